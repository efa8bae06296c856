"""Faults put into simulated dives are named and left out; what a sensor may truly show is not."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from logs import codes, logged, with_table
from recordings import SECOND, T0, short_dive, yaw
from usbldr.filters.frames import rotated
from usbldr.filters.types import Mask, Truth, Vector
from usbldr.filters.windows import columns_at
from usbldr.io.conventions import spikes
from usbldr.io.conventions.displaced import Fixes, false_velocities
from usbldr.io.conventions.implausible import without_implausible
from usbldr.io.doctor.doctor import examine
from usbldr.io.log import Log
from usbldr.io.messages import layouts
from usbldr.io.reading.opening import Request
from usbldr.io.scenarios.shipped import find_scenario
from usbldr.io.scenarios.simulated_log import simulated_log

VELOCITY, PLACE = ["starboard_mps", "forward_mps"], ["east_m", "north_m"]


@pytest.fixture(scope="module")
def dive() -> Log:
    """Simulate 900 s at 1 m/s: DVL at 5 Hz, compass at 10 Hz, USBL at 1 Hz, noise in all of them."""
    return simulated_log(find_scenario("square"), seed=1)


def changed(log: Log, role: str, columns: list[str], values: NDArray[Any]) -> Log:
    table = log.tables[role].copy()
    table[columns] = values
    return with_table(log, role, table)


def with_headings(log: Log, time_s: Vector, heading_deg: Vector) -> Log:
    columns = {"time_s": time_s, "received_s": time_s, "heading_deg": heading_deg, "sd_deg": 0.3}
    return with_table(log, "compass", pd.DataFrame(columns))


def times(log: Log, role: str) -> Vector:
    return log.tables[role]["time_s"].to_numpy()


def within(log: Log, role: str, from_s: float, to_s: float) -> Mask:
    return (times(log, role) >= from_s) & (times(log, role) < to_s)


def stuck(log: Log, role: str, columns: list[str], from_s: float, to_s: float) -> Log:
    values, during = log.tables[role][columns].to_numpy(), within(log, role, from_s, to_s)
    return changed(log, role, columns, np.where(during[:, None], values[np.argmax(during)], values))


def resting(log: Log, from_s: float, to_s: float) -> Log:
    """Repeat a fix; the later ones go on from there."""
    values, later = log.tables["usbl"][PLACE].to_numpy(), times(log, "usbl") >= to_s
    first, end = np.argmax(times(log, "usbl") >= from_s), np.argmax(later)
    gone_on = changed(log, "usbl", PLACE, values - later[:, None] * (values[end] - values[first]))
    return stuck(gone_on, "usbl", PLACE, from_s, to_s)


def turned(log: Log, records: Mask, by_deg: float | Vector) -> Log:
    heading = log.tables["compass"]["heading_deg"].to_numpy()
    return changed(log, "compass", ["heading_deg"], ((heading + records * by_deg) % 360.0)[:, None])


def found(log: Log) -> list[str]:
    return [finding.code for finding in without_implausible(log).findings]


def lost(log: Log) -> dict[str, list[float]]:
    """Return by sensor the times of the records that are left out."""
    kept = without_implausible(log)
    gone = {role: np.setdiff1d(times(log, role), times(kept, role)).tolist() for role in log.tables}
    return {role: left_out for role, left_out in gone.items() if left_out}


# ---- what is named and left out


@pytest.mark.parametrize(
    ("role", "columns", "to_s"), [("dvl", VELOCITY, 360), ("compass", ["heading_deg"], 360), ("dvl", VELOCITY, np.inf)]
)
def test_records_of_a_stuck_sensor_are_left_out(dive, role, columns, to_s):
    log = stuck(dive, role, columns, 300, to_s)

    assert found(log) == ["STUCK"]
    assert lost(log) == {role: times(log, role)[within(log, role, 300, to_s)].tolist()}


def test_a_compass_that_restarts_with_zeros_turns_nothing(dive: Log) -> None:
    during, heading_deg = within(dive, "compass", 300, 308), dive.tables["compass"]["heading_deg"].to_numpy()
    log = changed(dive, "compass", ["heading_deg"], np.where(during, 0.0, heading_deg)[:, None])

    assert lost(log) == {"compass": times(log, "compass")[during].tolist()}


@pytest.mark.parametrize(("step_deg", "stops"), [(0.01, True), (0.1, True), (2.0, False)])
def test_a_coarse_compass_is_stuck_if_it_repeats_itself_for_longer_than_rounding_explains(dive, step_deg, stops):
    rounded = np.round(dive.tables["compass"][["heading_deg"]].to_numpy() / step_deg) * step_deg

    log = stuck(changed(dive, "compass", ["heading_deg"], rounded), "compass", ["heading_deg"], 300, 360)

    assert ("STUCK" in found(log)) == stops


def test_a_finding_counts_the_records_and_the_stretches_and_places_the_longest(dive: Log) -> None:
    log = without_implausible(stuck(stuck(dive, "dvl", VELOCITY, 300, 360), "dvl", VELOCITY, 500, 520))

    (finding,) = log.findings
    assert f"{300 + 100} of 4501 records, in 2 stretches, the longest 60.0 s from 300.0 s on" in finding.text
    assert (finding.topic, finding.level) == ("square/dvl", "warning")
    assert (finding.time_s, finding.worst, finding.unit) == (pytest.approx(300.0), pytest.approx(60.0), "s")
    assert log.provenance["dvl"].used == 4501 - 300 - 100


def test_stuck_depths_are_named_and_stay(dive: Log) -> None:
    time_s = np.arange(0.0, 900.0, 0.5)
    depth_m = 10 + np.sin(time_s / 60) + np.random.default_rng(0).normal(0, 0.02, len(time_s))
    depth_m[600:800] = depth_m[600]
    table = pd.DataFrame({"time_s": time_s, "received_s": time_s, "depth_m": depth_m})
    provenance = {**dive.provenance, "depth": dive.provenance["dvl"]}

    log = replace(with_table(dive, "depth", table), provenance=provenance)

    assert (found(log), lost(log)) == (["STUCK"], {})


def test_of_fixes_that_are_polled_faster_than_the_usbl_pings_each_is_used_once(dive: Log) -> None:
    every = np.arange(len(times(dive, "usbl")))
    log = changed(dive, "usbl", PLACE, dive.tables["usbl"][PLACE].to_numpy()[every // 3 * 3])

    assert found(log) == ["USBL-REPEATED"]
    assert lost(log) == {"usbl": times(log, "usbl")[every % 3 != 0].tolist()}


@pytest.mark.parametrize("apart_s", [0.25, 0.7], ids=["fixes are rows", "fixes lie between rows"])
def test_of_fixes_that_a_table_interpolates_each_is_used_once(dive: Log, apart_s: float) -> None:
    fixes = dive.tables["usbl"].iloc[::3]
    fix_s = fixes["time_s"].to_numpy()
    time_s = np.arange(fix_s[0], fix_s[-1], apart_s)
    table = pd.DataFrame({name: np.interp(time_s, fix_s, fixes[name]) for name in fixes})
    log = with_table(dive, "usbl", table)

    assert found(log) == ["USBL-INTERPOLATED"]
    kept_s = np.setdiff1d(time_s, lost(log)["usbl"])
    assert len(kept_s) == pytest.approx(len(fixes), abs=5)
    assert np.abs(kept_s[:, None] - fix_s).min(axis=1).max() <= apart_s


@pytest.mark.parametrize("runs", [{150: 8, 170: 3, 400: 12}, {150: 8, 880: 20}], ids=["in the dive", "to its end"])
def test_fixes_that_software_extrapolates_are_left_out(dive: Log, runs: dict[int, int]) -> None:
    fixes = dive.tables["usbl"]
    time_s, fix_m = fixes["time_s"].to_numpy(), fixes[PLACE].to_numpy(copy=True)
    extrapolated = np.zeros(len(time_s), dtype=bool)
    for first_s, number in runs.items():
        first = int(np.searchsorted(time_s, first_s))
        rows = slice(first, first + number)
        extrapolated[rows] = True
        fix_m[rows] = fix_m[first - 1] + (time_s[rows] - time_s[first - 1])[:, None] * (0.31, -0.54)
    fix_m[20] = [np.interp(time_s[20], time_s[[19, 21]], near) for near in fix_m[[19, 21]].T]  # by chance
    log = changed(dive, "usbl", PLACE, fix_m)

    assert found(log) == ["USBL-EXTRAPOLATED"]
    assert lost(log) == {"usbl": time_s[extrapolated].tolist()}


@pytest.mark.parametrize("step_m", [0.1, 1.0, 5.0])
def test_fixes_that_rounding_puts_on_lines_are_not_extrapolated(dive: Log, step_m: float) -> None:
    time_s = np.arange(0.0, 900.0, 1.0)
    slow_m = 20.0 * np.sin(time_s[:, None] / (150.0, 110.0)) + np.random.default_rng(0).normal(0, 0.4, (900, 2))
    fixes = dive.tables["usbl"]
    table = pd.DataFrame({name: np.interp(time_s, fixes["time_s"], fixes[name]) for name in fixes})
    table[PLACE] = np.round(slow_m / step_m) * step_m

    assert "USBL-EXTRAPOLATED" not in found(with_table(dive, "usbl", table))


@pytest.mark.parametrize(
    ("sd_m", "digits", "apart_s"),
    [(0.03, 9, 1.0), (0.0, 9, 1.0), (0.0, 2, 0.2)],
    ids=["precise fixes", "no noise", "whole centimetres"],
)
def test_fixes_of_a_vehicle_on_a_line_are_not_interpolated(dive: Log, sd_m: float, digits: int, apart_s: float) -> None:
    time_s = np.arange(0.0, 900.0, apart_s)
    noise_m = np.random.default_rng(0).normal(0, sd_m, (len(time_s), 2))
    weaving_m = 4.0 * np.sin(time_s / 4.0) * (digits == 2)
    straight = time_s[:, None] * (0.8123, 0.6317) + np.where(time_s > 450, 30.0, weaving_m)[:, None]
    fixes = dive.tables["usbl"]
    table = pd.DataFrame({name: np.interp(time_s, fixes["time_s"], fixes[name]) for name in fixes})
    table[PLACE] = np.round(straight + noise_m, digits)

    assert found(with_table(dive, "usbl", table)) == []


def test_fixes_without_noise_on_legs_and_turns_are_not_extrapolated(dive: Log) -> None:
    time_s = np.arange(0.0, 900.0, 1.0)
    course = np.cumsum(np.where(time_s % 90 < 60, 0.0, 0.5))
    fixes = dive.tables["usbl"]
    table = pd.DataFrame({name: np.interp(time_s, fixes["time_s"], fixes[name]) for name in fixes})
    table[PLACE] = 0.8 * np.cumsum(np.column_stack([np.sin(course), np.cos(course)]), axis=0)

    assert found(with_table(dive, "usbl", table)) == []


def test_velocities_that_a_table_holds_until_the_next_are_used_once(dive: Log) -> None:
    """The table goes on with the last velocity also while the DVL is silent."""
    every, silent = np.arange(len(times(dive, "dvl"))), within(dive, "dvl", 400, 440)
    fresh = (every % 4 == 0) & ~silent
    held = dive.tables["dvl"][VELOCITY].to_numpy()[np.maximum.accumulate(np.where(fresh, every, 0))]

    log = changed(dive, "dvl", VELOCITY, held)

    assert found(log) == ["DVL-HELD"]
    assert lost(log) == {"dvl": times(log, "dvl")[~fresh].tolist()}


def test_gps_fixes_that_are_sent_again_are_no_fixes_and_no_truth(dive: Log) -> None:
    """A table with a row for each DVL record shows each GPS fix several times, as if the vehicle stopped for it."""
    rows = np.arange(len(times(dive, "dvl"))) // 5 * 5
    time_s, steps_m = times(dive, "dvl"), np.random.default_rng(0).normal(0.2, 0.1, (len(rows), 2))
    place = np.cumsum(steps_m, axis=0)[rows]
    fixes = pd.DataFrame({"time_s": time_s, "received_s": time_s, "east_m": place[:, 0], "north_m": place[:, 1]})
    fixes = fixes.assign(sd_m=1.0, lat_deg=45 + fixes["north_m"] * 9e-6, lon_deg=7 + fixes["east_m"] * 13e-6)
    provenance = {**dive.provenance, "gps": replace(dive.provenance["usbl"], topic="/gps")}
    truth = Truth(time_s, place, fixes["sd_m"].to_numpy(), "gps", "/gps")
    log = replace(with_table(dive, "gps", fixes), provenance=provenance, truth=truth)

    kept = without_implausible(log)

    assert found(log) == ["GPS-HELD"]
    assert type(kept.provenance["gps"].used) is int  # of Python, as JSON needs it
    assert kept.tables["gps"]["time_s"].tolist() == time_s[::5].tolist()
    assert kept.truth.time_s.tolist() == time_s[::5].tolist()
    other = replace(log, truth=replace(truth, source="reference.csv"))
    assert without_implausible(other).truth is other.truth


@pytest.mark.parametrize(
    ("from_s", "to_s", "decimals"), [(300, 360, 9), (300, 300.2, 9), (0, 50, 9), (700, np.inf, 9), (300, 360, 2)]
)
def test_valid_zeros_between_velocities_at_cruise_are_left_out(dive, from_s, to_s, decimals):
    zeros = within(dive, "dvl", from_s, to_s)
    velocity = np.round(dive.tables["dvl"][VELOCITY].to_numpy() * ~zeros[:, None], decimals)
    log = changed(dive, "dvl", VELOCITY, velocity)

    assert found(log) == ["DVL-ZERO"]
    assert lost(log) == {"dvl": times(log, "dvl")[zeros].tolist()}


@pytest.mark.parametrize(("records", "size_deg"), [(1, 20.0), (1, -60.0), (5, 120.0), (5, 180.0)])
def test_one_wrong_heading_and_a_burst_are_left_out(dive: Log, size_deg: float, records: int) -> None:
    wrong = np.isin(np.arange(len(times(dive, "compass"))), 4500 + np.arange(records))
    log = turned(dive, wrong, size_deg)

    assert found(log) == ["SPIKES"]
    assert lost(log) == {"compass": times(log, "compass")[wrong].tolist()}


@settings(max_examples=40)
@given(at=st.integers(100, 8900), size_deg=st.floats(3.0, 180.0))
def test_a_wrong_heading_of_any_size_changes_no_other(dive: Log, at: int, size_deg: float) -> None:
    """About 90 deg/s, one of both changes may look possible and the other not."""
    wrong = np.arange(len(times(dive, "compass"))) == at
    left = without_implausible(turned(dive, wrong, size_deg))

    assert "SPIKES" in [finding.code for finding in left.findings] or size_deg < 12
    was = dive.tables["compass"][~wrong].set_index("time_s")["heading_deg"]
    now = left.tables["compass"].set_index("time_s")["heading_deg"].reindex(was.index)
    pd.testing.assert_series_equal(now, was)


def with_velocities(dive: Log, wrong: Mask, velocity_mps: tuple[float, float], share: float = 1.0) -> Log:
    """Add a velocity to some records, with a share of what they were."""
    was = dive.tables["dvl"][VELOCITY].to_numpy()
    return changed(dive, "dvl", VELOCITY, np.where(wrong[:, None], share * was + velocity_mps, was))


@pytest.mark.parametrize(("from_s", "to_s"), [(200, 240), (200, 206), (480, 860)])
@pytest.mark.parametrize(
    ("velocity_mps", "share"), [((0.0, -1.0), 1.0), ((0.8, 0.3), 1.0), ((0.0, 0.0), 0.01), ((0.01, 0.02), -1.0)]
)
def test_velocities_that_no_vehicle_reaches_and_leaves_are_left_out(dive, from_s, to_s, velocity_mps, share):
    """They are nearly 0, of another target, or of the wrong sign, and still noisy."""
    wrong = within(dive, "dvl", from_s, to_s)
    log = with_velocities(dive, wrong, velocity_mps, share)

    assert found(log) == ["DVL-JUMP"]
    assert lost(log) == {"dvl": times(log, "dvl")[wrong].tolist()}
    assert without_implausible(log).findings[-1].worst == pytest.approx(to_s - from_s, abs=0.3)


@pytest.mark.parametrize(
    ("spans_s", "velocity_mps"),
    [
        ([(200, 950)], (0.0, 1.0)),  # never leaves it: the log may end in it
        ([(100, 800)], (0.0, 1.0)),  # most of the log
        ([(200, 400), (300, 400)], (0.0, 1.0)),  # one step up, another one up, then down by both
    ],
)
def test_velocities_that_a_vehicle_may_have_stay(dive, spans_s, velocity_mps):
    log = dive
    for span_s in spans_s:
        log = with_velocities(log, within(dive, "dvl", *span_s), velocity_mps)

    assert "DVL-JUMP" not in found(log)


def test_the_fixes_show_that_the_vehicle_did_not_move_as_it_could_have(dive: Log) -> None:
    """Velocities are .4 m/s off for 40 s; the last fix before them is an outlier, with which they would be right."""
    wrong = within(dive, "dvl", 200, 240)
    log = with_velocities(dive, wrong, (0.0, 0.4))
    heading = np.radians(log.tables["compass"]["heading_deg"].to_numpy()[np.searchsorted(times(log, "compass"), 200)])
    outlier = np.arange(len(times(log, "usbl"))) == np.searchsorted(times(log, "usbl"), 200) - 1
    back_m = 16.0 * np.array([np.sin(heading), np.cos(heading)])
    log = changed(log, "usbl", PLACE, log.tables["usbl"][PLACE].to_numpy() - outlier[:, None] * back_m)

    assert found(log) == ["DVL-JUMP"]
    assert lost(log) == {"dvl": times(log, "dvl")[wrong].tolist()}
    assert found(replace(log, tables={name: log.tables[name] for name in ("dvl", "compass")})) == []


@pytest.mark.parametrize(("mirrored", "false"), [(False, 0), (True, 0), (False, 1), (False, 2)])
def test_a_vehicle_that_moves_and_stops_keeps_its_velocities(dive, mirrored, false):
    """It moves at .4 m/s for 20 s of every minute, on a heading of 60 deg.

    Also if the compass is mirrored, or before the first stretch are one or two fixes alone, which are false.
    """
    rng = np.random.default_rng(4)
    dvl_s, usbl_s = times(dive, "dvl"), times(dive, "usbl")
    moves = ((dvl_s % 60) > 40) * 0.4
    log = changed(dive, "dvl", VELOCITY, np.column_stack([0 * moves, moves]) + rng.normal(0, 0.01, (len(moves), 2)))
    headings = 60.0 + rng.normal(0, 0.3, len(times(dive, "compass")))
    log = changed(log, "compass", ["heading_deg"], ((-headings if mirrored else headings) % 360)[:, None])
    gone_m = np.interp(usbl_s, dvl_s, np.cumsum(moves * np.gradient(dvl_s)))[:, None]
    place = gone_m * [np.sin(np.radians(60)), np.cos(np.radians(60))] + rng.normal(0, 0.3, (len(usbl_s), 2))
    place[:false] += 30.0, -20.0
    log = changed(log, "usbl", PLACE, place)
    if false:
        kept = (usbl_s > 60.0) | (np.arange(len(usbl_s)) < false)
        log = with_table(log, "usbl", log.tables["usbl"][kept].reset_index(drop=True))

    assert "dvl" not in lost(log)


@pytest.mark.parametrize(
    ("to_s", "bias_mps", "shift_s"), [(350, 0.06, 900), (600, 0.06, 900), (350, 0.0, 710), (600, 0.0, 400)]
)
def test_what_no_other_velocity_explains_makes_none_false(to_s: int, bias_mps: float, shift_s: int) -> None:
    """It jumps down at 200 s, rises slowly, sinks slowly, and jumps up: in between, it was as before.

    Fixes beside another stretch, of 20 s, are too noisy to show the bias. Or fixes shift by 94 m for good.
    """
    rng, dvl_s, usbl_s = np.random.default_rng(7), np.arange(0.0, 900.01, 0.2), np.arange(0.0, 900.0)
    slower = np.interp(dvl_s, [200, 200.1, 220, 250, to_s - 50, to_s - 20, to_s, to_s + 0.1], [0, 1, 1, 0, 0, 1, 1, 0])
    speed_mps = 1.5 + 0.2 * np.sin(dvl_s / 40) - 0.4 * (slower + ((dvl_s > 700) & (dvl_s < 720)))
    heading = np.radians(60.0 + 40 * np.sin(dvl_s / 90))
    velocity = np.column_stack([0 * speed_mps, speed_mps + bias_mps]) + rng.normal(0, 0.01, (len(dvl_s), 2))
    way_m = np.cumsum(0.2 * speed_mps[:, None] * np.column_stack([np.sin(heading), np.cos(heading)]), axis=0)
    place = columns_at(usbl_s, dvl_s, way_m) + rng.normal(0, 0.7, (len(usbl_s), 2))
    place[usbl_s > shift_s] += 80.0, 50.0

    assert not false_velocities(dvl_s, velocity, Fixes.beside(usbl_s, place, 1.0, (dvl_s, velocity, heading))).any()


def test_the_fixes_show_that_a_simulated_vehicle_changes_its_speed_at_once() -> None:
    log = simulated_log(find_scenario("turns"), seed=1)

    assert found(log) == []
    assert "DVL-JUMP" in found(replace(log, tables={name: log.tables[name] for name in ("dvl", "compass")}))


@pytest.mark.parametrize("at_s", [80.0, 175.0, 335.0, 460.0, 560.0])
@pytest.mark.parametrize("off_m", [(32.0, 0.0), (-25.0, 20.0)])
def test_false_fixes_in_a_row_make_no_velocity_false(at_s: float, off_m: tuple[float, float]) -> None:
    """They lie about a change of the speed, for 50 s."""
    log = simulated_log(find_scenario("turns"), seed=2)
    false = np.abs(times(log, "usbl") - at_s) < 25.0

    assert found(changed(log, "usbl", PLACE, log.tables["usbl"][PLACE].to_numpy() + false[:, None] * off_m)) == []


@pytest.mark.parametrize("share", [0.02, 0.1])
def test_spikes_of_the_dvl_are_left_out_and_no_other_velocity(dive: Log, share: float) -> None:
    rng = np.random.default_rng(3)
    inside = within(dive, "dvl", 1, 899)  # at the ends of the log a spike looks like a start or a stop
    wrong, to = (rng.random(len(inside)) < share) & inside, rng.uniform(0, 2 * np.pi, len(inside))
    spikes = 3.0 * np.column_stack([np.cos(to), np.sin(to)]) * wrong[:, None]
    log = changed(dive, "dvl", VELOCITY, dive.tables["dvl"][VELOCITY].to_numpy() + spikes)

    assert found(log) == ["SPIKES"]
    assert lost(log) == {"dvl": times(log, "dvl")[wrong].tolist()}


def test_the_fixes_show_that_headings_are_false_to_which_a_vehicle_could_turn(dive: Log) -> None:
    table = dive.tables["compass"].iloc[::10].reset_index(drop=True)  # 1 Hz: 90 degrees there and back are possible
    false = np.random.default_rng(5).permuted(np.arange(len(table)) < 45) & (table["time_s"] > 9).to_numpy()

    log = turned(with_table(dive, "compass", table), false, 60.0)

    assert lost(log) == {"compass": table["time_s"][false].tolist()}


def test_spikes_at_the_begin_of_a_turn_of_a_slow_compass_are_found_although_the_running_median_is_off_there() -> None:
    time_s = np.arange(300.0)
    heading_deg = 5.0 * np.clip(time_s - 100.0, 0.0, 20.0) + np.random.default_rng(6).normal(0.0, 0.3, 300)
    heading_deg[[103, 104, 105]] += [60.0, 60.0, -60.0]

    off = spikes.heading_spikes(time_s, heading_deg[:, None], reached=0.0)

    assert np.flatnonzero(off).tolist() == [103, 104, 105]


@pytest.mark.parametrize("made", [False, True])
def test_the_fixes_show_whether_a_slow_dvl_has_spikes_or_the_vehicle_moves_so(dive: Log, made: bool) -> None:
    rng = np.random.default_rng(4)
    table = dive.tables["dvl"].iloc[::5].reset_index(drop=True)  # 1 Hz: 1.5 m/s there and back are possible
    moved = rng.permuted(np.arange(len(table)) < 40) & (table["time_s"] > 9).to_numpy()
    burst_mps = 1.5 * rotated(rng.uniform(0, 2 * np.pi, len(table)), np.array([1.0, 0.0])) * moved[:, None]
    log = changed(with_table(dive, "dvl", table), "dvl", VELOCITY, table[VELOCITY].to_numpy() + burst_mps)
    headings = log.tables["compass"]
    heading_deg = np.interp(table["time_s"], headings["time_s"], np.unwrap(headings["heading_deg"], period=360.0))
    way_m = np.cumsum(rotated(-np.radians(heading_deg), burst_mps), axis=0)
    fixes_m = np.column_stack([np.interp(times(log, "usbl"), table["time_s"], east) for east in way_m.T])
    log = changed(log, "usbl", PLACE, log.tables["usbl"][PLACE].to_numpy() + made * fixes_m)

    assert lost(log) == ({} if made else {"dvl": table["time_s"][moved].tolist()})


@pytest.mark.parametrize("to_s", [360.0, np.inf])
def test_a_heading_that_jumps_and_does_not_return_at_once_is_turned_back(dive: Log, to_s: float) -> None:
    """A square of 900 s: the stretch from 300 s, and that after 360 s, are the longest of theirs."""
    log = turned(dive, within(dive, "compass", 300, to_s), 40.0)

    assert (found(log), lost(log)) == (["HEADING-JUMP"], {})
    was, now = (one.tables["compass"]["heading_deg"].to_numpy() for one in (dive, without_implausible(log)))
    added = 0.0 if to_s == 360.0 else 40.0
    assert np.abs((now - was - added + 180) % 360 - 180).max() < 1.5  # noise of .3 deg at each of two jumps


# ---- what a sensor may truly show


def holding_90_deg(log: Log) -> Vector:
    """Return headings that are noisy while the vehicle turns, and stay the same from 300 to 400 s."""
    course = np.interp(times(log, "compass"), [0, 300, 400, 900], [0, 90, 90, 300])
    return course + np.random.default_rng(7).normal(0, 0.5, len(course)) * ~within(log, "compass", 300, 400)


@pytest.mark.parametrize("rate_hz", [2.0, 5.0, 10.0, 50.0])
@pytest.mark.parametrize("sd_deg", [0.0, 0.3, 2.0])
def test_the_turns_of_a_fast_rov_are_true(dive: Log, rate_hz: float, sd_deg: float) -> None:
    time_s = np.arange(0.0, 300.0, 1 / rate_hz)
    turning_dps = 60.0 * np.array([0, 0, 1, 0, -1, 1, -1, 0])[(time_s // 3).astype(int) % 8]  # reverses at once
    heading = 350 + np.cumsum(turning_dps) / rate_hz + np.random.default_rng(4).normal(0, sd_deg, len(time_s))

    log = with_headings(dive, time_s, heading % 360)

    assert without_implausible(log) is log


def test_a_sensor_may_repeat_itself_if_it_is_coarse_or_polled_faster_than_it_measures(dive: Log) -> None:
    course = changed(dive, "compass", ["heading_deg"], holding_90_deg(dive)[:, None])
    polled = dive.tables["compass"]["heading_deg"].to_numpy()[np.arange(len(times(dive, "compass"))) // 10 * 10]
    for log, role, columns, step in (
        (dive, "compass", ["heading_deg"], 1.0),
        (course, "compass", ["heading_deg"], 1.0),  # while the vehicle keeps its course
        (dive, "dvl", VELOCITY, 0.01),
        (dive, "usbl", PLACE, 1.0),
    ):
        rounded = changed(log, role, columns, np.round(log.tables[role][columns].to_numpy() / step) * step)
        assert without_implausible(rounded) is rounded, role
    held = changed(dive, "compass", ["heading_deg"], polled[:, None])
    assert without_implausible(dive) is dive
    assert without_implausible(held) is held


def test_a_compass_is_stuck_if_its_headings_step_afterwards_although_the_vehicle_only_turned(dive: Log) -> None:
    time_s, held = times(dive, "dvl"), within(dive, "compass", 310, 370)
    moving = ((time_s < 300) | (time_s > 380))[:, None]
    noise = 0.01 * np.random.default_rng(7).normal(size=(len(time_s), 2))
    log = changed(dive, "dvl", VELOCITY, dive.tables["dvl"][VELOCITY].to_numpy() * moving + noise)
    log = turned(log, times(dive, "compass") > 310, np.clip(times(dive, "compass") - 310, 0, 60) * 2)
    log = stuck(log, "compass", ["heading_deg"], 310, 370)

    assert "STUCK" in found(log)
    assert "HEADING-JUMP" not in found(log)
    assert lost(log)["compass"] == times(log, "compass")[held].tolist()


def test_a_vehicle_at_rest_may_show_the_same_values_again(dive: Log) -> None:
    share = np.clip(np.abs(times(dive, "dvl") - 350)[:, None] - 50, 0, 1)  # it stops and starts within a second
    noise = np.random.default_rng(6).normal(size=(len(share), 2))
    log = changed(dive, "dvl", VELOCITY, share + (0.01 + 0.01 * share) * noise)
    log = changed(log, "compass", ["heading_deg"], holding_90_deg(dive)[:, None])
    log = resting(log, 301, 400)

    assert lost(log) == {"usbl": times(log, "usbl")[within(log, "usbl", 302, 401)].tolist()}  # noise repeats no fix


@pytest.mark.parametrize("step_mps", [0.01, 1e-9])
def test_a_vehicle_that_stops_or_starts_slowly_may_have_no_velocity(dive: Log, step_mps: float) -> None:
    ramp_s = 1.0 if step_mps == 0.01 else 2.5
    since_s = times(dive, "dvl") - 350
    for stops, starts in ((ramp_s, ramp_s), (ramp_s, 1e-9), (1e-9, ramp_s)):  # before 320 s and after 380 s
        share = np.clip((np.abs(since_s) - 30.0) / np.where(since_s < 0, stops, starts), 0, 1)[:, None]
        velocity = dive.tables["dvl"][VELOCITY].to_numpy() * share
        log = resting(changed(dive, "dvl", VELOCITY, np.round(velocity / step_mps) * step_mps), 320, 380)

        assert np.sum(np.all(log.tables["dvl"][VELOCITY] == 0, axis=1)) > 290
        assert found(log) == ["USBL-REPEATED"]


def test_velocities_that_are_marked_invalid_are_not_judged(dive: Log) -> None:
    zeros = within(dive, "dvl", 300, 360)
    log = changed(dive, "dvl", VELOCITY, dive.tables["dvl"][VELOCITY].to_numpy() * ~zeros[:, None])
    log = changed(log, "dvl", ["valid"], ~zeros[:, None])

    assert without_implausible(log) is log


def test_a_sensor_may_be_quieter_for_a_while_than_it_resolves(dive: Log) -> None:
    rng, quiet = np.random.default_rng(9), within(dive, "dvl", 300, 400)[:, None]
    velocity = np.array([0.0, 1.0]) + rng.normal(0, np.where(quiet, 0.006, 0.05), (len(quiet), 2))
    log = changed(dive, "dvl", VELOCITY, np.round(velocity, 2))

    assert without_implausible(log) is log


@pytest.mark.parametrize(("interval_s", "repeats"), [(3.0, 2), (0.2, 20)])
def test_a_few_repeats_and_a_short_hang_are_no_fault(dive: Log, interval_s: float, repeats: int) -> None:
    time_s = np.arange(0.0, 900.0, interval_s)
    heading = 40 + np.random.default_rng(10).normal(0, 0.8, len(time_s))
    heading[200 : 201 + repeats] = heading[200]

    log = with_headings(dive, time_s, heading)

    assert without_implausible(log) is log


@pytest.mark.parametrize(("fixes", "repeats"), [(800, [300, 500]), (12, [3, 5, 7, 9])])
def test_two_equal_fixes_and_a_handful_of_fixes_prove_nothing(dive: Log, fixes: int, repeats: list[int]) -> None:
    table = dive.tables["usbl"][:fixes].copy()
    table.loc[repeats, PLACE] = table.loc[np.array(repeats) - 1, PLACE].to_numpy()

    log = with_table(dive, "usbl", table)

    assert without_implausible(log) is log


def test_a_simulation_without_noise_repeats_itself(dive: Log) -> None:
    time_s = times(dive, "compass")
    rate_dps = np.where((time_s % 200) < 100, 0.0, 3.0 * np.sin(time_s / 10))  # straight legs between weaving ones
    log = changed(dive, "compass", ["heading_deg"], ((np.cumsum(rate_dps) / 10 + 90) % 360)[:, None])
    speed = np.where(times(dive, "dvl") % 150 < 50, 0.0, 1.0)  # hovers between legs at 1 m/s
    log = changed(log, "dvl", VELOCITY, np.column_stack([np.zeros_like(speed), speed]))
    log = changed(log, "usbl", PLACE, np.tile([3.0, 4.0], (len(times(dive, "usbl")), 1)))

    assert without_implausible(log) is log


def test_dense_spikes_show_once_their_neighbours_are_gone(dive: Log) -> None:
    every = np.arange(0, len(times(dive, "compass")), 5)  # at 2 Hz, where a window of 13 records lasts for 6 s
    table = dive.tables["compass"].iloc[every].reset_index(drop=True)
    slow = with_table(dive, "compass", table)
    off = np.random.default_rng(0).random(len(table)) < 0.17
    off[[0, -1]] = False  # nothing shows the way back there

    log = without_implausible(turned(slow, off, 84.0))

    np.testing.assert_array_equal(times(log, "compass"), table["time_s"].to_numpy()[~off])
    np.testing.assert_array_equal(log.tables["compass"]["heading_deg"], table["heading_deg"].to_numpy()[~off])


@pytest.mark.parametrize("sd_deg", [5.0, 15.0, 40.0])
def test_a_compass_that_grows_noisy_has_no_jumps(dive: Log, sd_deg: float) -> None:
    late = times(dive, "compass") > 500
    noise = np.random.default_rng(1).normal(0.0, sd_deg, len(late))

    assert "HEADING-JUMP" not in found(turned(dive, late, noise))


# ---- from a file


def test_a_file_is_read_without_its_spikes_and_doctor_names_them(tmp_path: Path) -> None:
    spins = [yaw(T0 + k * SECOND // 10, 120.0 if k == 50 else 0.0) for k in range(100)]

    log = logged(tmp_path, [*(row for row in short_dive() if row[1] != "/imu"), *spins])

    assert codes(log)["SPIKES"].startswith("/imu: 1 of 100 records are far from their neighbours, the worst by 120 deg")
    assert 5.0 not in log.tables["compass"]["time_s"].tolist()
    assert "SPIKES" in [finding.code for finding in examine(tmp_path / "dive.mcap", Request()).findings]


@pytest.mark.parametrize("length", [30, 4500])
def test_spikes_are_the_same_in_blocks_of_any_length(dive: Log, length: int, monkeypatch: pytest.MonkeyPatch) -> None:
    time_s, heading_deg = times(dive, "compass"), dive.tables["compass"]["heading_deg"].to_numpy()
    off = np.random.default_rng(5).choice(len(time_s), 40, replace=False)
    heading_deg = heading_deg + 50.0 * np.isin(np.arange(len(time_s)), off)
    whole = spikes.heading_spikes(time_s, heading_deg[:, None])
    turned_deg = heading_deg + 90.0 * (np.arange(len(time_s)) >= 2000)
    rows, jump_deg = spikes.heading_jumps(time_s, turned_deg)

    monkeypatch.setattr(layouts, "BLOCK_RECORDS", length)

    assert np.count_nonzero(whole) > 20
    np.testing.assert_array_equal(spikes.heading_spikes(time_s, heading_deg[:, None]), whole)
    assert 2000 in rows.tolist()
    np.testing.assert_array_equal(spikes.heading_jumps(time_s, turned_deg), (rows, jump_deg))
