"""The cells of a text file by column, kept as text: one string for each cell would need ten times the memory."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from usbldr.filters import errors
from usbldr.io.file_access.open_file import cut_line
from usbldr.io.findings import Finding
from usbldr.io.reader import Column

MAX_NAMES = 20  # of names in a sentence
MAX_CHARACTERS = 60  # of a name or a cell in a sentence


class Cells(Sequence[str]):
    """The cells of a column as text. To read them one after the other is fast; to pick one, all are read."""

    def __getitem__(self, index: Any) -> Any:
        cells: Any = list(self)
        return cells[index]

    def numbers(self) -> Column | None:
        """Return the cells as numbers, NaN for empty ones, if they are known; else their text is to be read."""
        return None

    def times(self, unit_ns: int, at_1970: float, most_ns: int) -> tuple[Column, Sequence[int]] | None:
        """Return times in a unit as nanoseconds since 1970, exactly, and the rows of those that are none, if known.

        ``at_1970``: that moment in the unit; ``most_ns``: what they and their differences are below.
        """
        return None


class TextColumn(Cells):
    """Cells without line ends."""

    def __init__(self) -> None:
        self._pieces: list[str] = []  # the cells of many rows each, one a line
        self._count = 0

    def add(self, cells: Sequence[str]) -> None:
        """Add the cells of at least one row."""
        self._pieces.append("\n".join(cells))
        self._count += len(cells)

    def __len__(self) -> int:
        return self._count

    def __iter__(self) -> Iterator[str]:
        for piece in self._pieces:
            yield from piece.split("\n")


class TextTable(NamedTuple):
    """The cells of a file as stripped text."""

    columns: Mapping[str, Sequence[str]]  # by plain names
    lines: Sequence[int]  # line of each row
    left_out: Mapping[int, str]  # line -> why it is not a row
    cut_line: int = 0  # last line, if it has no line end and may be cut; 0: it has
    by_commas: bool = True  # else a comma in a number was a decimal comma, and has become a point


def listed(names: Sequence[str]) -> str:
    """Return names as text, the first of many."""
    return errors.listed([name[:MAX_CHARACTERS] for name in names], MAX_NAMES)


def row_findings(
    title: str, table: TextTable, left_out: Mapping[int, str], what: str = "line", topic: str = "", lost: bool = True
) -> list[Finding]:
    """Report the rows of a table that are left out (line or row -> why), and whether data is lost by that."""
    if not left_out:
        return []
    first, *others = sorted(left_out)
    more = f"; so are {what}s {listed(list(map(str, others)))}" if others else ""
    text = f"{title}: {len(left_out)} of {len(table.lines) + len(table.left_out)} rows are left out"
    return [Finding("UNDECODED", f"{text}: {what} {first}: {left_out[first]}{more}", topic, lost_data=lost)]


def line_findings(file: Path, table: TextTable) -> list[Finding]:
    """Report the lines of a file that are no rows, and its cut line."""
    return [*row_findings(file.name, table, table.left_out), *cut_line(file, table.cut_line)]
