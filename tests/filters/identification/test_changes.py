"""Compass and DVL that change within a log: time and size are found, and false fixes are not taken for changes."""

import itertools
import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from textbook import log_density
from usbldr.filters.frames import rotated
from usbldr.filters.identification import evidence
from usbldr.filters.identification.blocks import (
    OF_DEAD_RECKONING,
    OF_FIXES,
    OF_WATER,
    Kind,
    blocks_about,
    blocks_of,
    off_neighbours_m,
)
from usbldr.filters.identification.changes import (
    FoundChanges,
    _Change,
    _changing,
    _gains,
    _with,
    about_longest_part,
    changes,
)
from usbldr.filters.identification.changes_of_noise import changes_of_noise
from usbldr.filters.identification.evidence import identify
from usbldr.filters.identification.false_runs import false_runs
from usbldr.filters.identification.linearisation import NO_ERROR, drift_variances_m2
from usbldr.filters.identification.lost_reckoning import lost_spans
from usbldr.filters.identification.usbl_likelihood import Member
from usbldr.filters.models.parameters import Parameters, ProcessNoise, SensorChange
from usbldr.filters.replay.dead_reckoning import displacement_m, without_changes
from usbldr.filters.replay.run import run
from usbldr.filters.types import Outage, Timeline
from usbldr.filters.windows import columns_at
from weaving import ASSUMED, DIVE, Faults, headings_off, mean_error_m, weaving_dive


def wrong(from_s: float, to_s: float, turned_rad: float = 0.0, scale: float = 0.0, dive: Timeline = DIVE) -> Timeline:
    """Return a dive with an error of compass and DVL for a while."""
    there = (dive.time_s >= from_s) & (dive.time_s < to_s)
    factor = 1 + (there * scale)[:, None]
    turned = np.where(there, turned_rad, 0.0)
    return headings_off(turned, replace(dive, dvl_mps=dive.dvl_mps * factor, dr_mps=dive.dr_mps * factor))


BESIDE_IRON = headings_off(1.2 * np.exp(-(((DIVE.time_s - 200.0) / 12.0) ** 2)))  # [rad] for half a minute


def of_dead_reckoning(line: Timeline, given: Parameters = ASSUMED) -> tuple[SensorChange, ...]:
    usual, blocks = blocks_of(line, given)
    return next(iter(changes(usual, given, blocks)), FoundChanges()).changes


@pytest.mark.parametrize("kind", [OF_DEAD_RECKONING, OF_WATER, OF_FIXES], ids=["dead reckoning", "water", "fixes"])
def test_the_gain_is_the_ratio_of_two_densities(kind: Kind) -> None:
    blocks = blocks_about(wrong(200.0, 1e9, 0.1), ASSUMED, NO_ERROR, 1.0)._replace(kind=kind)
    last = len(blocks.time_s)
    before, begins, ends = [_Change(150, len(kind.parts) - 1, last)], [60, 200, 300], [260, last]
    gains = _gains(blocks, before, np.array(begins), np.array(ends))
    for (begin, end, parts), gain in zip(
        itertools.product(begins, ends, range(len(kind.parts))), gains.ravel(), strict=True
    ):
        with_it, without = (
            log_density(blocks.residual_m, _with(blocks, found))
            for found in ([*before, _Change(begin, parts, end)], before)
        )
        assert gain == pytest.approx(with_it - without, rel=1e-6, abs=1e-6)


def test_a_change_of_both_parts_of_the_factor_has_the_covariance_of_either() -> None:
    blocks = blocks_about(wrong(200.0, 1e9, 0.1), ASSUMED, NO_ERROR, 1.0)
    one, other, both = (_with(blocks, [_Change(60, parts, len(blocks.time_s))]) for parts in range(3))
    assert np.allclose(one + other, both + _with(blocks, []))


@pytest.mark.parametrize("end", [260, len(DIVE.fix_time_s)])
def test_a_current_that_passes_moves_the_fixes_by_its_way_until_then(end: int) -> None:
    blocks = blocks_about(DIVE, ASSUMED, NO_ERROR, 1.0)._replace(kind=OF_WATER)
    moved = _changing(blocks, [_Change(63, 0, end)])[:, 0]

    t = DIVE.fix_time_s
    way_s = np.clip(t, t[63], t[min(end, len(t) - 1)]) - t[63]
    of_blocks = way_s[blocks.first[:, None] + np.arange(blocks.first[1])].mean(axis=1)
    np.testing.assert_allclose(moved[0::2, 0], of_blocks, atol=1e-9)  # of 1 m/s east
    np.testing.assert_allclose(moved[1::2, 1], of_blocks, atol=1e-9)
    assert not moved[1::2, 0].any()


