"""The tangent plane, against the radii of WGS84 near its origin and against itself far from it."""

import math

import numpy as np
import pytest

from textbook import radii_m
from usbldr.filters.frames import convergence_rad
from usbldr.io.geodesy import Origin, OriginKind, to_geodetic, to_plane

ORIGIN = Origin(39.718033330, 2.587106667, OriginKind.MAP)


def test_near_the_origin_an_arc_second_has_the_length_of_wgs84_radii() -> None:
    (meridian, vertical), second = radii_m(ORIGIN.lat_deg), 1 / 3600

    east, north = to_plane(ORIGIN, np.array([ORIGIN.lat_deg + second]), np.array([ORIGIN.lon_deg + second]))

    assert north[0] == pytest.approx(math.radians(second) * meridian, abs=2e-3)
    assert east[0] == pytest.approx(math.radians(second) * vertical * math.cos(math.radians(ORIGIN.lat_deg)), abs=2e-3)


def test_there_and_back_is_a_centimetre_over_five_kilometres() -> None:
    east, north = np.array([0.0, 5000.0, -3000.0]), np.array([0.0, -100.0, 4000.0])

    lat, lon = to_geodetic(ORIGIN, east, north)
    np.testing.assert_allclose(to_plane(ORIGIN, lat, lon), [east, north], atol=0.01)


@pytest.mark.parametrize("lat_deg", [0.0, 45.0, -33.0, 80.0])
def test_true_north_on_the_plane_is_the_way_a_point_moves_with_its_latitude(lat_deg: float) -> None:
    place_m = np.array([[20e3, 0.0], [20e3, 15e3], [-30e3, -20e3], [0.0, 10e3]])
    origin, step_deg = Origin(lat_deg, 7.0, OriginKind.MAP), 1e-4
    lat, lon = to_geodetic(origin, *place_m.T)

    south, north = (np.column_stack(to_plane(origin, lat + step, lon)) for step in (-step_deg, step_deg))
    east, along = (north - south).T

    np.testing.assert_allclose(convergence_rad(lat_deg, place_m), np.arctan2(-east, along), atol=1e-6)
