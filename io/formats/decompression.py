"""Compressed chunks of MCAP files and ROS 1 bags, decompressed into one buffer that is reused.

Allocating memory for each chunk would cost more than the decompression.
"""

import bz2
from collections.abc import Iterable
from typing import Any

import lz4.frame  # pyright: ignore[reportMissingTypeStubs]
import zstandard

STEP = 1 << 18  # [bytes] bytes decompressed at once, so that they stay in the cache
DAMAGE = (ValueError, OverflowError, MemoryError, RuntimeError, EOFError, OSError, zstandard.ZstdError)
"""Errors that the libraries raise for damaged bytes; lz4's are RuntimeErrors, bz2's OSErrors."""


class Decompressor:
    """Memory for one unpacked chunk."""

    def __init__(self) -> None:
        self._memory = bytearray()

    def unpack(self, compression: str, packed: memoryview, size: int) -> memoryview:
        """Return the ``size`` decompressed bytes, fewer if the end is missing; valid until the next call.

        ``compression`` is "", "zstd", "lz4" or "bz2". Raises one of DAMAGE if the bytes are damaged.
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
            into[got : got + len(piece)] = piece  # a ValueError if it is too long
            got += len(piece)
        return into[:got]


def unknown_compression_text(compressions: Iterable[str]) -> str:
    """Return the text for chunks of unknown compression, empty if the name is damaged, too."""
    words = sorted(name for name in compressions if name.isalnum() and name.isascii() and len(name) < 16)
    return f" or use an unknown compression ({', '.join(words)})" if words else ""
