"""The option --noise: the noise family of a sensor, as SENSOR=KIND[:NUMBER...][:scalar|record]."""

from usbldr.filters.errors import UsageError
from usbldr.filters.models.noise import FAMILIES, Gaussian, NoiseFamily
from usbldr.filters.models.quantities import SENSOR_UNITS, quantities
from usbldr.io.settings.noise_sections import NOISES, noise_family_of
from usbldr.io.settings.validation import checked


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
