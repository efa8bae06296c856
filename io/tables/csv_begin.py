"""The beginning of a CSV file: what separates its columns, their names, and where its rows begin.

Titles, comments, words with their values and lines of units may stand before the first row.
"""

import csv
import re
from collections.abc import Iterator, Mapping, Sequence
from itertools import chain, islice, pairwise
from pathlib import Path
from typing import NamedTuple

from usbldr.io.decoding.date_order import stated_order
from usbldr.io.file_access.open_file import CONTROL, WESTERN, head_lines, text_lines
from usbldr.io.messages.topic_names import without_numbers
from usbldr.io.tables.cells import THOUSANDS
from usbldr.io.tables.date_times import DATE, DATE_TIME, foreign_time
from usbldr.io.tables.foreign_texts import foreign_text
from usbldr.io.tables.time_columns import ISO
from usbldr.io.tables.time_zones import named_zone
from usbldr.io.tables.unnamed_columns import is_number, unnamed_columns
from usbldr.io.units import named_unit

PREAMBLE = 100  # [lines] among which the column names are looked for
SEPARATOR_LINE = re.compile(r'"?sep=.?"?\s*', re.IGNORECASE)  # of Excel, before the column names
COMMENT = re.compile(r"(?:#+|%+(?=\s))\s*|\s+")
"""What the column names may follow; rostopic's "%time" is one of them."""
DATED = " "  # the separator of columns between blanks whose first one is a date and a time of day
BY_BLANKS = (None, DATED)
COMMENTS = ("#", "%", "//")  # with which a line begins that is no row
REMARKS = (*COMMENTS, ";")  # with which a line before the column names begins that is none
DECIMAL_COMMA = re.compile(r"[+-]?(\d*,(\d{1,2}|\d{4,})|(0|\d{4,}),\d+)")
"""A number in quotes whose comma parts no thousands."""
DATE_WORD = re.compile(rf"(?<![\w./-])({DATE})(?![\w/-])")
START = re.compile(rf"\b(start|begin|began|d[eé]but|in[ií]cio|inizio).*?(?P<moment>{DATE_TIME.pattern})", re.IGNORECASE)
"""A line that states when a recording began."""
BLANKS = " \t\v\f\xa0"  # that may surround a cell


def looks_like_csv(head: bytes) -> bool:
    """Return whether a file's first bytes are text with a line of column names, or comments alone."""
    if head.lstrip().startswith((b"{", b"<")) or foreign_text(head):  # JSON, XML
        return False
    lines, _ = _whole_names(head_lines(head))
    if len(lines) > PREAMBLE and all(line.startswith(REMARKS) for line in lines[:-1]):
        return lines[0].startswith("#")
    header = lines[_header_place(lines)] if lines else ""
    row = row_without_names(lines)
    printable = (header if row is None else lines[row]).replace("\t", " ").isprintable()
    named = any(char.isalpha() for char in header) and (separator_of(header) in header or has_blank_columns(head, True))
    return printable and (named or row is not None)


def _whole_names(lines: list[str]) -> tuple[list[str], int]:
    """Return lines with those joined that line breaks in quoted names part, as in a spreadsheet, and how many they are.

    A line of names holds no value.
    """
    quoted = [k for k, line in enumerate(lines) if line.count('"') % 2][:2]
    if len(quoted) < 2:
        return lines, 0
    first, last = quoted
    whole = " ".join(line.strip() for line in lines[first : last + 1])
    named = not any(map(is_value, cells_of(whole, separator_of(whole))))
    return ([*lines[:first], whole, *lines[last + 1 :]], last - first) if named else (lines, 0)


def has_blank_columns(head: bytes, whole: bool = False) -> bool:
    """Return whether a file's first bytes are names between blanks, and a row with numbers; ``whole``: as many."""
    begun = head_lines(head)
    place = _header_place(begun)
    lines = [bare(line).split() for line in begun[place:] if line.strip()]
    names, row = (*lines, [], [])[:2]
    row = row[1:] if _is_dated(names, row) else row
    named = unnamed_columns(Path(), names) is None and not any(map(is_value, names))  # else those of a format
    numbers = sum(is_value(cell) or foreign_time(cell) for cell in row)
    return named and (numbers == len(row) == len(names) > 1 if whole else len(names) > 1 and numbers > 0)


