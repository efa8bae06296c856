"""ROS messages (CDR of ROS 2, or ROS 1's format) to columns by field path, with the definition that a log carries.

rosbags' type system reads the definition; no ROS distribution is assumed. Messages of a regular layout are read all at
once (ros_byte_layout); rosbags decodes the others one by one, and reports which do not match.
"""

import re
import struct
from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any, Literal

from rosbags.interfaces import Nodetype
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, TypesysError, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from usbldr.io.decoding.columns import TYPE_FIELDS, DecodedRows, DefinitionError, Extractor, decode_one_by_one
from usbldr.io.decoding.definitions import Types, ros2_name
from usbldr.io.decoding.ros_byte_layout import TIMES, decode_by_layout
from usbldr.io.limits import RAISE, limit


class RosDecoder:
    """The messages of one type."""

    def __init__(self, name: str, types: Types, encoding: Literal["cdr", "ros1"] = "cdr") -> None:
        """Take the definitions of a type and of those in it; raise DefinitionError if one is missing."""
        self._encoding = encoding
        self._name = ros2_name(name)
        self._definitions = dict(types)
        try:
            self._refuse_endless(self._name, {}, set())
            paths = self._paths(self._name)
        except RecursionError as err:
            raise DefinitionError("it is nested too deeply") from err
        except KeyError as err:
            raise DefinitionError(" ".join(str(err).split())[:80]) from err
        self.fields = tuple(paths)
        self.arrays = frozenset(path for path, is_array in paths.items() if is_array)

    def _refuse_endless(self, name: str, counted: dict[str, int], within: set[str]) -> int:
        """Return the number of fields below a type; raise DefinitionError if it contains itself, or has too many.

        ``counted``: numbers of other types; ``within``: the types that this one is part of.
        """
        if name in within:
            raise DefinitionError(f"{name} contains itself")
        if name not in counted:
            total = 0
            for _, (kind, what) in self._definitions[name][1]:
                element, times = ((kind, what), 1) if kind in (Nodetype.BASE, Nodetype.NAME) else what
                inside = element[0] is Nodetype.NAME and element[1] not in TIMES
                below = self._refuse_endless(str(element[1]), counted, within | {name}) if inside else 1
                loops = kind is Nodetype.ARRAY and (inside or element[1][0] == "string")
                total += below * max(1, times) if loops else below
            counted[name] = total
        if counted[name] > limit(TYPE_FIELDS):
            raise DefinitionError(f"{name} has more than {limit(TYPE_FIELDS)} fields; {RAISE}")
        return counted[name]

    @cached_property
    def _store(self) -> Typestore:
        """Return rosbags' decoder; it uses each log's own definitions, so those of two logs cannot conflict."""
        store = get_typestore(Stores.EMPTY)
        store.register(self._definitions)
        return store

    def _paths(self, name: str, prefix: str = "") -> dict[str, bool]:
        """Return the fields below a type, scalars and times by their path, and which are arrays of scalars."""
        found: dict[str, bool] = {}
        for field, (kind, what) in self._definitions[name][1]:
            path = prefix + field
            if kind is Nodetype.NAME and what not in TIMES:
                found |= self._paths(str(what), path + ".")
            elif kind in (Nodetype.BASE, Nodetype.NAME):
                found[path] = False
            elif isinstance(what[0], tuple) and what[0][0] is Nodetype.BASE:
                found[path] = True
            else:
                self._paths(str(what[0][1]))  # raises KeyError if there is no such type
        return found

    def fits(self, payloads: Sequence[bytes]) -> bool:
        """Return whether all of some messages match the definition."""
        return sum(len(piece.rows) for piece in self.pieces(payloads, ())) == len(payloads)

    def pieces(self, payloads: Sequence[bytes], paths: Sequence[str]) -> list[DecodedRows]:
        """Read all messages; those that do not match the definition are in no piece."""
        pieces, left = decode_by_layout(self._definitions, self._name, payloads, paths, self._encoding == "cdr")
        if len(left):
            pieces.append(decode_one_by_one(self.extractor(paths), payloads, paths, left.tolist()))
        return pieces

    def extractor(self, paths: Sequence[str]) -> Extractor:
        """Return a function from a message's bytes to the values at the paths; to None if the bytes do not match."""
        getters = [_getter(path) for path in paths]
        deserialize = self._store.deserialize_ros1 if self._encoding == "ros1" else self._store.deserialize_cdr

        def extract(data: bytes) -> tuple[Any, ...] | None:
            try:
                message = deserialize(data, self._name)
            except (SerdeError, struct.error, ValueError, IndexError):
                return None
            return tuple(getter(message) for getter in getters)

        return extract


def from_msg(name: str, definition: bytes, encoding: Literal["cdr", "ros1"] = "cdr") -> RosDecoder:
    """Return the decoder for a definition in ROS's own language; raise DefinitionError if it is invalid."""
    return _read(name, definition, encoding, lambda text: get_types_from_msg(text, ros2_name(name)))


def from_idl(name: str, definition: bytes) -> RosDecoder:
    """Return the decoder for a definition in OMG IDL, as rosbag2 writes it: one part for each type in it."""
    return _read(name, definition, "cdr", _idl_types)


def _read(
    name: str, definition: bytes, encoding: Literal["cdr", "ros1"], types_of: Callable[[str], Types]
) -> RosDecoder:
    try:
        types = types_of(definition.decode())
    except RecursionError as err:
        raise DefinitionError("it is nested too deeply") from err
    except (TypesysError, UnicodeDecodeError, KeyError) as err:
        raise DefinitionError(" ".join(str(err).split())[:80]) from err
    return RosDecoder(name, types, encoding)


def _idl_types(text: str) -> Types:
    """Return the types of an IDL definition; a part begins with a line of "=" and a line with the type's name."""
    types: dict[str, Any] = {}
    for part in re.split(r"^={80}\n", text, flags=re.MULTILINE):
        body = re.sub(r"\AIDL: .*\n", "", part)
        if body.strip():
            types |= get_types_from_idl(body)
    return types


def _getter(path: str) -> Callable[[object], Any]:
    """Return a function from a message to the value at the path; times become integer nanoseconds."""
    parts = path.split(".")
    index = int(parts.pop()) if parts[-1].isdecimal() else None

    def get(message: Any) -> Any:
        for part in parts:
            message = getattr(message, part)
        if index is not None:
            return message[index] if index < len(message) else float("nan")
        if hasattr(message, "nanosec"):
            return message.sec * 1_000_000_000 + message.nanosec
        return message

    return get
