"""Open the files of a log: regular ones only, for a pipe would be waited for forever; faults are sentences."""

import stat
from collections.abc import Generator, Iterator
from contextlib import contextmanager
from io import BufferedReader
from mmap import ACCESS_READ, mmap
from pathlib import Path

from usbldr.filters.errors import LogError
from usbldr.io.formats.decompression import compression_of
from usbldr.io.limits import RAISE, limit

LINE_CHARACTERS = 1 << 20  # [characters] of a line of text; lines of logs have some hundreds


@contextmanager
def opened(path: Path) -> Generator[BufferedReader]:
    """Open a file for reading; raise LogError if it is no regular file, or if it cannot be opened or read."""
    try:
        if not stat.S_ISREG(path.stat().st_mode):
            raise LogError("is neither a file nor a folder", path=path)
        with path.open("rb") as file:
            yield file
    except OSError as err:
        raise LogError(f"cannot be read ({err.strerror or err})", path=path) from err


def mapped(path: Path) -> mmap:
    """Return the bytes of a file without reading them all; raise LogError (see `opened`)."""
    with opened(path) as file:
        return mmap(file.fileno(), 0, access=ACCESS_READ)


def text_lines(path: Path) -> Iterator[str]:
    """Yield the lines of a text file with their line ends, as far as they have any; raise LogError (see `opened`).

    Raises LogError for a line beyond the limit and for a compressed file, too.
    """
    most = limit(LINE_CHARACTERS)
    with opened(path) as file:  # refuses what is not a file
        compression = compression_of(file.read(16))
    if compression:
        raise LogError(f"is compressed with {compression}; decompress it first", path=path)
    try:
        with path.open(encoding="utf-8-sig", errors="replace") as lines:
            number = 0
            while line := lines.readline(most + 1):
                number += 1
                if len(line) > most:
                    text = f"line {number} is longer than {most} characters, too long for a log; {RAISE}"
                    raise LogError(text, path=path)
                yield line
    except OSError as err:
        raise LogError(f"cannot be read ({err.strerror or err})", path=path) from err
