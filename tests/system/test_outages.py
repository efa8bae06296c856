"""What a filter claims while a sensor is silent: dives round a square by the generic defaults, over several seeds.

The generic process noise is wider than the motion of these dives, so the mean NEES may lie below 2 but not above what
chance allows. Errors inside a window are alike, so each seed counts once there: N seeds are 2 N degrees of freedom.
"""

from dataclasses import replace
from functools import cache
from typing import NamedTuple

import numpy as np
import pytest

from uncalibrated import dive_without_calibration
from usbldr.filters.estimators.gaussian_bank import predict, replicate
from usbldr.filters.evaluation.consistency import nees
from usbldr.filters.models.calibration import layout_for
from usbldr.filters.models.motion import VehicleMotion
from usbldr.filters.models.noise import Contamination, chi_square_quantile
from usbldr.filters.models.parameters import Parameters, ProcessNoise
from usbldr.filters.models.sigma_points import cubature
from usbldr.filters.models.states import StateLayout
from usbldr.filters.replay.methods import FilterSettings
from usbldr.filters.replay.outage_recovery import outage_recoveries
from usbldr.filters.replay.run import run
from usbldr.filters.simulation.scenario import Scenario, Timing
from usbldr.filters.types import Outage, Timeline, Trajectory
from usbldr.io.reading.epochs import timeline
from usbldr.io.scenarios.shipped import find_scenario

SQUARE = find_scenario("square")
HZ = 5
AFTER_S = 40.0
SHORT = [("dvl", 90.0, 60.0), ("dvl", 0.0, 60.0), ("usbl", 0.0, 60.0)]
LONG = [
    pytest.param("dvl", 90.0, 200.0, marks=pytest.mark.slow),
    pytest.param("usbl", 90.0, 300.0, marks=pytest.mark.slow),
]
POSITION = np.ix_(StateLayout().rows("x", "y"), StateLayout().rows("x", "y"))


class Dive(NamedTuple):
    line: Timeline
    assumed: Parameters
    track: Trajectory
    error_m: np.ndarray  # (K, 2)

    @property
    def nees(self) -> np.ndarray:
        assert self.track.position_cov_m2 is not None
        return nees(self.error_m, self.track.position_cov_m2)

    @property
    def sd_m(self) -> np.ndarray:
        """1-sigma of the position, both axes together, (K,)."""
        return np.sqrt(self.track.position_cov_m2.trace(axis1=1, axis2=2))


def scenario(sensors: tuple[str, ...], start_s: float, lasts_s: float, every_s: float = 1.0) -> Scenario:
    """The square with the generic assumptions of a filter, and sensors that fall silent in it."""
    usbl = replace(SQUARE.usbl, assumed_noise=Contamination(), rate_hz=1 / every_s)
    square = replace(SQUARE, duration_s=start_s + lasts_s + AFTER_S, process=ProcessNoise(), usbl=usbl)
    silent = Timing(silences_s=((start_s, start_s + lasts_s),))
    return replace(square, **{sensor: replace(getattr(square, sensor), timing=silent) for sensor in sensors})


@cache
def dives(scene: Scenario, method: str, seeds: int) -> tuple[Dive, ...]:
    found: list[Dive] = []
    for seed in range(seeds):
        log = dive_without_calibration(scene, seed)
        line = timeline(log)
        track = run(method, line, log.parameters, FilterSettings(particles=20))
        truth = np.column_stack([np.interp(line.time_s, log.truth.time_s, axis) for axis in log.truth.position_m.T])
        found.append(Dive(line, log.parameters, track, track.position_m - truth))
    return tuple(found)


def mean_nees(found: tuple[Dive, ...], from_s: float, to_s: float) -> float:
    return float(np.mean([dive.nees[round(from_s * HZ) : round(to_s * HZ)].mean() for dive in found]))


def at_most(seeds: int) -> float:
    """What the mean NEES of so many seeds exceeds once in 1000 times where the covariance is right."""
    return chi_square_quantile(0.999, 2 * seeds) / seeds


@pytest.mark.parametrize(("sensor", "start_s", "lasts_s"), [*SHORT, *LONG])
def test_no_filter_claims_more_than_it_knows_while_a_sensor_is_silent_and_after(sensor, start_s, lasts_s):
    for method, seeds in (("adf", 12), ("ekf", 4), ("cpf", 4)):
        found = dives(scenario((sensor,), start_s, lasts_s), method, seeds)
        end_s = start_s + lasts_s

        for from_s, to_s in (
            (start_s, start_s + lasts_s / 2),
            (start_s + lasts_s / 2, end_s),
            (end_s, end_s + AFTER_S),
        ):
            assert mean_nees(found, from_s, to_s) < at_most(seeds), (method, from_s, to_s)


