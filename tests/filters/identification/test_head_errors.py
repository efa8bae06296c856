"""Errors of the USBL head: its heading, its ranges, and its lever arm from the antenna of a ship that turns."""

from dataclasses import replace

import numpy as np
import pytest

from usbldr.filters.frames import rotated
from usbldr.filters.identification.evidence import identify
from usbldr.filters.replay.dead_reckoning import freed
from usbldr.filters.replay.run import run
from usbldr.filters.types import Array, Timeline, Vector
from weaving import ASSUMED, DIVE, Faults, clean_track, mean_error_m, mean_nees, weaving_dive

CLEAN, T = clean_track(), DIVE.fix_time_s
SHIP = np.column_stack([-80 + 90 * np.sin(T / 50), 60 + 90 * np.cos(T / 70)])
QUAY = np.tile([-80.0, 60.0], (len(T), 1))


def measured(head_m: Array, heading_deg: float = 0.0, range_scale: float = 0.0, line: Timeline = DIVE) -> Timeline:
    """Return the fixes as a head would measure them that is turned clockwise and whose ranges are too long."""
    away_m = (1 + range_scale) * rotated(-np.radians(heading_deg), line.fix_m - head_m)
    return replace(line, fix_m=head_m + away_m, fix_away_m=away_m)


@pytest.mark.parametrize(
    ("heading_deg", "scale"),
    [
        *((0.0, 0.0), (2.0, 0.0), (0.0, 0.02), (-15.0, 0.0)),
        *(pytest.param(*both, marks=pytest.mark.slow) for both in ((-2.0, -0.02), (40.0, 0.07))),
    ],
)
def test_a_ship_that_moves_shows_the_errors_of_its_head(heading_deg: float, scale: float) -> None:
    line = measured(SHIP, heading_deg, scale)

    found = identify(line, ASSUMED)

    wanted = {"usbl_heading_deg": heading_deg, "usbl_range_scale": scale}
    assert set(found.estimates) == {name for name, value in wanted.items() if value}
    for name, estimate in found.estimates.items():
        assert abs(estimate.value - wanted[name]) < 4 * estimate.sd < 0.5 * abs(wanted[name])
    assert mean_error_m(line, found.parameters) < 0.3


@pytest.mark.parametrize(("head_deg", "bias_deg"), [(2.0, 3.0), (-12.0, 20.0)])
def test_the_compass_and_the_head_are_told_apart_beside_a_ship_that_moves(head_deg: float, bias_deg: float) -> None:
    line = measured(SHIP, head_deg, line=weaving_dive(Faults(heading_bias_deg=bias_deg)))

    found = identify(line, ASSUMED).estimates

    assert found["usbl_heading_deg"].value == pytest.approx(head_deg, abs=4 * found["usbl_heading_deg"].sd)
    assert found["heading_bias_deg"].value == pytest.approx(bias_deg, abs=4 * found["heading_bias_deg"].sd)


def test_a_compass_that_is_far_off_beside_a_head_that_rests_is_no_error_of_the_head() -> None:
    found = identify(measured(QUAY, 0.0, line=weaving_dive(Faults(heading_bias_deg=40.0))), ASSUMED)

    assert found.estimates["heading_bias_deg"].value == pytest.approx(40.0, abs=2.0)
    assert abs(np.degrees(found.parameters.settled["usbl_heading"])) < 2.0


@pytest.mark.parametrize(("heading_deg", "scale"), [(1.0, 0.0), (0.0, 0.01)])
def test_a_head_that_rests_leaves_head_and_vehicle_open_and_the_covariance_says_so(heading_deg, scale):
    line = measured(QUAY, heading_deg, scale)

    identified = identify(line, ASSUMED)

    found = identified.parameters
    (pair,) = identified.open_pairs
    assert (pair.head, pair.vehicle) == (("usbl-heading", "heading") if heading_deg else ("usbl-range", "scale"))
    assert 0.9 < pair.sd_m / (pair.away_m * (np.radians(1.0) if heading_deg else 0.01)) < 1.0
    assert pair.text in "".join(identified.warnings)
    assert 0.05 < mean_nees(run("adf", line, found), CLEAN) < 6.0  # an error of one prior sigma


def test_slant_ranges_and_depths_show_the_range_error_of_a_head_that_rests() -> None:
    """A range that is too long moves a fix by r² / h: most above the vehicle, where a DVL's scale does least."""
    deep_m, above = 80.0, np.tile([0.0, 5.0], (len(T), 1))
    away_m = DIVE.fix_m - above
    level_m = np.hypot(*away_m.T)
    longer = np.sqrt(1.01**2 * (level_m**2 + deep_m**2) - deep_m**2) / level_m
    away_m = away_m * longer[:, None]
    line = replace(DIVE, fix_m=above + away_m, fix_away_m=away_m, fix_levelled_by_m=np.full(len(T), deep_m))
    line = line.with_fixes(level_m > deep_m / 2)

    found = identify(line, ASSUMED)

    estimate = found.estimates["usbl_range_scale"]
    assert abs(estimate.value - 0.01) < 3 * estimate.sd < 0.01  # by positions alone the sigma is its prior, 0.01
    assert "dvl_scale" not in found.estimates


