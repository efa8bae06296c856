"""The chunks of an MCAP file: many records packed together, with a checksum.

Their bytes are read and unpacked into the same memory again and again: 300 MB of pictures beside the navigation cost a
copy and a checksum, and no memory.
"""

import struct
import zlib
from io import BufferedReader
from typing import Any, NamedTuple

import lz4.frame  # pyright: ignore[reportMissingTypeStubs]
import zstandard
from mcap.exceptions import McapError

HEAD = struct.Struct("<BQ")  # of a record: opcode, length
CHUNK = struct.Struct("<QQQII")  # first and last log time, size unpacked, its checksum, length of compression's name
STEP = 1 << 18  # bytes of lz4 unpacked at once, so that they stay near the processor
DAMAGE = (McapError, struct.error, ValueError, OverflowError, MemoryError, RuntimeError, EOFError, zstandard.ZstdError)
"""What broken bytes raise here and in the libraries; lz4's errors are RuntimeErrors."""


class Chunk(NamedTuple):
    """One chunk."""

    first_ns: int  # log time
    last_ns: int
    data: memoryview  # its records, as far as they can be believed; good until the next chunk is read
    whole: bool  # the file does not end inside
    sound: bool  # it has the size and the checksum that it states; no checksum is right, too


class ChunkReader:
    """Reads one chunk of a file after the other."""

    def __init__(self, file: BufferedReader) -> None:
        """Read from where the file stands each time."""
        self._file = file
        self._raw = bytearray()
        self._unpacked = bytearray()

    def read(self, length: int, left: int) -> Chunk:
        """Read the record of a chunk, of which ``left`` bytes at most are there; raise one of DAMAGE at its head."""
        raw = self._packed(min(length, left))
        whole = len(raw) == length
        first_ns, last_ns, size, checksum, named = CHUNK.unpack_from(raw)
        packed_at = CHUNK.size + named + 8
        try:
            data = self._unpack(bytes(raw[CHUNK.size : packed_at - 8]), raw[packed_at:], size)
        except DAMAGE:
            return Chunk(first_ns, last_ns, memoryview(b""), whole, sound=False)
        if whole and checksum and zlib.crc32(data) != checksum:
            return Chunk(first_ns, last_ns, memoryview(b""), whole, sound=False)
        return Chunk(first_ns, last_ns, data, whole, sound=len(data) == size)

    def _packed(self, length: int) -> memoryview:
        if length > len(self._raw):
            self._raw = bytearray(length)
        into = memoryview(self._raw)[:length]
        return into[: self._file.readinto(into)]

    def _unpack(self, compression: bytes, packed: memoryview, size: int) -> memoryview:
        """Return what can be unpacked."""
        if not compression:
            return packed
        if size > len(self._unpacked):
            self._unpacked = bytearray(size)
        into, got = memoryview(self._unpacked)[:size], 0
        if compression == b"zstd":
            reader: Any = zstandard.ZstdDecompressor().stream_reader(packed)
            while got < size and (more := reader.readinto(into[got:])):
                got += more
        elif compression == b"lz4":
            unpacker: Any = lz4.frame.LZ4FrameDecompressor()
            for at in range(0, len(packed), STEP):
                piece = unpacker.decompress(packed[at : at + STEP])
                into[got : got + len(piece)] = piece  # a ValueError where it is too much
                got += len(piece)
        else:
            raise ValueError(f"unknown compression {compression}")
        return into[:got]
