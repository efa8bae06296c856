"""CSV files as columns of text: their separator, their names and their rows."""

import csv
import re
from array import array
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from itertools import chain, islice, pairwise
from pathlib import Path
from typing import NamedTuple

from usbldr.filters.errors import LogError
from usbldr.io.file_access.decompression import compression_of, first_bytes
from usbldr.io.file_access.open_file import (
    CONTROL,
    HEAD_BYTES,
    WESTERN,
    begin_of,
    filled_files,
    head_lines,
    opened,
    text_lines,
)
from usbldr.io.tables.clean_csv import clean_columns
from usbldr.io.tables.csv_sheets import plain_names
from usbldr.io.tables.date_order import stated_order
from usbldr.io.tables.date_times import foreign_time, named_zone
from usbldr.io.tables.text_table import TextColumn, TextTable, listed
from usbldr.io.tables.time_columns import ISO
from usbldr.io.tables.unnamed_columns import is_number, unnamed_columns
from usbldr.io.units import named_unit

PREAMBLE = 100  # [lines] among which the column names are looked for
SEPARATOR_LINE = re.compile(r'"?sep=.?"?\s*', re.IGNORECASE)  # of Excel, before the column names
MOST_BREAKS = 20  # [lines] of a row whose quoted cell has line breaks
COMMENT = "# "  # what the column names may follow
COMMENTS = ("#", "%", "//")  # with which a line begins that is no row
REMARKS = (*COMMENTS, ";")  # with which a line before the column names begins that is none
PIECE = 10_000  # [rows] split into cells at once: some megabytes
BLANKS = " \t\v\f\xa0"  # that may surround a cell


def text_files(folder: Path) -> Iterator[Path]:
    """Yield the files of a folder that look like CSV, by name."""
    from usbldr.io.instruments.json_lines_log import looks_like_json_lines
    from usbldr.io.instruments.nmea_log import form_of
    from usbldr.io.instruments.pd6_log import looks_like_pd6

    others = (form_of, looks_like_json_lines, looks_like_pd6)
    for file in filled_files(folder):
        if file.suffix not in (".toml", ".md", ".json"):
            head, _ = begin_of(file, HEAD_BYTES)
            if looks_like_csv(head) and not any(holds(head) for holds in others):
                yield file


def compressed_texts(folder: Path) -> dict[Path, str]:
    """Return the compressed files of a folder whose contents look like CSV, and their compressions.

    Files whose decompressed copies lie beside them do not count. One that is named .csv and cannot be decompressed
    does, so that its damage is an error.
    """
    found: dict[Path, str] = {}
    for file in filled_files(folder):
        if file.with_suffix("").is_file():
            continue
        with opened(file) as content:
            if compression := compression_of(content.peek(16)):
                head = first_bytes(content, compression, HEAD_BYTES)
                if looks_like_csv(head) if head else Path(file.stem).suffix == ".csv":
                    found[file] = compression
    return found


def looks_like_csv(head: bytes) -> bool:
    """Return whether a file's first bytes are text with a line of column names, or comments alone."""
    lines = head_lines(head)
    if len(lines) > PREAMBLE and all(line.startswith(REMARKS) for line in lines[:-1]):
        return lines[0].startswith("#")
    header = lines[_header_place(lines)] if lines else ""
    printable = header.replace("\t", " ").isprintable() and any(char.isalpha() for char in header)
    return printable and (_separator(header) in header or has_blank_columns(head, whole=True))


def has_blank_columns(head: bytes, whole: bool = False) -> bool:
    """Return whether a file's first bytes are names between blanks, and a row with numbers; ``whole``: as many."""
    lines = [line.lstrip(COMMENT).split() for line in head_lines(head) if line.strip()]
    names, row = (*lines, [], [])[:2]
    named = unnamed_columns(Path(), names) is None and not any(map(_is_value, names))  # else those of a format
    numbers = sum(map(_is_value, row))
    return named and (numbers == len(row) == len(names) > 1 if whole else len(names) > 1 and numbers > 0)


