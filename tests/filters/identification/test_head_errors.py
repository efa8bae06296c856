"""Errors of the USBL head: its heading and its range, seen from a ship that moves and from a head that rests."""

from dataclasses import replace

import numpy as np
import pytest

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
    return float(np.hypot(*(run("adf", line, assumed).position_m - CLEAN.position_m).T).mean())


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
def test_a_head_that_rests_leaves_head_and_vehicle_open_and_the_covariance_says_so(
    heading_deg: float, scale: float
) -> None:
    line = measured(QUAY, heading_deg, scale)

    found = identify(line, ASSUMED).parameters

    track = run("adf", line, found)
    assert set(found.settled_sd) == {"usbl_heading" if heading_deg else "usbl_range"}
    e = track.position_m - CLEAN.position_m
    assert track.position_cov_m2 is not None
    nees = np.einsum("ka,kab,kb->k", e, np.linalg.inv(track.position_cov_m2), e)
    assert 0.05 < nees.mean() < 6.0  # an error of one prior sigma


def test_what_is_settled_is_taken_off_the_fixes_exactly() -> None:
    line = measured(SHIP, 2.0, 0.02)

    right = freed(line, {"usbl_heading": -np.radians(2.0), "usbl_range": 0.02})

    np.testing.assert_allclose(right.fix_m, DIVE.fix_m, atol=1e-9)
    assert right.fix_away_m is not None
    np.testing.assert_allclose(right.fix_away_m, DIVE.fix_m - SHIP, atol=1e-9)


def test_fixes_without_a_head_are_not_asked_about_it() -> None:
    assert not {"usbl-heading", "usbl-range"} & {one.key for one in identify(DIVE, ASSUMED).evidence}
