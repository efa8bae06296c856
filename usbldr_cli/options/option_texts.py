"""Texts of options as values: windows of the log as SENSOR@FROM:TO,FROM:TO in seconds, in which GPS aids, or whose
records are left out; the noise family of a sensor, as SENSOR=KIND[:NUMBER...][:scalar|record].
"""

from collections.abc import Sequence
from itertools import pairwise
from math import isfinite

from usbldr.filters.errors import UsageError
from usbldr.filters.models.noise import FAMILIES, Gaussian, NoiseFamily
from usbldr.filters.models.quantities import SENSOR_UNITS, quantities
from usbldr.filters.windows import TimeWindow
from usbldr.io.settings.noise_sections import NOISES, noise_family_of
from usbldr.io.settings.validation import checked

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


def noise_family(text: str) -> tuple[str, NoiseFamily]:
    """Return sensor and family; the numbers are those of usbldr.toml in order. Raise UsageError for invalid text."""
    sensor, _, family = text.partition("=")
    kind, *words = family.split(":")
    if sensor not in SENSOR_UNITS or kind not in FAMILIES:
        kinds = f"a sensor of {', '.join(SENSOR_UNITS)} and a kind of {', '.join(FAMILIES)}"
        raise UsageError(f"--noise {text}: write SENSOR=KIND with {kinds}")
    per = words.pop() if words and words[-1] in ("scalar", "record") else None
    keys = [quantity.key for quantity in quantities(FAMILIES[kind], sensor).values()]
    if len(words) > len(keys):
        takes = ", ".join(keys) or "no number"
        raise UsageError(f"--noise {text}: {kind} takes {takes}, then optionally scalar or record")
    numbers = {key: _number(text, key, word) for key, word in zip(keys, words, strict=False)}
    section = checked({"kind": kind, **numbers, "per": per}, NOISES[sensor], f"--noise {text}")
    return sensor, noise_family_of(section, Gaussian(), sensor)


def _number(text: str, key: str, word: str) -> float:
    try:
        return float(word)
    except ValueError as err:
        raise UsageError(f"--noise {text}: {word!r} is not a number for {key}") from err