def lacks_header(head: bytes) -> bool:
    """Return whether a file's first bytes are columns of numbers without names."""
    first = next(iter(head_lines(head)), "")
    cells = first.split(_separator(first))
    return len(cells) > 1 and all(map(_is_value, cells))


def _is_value(cell: str) -> bool:
    cell = cell.strip()
    return is_number(_with_point(cell)) or ISO.fullmatch(cell) is not None


def _header_place(lines: Sequence[str]) -> int:
    """Return the place of the column names among the first lines: before the first row, known by a number in it.

    Comments, a title, and words with their values may precede them, units follow; so a row that begins with a time or
    number comes first. If no row is found, it is the first line that is not blank.
    """
    filled = [k for k, line in enumerate(lines) if line.strip() and not SEPARATOR_LINE.fullmatch(line)]
    names, width, worded = filled[0] if filled else 0, 0, -1
    for k, following in pairwise(filled):
        separator = _separator(lines[k])
        cells, row = (_cells(lines[place].lstrip(COMMENT), separator) for place in (k, following))
        title = len(cells) > 1 and sum(map(bool, cells)) < 2  # a spreadsheet fills its line with separators
        if title or any(map(_is_value, cells)):
            width = 0
            continue
        if len(cells) != width or lines[names].startswith("#"):
            names, width = k, len(cells)
        if 1 < len(cells) == len(row) and any(map(_is_value, row)):
            if _is_value(row[0]) or foreign_time(row[0]):
                return names
            worded = names if worded < 0 else worded
    return worded if worded >= 0 else filled[0] if filled else 0


def _separator(line: str) -> str:
    """Return the separator of a file's columns by its first line; with semicolons, numbers have a decimal comma."""
    return max(",;\t", key=line.count)


def _with_point(cell: str) -> str:
    return cell.replace(",", ".") if re.fullmatch(r"[+-]?\d*,\d+([eE][+-]?\d+)?", cell) else cell


def header_and_row(file: Path) -> tuple[list[str], list[str]]:
    """Return a file's column names as written, and the cells of its first row."""
    names, separator, lines, *_ = _begun(file)
    cells = _cells(next((line for line in lines if line.strip()), ""), separator)
    return names, cells if separator in (",", None) else [_with_point(cell) for cell in cells]


class _Begin(NamedTuple):
    """The beginning of a file."""

    names: list[str]  # of its columns
    separator: str | None  # None: blanks
    lines: Iterator[str]  # behind the names, and behind a line of their units
    number: int  # of the last line before these
    spoilt: Mapping[int, str]  # line before them -> why it is none


def _begun(file: Path, units_are_row: bool = False) -> _Begin:
    """Return the beginning of a file: what is before its column names, if it is text, is a title or comments."""
    lines = text_lines(file, WESTERN)
    begun = list(islice(lines, PREAMBLE))
    comments = 0  # before the last ones: there may be thousands
    while len(begun) == PREAMBLE and all(line.startswith(REMARKS) for line in begun):
        comments += len(begun) - 1
        begun = [begun[-1], *islice(lines, PREAMBLE - 1)]
    clean = [line.replace("\0", "") for line in begun]
    place = _header_place(clean)
    first = clean[place].lstrip(COMMENT) if begun else ""
    separator = _separator(first) if _separator(first) in first else None
    spoilt = {k: "it is no text" for k, line in enumerate(begun[:place], 1) if CONTROL.search(line.replace("\0", ""))}
    names, rows = _cells(first, separator), place + 1
    while not units_are_row and rows < len(begun):
        joined = _joined(names, _cells(clean[rows], separator))
        if joined is None:
            break
        names, rows = joined, rows + 1
    while len(names) > 1 and not names[-1]:
        names.pop()  # of separators at the end of the line
    return _Begin(names, separator, chain(begun[rows:], lines), comments + rows, spoilt)


