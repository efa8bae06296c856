"""JSON messages to values by field path, by the JSON schema of an MCAP file, else by one made from some messages.

A time is an object of seconds and nanoseconds, however these are called, or a text in ISO 8601 that the schema calls
date-time. A field that is absent or null is NaN (a time: 0, unset; a text: empty).
"""

import json
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, Literal, TypeAlias, cast

import numpy as np

from usbldr.io.decoding.columns import DefinitionError, Extractor, arrays_within, extractor, limited
from usbldr.io.reader import listed_field

LeafType: TypeAlias = Literal["number", "text", "time"]
Leaf: TypeAlias = tuple[LeafType, bool]  # and whether it is an array of such
Schema: TypeAlias = Mapping[str, Any]
SECONDS, NANOSECONDS = ("sec", "secs", "seconds"), ("nsec", "nsecs", "nanosec", "nanos", "nanoseconds")
LEAF_TYPES: Mapping[str, LeafType] = {"number": "number", "integer": "number", "boolean": "number", "string": "text"}
UNSET: Mapping[LeafType, Any] = {"number": float("nan"), "text": "", "time": 0}
WHOLE = re.compile(r"-?\d{1,19}", re.ASCII)
ISO = re.compile(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d")
LEVELS = 8  # of objects in objects; schemas may be recursive


class JsonDecoder:
    """The messages of one type."""

    def __init__(self, name: str, definition: bytes) -> None:
        """Read the schema; raise DefinitionError if that fails. The name does not matter to JSON."""
        try:
            schema = json.loads(definition)
        except RecursionError as err:
            raise DefinitionError("it is nested too deeply") from err
        except ValueError as err:
            raise DefinitionError(str(err)[:80]) from err
        if not isinstance(schema, dict):
            raise DefinitionError("a JSON schema is an object")
        whole = cast("Schema", schema)
        found = limited(_leaves(whole, whole))
        self._kinds: Mapping[str, LeafType] = {path: kind for path, (kind, _) in found.items()}
        self.fields = tuple(self._kinds)
        self.arrays = arrays_within(found) | {path for path, (_, is_array) in found.items() if is_array}

    def extractor(self, paths: Sequence[str]) -> Extractor:
        """Return a function from a message's bytes to the values at the paths; to None if the bytes do not match."""
        getters = [_getter(path, self._kinds[listed_field(path, self._kinds, self.arrays) or path]) for path in paths]
        return extractor(json.loads, getters, (ValueError, TypeError, OverflowError, RecursionError))


def schema_of(samples: Sequence[bytes]) -> bytes:
    """Return a JSON schema for messages without one: of all fields that any of them has."""
    whole: Schema = {}
    for data in samples:
        try:
            whole = _both(whole, _fitting(json.loads(data)))
        except (ValueError, RecursionError):
            continue
    return json.dumps(whole).encode()


def _fitting(value: Any) -> Schema:
    """Return a schema of a value; one without a type for null and for what is empty."""
    if isinstance(value, dict):
        return {"properties": {name: _fitting(inner) for name, inner in cast("dict[str, Any]", value).items()}}
    if isinstance(value, list):
        row = cast("list[Any]", value)
        return {"items": _fitting(row[0])} if row else {}
    if isinstance(value, str):
        return {"type": "string", "format": "date-time"} if ISO.match(value) else {"type": "string"}
    return {} if value is None else {"type": "number"}


def _both(one: Schema, other: Schema) -> Schema:
    fields, more = _part(one, "properties"), _part(other, "properties")
    if not fields or not more:
        return one or other
    return {"properties": {name: _both(_part(fields, name), _part(more, name)) for name in (*fields, *more)}}


def _leaves(schema: Schema, whole: Schema, prefix: str = "", level: int = 0) -> Iterator[tuple[str, Leaf | None]]:
    """Yield the fields below an object by path, None for an object; an array of numbers by its name.

    Of objects in an array those of the first.
    """
    for name, stated in _part(schema, "properties").items():
        path, inner = f"{prefix}{name}", _resolved(stated, whole)
        items = _resolved(inner.get("items"), whole)
        if time_names(_part(inner, "properties")) or inner.get("format") == "date-time":
            yield path, ("time", False)
        elif level < LEVELS and "properties" in inner:
            yield path, None
            yield from _leaves(inner, whole, f"{path}.", level + 1)
        elif level < LEVELS and "properties" in items:
            yield path, None
            yield from _leaves(items, whole, f"{path}.0.", level + 1)
        elif (kind := _kind(items or inner)) is not None:
            yield path, (kind, bool(items))


def _kind(schema: Schema) -> LeafType | None:
    stated = schema.get("type")
    names = cast("list[Any]", stated if isinstance(stated, list) else [stated])
    known: list[LeafType] = [LEAF_TYPES[name] for name in names if isinstance(name, str) and name in LEAF_TYPES]
    return known[0] if known else "number" if "oneOf" in schema else None


def _part(schema: Schema, key: str) -> Schema:
    part = schema.get(key)
    return cast("Schema", part if isinstance(part, dict) else {})


def _resolved(stated: object, whole: Schema) -> Schema:
    """Return a schema, or the one within the whole that it refers to."""
    schema = cast("Schema", stated if isinstance(stated, dict) else {})
    reference = schema.get("$ref")
    if isinstance(reference, str) and reference.startswith("#/"):
        schema = whole
        for name in reference[2:].split("/"):
            schema = _part(schema, name)
    return schema


def time_names(fields: Mapping[str, Any]) -> tuple[str, str] | None:
    """Return what seconds and nanoseconds are called, None if an object has anything else."""
    seconds = [name for name in SECONDS if name in fields]
    nanoseconds = [name for name in NANOSECONDS if name in fields]
    return (seconds[0], nanoseconds[0]) if len(fields) == 2 and seconds and nanoseconds else None


def _getter(path: str, kind: LeafType) -> Callable[[Any], Any]:
    """Return a function from a message to the value at the path; it raises if a value is not of its kind."""
    parts = path.split(".")

    def get(message: Any) -> Any:
        for part in parts:
            if isinstance(message, list):
                row = cast("list[Any]", message)
                message = row[int(part)] if int(part) < len(row) else None
            elif message is not None:
                message = _object(message).get(part)
        return UNSET[kind] if message is None else _value(message, kind)

    return get


def _value(value: Any, kind: LeafType) -> Any:
    if kind == "text":
        return str(value)
    if kind == "number":
        if not isinstance(value, str):
            return value + 0
        return int(value) if WHOLE.fullmatch(value) else float(value)  # as 64-bit integers and NaN come
    if isinstance(value, str):
        return int(np.datetime64(value.removesuffix("Z").removesuffix("+00:00"), "ns").astype(np.int64))
    names = time_names(_object(value))
    if names is None:
        raise ValueError("no time")
    return int(value[names[0]]) * 1_000_000_000 + int(value[names[1]])


def _object(value: Any) -> Mapping[str, Any]:
    if not isinstance(value, dict):
        raise TypeError("no object")
    return cast("Mapping[str, Any]", value)
