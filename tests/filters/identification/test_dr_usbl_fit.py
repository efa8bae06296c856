"""Dead reckoning held against fixes: what was put into the sensors has to come out."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest

from timelines import HZ, five_hz
from usbldr.filters.identification.dr_usbl_fit import (
    SEGMENT_S,
    fit_rotation,
    jackknife_rotation_sd_rad,
    residuals_m,
    segment_numbers,
    without_errors,
)
from usbldr.filters.identification.identification import ErrorEstimate, Identification, SensorErrorEvidence
from usbldr.filters.models.parameters import Parameters
from usbldr.filters.types import Array, Outage, Timeline, Vector
from weaving import SD_M, Faults, weaving_dive


def heading_rad(t: Vector) -> Vector:
    """Clockwise from north: a slow circle with swings, so that everything is observable."""
    return 0.01 * t + 0.8 * np.sin(t / 25.0)


def speed_mps(t: Vector, swell: float) -> Vector:
    return 1 + swell * np.sin(t / 9.0)


def truth_m(t: Vector, swell: float) -> Array:
    """East and north along the heading, by a sum a hundred times finer than the filter's grid."""
    fine = np.arange(-20.0, t.max() + 20.0, 0.002)
    v = np.column_stack([np.sin(heading_rad(fine)), np.cos(heading_rad(fine))])
    track = np.cumsum(v * speed_mps(fine, swell)[:, None], axis=0) * 0.002
    return np.column_stack([np.interp(t, fine, track[:, axis]) for axis in (0, 1)])


def dive(
    *,
    mount_deg: float = 0.0,
    scale: float = 0.0,
    latency_s: float = 0.0,
    fix_sd_m: float = 0.3,
    swell: float = 0.0,
    length_s: float = 900.0,
    outages: tuple[Outage, ...] = (),
) -> Timeline:
    """A vehicle that only surges; its DVL is turned clockwise by mount_deg and reads too much by scale."""
    rng = np.random.default_rng(4)
    t = np.arange(round(length_s * HZ)) / HZ
    mount = np.radians(mount_deg)
    bow = np.array([-np.sin(mount), np.cos(mount)])  # starboard and forward of the DVL
    dvl = (1 + scale) * speed_mps(t, swell)[:, None] * bow
    fix_t = np.arange(3.0, length_s - 3.0)
    fixes = truth_m(fix_t - latency_s, swell) + rng.normal(0, fix_sd_m, (len(fix_t), 2)) + [40.0, -7.0]
    yaw = -heading_rad(t)
    return five_hz(dvl, yaw, fix_t, fixes, yaw_sd_rad=0.005, fix_sd_m=fix_sd_m, outages=outages)


def test_segments_are_numbered_by_cut_and_then_by_length() -> None:
    line = dive(outages=(Outage("dvl", 100.0, 110.0), Outage("usbl", 0.0, 400.0)))
    time_s = np.array([-3.0, 5.0, 59.0, 99.0, 105.0, 115.0, 119.0, 121.0])

    assert segment_numbers(line, time_s).tolist() == [0, 0, 0, 0, -1, 1, 1, 1]
    assert segment_numbers(line, time_s, 60.0).tolist() == [0, 1, 1, 2, -1, 3, 3, 4]
    assert segment_numbers(line, time_s[:0]).tolist() == []


def test_the_turn_is_the_angle_by_which_the_dvl_sits_askew() -> None:
    line = dive(mount_deg=30.0)
    group = segment_numbers(line, line.fix_time_s)

    turn = fit_rotation(line, group)
    sd_deg = np.degrees(jackknife_rotation_sd_rad(line, group, turn.latency_s))

    assert np.degrees(-turn.rotation_rad) == pytest.approx(30.0, abs=0.3)
    assert 0 < sd_deg < 0.3
    assert turn.latency_s == 0.0
    assert turn.rms_m == pytest.approx(0.3 * np.sqrt(2), rel=0.15)


def test_a_tenth_of_gross_fixes_does_not_move_the_turn() -> None:
    line = dive(mount_deg=-75.0)
    line.fix_m[::10] += np.array([300.0, -200.0])

    turn = fit_rotation(line, segment_numbers(line, line.fix_time_s))

    assert np.degrees(-turn.rotation_rad) == pytest.approx(-75.0, abs=1.0)


def test_the_scale_is_that_of_the_dvl_whatever_its_mount() -> None:
    line = dive(mount_deg=30.0, scale=0.2)

    turn = fit_rotation(line, segment_numbers(line, line.fix_time_s, SEGMENT_S))

    assert turn.scale == pytest.approx(1.2, abs=0.01)


