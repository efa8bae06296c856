"""Magnetic declination by the World Magnetic Model: true minus magnetic north, degrees, east positive.

The model is NOAA's and the British Geological Survey's, one set of coefficients every five years, by pygeomag. It is
accurate to about 0.4 degrees away from the magnetic poles and from iron; depth under water makes no difference.
"""

from datetime import UTC, datetime
from typing import Any, cast

import pygeomag  # pyright: ignore[reportMissingTypeStubs]

from usbldr.filters.errors import UsageError
from usbldr.filters.frames import wrapped
from usbldr.io.geodesy import Origin

FIRST_YEAR, LAST_YEAR = 2010, 2029  # of pygeomag's coefficients


def declination(place: Origin, time_ns: int) -> tuple[float, str]:
    """Return the declination at a place and time, degrees, and in words by which model, where and when.

    Raises UsageError for a time that no model covers.
    """
    moment = datetime.fromtimestamp(time_ns // 1_000_000_000, UTC)
    if not FIRST_YEAR <= moment.year <= LAST_YEAR:
        raise UsageError(
            f"no magnetic model for {moment:%Y-%m-%d} (available: {FIRST_YEAR} to {LAST_YEAR}); "
            "state declination_deg under [compass] as a number"
        )
    begin, end = (datetime(moment.year + k, 1, 1, tzinfo=UTC) for k in (0, 1))
    year = moment.year + (moment - begin) / (end - begin)
    model = cast("Any", pygeomag.GeoMag(base_year=moment))  # pyright: ignore[reportArgumentType]
    longitude = wrapped(place.lon_deg, 180.0)
    value = float(model.calculate(glat=place.lat_deg, glon=longitude, alt=0.0, time=year).d)
    where = f"{place.lat_deg:.2f}, {longitude:.2f} ({place.kind})"
    return value, f"{model.model} at {where} on {moment:%Y-%m-%d}"
