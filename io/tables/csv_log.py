"""CSV logs: a folder with one text file for each topic, or one file; its stem is the topic ("dvl.csv" is "/dvl").

A "__" in a stem is a "/" of the topic. A file in a folder of its own has that folder's name. csv_sheets lists the
columns that are understood.
"""

from collections.abc import Sequence
from functools import cache
from pathlib import Path

from usbldr.io.tables.csv_begin import begin_of_table, header_and_row
from usbldr.io.tables.csv_text import read_texts, text_files
from usbldr.io.tables.table_log import TableLog, TableSource
from usbldr.io.tables.text_table import TextTable


def csv_log(path: Path, files: Sequence[Path] = (), cells: TextTable | None = None) -> TableLog:
    """Return the log of a file or a folder; if the caller knows them, which files to read, or the only one's cells."""
    texts = files or (list(text_files(path)) if path.is_dir() else [path])
    kind = "CSV folder" if path.is_dir() else "CSV file"
    return TableLog(path, kind, [_source(file, _stem(path, file, files), texts, cells) for file in texts])


def _stem(path: Path, file: Path, files: Sequence[Path]) -> str:
    """Return the name of a file, if it lies in a folder within the log's the name of that, alone or before it."""
    folder = file.parent
    if folder == path or folder.parent != path:  # "." is its own parent
        return file.stem
    alone = [other.parent for other in files].count(folder) == 1
    return folder.name if alone else f"{folder.name}__{file.stem}"


def _source(file: Path, stem: str, beside: Sequence[Path], cells: TextTable | None) -> TableSource:
    def begin() -> tuple[Sequence[str], Sequence[str]]:
        if cells is None:
            return header_and_row(file, beside)
        return list(cells.columns), [next(iter(column), "") for column in cells.columns.values()]

    @cache
    def read() -> TextTable:
        return cells or read_texts(file, beside=beside)

    return TableSource(
        file=file,
        name=stem.replace("__", "/"),
        stem=stem,
        title=file.name,
        where="",
        row="line",
        encoding="csv",
        begin=begin,
        read=read,
        remarks=lambda: begin_of_table(file).remarks,
    )
