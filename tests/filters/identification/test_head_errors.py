"""Errors of the USBL head: its heading and its range, seen from a ship that moves and from a head that rests."""

from dataclasses import replace

import numpy as np
import pytest

from apart import apart_m, mean_nees
from usbldr.filters.frames import rotated
from usbldr.filters.identification.evidence import identify
from usbldr.filters.models.noise import Contamination
from usbldr.filters.models.parameters import Parameters, ProcessNoise
from usbldr.filters.replay.dead_reckoning import freed
from usbldr.filters.replay.run import run
from usbldr.filters.types import Array, Timeline
from weaving import Faults, weaving_dive

ASSUMED = Parameters(process=ProcessNoise(0.005, 0.001, 0.02, 0.02), usbl=Contamination())
DIVE = weaving_dive(Faults())
T = DIVE.fix_time_s[:, None]
CLEAN = run("adf", DIVE, identify(DIVE, ASSUMED).parameters)
SHIP = np.hstack([-80 + 90 * np.sin(T / 50), 60 + 90 * np.cos(T / 70)])
QUAY = np.tile([-80.0, 60.0], (len(T), 1))


def measured(head_m: Array, heading_deg: float = 0.0, range_scale: float = 0.0, line: Timeline = DIVE) -> Timeline:
    """Return the fixes as a head would measure them that is turned clockwise and whose ranges are too long."""
    away_m = (1 + range_scale) * rotated(-np.radians(heading_deg), line.fix_m - head_m)
    return replace(line, fix_m=head_m + away_m, fix_away_m=away_m)


def error_m(line: Timeline, assumed: Parameters) -> float:
    return float(apart_m(run("adf", line, assumed), CLEAN).mean())


@pytest.mark.parametrize(("heading_deg", "scale"), [(0.0, 0.0), (2.0, 0.0), (0.0, 0.02), (-2.0, -0.02)])
def test_a_ship_that_moves_shows_the_errors_of_its_head(heading_deg: float, scale: float) -> None:
    line = measured(SHIP, heading_deg, scale)

    found = identify(line, ASSUMED)

    wanted = {"usbl_heading_deg": heading_deg, "usbl_range_scale": scale}
    assert set(found.estimates) == {name for name, value in wanted.items() if value}
    for name, estimate in found.estimates.items():
        assert abs(estimate.value - wanted[name]) < 4 * estimate.sd < 0.5 * abs(wanted[name])
    assert error_m(line, found.parameters) < 0.3


def test_the_compass_and_the_head_are_told_apart_beside_a_ship_that_moves() -> None:
    line = measured(SHIP, 2.0, line=weaving_dive(Faults(heading_bias_deg=3.0)))

    found = identify(line, ASSUMED).estimates

    assert found["usbl_heading_deg"].value == pytest.approx(2.0, abs=4 * found["usbl_heading_deg"].sd)
    assert found["heading_bias_deg"].value == pytest.approx(3.0, abs=4 * found["heading_bias_deg"].sd)


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