def bare(line: str) -> str:
    """Return a line without the mark of a comment."""
    found = COMMENT.match(line)
    return line[found.end() :] if found else line


def _is_dated(names: Sequence[str], row: Sequence[str]) -> bool:
    """Return whether a row between blanks begins with a date and a time of day, which are one column."""
    return len(row) == len(names) + 1 > 2 and all(map(foreign_time, (f"{row[0]} 00:00:00", row[1])))


def row_without_names(lines: Sequence[str]) -> int | None:
    """Return the place of the first row, of numbers and times or most of them, if no line names its columns.

    Comments, and the rest of a row, may come before. None if one of them names as many columns, or if the format does
    (TUM).
    """
    place = next((k for k, line in enumerate(lines) if line.strip() and not line.startswith((*REMARKS, "*"))), 0)
    place += _is_rest(lines[place : place + 3])
    row = lines[place] if lines else ""
    separator = separator_of(row) if separator_of(row) in row else None
    cells = cells_of(row, separator)
    values = sum(is_value(cell) or foreign_time(cell.strip()) for cell in cells)
    if values <= max(2, len(cells) / 2) and not len(cells) == values > 1:
        return None
    names = cells_of(bare(lines[_header_place(lines)]), separator)
    named = (len(names) == len(cells) or _is_dated(names, cells)) and not any(map(is_value, names))
    return None if named or (unnamed_columns(Path(), cells) and separator is None) else place


def _is_rest(lines: Sequence[str]) -> bool:
    """Return whether the first of three lines is the rest of a row whose beginning was lost.

    The others have more cells, and all of its own but the first, which may be cut, are values.
    """
    if len(lines) < 3 or not lines[0].strip():
        return False
    separator = separator_of(lines[1]) if separator_of(lines[1]) in lines[1] else None
    first, *others = (cells_of(line, separator) for line in lines)
    values = all(map(is_value, first[1:])) and (len(first) > 1 or is_value(first[0]))
    return values and len(first) < len(others[0]) == len(others[1]) and any(map(is_value, others[0]))


def is_value(cell: str) -> bool:
    """Return whether a cell holds a number, or a date and time."""
    cell = cell.strip()
    return is_number(with_point(cell)) or (ISO.fullmatch(cell) or THOUSANDS.fullmatch(cell)) is not None


def is_unit(text: str) -> bool:
    """Return whether a text is a known unit, perhaps in brackets, and nothing else."""
    unit = text.strip("[]() ")
    stated = named_unit(f"x [{unit}]")
    return bool(stated.dimension) and stated.unit == unit


def _header_place(lines: Sequence[str]) -> int:
    """Return the place of the column names among the first lines: before the first row, known by a number in it.

    Comments, a title, and words with their values may precede them, units follow; so a row that begins with a time or
    number comes first. If no row is found, it is the first line that is not blank.
    """
    filled = [k for k, line in enumerate(lines) if line.strip() and not SEPARATOR_LINE.fullmatch(line)]
    names, width, worded = filled[0] if filled else 0, ("", 0), -1
    for k, following in pairwise(filled):
        separator = separator_of(lines[k]) if separator_of(lines[k]) in lines[k] else None
        if separator is None and _is_dated(bare(lines[k]).split(), lines[following].split()):
            return k
        cells, row = (cells_of(bare(lines[place]), separator) for place in (k, following))
        title = len(cells) > 1 and sum(map(bool, cells)) < 2  # a spreadsheet fills its line with separators
        if title or any(map(is_value, cells)):
            width = "", 0
            continue
        if (separator, len(cells)) != width or COMMENT.match(lines[names]):
            names, width = k, (separator, len(cells))
        if 1 < len(cells) == len(row) + _ends_in_comment(cells, row) and any(map(is_value, row)):
            if is_value(row[0]) or foreign_time(row[0]):
                return names
            worded = names if worded < 0 else worded
    return worded if worded >= 0 else filled[0] if filled else 0


