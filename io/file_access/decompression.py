"""Decompress whole files piece by piece, and chunks of MCAP files and ROS 1 bags into one buffer that is reused.

Allocating memory for each chunk would cost more than the decompression.
"""

import bz2
import lzma
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from io import BufferedReader, BytesIO
from pathlib import Path
from typing import Any

import lz4.frame  # pyright: ignore[reportMissingTypeStubs]
import zstandard

from usbldr.io.findings import Finding
from usbldr.io.limits import CHUNK_BYTES, RAISE, BeyondLimitError, TooLargeError, UnpackingBudget, limit

ZSTD = b"\x28\xb5\x2f\xfd"  # fixed by the format; no message of ROS begins like this
STEP = 1 << 16  # [bytes] decompressed at once: they stay in the cache, and malloc reuses blocks below 128 kB
FED = 1 << 8  # [bytes] given to a library at once, which zstd may decompress to 8 MB
FRAMES, FRAME_BYTES = 100_000, 1 << 10  # [frames] of any file, [bytes] for each further one; bgzip's have 20 kB
XZ_MEMORY = 1 << 27  # [bytes] for xz: `xz -9` needs 65 MB, and zstd has the same limit
LIBRARY_ERRORS = (ValueError, OverflowError, MemoryError, RuntimeError, EOFError, zlib.error, lzma.LZMAError)
DAMAGE = (*LIBRARY_ERRORS, OSError, zstandard.ZstdError)
"""Errors that the libraries raise for damaged bytes; lz4's are RuntimeErrors, bz2's OSErrors."""
UNPACKERS: Mapping[str, tuple[tuple[bytes, ...], Callable[[], Any]]] = {
    "zstd": ((ZSTD, b"\x50\x2a\x4d\x18"), lambda: zstandard.ZstdDecompressor().decompressobj()),
    "gzip": ((b"\x1f\x8b",), lambda: zlib.decompressobj(16 + zlib.MAX_WBITS)),
    "bzip2": ((b"BZh",), bz2.BZ2Decompressor),
    "xz": ((b"\xfd7zXZ",), lambda: lzma.LZMADecompressor(lzma.FORMAT_XZ, memlimit=XZ_MEMORY)),
    "lz4": ((b"\x04\x22\x4d\x18",), lz4.frame.LZ4FrameDecompressor),
}
"""By the compression of a file: its first bytes (pzstd puts a frame of its own first), and its library."""


def compression_of(head: bytes) -> str | None:
    """Return the compression of a file by its first bytes, None if it has none."""
    return next((name for name, (magics, _) in UNPACKERS.items() if head.startswith(magics)), None)


class CutError(EOFError):
    """The bytes end inside a record, or are not a record."""


class DamagedFileError(Exception):
    """A compressed file is damaged, or ends too early."""

    def __init__(self, at: int, why: str) -> None:
        """Take the byte of the file, and what the library says; "" if the file ends too early."""
        super().__init__(why)
        self.at, self.why = at, why


