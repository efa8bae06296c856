"""Where the containers in a file begin and end: files may have been concatenated, or have other bytes in front.

A container is walked from record to record. Files that are records one after the other need no such search: their
readers go on over anything.
"""

import struct
import zlib
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from typing import Literal, NamedTuple

from usbldr.io.file_access.decompression import compression_of
from usbldr.io.file_access.file_view import BLOCK_BYTES, FileView
from usbldr.io.limits import limit

MCAP, BAG, SQLITE = b"\x89MCAP0\r\n", b"#ROSBAG V2.0\n", b"SQLite format 3\x00"
PARQUET, HDF5, MATLAB = b"PAR1", b"\x89HDF\r\n\x1a\n", b"\0MATLAB"
MCAP_HEAD, MCAP_FOOTER = struct.Struct("<BQ"), struct.Struct("<BQQQI")  # fixed: opcode, length; summary's place
MCAP_HEADER, FOOTER, ATTACHMENT, DATA_END = b"\x01", 2, 9, 15  # fixed: MCAP's opcodes; of the first record as a byte
CHECKSUM_BYTES = 4  # fixed: of MCAP, all that the end of its data holds
BAG_NUMBERS = (b"index_pos=", b"conn_count=", b"chunk_count=")  # fixed: fields of a bag's first record
BAG_PLACES = (b"index_pos=", b"chunk_pos=")  # fixed: fields of eight bytes
OP, CHUNK, CHUNK_INFO, CONNECTION = b"op=", b"op=\x05", b"op=\x06", b"op=\x07"  # fixed: what the records of a bag are
WORD = struct.Struct("<I")
COMPRESSED = b"\0compressed"
MARKS = (MCAP + MCAP_HEADER, BAG, SQLITE, HDF5)
"""How containers begin that are found behind other bytes."""
MAT_HEAD_BYTES = 128  # fixed; the version ends the head
MAT_VERSIONS: Mapping[bytes, Literal["little", "big"]] = {b"\x00\x01IM": "little", b"\x01\x00MI": "big"}  # fixed
MAT_ELEMENTS = (14, 15)  # fixed: matrices, compressed elements
MAT_HDF5_AT = 512  # fixed: where HDF5 begins in a file of MATLAB 7.3
HDF5_END_AT = {0: 40, 1: 44, 2: 28, 3: 28}  # fixed: of the address by the version of the superblock
SEARCHED = 1 << 20  # [bytes] before a recording; a capture loses less than a buffer
RECORDINGS = 1000  # of one file: a day of files of two minutes


class Place(NamedTuple):
    """A part of a file."""

    start: int
    end: int
    kind: bytes  # how its container begins, empty if it is none


def places_of(data: FileView) -> list[Place]:
    """Return the containers in a file and what is between them, zeros left out; of several thousands the first ones.

    A file that does not begin with a container is searched for the first one up to a limit.
    """
    found: list[Place] = []
    at = data.after_zeros(0)
    is_parquet = data[len(data) - len(PARQUET) : len(data)] == PARQUET  # which is known by its end, too
    marks = (*MARKS, PARQUET) if is_parquet else MARKS
    while at < len(data):
        kind = container_at(data, at)
        end = _end(data, at, kind) if kind else _next(data, at, marks, len(data) if found else limit(SEARCHED))
        if len(found) == limit(RECORDINGS):
            kind, end = b"", len(data)
        found.append(Place(at, end, kind))
        at = data.after_zeros(end)
    return found


def _next(data: FileView, at: int, marks: Sequence[bytes], until: int | None = None) -> int:
    """Return where one of the marks is next, else the end of the file."""
    return min((place for mark in marks if (place := data.find(mark, at, until)) >= 0), default=len(data))


def container_at(data: FileView | bytes, start: int) -> bytes:
    """Return how the container at a byte begins, empty if none does."""
    head = data[start : start + MAT_HDF5_AT + len(HDF5)]
    if head[MAT_HEAD_BYTES - 4 : MAT_HEAD_BYTES] in MAT_VERSIONS or head[MAT_HDF5_AT:] == HDF5:
        return MATLAB
    if compression_of(head):
        return COMPRESSED
    return next((magic for magic in ENDS if head.startswith(magic)), b"")


def _end(data: FileView, start: int, kind: bytes) -> int:
    """Return where a container ends; of a damaged one, where the next of its kind begins, else the end of the file."""
    try:
        end = ENDS[kind](data, start)
        if start < end <= len(data):
            return end
        behind = len(data)
    except (struct.error, BrokenError) as err:
        behind = err.at if isinstance(err, BrokenError) else start + 1
    return _next(data, behind, {MCAP: (MARKS[0],), BAG: (BAG,)}.get(kind, MARKS))


class BrokenError(Exception):
    """The records of a container cannot be followed to its end; another may begin behind a byte."""

    def __init__(self, at: int) -> None:
        super().__init__()
        self.at = at


def summary_ends_file(data: FileView, start: int = 0) -> bool:
    """Return whether an MCAP file ends with the summary that its footer names, and has all of its data before it."""
    footer = len(data) - MCAP_FOOTER.size - len(MCAP)
    if footer <= start or data[len(data) - len(MCAP) : len(data)] != MCAP:
        return False
    op, _, summary, _, _ = MCAP_FOOTER.unpack(data[footer : footer + MCAP_FOOTER.size])
    if op != FOOTER or not 0 < summary < footer - start:
        return False
    end = data[start + summary - MCAP_HEAD.size - CHECKSUM_BYTES : start + summary - CHECKSUM_BYTES]
    if end != MCAP_HEAD.pack(DATA_END, CHECKSUM_BYTES):  # the record before the summary, which ends the data
        return False
    with suppress(BrokenError):
        return _mcap_walk(data, start + summary) == len(data)
    return False


