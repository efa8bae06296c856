"""The texts of CSV files as columns: names, integer nanoseconds and numbers; errors name the line."""

import codecs
import re
from collections.abc import Iterator, Mapping, Sequence
from datetime import datetime
from decimal import Decimal, InvalidOperation
from pathlib import Path

import numpy as np
import pandas as pd

from usbldr.filters.errors import LogError
from usbldr.filters.types import Vector
from usbldr.io.formats.csv_sheets import plain_names
from usbldr.io.reader import Nanoseconds

SECOND = Decimal(1_000_000_000)
MAX_TIME_NS = 1 << 62  # in 2116


def text_files(folder: Path) -> Iterator[Path]:
    """Yield the files of a folder that look like CSV, by name."""
    for file in sorted(folder.iterdir()):
        if file.is_file() and not file.name.startswith(".") and file.suffix not in (".toml", ".md", ".json"):
            with file.open("rb") as opened:
                if looks_like_csv(opened.read(4096)):
                    yield file


def looks_like_csv(head: bytes) -> bool:
    """Return whether a file's first bytes are text whose first line holds column names."""
    first = _first_line(head)
    return _separator(first) in first and any(char.isalpha() for char in first)


def lacks_header(head: bytes) -> bool:
    """Return whether a file's first bytes are columns of numbers without names."""
    cells = _first_line(head).split(_separator(_first_line(head)))
    return len(cells) > 1 and all(_is_number(_with_point(cell.strip())) for cell in cells)


def _first_line(head: bytes) -> str:
    if b"\0" in head or not head.strip():
        return ""
    return head.removeprefix(codecs.BOM_UTF8).decode(errors="replace").splitlines()[0]


def _separator(line: str) -> str:
    """Return the separator of a file's columns by its first line; with semicolons, numbers have a decimal comma."""
    return max(",;\t", key=line.count)


def _with_point(cell: str) -> str:
    return cell.replace(",", ".") if re.fullmatch(r"[+-]?\d*,\d+([eE][+-]?\d+)?", cell) else cell


def raw_header(file: Path) -> list[str]:
    """Return a file's column names as written."""
    line = _header_line(file)
    return [name.strip() for name in line.split(_separator(line))]


def _header_line(file: Path) -> str:
    try:
        with file.open(encoding="utf-8-sig", errors="replace") as lines:
            return lines.readline()
    except OSError as err:
        raise LogError(f"cannot be read ({err.strerror})", path=file) from err


def read_texts(file: Path) -> Mapping[str, Sequence[str]]:
    """Return all columns of a CSV file as stripped text, by plain names; raise LogError if it is not CSV."""
    header, separator = plain_names(raw_header(file)), _separator(_header_line(file))
    twice = [name for name in dict.fromkeys(header) if header.count(name) > 1]
    if twice:
        raise LogError(f"has two columns {twice[0] or 'without a name'} (its columns: {', '.join(header)})", path=file)
    try:
        table = pd.read_csv(
            file, sep=separator, header=0, names=header, dtype=str, keep_default_na=False, index_col=False
        )
    except (ValueError, UnicodeDecodeError) as err:
        raise LogError(f"is not a CSV file ({' '.join(str(err).split())})", path=file) from err
    texts = {name: [str(text).strip() for text in table[name]] for name in header}
    return texts if separator == "," else {name: [_with_point(cell) for cell in cells] for name, cells in texts.items()}


def column(texts: Mapping[str, Sequence[str]], name: str, file: Path) -> Sequence[str]:
    """Return one column; raise LogError with the header if it is missing."""
    if name not in texts:
        raise LogError(f"has no column {name} (its columns: {', '.join(texts)})", path=file)
    return texts[name]


def nanoseconds(texts: Sequence[str], name: str, file: Path, rows: Sequence[int] | None = None) -> Nanoseconds:
    """Return a column of integer nanoseconds, never through float; ``rows`` (None: all) are their rows."""
    times: list[int] = []
    for i, text in enumerate(texts):
        try:
            times.append(_in_range(int(text)))
        except (ValueError, OverflowError) as err:
            raise _fault(texts, i, name, file, rows, "a whole number of nanoseconds") from err
    return np.array(times, dtype=np.int64)


def seconds(texts: Sequence[str], name: str, file: Path, rows: Sequence[int] | None = None) -> Nanoseconds:
    """Return a column of seconds with decimals, or of dates and times, as nanoseconds.

    Exact: 1474477150.374442 is not representable in float64.
    """
    times: list[int] = []
    for i, text in enumerate(texts):
        try:
            exact = _iso_ns(text) if ISO.fullmatch(text) else int((Decimal(text) * SECOND).to_integral_value())
            times.append(_in_range(exact))
        except (InvalidOperation, ValueError, OverflowError) as err:
            raise _fault(texts, i, name, file, rows, "a number of seconds") from err
    return np.array(times, dtype=np.int64)


def _in_range(time_ns: int) -> int:
    """Return a time; raise OverflowError if differences of such times would exceed 64 bits."""
    if abs(time_ns) >= MAX_TIME_NS:
        raise OverflowError
    return time_ns


ISO = re.compile(r"(\d{4}-\d\d-\d\d)[T ](\d\d:\d\d:\d\d)(?:[.,](\d{1,9}))?(Z|[+-]\d\d:?\d\d)?")


def _iso_ns(text: str) -> int:
    """Return a date and time as nanoseconds since 1970; without a zone it is UTC."""
    match = ISO.fullmatch(text)
    assert match is not None
    date, clock, fraction, zone = match.groups()
    moment = datetime.fromisoformat(f"{date}T{clock}{zone or 'Z'}")
    return int(moment.timestamp()) * 1_000_000_000 + int((fraction or "").ljust(9, "0"))


def numbers(texts: Sequence[str], name: str, file: Path, rows: Sequence[int] | None = None) -> Vector:
    """Return a column of numbers; an empty cell is NaN, True and False are 1 and 0."""
    words = {"": "nan", "true": "1", "false": "0"}
    values = [words.get(text.lower(), text) for text in texts]
    try:
        return np.array([float(value) for value in values], dtype=np.float64)
    except ValueError as err:
        i = next(i for i, value in enumerate(values) if not _is_number(value))
        raise _fault(texts, i, name, file, rows, "a number") from err


def _fault(texts: Sequence[str], i: int, name: str, file: Path, rows: Sequence[int] | None, what: str) -> LogError:
    line = (i if rows is None else rows[i]) + 2
    return LogError(f'{file}: line {line}: {name} is "{texts[i]}", not {what}')


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
