"""Keys that --set states over those of a configuration: SECTION.KEY=VALUE, several values for one run each."""

import copy
import itertools
import tomllib
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, cast

from usbldr.filters.errors import UsageError
from usbldr.io.settings.toml_text import inline


class SetKey(NamedTuple):
    """A key and its values, as --set states them."""

    key: str  # "usbl.sd_m"
    values: tuple[object, ...]  # as TOML has them: numbers, texts, lists

    @classmethod
    def read(cls, text: str) -> "SetKey":
        """Return KEY=A,B as a key and values; raise UsageError if it is none."""
        key, equals, values = (part.strip() for part in text.partition("="))
        if not (key and equals and values):
            raise UsageError(f"--set {text}: write SECTION.KEY=VALUE with a key of usbldr.toml, such as usbl.sd_m=2")
        whole: list[object] | None = _toml(f"[{values}]")
        return cls(key, tuple(_value(v) for v in values.split(",")) if whole is None else tuple(whole))

    def texts(self) -> list[str]:
        """Return KEY=VALUE of each value."""
        return [f"{self.key}={inline(value)}" for value in self.values]


def with_set_keys(content: Mapping[str, object], texts: Sequence[str]) -> dict[str, object]:
    """Return the content of a configuration with the keys that --set states; raise UsageError if one has no place."""
    found = copy.deepcopy(dict(content))
    for text in texts:
        key, (value, *others) = SetKey.read(text)
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
    return list(itertools.product(*(SetKey.read(text).texts() for text in texts)))


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
