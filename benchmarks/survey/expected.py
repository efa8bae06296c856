"""The numbers that the collectors of the field logs measured, beside ours: each leaf of an expected.json is one.

Tolerances are the collectors'. Where they state none, counts and names have to be equal, what is told of a file has to
agree to the last digit written, and an error, which hangs on a definition, is only shown.
"""

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

Value = float | int | str
DEGREE_M = 111_000.0  # of latitude: a tolerance of a place in metres, in degrees
DEFINED = ("dead_reckoning", "usbl_error", "usbl_synthetic.error")  # numbers that hang on a definition of error
HELD_BACK = ("dead_reckoning", "usbl_synthetic.error")  # those against GPS
OURS = " (usbldr)"  # behind a key: the same by usbldr's own way
NO_NUMBERS = {
    "how": "a remark",
    "tolerance": "a tolerance",
    "tolerance_m": "a tolerance",
    "path_tolerance_m": "a tolerance",
    "seed": "of the collectors' own random numbers",
    "rows_of_odd_length_dropped": "of the conversion from the first format, which usbldr does not read",
    "clock_offset_s": "of the conversion from the first format, which usbldr does not read",
}
EXPLAINED = {
    ("uib_simulation", "truth.path_m"): "the rows of the file add up to 336.79 m, with or without those whose stamp "
    "repeats; 0.1 % more than theirs, for which they state neither a tolerance nor a way",
    ("stpere_marina", f"dead_reckoning_mti_fitted.max_m{OURS}"): "usbldr takes the velocity between two records as a "
    "straight line, where they hold the earlier one: on 1030 m of way the tracks come to lie up to 1.5 m apart",
}


class Number(NamedTuple):
    """One number: theirs, ours, and how far apart they may be."""

    log: str
    key: str
    theirs: Value
    ours: Value | None  # None: not measured
    tolerance: float | None  # None: not stated, only shown

    @property
    def held_back(self) -> bool:
        """Whether it is an error on a held-back log."""
        return self.ours is None and self.key.startswith(HELD_BACK)

    @property
    def met(self) -> bool:
        """Whether ours is near enough."""
        if self.ours is None:
            return False
        if isinstance(self.theirs, str) or isinstance(self.ours, str):
            return self.ours == self.theirs
        return self.tolerance is None or abs(self.ours - self.theirs) <= self.tolerance * (1 + 1e-9)


def expected(folder: Path, name: str) -> Mapping[str, Any]:
    """Return what was measured on a log, by the name of its file without the ending."""
    document = json.loads((folder / "expected.json").read_text(encoding="utf-8"))
    return document["logs"][name] if "logs" in document else document


def compared(log: str, document: Mapping[str, Any], ours: Mapping[str, Value]) -> tuple[Number, ...]:
    """Return every number of a document beside ours."""
    numbers: list[Number] = []
    for part in ("topics", "reference"):
        for way, theirs in leaves(document[part]):
            key, tolerance = ".".join(way), tolerance_of(document[part], way, theirs)
            numbers += [
                Number(log, one, theirs, ours.get(one), tolerance)
                for one in (key, key + OURS)
                if one == key or one in ours
            ]
    return tuple(numbers)


def leaves(document: Mapping[str, Any], above: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Value]]:
    """Yield each number with the way to it."""
    for name, value in document.items():
        if name in NO_NUMBERS or (name, value) == ("map_origin", "first /dgps/fix"):
            continue
        if isinstance(value, Mapping):
            yield from leaves(value, (*above, name))
        else:
            yield (*above, name), value


def tolerance_of(part: Mapping[str, Any], way: tuple[str, ...], theirs: Value) -> float | None:
    """Return how far apart two numbers may be: by the nearest tolerance above it, else by the rule."""
    stated = _stated(part, way)
    if stated is not None:
        return stated
    if not isinstance(theirs, float):
        return 0.0
    return None if ".".join(way).startswith(DEFINED) else last_digit(theirs)


def _stated(part: Mapping[str, Any], way: tuple[str, ...]) -> float | None:
    """Return the tolerance that is stated for a number or for all of its unit around it."""
    *above, name = way
    found: float | None = None
    around: Any = part
    for step in above:
        around = around[step]
        for_each = around.get("tolerance")
        if isinstance(for_each, Mapping):
            found = for_each.get(name, found)
        elif isinstance(for_each, float):
            found = for_each
        if name == "path_m":
            found = around.get("path_tolerance_m", found)
        elif name.endswith("_m"):
            found = around.get("tolerance_m", found)
        elif name in ("lat_deg", "lon_deg") and "tolerance_m" in around:
            found = around["tolerance_m"] / DEGREE_M
    return found


def last_digit(number: float) -> float:
    """Return one unit in the last place that a number is written with."""
    digits, _, exponent = repr(number).partition("e")
    return float(10.0 ** (int(exponent or 0) - len(digits.partition(".")[2])))