def _ends_in_comment(names: Sequence[str], row: Sequence[str]) -> bool:
    """Return whether the last column is that of LabVIEW's comments, which is not in the rows."""
    return len(row) > 1 and len(names) == len(row) + 1 and names[-1] == "Comment"


def separator_of(line: str) -> str:
    """Return the separator of a file's columns by its first line; with semicolons, numbers have a decimal comma."""
    return ";" if ";" in line and line.count(",") <= line.count(";") + 1 else max(",;\t|", key=line.count)


def with_point(cell: str) -> str:
    """Return a number with a point in place of its decimal comma, any other cell as it is."""
    return cell.replace(",", ".") if re.fullmatch(r"[+-]?\d*,\d+([eE][+-]?\d+)?", cell) else cell


def _decimal_commas(rows: Sequence[str], separator: str | None) -> bool:
    """Return whether commas of numbers are decimal ones: other marks part the columns, or quoted cells show it."""
    if separator != ",":
        return separator not in BY_BLANKS
    return any(DECIMAL_COMMA.fullmatch(cell) for row in rows if '"' in row for cell in cells_of(row, separator))


def header_and_row(file: Path, beside: Sequence[Path] = ()) -> tuple[list[str], list[str]]:
    """Return a file's column names as written, and the cells of its first row; ``beside``: files that may name them."""
    begin = begin_of_table(file, beside=beside)
    cells = cells_of(next((line for line in begin.lines if line.strip()), ""), begin.separator)
    cells += [""] * (len(begin.names) - len(cells) if any(cells) else 0)
    return begin.names, [with_point(cell) for cell in cells] if begin.decimal_commas else cells


def stated_date(remarks: Sequence[str]) -> str:
    """Return the one date that the lines before the names state, empty if they state none or several."""
    dates = {found[0] for line in remarks for found in DATE_WORD.finditer(line)}
    return dates.pop() if len(dates) == 1 else ""


def stated_start(remarks: Sequence[str]) -> str:
    """Return the one date and time at which the lines before the names state that it began, empty if there is none."""
    starts = {found["moment"] for line in remarks if (found := START.search(line))}
    return starts.pop() if len(starts) == 1 else ""


class TableBegin(NamedTuple):
    """The beginning of a file."""

    names: list[str]  # of its columns
    separator: str | None  # None: blanks
    lines: Iterator[str]  # behind the names, and behind a line of their units
    number: int  # of the last line before these
    spoilt: Mapping[int, str]  # line before them -> why it is none
    remarks: Sequence[str]  # the lines before the names
    decimal_commas: bool


def _names_of_part(file: Path, row: Sequence[str], beside: Sequence[Path]) -> list[str] | None:
    """Return the names of a file's columns by another one whose name differs in a number, and whose first row is alike.

    So a logger, or ``split``, leaves the parts of a table. None if there is no such file.
    """
    for other in beside:
        if other != file and without_numbers(other.stem) == without_numbers(file.stem):
            names, cells = header_and_row(other)
            alike = len(cells) == len(row) and names[0] != "1"
            pairs = (
                (is_number(with_point(cell)) for cell in pair) for pair in zip(cells, row, strict=False) if all(pair)
            )
            if alike and all(one == another for one, another in pairs):
                return names
    return None


