"""Tables in JSON files that hold columns: {"time": [...], "vx": [...]}, alone or by the name of a sensor.

pandas writes them with ``to_json`` (a column is an object of its rows) and ``to_dict("list")``.
"""

import json
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, cast

import pandas as pd

from usbldr.filters.errors import LogError
from usbldr.io.file_access.open_file import opened
from usbldr.io.file_access.optional_library import reading
from usbldr.io.limits import limit
from usbldr.io.reader import Column
from usbldr.io.tables.array_tables import TEXT, Table, array_log
from usbldr.io.tables.json_objects import MOST_BYTES
from usbldr.io.tables.table_log import TableLog

NAME = "JSON columns"
KEY = rb'\s*\{\s*"[^"\n]*"\s*:'
BEGIN = re.compile(rb'%b(?:%b)?\s*(?:\[\s*(?:[-\d"]|null)|\{\s*"0"\s*:)' % (KEY, KEY))
NEXT = re.compile(rb"\}\s*\n\s*\{")


def looks_like_json_columns(head: bytes) -> bool:
    """Return whether a file begins as an object of columns, and not as several objects of arrays."""
    return BEGIN.match(head) is not None and not NEXT.search(head)


def json_columns_log(file: Path) -> TableLog | None:
    """Return the log of a file, None if it holds no columns of one length; raise LogError if it cannot be read."""
    if file.stat().st_size > limit(MOST_BYTES):
        raise LogError(f"is JSON of more than {limit(MOST_BYTES)} bytes; write it as CSV or Parquet", path=file)
    with opened(file) as content, reading(file, NAME):
        tables = list(_tables(file, file.stem, json.loads(content.read())))
    return array_log(file, NAME, tables) if tables else None


def _tables(file: Path, name: str, value: Mapping[str, Any]) -> Iterator[Table]:
    if set(value) == {"columns", "index", "data"}:  # pandas' orient="split"
        value = dict(zip(value["columns"], map(list, zip(*value["data"], strict=True)), strict=True))
    by_length: dict[int, dict[str, Column]] = {}
    for label, given in value.items():
        inner = cast("Mapping[str, Any]", given if isinstance(given, dict) else {})
        cells = cast("Sequence[Any]", [*inner.values()] if "0" in inner else given)
        if isinstance(cells, list):
            by_length.setdefault(len(cells), {})[label] = pd.Series(cells).to_numpy()
        elif inner:
            yield from _tables(file, label if name == file.stem else f"{name}/{label}", inner)
    for rows, columns in by_length.items():
        if rows > 1 and len(columns) > 1:
            texts = frozenset(label for label, column in columns.items() if column.dtype.kind in TEXT)
            reads: Mapping[str, Callable[[], Column]]
            reads = {label: lambda column=column: column for label, column in columns.items()}
            topic = f"{name}/{rows}_rows" if len(by_length) > 1 else name
            yield Table(file, topic, rows, reads, texts=texts)
