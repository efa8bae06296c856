"""Dead reckoning and raw fixes against motions and error laws that are known in closed form."""

import dataclasses
import math

import numpy as np
import pytest

from logs import refusal
from usbldr.filters.errors import LogError
from usbldr.filters.replay import dead_reckoning
from usbldr.filters.simulation.scenario import Leg, Scenario
from usbldr.filters.simulation.simulate import simulate
from usbldr.filters.types import Array, Timeline, Vector
from usbldr.io.reading.epochs import timeline
from usbldr.io.scenarios.shipped import find_scenario
from usbldr.io.scenarios.simulated_log import simulated_log

PAPER = find_scenario("paper")

EXACT = dataclasses.replace(
    PAPER,
    dvl=dataclasses.replace(PAPER.dvl, sd_mps=1e-12, scale_error=0.0),
    compass=dataclasses.replace(PAPER.compass, sd_rad=1e-12),
)
TURNING = dataclasses.replace(EXACT, legs=(Leg(500.0, 0.1, 1.5, 0.02),), duration_s=500.0)


def _line(scenario: Scenario, seed: int = 0) -> Timeline:
    return timeline(simulated_log(scenario, seed))


def _with_fixes(line: Timeline, east_m: list[float]) -> Timeline:
    n = len(east_m)
    fixes = np.column_stack([np.array(east_m), np.zeros(n)])
    return dataclasses.replace(line, fix_time_s=np.arange(n, dtype=float), fix_m=fixes)


# the trapezoid shortens each chord by (r dt)^2 / 12: 1.3e-6 of 750 m
@pytest.mark.parametrize(("scenario", "scale", "off_m"), [(TURNING, 0.0, 2e-3), (EXACT, 0.01, 1e-6)])
def test_dead_reckoning_follows_the_turns_and_a_scale_error_lengthens_it_by_itself(scenario, scale, off_m):
    scaled = dataclasses.replace(scenario, dvl=dataclasses.replace(scenario.dvl, scale_error=scale))

    track = dead_reckoning.dr(_line(scaled), np.zeros(2))

    truth = simulate(scenario, 0).truth
    np.testing.assert_allclose(track.position_m, (1 + scale) * truth.position_m, rtol=0, atol=off_m)
    moved = np.column_stack([truth.yaw_rad, (1 + scale) * truth.velocity_mps])
    np.testing.assert_allclose(track.mean[:, :3], moved, atol=1e-9)
    assert track.cov is None


@pytest.mark.parametrize("start_time_s", [0.0, 33.3, 500.0])
def test_dead_reckoning_meets_its_start_at_its_time(start_time_s: float) -> None:
    line = _line(TURNING)

    track = dead_reckoning.dr(line, np.array([100.0, -50.0]), start_time_s)

    there = [np.interp(start_time_s, track.time_s, axis) for axis in track.position_m.T]
    np.testing.assert_allclose(there, [100.0, -50.0])
    from_origin = dead_reckoning.dr(line, np.zeros(2)).position_m
    np.testing.assert_allclose(np.ptp(track.position_m - from_origin, axis=0), 0, atol=1e-9)


def _start(line: Timeline) -> tuple[Vector, float]:
    return dead_reckoning.start_position(line, line.fix_time_s, line.fix_m)


def test_the_start_is_where_the_fixes_say_less_the_way_since_and_gps_is_no_part_of_it() -> None:
    line = _line(EXACT)
    truth = simulate(EXACT, 0).truth.position_m[::5]
    moved = truth[20:30] + np.array([40.0, -60.0])
    line = dataclasses.replace(line, fix_time_s=np.arange(20.0, 30.0), fix_m=moved)

    start, sd_m = _start(line)

    np.testing.assert_allclose(start, [40.0, -60.0], atol=1e-6)
    assert sd_m == 3.0
    np.testing.assert_array_equal(_start(dataclasses.replace(line, gps_m=line.gps_m + 1000.0))[0], start)


