"""Times of netCDF files: numbers in a unit since a date, which the attribute ``units`` states.

Source: CF conventions, time coordinate (cfconventions.org).
"""

import re
from datetime import datetime, timedelta, timezone
from typing import NamedTuple

import numpy as np

from usbldr.io.reader import MAX_TIME_NS, Column, Nanoseconds
from usbldr.io.units import named_unit

SINCE = re.compile(
    r"\s*([a-z]+)\s+since\s+(\d{4})-(\d{1,2})-(\d{1,2})"
    r"(?:[t\s]+(\d{1,2}):(\d{1,2})(?::(\d{1,2})(?:\.(\d{1,9})\d*)?)?)?"
    r"\s*(?:z|utc|gmt)?\s*(?:([+-])(\d{1,2}):?(\d{2})?|0{1,2}:?(?:00)?)?\s*",
    re.IGNORECASE | re.ASCII,
)
DAYS = ("d", "day", "days")
CALENDARS = ("standard", "gregorian", "proleptic_gregorian")
DAY_NS = 86_400 * 10**9  # fixed
NO_DATE = np.iinfo(np.int64).min  # fixed: NumPy's "not a time"


def whole_ns(numbers: Column, unit_ns: int) -> Nanoseconds:
    """Return numbers (n,) of a unit as nanoseconds; integers stay exact."""
    whole = np.floor(numbers).astype(np.int64) if numbers.dtype.kind == "f" else numbers.astype(np.int64)
    return whole * unit_ns + np.rint((numbers - whole) * unit_ns).astype(np.int64)


class Clock(NamedTuple):
    """What numbers count: a unit, since a moment."""

    unit_ns: int
    since_ns: int  # since 1970

    def dates(self, numbers: Column) -> Column:
        """Return numbers (n,) as dates and times, datetime64[ns]; those that are none, or after 2116, as no date."""
        masked, numbers = np.ma.getmaskarray(numbers), np.ma.getdata(numbers)
        rough = numbers.astype(np.float64) * self.unit_ns
        good = (np.abs(rough + self.since_ns) < MAX_TIME_NS) & (np.abs(rough) < -float(NO_DATE))  # False for NaN
        good &= ~masked
        ns = whole_ns(np.where(good, numbers, 0), self.unit_ns) + self.since_ns
        return np.where(good, ns, NO_DATE).astype("datetime64[ns]")


def clock_of(units: object, calendar: object = "standard") -> Clock | None:
    """Return the clock that ``units`` states, None if it states none, or one of a calendar of models."""
    found = SINCE.fullmatch(units) if isinstance(units, str) else None
    if found is None or str(calendar).lower() not in CALENDARS:
        return None
    name, *date, fraction, sign, hours, minutes = found.groups()
    zone = timedelta(hours=int(hours or 0), minutes=int(minutes or 0)) * (-1 if sign == "-" else 1)
    named = (named_unit(f"time [{one}]") for one in (name, name[:-1]))  # "msecs", as UDUNITS allows it
    unit_ns = DAY_NS if name.lower() in DAYS else next((round(u.factor) for u in named if u.dimension == "time"), 0)
    try:
        moment = datetime(*(int(part or 0) for part in date), tzinfo=timezone(zone))
    except ValueError:
        return None
    since_ns = int(moment.timestamp()) * 10**9 + int((fraction or "").ljust(9, "0"))
    return Clock(unit_ns, since_ns) if unit_ns and abs(since_ns) < MAX_TIME_NS else None
