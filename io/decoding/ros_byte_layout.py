"""Many ROS messages at once: the place of each field is found in one message, and checked in all others.

A text or a sequence shifts what follows it, so a type has no fixed layout; but messages of one topic hardly differ
in those lengths. One message is read by its definition, noting the place of each number and which bytes state a
length. Every message of the same size that states the same lengths has its numbers at the same places, and a field
of all of them is one slice of a table of bytes. A message that differs starts a layout of its own, and one whose
layout cannot be found is decoded one by one.

CDR, as ROS 2 writes it, aligns numbers to their size, counted from after the 4 bytes that name the encoding (OMG
formal/02-06-51, 15.3); ROS 1 aligns nothing. Both are little-endian here.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Nodetype

from usbldr.io.decoding.columns import DecodedRows
from usbldr.io.reader import Column

Definitions: TypeAlias = Mapping[str, Any]  # rosbags' fielddefs: type name -> (constants, ((field, description), ...))
Block: TypeAlias = NDArray[np.uint8]  # (n, size): n messages of one size
Rows: TypeAlias = NDArray[np.intp]

TIMES = ("builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration")
TIME, TEXT = "time", "text"  # kinds of places; others are NumPy's
NUMBERS: Mapping[str, str] = {
    "bool": "?",
    "byte": "u1",
    "char": "u1",
    "int8": "i1",
    "uint8": "u1",
    "int16": "<i2",
    "uint16": "<u2",
    "int32": "<i4",
    "uint32": "<u4",
    "int64": "<i8",
    "uint64": "<u8",
    "float32": "<f4",
    "float64": "<f8",
}
MAX_LAYOUTS_PER_SIZE = 100  # [layouts] of messages of one size; further messages are decoded one by one


class UnknownLayoutError(Exception):
    """The bytes do not match the definition, or are in an encoding that is not supported."""


class Place(NamedTuple):
    """The place of a field in every message of a layout."""

    offset: int
    kind: str
    length: int  # of an array in numbers, of a text in bytes
    array: bool = False


@dataclass(frozen=True, slots=True)
class ByteLayout:
    """The places of all fields, and the bytes that identify the layout."""

    places: Mapping[str, Place]
    fixed_at: NDArray[np.intp]
    fixed: NDArray[np.uint8]

    def matches(self, block: Block) -> NDArray[np.bool_]:
        """Return which messages have this layout, (n,)."""
        return np.all(block[:, self.fixed_at] == self.fixed, axis=1)

    def column(self, block: Block, path: str, unset: Any) -> Column:
        """Return a field of all messages, (n,); ``unset`` if their array is too short to have it.

        Raises UnknownLayoutError for a whole array, and UnicodeDecodeError.
        """
        place = self.places.get(path)
        if place is None:
            name, _, number = path.rpartition(".")
            array = self.places.get(name)
            if array is None or int(number) >= array.length:
                return np.full(len(block), unset)
            place = Place(array.offset + int(number) * np.dtype(array.kind).itemsize, array.kind, 1)
        if place.array:
            raise UnknownLayoutError
        return _values(block, place)


def _values(block: Block, place: Place) -> Column:
    def view(kind: str, size: int) -> Column:
        return np.ascontiguousarray(block[:, place.offset : place.offset + size]).view(kind)

    if place.kind == TIME:
        return view("<i4", 8)[:, 0] * np.int64(1_000_000_000) + view("<u4", 8)[:, 1]
    if place.kind == TEXT:
        if place.length == 0:
            return np.full(len(block), "")
        texts, which = np.unique(view(f"S{place.length}", place.length)[:, 0], return_inverse=True)
        return np.array([text.decode() for text in texts])[which]
    if place.kind == "?":
        return view("u1", 1)[:, 0] != 0
    return view(place.kind, np.dtype(place.kind).itemsize)[:, 0]


class _LayoutTracer:
    """One message, read field by field."""

    def __init__(self, definitions: Definitions, sample: bytes, aligned: bool) -> None:
        self._definitions = definitions
        self._sample = sample
        self._aligned = aligned
        self.at = 4 if aligned else 0
        self.places: dict[str, Place] = {}
        self.fixed = {0: 0, 1: 1} if aligned else dict[int, int]()  # byte 0, 1: plain little-endian CDR

    def message(self, name: str, prefix: str = "") -> None:
        for field, description in self._definitions[name][1]:
            self._field(prefix + field, description)

    def _field(self, path: str, description: tuple[Nodetype, Any]) -> None:
        node, what = description
        if node is Nodetype.BASE:
            self._base(path, what[0])
        elif node is Nodetype.NAME and what in TIMES:
            self.places[path] = Place(self._take(4, 2), TIME, 1)
        elif node is Nodetype.NAME:
            self.message(what, path + ".")
        else:
            element, count = what
            self._elements(path, element, count if node is Nodetype.ARRAY else self._length())

    def _base(self, path: str, name: str) -> None:
        if name == "string":
            size = self._length()
            ended = 1 if self._aligned else 0  # CDR counts the zero at a text's end
            offset = self._take(1, size)
            if ended:
                self._fix(self.at - 1, 1)
            self.places[path] = Place(offset, TEXT, size - ended)
            if size < ended or (ended and self._sample[self.at - 1]):
                raise UnknownLayoutError
        else:
            kind = _number(name)
            self.places[path] = Place(self._take(np.dtype(kind).itemsize, 1), kind, 1)

    def _elements(self, path: str, element: tuple[Nodetype, Any], count: int) -> None:
        node, what = element
        if node is Nodetype.BASE and what[0] != "string":
            kind = _number(what[0])
            offset = self._take(np.dtype(kind).itemsize, count) if count else self.at
            self.places[path] = Place(offset, kind, count, array=True)
        else:
            for index in range(count):
                self._field(f"{path}.{index}", element)

    def _length(self) -> int:
        offset = self._take(4, 1)
        self._fix(offset, 4)
        length = int.from_bytes(self._sample[offset : offset + 4], "little")
        if length > len(self._sample):
            raise UnknownLayoutError
        return length

    def _take(self, size: int, count: int) -> int:
        """Return the place of values of a size, and move past them."""
        if self._aligned:
            self.at += (4 - self.at) % size
        offset = self.at
        self.at += size * count
        if self.at > len(self._sample):
            raise UnknownLayoutError
        return offset

    def _fix(self, offset: int, count: int) -> None:
        self.fixed |= {at: self._sample[at] for at in range(offset, offset + count)}


def _number(name: str) -> str:
    if name not in NUMBERS:
        raise UnknownLayoutError
    return NUMBERS[name]


def byte_layout_of(definitions: Definitions, name: str, sample: bytes, aligned: bool) -> ByteLayout:
    """Return the layout of a message of a type; raise UnknownLayoutError if its bytes do not match.

    ``aligned``: True for CDR, False for ROS 1.
    """
    walk = _LayoutTracer(definitions, sample, aligned)
    walk.message(name)
    if not 0 <= len(sample) - walk.at <= (3 if aligned else 0):  # CDR may be padded
        raise UnknownLayoutError
    fixed = sorted(walk.fixed.items())
    at, values = [at for at, _ in fixed], [value for _, value in fixed]
    layout = ByteLayout(walk.places, np.array(at, dtype=np.intp), np.array(values, dtype=np.uint8))
    if not layout.matches(np.frombuffer(sample, dtype=np.uint8)[np.newaxis])[0]:
        raise UnknownLayoutError
    return layout


def decode_by_layout(
    definitions: Definitions, name: str, payloads: Sequence[bytes], unset: Mapping[str, Any], aligned: bool
) -> tuple[list[DecodedRows], Rows]:
    """Read all messages that have a layout; return them in pieces, and which messages are left.

    ``unset``: the wanted fields, and the value of each if an array is too short to have it.
    """
    pieces: list[DecodedRows] = []
    left: list[Rows] = [np.empty(0, dtype=np.intp)]
    sizes = np.array([len(payload) for payload in payloads], dtype=np.intp)
    by_size = np.argsort(sizes, kind="stable")
    of_sizes = np.split(by_size, np.flatnonzero(np.diff(sizes[by_size])) + 1) if len(payloads) else []
    for rows in of_sizes:
        of_one_size = [payloads[int(row)] for row in rows]
        block = np.frombuffer(b"".join(of_one_size), dtype=np.uint8).reshape(len(rows), -1)
        for _ in range(MAX_LAYOUTS_PER_SIZE):
            if not len(rows):
                break
            try:
                layout = byte_layout_of(definitions, name, payloads[int(rows[0])], aligned)
                same = layout.matches(block)
                table = block if same.all() else block[same]
                pieces.append(
                    DecodedRows(rows[same], {path: layout.column(table, path, value) for path, value in unset.items()})
                )
            except (UnknownLayoutError, UnicodeDecodeError):
                same = np.arange(len(rows)) == 0
                left.append(rows[same])
            rows, block = rows[~same], block[~same]
        left.append(rows)
    return pieces, np.concatenate(left)
