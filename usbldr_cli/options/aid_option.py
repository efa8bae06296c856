"""The option --aid: the windows of the log in which GPS aids the filter, as gps@FROM:TO,FROM:TO in seconds."""

from itertools import pairwise
from math import isfinite

from usbldr.filters.errors import UsageError
from usbldr.filters.windows import TimeWindow


def aid_windows(text: str) -> tuple[TimeWindow, ...]:
    """Return the windows in order of time; raise UsageError for invalid text."""
    sensor, at, windows = text.partition("@")
    if sensor != "gps" or not at:
        raise UsageError(f"--aid {text}: write gps@FROM:TO,FROM:TO with seconds of the log; only gps aids")
    found = sorted(_window(text, part) for part in windows.split(","))
    for (_, end_s), (start_s, _) in pairwise(found):
        if start_s <= end_s:
            raise UsageError(f"--aid {text}: a window starts at {start_s:g} s before another has ended at {end_s:g} s")
    return tuple(found)


def _window(text: str, part: str) -> TimeWindow:
    start, _, end = part.partition(":")
    try:
        start_s, end_s = float(start), float(end)
    except ValueError as err:
        raise UsageError(f"--aid {text}: {part!r} is not a window FROM:TO in seconds of the log") from err
    if not (0 <= start_s < end_s and isfinite(end_s)):
        raise UsageError(f"--aid {text}: the window {part} must start at 0 s or later and end after its start")
    return start_s, end_s