def _joined(names: Sequence[str], cells: Sequence[str]) -> list[str] | None:
    """Return the names of columns with what another line adds to them, None if that line is none of names or units.

    A line of units, or of dashes, has no names. A name that stands over several columns, of which the others are blank
    or repeat it, goes before the names of each.
    """
    if len(names) != len(cells) or len(cells) < 2 or any(_is_value(cell) or foreign_time(cell) for cell in cells):
        return None
    bare = [cell.strip("[]() ") for cell in cells]
    stated = [named_unit(f"x [{unit}]") for unit in bare]
    units = [
        f" [{u}]" if (one.dimension and one.unit == u) or stated_order(u) is not None or named_zone(f"[{u}]") else ""
        for u, one in zip(bare, stated, strict=True)
    ]
    of_names = any(not unit and named_unit(cell).unit for cell, unit in zip(cells, units, strict=True))
    if not of_names and (any(units) or not any(cell.strip("-") for cell in cells)):
        return [name if named_unit(name).unit else name + unit for name, unit in zip(names, units, strict=True)]
    over, found = "", list[str]()
    for name, cell, unit in zip(names, cells, units, strict=True):
        over = name or over
        found.append(over + unit if unit else f"{over} {cell}".strip() if cell not in ("", over) else name)
    named = list(filter(None, found))
    over_several = len(set(names[1:]) - {""}) < len(names[1:])
    return found if over_several and len(set(named)) == len(named) else None


class _Rows:
    """Which of a file's lines are rows of its table, and their cells in the order of its columns."""

    def __init__(self, file: Path, header: Sequence[str], separator: str | None) -> None:
        self._file, self._header, self._separator = file, header, separator
        self._order: Sequence[int] | None = None  # of the columns behind another line of names
        self._other = ""  # why rows are those of another table

    def cells(self, line: str) -> Sequence[str] | str:
        """Return the cells of a row, of another line why it is none; empty if it holds no data."""
        cells = _cells(line, self._separator)
        if len(cells) > len(self._header) and len(cells) not in self._wider:
            cells = cells[: len(self._header)]  # separators at the end of the line
        if line.count('"') % 2:
            return "a quotation mark is missing"
        if cells[0].lstrip(COMMENT) in self._header and not any(map(_is_value, cells)):
            return self._names_again([cells[0].lstrip(COMMENT), *cells[1:]])
        if self._other:
            return self._other
        if more := len(cells) - len(self._header):
            commas = self._separator == "," and sum(cell.isdigit() for cell in cells) >= 2 * more > 0
            why = "; decimal commas need another separator of columns, such as semicolons" if commas else ""
            return f"it has {len(cells)} cells, the first line {len(self._header)}{why}"
        return cells if self._order is None else [cells[place] for place in self._order]

    @cached_property
    def _wider(self) -> set[int]:
        """How many cells rows have that go on behind the last column: one was inserted, and no row of them is right."""
        rows = (_cells(line, self._separator) for line in text_lines(self._file, WESTERN))
        return {len(cells) for cells in rows if any(cells[len(self._header) :])}

    def _names_again(self, cells: list[str]) -> str:
        """Take another line of column names, as files that were joined have; their columns may have another order."""
        names = plain_names(cells)
        self._order, self._other = None, ""
        if sorted(names) == sorted(self._header):
            self._order = None if names == list(self._header) else [names.index(name) for name in self._header]
            return ""
        self._other = f"it belongs to a table of other columns ({listed(names)})"
        return self._other


