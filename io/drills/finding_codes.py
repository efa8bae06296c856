"""Which findings name which fault: a finding with one of these codes tells a user what is wrong."""

from collections.abc import Collection, Mapping

from usbldr.io.drills.drill import Drill
from usbldr.io.drills.fault_text import Fault

FALSE_FIXES = ("USBL-OUTLIERS",)
NAMED_BY: Mapping[str, Mapping[str, tuple[str, ...]]] = {
    "sd": {"usbl": ("USBL-NOISE",)},
    "scale": {"dvl": ("DVL-SCALE", "DVL-UNIT")},
    "bias": {"compass": ("DVL-MOUNT", "HEADING-BIAS"), "usbl": FALSE_FIXES},
    "drift": {"compass": ("DVL-MOUNT", "HEADING-BIAS")},
    "lever": {"dvl": ("HEADING-DELAY",), "usbl": ("USBL-LATENCY",)},
    "scatter": {"usbl": ("USBL-NOISE",)},
    "spike": {"usbl": FALSE_FIXES},
    "outlier": {"usbl": FALSE_FIXES},
    "cluster": {"usbl": FALSE_FIXES},
    "stuck": {"usbl": ("USBL-REPEATED", *FALSE_FIXES)},
    "drop": {"dvl": ("OUTAGE", "LOST-LOCK"), "compass": ("OUTAGE",), "usbl": ("OUTAGE",)},
    "latency": {"usbl": ("USBL-LATENCY", "CLOCK-OFFSET"), "compass": ("HEADING-DELAY",), "dvl": ("HEADING-DELAY",)},
    "clock": {"usbl": ("USBL-LATENCY", "CLOCK-OFFSET"), "compass": ("HEADING-DELAY",), "dvl": ("HEADING-DELAY",)},
}
"""By kind and sensor; docs/findings.md explains each code."""
UNNAMED = ("thin",)  # fewer records are no fault of a record


def is_named(drill: Drill, codes: Collection[str]) -> bool | None:
    """Return whether findings name every fault of a drill; None if there is nothing to be named."""
    faults = [fault for fault in drill.faults if fault.kind not in UNNAMED]
    if not faults:
        return None
    return all(set(_codes(fault)) & set(codes) for fault in faults)


def _codes(fault: Fault) -> tuple[str, ...]:
    return NAMED_BY.get(fault.kind, {}).get(fault.sensor, ())
