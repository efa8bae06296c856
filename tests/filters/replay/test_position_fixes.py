"""GPS as an aid: inside the stated windows a measurement, outside them the truth that no filter sees."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from logs import refusal
from timelines import five_hz
from usbldr.filters.errors import LogError
from usbldr.filters.evaluation.error_report import ErrorReport
from usbldr.filters.evaluation.evaluation import evaluate
from usbldr.filters.models.calibration import layout_for
from usbldr.filters.models.noise import Gaussian
from usbldr.filters.models.parameters import Parameters, Start
from usbldr.filters.models.states import StateLayout
from usbldr.filters.replay.methods import METHODS, FilterSettings
from usbldr.filters.replay.position_fixes import DEFAULT_GPS_SD_M, gps_fixes, require_gps
from usbldr.filters.replay.run import run
from usbldr.filters.replay.steps import steps
from usbldr.filters.types import Array, Mask, Timeline, Trajectory, Truth

WINDOWS = ((3.0, 5.0), (20.0, 22.0))
AIDED = Parameters(aid=WINDOWS, start=Start(0.0, 0.0, 3.0, sd_yaw_rad=0.01, sd_mps=0.02, sd_radps=0.01))
GPS_S = np.arange(0.0, 30.5, 0.5)
ON_WAY_M = np.stack([0 * GPS_S, GPS_S], axis=1)


def timeline(gps_m: Array | None = None, sd_m: float = 0.5) -> Timeline:
    """A vehicle going north at 1 m/s for half a minute, a fix of 2 m every 5 s, GPS twice a second."""
    fix_s = np.arange(0.0, 30.0, 5.0)
    fix_m, gps_m = np.stack([0 * fix_s + 1.5, fix_s], axis=1), ON_WAY_M if gps_m is None else gps_m
    gps: dict[str, Any] = {"gps_time_s": GPS_S, "gps_m": gps_m, "gps_sd_m": np.full(len(GPS_S), sd_m)}
    return five_hz(np.tile([0.0, 1.0], (151, 1)), np.zeros(151), fix_s, fix_m, fix_sd_m=2.0, **gps)


def evaluated(east_m: Array, *, seen: Mask | None = None, **how: Any) -> ErrorReport:
    """Hold a track that goes north at 1 m/s, off to the east, against a truth of some of its epochs."""
    t = np.arange(float(len(east_m)))
    rows = np.ones(len(t), dtype=bool) if seen is None else seen
    truth = Truth(t[rows], np.column_stack([0 * t, t])[rows], np.full(rows.sum(), np.nan), "gps", "/gps")
    return evaluate(Trajectory("ekf", ("x", "y"), t, np.column_stack([east_m, t]), None), truth, **how)


@pytest.mark.parametrize("name", [name for name, method in METHODS.items() if method.is_filter])
def test_gps_outside_the_windows_changes_no_bit_and_inside_it_changes_the_track(name: str) -> None:
    line, settings = timeline(), FilterSettings(particles=200)
    outside, within = line.gps_m.copy(), line.gps_m.copy()
    outside[~np.any([(a <= GPS_S) & (b >= GPS_S) for a, b in WINDOWS], axis=0)] += 1000.0
    within[7] += 1.0  # 3.5 s

    as_it_is, moved_outside, moved_within = (
        run(name, timeline(gps), AIDED, settings) for gps in (None, outside, within)
    )

    np.testing.assert_array_equal(moved_outside.mean, as_it_is.mean)
    np.testing.assert_array_equal(moved_outside.cov, as_it_is.cov)
    assert np.any(moved_within.mean[18:] != as_it_is.mean[18:])
    np.testing.assert_array_equal(moved_within.mean[:17], as_it_is.mean[:17])


def test_a_gps_fix_pulls_the_track_to_itself_and_its_sigma_says_so() -> None:
    aided = run("ekf", timeline(), replace(AIDED, gps=Gaussian()), FilterSettings())
    alone = run("ekf", timeline(), replace(AIDED, aid=()), FilterSettings())

    k = 5 * 5  # after the first window, 5 fixes of 0.5 m
    assert abs(aided.position_m[k, 0]) < 0.5 < abs(alone.position_m[k, 0])
    assert np.sqrt(aided.position_cov_m2[k, 0, 0]) == pytest.approx(0.5 / np.sqrt(5), rel=0.1)


def test_each_gps_fix_is_one_robust_measurement_with_its_own_sigma_and_none_without_windows() -> None:
    used, none = (
        [m for step in steps(timeline(), assumed, StateLayout()) for m in step.measurements if m.sensor == "gps"]
        for assumed in (AIDED, Parameters())
    )

    assert none == []
    assert [m.row for m in used] == [6, 7, 8, 9, 10, 40, 41, 42, 43, 44]
    assert {len(m.noise.probabilities) for m in used} == {2}  # nominal and gross errors
    assert {float(m.noise.cov[0, 0, 0]) for m in used} == {0.25}


def test_a_fix_without_a_sigma_has_the_usual_one() -> None:
    for sd_m in (np.nan, 0.0):
        fixes = gps_fixes(timeline(sd_m=sd_m), replace(AIDED, gps=Gaussian()))

        np.testing.assert_array_equal(fixes.cov_m2[0], DEFAULT_GPS_SD_M**2 * np.eye(2))


def test_a_gross_gps_error_hardly_moves_a_filter_that_weighs_outliers() -> None:
    line = timeline()
    wrong = line.gps_m.copy()
    wrong[8] += 50.0

    track = run("adf", timeline(wrong), AIDED, FilterSettings())

    assert np.abs(track.position_m[5 * 5] - [0.0, 5.0]).max() < 1.0


def test_the_antennas_place_is_taken_off() -> None:
    """Bow north, antenna 2 m ahead and 1 m to starboard: its fixes lie 2 m north and 1 m east of the vehicle."""
    line = timeline()
    at_antenna = line.gps_m + np.array([1.0, 2.0])

    plain = run("ekf", line, AIDED, FilterSettings())
    levered = run("ekf", timeline(at_antenna), replace(AIDED, gps_lever_m=(1.0, 2.0, 0.5)), FilterSettings())

    np.testing.assert_allclose(levered.position_m[-1], plain.position_m[-1], atol=0.02)


def test_errors_of_the_usbl_are_not_laid_to_gps() -> None:
    """With a correlated USBL error as states the fixes may be 1.5 m off in the east, GPS may not."""
    parameters = replace(AIDED, calibrate=("usbl-bias",), aid=((0.0, 30.0),))
    layout = layout_for(parameters.calibrate)
    track = run("ekf", timeline(), parameters, FilterSettings())

    bias = track.state(next(name for name in layout.names if name.startswith("usbl_bias_e")))

    assert abs(track.position_m[-1, 0]) < 0.3
    assert bias[-1] > 0


def test_nothing_is_scored_inside_the_windows() -> None:
    t = np.arange(0.0, 31.0)
    inside = ((t >= 3) & (t <= 5)) | ((t >= 20) & (t <= 22))

    report = evaluated(np.where(inside, 100.0, (-1.0) ** t), aid=WINDOWS)

    assert report.east.max_abs_m == pytest.approx(1.0)
    assert report.time_s.tolist() == t[~inside].tolist()
    assert (report.matching.matched, report.matching.aided, report.matching.candidates) == (25, 6, 31)
    assert report.aid == WINDOWS
    assert report.warnings == ()  # what the user chose is no shortcoming


def test_alignment_takes_nothing_from_inside_the_windows() -> None:
    report = evaluated(np.where(np.arange(31) <= 5, 7.0, 1.0), align="first", aid=((0.0, 5.0),))

    assert report.alignment.shift_m == pytest.approx((-1.0, 0.0))


def test_a_surfacing_that_aids_the_filter_is_no_test_of_it() -> None:
    t = np.arange(0.0, 200.0)
    seen = (t <= 10) | ((t >= 60) & (t <= 70)) | (t >= 150)

    alone, aided = (evaluated(0 * t + 2.0, seen=seen, aid=aid) for aid in ((), ((55.0, 75.0),)))

    assert [s.time_s for s in alone.surfacings] == [60.0, 150.0]
    assert [s.time_s for s in aided.surfacings] == [150.0]


def test_a_window_without_gps_is_refused_with_what_there_is_and_one_over_all_of_the_truth_leaves_nothing() -> None:
    assert refusal(LogError, require_gps, timeline(), ((3.0, 5.0), (40.0, 60.0)), "dive.mcap") == (
        "dive.mcap: no GPS fix to aid a filter from 40 to 60 s of the log (it has GPS fixes from 0.0 to 30.0 s)"
    )
    with pytest.raises(LogError, match=r"all of its epochs .* lie in the windows that GPS aids"):
        evaluated(np.zeros(31), aid=((0.0, 30.0),))