@pytest.mark.parametrize(
    ("line", "want"),
    [
        (wrong(200.0, 1e9, 0.14), [(200.0, 0.14, 0.0)]),
        (wrong(200.0, 1e9, -0.14), [(200.0, -0.14, 0.0)]),
        (wrong(150.0, 1e9, 0.0, 0.2), [(150.0, 0.0, 0.2)]),
        (wrong(150.0, 210.0, 0.7), [(150.0, 0.7, 0.0), (210.0, 0.0, 0.0)]),
        (wrong(0.0, 1e9, 2.9, 0.0, wrong(200.0, 1e9, 0.14)), [(200.0, 0.14, 0.0)]),  # however the compass is mounted
    ],
    ids=["heading", "the other way", "scale", "a minute", "on top of a mounting"],
)
def test_a_change_is_found_with_its_time_and_size(line: Timeline, want: list[tuple[float, float, float]]) -> None:
    found = of_dead_reckoning(line)

    assert len(found) == len(want)
    for one, (start_s, turned_rad, scale) in zip(found, want, strict=True):
        assert one.start_s == pytest.approx(start_s, abs=12.0)
        assert one.heading_bias_rad == pytest.approx(turned_rad, abs=0.03)
        assert one.dvl_scale == pytest.approx(scale, abs=0.03)


BY_HALF = [(1e9, -0.4, 1), (1e9, 0.6, 1), (230.0, 0.4, 2), (230.0, 0.6, 0), (230.0, -0.4, 0)]


@pytest.mark.parametrize(("to_s", "scale", "changes"), BY_HALF)
def test_a_speed_that_changes_by_half_does_so_for_good(to_s: float, scale: float, changes: int) -> None:
    assert len(of_dead_reckoning(wrong(150.0, to_s, 0.0, scale))) == changes


def test_a_heading_that_jumps_twice_and_back_has_no_scale() -> None:
    line = wrong(200.0, 240.0, 1.2, 0.0, wrong(240.0, 280.0, 1.8))

    found = of_dead_reckoning(line)

    assert [one.start_s for one in found] == pytest.approx([200.0, 240.0, 280.0], abs=5.0)
    assert [one.heading_bias_rad for one in found] == pytest.approx([1.2, 1.8, 0.0], abs=0.05)
    assert [one.dvl_scale for one in found] == pytest.approx([0.0, 0.0, 0.0], abs=0.05)
    (one,) = of_dead_reckoning(wrong(200.0, 1e9, 0.14))
    assert one.dvl_scale == pytest.approx(0.0, abs=7e-3)  # linear in the turn, it would be 1 - cos 8 deg more, 0.015


@pytest.mark.parametrize(("line", "since_s"), [(wrong(0.0, 100.0, 0.5), -np.inf), (wrong(300.0, 1e9, 0.5), 300.0)])
def test_a_compass_that_settles_or_slips_is_right_for_the_longest_part(line: Timeline, since_s: float) -> None:
    found = identify(line, ASSUMED)

    assert not found.estimates
    (other,) = (one for one in found.parameters.changes if one.heading_bias_rad)
    assert other.start_s == pytest.approx(since_s, abs=5.0)
    assert other.heading_bias_rad == pytest.approx(0.5, abs=0.03)
    (text,) = found.change_texts.values()
    assert f"on headings read {'+28' if since_s < 0 else '-28'}" in text


def test_speeds_that_change_by_half_leave_the_first_part_as_it_is() -> None:
    fails = FoundChanges((SensorChange(50.0, 0.1, -0.6),))
    assert about_longest_part(fails, 400.0) == fails
    assert about_longest_part(FoundChanges(), 400.0) == FoundChanges()


def test_what_is_taken_off_is_what_was_put_on() -> None:
    line = wrong(150.0, 210.0, 0.7, 0.1)
    one, back = of_dead_reckoning(line)
    one = one._replace(start_s=150.0, heading_bias_rad=0.7, dvl_scale=0.1)
    exact = one, back._replace(start_s=210.0, heading_bias_rad=0.0, dvl_scale=0.0)

    restored = without_changes(line, exact)

    for name in ("yaw_rad", "dr_yaw_rad", "dvl_mps", "dr_mps"):
        np.testing.assert_allclose(getattr(restored, name), getattr(DIVE, name), atol=1e-12)