def begin_of_table(file: Path, units_are_row: bool = False, beside: Sequence[Path] = ()) -> TableBegin:
    """Return the beginning of a file: what is before its column names, if it is text, is a title or comments.

    ``beside``: the files of its folder, of which another part of the table may name its columns.
    """
    lines = text_lines(file, WESTERN)
    begun = list(islice(lines, PREAMBLE))
    comments = 0  # before the last ones: there may be thousands
    while len(begun) == PREAMBLE and all(line.startswith(REMARKS) for line in begun):
        comments += len(begun) - 1
        begun = [begun[-1], *islice(lines, PREAMBLE - 1)]
    begun, breaks = _whole_names(begun)
    clean = [line.replace("\0", "") for line in begun]
    row = row_without_names(clean)
    place = _header_place(clean) if row is None else row
    first = bare(clean[place]) if begun else ""
    separator = separator_of(first) if separator_of(first) in first else None
    spoilt = {k: "it is no text" for k, line in enumerate(begun[:place], 1) if CONTROL.search(line.replace("\0", ""))}
    if row and _is_rest(clean[row - 1 : row + 2]):
        spoilt[row] = "its beginning is lost"
    names, rows = cells_of(first, separator), place + 1
    if row is not None:
        names, rows = _names_of_part(file, names, beside) or [f"{k}" for k in range(1, len(names) + 1)], place
    elif separator is None and _is_dated(names, next((line for line in clean[rows:] if line.strip()), "").split()):
        separator = DATED
    while not units_are_row and rows < len(begun):
        joined = _joined(names, cells_of(clean[rows], separator))
        if joined is None:
            break
        names, rows = joined, rows + 1
    if _ends_in_comment(names, cells_of(clean[rows], separator) if rows < len(clean) else ()):
        names.pop()
    of_r = [cells_of(line, separator) for k, line in enumerate(clean[rows : rows + 2], 1) if line.startswith(f'"{k}"')]
    if len(of_r) == 2 and all(len(cells) == len(names) + 1 and cells[-1] for cells in of_r):
        names.insert(0, "row")  # write.table() gives its names of rows no name
    while len(names) > 1 and not names[-1]:
        names.pop()  # of separators at the end of the line
    if names.count("") > 1:
        names = [name or f"column {k}" for k, name in enumerate(names, 1)]
    number, commas = comments + rows + breaks, _decimal_commas(clean[rows:], separator)
    return TableBegin(names, separator, chain(begun[rows:], lines), number, spoilt, clean[:place], commas)


def _joined(names: Sequence[str], cells: Sequence[str]) -> list[str] | None:
    """Return the names of columns with what another line adds to them, None if that line is none of names or units.

    A line of units, or of dashes, has no names. A name that stands over several columns, of which the others are blank
    or repeat it, goes before the names of each.
    """
    if len(names) != len(cells) or len(cells) < 2 or any(is_value(cell) or foreign_time(cell) for cell in cells):
        return None
    if any(cells) and all(not cell or not name for name, cell in zip(names, cells, strict=True)):
        return [name or cell for name, cell in zip(names, cells, strict=True)]  # as pandas names an index
    plain = [cell.strip("[]() ") for cell in cells]
    units = [f" [{u}]" if is_unit(u) or stated_order(u) is not None or named_zone(f"[{u}]") else "" for u in plain]
    of_names = any(not unit and named_unit(cell).unit for cell, unit in zip(cells, units, strict=True))
    if not of_names and (any(units) or not any(cell.strip("-:") for cell in cells)):
        return [name if named_unit(name).unit else name + unit for name, unit in zip(names, units, strict=True)]
    over, found = "", list[str]()
    for name, cell, unit in zip(names, cells, units, strict=True):
        over = name or over
        found.append(over + unit if unit else f"{over} {cell}".strip() if cell not in ("", over) else name)
    named = list(filter(None, found))
    over_several = len(set(names[1:]) - {""}) < len(names[1:])
    described = list(names) if all(cells) else None  # a line of types or remarks, or the names again
    return found if over_several and len(set(named)) == len(named) else described


def cells_of(line: str, separator: str | None) -> list[str]:
    """Return the cells of a line without the blanks around them; ``separator`` None: blanks part them."""
    if separator in BY_BLANKS:
        cells = line.split()
        return [" ".join(cells[:2]), *cells[2:]] if separator == DATED and len(cells) > 1 else cells
    if '"' in line:
        line = re.sub(rf'(^|{re.escape(separator)})="', r'\1"', line)  # of Excel: ="1.2" is a text
        return [cell.strip() for cell in next(csv.reader([line], delimiter=separator, skipinitialspace=True))]
    cells = line.rstrip("\r\n").split(separator)
    return [cell.strip() for cell in cells] if any(blank in line for blank in BLANKS) else cells
