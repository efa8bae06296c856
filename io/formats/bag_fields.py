"""The fields of a ROS 1 bag's records, and the two kinds of record that hold messages and their types.

http://wiki.ros.org/Bags/Format/2.0
"""

import struct
from collections.abc import Mapping
from typing import NamedTuple, TypeAlias

WORD = struct.Struct("<I")
TIME = struct.Struct("<II")


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


def op_of(fields: Fields) -> int:
    """Return what a record is; raise CutError if its header does not say so."""
    return number_of(fields, b"op", 1)


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