def _mcap_walk(data: FileView, at: int) -> int:
    """Return where the records from a byte on end; raise BrokenError with a byte behind all attachments.

    A record that was cut may by its length reach into the next recording and end with a record of that.
    """
    attached = at
    while at + MCAP_HEAD.size <= len(data):
        op, length = MCAP_HEAD.unpack(data[at : at + MCAP_HEAD.size])
        at += MCAP_HEAD.size + length
        if not op or at > len(data):
            break
        if op == FOOTER and data[at : at + len(MCAP)] == MCAP:
            inside = data.find(MARKS[0], attached, at)
            return inside if inside >= 0 else at + len(MCAP)
        if op == ATTACHMENT and _is_attachment(data, at - length, at):
            attached = at
    raise BrokenError(attached)


def _is_attachment(data: FileView, start: int, end: int) -> bool:
    """Return whether an attachment has its checksum: behind damage any bytes may look like one."""
    checksum = 0
    for at in range(start, end - CHECKSUM_BYTES, BLOCK_BYTES):
        checksum = zlib.crc32(data[at : min(at + BLOCK_BYTES, end - CHECKSUM_BYTES)], checksum)
    return checksum.to_bytes(CHECKSUM_BYTES, "little") == data[end - CHECKSUM_BYTES : end]


def _word(data: FileView, at: int) -> int:
    return WORD.unpack(data[at : at + WORD.size])[0]


def _bag_end(data: FileView, start: int) -> int:
    """Return where a bag ends: behind its index, or where another one begins."""
    head = start + len(BAG)
    fields = data[head + WORD.size : head + WORD.size + _word(data, head)]
    index, connections, chunks = (_bag_number(fields, name) for name in BAG_NUMBERS)
    with suppress(BrokenError):
        if index and connections + chunks:
            return _bag_walk(data, start + index, connections + chunks, start)
    return _bag_walk(data, head)


def _bag_number(fields: bytes, name: bytes) -> int:
    _, _, value = fields.partition(name)
    return int.from_bytes(value[: 8 if name in BAG_PLACES else 4], "little")


def _bag_walk(data: FileView, at: int, count: int = -1, start: int = 0) -> int:
    """Return where so many records of the index of a bag end, or where its records end; raise BrokenError.

    ``start``: the bag, in which the index names the places of its chunks. Another bag may begin behind a record.
    """
    begin = at
    while at < len(data) and count and data[at : at + len(BAG)] != BAG:
        if not any(data[at : at + WORD.size]):
            at = data.after_zeros(at)
            continue
        header = _bag_header(data, at)
        for _ in range(2):  # header and data
            at += WORD.size + (_word(data, at) if at + WORD.size <= len(data) else len(data))
        chunk = start + _bag_number(header, BAG_PLACES[1]) if count > 0 and CHUNK_INFO in header else -1
        listed = CHUNK in _bag_header(data, chunk) if 0 <= chunk < begin else CONNECTION in header
        if OP not in header or (count > 0 and not listed):
            raise BrokenError(begin)
        count -= 1
    if at > len(data) or count > 0:
        raise BrokenError(begin)
    return at


def _bag_header(data: FileView, at: int) -> bytes:
    begin = at + WORD.size
    return data[begin : begin + min(_word(data, at), SEARCHED)] if begin <= len(data) else b""


def _sqlite_end(data: FileView, start: int) -> int:
    head = data[start : start + 100]
    page, pages = int.from_bytes(head[16:18]), int.from_bytes(head[28:32])
    stated = head[24:28] == head[92:96]  # else the number of pages is not valid
    return start + (65536 if page == 1 else page) * pages if stated and pages else len(data)


def _parquet_end(data: FileView, start: int) -> int:
    """Return the place behind the first footer that another file or the end follows, else behind the last footer."""
    at = last = start
    while (at := data.find(PARQUET, at + len(PARQUET))) >= 0:
        if 0 < _word(data, at - WORD.size) <= at - WORD.size - start:
            last = at + len(PARQUET)
            after = data.after_zeros(last)
            if after == len(data) or data[after : after + len(PARQUET)] == PARQUET:
                return last
    return last if last > start else len(data)


def _hdf5_end(data: FileView, start: int, superblock: int = 0) -> int:
    at = start + superblock + len(HDF5)
    version = int.from_bytes(data[at : at + 1])
    if version not in HDF5_END_AT:
        raise BrokenError(at)
    at = start + superblock + HDF5_END_AT[version]
    end = data[at : at + 8]
    return start + int.from_bytes(end, "little") if end.strip(b"\xff") else len(data)


def _mat_end(data: FileView, start: int) -> int:
    if data[start + MAT_HDF5_AT : start + MAT_HDF5_AT + len(HDF5)] == HDF5:
        return _hdf5_end(data, start, MAT_HDF5_AT)
    order = MAT_VERSIONS[data[start + MAT_HEAD_BYTES - 4 : start + MAT_HEAD_BYTES]]
    at = start + MAT_HEAD_BYTES
    while at + 8 <= len(data):
        kind, length = (int.from_bytes(data[place : place + 4], order) for place in (at, at + 4))
        if kind not in MAT_ELEMENTS:
            break
        at += 8 + length
    return min(at, len(data))


ENDS: Mapping[bytes, Callable[[FileView, int], int]] = {
    MCAP: lambda data, start: len(data) if summary_ends_file(data, start) else _mcap_walk(data, start + len(MCAP)),
    BAG: _bag_end,
    SQLITE: _sqlite_end,
    PARQUET: _parquet_end,
    HDF5: _hdf5_end,
    MATLAB: _mat_end,
    COMPRESSED: lambda data, start: len(data),
}
"""By how a container begins: from the file and its place to its end. Raises BrokenError where it is damaged."""
