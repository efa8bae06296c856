"""ROS messages (cdr of ROS 2, or ROS 1's own bytes) to values by field path, by the definition that a log carries.

rosbags' type system reads the definition and decodes; no ROS distribution is assumed.
"""

import struct
from collections.abc import Callable, Sequence
from typing import Any

from rosbags.interfaces import Nodetype
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, TypesysError, get_types_from_msg, get_typestore

Extractor = Callable[[bytes], tuple[Any, ...] | None]
TIMES = ("builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration")


class DefinitionError(ValueError):
    """The text of a message definition makes no sense."""


class RosDecoder:
    """The messages of one type."""

    def __init__(self, name: str, definition: bytes, encoding: str = "cdr") -> None:
        """Read the definition; raise DefinitionError where that fails. ``encoding`` is "cdr" or "ros1"."""
        self._encoding = encoding
        self._name = name if name.count("/") > 1 else name.replace("/", "/msg/")  # ROS 1 spells pkg/Type
        self._store = get_typestore(Stores.EMPTY)  # one for each type: two logs' definitions cannot disagree
        try:
            self._store.register(get_types_from_msg(definition.decode(), self._name))
            self.fields = tuple(self._paths(self._name))
            self._store.get_msgdef(self._name)
        except (TypesysError, UnicodeDecodeError, KeyError) as err:
            raise DefinitionError(" ".join(str(err).split())[:80]) from err

    def _paths(self, name: str, prefix: str = "") -> list[str]:
        """List the fields below a type: scalars and times by their path, arrays of scalars by their name."""
        found: list[str] = []
        for field, (kind, what) in self._store.fielddefs[name][1]:
            path = prefix + field
            if kind is Nodetype.NAME and what not in TIMES:
                found += self._paths(str(what), path + ".")
            elif kind in (Nodetype.BASE, Nodetype.NAME) or (isinstance(what[0], tuple) and what[0][0] is Nodetype.BASE):
                found.append(path)
        return found

    def extractor(self, paths: Sequence[str]) -> Extractor:
        """Return a function from a message's bytes to the values at the paths; to None where the bytes do not fit."""
        getters = [_getter(path) for path in paths]
        deserialize = self._store.deserialize_ros1 if self._encoding == "ros1" else self._store.deserialize_cdr

        def extract(data: bytes) -> tuple[Any, ...] | None:
            try:
                message = deserialize(data, self._name)
            except (SerdeError, struct.error, ValueError, IndexError):
                return None
            return tuple(getter(message) for getter in getters)

        return extract


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
