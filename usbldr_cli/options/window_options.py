"""Windows of the log as SENSOR@FROM:TO,FROM:TO in seconds: in which GPS aids, or whose records are left out."""

from collections.abc import Sequence
from itertools import pairwise
from math import isfinite

from usbldr.filters.errors import UsageError
from usbldr.filters.windows import TimeWindow

EXCLUDABLE = ("dvl", "compass", "usbl")


def aid_windows(text: str) -> tuple[TimeWindow, ...]:
    """Return the windows of --aid in order of time; raise UsageError for invalid text."""
    sensor, at, windows = text.partition("@")
    if sensor != "gps" or not at:
        raise UsageError(f"--aid {text}: write gps@FROM:TO,FROM:TO with seconds of the log; only gps aids")
    return _windows(f"--aid {text}", windows)


def excluded_windows(texts: Sequence[str]) -> dict[str, tuple[TimeWindow, ...]]:
    """Return sensor -> the windows of --exclude; raise UsageError for invalid text."""
    found: dict[str, tuple[TimeWindow, ...]] = {}
    for text in texts:
        sensor, at, windows = text.partition("@")
        if sensor not in EXCLUDABLE or not at:
            raise UsageError(
                f"--exclude {text}: write SENSOR@FROM:TO,FROM:TO with seconds of the log (sensors: "
                f"{', '.join(EXCLUDABLE)})"
            )
        found[sensor] = found.get(sensor, ()) + _windows(f"--exclude {text}", windows)
    return found


def _windows(option: str, texts: str) -> tuple[TimeWindow, ...]:
    found = sorted(_window(option, part) for part in texts.split(","))
    for (_, end_s), (start_s, _) in pairwise(found):
        if start_s <= end_s:
            raise UsageError(f"{option}: a window starts at {start_s:g} s before another has ended at {end_s:g} s")
    return tuple(found)


def _window(option: str, part: str) -> TimeWindow:
    start, _, end = part.partition(":")
    try:
        start_s, end_s = float(start), float(end)
    except ValueError as err:
        raise UsageError(f"{option}: {part!r} is not a window FROM:TO in seconds of the log") from err
    if not (0 <= start_s < end_s and isfinite(end_s)):
        raise UsageError(f"{option}: the window {part} must start at 0 s or later and end after its start")
    return start_s, end_s
