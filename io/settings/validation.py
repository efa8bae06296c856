"""TOML documents checked against typed sections: an error is one sentence that names the key and the allowed values.

Configurations, scenarios and baselines are all checked here.
"""

import math
import re
import stat
import tomllib
import typing
from pathlib import Path
from typing import Literal, TypeVar, cast

import msgspec
from msgspec import Struct

from usbldr.filters.errors import UsageError, did_you_mean
from usbldr.io.limits import RAISE, limit

SETTINGS_BYTES = 1 << 20  # [bytes] of a configuration; one that states every key has 10 kB
DEEP_KEY = re.compile(r"(?:\.[ \t]*[\w\"'-]+[ \t]*){100}")  # a key of 100 parts; ours have four

Form = TypeVar("Form")


def read_text(file: Path) -> str:
    """Return a file's text; raise UsageError if it cannot be read."""
    try:
        if not stat.S_ISREG(file.stat().st_mode):  # a pipe would be waited for forever
            raise UsageError(f"{file}: cannot be read (it is no file)")
        if file.stat().st_size > limit(SETTINGS_BYTES):
            raise UsageError(f"{file}: is longer than {limit(SETTINGS_BYTES) >> 10} kB; {RAISE}")
        return file.read_text(encoding="utf-8")
    except OSError as err:
        raise UsageError(f"{file}: cannot be read ({err.strerror})") from err
    except UnicodeDecodeError as err:
        raise UsageError(f"{file}: is not valid TOML ({err})") from err


def read_document(file: Path) -> dict[str, object]:
    """Return a TOML file's content, unchecked; raise UsageError if it is not TOML."""
    text = read_text(file)
    if DEEP_KEY.search(text):  # the time to read one grows with the square of its length
        raise UsageError(f"{file}: is not valid TOML (it is nested too deeply)")
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as err:
        raise UsageError(f"{file}: is not valid TOML ({err})") from err
    except RecursionError as err:
        raise UsageError(f"{file}: is not valid TOML (it is nested too deeply)") from err


def checked(value: object, form: type[Form], where: object, key: str = "") -> Form:
    """Return a parsed value as ``form``; ``key``: the dotted path to it, "" for a whole document.

    Raises UsageError: ``where`` (the file), the key, the nearest match of an unknown one, the allowed values.
    """
    _refuse_unknown_keys(value, form, key, where)
    try:
        return msgspec.convert(value, form)
    except msgspec.ValidationError as err:
        raise UsageError(f"{where}: {_sentence(str(err), form, key)}") from err


def sections(annotation: object) -> list[type[Struct]]:
    """Return the sections that a key may hold."""
    if isinstance(annotation, type) and issubclass(annotation, Struct):
        return [annotation]
    return [section for part in typing.get_args(annotation) for section in sections(part)]


def _refuse_unknown_keys(value: object, annotation: object, path: str, where: object) -> None:
    """Refuse what msgspec accepts or reports without a hint: unknown keys, unknown kinds, nan and inf."""
    if isinstance(value, float) and not math.isfinite(value):
        raise UsageError(f"{where}: {_place(path, annotation)} = {value} is not a finite number")
    if isinstance(value, list):
        for row, inner in enumerate(cast("list[object]", value)):
            _refuse_unknown_keys(inner, annotation, f"{path}[{row}]", where)
    if not isinstance(value, dict) or not (forms := sections(annotation)):
        return
    table, form, tag = cast("dict[str, object]", value), forms[0], forms[0].__struct_config__.tag_field
    if tag:
        kinds = {form.__struct_config__.tag: form for form in forms}
        if table.get(tag) not in kinds:
            raise UsageError(
                f"{where}: {_place(path, None)}: {tag} is missing or unknown (allowed: {', '.join(map(str, kinds))})"
            )
        form = kinds[cast("str", table[tag])]
    hints = typing.get_type_hints(form, include_extras=True)
    allowed = [*([tag] if tag else []), *form.__struct_fields__]
    for key, inner in table.items():
        if key not in allowed:
            section = f"[{path}] has no key" if path else "there is no section"
            raise UsageError(f"{where}: {section} {key}{did_you_mean(key, allowed)} (allowed: {', '.join(allowed)})")
        _refuse_unknown_keys(inner, hints.get(key), f"{path}.{key}".removeprefix("."), where)


def _sentence(message: str, form: object, key: str) -> str:
    """Rewrite msgspec's "Expected `float`, got `str` - at `$.dvl.mount_deg`" into "[dvl] mount_deg: expected ..."."""
    what, _, place = message.partition(" - at ")
    path = re.sub(r"^.*\$\.?|`$", "", place)
    if invalid := re.fullmatch(r"Invalid enum value '?(.*?)'?", what):
        what = f"{invalid[1]} is not allowed (allowed: {', '.join(dict.fromkeys(_words(_annotation(path, form))))})"
    elif what == "Invalid RFC3339 encoded date":
        what = "expected a date, such as 2026-05-01"
    elif what.startswith("Object missing required field"):
        what = f"the key {what.split('`')[1]} is missing"
    elif what.startswith("Expected"):
        what = what.replace("`", "").replace("Expected", "expected").replace(" | null", "")
        what = re.sub(r"\b(float|int)\b", "number", what).replace("str", "text").replace("object", "table")
    whole = f"{key}.{path}".strip(".")
    return f"{_place(whole, _annotation(path, form))}: {what}" if whole else what


def _place(path: str, annotation: object) -> str:
    """Return a dotted path as "[dvl] mount_deg", one name as "[dvl]" if it is a section, else as it is."""
    section, _, key = path.partition(".")
    return f"[{section}] {key}" if key else f"[{path}]" if sections(annotation) else path


def _annotation(path: str, form: object) -> object:
    for name in re.sub(r"\[.*?\]", "", path).split(".") if path else ():
        hints = [typing.get_type_hints(section, include_extras=True) for section in sections(form)]
        form = next((hint[name] for hint in hints if name in hint), None)
    return form


def _words(annotation: object) -> list[str]:
    if typing.get_origin(annotation) is Literal:
        return [str(word) for word in typing.get_args(annotation)]
    if annotation is float:
        return ["a number"]
    return [word for part in typing.get_args(annotation) for word in _words(part)]
