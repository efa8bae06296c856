"""The cells of a column that a file holds as an array: of known numbers and dates, of which its text is made."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from functools import cached_property

import numpy as np

from usbldr.filters.errors import LogError
from usbldr.io.reader import Column
from usbldr.io.tables.cf_times import whole_ns
from usbldr.io.tables.text_table import Cells

PIECE = 1_000  # [cells] made to text at once: some twenty are looked at, often


class ArrayColumn(Cells):
    """A column that is read when it is asked for; a masked cell is empty."""

    def __init__(self, read: Callable[[], Column], rows: int, is_examined: bool) -> None:
        """Take what reads the column, (rows,), and whether its cells are looked at to interpret its table.

        If that raises LogError, so do all methods.
        """
        self._read, self._rows, self._is_examined = read, rows, is_examined

    @cached_property
    def values(self) -> Column:
        """The array, (n,)."""
        return self._read()

    @property
    def is_examined(self) -> bool:
        """Whether its cells are looked at, and can be read."""
        with suppress(LogError):
            return self._is_examined and len(self.values) == self._rows
        return False

    def __len__(self) -> int:
        return self._rows

    def __iter__(self) -> Iterator[str]:
        for first in range(0, self._rows, PIECE):
            piece = self.values[first : first + PIECE]
            if piece.dtype.kind == "M":
                piece = np.where(np.isnat(piece), "", np.datetime_as_string(piece, unit="ns"))
            yield from ("" if cell is None else str(cell).strip() for cell in piece.tolist())

    def numbers(self) -> Column | None:
        """Return the array if it is one of numbers, NaN where it is masked."""
        if self.values.dtype.kind not in "biuf":
            return None
        masked = np.ma.isMaskedArray(self.values)
        return np.ma.filled(self.values.astype(np.float64), np.nan) if masked else self.values

    def times(self, unit_ns: int, at_1970: float, most_ns: int) -> tuple[Column, Sequence[int]] | None:
        """Return numbers of a unit, or dates, as nanoseconds since 1970, and which are none; integers stay exact."""
        masked, values = np.ma.getmaskarray(self.values), np.ma.getdata(self.values)
        if values.dtype.kind not in "iufM":
            return None
        if values.dtype.kind == "M":
            values, unit_ns = values.astype(np.int64), 1
        elif at_1970:
            values = (values.astype(np.int64) if values.dtype.kind in "iu" else values) - at_1970
        good = (np.abs(values.astype(np.float64)) * unit_ns < most_ns) & ~masked  # False for NaN, and for no date
        return whole_ns(np.where(good, values, 0), unit_ns), np.flatnonzero(~good).tolist()