@pytest.mark.parametrize("seed", range(6))
def test_a_dive_without_a_change_has_none(seed: int) -> None:
    assert of_dead_reckoning(weaving_dive(Faults(), seed)) == ()


@pytest.mark.parametrize("seed", [0, 3])
def test_fixes_that_wander_more_than_is_usual_are_no_change(seed: int) -> None:
    assert identify(weaving_dive(Faults(), seed, wander_m=0.5), ASSUMED).parameters.changes == ()


@pytest.mark.parametrize("seed", range(2))
def test_a_heading_that_walks_does_not_change(seed: int) -> None:
    dive = weaving_dive(Faults(), seed, seconds=3600)
    steps = np.random.default_rng(seed).normal(size=len(dive.time_s))
    walk_rad = np.cumsum(steps) * np.sqrt(np.diff(dive.time_s)[0]) * ASSUMED.errors.heading_walk_rad
    line = headings_off(walk_rad, dive)

    assert of_dead_reckoning(line) == ()
    assert of_dead_reckoning(line, replace(ASSUMED, errors=replace(ASSUMED.errors, heading_walk_rad=0.0)))


def with_outliers(line: Timeline, share: float, seed: int) -> Timeline:
    """Return a dive of whose fixes some are off by 15 m (1-sigma), each by itself."""
    rng = np.random.default_rng(seed)
    wrong_m = np.where(rng.random((len(line.fix_m), 1)) < share, rng.normal(scale=15.0, size=line.fix_m.shape), 0.0)
    return replace(line, fix_m=line.fix_m + wrong_m)


@pytest.mark.parametrize("share", [0.15, 0.35])
def test_a_change_is_found_among_outliers_and_outliers_are_none(share: float) -> None:
    for seed in range(4):
        dive = weaving_dive(Faults(), seed)
        assert of_dead_reckoning(with_outliers(dive, share, seed)) == ()
        (one,) = of_dead_reckoning(with_outliers(wrong(200.0, 1e9, 0.14, dive=dive), share, seed))
        assert one.start_s == pytest.approx(200.0, abs=25.0)
        assert one.heading_bias_rad == pytest.approx(0.14, abs=0.05)


@pytest.mark.parametrize("line", [wrong(200.0, 1e9, 0.03), wrong(200.0, 230.0, 0.2)], ids=["small", "short"])
def test_an_error_within_the_stated_error_of_the_fixes_is_found_if_theirs_is_smaller(line: Timeline) -> None:
    assert of_dead_reckoning(line)


@pytest.mark.long
def test_a_track_is_what_it_is_without_the_change_and_a_warning_says_when() -> None:
    line = wrong(200.0, 1e9, 0.14)
    found = identify(line, ASSUMED)
    constant = replace(found.parameters, changes=())

    off_m, before_m = (mean_error_m(line, parameters) for parameters in (found.parameters, constant))

    assert off_m < 0.25
    assert before_m > 3 * off_m
    (warning,) = (text for text in found.warnings if "headings read" in text)
    assert warning.startswith("SENSOR-CHANGE: from ")
    assert "headings read -8." in warning  # clockwise


@pytest.mark.parametrize(
    ("from_s", "to_s", "by_m", "silent_s"),
    [
        (150.0, 240.0, [4.0, -3.0], 0.0),
        (60.0, 120.0, [4.0, -3.0], 0.0),
        (100.0, 115.0, [4.0, -3.0], 0.0),
        (250.0, 300.0, [10.0, 10.0], 60.0),
    ],
)
def test_two_jumps_of_the_position_are_no_change(from_s, to_s, by_m, silent_s):
    """Of 5 m, and of 14 m behind a minute without fixes: no other factor explains them."""
    T = DIVE.fix_time_s
    jumped = replace(DIVE, fix_m=DIVE.fix_m + ((from_s <= T) & (to_s > T))[:, None] * by_m)
    assert of_dead_reckoning(jumped.with_fixes((from_s - silent_s > T) | (from_s <= T))) == ()