ERRORS = {
    "dvl_scale": 0.02, "heading_bias_deg": 4.0, "deviation_sin_deg": 3.0, "deviation_cos_deg": -2.0,
    "usbl_latency_s": 1.4,
}  # fmt: skip


def test_dead_reckoning_freed_of_its_errors_leaves_the_noise_of_the_fixes() -> None:
    line = weaving_dive(Faults(**ERRORS))
    found = identified(ERRORS)

    freed = residuals_m(without_errors(line, found))
    raw = residuals_m(line)

    assert np.sqrt(np.mean(freed**2) / 2) == pytest.approx(SD_M, rel=0.1)
    assert np.mean(raw**2) > 4 * np.mean(freed**2)


@pytest.mark.parametrize("name", sorted(ERRORS.keys() - {"heading_bias_deg"}))
def test_each_error_counts_in_what_is_left(name: str) -> None:
    line = weaving_dive(Faults(**ERRORS))

    left = residuals_m(without_errors(line, identified(ERRORS | {name: 5 * ERRORS[name]})))

    assert np.sqrt(np.mean(left**2) / 2) > 1.2 * SD_M


def test_lever_arm_and_clock_of_the_dvl_are_taken_off_too() -> None:
    """The DVL is 3 m ahead of the transponder and stamped 1 s late."""
    line, t = dive(fix_sd_m=0.02, swell=0.7), np.arange(3.0, 897.0)
    heading = np.interp(t, line.time_s, -line.dr_yaw_rad)
    behind = line.fix_m - 3.0 * np.column_stack([np.sin(heading), np.cos(heading)])
    late = np.interp(line.time_s - 1.0, line.time_s, line.dr_mps[:, 1])
    seen = replace(line, fix_m=behind, dr_mps=np.column_stack([line.dr_mps[:, 0], late]))
    found = identified({"dvl_clock_s": 1.0})
    found = replace(found, parameters=replace(found.parameters, dvl_lever_m=(0.0, 3.0, 0.0)))

    assert np.sqrt(np.mean(residuals_m(without_errors(seen, found)) ** 2)) < 0.1
    assert np.sqrt(np.mean(residuals_m(seen) ** 2)) > 0.5


def identified(errors: Mapping[str, float]) -> Identification:
    estimates = tuple(ErrorEstimate(name, value, 0.1) for name, value in errors.items())
    return Identification(Parameters(), (SensorErrorEvidence("all", 9.0, True, estimates),))


def test_gross_fixes_stand_out_one_by_one() -> None:
    line = dive()
    gross = np.array([7, 100, 101, 640])
    line.fix_m[gross] += np.array([9.0, -4.0])

    left = residuals_m(line)

    assert np.flatnonzero(left > 4.0).tolist() == gross.tolist()
    assert left[gross] == pytest.approx(np.hypot(9, 4), abs=1.5)


def test_a_third_of_the_fixes_on_one_side_hardly_moves_the_others() -> None:
    line = dive()
    false = np.arange(len(line.fix_m)) % 3 == 0
    others = np.median(residuals_m(line)[~false])
    line.fix_m[false] += np.array([15.0, -8.0])

    left = residuals_m(line)

    assert np.median(left[~false]) == pytest.approx(others, rel=0.3)
    assert np.all(left[false] > 12.0)


def test_fixes_during_an_outage_have_no_residual() -> None:
    line = dive(outages=(Outage("dvl", 0.0, 900.0),))

    assert np.isnan(residuals_m(line)).all()


def test_an_outage_of_the_dvl_cuts_the_log_and_its_fixes_do_not_count() -> None:
    line = dive(outages=(Outage("dvl", 100.0, 130.0), Outage("usbl", 500.0, 530.0)))

    group = segment_numbers(line, line.fix_time_s)

    t = line.fix_time_s
    assert set(group[t <= 100.0]) == {0}
    assert set(group[(t > 100.0) & (t < 130.0)]) == {-1}
    assert set(group[t >= 130.0]) == {1}
    assert len(fit_rotation(line, group).shift_m) == 2


def test_fixes_without_dead_reckoning_show_no_turn_and_a_vehicle_at_rest_no_scale() -> None:
    line = dive()
    still = replace(line, dr_mps=np.zeros_like(line.dr_mps))

    assert np.isnan(fit_rotation(still, segment_numbers(still, still.fix_time_s)).scale)
    turn = fit_rotation(line, np.full(len(line.fix_time_s), -1))

    assert (turn.rotation_rad, turn.rms_m) == (0.0, 0.0)
    assert np.isnan([turn.scale, *turn.residual_m]).all()
