"""A text file that holds several tables, one below the other: each is copied into a file of its own, and all are read.

Between two tables is a blank line, a title or a comment. A copy has the lines of its table at their old numbers. The
sheets of a workbook are tables, too.
"""

import csv
import re
from collections.abc import Iterable, Iterator
from contextlib import ExitStack
from datetime import datetime
from io import StringIO
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple
from zipfile import ZipFile, is_zipfile

from usbldr.io.file_access.file_view import BLOCK_BYTES
from usbldr.io.file_access.open_file import WESTERN, opened, text_lines
from usbldr.io.file_access.optional_library import library, reading
from usbldr.io.findings import Finding
from usbldr.io.formats.compressed_log import CopiedLog, Copies, written
from usbldr.io.limits import UnpackingBudget, note_copy
from usbldr.io.messages.field_names import words_of
from usbldr.io.tables.csv_begin import BLANKS, COMMENTS, cells_of, is_unit, is_value, separator_of
from usbldr.io.tables.csv_log import csv_log
from usbldr.io.tables.date_times import foreign_time

ANOTHER = re.compile(
    rb"""[\r\n][ \t"]*[-+.]?\d[^\r\n]*+[\r\n][\s,;|"]*+[A-Za-z[#%=*\x80-\xff]"""
    rb"""|[\r\n]"?[A-Za-z]\w*"?[,;\t|][ "]*\d[^\r\n]*+(\r?\n)++"""
    rb"""("?[A-Za-z]\w*"?[,;\t|][ "]*[A-Za-z]|[\s,;|"]*+[\[#%=*])"""
)
"""A row of numbers, perhaps behind a sensor's name, and behind it the beginning of a title or of names."""
PAIR = re.compile(r"\w\s*[:=]\s*\w")  # a word and its value, which is no title
OVERLAP = 4096  # [bytes] of two blocks that are searched: longer than two lines
MOST_TABLES = 100  # by judgement: more are records of words
LONGEST_TITLE = 40  # [characters] a longer one is a sentence


NO_NAME = re.compile(r"[^\w .-]|^\.+")  # what no file of a sheet has in its name


class StackedTable(NamedTuple):
    """One of several tables in a file."""

    line: int  # behind the table before, from 0
    kind: tuple[str, tuple[str, ...]]  # title, empty if it has none, and names: the same in all parts of a table
    names_at: int  # line


def stacked_log(path: Path) -> CopiedLog | None:
    """Return the log of a file of several tables, None if it holds one alone."""
    tables = list(_tables(path)) if _goes_on_with_words(path) else []
    kinds = list(dict.fromkeys(table.kind for table in tables))
    if len({names for _, names in kinds}) < 2 or len(kinds) > MOST_TABLES:
        return None
    titles = [title or f"{path.stem}_{number}" for number, (title, _) in enumerate(kinds, 1)]
    titles = [f"{title}_{k}" if titles.count(title) > 1 else title for k, title in enumerate(titles, 1)]
    text = f"the file holds {len(kinds)} tables, one below the other: {', '.join(titles)}"

    def copy(folder: Path) -> Copies:
        copies = [folder / f"{title}.csv" for title in titles]
        lines = enumerate(text_lines(path, WESTERN))
        with ExitStack() as opened_files:
            files = {
                kind: opened_files.enter_context(written(to, path)) for kind, to in zip(kinds, copies, strict=True)
            }
            done = dict.fromkeys(kinds, 0)  # lines
            for table, end in zip(tables, [*(table.line for table in tables[1:]), None], strict=True):
                files[table.kind].write(b"#\n" * (table.line - done[table.kind]))
                for number, line in islice(lines, None if end is None else end - table.line):
                    files[table.kind].write((line if number >= table.names_at else f"# {line}").encode())
                done[table.kind] = end or 0
        for to in copies:
            note_copy(to, path, min(1.0, to.stat().st_size / path.stat().st_size))
        return dict.fromkeys(copies, path), [Finding("CONCATENATED", text)]

    return CopiedLog(path, ", tables below each other", copy, lambda copies: csv_log(copies[0].parent))


