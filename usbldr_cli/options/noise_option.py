"""The option --noise: how a sensor errs, as SENSOR=KIND[:NUMBER...][:scalar|record]."""

import math
from collections.abc import Callable, Mapping
from dataclasses import replace

from usbldr.filters.errors import UsageError
from usbldr.filters.models.noise import Contamination, Gaussian, Mixture, NoiseFamily, StudentT

Family = Gaussian | Mixture | StudentT | Contamination

SENSORS = ("dvl", "compass", "usbl", "gps")
KINDS: Mapping[str, tuple[Callable[..., Family], tuple[str, ...]]] = {
    "gaussian": (Gaussian, ()),
    "mixture": (Mixture, ("share", "variance ratio")),
    "student-t": (StudentT, ("degrees of freedom",)),
    "contamination": (Contamination, ("share", "sd")),
}
"""Each family with the numbers that may follow; sd is in m/s, degrees or m."""


BOUNDS = {"share": (0.0, 1.0), "variance ratio": (0.0, 1e9), "degrees of freedom": (2.0, 1e6), "sd": (0.0, 1e6)}


def noise_family(text: str) -> tuple[str, NoiseFamily]:
    """Return sensor and family; raise UsageError for what is neither."""
    sensor, _, said = text.partition("=")
    kind, *words = said.split(":")
    if sensor not in SENSORS or kind not in KINDS:
        raise UsageError(
            f"--noise {text}: write SENSOR=KIND with a sensor of {', '.join(SENSORS)} and a kind of {', '.join(KINDS)}"
        )
    per = words.pop() if words and words[-1] in ("scalar", "record") else None
    family, names = KINDS[kind]
    if len(words) > len(names):
        raise UsageError(f"--noise {text}: {kind} takes {_listed(names)}, then scalar or record, and no more")
    numbers = [_number(text, name, word) for name, word in zip(names, words, strict=False)]
    if sensor == "compass" and len(numbers) == 2 and kind == "contamination":
        numbers[1] = math.radians(numbers[1])
    made = family(*numbers)
    return sensor, made if per is None else replace(made, per_scalar=per == "scalar")


def _number(text: str, name: str, word: str) -> float:
    least, most = BOUNDS[name]
    try:
        value = float(word)
    except ValueError as err:
        raise UsageError(f"--noise {text}: {word!r} is no number for the {name}") from err
    if not least < value < most:
        raise UsageError(f"--noise {text}: the {name} has to be above {least:g} and below {most:g}")
    return value


def _listed(names: tuple[str, ...]) -> str:
    return ", ".join(names) or "no number"
