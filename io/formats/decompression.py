"""Compressed chunks of MCAP files and ROS 1 bags, unpacked into the same memory again and again.

Fresh memory for each chunk would cost more than the unpacking itself.
"""

import bz2
from collections.abc import Iterable
from typing import Any

import lz4.frame  # pyright: ignore[reportMissingTypeStubs]
import zstandard

STEP = 1 << 18  # [bytes] bytes unpacked at once, so that they stay near the processor
DAMAGE = (ValueError, OverflowError, MemoryError, RuntimeError, EOFError, OSError, zstandard.ZstdError)
"""What broken bytes raise in the libraries; lz4's errors are RuntimeErrors, bz2's OSErrors."""


class Decompressor:
    """Memory for one unpacked chunk."""

    def __init__(self) -> None:
        """Begin without memory."""
        self._memory = bytearray()

    def unpack(self, compression: str, packed: memoryview, size: int) -> memoryview:
        """Return the ``size`` bytes that were packed, fewer where the end is missing; good until the next call.

        ``compression`` is "", "zstd", "lz4" or "bz2". Raises one of DAMAGE where the bytes make no sense.
        """
        if not compression:
            return packed
        if size > len(self._memory):
            self._memory = bytearray(size)
        into, got = memoryview(self._memory)[:size], 0
        if compression == "zstd":
            reader: Any = zstandard.ZstdDecompressor().stream_reader(packed)
            while got < size and (more := reader.readinto(into[got:])):
                got += more
            return into[:got]
        unpacker: Any = lz4.frame.LZ4FrameDecompressor() if compression == "lz4" else bz2.BZ2Decompressor()
        for at in range(0, len(packed), STEP):
            piece = unpacker.decompress(packed[at : at + STEP])
            into[got : got + len(piece)] = piece  # a ValueError where it is too much
            got += len(piece)
        return into[:got]


def unknown_compression_text(compressions: Iterable[str]) -> str:
    """Return words for chunks whose compression nobody knows, none where a bent name is no word."""
    words = sorted(name for name in compressions if name.isalnum() and name.isascii() and len(name) < 16)
    return f" or packed in a way that is not known ({', '.join(words)})" if words else ""