@pytest.mark.parametrize("start_s", [0.0, 90.0])
def test_without_a_compass_no_filter_claims_twice_what_it_knows(start_s: float) -> None:
    """A yaw that only the fixes tell bends the density of the position, which no Gaussian says: hence the factor."""
    for method, seeds in (("adf", 12), ("cpf", 4), ("ekf", 4)):
        found = dives(scenario(("compass",), start_s, 60.0), method, seeds)

        assert mean_nees(found, start_s, start_s + 60) < 4 * 2, method
        assert mean_nees(found, start_s + 60 + 10, start_s + 60 + AFTER_S) < at_most(seeds), method


@pytest.mark.parametrize("start_s", [90.0, 150.0, 300.0, 400.0])
def test_without_compass_and_fixes_the_sigma_covers_the_error_and_not_more_than_the_way(start_s: float) -> None:
    """Legs straight on and turns begin before, in and after the minute."""
    for dive in dives(scenario(("compass", "usbl"), start_s, 60.0), "adf", 4):
        silent = slice(round((start_s + 5) * HZ), round((start_s + 60) * HZ))
        travelled_m = 1.2 * (dive.line.time_s[silent] - start_s)
        error_m = np.hypot(*dive.error_m[silent].T)

        assert np.all(error_m < 1.5 * dive.sd_m[silent])
        assert np.all(dive.sd_m[silent] < 2 * travelled_m)
        assert np.all((dive.sd_m[silent] > 0.2 * travelled_m)[5 * HZ :])


@pytest.mark.parametrize("method", ["adf", "ekf", "cpf"])
def test_without_fixes_the_sigma_grows_at_every_epoch(method: str) -> None:
    for dive in dives(scenario(("usbl",), 90.0, 60.0), method, 4):
        silent = dive.sd_m[90 * HZ : 150 * HZ]

        assert np.all(np.diff(silent) > 0)
        assert silent[-1] > silent[0] + 0.05


@pytest.mark.parametrize("sensor", ["dvl", "compass"])
def test_without_dvl_or_compass_the_sigma_grows_between_two_fixes_and_on_the_whole(sensor: str) -> None:
    for dive in dives(scenario((sensor,), 90.0, 60.0), "adf", 4):
        silent = slice(90 * HZ + 1, 150 * HZ)
        fixed = np.isin(np.round(dive.line.time_s, 6), np.round(dive.line.fix_time_s, 6))

        grown = np.diff(dive.sd_m)[silent.start - 1 : silent.stop - 1]
        assert np.all(grown[~fixed[silent]] > 0)
        assert dive.sd_m[silent].max() > 2 * dive.sd_m[90 * HZ - 1]


@pytest.mark.parametrize(
    ("sensors", "lasts_s"), [(("dvl",), 60.0), (("compass",), 60.0), (("usbl",), 60.0), (("dvl", "usbl"), 20.0)]
)
def test_no_fix_moves_the_track_further_than_its_own_covariances_explain(sensors, lasts_s):
    """A jump has the covariance that the fix took away; 11 in 1000 of a right filter's lie beyond 3 sigma.

    The odd fix that may be an outlier moves the track and takes nearly nothing away, so only its prior bounds it.
    """
    by_taken, by_prior = [], []
    for dive in dives(scenario(sensors, 90.0, lasts_s), "adf", 12):
        track, motion = dive.track, VehicleMotion(StateLayout(), dive.assumed.process)
        moved = {round(u.time_s * HZ): np.array(u.shift)[4:6] for u in track.updates if u.shift is not None}
        for k, jump_m in moved.items():
            if k < 90 * HZ:
                continue
            before = replicate(track.mean[k - 1], track.cov[k - 1], 1)
            prior = predict(before, motion, cubature, *track.time_s[k - 1 : k + 1].tolist()).cov[:, :, 0]
            taken = prior[POSITION] - track.cov[k][POSITION]
            by_taken.append(jump_m @ np.linalg.solve(taken + 1e-4 * np.eye(2), jump_m))
            by_prior.append(jump_m @ np.linalg.solve(prior[POSITION], jump_m))

    assert len(by_taken) > 400
    assert np.mean(np.array(by_taken) > 9) < 0.02
    assert max(by_prior) < 9


