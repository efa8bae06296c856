"""Limits on what a log may cost to read, against files made or damaged to exhaust memory or time.

Each is far above what recordings of vehicles need. The environment variable USBLDR_LIMITS, or the option --limits of
the commands, multiplies all of them: USBLDR_LIMITS=10. docs/broken_files.md lists them.
"""

import os
from pathlib import Path

from usbldr.filters.errors import LogError, UsageError

VARIABLE = "USBLDR_LIMITS"
CHUNK_BYTES = 1 << 27  # [bytes] of one chunk or message, decompressed: 16 chunks of the largest usual size
UNPACKED_BYTES = 1 << 28  # [bytes] that any log may decompress to: a second or two
UNPACKED_RATIO = 100  # [bytes per byte] that a log may decompress to beyond that; navigation logs reach 10
TEXT_BYTES = 1 << 25  # [bytes] that any compressed text may decompress to: text takes ten times its size in memory
TEXT_RATIO = 25  # [bytes per byte] that a compressed text may decompress to beyond that; CSV logs reach 15
RECORDS = 1_000_000  # [records] that any log may hold in compressed chunks: a few seconds
TEXT_LINES = 400_000  # [lines] that any compressed text may hold: sentences of NMEA take 20 us each
RECORD_BYTES = 4  # [bytes] of the log for each further record; compressed messages need ten and more
SEARCH_BYTES = 1 << 25  # [bytes] that are examined in search of whole messages behind damage: two seconds of checksums
SEARCH_RATIO = 4  # [bytes per byte] the same beyond that: each damage costs a message or two
RAISE = "--limits 10 raises the limits tenfold"


def factor() -> float:
    """Return the factor on all limits; raise UsageError if the variable is not a positive number."""
    text = os.environ.get(VARIABLE, "1")
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0 < value < float("inf"):
        raise UsageError(f"{VARIABLE} (--limits) is {text}, not a positive number")
    return value


def limit(usual: int) -> int:
    """Return a limit times the factor."""
    return round(usual * factor())


class TooLargeError(ValueError):
    """A part of a file is larger than a limit."""


_copied_from: dict[str, tuple[Path, float]] = {}  # copy of a log or of a part -> the file, the share of its limits


def note_copy(copy: Path, original: Path, share: float = 1.0) -> None:
    """Let the limits of a copy be those of the file, or a share of them for a part of it: they do not multiply."""
    _copied_from[str(copy)] = original, share


def original_of(path: Path | str) -> tuple[Path, float]:
    """Return the file that the user has, of a copy the one it was made of, and the share of its limits that is its."""
    share = 1.0
    while str(path) in _copied_from:
        path, part = _copied_from[str(path)]
        share *= part
    return Path(path), share


class BeyondLimitError(LogError):
    """A log costs more to read than its size allows."""


class UnpackingBudget:
    """The bytes to which a log may still decompress, and the records that it may still hold."""

    def __init__(self, path: Path | str, size: int, text: bool = False) -> None:
        """Take the log, its size in bytes, and whether it is a compressed text."""
        self._path = path
        original, share = original_of(path)
        size = original.stat().st_size if str(path) in _copied_from else size
        whole = TEXT_BYTES + TEXT_RATIO * size if text else UNPACKED_BYTES + UNPACKED_RATIO * size
        self._whole = limit(round(share * whole))
        self._left = self._whole
        self._records = limit(round(share * ((TEXT_LINES if text else RECORDS) + size // RECORD_BYTES)))
        self._search = limit(round(share * (SEARCH_BYTES + SEARCH_RATIO * size)))
        self.chunk_bytes = limit(CHUNK_BYTES)

    def take_record(self, count: int = 1) -> None:
        """Take a record of the budget, or several; raise LogError if it is exhausted."""
        self._records -= count
        if self._records < 0:
            raise BeyondLimitError(f"holds too many records for its size; {RAISE}", path=self._path)

    def take_bytes(self, count: int) -> None:
        """Take bytes of the budget; raise LogError if it is exhausted."""
        self._left -= count
        if self._left < 0:
            text = f"decompresses to more than {self._whole >> 20} MB, too much for its size; {RAISE}"
            raise BeyondLimitError(text, path=self._path)

    def take_search(self, count: int) -> None:
        """Take bytes that are examined in search of a whole message; raise LogError if the budget is exhausted."""
        self._search -= count
        if self._search < 0:
            text = f"is damaged: too many bytes look like the beginning of a message and are none; {RAISE}"
            raise BeyondLimitError(text, path=self._path)