@pytest.mark.parametrize(
    ("turned_rad", "cost", "taken"), [(0.3, 0.0, False), (0.0, 1.0, False), (0.0, -1.0, True)], ids=str
)
def test_changes_are_taken_if_the_fixes_are_likelier_with_them_by_more_than_they_cost(
    turned_rad, cost, taken, monkeypatch
):
    proposed = (SensorChange(200.0, turned_rad, 0.0),)  # of 0 it makes no difference
    monkeypatch.setattr(evidence, "changes", lambda *_: (FoundChanges(proposed, cost),))

    assert identify(DIVE, ASSUMED).parameters.changes == (proposed if taken else ())


def through_water(from_s: float, to_s: float, current_mps: tuple[float, float], dive: Timeline = DIVE) -> Timeline:
    """Return a dive whose DVL measures through a current, east and north, for a while."""
    along_axes = rotated(-DIVE.dr_yaw_rad, np.array(current_mps))  # of the vehicle
    there = ((DIVE.time_s >= from_s) & (DIVE.time_s < to_s))[:, None]
    return replace(dive, dvl_mps=dive.dvl_mps - there * along_axes, dr_mps=dive.dr_mps - there * along_axes)


@pytest.mark.parametrize(
    ("from_s", "to_s"),
    [
        (-1.0, 150.0),
        *(pytest.param(*span, marks=pytest.mark.slow) for span in ((100.0, 220.0), (250.0, 320.0), (200.0, 1e9))),
    ],
)
def test_a_dvl_that_measures_through_a_current_for_a_while_is_corrected(from_s: float, to_s: float) -> None:
    line = through_water(from_s, to_s, (0.25, -0.3))

    found = identify(line, ASSUMED)

    freed = without_changes(line, found.parameters.changes)
    at_ends = [abs(DIVE.time_s - edge_s) > 5.0 for edge_s in (from_s, to_s)]
    off_mps = (freed.dr_mps - DIVE.dr_mps)[np.all(at_ends, axis=0)]
    assert np.abs(off_mps).max() < 0.05
    (text,) = found.change_texts.values()
    begin_s, end = re.match(
        r"from (\d+) (to \d+ s|s on) the DVL reads 0.[34]\d m/s more towards 3[12]\d° ", text
    ).groups()
    assert float(begin_s) == pytest.approx(max(from_s, 0.0), abs=10.0)
    assert end == "s on" or float(end[3:-2]) == pytest.approx(to_s, abs=10.0)
    assert (end == "s on") == (to_s > line.time_s[-1])


@pytest.mark.long
def test_fixes_that_drift_away_and_come_back_are_false_and_no_current_is_found() -> None:
    away_m = 10.0 * np.sin(np.pi * np.clip((DIVE.fix_time_s - 130.0) / 150.0, 0.0, 1.0))
    line = replace(DIVE, fix_m=DIVE.fix_m + away_m[:, None] * (0.8, 0.6))

    found = identify(line, ASSUMED)

    assert not found.parameters.changes
    (run,) = found.false_runs
    assert (run.start_s, run.end_s) == pytest.approx((130.0, 280.0), abs=10.0)
    assert mean_error_m(line, found.parameters) < 0.1


@pytest.mark.long
def test_currents_that_do_not_cancel_each_other_are_no_drift_of_the_fixes() -> None:
    line = through_water(200.0, 230.0, (-0.3, 0.0), through_water(100.0, 160.0, (0.3, 0.0)))

    found = identify(line, ASSUMED)

    assert len(found.change_texts) == 2
    assert not found.false_runs
    assert mean_error_m(line, found.parameters) < 0.3


def test_a_stretch_from_the_first_fix_or_to_the_last_one_has_no_times_to_choose() -> None:
    blocks = blocks_about(DIVE, ASSUMED, NO_ERROR, 1.0)
    last, count = len(DIVE.fix_time_s), len(blocks.first)
    begins, ends = np.array([0, 5, 100]), np.array([200, last])

    of_water, of_fixes = (blocks._replace(kind=kind).log_odds(begins, ends) for kind in (OF_WATER, OF_FIXES))

    times = np.array([[count, 1], [count, 1], [count**2, count]])
    np.testing.assert_allclose(of_water[..., 0], np.log(20**2 * times))  # of two numbers
    np.testing.assert_allclose(of_fixes[:, 1, 1], np.log(20 * np.full(3, count)))  # of one