def unpacked_file(file: BufferedReader, compression: str) -> Iterator[bytes]:
    """Yield the contents of a compressed file, of one or several frames; raise DamagedFileError when they are damaged.

    No piece is larger than 8 MB.
    """
    unpacker: Any = None
    frames, most = 0, limit(FRAMES + Path(file.name).stat().st_size // FRAME_BYTES)
    while fed := file.read(FED):
        while fed := fed if unpacker else fed.lstrip(b"\0"):  # zeros may fill up the end of a file
            if unpacker is None:
                unpacker, frames = UNPACKERS[compression_of(fed) or compression][1](), frames + 1
                if frames > most:
                    raise BeyondLimitError(f"holds too many frames for its size; {RAISE}", path=file.name)
            try:
                yield from _fed(unpacker, fed)
            except DAMAGE as err:
                raise DamagedFileError(file.tell(), str(err) or "not enough memory") from err
            fed, unpacker = (unpacker.unused_data or b"", None) if unpacker.eof else (b"", unpacker)
    if unpacker:
        raise DamagedFileError(file.tell(), "")


def first_bytes(file: BufferedReader, compression: str, count: int) -> bytes:
    """Return the first bytes of a compressed file's contents, as far as they can be decompressed."""
    head = b""
    with suppress(DamagedFileError):
        for piece in unpacked_file(file, compression):
            head += piece[: count - len(head)]
            if len(head) == count:
                break
    return head


def _fed(unpacker: Any, fed: bytes) -> Iterator[bytes]:
    """Yield what some bytes decompress to."""
    if not hasattr(unpacker, "needs_input"):  # zstd and zlib take all that they are given
        yield unpacker.decompress(fed)
        return
    yield unpacker.decompress(fed, STEP)
    while not unpacker.eof and not unpacker.needs_input:
        yield unpacker.decompress(b"", STEP)


def deflated(packed: bytes, budget: UnpackingBudget) -> Iterator[bytes]:
    """Yield what zlib's data decompress to, taken from a budget.

    Raises zlib.error if they are damaged, EOFError if they are cut, LogError if the budget is exhausted.
    """
    unpacker = zlib.decompressobj()
    while packed and not unpacker.eof:
        piece = unpacker.decompress(packed, STEP)
        budget.take_bytes(len(piece))
        yield piece
        packed = unpacker.unconsumed_tail
    if not unpacker.eof:
        raise EOFError("it ends within a variable")


class Decompressor:
    """Memory for one unpacked chunk."""

    def __init__(self, budget: UnpackingBudget) -> None:
        """Take what the chunks together may decompress to."""
        self._budget = budget
        self._memory = bytearray()

    def unpack(self, compression: str, packed: memoryview, size: int) -> memoryview:
        """Return the ``size`` decompressed bytes, fewer if the end is missing; valid until the next call.

        ``compression`` is "", "zstd", "lz4" or "bz2". Raises one of DAMAGE if the bytes are damaged or more than
        ``size``, TooLargeError if ``size`` is beyond the limit, LogError if the budget is exhausted.
        """
        if not compression:
            return packed
        if size > self._budget.chunk_bytes:
            raise TooLargeError
        if size > len(self._memory):
            self._memory = bytearray(size)
        into, got = memoryview(self._memory)[:size], 0
        for piece in _pieces(compression, packed, size):
            into[got : got + len(piece)] = piece  # a ValueError if it is too long
            got += len(piece)
        self._budget.take_bytes(got)
        return into[:got]


class MessageUnpacker:
    """Messages of rosbag2, which may have compressed each on its own with zstd."""

    def __init__(self, path: Path) -> None:
        self._budget = UnpackingBudget(path, path.stat().st_size)
        self._oversized = False  # messages are beyond the limit

    def unpacked(self, data: object) -> bytes:
        """Return a payload, b"" if it is not one or does not decompress; that fits no definition and is counted so.

        Raises LogError if the budget is exhausted.
        """
        if not isinstance(data, bytes):
            return b""
        if not data.startswith(ZSTD):
            return data
        buffer = BytesIO()  # a list of pieces would need the memory twice
        try:
            buffer.writelines(_pieces("zstd", memoryview(data), self._budget.chunk_bytes))
        except DAMAGE:
            return b""
        whole = buffer.getvalue()
        self._budget.take_bytes(len(whole))
        if len(whole) <= self._budget.chunk_bytes:
            return whole
        self._oversized = True
        return b""

    def findings(self) -> list[Finding]:
        """Report messages beyond the limit."""
        text = f"messages decompress to more than {limit(CHUNK_BYTES) / 1e6:.3g} MB each and are left out ({RAISE})"
        return [Finding("DAMAGED", text, lost_data=True)] if self._oversized else []


def _pieces(compression: str, packed: memoryview, size: int) -> Iterator[bytes]:
    """Yield decompressed bytes, at most one more than ``size``."""
    left = size + 1
    if compression == "zstd":
        reader: Any = zstandard.ZstdDecompressor().stream_reader(packed)
        while left and (piece := reader.read(min(STEP, left))):
            yield piece
            left -= len(piece)
        return
    unpacker: Any = lz4.frame.LZ4FrameDecompressor() if compression == "lz4" else bz2.BZ2Decompressor()
    at = 0
    while left and not unpacker.eof and (at < len(packed) or not unpacker.needs_input):
        fed = packed[at : at + STEP] if unpacker.needs_input else b""
        at += len(fed)
        piece = unpacker.decompress(fed, min(STEP, left))
        yield piece
        left -= len(piece)


def unread_text(compressions: Iterable[str], oversized: bool) -> str:
    """Return why chunks may not have been read besides damage: their size, or unknown compressions with sound names."""
    words = sorted(name for name in compressions if name.isalnum() and name.isascii() and len(name) < 16)
    unknown = f" or use an unknown compression ({', '.join(words)})" if words else ""
    large = f" or decompress to more than {limit(CHUNK_BYTES) / 1e6:.3g} MB each ({RAISE})" if oversized else ""
    return unknown + large
