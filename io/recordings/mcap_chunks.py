"""The chunks of an MCAP file: many records packed together, with a checksum.

Their bytes are read into one buffer that is reused: 300 MB of images beside the navigation cost a copy and a
checksum, and no memory.
"""

import struct
from io import BufferedReader
from pathlib import Path
from typing import NamedTuple

from mcap.exceptions import McapError
from zlib_ng import zlib_ng

from usbldr.io.file_access import decompression
from usbldr.io.file_access.decompression import Decompressor
from usbldr.io.limits import TooLargeError, UnpackingBudget

CHUNK = struct.Struct("<QQQII")  # first and last log time, decompressed size, checksum, length of compression's name
COMPRESSIONS = ("", "zstd", "lz4")
DAMAGE = (McapError, struct.error, *decompression.DAMAGE)
"""Errors for damaged bytes, here and in the libraries."""


def crc32(data: bytes | memoryview, before: int = 0) -> int:
    """Return the checksum of bytes; ``before``: that of those before them."""
    return zlib_ng.crc32(data, before)  # pyright: ignore[reportUnknownMemberType]


class Chunk(NamedTuple):
    """One chunk."""

    first_ns: int  # log time
    last_ns: int
    data: memoryview  # its records, as far as they can be read; valid until the next chunk is read
    whole: bool  # the file does not end inside
    sound: bool  # it has the stated size and, if one is stated, the stated checksum
    altered: bool  # it has the stated size, but another checksum
    compression: str
    oversized: bool = False  # it is beyond the limit of a chunk


class ChunkReader:
    """Reads the chunks of a file one after the other."""

    def __init__(self, file: BufferedReader) -> None:
        self._file = file
        self._raw = bytearray()
        self.budget = UnpackingBudget(file.name, Path(file.name).stat().st_size)
        self._unpacker = Decompressor(self.budget)

    def read(self, length: int, left: int) -> Chunk:
        """Read the record of a chunk, of which at most ``left`` bytes exist; raise one of DAMAGE for its head."""
        most = min(length, left)
        if most > len(self._raw):
            self._raw = bytearray(most)
        raw = memoryview(self._raw)[:most]
        raw = raw[: self._file.readinto(raw)]
        whole = len(raw) == length
        first_ns, last_ns, size, checksum, named = CHUNK.unpack_from(raw)
        packed_at = CHUNK.size + named + 8
        compression = bytes(raw[CHUNK.size : packed_at - 8]).decode(errors="replace")
        nothing = Chunk(first_ns, last_ns, memoryview(b""), whole, sound=False, altered=False, compression=compression)
        if compression not in COMPRESSIONS:
            return nothing
        try:
            data = self._unpacker.unpack(compression, raw[packed_at:], size)
        except TooLargeError:
            return nothing._replace(oversized=True)
        except DAMAGE:
            return nothing
        complete = whole and len(data) == size
        altered = complete and checksum != 0 and crc32(data) != checksum
        return nothing._replace(data=data, sound=complete and not altered, altered=altered)