@pytest.mark.parametrize("false", [0, 2])
def test_the_first_and_last_fixes_of_a_track_that_drifts_lie_among_their_neighbours(false: int) -> None:
    exact_m = columns_at(DIVE.fix_time_s, DIVE.time_s, displacement_m(DIVE))
    off_m = np.where(np.arange(len(exact_m)) < false, 40.0, 0.0)
    drifting_m = exact_m + np.outer(DIVE.fix_time_s, (0.4, -0.2)) + off_m[:, None]

    found_m = off_neighbours_m(replace(DIVE, fix_m=drifting_m), ASSUMED)

    np.testing.assert_allclose(found_m, np.column_stack([off_m, off_m]), atol=1.0)


@pytest.mark.parametrize("false", [0, 4])
def test_a_current_from_the_first_fix_on_is_found_beside_noise_and_false_first_fixes(false: int) -> None:
    """As in the descent of a vehicle whose DVL does not reach the bottom yet; first replies are another beacon's."""
    noise_m, current_mps = np.random.default_rng(3).normal(0, 1.5, DIVE.fix_m.shape), (0.2, 0.1)
    line = through_water(0.0, 150.0, current_mps)
    line = replace(line, fix_m=line.fix_m + noise_m, fix_cov_m2=np.full_like(line.fix_cov_m2, 1.5**2) * np.eye(2))
    line = line.with_fixes(np.arange(0, len(noise_m), 5))
    line.fix_m[:false] = 200.0, 100.0

    found = identify(line, ASSUMED).parameters

    assert found.false_fixes == tuple(range(false))
    begin, end = found.changes
    assert begin.current_mps == pytest.approx(current_mps, abs=0.05)
    assert begin.start_s < 25.0
    assert (end.start_s, *end.current_mps) == pytest.approx((150.0, 0.0, 0.0), abs=10.0)
    assert not any(end.current_mps)


def changed_fixes(from_s: float, shift_m: tuple[float, float] = (0.0, 0.0), late_s: float = 0.0) -> Timeline:
    """Return a dive whose fixes lie elsewhere from then on, or come later."""
    there = DIVE.fix_time_s >= from_s
    moved_m = DIVE.fix_m + there[:, None] * np.array(shift_m)
    return replace(DIVE, fix_m=moved_m, fix_time_s=DIVE.fix_time_s + there * late_s)


@pytest.mark.parametrize("share", [0.35, 0.5, 0.65])
def test_fixes_that_shift_for_good_are_moved_onto_the_others(share: float) -> None:
    from_s = round(share * float(DIVE.fix_time_s[-1]))

    found = identify(changed_fixes(from_s, (5.0, -7.0)), ASSUMED)

    moved = {one.start_s: one.fix_shift_m for one in found.parameters.changes}
    since_s, text = next(iter(found.change_texts.items()))
    assert len(found.change_texts) == 1
    assert since_s == pytest.approx(from_s, abs=2.0)
    assert text.startswith(f"from {since_s:.0f} s on the USBL fixes lie ")
    assert "m east and" in text
    assert "m south of where they lay before" in text
    if share < 0.4:
        assert moved[-np.inf] == pytest.approx((-5.0, 7.0), abs=0.5)
    else:
        assert moved[since_s] == pytest.approx((5.0, -7.0), abs=0.5)
    track = run("adf", changed_fixes(from_s, (5.0, -7.0)), found.parameters)
    expected_m = np.array([5.0, -7.0]) * (share < 0.4)
    off_m = np.median(track.position_m - run("adf", DIVE, ASSUMED).position_m, axis=0)
    np.testing.assert_allclose(off_m, expected_m, atol=0.5)
    likelier = min(share, 1 - share) ** 4 / (share**4 + (1 - share) ** 4)
    np.testing.assert_allclose(track.open_cov_m2[-1], likelier * np.outer([5.0, -7.0], [5.0, -7.0]), rtol=0.4)


