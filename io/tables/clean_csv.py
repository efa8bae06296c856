"""The fast path for a clean CSV file: pandas parses its numbers, and its text is read again only where it is asked for.

Clean is ASCII with commas, no quotation mark, zero or comment, the same number of cells in each line, and a line end
behind the last: then pandas' rows are those of `csv_text.read_texts`. After a lone quotation mark it would take the
rest of the file for one cell.
"""

import csv
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from usbldr.io.file_access.open_file import LINE_CHARACTERS, opened
from usbldr.io.limits import limit
from usbldr.io.reader import Column
from usbldr.io.tables.text_table import Cells, TextColumn

BLOCK_BYTES = 1 << 22  # [bytes] examined at once
PIECE = 10_000  # [rows] read as text at once: some megabytes
CLEAN = bytes(set(range(1, 128)) - set(b',\n\r"#'))  # letters of cells
SHOWN = 20  # [rows] whose text is kept, by which the kind of a column is known
WHOLE_DIGITS, FRACTION_DIGITS = 18, 9  # [digits] of a time: what 64 bits hold, and nanoseconds
read_csv: Any = pd.read_csv  # whose options the stubs do not all know
MAX_LETTERS = 32  # of a time as text: more than its digits


class NumberColumn(Cells):
    """The cells of a column that holds nothing but numbers, True or False, and empty cells."""

    def __init__(self, file: Path, options: dict[str, Any], values: Column, first: Sequence[str]) -> None:
        """Take how pandas reads the column, its numbers (n,) and the text of its first cells."""
        self._file, self._options, self.values, self._first = file, options, values, first
        self._times: dict[tuple[int, int], Column | None] = {}  # by unit and moment: asked for more than once

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
        return self.values.astype(np.float64)

    def times(self, unit_ns: int, at_1970: int, most_ns: int) -> Column | None:
        """Return times in a unit as nanoseconds since 1970, exactly; None if their text has to be read one by one."""
        if (unit_ns, at_1970) not in self._times:
            self._times[unit_ns, at_1970] = self._exact_times(unit_ns, at_1970, most_ns)
        return self._times[unit_ns, at_1970]

    def _exact_times(self, unit_ns: int, at_1970: int, most_ns: int) -> Column | None:
        whole = self.values
        fraction_ns: Column | int = 0
        if whole.dtype.kind == "f" and len(whole):
            texts = read_csv(self._file, **self._options | {"dtype": f"S{MAX_LETTERS}"}).iloc[:, 0].to_numpy()
            whole, fraction, digits = _parts(texts.astype(f"S{np.strings.str_len(texts).max()}"))
            if not digits or unit_ns % 10**digits:
                return None
            fraction_ns = fraction * (unit_ns // 10**digits)
        if whole.dtype.kind != "i" or np.any(np.abs((whole - float(at_1970)) * unit_ns) >= most_ns - unit_ns):
            return None
        return (whole.astype(np.int64) - at_1970) * unit_ns + fraction_ns


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
    if len(header) < 2 or not _is_clean(file, len(header), begin):
        return None
    options: dict[str, Any] = {"header": None, "names": list(header), "skiprows": begin, "keep_default_na": False}
    options["quoting"] = csv.QUOTE_NONE  # before the rows, too
    try:
        shown: Any = read_csv(file, **options, dtype=str, nrows=SHOWN)
        table: Any = read_csv(file, **options, na_values=[""], index_col=False)
    except ValueError:
        return None
    columns: dict[str, Sequence[str]] = {}
    for name in header:
        values = table.pop(name).to_numpy()
        own = options | {"usecols": [name], "dtype": object}  # texts, and not those of pyarrow
        if values.dtype.kind in "biuf":
            columns[name] = NumberColumn(file, own, values, [cell.strip() for cell in shown[name]])
            continue
        columns[name] = text = TextColumn()
        for piece in _pieces(file, own):
            text.add(piece)
    numeric = any(isinstance(column, NumberColumn) for column in columns.values())
    return columns if numeric else None  # else a line of names may be among the rows


def _is_clean(file: Path, width: int, begin: int) -> bool:
    """Return whether a file holds nothing but ASCII without quotation marks, in lines of so many cells."""
    with opened(file) as content:
        for _ in range(begin):
            if b"\r" in content.readline(limit(LINE_CHARACTERS)).rstrip(b"\r\n"):
                return False
        while block := content.read(BLOCK_BYTES) + content.readline(limit(LINE_CHARACTERS)):
            row = b"," * (width - 1) + (b"\r\n" if block.endswith(b"\r\n") else b"\n")
            left = block.translate(None, CLEAN)
            if not block.endswith(b"\n") or left != row * (len(left) // len(row)):  # a cut row may have no comma
                return False
    return True


def _pieces(file: Path, options: dict[str, Any]) -> Iterator[list[str]]:
    """Yield the text of one column, many rows at once."""
    with read_csv(file, **options, chunksize=PIECE) as reader:
        for piece in reader:
            yield [cell.strip() for cell in piece.iloc[:, 0]]
