"""The fast path for a clean CSV file: pandas parses its numbers, and its text is read again only where it is asked for.

Clean is ASCII with commas, no quotation mark, zero, comment or empty row, the same number of cells in each line, and a
line end behind the last: then pandas' rows are those of `csv_text.read_texts`. After a lone quotation mark it would
take the rest of the file for one cell. pyarrow, if it is there, reads the same numbers in less time.
"""

import csv
from collections.abc import Iterator, Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import pandas as pd

from usbldr.io.file_access.open_file import LINE_CHARACTERS, opened
from usbldr.io.limits import limit
from usbldr.io.reader import Column
from usbldr.io.tables.text_table import Cells, TextColumn

BLOCK_BYTES = 1 << 18  # [bytes] examined at once: what a processor's cache holds
ARROW_BYTES = 1 << 22  # [bytes] by which pyarrow knows the kind of a column
PIECE = 10_000  # [rows] read as text at once: some megabytes
SPECIAL = b'"#\0xX('  # the last for pyarrow, to which 0x1A and nan(ind) are numbers
SHOWN = 20  # [rows] whose text is kept, by which the kind of a column is known
WHOLE_DIGITS, FRACTION_DIGITS = 18, 9  # [digits] of a time: what 64 bits hold, and nanoseconds
read_csv: Any = pd.read_csv  # whose options the stubs do not all know
MAX_LETTERS = 32  # of a time as text: more than its digits


