"""From the bytes of messages to columns: what the decoders of all encodings share."""

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import islice
from typing import Any, NamedTuple, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from usbldr.io.limits import RAISE, limit
from usbldr.io.reader import Column, Nanoseconds

Extractor: TypeAlias = Callable[[bytes], tuple[Any, ...] | None]
"""From a message's bytes to the values at some field paths; to None if the bytes do not match the definition."""
TYPE_FIELDS = 20_000  # [fields] of a type, those of types in it counted each time; 36 x 36 covariances fit


class DefinitionError(ValueError):
    """The text of a message definition is invalid."""


Leaf = TypeVar("Leaf")


def limited(fields: Iterable[tuple[str, Leaf | None]]) -> dict[str, Leaf]:
    """Return the fields of a type by path, without those that only hold others (None).

    Raises DefinitionError if there are too many.
    """
    most = limit(TYPE_FIELDS)
    found = list(islice(fields, most + 1))
    if len(found) > most:
        raise DefinitionError(f"it has more than {most} fields; {RAISE}")
    return {path: leaf for path, leaf in found if leaf is not None}


def arrays_within(paths: Iterable[str]) -> frozenset[str]:
    """Return the arrays of messages in whose first elements some fields are: "beams" of "beams.0.range"."""
    return frozenset(path[: found.start()] for path in paths for found in re.finditer(r"\.0(?=\.)", path))


def extractor(
    parse: Callable[[bytes], Any], getters: Sequence[Callable[[Any], Any]], errors: tuple[type[Exception], ...]
) -> Extractor:
    """Return a function from a message's bytes to what the getters return; to None if one of the errors is raised."""

    def extract(data: bytes) -> tuple[Any, ...] | None:
        try:
            message = parse(data)
            return tuple(getter(message) for getter in getters)
        except errors:
            return None

    return extract


class DecodedRows(NamedTuple):
    """Some of the messages of a topic, read."""

    rows: NDArray[np.intp]  # which ones
    columns: Mapping[str, Column]  # field path -> (len(rows),)


def decode_one_by_one(
    extract: Extractor, payloads: Sequence[bytes], paths: Sequence[str], rows: Sequence[int] | None = None
) -> DecodedRows:
    """Read messages, all or those of ``rows``, one by one; leave out those that do not match."""
    read = [(row, extract(payloads[row])) for row in (range(len(payloads)) if rows is None else rows)]
    fitting = [(row, values) for row, values in read if values is not None]
    columns = {path: np.array([values[i] for _, values in fitting]) for i, path in enumerate(paths)}
    return DecodedRows(np.array([row for row, _ in fitting], dtype=np.intp), columns)


def concatenated(pieces: Sequence[DecodedRows], paths: Sequence[str]) -> DecodedRows:
    """Return all pieces as one, numbers as int64 and float64."""
    some = [piece for piece in pieces if len(piece.rows)]
    rows = np.concatenate([np.empty(0, dtype=np.intp), *(piece.rows for piece in some)])
    columns = {path: [_wide(piece.columns[path]) for piece in some] or [np.empty(0)] for path in paths}
    return DecodedRows(rows, {path: np.concatenate(parts) for path, parts in columns.items()})


def _wide(column: Column) -> Column:
    """Return numbers in the widest type of their kind; unsigned 64-bit numbers stay unsigned."""
    if column.dtype.kind == "f":
        return column.astype(np.float64, copy=False)
    if column.dtype.kind in "iu" and column.dtype != np.uint64:
        return column.astype(np.int64, copy=False)
    return column


def counted(times: Nanoseconds) -> tuple[int, int | None, int | None]:
    """Return how many times (n,) there are, the first and the last; None if there is none."""
    return (len(times), int(times.min()), int(times.max())) if len(times) else (0, None, None)