def read_texts(file: Path, units_are_row: bool = False) -> TextTable:
    """Return all cells of a CSV file, or of columns between blanks; raise LogError if a column is there twice.

    A file without names, TUM or .fnv, has the columns of its format. Its last line needs no line end; of any other
    file, such a line is left out, and so is a row with too few or too many cells. Comments are no rows, nor is a line
    of units behind the names, unless ``units_are_row``.
    """
    names, separator, lines, begin, spoilt = _begun(file, units_are_row)
    header = plain_names(names)
    known = unnamed_columns(file, header if separator is None else ())
    if known is not None:
        lines, separator, header, begin = text_lines(file, WESTERN), None, list(known), 0
    twice = [name for name in dict.fromkeys(header) if header.count(name) > 1]
    if twice:
        raise LogError(f"has two columns {twice[0] or 'without a name'} (its columns: {listed(header)})", path=file)
    fast = clean_columns(file, header, begin) if separator == "," else None
    if fast is not None:
        count = len(next(iter(fast.values())))
        return TextTable(fast, range(begin + 1, begin + 1 + count), spoilt)
    texts = {name: TextColumn() for name in header}
    rows: list[Sequence[str]] = []
    numbered = array("q")
    left_out: dict[int, str] = dict(spoilt if known is None else {})
    cut = 0
    table = _Rows(file, header, separator)
    for number, line in _whole_rows(enumerate(lines, start=begin + 1), len(header), separator):
        blank = not line.strip(f"{separator or ''}{BLANKS}\r\n")
        if blank or line.startswith(COMMENTS) or (known is not None and line.split() == header):
            continue
        cut = 0 if line.endswith("\n") or known is not None else number
        cells = "" if cut else table.cells(line)
        if isinstance(cells, str):
            left_out |= {number: cells} if cells else {}
            continue
        rows.append(cells)
        numbered.append(number)
        if len(rows) == PIECE:
            _add(texts, rows, separator)
            rows = []
    _add(texts, rows, separator)
    return TextTable(texts, numbered, left_out, cut, separator in (",", None))


def _whole_rows(lines: Iterator[tuple[int, str]], width: int, separator: str | None) -> Iterator[tuple[int, str]]:
    """Yield the lines with their numbers; those that are one row, by line breaks in a quoted cell, as one with blanks.

    A row is so many cells wide, and no line of it is so alone: else a quotation mark is missing.
    """
    ahead: deque[tuple[int, str]] = deque()
    while (one := ahead.popleft() if ahead else next(lines, None)) is not None:
        number, line = one
        if line.count('"') % 2 and separator is not None:
            ahead.extend(islice(lines, MOST_BREAKS - len(ahead)))
            last = next((k for k, (_, later) in enumerate(ahead) if later.count('"') % 2), None)
            if last is not None:
                whole = " ".join([line.rstrip(), *(ahead[k][1].rstrip() for k in range(last)), ahead[last][1]])
                rows = any(ahead[k][1].count(separator) == width - 1 for k in range(last + 1))
                if not rows and len(_cells(whole, separator)) == width:
                    line = whole
                    for _ in range(last + 1):
                        ahead.popleft()
        yield number, line


def _add(texts: Mapping[str, TextColumn], rows: Sequence[Sequence[str]], separator: str | None) -> None:
    for column, cells in zip(texts.values(), zip(*rows, strict=True), strict=bool(rows)):
        column.add(cells if separator in (",", None) else [_with_point(cell) for cell in cells])


def _cells(line: str, separator: str | None) -> list[str]:
    if separator is None:
        return line.split()
    if '"' in line:
        line = re.sub(rf'(^|{re.escape(separator)})="', r'\1"', line)  # of Excel: ="1.2" is a text
        return [cell.strip() for cell in next(csv.reader([line], delimiter=separator, skipinitialspace=True))]
    cells = line.rstrip("\r\n").split(separator)
    return [cell.strip() for cell in cells] if any(blank in line for blank in BLANKS) else cells


def column(texts: Mapping[str, Sequence[str]], name: str, file: Path) -> Sequence[str]:
    """Return one column; raise LogError with the header if it is missing."""
    if name not in texts:
        raise LogError(f"has no column {name} (its columns: {listed(list(texts))})", path=file)
    return texts[name]
