"""Message definitions that a log may lack: those of ROS 2 itself, of known navigation messages, and of the user.

A folder of the user's holds .msg files as ROS packages do: PACKAGE/msg/TYPE.msg.
"""

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

from usbldr.filters.errors import UsageError
from usbldr.io.limits import RAISE, limit

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

Types: TypeAlias = Mapping[str, Any]  # rosbags': type name -> (constants, ((field, description), ...))
FOLDER_ENTRIES = 50_000  # [files and folders] below a folder of definitions; all of ROS has 20,000
MESSAGE_FILE_BYTES = 1 << 16  # [bytes] of a .msg file; the longest of ROS has 20 kB
SEPARATOR = "=" * 80 + "\nMSG: "  # fixed by ROS: between definitions in one text
WRITTEN = ("marine_acoustic_msgs/msg/Dvl", "dvl_msgs/msg/DVLBeam", "dvl_msgs/msg/DVL")


@dataclass(frozen=True, slots=True)
class Definitions:
    """Definitions by type, "PACKAGE/msg/TYPE"; for each its possible layouts, the likeliest first."""

    texts: Mapping[str, Sequence[str]]

    def layouts(self, type_name: str) -> list[Types]:
        """Return the definitions of a type and of all types in it, one for each layout; none if it is unknown."""
        name = ros2_name(type_name)
        if name in _standard():
            return [_with_parts(name, {name: _standard()[name]}, self)]
        return [_with_parts(name, parsed(text, name), self) for text in self.texts.get(name, ())]


def _known() -> dict[str, list[str]]:
    """Return the definitions that come with usbldr, by type."""
    found: dict[str, list[str]] = {}
    text = (files("usbldr.io.decoding") / "known_types.msg").read_text(encoding="utf-8")
    for part in text.split(SEPARATOR)[1:]:
        name, _, definition = part.partition("\n")
        found.setdefault(name, []).append(definition)
    return found


KNOWN: Mapping[str, Sequence[str]] = _known()
SHIPPED = Definitions(KNOWN)


def ros2_name(type_name: str) -> str:
    """Return a type's name as ROS 2 spells it; ROS 1 and the first rosbag2 leave "/msg" out."""
    return type_name if type_name.count("/") > 1 else type_name.replace("/", "/msg/")


def with_folders(folders: Sequence[str]) -> Definitions:
    """Return usbldr's definitions and, before them, those of folders of .msg files.

    Raises UsageError for a folder that is missing or holds no .msg file, and for an invalid .msg file.
    """
    from rosbags.typesys import TypesysError

    texts: dict[str, Sequence[str]] = dict(KNOWN)
    for folder in map(Path, folders):
        found = sorted(_message_files(folder))
        if not found:
            what = "holds no .msg file" if folder.is_dir() else "no such folder"
            raise UsageError(f"--msg-path {folder}: {what}; expected PACKAGE/msg/TYPE.msg")
        for file in found:
            package = file.parent.parent if file.parent.name == "msg" else file.parent
            name = f"{package.name}/msg/{file.stem}"
            try:
                if not file.is_file() or file.stat().st_size > limit(MESSAGE_FILE_BYTES):  # a pipe would block
                    raise UsageError(f"is no file of at most {limit(MESSAGE_FILE_BYTES) >> 10} kB; {RAISE}", path=file)
                texts[name] = (file.read_text(encoding="utf-8"), *texts.get(name, ()))
                parsed(texts[name][0], name)
            except (TypesysError, UnicodeDecodeError, OSError, RecursionError) as err:
                raise UsageError(f"is not a message definition ({' '.join(str(err).split())[:80]})", path=file) from err
    return Definitions(texts)


def _message_files(folder: Path) -> Iterator[Path]:
    """Yield the .msg files below a folder, links to folders not followed; raise UsageError if it holds too much."""
    left = limit(FOLDER_ENTRIES)
    for place, folders, names in os.walk(folder.resolve()):
        left -= len(folders) + len(names)
        if left < 0:
            many = f"holds more than {limit(FOLDER_ENTRIES)} files and folders"
            raise UsageError(f"--msg-path {folder}: {many}; name the folder of the packages, or {RAISE}")
        yield from (Path(place) / name for name in names if name.endswith(".msg"))


def parsed(text: str, name: str) -> dict[str, Any]:
    """Return the type that a text defines, without the types in it."""
    from rosbags.typesys import get_types_from_msg

    return dict(get_types_from_msg(text, name))


def _with_parts(name: str, types: dict[str, Any], known: Definitions) -> Types:
    todo = [name]
    while todo:
        for part in _parts(types[todo.pop()]):
            if part not in types:
                found = {part: _standard()[part]} if part in _standard() else {}
                found = found or (parsed(known.texts[part][0], part) if part in known.texts else {})
                types |= found
                todo += found
    return types


def _parts(definition: Any) -> Iterator[str]:
    from rosbags.interfaces import Nodetype

    for _, (node, what) in definition[1]:
        if node is Nodetype.NAME:
            yield what
        elif node is not Nodetype.BASE and what[0][0] is Nodetype.NAME:
            yield what[0][1]


@cache
def _standard() -> Types:
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores.ROS2_HUMBLE).fielddefs


@cache
def known_types(ros_version: int) -> "Typestore":
    """Return the standard types of ROS 1 (Noetic) or ROS 2 (Humble) and those of usbldr that are written."""
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC if ros_version == 1 else Stores.ROS2_HUMBLE)
    for name in WRITTEN:
        store.register(parsed(KNOWN[name][0], name))
    return store