@pytest.mark.parametrize(("cost", "rival"), [(2.5, True), (3.5, False)])
def test_a_shift_that_is_nearly_as_likely_as_what_is_taken_stays_in_the_sigma(cost, rival, monkeypatch) -> None:
    shift = (SensorChange(200.0, 0.0, 0.0, fix_shift_m=(1e-3, -1e-3)),)  # so small that it makes no difference
    monkeypatch.setattr(evidence, "changes", lambda *_: (FoundChanges(shift, cost),))

    found = identify(DIVE, ASSUMED)

    assert (found.parameters.changes, found.parameters.rival_shift) == ((), shift if rival else ())
    assert any("from 200 s on the USBL fixes lie 0.0 m east" in one for one in found.warnings) == rival
    with_both, without = (replace(found.parameters, rival_shift=one) for one in (found.parameters.rival_shift, ()))
    tracks: list[Any] = [run("adf", DIVE, one) for one in (with_both, without)]
    open_m2 = tracks[0].open_cov_m2 - tracks[1].open_cov_m2
    share = 0.5 if rival else 0.0
    np.testing.assert_allclose(open_m2[-1], share * 1e-6 * np.array([[1, -1], [-1, 1]]), rtol=0.1)


def test_fixes_that_come_later_from_a_time_on_are_moved_to_when_they_were_valid() -> None:
    found = identify(changed_fixes(200.0, late_s=2.5), ASSUMED)

    ((since_s, text),) = found.change_texts.items()
    assert since_s == pytest.approx(200.0, abs=10.0)
    (later,) = re.findall(r"stamps of the USBL fixes are (.*) s later than before", text)
    assert float(later) == pytest.approx(2.5, abs=0.2)


@pytest.mark.parametrize(("from_s", "factor"), [(120.0, 5.0), (280.0, 5.0), (200.0, 0.25)])
def test_fixes_that_scatter_more_from_a_time_on_count_less_there(from_s: float, factor: float) -> None:
    noise_m = np.random.default_rng(8).normal(0, 0.2 * max(factor, 1.0), DIVE.fix_m.shape)
    later = DIVE.fix_time_s >= from_s
    louder = later if factor > 1 else ~later
    line = replace(DIVE, fix_m=DIVE.fix_m + louder[:, None] * noise_m * (1.0 if factor > 1 else 4.0))

    found = identify(line, ASSUMED)

    ((since_s, text),) = found.change_texts.items()
    assert since_s == pytest.approx(from_s, abs=15.0)
    said = float(re.search(r"the USBL fixes scatter ([\d.]+) times as much as before", text)[1])
    assert said == pytest.approx(factor, rel=0.3)
    assert not found.parameters.false_fixes
    scaled = without_changes(line, found.parameters.changes)
    np.testing.assert_allclose(scaled.fix_cov_m2[-1], line.fix_cov_m2[-1] * said**2, rtol=0.1)
    np.testing.assert_array_equal(scaled.fix_cov_m2[0], line.fix_cov_m2[0])


def test_fixes_that_scatter_more_for_a_while_are_as_before_afterwards() -> None:
    """As the noise of a head grows with the distance to a vehicle that comes back."""
    away = (DIVE.fix_time_s >= 130.0) & (DIVE.fix_time_s < 270.0)
    noise_m = np.random.default_rng(10).normal(0, 0.8, DIVE.fix_m.shape)

    found = identify(replace(DIVE, fix_m=DIVE.fix_m + away[:, None] * noise_m), ASSUMED).parameters

    more, as_before = found.changes
    assert (more.start_s, as_before.start_s) == (pytest.approx(130.0, abs=15.0), pytest.approx(270.0, abs=15.0))
    assert more.fix_sd_scale == pytest.approx(np.hypot(0.2, 0.8) / 0.2, rel=0.3)
    assert as_before.fix_sd_scale == pytest.approx(1.0, abs=0.3)
    assert not found.false_fixes


def test_fixes_without_noise_and_a_few_outliers_do_not_scatter_more() -> None:
    exact = replace(DIVE, fix_m=columns_at(DIVE.fix_time_s, DIVE.time_s, displacement_m(DIVE)))
    jumping = replace(DIVE, fix_m=DIVE.fix_m + 30.0 * (np.arange(len(DIVE.fix_m)) % 20 == 0)[:, None])

    assert [identify(line, ASSUMED).change_texts for line in (DIVE, jumping)] == [{}, {}]
    assert changes_of_noise(exact, ASSUMED) == FoundChanges()


