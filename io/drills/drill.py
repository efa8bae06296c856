"""A drill: a log with one or several faults put into its records."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from usbldr.filters.errors import LogError, UsageError
from usbldr.filters.types import Mask, Vector
from usbldr.filters.windows import TimeWindow
from usbldr.io.drills.effects import EFFECTS, Damage
from usbldr.io.drills.fault_text import Fault
from usbldr.io.drills.kinds import KINDS
from usbldr.io.log import Log, missing_sensor_text

FALSE_FIXES = ("FALSE-FIXES", "USBL-OUTLIERS")
WRONG_CLOCKS: Mapping[str, tuple[str, ...]] = {
    "usbl": ("USBL-LATENCY", "CLOCK-OFFSET", "LEVER-OR-LATENCY"),
    "compass": ("COMPASS-CLOCK", "CLOCK-OFFSET"),
    "dvl": ("DVL-CLOCK", "CLOCK-OFFSET"),
}
FALSE_RECORDS: Mapping[str, tuple[str, ...]] = {
    "usbl": FALSE_FIXES,
    "compass": ("SPIKES", "HEADING-JUMP"),
    "dvl": ("SPIKES", "DVL-JUMP"),
}
NAMED_BY: Mapping[str, Mapping[str, tuple[str, ...]]] = {
    "sd": {"usbl": ("USBL-NOISE",), "compass": ("NOISE-LARGER",), "dvl": ("NOISE-LARGER",)},
    "scale": {"dvl": ("DVL-SCALE", "DVL-UNIT", "SENSOR-CHANGE")},
    "bias": {
        "compass": ("DVL-MOUNT", "HEADING-BIAS", "HEADING-JUMP", "SENSOR-CHANGE"),
        "dvl": ("DVL-JUMP",),
        "usbl": FALSE_FIXES,
    },
    "drift": {"compass": ("DVL-MOUNT", "HEADING-BIAS", "SENSOR-CHANGE"), "usbl": FALSE_FIXES},
    "lever": {"dvl": ("DVL-LEVER", "LEVER-OR-LATENCY"), "usbl": ("DVL-LEVER", "LEVER-OR-LATENCY")},
    "scatter": {"usbl": ("USBL-NOISE", *FALSE_FIXES), "compass": ("NOISE-LARGER",), "dvl": ("NOISE-LARGER",)},
    "spike": FALSE_RECORDS,
    "outlier": FALSE_RECORDS,
    "cluster": {"usbl": FALSE_FIXES},
    "stuck": {"usbl": ("USBL-REPEATED", *FALSE_FIXES), "compass": ("STUCK",), "dvl": ("STUCK",)},
    "zero": {"dvl": ("DVL-ZERO",)},
    "drop": {"dvl": ("OUTAGE", "LOST-LOCK"), "compass": ("OUTAGE",), "usbl": ("OUTAGE",)},
    "latency": WRONG_CLOCKS,
    "clock": WRONG_CLOCKS,
}
"""By kind and sensor; docs/findings.md explains each code."""
UNNAMED = ("thin",)  # fewer records are no fault of a record


@dataclass(frozen=True, slots=True)
class Drill:
    """Faults that happen together, under a name; without faults, the log as it is."""

    name: str
    faults: tuple[Fault, ...] = ()

    @property
    def draws(self) -> bool:
        """Whether it depends on the seed."""
        return any(fault.draws for fault in self.faults)

    @property
    def text(self) -> str:
        """The faults as they are written."""
        return ", ".join(fault.text for fault in self.faults)

    def spans_s(self, length_s: float) -> tuple[TimeWindow, ...]:
        """Return the spans of its faults in a log of this length, in order; a fault of the whole log has none."""
        spans = {span.seconds(length_s) for fault in self.faults for span in fault.spans}
        return tuple(sorted((start_s, min(end_s, length_s)) for start_s, end_s in spans))


UNDAMAGED = Drill("undamaged")


def log_length_s(log: Log) -> float:
    """Return the time of the last DVL, compass or USBL record, seconds since the log's start."""
    ends = [log.tables[role]["time_s"].max() for role in ("dvl", "compass", "usbl") if role in log.tables]
    return float(np.nanmax(ends))


def damaged(log: Log, drill: Drill, seed: int) -> Log:
    """Return a log with the faults of a drill, in the order of KINDS, whatever the order in which they are stated.

    Raises LogError without records of a sensor, UsageError if no record is where a fault is to be.
    """
    if not drill.faults:
        return log
    length_s = log_length_s(log)
    order = list(KINDS)
    for k, fault in enumerate(sorted(drill.faults, key=lambda fault: order.index(fault.kind))):
        log = _with_fault(log, fault, length_s, np.random.default_rng([seed, k]))
    return log


def _with_fault(log: Log, fault: Fault, length_s: float, rng: np.random.Generator) -> Log:
    if fault.sensor not in log.tables:
        raise LogError(f"{log.path}: {fault.text}: {missing_sensor_text(log, fault.sensor)}")
    table = log.tables[fault.sensor].sort_values("time_s", kind="stable").reset_index(drop=True)
    time_s = table["time_s"].to_numpy(dtype=float)
    spans = [span.seconds(length_s) for span in fault.spans]
    inside, grown = _inside(time_s, spans)
    if not inside.any():
        span = f"{time_s[0]:.0f} to {time_s[-1]:.0f} s" if len(time_s) else "there are none"
        raise UsageError(f"{log.path.name}: {fault.text}: the log has no {fault.sensor} record there ({span})")
    hit = inside
    if fault.one:
        hit = np.zeros(len(table), np.bool_)
        hit[rng.choice(np.flatnonzero(inside))] = True
    elif fault.share is not None:
        hit = inside & (rng.random(len(table)) < fault.share)
    damage = Damage(fault.sensor, table, hit, fault.amount, grown, rng, log)
    changed = EFFECTS[fault.kind](damage).reset_index(drop=True)
    return replace(log, tables={**log.tables, fault.sensor: changed})


def _inside(time_s: Vector, spans: Sequence[TimeWindow]) -> tuple[Mask, Vector]:
    """Return which times lie in [start, end) of a span, all without spans, and how far each has got in it, 0 to 1."""
    inside, grown = np.full(len(time_s), not spans), np.zeros(len(time_s))
    for start_s, end_s in spans:
        mine = (time_s >= start_s) & (time_s < end_s)
        last_s = min(end_s, float(time_s[-1]))
        grown[mine] = (time_s[mine] - start_s) / max(last_s - start_s, 1e-9)
        inside |= mine
    return inside, grown


def is_named(drill: Drill, codes: Collection[str], usual: Collection[str] = ()) -> bool | None:
    """Return whether findings name every fault of a drill, given the codes with the faults and without them.

    None if there is nothing to be named, or if a code that would name a fault is reported without the faults, too.
    """
    faults = [
        set(NAMED_BY.get(fault.kind, {}).get(fault.sensor, ())) for fault in drill.faults if fault.kind not in UNNAMED
    ]
    unnamed = [mine for mine in faults if not mine & (set(codes) - set(usual))]
    if not faults or any(mine & set(usual) for mine in unnamed):
        return None
    return not unnamed
