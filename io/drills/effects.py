"""The effects of faults, each a pure function from the table of a sensor to a damaged one.

Seconds of the log; sizes in degrees clockwise (compass), m/s (DVL, starboard and forward) and metres (USBL, east and
north). Random numbers come from a generator that the caller seeds.
"""

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np
import pandas as pd

from usbldr.filters.errors import UsageError
from usbldr.filters.types import Array, Mask, Vector
from usbldr.io.log import Log

MEASURED: Mapping[str, list[str]] = {
    "compass": ["heading_deg"],
    "dvl": ["starboard_mps", "forward_mps"],
    "usbl": ["east_m", "north_m"],
}
STATED: Mapping[str, tuple[list[str], int]] = {
    "compass": (["sd_deg"], 1),
    "dvl": (["sd_mps"], 1),
    "usbl": (["cov_ee_m2", "cov_en_m2", "cov_nn_m2"], 2),
}
"""The columns of what a record states of its own noise, and the power of its sigma in them."""
BIASED: Mapping[str, tuple[float, ...]] = {"compass": (1.0,), "dvl": (0.0, 1.0), "usbl": (1.0, 0.0)}
"""The direction of a bias: clockwise, forward, east."""
TURN_RATE_S = 2.0  # for the turn rate by headings: noise of 0.3 deg at 10 Hz is then 0.2 deg/s, turns last longer


class Damage(NamedTuple):
    """What the effect of a fault is given: a table of n records of a sensor that it may change."""

    sensor: str
    table: pd.DataFrame
    hit: Mask  # (n,) which records
    amount: float
    grown: Vector  # (n,) how far each record lies in its span, 0 to 1
    rng: np.random.Generator
    log: Log

    @property
    def time_s(self) -> Vector:
        """Stamps of the records, (n,)."""
        return self.table["time_s"].to_numpy(dtype=float)

    @property
    def measured(self) -> Array:
        """What the records measured, (n, k)."""
        return self.table[MEASURED[self.sensor]].to_numpy(dtype=float)

    def changed(self, columns: list[str], values: Array) -> pd.DataFrame:
        """Return the table with other values of columns, (n, k), in the records that are hit."""
        mixed = np.where(self.hit[:, None], values, self.table[columns].to_numpy(dtype=float))
        return self.table.assign(**dict(zip(columns, mixed.T, strict=True)))

    def shifted(self, error: Array) -> pd.DataFrame:
        """Return the table with errors, (n, k) or (k,), added to the records that are hit."""
        values = self.measured + error
        return self.changed(MEASURED[self.sensor], values % 360.0 if self.sensor == "compass" else values)

    def directions(self, count: int) -> Array:
        """Return random unit vectors, (count, k): a sign for a heading, any angle in the plane."""
        if self.sensor == "compass":
            return self.rng.choice([-1.0, 1.0], (count, 1))
        angle = self.rng.uniform(0, 2 * np.pi, count)
        return np.column_stack([np.cos(angle), np.sin(angle)])


def _sd(d: Damage) -> pd.DataFrame:
    columns, power = STATED[d.sensor]
    values = d.table[columns].to_numpy(dtype=float)
    if np.isnan(values[d.hit]).all():
        raise UsageError(f"sd {d.sensor}: its records state no sigma that could be wrong")
    return d.changed(columns, values * d.amount**power)


def _lever(d: Damage) -> pd.DataFrame:
    """A velocity at the place of the DVL is v + w x r; a fix is of the place of the transponder."""
    yaw_rad, rate_rps = _turning(d.log, d.time_s)
    if d.sensor == "dvl":
        return d.shifted(d.amount * np.column_stack([-rate_rps, np.zeros(len(rate_rps))]))
    return d.shifted(d.amount * np.column_stack([-np.sin(yaw_rad), np.cos(yaw_rad)]))


def _turning(log: Log, time_s: Vector) -> tuple[Vector, Vector]:
    """Return yaw, radians counter-clockwise, and its rate at these times, by the log's headings."""
    if "compass" not in log.tables:
        raise UsageError("a lever arm needs headings, and the log has none")
    compass = log.tables["compass"].dropna(subset=["time_s", "heading_deg"])
    t = compass["time_s"].to_numpy(dtype=float)
    wrapped: Vector = -np.radians(compass["heading_deg"].to_numpy(dtype=float))
    yaw: Vector = np.unwrap(wrapped)
    half = TURN_RATE_S / 2
    rate: Vector = (np.interp(time_s + half, t, yaw) - np.interp(time_s - half, t, yaw)) / TURN_RATE_S
    return np.interp(time_s, t, yaw), rate


def _noise(d: Damage) -> pd.DataFrame:
    return d.shifted(d.amount * d.rng.standard_normal((len(d.table), len(MEASURED[d.sensor]))))


def _stuck(d: Damage) -> pd.DataFrame:
    """Each run of records that are hit repeats its first one."""
    begins = d.hit & ~np.concatenate([[False], d.hit[:-1]])
    source = np.maximum.accumulate(np.where(begins, np.arange(len(d.hit)), 0))
    return d.changed(MEASURED[d.sensor], d.measured[source])


def _thin(d: Damage) -> pd.DataFrame:
    first = np.diff(np.floor(d.time_s * d.amount), prepend=-np.inf) > 0
    return d.table[first | ~d.hit]


def _latency(d: Damage) -> pd.DataFrame:
    """A record is stamped late, and cannot arrive before its stamp."""
    stamped = d.table["time_s"] + d.amount
    return d.table.assign(time_s=stamped, received_s=np.fmax(d.table["received_s"], stamped))


EFFECTS: Mapping[str, Callable[[Damage], pd.DataFrame]] = {
    "sd": _sd,
    "scale": lambda d: d.shifted((d.amount - 1) * d.measured),
    "bias": lambda d: d.shifted(d.amount * np.array(BIASED[d.sensor])),
    "drift": lambda d: d.shifted(d.amount * d.grown[:, None] * np.array(BIASED[d.sensor])),
    "lever": _lever,
    "scatter": _noise,
    "spike": lambda d: d.shifted(d.amount * d.directions(len(d.table))),
    "outlier": _noise,
    "cluster": lambda d: d.shifted(d.amount * d.directions(1)),
    "stuck": _stuck,
    "zero": lambda d: d.changed(MEASURED[d.sensor], np.zeros_like(d.measured)).assign(valid=d.table["valid"] | d.hit),
    "thin": _thin,
    "drop": lambda d: d.table[~d.hit],
    "latency": _latency,
    "clock": lambda d: d.table.assign(time_s=d.table["time_s"] + d.amount, received_s=d.table["received_s"] + d.amount),
}
"""By the name of the kind; kinds.py declares each."""
