"""Which findings name which fault: a finding with one of these codes says what is wrong."""

from collections.abc import Collection, Mapping

from usbldr.io.drills.drill import Drill

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
