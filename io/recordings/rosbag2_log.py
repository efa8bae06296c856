"""rosbag2 recordings: a folder of .db3 or .mcap parts with or without its metadata.yaml."""

import re
from collections.abc import Callable
from pathlib import Path

import msgspec
from msgspec import Struct

from usbldr.filters.errors import LogError, listed
from usbldr.io.file_access.open_file import opened
from usbldr.io.findings import Finding
from usbldr.io.limits import RAISE, limit
from usbldr.io.reader import Reader
from usbldr.io.recordings.joined import JoinedLog, readable_parts
from usbldr.io.settings.plain_yaml import plain_yaml

STORAGES = (".db3", ".mcap")
METADATA_BYTES = 1 << 19  # [bytes] of metadata.yaml; 500 topics with their settings have half of it
PACKED_ENDINGS = (".zstd", ".zst")
PACKED = tuple(storage + ending for storage in STORAGES for ending in PACKED_ENDINGS)
"""Endings of compressed parts: those that rosbag2 writes, and those of the program zstd."""


def holds_recording(folder: Path) -> bool:
    """Return whether a folder is a recording: it has metadata.yaml or parts."""
    return (folder / "metadata.yaml").is_file() or any(_parts(folder))


def open_rosbag2(path: Path, open_part: Callable[[Path], Reader]) -> Reader:
    """Return the reader of a folder's recording; raise LogError if none of its parts can be read.

    ``open_part`` opens a file.
    """
    parts = _parts(path)
    metadata = _metadata(path / "metadata.yaml") if (path / "metadata.yaml").is_file() else Metadata()
    named = list(dict.fromkeys(Path(part).name for part in metadata.parts))
    if named:
        files, findings = _found(path, [path / name for name in named], parts)
        if len(named) < len(metadata.parts):
            findings.append(Finding("PART-TWICE", "metadata.yaml names a part more than once; it is read once"))
        if unnamed := [part.name for part in parts if part not in files]:
            text = f"{listed(unnamed, 5)}: not read, because metadata.yaml does not name it; --with FILE adds it"
            findings.append(Finding("NOT-READ", text, lost_data=True))
    else:
        files, findings = _numbered(path, parts), _gaps(parts)
    opened_parts, unread = readable_parts(files, open_part)
    complete = len(opened_parts) == len(named)  # missing parts are reported
    stated = metadata.messages if complete else None
    return JoinedLog(path, opened_parts, (*findings, *unread), stated, kind="rosbag2 folder")


def _parts(folder: Path) -> list[Path]:
    """List the files of a folder that can be parts, part 2 before part 10; a compressed one only without its copy."""
    files = [file for file in folder.iterdir() if file.name.endswith((*STORAGES, *PACKED)) and file.is_file()]
    files = [file for file in files if not _has_copy(file)]
    return sorted(files, key=lambda file: [int(s) if s.isdecimal() else s for s in re.split(r"(\d+)", file.name)])


def recording_files(folder: Path) -> set[Path]:
    """Return the files that belong to a recording: its parts, their copies and journals, and what describes it."""
    stems = {file.with_suffix("") if file.name.endswith(PACKED) else file for file in _parts(folder)}
    belonging = (*PACKED_ENDINGS, "", "-wal", "-shm", "-journal")
    return {folder / "metadata.yaml", *(Path(f"{stem}{ending}") for stem in stems for ending in belonging)}


def _has_copy(file: Path) -> bool:
    """Return whether a part is compressed, and its decompressed copy lies beside it."""
    return file.name.endswith(PACKED) and file.with_suffix("").is_file()


class Metadata(Struct, frozen=True, rename={"parts": "relative_file_paths", "messages": "message_count"}):
    """What metadata.yaml says of a recording."""

    parts: tuple[str, ...] = ()  # names of files; early rosbag2 wrote the folder before each
    messages: int | None = None  # number of messages


def _metadata(file: Path) -> Metadata:
    """Return what metadata.yaml says; nothing if it is damaged, or not as recorders write it."""
    with opened(file) as content:
        text = content.read(limit(METADATA_BYTES) + 1)
    if len(text) > limit(METADATA_BYTES):
        raise LogError(f"is longer than {limit(METADATA_BYTES) >> 10} kB; {RAISE}", path=file)
    try:
        return msgspec.convert(plain_yaml(text)["rosbag2_bagfile_information"], Metadata)
    except (ValueError, TypeError, KeyError):
        return Metadata()  # treated as absent: the files in the folder are read


def _found(folder: Path, named: list[Path], parts: list[Path]) -> tuple[list[Path], list[Finding]]:
    """Return which of the named files can be read, and the findings about the others."""
    present = [file for file in named if file.is_file()]
    missing = [file for file in named if not file.is_file()]
    present = [file.with_suffix("") if _has_copy(file) else file for file in present]
    if not missing:
        return present, []
    names = ", ".join(file.name for file in missing)
    others = [file for file in parts if file not in present]
    if len(others) == len(missing):
        other = ", ".join(file.name for file in others)
        text = f"metadata.yaml names {names}, which is missing; {other} is read instead"
        return sorted([*present, *others], key=parts.index), [Finding("RENAMED", text)]
    if not present:
        inside = ", ".join(sorted(child.name for child in folder.iterdir())[:5])
        raise LogError(f"metadata.yaml names {names}, which is missing (the folder holds {inside})", path=folder)
    return present, [Finding("MISSING-PART", f"{names} is missing: metadata.yaml names it", lost_data=True)]


def _stem(file: Path) -> str:
    """Return the name of a part without its endings."""
    return file.with_suffix("").stem if file.name.endswith(PACKED) else file.stem


def _numbered(folder: Path, parts: list[Path]) -> list[Path]:
    """Return the parts of a folder without metadata; raise LogError if they are several recordings."""
    recordings = {(re.sub(r"_\d+$", "", _stem(file)), file.suffix) for file in parts}
    if len(recordings) > 1:
        names = ", ".join(file.name for file in parts[:5])
        raise LogError(
            f"holds {len(recordings)} recordings ({names}); name one of them, or join them with --with", path=folder
        )
    return parts


def _gaps(parts: list[Path]) -> list[Finding]:
    found = [re.fullmatch(r"(.*)_(\d+)", _stem(file)) for file in parts]
    numbers = {int(match[2]) for match in found if match}
    missing = sorted(set(range(max(numbers, default=0) + 1)) - numbers) if len(numbers) > 1 else []
    if not missing:
        return []
    names = ", ".join(str(number) for number in missing)
    return [Finding("MISSING-PART", f"part {names} is missing: the parts are numbered from 0", lost_data=True)]