class NumberColumn(Cells):
    """The cells of a column that holds nothing but numbers, True or False, and empty cells."""

    def __init__(self, file: Path, options: dict[str, Any], values: Column, first: Sequence[str]) -> None:
        """Take how pandas reads the column, its numbers (n,) and the text of its first cells."""
        self._file, self._options, self.values, self._first = file, options, values, first

    def __len__(self) -> int:
        return len(self.values)

    def __iter__(self) -> Iterator[str]:
        yield from self._first
        place = len(self._first)
        for piece in _pieces(self._file, self._options) if place < len(self) else ():
            yield from piece[place:]
            place = max(0, place - len(piece))

    def numbers(self) -> Column:
        """Return the cells as numbers, NaN for empty ones."""
        return self.values.astype(np.float64, copy=False)

    def times(self, unit_ns: int, at_1970: float, most_ns: int) -> tuple[Column, Sequence[int]] | None:
        """Return times in a unit as nanoseconds since 1970, exactly; None if their text has to be read one by one."""
        whole = self.values
        fraction_ns: Column | int = 0
        if whole.dtype.kind == "f" and len(whole):
            texts = read_csv(self._file, **self._options | {"dtype": f"S{MAX_LETTERS}"}).iloc[:, 0].to_numpy()
            whole, fraction, digits = _parts(texts.astype(f"S{np.strings.str_len(texts).max()}"))
            if not digits or unit_ns % 10**digits:
                return None
            fraction_ns = fraction * (unit_ns // 10**digits)
        if whole.dtype.kind != "i" or not len(whole):
            return None
        if max(abs(int(edge) - at_1970) for edge in (whole.min(), whole.max())) >= most_ns // unit_ns - 1:
            return None
        half_ns = round(at_1970 % 1 * unit_ns)  # of Julian Dates
        return (whole.astype(np.int64, copy=False) - int(at_1970)) * unit_ns + fraction_ns - half_ns, ()


def _parts(texts: Any) -> tuple[Column, Column, int]:
    """Return the digits before and behind the point of texts (n,), and how many are behind it; 0 if that differs."""
    letters = texts.view(np.uint8).reshape(len(texts), -1)
    point = int(np.argmax(letters[0] == ord(".")))
    behind = letters.shape[1] - point - 1
    whole, fraction = (_integers(part) for part in (letters[:, :point], letters[:, point + 1 :]))
    fits = 0 < point <= WHOLE_DIGITS and behind <= FRACTION_DIGITS and bool(np.all(letters[:, point] == ord(".")))
    if not fits or whole is None or fraction is None:
        return texts, texts, 0
    return whole, fraction, behind


def _integers(letters: Column) -> Column | None:
    """Return the numbers that columns of digits spell; None if there are other letters."""
    value = np.zeros(len(letters), dtype=np.int64)
    for column in letters.T:
        digit = column - np.uint8(ord("0"))  # of any other letter more than 9
        if np.any(digit > 9):
            return None
        value = value * 10 + digit
    return value


def clean_columns(file: Path, header: Sequence[str], begin: int) -> Mapping[str, Sequence[str]] | None:
    """Return the columns of a clean file whose rows begin behind line ``begin``; None for any other file."""
    options: dict[str, Any] = {"header": None, "names": list(header), "skiprows": begin, "keep_default_na": False}
    options["quoting"] = csv.QUOTE_NONE  # before the rows, too
    options["compression"] = None  # whatever the file is called
    columns: dict[str, Sequence[str]] = {}
    with opened(file) as content:
        before = b"".join(content.readline(limit(LINE_CHARACTERS)) for _ in range(begin))
        if len(header) < 2 or before.count(b"\r") != before.count(b"\r\n") or not _is_clean(content, len(header)):
            return None
        content.seek(len(before))
        lines = [content.readline().decode() for _ in range(SHOWN)]
        shown = zip(*(line.strip("\r\n").split(",") for line in lines if line), strict=True)
        content.seek(len(before))
        try:
            table = _by_pyarrow(content, header) or read_csv(file, **options, na_values=[""])
        except ValueError:  # a line has more cells than the first one
            return None
    for name, first in zip(header, shown, strict=True):
        values = table.pop(name).to_numpy()
        own = options | {"usecols": [name], "dtype": object}  # texts, and not those of pyarrow
        if values.dtype.kind in "biuf":
            columns[name] = NumberColumn(file, own, values, [cell.strip() for cell in first])
            continue
        columns[name] = text = TextColumn()
        for piece in _pieces(file, own):
            text.add(piece)
    numeric = any(isinstance(column, NumberColumn) for column in columns.values())
    return columns if numeric else None  # else a line of names may be among the rows


def _by_pyarrow(rows: BinaryIO, header: Sequence[str]) -> dict[str, Any] | None:
    """Return the columns as pyarrow reads them, faster than pandas; None without it, or if a column's kind changes."""
    try:
        arrow: Any = import_module("pyarrow.csv")  # pandas has loaded the rest of it
    except ImportError:
        return None
    try:
        table = arrow.read_csv(
            rows,
            arrow.ReadOptions(use_threads=False, block_size=ARROW_BYTES, column_names=list(header)),
            arrow.ParseOptions(quote_char=False),
            arrow.ConvertOptions(null_values=[""]),
        )
    except ValueError:
        return None
    return dict(zip(header, table.columns, strict=True))


def _is_clean(rows: BinaryIO, width: int) -> bool:
    """Return whether rows are such text: so many cells in the first one, and in all on average."""
    first, last, empty = rows.tell(), b"", b"\n" + b"," * (width - 1)
    while block := rows.read(BLOCK_BYTES) + rows.readline(limit(LINE_CHARACTERS)):
        letters = np.frombuffer(block, dtype=np.uint8)
        lines, commas = (int(np.count_nonzero(letters == ord(letter))) for letter in "\n,")
        if (
            not (block.isascii() and block.endswith(b"\n"))  # a cut row may have no comma
            or any(letter in block for letter in SPECIAL)
            or any(empty + end in b"\n" + block for end in (b"\r", b"\n"))
            or (first >= 0 and block.partition(b"\n")[0].count(b",") != width - 1)
            or commas != lines * (width - 1)
            or (b"\r" in block and not lines == block.count(b"\r") == block.count(b"\r\n"))
        ):
            return False
        first, last = -1, block[block.rfind(b"\n", 0, -1) + 1 :]
    return first < 0 and b"," in last.rstrip(b",\r\n")  # else it may hold words


def _pieces(file: Path, options: dict[str, Any]) -> Iterator[list[str]]:
    """Yield the text of one column, many rows at once."""
    with read_csv(file, **options, chunksize=PIECE) as reader:
        for piece in reader:
            yield [cell.strip() for cell in piece.iloc[:, 0]]
