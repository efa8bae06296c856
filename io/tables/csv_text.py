"""CSV files as columns of text: which files of a folder they are, and which of their lines are rows."""

import re
from array import array
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from itertools import islice
from pathlib import Path

from usbldr.filters.errors import LogError
from usbldr.io.file_access.decompression import compression_of, first_bytes
from usbldr.io.file_access.open_file import HEAD_BYTES, WESTERN, begin_of, filled_files, opened, text_lines
from usbldr.io.tables.cells import WORDS
from usbldr.io.tables.clean_csv import clean_columns
from usbldr.io.tables.csv_begin import (
    BLANKS,
    BY_BLANKS,
    COMMENTS,
    bare,
    begin_of_table,
    cells_of,
    is_value,
    looks_like_csv,
    with_point,
)
from usbldr.io.tables.csv_sheets import plain_names
from usbldr.io.tables.date_times import foreign_time
from usbldr.io.tables.text_table import TextColumn, TextTable, listed
from usbldr.io.tables.unnamed_columns import TUM, unnamed_columns

MOST_BREAKS = 20  # [lines] of a row whose quoted cell has line breaks
RULE = re.compile(r"[|+:\s]*-{3,}[-|+:\s]*")
"""A line of dashes, which parts the names of columns from the rows where programs print tables."""
CLOSING = re.compile(r"\W*(\d+ )?[^\W\d]{3}.*", re.DOTALL)
"""Words behind the last row, as programs write: "(500 rows)", "-- end of file --", "Total: 500 records"."""
PIECE = 10_000  # [rows] split into cells at once: some megabytes


def text_files(folder: Path) -> Iterator[Path]:
    """Yield the files of a folder that look like CSV, by name."""
    from usbldr.io.instruments.nmea_log import form_of
    from usbldr.io.instruments.pd6_log import looks_like_pd6
    from usbldr.io.tables.json_lines_log import looks_like_json_lines

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


class _Rows:
    """Which of a file's lines are rows of its table, and their cells in the order of its columns."""

    def __init__(self, file: Path, header: Sequence[str], separator: str | None) -> None:
        self._file, self._header, self._separator = file, header, separator
        self._order: Sequence[int] | None = None  # of the columns behind another line of names
        self._other = ""  # why rows are those of another table

    def cells(self, line: str) -> Sequence[str] | str:
        """Return the cells of a row, of another line why it is none; empty if it holds no data."""
        cells = cells_of(line, self._separator)
        if len(cells) > len(self._header) and len(cells) not in self._wider:
            cells = cells[: len(self._header)]  # separators at the end of the line
        if line.count('"') % 2:
            return "a quotation mark is missing"
        if bare(cells[0]) in self._header and not any(map(is_value, cells)):
            self._names_again([bare(cells[0]), *cells[1:]])
            return ""  # of a table without rows nothing is lost
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
        rows = (cells_of(line, self._separator) for line in text_lines(self._file, WESTERN))
        return {len(cells) for cells in rows if any(cells[len(self._header) :])}

    def _names_again(self, cells: list[str]) -> None:
        """Take another line of column names, as files that were joined have; their columns may have another order."""
        names = plain_names(cells)
        same = sorted(names) == sorted(self._header)
        self._order = [names.index(name) for name in self._header] if same and names != self._header else None
        other = f"it belongs to a table of other columns ({listed(names)}); save each table as a file of its own"
        self._other = "" if same else other