def test_two_gross_errors_in_five_neither_move_the_start_nor_widen_it_and_more_widen_it() -> None:
    still = dataclasses.replace(EXACT, legs=(Leg(1000.0, 0.0, 0.0),))

    start, sd_m = _start(_with_fixes(_line(still), [0.1, 50.0, 0.0, 80.0, -0.1]))
    _, wide_m = _start(_with_fixes(_line(still), [-40.0, -10.0, 0.0, 20.0, 50.0]))

    np.testing.assert_allclose(start, [0.1, 0.0], atol=1e-6)
    assert sd_m == 3.0
    assert wide_m == pytest.approx(1.4826 * 20.0)


def test_raw_fixes_keep_their_own_times_and_without_any_there_is_one_sentence() -> None:
    track, line = dead_reckoning.usbl(_with_fixes(_line(EXACT), [1.0, 2.0])), _with_fixes(_line(EXACT), [])

    assert (track.time_s.tolist(), track.names) == ([0.0, 1.0], ("x", "y"))
    assert "no USBL fix" in refusal(LogError, dead_reckoning.usbl, line)
    assert "no USBL fix to nudge" in refusal(LogError, dead_reckoning.nudge, line)


def test_nudged_dead_reckoning_meets_every_fix_and_keeps_its_shape_between() -> None:
    slow = dataclasses.replace(TURNING, dvl=dataclasses.replace(TURNING.dvl, scale_error=0.2))
    line = _line(slow)
    every_20 = slice(0, None, 20)
    truth = simulate(slow, 0).truth
    fix_s = line.fix_time_s[every_20]
    where = np.column_stack([np.interp(fix_s, truth.time_s, axis) for axis in truth.position_m.T])
    line = dataclasses.replace(line, fix_time_s=fix_s, fix_m=where)

    track = dead_reckoning.nudge(line)

    at_fixes = np.column_stack([np.interp(fix_s, track.time_s, axis) for axis in track.position_m.T])
    np.testing.assert_allclose(at_fixes, where, atol=1e-9)
    within = track.time_s <= fix_s[-1]
    worst = np.hypot(*(track.position_m - truth.position_m)[within].T).max()
    reckoned = np.hypot(*(dead_reckoning.dr(line, where[0]).position_m - truth.position_m)[within].T).max()
    # 20 s of a circle of 75 m radius: what a straight line between two offsets misses of a fifth of it
    assert worst < 0.2 * 75 * (1 - math.cos(0.2)) * 1.05 < reckoned / 10


@pytest.mark.parametrize("late_s", [1.3, -0.7])
@pytest.mark.parametrize("sensor", dead_reckoning.COLUMNS)
def test_records_with_late_stamps_are_those_of_the_epochs_at_which_they_were_true(sensor: str, late_s: float) -> None:
    """A sensor has a record in every other epoch, and reads a tenth of the time."""

    def read(time_s: Vector) -> Array:
        return 0.1 * (np.column_stack([time_s, -time_s]) if sensor == "dvl" else time_s)

    line = timeline(simulated_log(dataclasses.replace(find_scenario("paper"), duration_s=20.0), 0))
    t, (measured, reckoned, count, sd) = line.time_s, dead_reckoning.COLUMNS[sensor]
    stamped, records = read(t - late_s), np.arange(len(t)) % 2
    late = dataclasses.replace(line, **{measured: stamped, reckoned: stamped, count: records, sd: t})

    right = dead_reckoning.freed(late, {f"{sensor}_clock": late_s})

    inside = (t + late_s > 0.1) & (t + late_s < t[-1] - 0.1)
    for name in (measured, reckoned):
        np.testing.assert_allclose(getattr(right, name)[inside], read(t)[inside], atol=1e-9)
    stamped_s = getattr(right, sd)[inside]
    np.testing.assert_allclose(stamped_s, (t + late_s)[inside], atol=0.1 + 1e-9)
    np.testing.assert_array_equal(getattr(right, count)[inside], np.round(stamped_s * 5) % 2)
