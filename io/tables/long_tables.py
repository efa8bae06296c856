"""Long tables, one value a row, as databases export them ("time,name,value"): as tables with a column for each name."""

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import NamedTuple

from usbldr.io.messages.field_names import named_column
from usbldr.io.messages.layouts import FLAG_WORDS
from usbldr.io.tables.date_times import foreign_time
from usbldr.io.tables.text_table import TextTable
from usbldr.io.tables.time_columns import ISO
from usbldr.io.tables.unnamed_columns import is_number

DEVICES = ("sensor", "device", "source", "instrument")  # whose names go before those of quantities, if they differ
NAMES = (
    *("measurement", "topic", "name", "series", "tag", "channel", "signal", "variable", "parameter", "metric"),
    *("field", "quantity"),
)
"""Columns of names, in the order in which they make one."""
FLAGS = ("quality", "status", "valid")  # columns of words that may call a value invalid
MOST_NAMES = 500  # of quantities: more are those of something else


class LongColumns(NamedTuple):
    """The columns of a long table as written."""

    names: Sequence[str]
    value: str
    unit: str | None


def long_columns(header: Sequence[str]) -> LongColumns | None:
    """Return the columns of a long table, None if it is none: it has one of names, and one of values."""
    plain = {name.strip("_").lower(): name for name in header}
    names = [plain[name] for name in (*DEVICES, *NAMES) if name in plain]
    unit = plain.get("unit", plain.get("units"))
    return LongColumns(names, plain["value"], unit) if names and "value" in plain else None


def widened(table: TextTable, long: LongColumns) -> TextTable:
    """Return a table with a column for each name; values of one time are a row.

    Unchanged if no column holds times, or too many names are there. A name that comes twice at a time begins a row. If
    the names come one after the other, the rows are in the order of their times.
    """
    columns = {name: list(cells) for name, cells in table.columns.items()}
    times = [name for name, cells in columns.items() if cells and _is_time(name, cells[0])]
    differing = [name for name in long.names if name.strip("_").lower() not in DEVICES or len(set(columns[name])) > 1]
    labels = [" ".join(cells) for cells in zip(*(columns[name] for name in differing or long.names), strict=True)]
    if long.unit:
        units = columns[long.unit]
        labels = [f"{label} [{unit}]" if unit else label for label, unit in zip(labels, units, strict=True)]
    series = list(dict.fromkeys(labels))
    if not times or len(series) > MOST_NAMES:
        return table
    rows: list[tuple[int, tuple[str, ...], dict[str, str]]] = []
    latest: dict[tuple[str, ...], dict[str, str]] = {}
    moments = zip(*(columns[name] for name in times), strict=True)
    flags = next((cells for name, cells in columns.items() if name.strip("_").lower() in FLAGS), [""] * len(labels))
    for line, moment, label, value, flag in zip(table.lines, moments, labels, columns[long.value], flags, strict=True):
        cells = latest.get(moment)
        if cells is None or label in cells:
            cells = latest[moment] = {}
            rows.append((line, moment, cells))
        cells[label] = flag if FLAG_WORDS.get(flag.lower()) == 0 else value  # a word is no number
    if sum(a != b for a, b in pairwise(labels)) < len(series):  # one after the other
        rows.sort(key=lambda row: [(float(cell), "") if is_number(cell) else (0.0, cell) for cell in row[1]])
    wide: Mapping[str, Sequence[str]] = {
        **{name: [moment[k] for _, moment, _ in rows] for k, name in enumerate(times)},
        **{label: [cells.get(label, "") for _, _, cells in rows] for label in series},
    }
    return table._replace(columns=wide, lines=[line for line, *_ in rows])


def _is_time(name: str, cell: str) -> bool:
    column = named_column(name)
    named = column is not None and column.rule.dimension == "time"
    return bool(ISO.fullmatch(cell)) or foreign_time(cell) or (named and is_number(cell))
