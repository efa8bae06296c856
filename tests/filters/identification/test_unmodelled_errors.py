"""A compass that drifts or errs twice per turn, a DVL with a bias: found, and other errors are not taken for one."""

from dataclasses import replace

import numpy as np
import pytest

from textbook import log_density
from usbldr.filters.identification.blocks import blocks_about, blocks_of
from usbldr.filters.identification.evidence import identify
from usbldr.filters.identification.linearisation import NO_ERROR, PASS_STATES
from usbldr.filters.identification.unmodelled_errors import Shape, _fitted, _moved, unmodelled_errors
from usbldr.filters.models.parameters import SensorChange
from usbldr.filters.replay.dead_reckoning import displacement_m, without_changes
from usbldr.filters.replay.run import run
from usbldr.filters.types import Timeline, Vector
from usbldr.filters.windows import columns_at
from weaving import ASSUMED, DIVE, Faults, apart_m, headings_off, weaving_dive

SHARE = DIVE.time_s / DIVE.time_s[-1]
TWICE = np.radians(4.0) * np.sin(2 * DIVE.dr_yaw_rad)
OVER_TIME = {
    "even": np.radians(-8.0) * SHARE,
    "settling": np.radians(8.0) * np.exp(-5 * SHARE),
    "there and back": np.radians(5.0) * np.sin(5 * SHARE),
}


def stop_and_go() -> Timeline:
    """The dive at 0 to 1.2 m/s: at a constant speed a bias is a scale and a mount."""
    share = np.cos(DIVE.time_s / 30)[:, None] ** 2
    slow = replace(DIVE, dvl_mps=DIVE.dvl_mps * share, dr_mps=DIVE.dr_mps * share)
    moved_m = columns_at(DIVE.fix_time_s, DIVE.time_s, displacement_m(slow) - displacement_m(DIVE))
    return replace(slow, fix_m=DIVE.fix_m + moved_m)


def found(line: Timeline) -> tuple[SensorChange, ...]:
    usual, blocks = blocks_of(line, ASSUMED)
    return unmodelled_errors(usual, ASSUMED, blocks).changes


@pytest.mark.parametrize(
    "by_rad", [*OVER_TIME.values(), TWICE, OVER_TIME["even"] + TWICE], ids=[*OVER_TIME, "2H", "both"]
)
def test_a_track_is_nearly_as_good_as_with_a_right_compass(by_rad: Vector) -> None:
    identified = identify(headings_off(by_rad), ASSUMED).parameters

    clean, freed = run("adf", DIVE, ASSUMED), run("adf", headings_off(by_rad), identified)

    assert identified.changes
    assert apart_m(freed, clean).mean() < 0.2 < 0.5 * apart_m(run("adf", headings_off(by_rad), ASSUMED), clean).mean()


@pytest.mark.parametrize("name", OVER_TIME)
def test_the_drift_is_that_of_the_compass(name: str) -> None:
    changes = found(headings_off(OVER_TIME[name]))

    turned = np.interp(DIVE.time_s, [one.start_s for one in changes], [one.heading_bias_rad for one in changes])
    off_deg = np.degrees(turned - OVER_TIME[name])
    assert off_deg.std() < 1.0  # a constant part is another error
    assert all(one.gradual and one.twice_per_turn_rad == (0.0, 0.0) for one in changes)


def test_a_deviation_twice_per_turn_is_that_of_the_compass() -> None:
    changes = found(headings_off(TWICE))

    assert np.degrees(changes[0].twice_per_turn_rad) == pytest.approx([4.0, 0.0], abs=0.5)
    assert not any(one.heading_bias_rad for one in changes)


def test_a_bias_of_the_dvl_is_found_and_taken_off() -> None:
    added, dive = np.array([0.02, -0.04]), stop_and_go()
    biased = replace(dive, dvl_mps=dive.dvl_mps + added, dr_mps=dive.dr_mps + added)

    identified = identify(biased, ASSUMED)

    assert identified.parameters.changes[0].dvl_bias_mps == pytest.approx(added, abs=0.01)
    assert "the DVL reads -0.0" in next(iter(identified.change_texts.values()))
    freed, clean = run("adf", biased, identified.parameters), run("adf", dive, ASSUMED)
    assert apart_m(freed, clean).mean() < 0.2 < 0.5 * apart_m(run("adf", biased, ASSUMED), clean).mean()


