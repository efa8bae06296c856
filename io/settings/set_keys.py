"""Keys that --set states over those of a configuration: SECTION.KEY=VALUE, several values for one run each."""

import copy
import itertools
import tomllib
from collections.abc import Mapping, Sequence
from typing import Any, cast

from usbldr.filters.errors import UsageError
from usbldr.io.settings.toml_text import inline


def with_set_keys(content: Mapping[str, object], texts: Sequence[str]) -> dict[str, object]:
    """Return the content of a configuration with the keys that --set states; raise UsageError if one has no place."""
    found = copy.deepcopy(dict(content))
    for text in texts:
        key, (value, *others) = _read(text)
        if others:
            raise UsageError(f"--set {text}: several values are for usbldr compare; a list is written [1, 2]")
        path = key.split(".")
        table = found
        for section in path[:-1]:
            inner = table.setdefault(section, {})
            if not isinstance(inner, dict):
                raise UsageError(f"--set {text}: {section} is no section that has keys")
            table = cast("dict[str, object]", inner)
        table[path[-1]] = value
    return found


def sweep(texts: Sequence[str]) -> list[tuple[str, ...]]:
    """Return the KEY=VALUE of each run: every combination of the values; one empty combination without --set."""
    stated = map(_read, texts)
    return list(itertools.product(*([f"{key}={inline(value)}" for value in values] for key, values in stated)))


def _read(text: str) -> tuple[str, list[object]]:
    """Return KEY=A,B as a key and values, as TOML has them; raise UsageError if it is none."""
    key, equals, values = (part.strip() for part in text.partition("="))
    if not (key and equals and values):
        raise UsageError(f"--set {text}: write SECTION.KEY=VALUE with a key of usbldr.toml, such as usbl.sd_m=2")
    whole: list[object] | None = _toml(f"[{values}]")
    return key, [_value(v) for v in values.split(",")] if whole is None else whole


def _value(text: str) -> object:
    """Return a value of TOML, or else the text: words need no quotes."""
    found = _toml(text)
    return text.strip() if found is None else found


def _toml(text: str) -> Any:
    try:
        document = tomllib.loads(f"value = {text}")
    except (tomllib.TOMLDecodeError, RecursionError):
        return None
    return document["value"] if len(document) == 1 else None