def test_a_change_of_the_noise_is_found_beside_fixes_that_shift() -> None:
    louder = (DIVE.fix_time_s >= 250.0)[:, None]
    noise_m = np.random.default_rng(9).normal(0, 1.0, DIVE.fix_m.shape)
    line = changed_fixes(150.0, (9.0, -12.0))

    found = identify(replace(line, fix_m=line.fix_m + louder * noise_m), ASSUMED)

    shifted, scattered = found.change_texts
    assert (shifted, scattered) == (pytest.approx(150.0, abs=2.0), pytest.approx(250.0, abs=15.0))
    assert found.parameters.changes[-1].fix_sd_scale > 3 > 1 == found.parameters.changes[-2].fix_sd_scale


def test_speeds_that_change_by_more_than_a_scale_error_are_said_to_be_none() -> None:
    found = identify(DIVE, ASSUMED)
    some = (SensorChange(100.0, 0.0, 0.03), SensorChange(200.0, 0.0, 4.6), SensorChange(300.0, 0.0, 0.0))

    texts = replace(found, parameters=replace(found.parameters, changes=some)).change_texts

    assert ["so much is no scale error" in text for text in texts.values()] == [False, True, True]


@pytest.mark.parametrize("from_s", [150.0, *(pytest.param(s, marks=pytest.mark.slow) for s in (90.0, 260.0))])
def test_a_dvl_that_reads_no_motion_for_a_while_is_left_out_there(from_s: float) -> None:
    """Most fixes follow, or precede: the others would be false otherwise."""
    still = ((DIVE.time_s >= from_s) & (DIVE.time_s < from_s + 40.0))[:, None]
    noise_mps = np.random.default_rng(4).normal(0, 0.01, DIVE.dvl_mps.shape)
    dvl_mps, dr_mps = (np.where(still, noise_mps, moving_mps) for moving_mps in (DIVE.dvl_mps, DIVE.dr_mps))
    line = replace(DIVE, dvl_mps=dvl_mps, dr_mps=dr_mps)

    found = identify(line, ASSUMED)

    begin, end = found.parameters.changes
    assert (begin.lost, end.lost) == (("dvl", "compass"), ())
    assert (begin.start_s, end.start_s) == pytest.approx((from_s, from_s + 40.0), abs=10.0)
    assert len(found.parameters.false_fixes) < 10
    ((since_s, text),) = found.change_texts.items()
    assert since_s == begin.start_s
    assert text.startswith(f"from {begin.start_s:.0f} to {end.start_s:.0f} s DVL or compass do not read the vehicle's")
    assert "neither is used in this time" in text
    assert mean_error_m(line, found.parameters) < 0.3


def test_a_compass_that_is_turned_for_a_while_is_not_taken_for_fixes_that_shift() -> None:
    found = identify(BESIDE_IRON, ASSUMED)

    assert [one.lost for one in found.parameters.changes] == [("dvl", "compass"), ()]
    assert mean_error_m(BESIDE_IRON, found.parameters) < 0.5


def test_lost_dead_reckoning_is_sought_where_fixes_seem_to_shift(monkeypatch: pytest.MonkeyPatch) -> None:
    shift = SensorChange(200.0, 0.0, 0.0, fix_shift_m=(9.0, 0.0))
    sought_s = list[float]()
    monkeypatch.setattr(evidence, "changes", lambda *_: (FoundChanges((shift,), 100.0),))
    monkeypatch.setattr(evidence, "lost_spans", lambda *given: sought_s.extend(given[3]) or ())

    identify(DIVE, ASSUMED)

    assert sought_s == [200.0]
    assert not lost_spans(DIVE, Member(ASSUMED, frozenset()), shifts_s=[200.0])  # one gains less than it costs
    spans = lost_spans(BESIDE_IRON, Member(ASSUMED, frozenset()), shifts_s=[-np.inf, 200.0])
    assert {begin.lost for begin, _ in spans} == {("dvl",), ("dvl", "compass")}
    assert all(begin.start_s < 200.0 < end.start_s for begin, end in spans)
    better = false_runs(DIVE, Member(ASSUMED, frozenset())).log_likelihood
    assert not lost_spans(BESIDE_IRON, Member(ASSUMED, frozenset()), better, [200.0])


