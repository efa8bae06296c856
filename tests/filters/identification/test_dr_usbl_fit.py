"""Dead reckoning held against fixes: what was put into the sensors has to come out."""

import numpy as np
import pytest

from timelines import HZ, five_hz
from usbldr.filters.identification.dr_usbl_fit import (
    SEGMENT_S,
    fit_rotation,
    fit_sensor_errors,
    jackknife_rotation_sd_rad,
    segment_numbers,
)
from usbldr.filters.types import Array, Outage, Timeline, Vector


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
    heading_delay_s: float = 0.0,
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
    yaw = -heading_rad(t - heading_delay_s)
    return five_hz(dvl, yaw, fix_t, fixes, yaw_sd_rad=0.005, fix_sd_m=fix_sd_m, outages=outages)


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


def test_calibration_finds_turn_scale_and_latency_within_their_sigmas() -> None:
    found = fit_sensor_errors(dive(mount_deg=3.0, scale=0.02, latency_s=1.4))

    assert found is not None
    for name, value, sd in (
        ("rotation_rad", -np.radians(3.0), found.rotation_sd_rad),
        ("scale", 0.02, found.scale_sd),
        ("latency_s", 1.4, found.latency_sd_s),
    ):
        assert abs(getattr(found, name) - value) < 4 * sd, name
    assert found.scale_sd < 0.01
    assert found.latency_sd_s < 0.2
    assert found.sd_m == pytest.approx(0.3, rel=0.15)


def test_the_sigmas_of_a_log_of_five_stretches_are_its_jackknife_over_these() -> None:
    line = dive(length_s=600.0)
    stretch = segment_numbers(line, line.fix_time_s, SEGMENT_S)

    found = fit_sensor_errors(line)
    without_one = [fit_sensor_errors(line.with_fixes(stretch != k)) for k in range(5)]

    assert found is not None
    for name, sd in (
        ("rotation_rad", found.rotation_sd_rad),
        ("scale", found.scale_sd),
        ("latency_s", found.latency_sd_s),
    ):
        off = [getattr(one, name) - getattr(found, name) for one in without_one]
        assert sd == pytest.approx(np.sqrt(4 * np.mean(np.square(off))), rel=0.01), name


@pytest.mark.parametrize("delay_s", [-0.8, 0.8])
def test_calibration_finds_a_heading_that_is_stamped_late_or_early(delay_s: float) -> None:
    found = fit_sensor_errors(dive(heading_delay_s=delay_s, fix_sd_m=0.02, swell=0.7))

    assert found is not None
    assert found.heading_delay_s == pytest.approx(delay_s, abs=max(0.1, 4 * found.heading_delay_sd_s))
    assert found.sd_m < 0.5 * found.sd_without_delay_m
    assert not len(found.outlier_rows)


def test_at_constant_speed_a_late_heading_is_not_told_from_a_late_fix() -> None:
    found = fit_sensor_errors(dive(heading_delay_s=0.8))

    assert found is not None
    assert np.isnan(found.heading_delay_sd_s)
    assert found.latency_s == pytest.approx(-0.8, abs=4 * found.latency_sd_s)


def test_gross_fixes_are_found_one_by_one() -> None:
    line = dive()
    gross = np.array([7, 100, 101, 640])
    line.fix_m[gross] += np.array([9.0, -4.0])

    found = fit_sensor_errors(line)

    assert found is not None
    assert found.outlier_rows.tolist() == gross.tolist()
    assert np.nanmax(found.residual_m) == pytest.approx(np.hypot(9, 4), abs=1.5)


def test_a_short_log_claims_nothing() -> None:
    assert fit_sensor_errors(dive(length_s=100.0)) is None


def test_an_outage_of_the_dvl_cuts_the_log_and_its_fixes_do_not_count() -> None:
    line = dive(outages=(Outage("dvl", 100.0, 130.0), Outage("usbl", 500.0, 530.0)))

    group = segment_numbers(line, line.fix_time_s)

    t = line.fix_time_s
    assert set(group[t <= 100.0]) == {0}
    assert set(group[(t > 100.0) & (t < 130.0)]) == {-1}
    assert set(group[t >= 130.0]) == {1}
    assert len(fit_rotation(line, group).shift_m) == 2
