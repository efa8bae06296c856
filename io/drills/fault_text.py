"""A fault as it is written: SENSOR[:AMOUNT][@WHERE]..., as compass:120deg@0.02@300:600.

WHERE is a share of the records (0.02), ``one`` record, or spans FROM:TO,FROM:TO. FROM and TO are seconds of the log or
a percentage of its length (40%), and 40%+120 is 120 s later; +60 as TO means 60 s after FROM; without TO a span lasts
until the end.
"""

import math
import re
from dataclasses import dataclass
from typing import NamedTuple

from usbldr.filters.errors import UsageError, did_you_mean
from usbldr.filters.windows import TimeWindow
from usbldr.io.drills.kinds import KINDS, Kind

ONE = "one"
NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:e[+-]?\d+)?"


class Span(NamedTuple):
    """Part of a log: each end is a share of the log's length, and seconds; the end may count from the start."""

    start_share: float
    start_s: float
    end_share: float
    end_s: float
    end_after_start: bool = False

    def seconds(self, length_s: float) -> TimeWindow:
        """Return start and end in a log of this length."""
        start_s = self.start_share * length_s + self.start_s
        return start_s, self.end_share * length_s + self.end_s + (start_s if self.end_after_start else 0.0)


@dataclass(frozen=True, slots=True)
class Fault:
    """One fault of a sensor; without spans it lasts for the whole log."""

    kind: str  # of KINDS
    sensor: str
    amount: float = 1.0  # fixed: in the unit of the kind; without meaning for a kind that takes no number
    spans: tuple[Span, ...] = ()
    share: float | None = None  # of the records that are hit, at random
    one: bool = False  # hits a single record
    text: str = ""  # as it was written, with its kind

    @property
    def draws(self) -> bool:
        """Whether it depends on the seed."""
        return KINDS[self.kind].draws or self.share is not None or self.one


def fault_of(kind: str, text: str) -> Fault:
    """Return a fault of a kind from its text; raise UsageError that says what to write instead."""
    where = f"{kind} {text}"
    if kind not in KINDS:
        raise UsageError(f"{where}: there is no fault {kind!r}{did_you_mean(kind, KINDS)} (faults: {', '.join(KINDS)})")
    declared = KINDS[kind]
    head, *places = text.split("@")
    sensor, colon, amount = head.partition(":")
    if sensor not in declared.units:
        raise UsageError(f"{where}: write a sensor of {', '.join(declared.units)}, as {declared.example}")
    unit = declared.units[sensor]
    if (unit is None) == bool(colon):
        takes = "takes no number" if unit is None else f"needs a number{unit and f' in {unit}'}"
        raise UsageError(f"{where}: {kind} {takes}, as {declared.example}")
    number = 1.0 if unit is None else _amount(where, declared, unit, amount)
    spans: list[Span] = []
    share: float | None = None
    one = False
    for place in places:
        if ":" in place:
            spans += [_span(where, part) for part in place.split(",")]
        elif place == ONE:
            one = True
        else:
            share = _share(where, place)
    _check_places(where, declared, bool(spans), share is not None or one)
    return Fault(kind, sensor, number, tuple(spans), share, one, where)


def _check_places(where: str, declared: Kind, spans: bool, share: bool) -> None:
    """Refuse a fault with too few or too many parameters for the records that it hits."""
    for given, rule, what in ((spans, declared.spans, "a span FROM:TO"), (share, declared.share, 'a share or "one"')):
        if given and rule == "none":
            raise UsageError(f"{where}: takes no {what.removeprefix('a ')}, as {declared.example}")
        if not given and rule == "needed":
            raise UsageError(f"{where}: needs {what} after @, as {declared.example}")
    if declared.share == "optional" and not (spans or share):
        raise UsageError(f"{where}: needs a span FROM:TO or a share after @, as {declared.example}")


def _amount(where: str, declared: Kind, unit: str, text: str) -> float:
    found = re.fullmatch(rf"({NUMBER})\s*(.*)", text)
    if found is None or found[2] not in ("", unit):
        raise UsageError(f"{where}: {text!r} is not a number{unit and f' in {unit}'}; write {declared.example}")
    value = float(found[1])
    if not math.isfinite(value) or (declared.positive and not value > 0):
        raise UsageError(f"{where}: {text} must be {'above 0' if declared.positive else 'finite'}")
    return value


def _share(where: str, text: str) -> float:
    try:
        share = float(text)
    except ValueError as err:
        raise UsageError(f"{where}: {text!r} is neither a share (0.02), nor one, nor a span FROM:TO") from err
    if not 0 < share <= 1:
        raise UsageError(f"{where}: the share {text} must be above 0 and at most 1; a span is FROM:TO")
    return share


def _span(where: str, text: str) -> Span:
    plain = r"\d+\.?\d*|\.\d+"
    found = re.fullmatch(rf"({plain})(%(?:\+({plain}))?)?:(?:(\+?)({plain})(%?))?", text)
    if found is None or (found[4] and found[6]):
        raise UsageError(f"{where}: {text!r} is not a span FROM:TO (seconds, 40%, +60 after FROM, or no TO)")
    start, end, later_s = float(found[1]), float(found[5] or math.inf), float(found[3] or 0)
    start_share, start_s = (start / 100, later_s) if found[2] else (0.0, start)
    end_share, end_s = (end / 100, 0.0) if found[6] else (0.0, end)
    span = Span(start_share, start_s, end_share, end_s, bool(found[4]))
    if bool(found[2]) == bool(found[6]) and not span.end_after_start and not start < end:
        raise UsageError(f"{where}: the span {text} must end after its start")
    return span