def test_lost_dead_reckoning_is_an_outage_of_its_sensors_and_goes_on_between_its_ends() -> None:
    begin, end = SensorChange(100.0, 0.0, 0.0, lost=("dvl", "compass")), SensorChange(140.0, 0.1, 0.0)
    lost = without_changes(DIVE, (begin, end))

    inside = (DIVE.time_s >= 100.0) & (DIVE.time_s < 140.0)
    for measured, count in ((lost.dvl_mps, lost.dvl_count), (lost.yaw_rad, lost.yaw_count)):
        assert np.isnan(measured[inside]).all()
        assert not count[inside].any()
    assert lost.outages == (Outage("dvl", 100.0, 140.0), Outage("compass", 100.0, 140.0))
    np.testing.assert_array_equal(lost.dvl_count[~inside], DIVE.dvl_count[~inside])
    np.testing.assert_array_equal(lost.dr_mps[~inside], DIVE.dr_mps[~inside])
    np.testing.assert_allclose(lost.dr_mps[inside], DIVE.dr_mps[inside], atol=0.3)
    first, last = np.flatnonzero(inside)[[0, -1]].tolist()
    between = np.linspace(DIVE.dr_yaw_rad[first - 1], DIVE.dr_yaw_rad[last + 1], last - first + 3)[1:-1]
    np.testing.assert_allclose(lost.dr_yaw_rad[inside], between)
    assert lost.yaw_rad[-1] == pytest.approx(DIVE.yaw_rad[-1] - 0.1)


def test_without_a_record_of_the_dvl_dead_reckoning_walks_alone() -> None:
    line = replace(DIVE, dvl_count=np.zeros_like(DIVE.dvl_count))
    assumed = Parameters(process=ProcessNoise(0.2, 0.0, 0.1, 0.0))

    found_m2 = drift_variances_m2(line, np.array([10.0, 30.0]), [assumed], [True])[:, 0]

    np.testing.assert_allclose(found_m2, [0.2**2 * 10.0, 0.2**2 * 20.0])


@pytest.mark.parametrize(
    ("until_s", "current_mps", "seed"), [(37.0, (0.3, 0.3), 2), (42.0, (0.6, -0.5), 0), (42.0, (0.3, 0.3), 2)]
)
def test_a_current_of_the_first_blocks_begins_before_it_ends(until_s, current_mps, seed) -> None:
    noise_m = np.random.default_rng(seed).normal(0, 0.3, DIVE.fix_m.shape)
    drift_m = np.outer(DIVE.fix_time_s, (0.01, 0.0))
    line = through_water(0.0, until_s, current_mps)
    line = replace(line, fix_m=line.fix_m + noise_m + drift_m).with_fixes(np.arange(0, len(noise_m), 8))

    usual, blocks = blocks_of(line, ASSUMED)

    for one in changes(usual, ASSUMED, blocks):
        start_s = [change.start_s for change in one.changes]
        assert start_s == sorted(start_s)


def test_before_the_first_record_of_the_dvl_the_velocity_is_open() -> None:
    """It is the first one, less a random walk; the variance of its integral is q² t³ / 3."""
    line, first_s = replace(DIVE, dvl_count=np.where(DIVE.time_s < 60.0, 0, DIVE.dvl_count)), 60.0
    assumed = Parameters(process=ProcessNoise(0.0, 0.0, 0.1, 0.0))

    found_m2 = drift_variances_m2(line, np.array([first_s / 2, first_s]), [assumed], [True])[:, 0]

    assert found_m2.sum() == pytest.approx(0.1**2 * first_s**3 / 3, rel=0.01)
    assert found_m2[0] == pytest.approx(found_m2[1], rel=0.01)


@pytest.mark.parametrize("until_s", [350.0, np.inf], ids=["for a while", "until the end"])
def test_without_headings_the_vehicle_may_have_moved_in_any_direction(until_s: float) -> None:
    """How far dead reckoning drifts while the compass is silent."""
    t, speed_mps, from_s = DIVE.time_s, 1.2, 150.0
    silent, end_s = (t > from_s) & (t < until_s), min(until_s, t[-1])
    straight_mps, blind = np.tile([0.0, speed_mps], (len(t), 1)), np.where(silent, 0, DIVE.yaw_count)
    line = replace(DIVE, dr_mps=straight_mps, yaw_count=blind, dr_yaw_rad=np.zeros(len(t)))
    assumed = Parameters(process=ProcessNoise(0.0, 0.0, 0.0, 0.02))

    found_m2 = drift_variances_m2(line, np.array([from_s, end_s]), [assumed], [True])

    # each axis of a direction that may be any has the variance 1/2
    assert found_m2[1, 0] == pytest.approx((speed_mps * (end_s - from_s)) ** 2 / 2, rel=0.02)
