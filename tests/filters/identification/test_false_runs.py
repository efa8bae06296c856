"""Runs of false fixes, errors far outside of what is usual, and noise that looks like drift."""

from dataclasses import replace

import numpy as np
import pytest

from usbldr.filters.identification import false_runs as search_room
from usbldr.filters.identification.evidence import identify
from usbldr.filters.identification.false_runs import false_fixes, false_runs, false_starts
from usbldr.filters.identification.histories import HistorySearch
from usbldr.filters.identification.usbl_likelihood import Member
from usbldr.filters.models.parameters import FalseStart
from usbldr.filters.replay.methods import FilterSettings
from usbldr.filters.replay.position_fixes import rival_fixes
from usbldr.filters.replay.run import run
from usbldr.filters.types import Array, Mask, Timeline
from usbldr.filters.updates import UpdateTable
from weaving import ASSUMED, DIVE, Faults, apart_m, clean_track, mean_error_m, track_of, weaving_dive

CLEAN = clean_track()


def moved(rows: Mask, by_m: Array) -> Timeline:
    return replace(DIVE, fix_m=np.where(rows[:, None], DIVE.fix_m + by_m, DIVE.fix_m))


T = DIVE.fix_time_s
AWAY_M = np.array([500.0, 100.0])
RUNS = {
    "first 5 s": T < 5,
    "first 40 s": T < 40,
    "first 100 s": T < 100,
    "middle": (T > 150) & (T < 210),
    "last": T > 350,
    "several": (T // 20) % 4 == 1,
}


@pytest.mark.parametrize("name", RUNS)
@pytest.mark.long
def test_false_fixes_in_a_row_are_found_wherever_they_are(name: str) -> None:
    line = moved(RUNS[name], np.array([40.0, -30.0]))

    found = identify(line, ASSUMED)

    assert found.parameters.false_fixes == tuple(np.flatnonzero(RUNS[name]).tolist())
    assert found.parameters.changes == ()
    assert sum(one.fixes for one in found.false_runs) == RUNS[name].sum()
    assert [one.last for one in found.false_runs][-1] == RUNS[name][-1]
    rivals, others = found.false_runs[0].fixes, int((~RUNS[name]).sum())
    assert found.false_runs[0].rival_share == pytest.approx(rivals**4 / (rivals**4 + others**4))
    assert str(RUNS[name].sum()) in found.warnings[0]
    assert mean_error_m(line, found.parameters) < 0.5


@pytest.mark.parametrize("place", ["first", "middle"])
def test_so_many_false_fixes_that_they_may_be_right_widen_the_sigma_while_they_last(place: str) -> None:
    count, others, first = 120, len(T) - 120, 0 if place == "first" else 150
    false = np.arange(first, first + count)
    line = moved(np.isin(np.arange(len(T)), false), np.array([6.0, -8.0]))
    track = run("adf", line, replace(ASSUMED, false_fixes=tuple(false.tolist())))
    share = count**4 / (count**4 + others**4)

    begin, there, end = np.searchsorted(line.time_s, T[false[[0, count // 2, -1]]])
    np.testing.assert_allclose(track.open_cov_m2[there], share * np.outer([6, -8], [6, -8]), rtol=0.2)
    assert not track.open_cov_m2[:begin].any()
    assert not track.open_cov_m2[end + 1 :].any()


@pytest.mark.long
def test_fixes_that_drift_away_and_return_are_false() -> None:
    """Until they return, dead reckoning might as well have drifted."""
    from_s, until_s = 150.0, 270.0
    drifting = (from_s < T) & (until_s > T)
    line = moved(drifting, np.outer((T - from_s) / (until_s - from_s), (8.0, 4.0)))

    found = identify(line, ASSUMED).parameters

    false = np.isin(np.arange(len(T)), found.false_fixes)
    assert not false[~drifting].any()
    assert false[T > 200].sum() == np.count_nonzero(drifting & (T > 200))
    assert mean_error_m(line, found) < 0.5


def test_fixes_that_drift_away_for_ever_are_not_false() -> None:
    """A compass or a DVL that drifts is more usual."""
    line = moved(T > 250.0, np.outer((T - 250.0) / 150.0, (8.0, 4.0)))

    assert not false_fixes(line, Member(ASSUMED, frozenset()), ASSUMED)[0].any()


@pytest.mark.parametrize(
    ("seed", "until_s", "by_m"), [(1, 40.0, (16.0, 12.0)), (0, 60.0, (8.0, 6.0)), (3, 60.0, (8.0, 6.0))]
)
@pytest.mark.long
def test_a_false_start_that_lies_near_is_found(seed: int, until_s: float, by_m: tuple[float, float]) -> None:
    dive = weaving_dive(Faults(), seed)
    false = dive.fix_time_s < until_s
    line = replace(dive, fix_m=dive.fix_m + false[:, None] * np.array(by_m))

    found = identify(line, ASSUMED).parameters.false_fixes

    assert found == tuple(np.flatnonzero(false).tolist())


@pytest.mark.parametrize("place_m", [(0.0, 0.0), (30.0, 20.0), (-4e5, -5e6)])
def test_positions_that_were_written_before_the_first_reply_do_not_matter(place_m: tuple[float, float]) -> None:
    line = replace(DIVE, fix_m=np.where((T < 8)[:, None], np.array(place_m), DIVE.fix_m + AWAY_M))
    there = replace(DIVE, fix_m=DIVE.fix_m + AWAY_M)

    assert apart_m(track_of(line), track_of(there)).mean() < 0.5


def test_a_dive_without_false_fixes_has_none() -> None:
    assert identify(DIVE, ASSUMED).false_runs == ()


def test_fixes_of_which_half_are_elsewhere_are_all_kept() -> None:
    """Nothing says which half is false."""
    assert identify(moved(T > 195, np.array([40.0, -30.0])), ASSUMED).parameters.false_fixes == ()


def test_false_fixes_may_be_half_of_all_if_each_run_has_an_offset_of_its_own() -> None:
    """Each run is shorter than what is correct: that half shares one place."""
    false, angle = T % 60 >= 26, 2.4 * (T // 60)
    line = moved(false, 6.0 * np.column_stack([np.cos(angle), np.sin(angle)]))

    found = identify(line, ASSUMED).parameters

    assert false.mean() > 0.5
    assert np.mean(np.isin(np.arange(len(T)), found.false_fixes) == false) > 0.95
    assert mean_error_m(line, found) < 0.5


def test_false_fixes_by_turns_that_outnumber_the_first_true_ones_are_found_from_the_end() -> None:
    """As echoes from the surface at some ranges; the first seconds decide for the wrong place."""
    false = (T % 130 < 40) & (np.random.default_rng(2).random(len(T)) < 0.6)
    line = moved(false, np.array([12.0, 9.0]))

    found = identify(line, ASSUMED).parameters

    assert np.mean(np.isin(np.arange(len(T)), found.false_fixes) == false) > 0.9
    assert mean_error_m(line, found) < 0.5


@pytest.mark.parametrize("seed", range(3))
def test_from_the_last_fix_backwards_a_log_is_as_likely(seed: int) -> None:
    """But for the prior of the position, which is that of the other end."""
    member, line = Member(ASSUMED, frozenset({"scale", "misalignment"})), weaving_dive(Faults(), seed)

    forwards, backwards = (false_runs(line, member, backwards=way).log_likelihood for way in (False, True))

    assert backwards == pytest.approx(forwards, abs=3.0)


def test_from_the_last_fix_backwards_the_same_time_and_drift_lie_between_two_fixes(monkeypatch) -> None:
    """Of fixes at uneven times; from the last one, each lies where it lay from the first one."""
    searches: list[HistorySearch] = []
    monkeypatch.setattr(search_room, "followed", lambda search: (searches.append(search), search.followed())[1])
    line, member = DIVE.with_fixes(T % 7 % 3 == 0), Member(ASSUMED, frozenset({"scale"}))
    for backwards in (False, True):
        false_runs(line, member, backwards=backwards)
    ahead, back = searches
    errors = ahead.mean + np.linspace(0.1, 0.5, len(ahead.mean))
    to_last = ahead.measurement_matrix[-1].copy()
    to_last[:, ahead.bias] = 0.0
    last = np.concatenate([to_last @ errors, errors[2:]])

    between_s = np.diff(line.fix_time_s)
    assert np.ptp(between_s) > 1.0
    np.testing.assert_allclose(back.dt_s, [0.0, *between_s[::-1]])
    np.testing.assert_allclose(back.fade, np.exp(-back.dt_s / ASSUMED.errors.usbl_bias_s))
    np.testing.assert_allclose(back.drift_m2, [0.0, *ahead.drift_m2[:0:-1]])
    assert np.ptp(ahead.drift_m2[1:]) > 0
    np.testing.assert_allclose(back.mean[:2], to_last @ ahead.mean)
    np.testing.assert_allclose(back.cov[:2, :2], to_last @ ahead.cov @ to_last.T)
    np.testing.assert_allclose(back.measurement_matrix @ last, (ahead.measurement_matrix @ errors)[::-1], atol=1e-9)


def test_a_false_fix_is_reported_as_rejected_at_its_own_row() -> None:
    line = moved(RUNS["middle"], np.array([40.0, -30.0]))

    fixes = UpdateTable.of(track_of(line).updates).of_sensor("usbl")

    assert sorted(fixes.row) == list(range(len(T)))
    assert set(fixes.row[fixes.outcome == "rejected"]) == set(np.flatnonzero(RUNS["middle"]))
    rejected_m = np.median(fixes.vectors("innovation")[fixes.outcome == "rejected"], axis=0)
    np.testing.assert_allclose(rejected_m, [40.0, -30.0], atol=1.0)


def test_a_walk_of_dead_reckoning_that_has_grown_is_tried_against_false_runs_and_the_likelier_stays() -> None:
    grown = replace(ASSUMED, process=replace(ASSUMED.process, position_m=0.5))
    member, steps_m = Member(grown, frozenset()), np.random.default_rng(3).normal(0.0, 0.5, DIVE.fix_m.shape)
    drifting = replace(DIVE, fix_m=DIVE.fix_m + np.cumsum(steps_m, axis=0))

    for name in ("several", "last"):
        false = moved(RUNS[name], np.array([4.0, -3.0]))
        np.testing.assert_array_equal(false_fixes(false, member, ASSUMED)[0], RUNS[name])
    assert not false_fixes(drifting, member, ASSUMED)[0].any()


@pytest.mark.parametrize(("jump_s", "back_s"), [(300.0, np.inf), (100.0, np.inf), (200.0, 260.0)])
def test_dead_reckoning_that_is_at_fault_may_jump_and_does_not_jump_back(jump_s: float, back_s: float) -> None:
    grown = replace(ASSUMED, process=replace(ASSUMED.process, position_m=0.5))
    steps_m = np.random.default_rng(3).normal(0.0, 0.5, DIVE.fix_m.shape)
    there = (jump_s < T) & (back_s > T)
    line = replace(DIVE, fix_m=DIVE.fix_m + np.cumsum(steps_m, axis=0) + np.outer(there, (16.0, -12.0)))

    false, _ = false_fixes(line, Member(grown, frozenset()), ASSUMED)

    np.testing.assert_array_equal(false, there & np.isfinite(back_s))


@pytest.mark.parametrize("at_end", [False, True])
@pytest.mark.parametrize(("correct", "astray"), [(1, True), (8, False)])
def test_dead_reckoning_that_leaves_the_last_or_first_fixes_again_and_again_is_at_fault(at_end, correct, astray):
    """Each 20 s they lie elsewhere, after so many correct ones."""
    k = np.arange(100)
    angle, there = 2.4 * (k // 20), k % 20 >= correct
    off_m = np.zeros_like(DIVE.fix_m)
    off_m[:100] = 20.0 * there[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    line = replace(DIVE, fix_m=DIVE.fix_m + (off_m[::-1] if at_end else off_m))

    false, _ = false_fixes(line, Member(ASSUMED, frozenset()), ASSUMED)

    assert false.sum() == (0 if astray else there.sum())


def test_when_a_false_start_is_known_does_not_depend_on_its_distance() -> None:
    dive, first_s = weaving_dive(Faults(), seconds=70), 20
    away = (dive.fix_time_s > first_s)[:, None]

    near, far = (
        false_starts(replace(dive, fix_m=dive.fix_m + away * off_m), Member(ASSUMED, frozenset()))
        for off_m in ((40.0, -30.0), (400.0, -300.0))
    )

    assert near == far
    assert [(one.fixes, first_s < one.known_s <= 2 * first_s) for one in near] == [(first_s, True)]


@pytest.mark.long
def test_by_arrival_a_fix_that_became_false_before_it_was_settled_is_reported_once() -> None:
    dive = weaving_dive(Faults(), seconds=60)
    first = dive.fix_time_s < 4
    found = replace(ASSUMED, false_starts=(FalseStart(8.0, int(first.sum())),))
    line = replace(dive, fix_m=dive.fix_m + first[:, None] * (40.0, -30.0))

    track = run("ekf", line, found, FilterSettings(order="arrival"))

    fixes = UpdateTable.of(track.updates).of_sensor("usbl")
    assert sorted(fixes.row) == list(range(len(first)))
    assert set(fixes.row[fixes.outcome == "rejected"]) >= set(np.flatnonzero(first))


@pytest.mark.parametrize("off_m", [(40.0, -30.0), (400.0, -300.0)])
@pytest.mark.long
def test_in_the_order_of_arrival_only_later_fixes_show_which_ones_are_false(off_m: tuple[float, float]) -> None:
    """They outweigh the first ones when they have lasted for as long, however far apart both are."""
    dive = weaving_dive(Faults(), seconds=120)
    t, false_s = dive.fix_time_s, 20.0
    moved_m = np.select([(t < false_s)[:, None], ((t > 80) & (t < 90))[:, None]], [off_m, off_m[::-1]], 0.0)
    line = replace(dive, fix_m=dive.fix_m + moved_m)
    found = identify(line, ASSUMED).parameters

    track, without, clean = (
        run("ekf", one, parameters, FilterSettings(order="arrival"))
        for one, parameters in ((line, found), (line, replace(found, false_starts=())), (dive, ASSUMED))
    )

    (start,) = found.false_starts
    assert start.fixes == np.count_nonzero(t < false_s)
    assert false_s < start.known_s <= 2 * false_s
    early = track.time_s < start.known_s
    np.testing.assert_array_equal(track.mean[early], without.mean[early])
    error_m = apart_m(track, clean)
    assert error_m[early].min() > 20
    assert error_m[~early & (track.time_s < 80)].max() < 1
    fixes = UpdateTable.of(track.updates).of_sensor("usbl")
    assert sorted(fixes.row) == list(range(len(t)))
    assert f"the first {start.fixes} were false" in track.warnings[0]


FAR = [
    *(("heading_bias_deg", 170.0), ("dvl_scale", 0.25), ("usbl_latency_s", 4.9)),
    *(pytest.param("heading_bias_deg", deg, marks=pytest.mark.slow) for deg in (20.0, 178.0)),
]


@pytest.mark.parametrize(("name", "value"), FAR)
@pytest.mark.long
def test_an_error_far_outside_what_is_usual_is_found_and_no_other_is_invented(name: str, value: float) -> None:
    line = weaving_dive(Faults(**{name: value}))

    found = identify(line, ASSUMED)

    (estimate,) = found.estimates.values()
    assert estimate.name == name
    assert abs(estimate.value - value) < 4 * estimate.sd
    assert mean_error_m(line, found.parameters) < 0.3


@pytest.mark.parametrize("period_s", [6.0, 12.0])
@pytest.mark.long
def test_the_roll_of_a_ship_is_noise_of_the_fixes_and_not_of_dead_reckoning(period_s: float) -> None:
    rolled = replace(DIVE, fix_m=DIVE.fix_m + 2.0 * np.sin(2 * np.pi * T / period_s)[:, None] * (0.8, 0.6))

    found = identify(rolled, ASSUMED)

    assert found.parameters.process.position_m < 10 * ASSUMED.process.position_m
    assert mean_error_m(rolled, found.parameters) < 0.3


BESIDE_M = np.array([30.0, 40.0])


def every_so_many(every: int, by_m: Array) -> Timeline:
    return moved(np.arange(len(T)) % every == 1, by_m)


@pytest.mark.parametrize("every", [2, 3])
def test_two_sets_of_fixes_are_named_and_the_sigma_covers_the_other(every: int) -> None:
    track = track_of(every_so_many(every, BESIDE_M))

    (text,) = (text for text in track.warnings if "RIVAL-FIXES" in text)
    fewer, more = sorted((len(T) // every, len(T) - len(T) // every))
    assert "lie together 50 m off (at " in text
    if every == 3:
        assert "50 m off (at 37°)" in text
    assert not any("hardly all" in other for other in track.warnings)
    share = (fewer / more) ** 4 / (1 + (fewer / more) ** 4)
    np.testing.assert_allclose(track.open_cov_m2[0], share * np.outer(BESIDE_M, BESIDE_M), rtol=0.35)


def test_fixes_in_two_places_near_each_other_are_named_and_the_sigma_covers_both() -> None:
    beside_m = BESIDE_M / 5
    line = every_so_many(2, beside_m)
    track = run("ekf", line, identify(line, ASSUMED).parameters)

    (text,) = (text for text in track.warnings if "RIVAL-FIXES" in text)
    assert "lie in two places 10 m apart, the track between them" in text
    assert track.open_cov_m2 is not None
    np.testing.assert_allclose(track.open_cov_m2[0], np.outer(beside_m, beside_m) / 4, rtol=0.1)


@pytest.mark.parametrize("shape", ["normal", "uniform", "sine"])
def test_fixes_that_scatter_about_one_place_are_no_two_groups(shape: str) -> None:
    rng = np.random.default_rng(3)
    along_m = {
        "normal": rng.normal(0.0, 8.0, len(T)),
        "uniform": rng.uniform(-8.0, 8.0, len(T)),
        "sine": 8.0 * np.sin(rng.uniform(0.0, 2 * np.pi, len(T))),
    }
    line = replace(DIVE, fix_m=DIVE.fix_m + along_m[shape][:, None] * BESIDE_M / 50)

    assert not rival_fixes(line, CLEAN.position_m, DIVE.dr_yaw_rad, np.zeros(2), sd_scale=10.0)


@pytest.mark.parametrize("every", [4, 10])
def test_a_few_are_outliers(every: int) -> None:
    track = track_of(every_so_many(every, BESIDE_M))

    assert not any("RIVAL-FIXES" in text for text in track.warnings)
    assert track.open_cov_m2 is not None
    assert np.abs(track.open_cov_m2).max() < 1e-3  # of what the log leaves open of a latency and a lever arm


def test_outliers_that_do_not_lie_together_are_no_rivals() -> None:
    track = track_of(every_so_many(2, np.random.default_rng(1).normal(0.0, 60.0, (len(T), 2))))

    assert not any("RIVAL-FIXES" in text for text in track.warnings)