def test_gps_at_the_end_tells_the_head_from_the_compass() -> None:
    """A compass and a head that are wrong alike hide each other from the fixes alone."""
    faulty = weaving_dive(Faults(heading_bias_deg=1.0))
    gps_s, sd_m = DIVE.fix_time_s[-30:], 0.1
    noise_m = sd_m * np.random.default_rng(1).standard_normal((30, 2))
    line = replace(
        measured(QUAY, 1.0, line=faulty),
        gps_time_s=gps_s,
        gps_m=np.column_stack([np.interp(gps_s, CLEAN.time_s, x) for x in CLEAN.position_m.T]) + noise_m,
        gps_sd_m=np.full(30, sd_m),
    )

    alone = identify(line, ASSUMED).parameters
    aided = identify(line, replace(ASSUMED, aid=((float(gps_s[0]), float(gps_s[-1])),))).parameters

    assert abs(np.degrees(alone.settled["usbl_heading"])) < 0.2 < 0.9 < np.degrees(alone.settled_sd["usbl_heading"])
    sd_deg = np.degrees(aided.settled_sd["usbl_heading"])
    assert abs(np.degrees(aided.settled["usbl_heading"]) + 1.0) < 3 * sd_deg < 1.0


def test_what_is_settled_is_taken_off_the_fixes_exactly() -> None:
    line = measured(SHIP, 2.0, 0.02)

    right = freed(line, {"usbl_heading": -np.radians(2.0), "usbl_range": 0.02})

    np.testing.assert_allclose(right.fix_m, DIVE.fix_m, atol=1e-9)
    assert right.fix_away_m is not None
    np.testing.assert_allclose(right.fix_away_m, DIVE.fix_m - SHIP, atol=1e-9)


def test_fixes_without_a_head_are_not_asked_about_it() -> None:
    assert not {"usbl-heading", "usbl-range"} & {one.key for one in identify(DIVE, ASSUMED).evidence}


def displaced(line: Timeline, arm_m: tuple[float, float], ship_yaw_rad: Vector) -> Timeline:
    """Return the fixes if the head is by an arm, starboard and forward, from where it is taken to be."""
    shift_m = -rotated(ship_yaw_rad, np.tile(arm_m, (len(T), 1)))
    return replace(line, fix_m=line.fix_m + shift_m, fix_ship_yaw_rad=ship_yaw_rad)


TURNING = 0.9 + 1.5 * np.sin(T / 37.0)  # psi of a ship that keeps its place


@pytest.mark.parametrize(
    ("arm_m", "heading_deg"),
    [((1.0, -5.0), 0.0), ((0.0, 0.6), 0.0), ((0.0, 0.0), 0.0), pytest.param((8.0, 3.0), 4.0, marks=pytest.mark.slow)],
)
def test_a_ship_that_turns_shows_where_its_head_is(arm_m: tuple[float, float], heading_deg: float) -> None:
    line = displaced(measured(SHIP, heading_deg), arm_m, TURNING)

    found = identify(line, ASSUMED)

    wanted = {"usbl_arm_starboard_m": arm_m[0], "usbl_arm_forward_m": arm_m[1]} if any(arm_m) else {}
    assert set(found.estimates) - {"usbl_heading_deg"} == set(wanted)
    for name, true_m in wanted.items():
        assert abs(found.estimates[name].value - true_m) < 4 * found.estimates[name].sd < 0.5
    track = run("adf", line, found.parameters)
    assert mean_error_m(line, found.parameters) < 0.3
    assert 0.2 < mean_nees(track, CLEAN) < 4.0


def test_a_ship_that_circles_leaves_arm_and_heading_of_its_head_open_but_not_the_track() -> None:
    """With the vehicle 100 m abeam all the time, a turned head is an arm: their sigmas are large, and cancel."""
    circling = T / 40.0
    vehicle_m = np.column_stack([np.interp(T, CLEAN.time_s, x) for x in CLEAN.position_m.T])
    line = displaced(measured(vehicle_m - rotated(circling, np.array([100.0, 0.0]))), (4.0, 4.0), circling)

    found = identify(line, ASSUMED)

    assert found.estimates["usbl_arm_forward_m"].sd > 1.0
    assert mean_error_m(line, found.parameters) < 0.5
    open_m2 = run("adf", line, found.parameters).open_cov_m2
    assert open_m2 is not None
    assert np.sqrt(open_m2[len(open_m2) // 2, 0, 0]) < 0.5


def test_an_arm_is_taken_off_the_fixes_exactly_but_where_the_ships_heading_is_unknown() -> None:
    line = displaced(DIVE, (1.0, -5.0), TURNING)
    line = replace(line, fix_ship_yaw_rad=np.where(T > 100, TURNING, np.nan))

    right = freed(line, {"usbl_arm_starboard": 1.0, "usbl_arm_forward": -5.0})

    np.testing.assert_allclose(right.fix_m, np.where(T[:, None] > 100, DIVE.fix_m, line.fix_m), atol=1e-9)


def test_fixes_without_the_heading_of_a_ship_are_not_asked_about_an_arm() -> None:
    assert "usbl-arm" not in {one.key for one in identify(measured(SHIP), ASSUMED).evidence}