@pytest.mark.parametrize("late_s", [2.0, -2.0])
def test_a_clock_of_the_fixes_that_drifts_is_found_and_taken_off(late_s: float) -> None:
    share = DIVE.fix_time_s / DIVE.fix_time_s[-1]
    drifting = replace(DIVE, fix_time_s=DIVE.fix_time_s + late_s * share)

    identified = identify(drifting, ASSUMED)

    changes = identified.parameters.changes
    apart_s = [one.fix_late_s - late_s * one.start_s / DIVE.fix_time_s[-1] for one in changes]
    assert np.std(apart_s) < 0.1  # a constant part is the latency
    assert f" s {'later' if late_s > 0 else 'earlier'} than at" in " ".join(identified.change_texts.values())
    freed, clean = run("adf", drifting, identified.parameters), run("adf", DIVE, ASSUMED)
    assert apart_m(freed, clean).mean() < 0.2 < 0.5 * apart_m(run("adf", drifting, ASSUMED), clean).mean()


@pytest.mark.parametrize(
    "line",
    [
        DIVE,
        DIVE.with_fixes(np.arange(20)),
        weaving_dive(Faults(heading_bias_deg=20.0)),
        weaving_dive(Faults(deviation_sin_deg=4.0, deviation_cos_deg=-2.0)),
        weaving_dive(Faults(usbl_latency_s=2.0)),
        weaving_dive(Faults(dvl_scale=0.05)),
        weaving_dive(Faults(), wander_m=0.5),
        stop_and_go(),
    ],
    ids=["none", "few fixes", "bias", "deviation", "latency", "scale", "fixes wander", "stop and go"],
)
def test_other_errors_are_no_drift(line: Timeline) -> None:
    assert found(line) == ()


def test_the_evidence_is_the_density_of_a_drift_a_deviation_a_bias_and_a_clock() -> None:
    """The covariance is written out from the motion of each block by an error that grows as min(t, t')."""
    blocks = blocks_about(headings_off(OVER_TIME["even"]), ASSUMED, NO_ERROR, 1.0)
    moved = _moved(DIVE, blocks)
    t = blocks.time_s[blocks.first]

    one, none = (_fitted(DIVE, ASSUMED, moved, Shape(on, 3.0 * on, on, on, on)) for on in (True, False))

    q = (3.0 * ASSUMED.errors.heading_walk_rad) ** 2
    trend = moved.by_step @ np.diff(t) / (t[-1] - t[0]) * np.radians(5.0)
    walked = moved.by_step @ np.diag(q * np.diff(t)) @ moved.by_step.T
    twice = moved.twice_per_turn @ moved.twice_per_turn.T * ASSUMED.errors.deviation_rad**2
    columns = blocks.measurement_matrix[:, :, PASS_STATES.index("usbl_latency")]
    late = columns * ((DIVE.fix_time_s - DIVE.fix_time_s[0]) / np.ptp(DIVE.fix_time_s))[:, None]
    clock = np.concatenate([late[first : first + int(blocks.first[1])].mean(axis=0) for first in blocks.first])
    cov = blocks.cov_m2 + walked + np.outer(trend, trend) + twice + moved.dvl_bias @ moved.dvl_bias.T * 0.03**2
    cov += np.outer(clock, clock)
    expected = log_density(blocks.residual_m, cov) - log_density(blocks.residual_m, blocks.cov_m2)
    assert one.evidence - none.evidence == pytest.approx(expected, rel=1e-6)


def test_gradual_changes_turn_headings_evenly_from_one_to_the_next() -> None:
    knots = ((0.0, 0.0), (100.0, 0.2), (300.0, -0.1))
    changes = [SensorChange(t, turned, 0.0, twice_per_turn_rad=(0.0, 0.05), gradual=True) for t, turned in knots]

    taken = DIVE.dr_yaw_rad - without_changes(DIVE, changes).dr_yaw_rad

    expected = np.interp(DIVE.time_s, *np.transpose(knots)) + 0.05 * np.cos(2 * DIVE.dr_yaw_rad)
    np.testing.assert_allclose(taken, expected, atol=1e-12)


def test_a_drift_is_said_in_clockwise_degrees() -> None:
    identified = identify(headings_off(OVER_TIME["even"] + TWICE), ASSUMED)

    ((_, text),) = identified.change_texts.items()
    assert text.startswith("headings drift: compared with the first ones they read +")
    assert "sin 2H" in text
