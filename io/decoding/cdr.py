"""ROS messages (CDR of ROS 2, or ROS 1's format) to columns by field path, with the definition that a log carries.

rosbags' type system reads the definition; no ROS distribution is assumed. Messages of a regular layout are read all at
once (ros_byte_layout); rosbags decodes the others one by one, and reports which do not match.
"""

import re
import struct
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cached_property
from typing import Any, Literal, NamedTuple

from rosbags.interfaces import Nodetype
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, TypesysError, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from usbldr.io.decoding.columns import (
    DecodedRows,
    DefinitionError,
    Extractor,
    arrays_within,
    decode_one_by_one,
    extractor,
    limited,
)
from usbldr.io.decoding.definitions import Types, ros2_name
from usbldr.io.decoding.ros_byte_layout import TIMES, decode_by_layout
from usbldr.io.reader import listed_field

IDL_TEXT = re.compile(r'"(?:\\.|[^"\\])*"|/\*.*?\*/|//[^\n]*', re.DOTALL)  # strings and comments
COMPUTED = re.compile(r"<<|\*")
DIRECTIVE = re.compile(r"^[ \t]*#.*\n", re.MULTILINE)  # #include of a type whose definition is another part


class Leaf(NamedTuple):
    """A field that holds no others: a number, text or time, or an array of such."""

    unset: float | str  # its value if an array is too short to have it; of a time 0
    is_array: bool


class RosDecoder:
    """The messages of one type."""

    def __init__(self, name: str, types: Types, encoding: Literal["cdr", "ros1"] = "cdr") -> None:
        """Take the definitions of a type and of those in it; raise DefinitionError if one is missing."""
        self._encoding = encoding
        self._name = ros2_name(name)
        self._definitions = dict(types)
        try:
            self._kinds: Mapping[str, Leaf] = limited(self._leaves(self._name))
        except RecursionError as err:
            raise DefinitionError("it is nested too deeply") from err
        except KeyError as err:
            raise DefinitionError(" ".join(str(err).split())[:80]) from err
        self.fields = tuple(self._kinds)
        self.arrays = arrays_within(self.fields) | {path for path, leaf in self._kinds.items() if leaf.is_array}

    @cached_property
    def _store(self) -> Typestore:
        """Return rosbags' decoder; it uses each log's own definitions, so those of two logs cannot conflict."""
        store = get_typestore(Stores.EMPTY)
        store.register({name: what for name, what in self._definitions.items() if name not in TIMES})  # it has those
        return store

    def _leaves(
        self, name: str, prefix: str = "", within: frozenset[str] = frozenset()
    ) -> Iterator[tuple[str, Leaf | None]]:
        """Yield the fields below a type by path, None for a message; of an array of messages those of the first.

        A fixed number of messages or texts counts as so many fields: they are read one by one. Raises DefinitionError
        if the type is one of those that it is ``within``.
        """
        if name in within:
            raise DefinitionError(f"{name} contains itself")
        for field, (kind, what) in self._definitions[name][1]:
            path, is_array = prefix + field, kind not in (Nodetype.BASE, Nodetype.NAME)
            node, element = what[0] if is_array else (kind, what)
            inside = node is Nodetype.NAME and element not in TIMES
            text = node is Nodetype.BASE and "string" in element[0]
            unset = "" if text else float("nan") if node is Nodetype.BASE else 0
            for _ in range(max(1, what[1]) if kind is Nodetype.ARRAY and (inside or text) else 1):
                yield path, None if inside else Leaf(unset, is_array)
                if inside:
                    yield from self._leaves(str(element), path + (".0." if is_array else "."), within | {name})

    def _unset(self, path: str) -> Any:
        """Return the value of a field of a message whose array is too short to have it."""
        return self._kinds[listed_field(path, self._kinds, self.arrays) or path].unset

    def fits(self, payloads: Sequence[bytes]) -> bool:
        """Return whether all of some messages match the definition."""
        return sum(len(piece.rows) for piece in self.pieces(payloads, ())) == len(payloads)

    def pieces(self, payloads: Sequence[bytes], paths: Sequence[str]) -> list[DecodedRows]:
        """Read all messages; those that do not match the definition are in no piece."""
        unset = {path: self._unset(path) for path in paths}
        pieces, left = decode_by_layout(self._definitions, self._name, payloads, unset, self._encoding == "cdr")
        if len(left):
            pieces.append(decode_one_by_one(self.extractor(paths), payloads, paths, left.tolist()))
        return pieces

    def extractor(self, paths: Sequence[str]) -> Extractor:
        """Return a function from a message's bytes to the values at the paths; to None if the bytes do not match."""
        getters = [_getter(path, self._unset(path)) for path in paths]
        deserialize = self._store.deserialize_ros1 if self._encoding == "ros1" else self._store.deserialize_cdr
        errors = (SerdeError, struct.error, ValueError, IndexError)
        return extractor(lambda data: deserialize(data, self._name), getters, errors)


def ros_decoder(
    name: str, definition: bytes, encoding: Literal["cdr", "ros1"] = "cdr", language: Literal["msg", "idl"] = "msg"
) -> RosDecoder:
    """Return the decoder for a definition in ROS's own language, or in OMG IDL as rosbag2 writes it.

    Raises DefinitionError if it is invalid.
    """
    try:
        text = definition.decode()
        types = _idl_types(text) if language == "idl" else get_types_from_msg(text, ros2_name(name))
    except RecursionError as err:
        raise DefinitionError("it is nested too deeply") from err
    except (TypesysError, ValueError, KeyError) as err:
        raise DefinitionError(" ".join(str(err).split())[:80]) from err
    return RosDecoder(name, types, encoding)


def _idl_types(text: str) -> Types:
    """Return the types of an IDL definition, a part each; a part begins with a line of "=" and one with the name.

    Raises DefinitionError for constants that would have to be computed: a result may be endless, and no type needs it.
    """
    if COMPUTED.search(IDL_TEXT.sub("", text)):
        raise DefinitionError("it computes a constant by << or *, which is not supported")
    types: dict[str, Any] = {}
    for part in re.split(r"^={80}\n", text, flags=re.MULTILINE):
        body = DIRECTIVE.sub("", re.sub(r"\AIDL: .*\n", "", part))
        if body.strip():
            types |= get_types_from_idl(body)
    return types


def _getter(path: str, unset: Any) -> Callable[[object], Any]:
    """Return a function from a message to the value at the path, times as integer nanoseconds.

    It is ``unset`` if an array is too short.
    """
    parts = path.split(".")

    def get(message: Any) -> Any:
        for part in parts:
            if not part.isdecimal():
                message = getattr(message, part)
            elif int(part) < len(message):
                message = message[int(part)]
            else:
                return unset
        if hasattr(message, "nanosec"):
            return message.sec * 1_000_000_000 + message.nanosec
        return message

    return get
