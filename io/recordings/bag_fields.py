"""The fields of a ROS 1 bag's records, and the two kinds of record that hold messages and their types.

http://wiki.ros.org/Bags/Format/2.0
"""

import re
import struct
from collections.abc import Mapping
from typing import NamedTuple, TypeAlias

WORD = struct.Struct("<I")
TIME = struct.Struct("<II")
MESSAGE_HEAD = re.compile(
    rb"&\0\0\0(?:\x04\0\0\0(op)=\x02|\x09\0\0\0conn=(.{4})|\x0d\0\0\0time=(.{8})){3}(.{4})", re.DOTALL
)
"""The header of a message as all recorders write it, its fields in any order; then the length of the message."""
HEAD_NUMBERS = struct.Struct("<4I")


class CutError(Exception):
    """The bytes end inside a record, or are not a record."""


class Connection(NamedTuple):
    """A publisher of messages of one topic and type."""

    number: int
    topic: str
    type: str
    definition: bytes


class BagMessage(NamedTuple):
    """One message; its bytes are valid until the next record is read."""

    connection: int
    time_ns: int  # log time
    data: memoryview


Record: TypeAlias = Connection | BagMessage
Fields: TypeAlias = Mapping[bytes, bytes]


def message_head(data: memoryview, at: int) -> tuple[int, int, int, int] | None:
    """Return connection, log time in ns, and first byte and end of the message whose record begins at a byte.

    None if its header holds anything but a message's three fields: it is to be read field by field. Most records of a
    bag are messages, and this takes a third of the time.
    """
    head = MESSAGE_HEAD.match(data, at)
    if head is None:
        return None
    op, connection, time, length = head.groups()
    if op is None or connection is None or time is None:  # a field is there twice
        return None
    number, seconds, nanoseconds, size = HEAD_NUMBERS.unpack(connection + time + length)
    return number, seconds * 1_000_000_000 + nanoseconds, head.end(), head.end() + size


def read_fields(header: bytes) -> Fields:
    """Return the fields of a record's header; raise CutError if it is not valid."""
    fields: dict[bytes, bytes] = {}
    at = 0
    while at < len(header):
        if at + 4 > len(header):
            raise CutError
        (length,) = WORD.unpack_from(header, at)
        name, equals, value = header[at + 4 : at + 4 + length].partition(b"=")
        if not equals or at + 4 + length > len(header):
            raise CutError
        fields[name] = value
        at += 4 + length
    return fields


def number_of(fields: Fields, name: bytes, size: int) -> int:
    """Return an unsigned number of a header; raise CutError if it is missing or has another size."""
    value = fields.get(name, b"")
    if len(value) != size:
        raise CutError
    return int.from_bytes(value, "little")


def read_connection(number: int, fields: Fields, data: memoryview) -> Connection:
    """Return the connection of a record; raise CutError if it is not valid."""
    info = read_fields(bytes(data))
    try:
        name = (info.get(b"topic") or fields[b"topic"]).decode()
        return Connection(number, name, info[b"type"].decode(), info[b"message_definition"])
    except (KeyError, UnicodeDecodeError) as err:
        raise CutError from err