def read_texts(file: Path, units_are_row: bool = False, beside: Sequence[Path] = ()) -> TextTable:
    """Return all cells of a CSV file, or of columns between blanks; raise LogError if a column is there twice.

    A file without names, TUM or .fnv, has the columns of its format. Its last line needs no line end; of any other
    file, such a line is left out, and so is a row with too few or too many cells. Comments are no rows, nor are words
    behind the last row, nor a line of units behind the names, unless ``units_are_row``.
    """
    names, separator, lines, begin, spoilt, _, commas = begin_of_table(file, units_are_row, beside)
    header = plain_names(names)
    known = unnamed_columns(file, header if separator in BY_BLANKS else ())
    if known is None and separator in BY_BLANKS and len(header) != len(TUM):  # of a comment, or the rest of a row
        begun = (line.split() for line in text_lines(file, WESTERN) if line.strip() and not line.startswith(COMMENTS))
        known = next(filter(None, (unnamed_columns(file, row) for row in islice(begun, 2))), None)
    if known is not None:
        lines, separator, header, begin, commas = text_lines(file, WESTERN), None, list(known), 0, False
    twice = [name for name in dict.fromkeys(header) if header.count(name) > 1]
    if twice:
        raise LogError(f"has two columns {twice[0]} (its columns: {listed(header)}); rename one", path=file)
    fast = clean_columns(file, header, begin) if separator == "," else None
    if fast is not None:
        count = len(next(iter(fast.values())))
        return TextTable(fast, range(begin + 1, begin + 1 + count), spoilt)
    texts = {name: TextColumn() for name in header}
    rows: list[Sequence[str]] = []
    numbered = array("q")
    left_out: dict[int, str] = dict(spoilt if known is None else {})
    closing: dict[int, str] = {}  # lines of words -> why they are no rows, if others follow
    cut, first = 0, ""
    table = _Rows(file, header, separator)
    for number, line in _whole_rows(enumerate(lines, start=begin + 1), len(header), separator):
        blank = not line.strip(f"{separator or ''}{BLANKS}\r\n")
        if blank or line.startswith(COMMENTS) or RULE.fullmatch(line) or (known is not None and line.split() == header):
            continue
        if (is_value(first) or foreign_time(first)) and _closes(line, separator):
            closing[number] = "it holds words, and rows follow"
            continue
        cut = 0 if line.endswith("\n") or known is not None else number
        cells = "" if cut else table.cells(line)
        if isinstance(cells, str):
            left_out |= {number: cells} if cells else {}
            continue
        left_out |= closing
        closing, first = {}, cells[0]
        rows.append(cells)
        numbered.append(number)
        if len(rows) == PIECE:
            _add(texts, rows, commas)
            rows = []
    _add(texts, rows, commas)
    return TextTable(texts, numbered, left_out, cut, not commas)


def _closes(line: str, separator: str | None) -> bool:
    """Return whether a line holds words in one cell: behind rows that begin with a value, it is none of them."""
    text = line.strip(f"{separator or ''}{BLANKS}\r\n")
    alone = separator not in text if separator else text.startswith(("(", "-", "*"))
    return alone and CLOSING.fullmatch(text) is not None and not is_value(text) and text.lower() not in WORDS


def _whole_rows(lines: Iterator[tuple[int, str]], width: int, separator: str | None) -> Iterator[tuple[int, str]]:
    """Yield the lines with their numbers; those that are one row, by line breaks in a quoted cell, as one with blanks.

    A row is so many cells wide, and no line of it is so alone: else a quotation mark is missing.
    """
    ahead: deque[tuple[int, str]] = deque()
    while (one := ahead.popleft() if ahead else next(lines, None)) is not None:
        number, line = one
        if line.count('"') % 2 and separator not in BY_BLANKS:
            ahead.extend(islice(lines, MOST_BREAKS - len(ahead)))
            last = next((k for k, (_, later) in enumerate(ahead) if later.count('"') % 2), None)
            if last is not None:
                whole = " ".join([line.rstrip(), *(ahead[k][1].rstrip() for k in range(last)), ahead[last][1]])
                rows = any(ahead[k][1].count(separator) == width - 1 for k in range(last + 1))
                if not rows and len(cells_of(whole, separator)) == width:
                    line = whole
                    for _ in range(last + 1):
                        ahead.popleft()
        yield number, line


def _add(texts: Mapping[str, TextColumn], rows: Sequence[Sequence[str]], decimal_commas: bool) -> None:
    for column, cells in zip(texts.values(), zip(*rows, strict=True), strict=bool(rows)):
        column.add([with_point(cell) for cell in cells] if decimal_commas else cells)
