"""The noise of fixes against noise that was put in, the scatter against runs without a fix."""

from dataclasses import replace

import numpy as np
import pytest

import usbldr
from usbldr.filters.evaluation.fix_statistics import fix_statistics
from usbldr.filters.evaluation.influence import without_fix
from usbldr.filters.identification.identification import Identification
from usbldr.filters.simulation.scenario import CorrelatedError
from usbldr.filters.simulation.simulate import correlated_error
from usbldr.filters.types import Trajectory
from usbldr.io.reports.run import Run, ScoredTrack
from usbldr.io.scenarios.shipped import find_scenario
from usbldr.io.scenarios.simulated_log import simulated_log

TIME_S = np.arange(0, 300.1, 0.2)
ALL = np.ones(150, dtype=bool)


def circling(smoothed=False, cov=None):
    """A vehicle that drives a circle of 60 m counter-clockwise at 1 m/s."""
    psi = TIME_S / 60
    place = 60 * np.column_stack([np.cos(psi), np.sin(psi)])
    mean = np.column_stack([psi, np.zeros(len(psi)), np.ones(len(psi)), place])
    return Trajectory("adf", ("psi", "u", "v", "x", "y"), TIME_S, mean, cov, smoothed=smoothed)


def dive(seed, range_sd_m=0.4, bearing_sd_deg=0.8, count=150, slow=(0.0, 0.0)):
    rng = np.random.default_rng(seed)
    time_s = np.sort(rng.choice(np.arange(0, 3000), count, replace=False)) / 10
    true = 60 * np.column_stack([np.cos(time_s / 60), np.sin(time_s / 60)])
    away = true - np.array([150.0, 20.0])
    lasting = [correlated_error(CorrelatedError(sd, 30.0), time_s, 1, rng)[:, 0] for sd in slow]
    reach, bearing = np.hypot(*away.T), np.arctan2(*away.T)
    reach = reach + rng.normal(0, range_sd_m, count) + lasting[0]
    bearing = bearing + np.radians(rng.normal(0, bearing_sd_deg, count) + lasting[1])
    measured = reach[:, None] * np.column_stack([np.sin(bearing), np.cos(bearing)])
    return time_s, measured + np.array([150.0, 20.0]), measured


@pytest.mark.parametrize("slow", [(0.6, 1.0), (0.0, 0.0)])
def test_white_and_slow_noise_are_what_was_put_in(slow):
    """50 dives with dead reckoning whose heading is wrong by 2 degrees, and whose speed by 2 %.

    Not each of the 200 numbers can be within 2.5 of its sigma: of normal errors 1.2 % are outside, so that all are
    within in 8 % of such trials. One of 200 is outside, with slow noise and without.
    """
    z, ratios, lasting = [], [], []
    for seed in range(50):
        time_s, place, away = dive(seed, slow=slow)
        track = circling()
        track.mean[:, 0] += np.radians(2.0)
        track.mean[:, 2] *= 1.02
        found = fix_statistics(time_s, place, away, np.ones(len(time_s), dtype=bool), track)
        parts = (found.range_m, found.bearing_deg)
        white = [part.white for part in parts]
        ratios += [part.sd / sd for part, sd in zip(white, (0.4, 0.8), strict=True)]
        lasting.append([part.slow.sd for part in parts])
        pairs = [*zip(white, (0.4, 0.8), strict=True), *zip([part.slow for part in parts], slow, strict=True)]
        z.append([(part.sd - sd) / part.sd_of_sd for part, sd in pairs])
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.05)
    z = np.array(z)
    assert 0.8 < np.sqrt(np.mean(z[:, :2] ** 2)) < 1.25
    assert np.sum(np.abs(z) > 2.5) <= 2
    assert np.abs(z).max() < 3.5
    assert (np.abs(z[:, 2:].mean(axis=0)) < (0.5 if any(slow) else 1.5)).all()  # a slow part cannot be below 0
    assert not any(slow) or np.mean(lasting, axis=0) / slow == pytest.approx(np.ones(2), abs=0.1)


def test_false_fixes_leave_the_noise_as_it_is_and_lower_the_share():
    time_s, place, away = dive(1)
    clean = fix_statistics(time_s, place, away, ALL, circling())
    place, good = place.copy(), np.arange(150) % 10 != 0
    place[~good] += 40.0
    found = fix_statistics(time_s, place, away, good, circling())
    assert found.good_share == pytest.approx(0.9)
    assert (found.fixes, found.outliers) == (150, 15)
    assert found.range_m.white.sd == pytest.approx(clean.range_m.white.sd, rel=0.2)
    assert sum(one.fixes for one in found.by_range) == 150
    assert found.longest_gap_s >= clean.longest_gap_s


