"""Values of a run as the text of a usbldr.toml."""

import math
from collections.abc import Mapping, Sequence

from usbldr.filters.models.noise import Contamination, Gaussian, Mixture, NoiseFamily, StudentT


def toml_text(
    title: Sequence[str], sections: Mapping[str, Mapping[str, str]], conventions: Mapping[str, Mapping[str, str]]
) -> str:
    """Return a usbldr.toml; ``sections`` hold TOML values, ``conventions`` words of the same sections."""
    lines = [*(f"# {line}" for line in title), "schema = 1"]
    for section, keys in sections.items():
        stated = {name: f'"{value}"' for name, value in conventions.get(section, {}).items()} | dict(keys)
        if stated:
            lines += ["", f"[{section}]", *(f"{name} = {value}" for name, value in stated.items())]
    return "\n".join(lines) + "\n"


def shortest_degrees(angle_rad: float) -> float:
    """Degrees with the fewest digits that bring back the angle: 0.1 deg in a scenario is 0.1 in its file."""
    candidates = [float(f"{math.degrees(angle_rad):.{digits}g}") for digits in range(1, 18)]
    return next((deg for deg in candidates if math.radians(deg) == angle_rad), candidates[-1])


def noise_text(family: NoiseFamily, unit: str) -> str:
    """Return the family as a TOML value."""
    match family:
        case Gaussian():
            keys = 'kind = "gaussian"'
        case Mixture():
            keys = f'kind = "mixture", share = {family.share!r}, variance_ratio = {family.variance_ratio!r}'
        case Contamination():
            sd = shortest_degrees(family.sd) if unit == "deg" else family.sd
            keys = f'kind = "contamination", share = {family.share!r}, sd_{unit} = {sd!r}'
        case StudentT():
            keys = f'kind = "student-t", dof = {family.dof!r}'
        case _:
            raise TypeError(f"no TOML form for the noise {family!r}")
    return f'{{ {keys}, per = "{"scalar" if family.per_scalar else "record"}" }}'
