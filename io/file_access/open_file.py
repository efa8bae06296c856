"""Open the files of a log: regular ones only, for a pipe would be waited for forever; faults are sentences."""

import codecs
import re
import stat
from collections.abc import Generator, Iterator
from contextlib import contextmanager
from io import BufferedReader
from mmap import ACCESS_READ, mmap
from pathlib import Path

from usbldr.filters.errors import LogError
from usbldr.io.file_access.decompression import compression_of
from usbldr.io.limits import RAISE, limit

HEAD_BYTES = 1 << 14  # [bytes] by which a text and its encoding are recognised
WIDE, NARROW = 0.4, 0.1  # [share] of zeros among the high bytes of UTF-16, at least, and among its low bytes, at most
CONTROL = re.compile(r"[\0-\x08\x0e-\x1b]")  # characters that are in no line of a text
CONTROLS = 0.02  # [share] of control characters of a text, at most: of random bytes they are a tenth
ZEROS = 1 << 24  # [characters] of zeros in a row that are skipped
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


def encoding_of(head: bytes) -> str:
    """Return the encoding of a text by its first bytes: UTF-16 with or without its mark, else UTF-8."""
    if head.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return "utf-16"
    even, odd = (head[start::2].count(0) / (len(head[start::2]) or 1) for start in (0, 1))
    wide = ((odd, even, "utf-16-le"), (even, odd, "utf-16-be"))
    return next((name for high, low, name in wide if high > WIDE and low < NARROW), "utf-8-sig")


def head_lines(head: bytes) -> list[str]:
    """Return the lines of a text's first bytes, without zeros, which damage leaves; none if it is no text."""
    text = head[:HEAD_BYTES].decode(encoding_of(head[:HEAD_BYTES]), errors="replace").replace("\0", "")
    return text.splitlines() if len(CONTROL.findall(text)) <= CONTROLS * len(text) else []


def text_lines(path: Path) -> Iterator[str]:
    """Yield the lines of a text file with their line ends, as far as they have any; raise LogError (see `opened`).

    A line may hold zeros in place of what was lost; those at the end of the file are left out. Raises LogError for a
    line beyond the limit and for a compressed file, too.
    """
    most = limit(LINE_CHARACTERS)
    with opened(path) as file:  # refuses what is not a file
        head = file.read(HEAD_BYTES)
    if compression := compression_of(head):
        raise LogError(f"is compressed with {compression}; decompress it first", path=path)
    try:
        with path.open(encoding=encoding_of(head), errors="replace") as lines:
            number, zeros = 1, 0
            while (line := lines.readline(most + 1)) and zeros < limit(ZEROS):
                if not line.strip("\0"):
                    zeros += len(line)
                    continue
                if len(line) > most:
                    text = f"line {number} is longer than {most} characters, too long for a log; {RAISE}"
                    raise LogError(text, path=path)
                yield "\0" * bool(zeros) + line
                number, zeros = number + 1, 0
            if line:
                yield "\0"
    except OSError as err:
        raise LogError(f"cannot be read ({err.strerror or err})", path=path) from err
