"""Open the files of a log: regular ones only, for a pipe would be waited for forever; faults are sentences."""

import codecs
import os
import re
import stat
from collections.abc import Generator, Iterator
from contextlib import contextmanager
from io import BufferedReader, TextIOWrapper
from mmap import ACCESS_READ, mmap
from pathlib import Path

from usbldr.filters.errors import LogError
from usbldr.io.file_access.file_view import FileView
from usbldr.io.findings import Finding
from usbldr.io.limits import RAISE, limit

BEGIN_BYTES = 1 << 17  # [bytes] by which a format is known: the longest record behind one that is cut
HEAD_BYTES = 1 << 14  # [bytes] by which a text and its encoding are recognised
LETTER_BYTES = 4  # fixed: of the widest letters, those of UTF-32
MARKS = {
    codecs.BOM_UTF32_LE: "utf-32",  # before that of UTF-16, with which it begins
    codecs.BOM_UTF32_BE: "utf-32",
    codecs.BOM_UTF16_LE: "utf-16",
    codecs.BOM_UTF16_BE: "utf-16",
}
HIGH_BYTES = {"123": "utf-32-le", "012": "utf-32-be", "13": "utf-16-le", "02": "utf-16-be"}  # fixed: which of four
WIDE, NARROW = 0.4, 0.1  # [share] of zeros among the high bytes, at least, and among the low ones, at most
CONTROL = re.compile(r"[\0-\x08\x0e-\x1b]")  # characters that are in no line of a text
CONTROL_BYTES = bytes(k for k in range(0x1C) if CONTROL.match(chr(k)))  # in UTF-8: no others hold them
CONTROLS = 0.02  # [share] of control characters of a text, at most: of random bytes they are a tenth
ZEROS = 1 << 24  # [characters] of zeros in a row that are skipped
TAR, TAR_AT = b"ustar", 257  # fixed by the format
END_OF_FILE = "\x1a"  # fixed: behind the text of programs for DOS
LINE_CHARACTERS = 1 << 20  # [characters] of a line of text; lines of logs have some hundreds


def _western(fault: UnicodeError) -> tuple[str, int]:
    """Return the letters of Windows-1252, which is Latin-1 and more, for bytes that are none in UTF-8."""
    if not isinstance(fault, UnicodeDecodeError):
        raise fault
    return fault.object[fault.start : fault.end].decode("cp1252", errors="replace"), fault.end


WESTERN = "usbldr-western"
codecs.register_error(WESTERN, _western)


def real_path(path: Path) -> Path:
    """Return where a path leads, links followed as far as they lead anywhere: one may be a link to itself."""
    return Path(os.path.realpath(path))


@contextmanager
def opened(path: Path) -> Generator[BufferedReader]:
    """Open a file for reading; raise LogError if it is no regular file, or if it cannot be opened or read.

    Reports are UTF-8 and hold its name, so that must be, too.
    """
    try:
        str(path).encode()
    except UnicodeEncodeError as err:
        raise LogError("its name is not UTF-8; rename it", path=path) from err
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


def begin_of(path: Path, size: int) -> tuple[bytes, int]:
    """Return the first bytes of a file that are no zeros, and their place; raise LogError (see `opened`)."""
    with opened(path) as file:
        place = FileView(file.fileno()).after_zeros(0) // LETTER_BYTES * LETTER_BYTES
        file.seek(place)
        return file.read(size), place


def parts_within(path: Path) -> Iterator[bytes]:
    """Yield the bytes behind each quarter of a file: a text may begin with what is none of it."""
    quarter = path.stat().st_size // (4 * LETTER_BYTES) * LETTER_BYTES
    for place in range(quarter, 4 * quarter, max(quarter, 1)):
        with opened(path) as file:
            file.seek(place)
            yield file.read(HEAD_BYTES)


def filled_files(folder: Path) -> Iterator[Path]:
    """Yield the files of a folder by name, neither hidden nor empty ones: of endless files the size is zero, too."""
    for file in sorted(folder.iterdir()):
        if not file.name.startswith(".") and file.is_file() and file.stat().st_size:
            yield file


def encoding_of(head: bytes) -> str:
    """Return the encoding of a text by its first bytes: UTF-32 or UTF-16 with or without its mark, else UTF-8."""
    marked = next((name for mark, name in MARKS.items() if head.startswith(mark)), "")
    shares = [head[start::LETTER_BYTES].count(0) * LETTER_BYTES / max(len(head), LETTER_BYTES) for start in range(4)]

    def fits(high: str) -> bool:
        return all(share > WIDE if str(k) in high else share < NARROW for k, share in enumerate(shares))

    return marked or next((name for high, name in HIGH_BYTES.items() if fits(high)), "utf-8-sig")


def is_damaged(line: str) -> bool:
    """Return whether a line of text holds what no text does: control characters, bytes of no letter."""
    return CONTROL.search(line) is not None or "\ufffd" in line


def is_tar(head: bytes) -> bool:
    """Return whether a file with these first bytes is a tar archive."""
    return head[TAR_AT : TAR_AT + len(TAR)] == TAR


def head_lines(head: bytes) -> list[str]:
    """Return the lines of a text's first bytes, without zeros, which damage leaves; none if it is no text.

    An archive of texts is none.
    """
    if is_tar(head):
        return []
    text = head[:HEAD_BYTES].decode(encoding_of(head[:HEAD_BYTES]), errors="replace").replace("\0", "")
    as_bytes = text.encode()
    controls = len(as_bytes) - len(as_bytes.translate(None, CONTROL_BYTES))  # much faster than to search for them
    return text.splitlines() if controls <= CONTROLS * len(text) else []


def text_lines(path: Path, errors: str = "replace") -> Iterator[str]:
    """Yield the lines of a text file with their line ends, as far as they have any; raise LogError (see `opened`).

    A line may hold zeros in place of what was lost; those at the end of the file are left out. Raises LogError for a
    line beyond the limit, too. ``errors``: what bytes of no letter become, or WESTERN.
    """
    most, most_zeros = limit(LINE_CHARACTERS), limit(ZEROS)
    head, place = begin_of(path, HEAD_BYTES)
    with opened(path) as file:
        file.seek(place)
        lines = TextIOWrapper(file, encoding_of(head), errors=errors)
        number, zeros = 1, 0
        while (line := lines.readline(most + 1)) and zeros < most_zeros:
            line = line.strip(END_OF_FILE)
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


def cut_line(file: Path, line: int) -> list[Finding]:
    """Report that the last line has no line end and is left out; ``line``: its number, 0 if it has one."""
    text = f"{file.name}: line {line}, the last, has no line end and is left out: it may be cut"
    return [Finding("TRUNCATED", f"{text}; append a line end if it is whole", lost_data=True)] if line else []
