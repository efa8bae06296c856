"""Compressed chunks of MCAP files and ROS 1 bags, decompressed into one buffer that is reused.

Allocating memory for each chunk would cost more than the decompression.
"""

import bz2
from collections.abc import Iterable, Iterator
from typing import Any

import lz4.frame  # pyright: ignore[reportMissingTypeStubs]
import zstandard

from usbldr.io.limits import CHUNK_BYTES, RAISE, TooLargeError, UnpackingBudget, limit

STEP = 1 << 18  # [bytes] bytes decompressed at once, so that they stay in the cache
DAMAGE = (ValueError, OverflowError, MemoryError, RuntimeError, EOFError, OSError, zstandard.ZstdError)
"""Errors that the libraries raise for damaged bytes; lz4's are RuntimeErrors, bz2's OSErrors."""


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


def unpacked_message(packed: bytes, budget: UnpackingBudget) -> bytes:
    """Return a message compressed with zstd on its own; raise one of DAMAGE, TooLargeError or LogError."""
    pieces: list[bytes] = []
    got = 0
    for piece in _pieces("zstd", memoryview(packed), budget.chunk_bytes):
        pieces.append(piece)
        got += len(piece)
        if got > budget.chunk_bytes:
            raise TooLargeError
    budget.take_bytes(got)
    return b"".join(pieces)


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
        piece = unpacker.decompress(fed, left)
        yield piece
        left -= len(piece)


def unread_text(compressions: Iterable[str], oversized: bool) -> str:
    """Return why chunks may not have been read besides damage: their size, or unknown compressions with sound names."""
    words = sorted(name for name in compressions if name.isalnum() and name.isascii() and len(name) < 16)
    unknown = f" or use an unknown compression ({', '.join(words)})" if words else ""
    large = f" or decompress to more than {limit(CHUNK_BYTES) / 1e6:.3g} MB each ({RAISE})" if oversized else ""
    return unknown + large