def test_the_return_of_the_fixes_is_told_with_what_it_did_to_the_track() -> None:
    for dive in dives(scenario(("usbl",), 90.0, 60.0), "adf", 12):
        (one,) = dive.track.recoveries
        assert (one.start_s, one.end_s) == (89.0, 150.0)
        assert one.sd_end_m > one.sd_start_m
        assert one.sd_end_m == pytest.approx(dive.sd_m[150 * HZ - 1] / np.sqrt(2), rel=0.01)
        assert one.residual_m < 3.7 * np.hypot(one.sd_end_m, 0.8)
        assert not dive.track.warnings


def test_a_return_is_told_by_its_first_fixes_and_by_what_was_known_before_them() -> None:
    """Straight north at 1 m/s: the first five fixes lie 3 m east and 4 m north of where they were foreseen."""
    line = dives(scenario(("usbl",), 90.0, 60.0), "adf", 12)[0].line
    layout = layout_for(("latency", "usbl-bias"))
    east_bias, late = layout.index("usbl_bias_east"), layout.index("usbl_latency")
    back = line.time_s >= 150.0
    mean = np.zeros((len(back), len(layout)))
    mean[:, layout.index("v")], mean[:, layout.index("y")] = 1.0, line.time_s
    mean[:, east_bias], mean[:, late] = np.where(back, 7.0, 1.0), np.where(back, -0.9, 0.5)
    mean[back, layout.index("x")] = 2.0
    cov = np.tile(np.eye(len(layout)), (len(back), 1, 1))
    cov[line.time_s > 90.0] *= 4.0
    for place, bias in (("x", "usbl_bias_east"), ("y", "usbl_bias_north")):
        rows = layout.rows(place, bias)
        cov[:, rows, rows[::-1]] = -1.5  # a place that the fixes told errs against them
    fix_m = np.column_stack([0 * line.fix_time_s + 1.0 + 3.0, line.fix_time_s - 0.5 + 4.0])
    fix_m[line.fix_time_s >= 155.0] += 100.0
    line = replace(line, fix_m=fix_m, fix_cov_m2=np.tile(0.09 * np.eye(2), (len(fix_m), 1, 1)))
    line = replace(line, outages=(*line.outages, Outage("dvl", 160.0, 170.0)))

    (one,) = outage_recoveries(line, Parameters(), layout, mean, cov)

    median_m2 = np.pi / 2 / 5 * 0.09
    assert one == pytest.approx((89.0, 150.0, 1.0, 2.0, 5.0, 5.0 / np.sqrt(4 + 4 - 2 * 1.5 + median_m2), 2.0))


@pytest.mark.parametrize("scale", [0.03, 0.06])
def test_drift_in_an_outage_is_reported_when_the_fixes_return_and_corrected(scale: float) -> None:
    """A small error is corrected at once; a large one is rejected first and accepted within 20 s."""
    scene = scenario(("usbl",), 90.0, 60.0)
    scene = replace(scene, dvl=replace(scene.dvl, scale_error=scale))
    for dive in dives(scene, "adf", 3):
        (one,) = dive.track.recoveries
        (warning,) = [text for text in dive.track.warnings if "after a USBL outage" in text]
        error_m = np.hypot(*dive.error_m[[150 * HZ - 1, 175 * HZ]].T)

        assert one.residual_m == pytest.approx(error_m[0], abs=1.5)
        assert error_m[1] < error_m[0] / 2
        assert warning.startswith("adf: after a USBL outage of 61 s the first fixes at 150.0 s are ")


def test_a_smoothed_track_reports_the_same_recoveries_as_its_filter() -> None:
    line, assumed, filtered, _ = dives(scenario(("usbl",), 90.0, 60.0), "adf", 12)[0]

    smoothed = run("adf", line, assumed, FilterSettings(smooth=True))

    assert smoothed.recoveries == filtered.recoveries


def test_a_silence_until_the_end_has_no_return() -> None:
    scene = replace(scenario(("usbl",), 90.0, 60.0), duration_s=140.0)

    assert not dives(scene, "adf", 1)[0].track.recoveries


def test_fixes_behind_the_next_silence_say_nothing_of_the_one_before() -> None:
    line, assumed, *_ = dives(scenario(("usbl",), 90.0, 60.0), "adf", 12)[0]
    kept = (line.fix_time_s < 151.5) | (line.fix_time_s > 164.5)  # two fixes between the silences
    line = replace(line.with_fixes(kept), outages=(*line.outages, Outage("usbl", 151.0, 165.0)))

    (one,) = run("adf", line, assumed).recoveries

    assert (one.start_s, one.end_s) == (151.0, 165.0)