def test_fixes_before_the_track_are_no_outliers():
    time_s, place, away = dive(1)
    after = time_s >= 100.0
    found = fix_statistics(time_s - 100.0, place, away, after, circling())
    assert (found.fixes, found.outliers, found.good_share) == (after.sum(), 0, 1.0)
    assert {one.good_share for one in found.by_range} == {1.0}


@pytest.mark.parametrize("method", ["adf", "ekf"])
def test_a_track_that_leaves_a_fix_out_is_that_of_a_run_without_it(method):
    log = simulated_log(replace(find_scenario("lawnmower"), duration_s=120.0), seed=3)
    line = usbldr.timeline(log)
    settings = usbldr.RunSettings(smooth=True, calibrate=("usbl-bias",))
    open_sd = {"dvl_lever_forward": 2.0}  # part of the track's sigma, but of none that a fix lessens
    found = Identification(replace(log.parameters, calibrate=("usbl-bias",), settled_sd=open_sd))
    track = usbldr.replay(log, line, method, settings, found)
    residual_m = Run(log, line, found, ScoredTrack(track, None)).fix_residuals_m
    for row in (20, 30):
        without = usbldr.replay(log, without_fix(line, row), method, settings, found)
        place = [np.interp(line.fix_time_s[row], without.time_s, axis) for axis in without.position_m.T]
        taken_back = residual_m[row] - (line.fix_m[row] - place)
        plain = [np.interp(line.fix_time_s[row], track.time_s, axis) for axis in track.position_m.T]
        assert np.hypot(*taken_back) < 0.1 * np.hypot(*(np.array(plain) - place))


def test_a_lever_arm_and_a_latency_are_no_noise_of_the_fixes():
    """The same noise with a transponder 4 m ahead, whose fixes are 2 s late: turns would show both."""
    plain = replace(find_scenario("lawnmower"), duration_s=400.0)
    timing = replace(plain.usbl.timing, latency_s=2.0)
    late = replace(plain, usbl=replace(plain.usbl, lever_m=(0.0, 4.0, 0.0), timing=timing))
    scatter = []
    for scenario in (plain, late):
        log = simulated_log(scenario, seed=3)
        line, settings = usbldr.timeline(log), usbldr.RunSettings(smooth=True, calibrate=("latency",))
        found = usbldr.resolve(log, line, "adf", settings)
        run = Run(log, line, found, ScoredTrack(usbldr.replay(log, line, "adf", settings, found), None))
        scatter.append(run.fix_statistics.scatter.drms_m)
    assert scatter[1] == pytest.approx(scatter[0], rel=0.05)


def test_the_scatter_is_that_of_the_residuals():
    time_s, place, away = dive(2)
    cov = np.zeros((len(TIME_S), 5, 5))
    cov_m2 = np.broadcast_to(np.eye(2), (150, 2, 2))
    scatter = fix_statistics(time_s, place, away, ALL, circling(True, cov), cov_m2).scatter
    true = 60 * np.column_stack([np.cos(time_s / 60), np.sin(time_s / 60)])
    off = np.hypot(*(place - true).T)
    assert scatter.drms_m == pytest.approx(np.sqrt(np.mean(off**2)), rel=0.01)
    assert scatter.drms_percent == pytest.approx(100 * np.sqrt(np.mean((off / np.hypot(*away.T)) ** 2)), rel=0.01)
    assert scatter.cep95_percent == pytest.approx(100 * np.quantile(off / np.hypot(*away.T), 0.95), rel=0.01)
    assert fix_statistics(time_s, place, None, ALL, circling()).scatter is None


def test_coarse_times_and_no_noise_show_in_the_noise_and_a_track_without_velocity_has_no_statistics():
    """Most steps between coarse times are zero; fixes of one moment do not show how noise changes with time."""
    time_s, place, away = dive(1)
    coarse_s = np.floor(time_s / 10) * 10
    assert fix_statistics(coarse_s, place, away, ALL, circling()).east_m.time_constant_s >= 10.0
    assert fix_statistics(coarse_s[:1].repeat(150), place, away, ALL, circling()).east_m is None
    plain = Trajectory("usbl", ("x", "y"), TIME_S, np.zeros((len(TIME_S), 2)), None)
    found = fix_statistics(time_s, np.zeros((150, 2)), np.full((150, 2), 50.0), ALL, circling())
    assert found.east_m.white.sd == pytest.approx(0.0, abs=1e-5)
    assert fix_statistics(time_s, place, away, ALL, plain) is None
