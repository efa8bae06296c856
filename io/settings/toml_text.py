"""Values of a run as the text of a usbldr.toml.

Names of topics and files are foreign text: the library of the format quotes them, and a comment ends with its line.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any, cast

from usbldr.filters.errors import printable
from usbldr.filters.models.noise import FAMILIES, NoiseFamily
from usbldr.filters.models.quantities import quantities


def toml_text(
    title: Sequence[str], sections: Mapping[str, Mapping[str, str]], conventions: Mapping[str, Mapping[str, str]]
) -> str:
    """Return a usbldr.toml; ``sections`` hold TOML values, ``conventions`` words of the same sections."""
    lines = [*(comment(line) for line in title), "schema = 1"]
    for section, keys in sections.items():
        stated = {name: quoted(value) for name, value in conventions.get(section, {}).items()} | dict(keys)
        if stated:
            lines += ["", f"[{section}]", *(f"{name} = {value}" for name, value in stated.items())]
    return "\n".join(lines) + "\n"


def quoted(text: str) -> str:
    """Return a text as a TOML string."""
    import tomlkit

    return tomlkit.string(text).as_string()


def inline(value: object) -> str:
    """Return a value of a configuration as TOML on one line."""
    import tomlkit

    if isinstance(value, list):
        return f"[{', '.join(inline(one) for one in cast('list[object]', value))}]"
    if isinstance(value, dict):
        entries = cast("dict[str, object]", value).items()
        return f"{{ {', '.join(f'{tomlkit.key(key).as_string()} = {inline(one)}' for key, one in entries)} }}"
    return tomlkit.item(value).as_string()


def comment(text: str) -> str:
    """Return a text as a comment of one line."""
    return f"# {printable(text)}"


def put(section: Any, key: str, item: Any, comment: str) -> None:
    """Put a TOML item and the comment on it into a section; an inline table has no room for comments."""
    from tomlkit.items import InlineTable

    if not isinstance(section, InlineTable):
        item.comment(comment)
        item.trivia.comment_ws = "  "
    section[key] = item


def shortest_degrees(angle_rad: float) -> float:
    """Return degrees with the fewest digits that restore the angle: 0.1 deg in a scenario is 0.1 in its file."""
    candidates = [float(f"{math.degrees(angle_rad):.{digits}g}") for digits in range(1, 18)]
    return next((deg for deg in candidates if math.radians(deg) == angle_rad), candidates[-1])


def stated(value: object, sensor: str = "") -> dict[str, str]:
    """Return the quantities of a declared dataclass as keys and TOML values; ``sensor``: the owner of their units."""
    numbers = {quantity: getattr(value, name) for name, quantity in quantities(type(value), sensor).items()}
    return {one.key: repr(shortest_degrees(number) if one.angle else number) for one, number in numbers.items()}


def changed(value: object, usual: object) -> dict[str, str]:
    """Return the quantities that differ from the usual ones, as keys and TOML values."""
    known = stated(usual)
    return {key: text for key, text in stated(value).items() if text != known[key]}


def noise_text(family: NoiseFamily, sensor: str) -> str:
    """Return a sensor's noise family as a TOML value."""
    (kind,) = (kind for kind, known in FAMILIES.items() if known is type(family))
    numbers = "".join(f"{key} = {text}, " for key, text in stated(family, sensor).items())
    return f'{{ kind = "{kind}", {numbers}per = "{"scalar" if family.per_scalar else "record"}" }}'
