"""Tables in Parquet files: a file, or a folder named .parquet, is a table, a folder of files is a log.

Members of structures are named with dots. Arrow files, also called Feather, hold the same tables.
"""

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np

from usbldr.filters.errors import LogError
from usbldr.io.file_access.container_ends import PARQUET, places_of
from usbldr.io.file_access.file_view import FileView
from usbldr.io.file_access.open_file import filled_files, opened
from usbldr.io.file_access.optional_library import library, reading
from usbldr.io.limits import UnpackingBudget
from usbldr.io.reader import Column
from usbldr.io.tables.array_tables import MOST_ELEMENTS, Table, array_log
from usbldr.io.tables.table_log import TableLog

NAME, ARROW = "Parquet", "Arrow"
PYARROW = "pyarrow.parquet"
ENDING = ".parquet"
LOOKED_AT = {"STRING", "DATE", "TIME", "TIMESTAMP", "INT96"}  # types of texts, dates and times


def parquet_files(folder: Path) -> Iterator[Path]:
    """Yield the Parquet files of a folder by name, whatever they are called: those that hold one alone."""
    for file in filled_files(folder):
        with opened(file) as content:
            data = FileView(content.fileno())
            if data[: len(PARQUET)] == PARQUET and places_of(data) == [(0, len(data), PARQUET)]:
                yield file


def is_parted(folder: Path) -> bool:
    """Return whether a folder is one table in parts, as Spark and Dask write it: named .parquet, and of such files."""
    if folder.suffix != ENDING or not folder.is_dir():
        return False
    parts = {*parquet_files(folder)}
    return bool(parts) and all(file in parts for file in folder.iterdir() if file.is_dir() or file.suffix == ENDING)


def parquet_log(file: Path) -> TableLog:
    """Return the log of a file; raise as `parquet_table` does."""
    return array_log(file, NAME, [parquet_table(file)])


def arrow_log(file: Path) -> TableLog:
    """Return the log of an Arrow file, whose table is read as the same in Parquet; raise as `parquet_table` does."""
    arrow, ipc, parquet = (library(one, "Arrow files", "parquet", file) for one in ("pyarrow", "pyarrow.ipc", PYARROW))
    budget, copy = UnpackingBudget(file, file.stat().st_size), arrow.BufferOutputStream()
    with reading(file, ARROW), arrow.OSFile(str(file)) as source:
        read = ipc.open_file(source)
        kept = [field for field in read.schema if _in_parquet(arrow, parquet, field)]
        with parquet.ParquetWriter(copy, arrow.schema(kept)) as written:
            for place in range(read.num_record_batches):
                budget.take_bytes((batch := read.get_batch(place)).nbytes)
                written.write_batch(batch.select([field.name for field in kept]))
    why = "its type is {}; write it as numbers or texts"
    others = {field.name: why.format(field.type) for field in read.schema if field not in kept}
    table = parquet_table(file, content=arrow.BufferReader(copy.getvalue()))
    return array_log(file, ARROW, [replace(table, left_out={**table.left_out, **others})])


def _in_parquet(arrow: Any, parquet: Any, field: Any) -> bool:
    """Return whether Parquet has the type of a column: it has no unions."""
    with suppress(arrow.ArrowNotImplementedError):
        parquet.ParquetWriter(arrow.BufferOutputStream(), arrow.schema([field])).close()
        return True
    return False


def parquet_table(file: Path, name: str = "", content: Any = None) -> Table:
    """Return the table of a file, or of its content, by its own or another name.

    Raises LogError if it cannot be read, UsageError without pyarrow.
    """
    arrow = library("pyarrow", "Parquet files", "parquet", file)
    budget = UnpackingBudget(file, file.stat().st_size)
    parquet = library(PYARROW, "Parquet files", "parquet", file)
    with reading(file, NAME):
        content = parquet.ParquetFile(content or file, page_checksum_verification=True)
        leaves = [content.schema.column(k) for k in range(len(content.schema))]
        places = {leaf.path: k for k, leaf in enumerate(leaves) if leaf.max_repetition_level == 0}
        kinds = {leaf.path: {leaf.logical_type.type, leaf.physical_type} for leaf in leaves}
        texts = frozenset(path for path, kind in kinds.items() if kind & LOOKED_AT)
        lists = dict.fromkeys(leaf.path.partition(".list.")[0] for leaf in leaves if leaf.max_repetition_level)
        rows = int(content.metadata.num_rows)
        lengths = {path: _first_length(content, path) for path in lists}

    def column(path: str) -> Column:
        groups = (content.metadata.row_group(k) for k in range(content.metadata.num_row_groups))
        budget.take_bytes(sum(group.column(places[path]).total_uncompressed_size for group in groups))
        read = content.read([path])
        while arrow.types.is_struct(read.schema.field(0).type):
            read = read.flatten()
        return _values(arrow, read.column(0).combine_chunks())

    def element(path: str, place: int) -> Column:
        read = content.read([path]).column(0).combine_chunks()
        budget.take_bytes(read.nbytes)
        if not (np.asarray(read.value_lengths().fill_null(0)) == lengths[path]).all():
            raise LogError(f"the lists of {path} differ in length; write their elements as columns", path=file)
        return _values(arrow, read.flatten())[place :: lengths[path]]

    columns = {path: lambda path=path: column(path) for path in places}
    for path, length in lengths.items():
        columns |= {f"{path}.{k}": lambda path=path, k=k: element(path, k) for k in range(length)}
    lists = [path for path in lists if not lengths[path]]
    left_out = dict.fromkeys(lists, "it holds a list in each row; write the elements as columns")
    lost = tuple(f"{one} (a list, not read)" for one in lists)
    return Table(file, (name or file.stem).replace("__", "/"), rows, columns, texts, lost, left_out)


def _first_length(content: Any, path: str) -> int:
    """Return how many numbers the first list of a column holds; 0 for many, for none and for lists of others."""
    batch = next(content.iter_batches(1, columns=[path]), None)
    first: Any = batch.column(0)[0].as_py() if batch is not None and batch.num_columns == 1 else None
    elements = cast("list[object]", first if isinstance(first, list) else [])
    plain = all(isinstance(one, int | float) for one in elements)
    return len(elements) if plain and len(elements) <= MOST_ELEMENTS else 0


def _values(arrow: Any, column: Any) -> Column:
    """Return a column as NumPy has it; masked, if it holds integers and rows without a value."""
    kinds, kind = arrow.types, column.type
    if kinds.is_date(kind) or kinds.is_time(kind):  # which belong together, as in the cells of a CSV file
        return column.cast(arrow.string()).to_numpy(zero_copy_only=False)
    if kinds.is_timestamp(kind):
        return column.cast(arrow.timestamp("ns")).to_numpy(zero_copy_only=False)
    if kinds.is_duration(kind):  # since 1970, as times of day without a date
        column = column.cast(arrow.duration("ns")).cast(arrow.int64()).cast(arrow.timestamp("ns"))
        return column.to_numpy(zero_copy_only=False)
    if kinds.is_decimal(kind):
        column = column.cast(arrow.float64())
    elif kinds.is_boolean(kind):
        column = column.cast(arrow.uint8())
    if not column.null_count or not kinds.is_integer(column.type):
        return column.to_numpy(zero_copy_only=False)
    empty = column.is_null().to_numpy(zero_copy_only=False)
    return np.ma.array(column.fill_null(0).to_numpy(zero_copy_only=False), mask=empty)