def workbook_log(path: Path) -> CopiedLog | None:
    """Return the log of a spreadsheet's file, None of another zip archive; raise UsageError without openpyxl."""
    with reading(path, "a spreadsheet"):
        sizes = {part.filename: part.file_size for part in ZipFile(path).infolist()} if is_zipfile(path) else {}
    if "xl/workbook.xml" not in sizes:
        return None
    budget = UnpackingBudget(path, path.stat().st_size)
    budget.take_bytes(sum(sizes.values()))
    openpyxl = library("openpyxl", "Spreadsheets", "excel", path)

    def copy(folder: Path) -> Copies:
        copies: dict[Path, Path] = {}
        with reading(path, "a spreadsheet"), opened(path) as content:
            sheets = openpyxl.load_workbook(content, read_only=True, data_only=True).worksheets
            for number, sheet in enumerate(sheets, 1):
                name = NO_NAME.sub("_", sheet.title) if len(sheets) > 1 else path.stem  # of a hostile file "../x"
                to = folder / f"{name}.csv"
                to = folder / f"{name}_{number}.csv" if to in copies else to
                sheet.reset_dimensions()  # else each row is filled up to the farthest cell of all
                with written(to, path) as file:
                    for row in sheet.iter_rows():
                        line = _line(row)
                        budget.take_bytes(len(line))
                        file.write(line)
                note_copy(to, path)
                copies[to] = path
        return copies, []

    return CopiedLog(path, ", sheets of a workbook", copy, lambda copies: csv_log(copies[0].parent))


def _line(row: Iterable[Any]) -> bytes:
    """Return the cells of a row as a line of CSV, without the empty ones behind the last."""
    cells, line = list(map(_shown, row)), StringIO()
    while cells and cells[-1] is None:
        cells.pop()
    csv.writer(line).writerow(cells)
    return line.getvalue().encode()


def _shown(cell: Any) -> object:
    """Return the value of a cell; of one that shows no time of day the date."""
    dated = isinstance(cell.value, datetime) and not {"h", "s"} & {*cell.number_format.lower()}
    return cell.value.date() if dated else cell.value


def _goes_on_with_words(path: Path) -> bool:
    with opened(path) as file:
        last = b""
        while block := file.read(BLOCK_BYTES):
            if ANOTHER.search((last + block).replace(b"\0", b"")):  # also in UTF-16
                return True
            last = block[-OVERLAP:]
    return False


def _tables(path: Path) -> Iterator[StackedTable]:
    """Yield the tables of a file: names, perhaps units, and a row that begins with a number or time.

    The lines before the first table, and those behind a break, belong to the table that follows.
    """
    begin: int | None = 0  # of the lines that belong to a table to come; None: these are its rows
    title, before = "", list[tuple[int, list[str], str]]()  # line, cells, and the title before it
    for number, line in enumerate(text_lines(path, WESTERN)):
        text = line.strip(f"{BLANKS},;|\r\n")
        separator = separator_of(text) if separator_of(text) in text else None
        cells = cells_of(line if separator else text, separator) or [""]
        remark = not text or text.startswith((*COMMENTS, "["))
        titled = title
        if remark or (separator is None and not is_value(cells[0])):  # a title, or names between blanks
            begin = number if begin is None else begin
            words = "" if PAIR.search(text) else words_of(text[: 2 * LONGEST_TITLE].strip("[]#%/=*:- "))
            title = re.sub(r"\W+", "_", words) or title
        if begin is None or remark:
            continue
        if _is_cell(cells[0]) or (len(cells) > 2 and cells[1] and _is_cell(cells[1])):  # behind a sensor's name
            for place, names, named in reversed(before):
                units = len(before) > 1 and any(map(is_unit, names))
                if len(names) == len(set(names)) == len(cells) > 1 and not (units or any(map(_is_cell, names))):
                    named = named if len(named) < LONGEST_TITLE else ""
                    yield StackedTable(begin, (named, tuple(names)), place)
                    break
            begin, title, before = None, "", []
        else:
            before = [*before[-1:], (number, cells, titled)]


def _is_cell(text: str) -> bool:
    return not text or is_value(text) or foreign_time(text)
