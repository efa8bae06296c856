"""Zones of times that the name of a column states, by an offset, a place, or as GPS time."""

import re
from collections.abc import Sequence
from zoneinfo import available_timezones

import numpy as np
import pandas as pd

from usbldr.io.gps_time import EPOCH_S, WEEK_S, utc_ns
from usbldr.io.tables.time_columns import ISO
from usbldr.io.tables.time_parts import as_text, moments_of, moments_text

NAMED_ZONE = re.compile(r"(?:(?:UTC|GMT) ?|[\[(] ?)([+-])(\d{1,2})(?::?([0-5]\d))?(?!\d)", re.IGNORECASE)
"""A zone that a column's name states: "Time (UTC+2)", "Time [+02:00]"."""
UNKNOWN_ZONE = re.compile(
    r"[\[(] ?((?!UTC?|GMT|GPST)[A-Z]{1,3}T|MES?Z|local(?: time)?) ?[\])]|^local(?=[ _-]?time)", re.IGNORECASE
)
GPS_TIME = re.compile(r"(?:^|[^a-z])gpst(?:$|[^a-z])|[\[(] ?gps(?: time)? ?[\])]", re.IGNORECASE)
PLACE = re.compile(r"\b[A-Z][A-Za-z]+/[A-Z][\w/]+")
"""A zone by its place, as the IANA data base names it: "Time (Europe/Oslo)"."""


def named_zone(name: str) -> str:
    """Return the zone that a name states as ISO has it, "+02:00"; empty if it states none."""
    zone = NAMED_ZONE.search(name)
    return f"{zone[1]}{int(zone[2]):02d}:{zone[3] or '00'}" if zone else ""


def in_named_zone(name: str, cells: Sequence[str]) -> Sequence[str]:
    """Return dates and times in the zone that their column's name states, if it states one."""
    if zone := named_zone(name):
        cells = [cell + zone if ISO.fullmatch(cell) else cell for cell in cells]
    place = PLACE.search(name)
    return _utc_of_place(cells, place[0]) if place and place[0] in available_timezones() else cells


def utc_of_gps(cells: Sequence[str]) -> list[str]:
    """Return dates and times of GPS time as those of UTC."""
    moments = moments_of(cells)
    since_1970 = moments.to_numpy("datetime64[ns]", na_value=np.datetime64(0, "ns")).astype(np.int64)
    weeks, rest_ns = np.divmod(since_1970 - EPOCH_S * 10**9, WEEK_S * 10**9)
    return moments_text(utc_ns(weeks, rest_ns / 1e9), moments.notna().to_numpy(np.bool_), cells)


def _utc_of_place(cells: Sequence[str], zone: str) -> list[str]:
    """Return dates and times of a place as those of UTC; of an hour that comes twice, until it does the first one."""
    local = moments_of(cells, utc=False)
    summer = (local.diff() < -pd.Timedelta(minutes=30)).cumsum() == 0
    hour = pd.Timedelta(hours=1)  # a clock that was not set shows an hour that the place leaves out
    moments = local.dt.tz_localize(zone, ambiguous=summer.to_numpy(), nonexistent=hour).dt.tz_convert("UTC")
    return as_text(moments, cells)
