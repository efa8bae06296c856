"""rosbag2 recordings: a folder of .db3 or .mcap parts with or without its metadata.yaml, or a .db3 file alone."""

import re
from pathlib import Path
from typing import Any, cast

from usbldr.filters.errors import LogError
from usbldr.io.decoding.definitions import SHIPPED, Definitions
from usbldr.io.findings import Finding
from usbldr.io.formats.joined import JoinedLog, LogPart
from usbldr.io.reader import Reader

STORAGES = (".db3", ".mcap")
PACKED = (".db3.zstd", ".mcap.zstd")


def holds_recording(folder: Path) -> bool:
    """Return whether a folder is a recording: it has metadata.yaml or parts."""
    if (folder / "metadata.yaml").is_file():
        return True
    return any(_parts(folder)) or any(file.name.endswith(PACKED) for file in folder.iterdir())


def open_rosbag2(path: Path, known: Definitions = SHIPPED) -> Reader:
    """Return the reader of a recording; raise LogError if a folder holds none that can be read."""
    if not path.is_dir():
        return _reader(path, known)
    parts = _parts(path)
    named = _named(path / "metadata.yaml") if (path / "metadata.yaml").is_file() else []
    findings: list[Finding] = []
    if named:
        files, findings = _found(path, [path / name for name in named], parts)
    else:
        files, findings = _numbered(path, parts), _gaps(parts)
    return JoinedLog(path, "rosbag2 folder", tuple(LogPart(_reader(file, known)) for file in files), tuple(findings))


def _reader(file: Path, known: Definitions) -> Reader:
    with file.open("rb") as opened:
        head = opened.read(16)
    if head.startswith(b"\x89MCAP0\r\n"):
        from usbldr.io.formats.mcap_log import McapLog

        return McapLog(file, known)
    if head.startswith(b"SQLite format 3\x00"):
        from usbldr.io.formats.db3_log import Db3Log

        return Db3Log(file, known)
    raise LogError("is neither sqlite3 nor MCAP" if head else "the file is empty", path=file)


def _parts(folder: Path) -> list[Path]:
    """List the files of a folder that can be parts, part 2 before part 10."""
    files = [file for file in folder.iterdir() if file.suffix in STORAGES and file.is_file()]
    return sorted(files, key=lambda file: [int(s) if s.isdecimal() else s for s in re.split(r"(\d+)", file.name)])


def _named(metadata: Path) -> list[str]:
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError

    try:
        content: Any = cast("Any", YAML(typ="safe")).load(metadata.read_text(encoding="utf-8"))
        names: list[object] = list(content["rosbag2_bagfile_information"]["relative_file_paths"] or [])
    except (YAMLError, KeyError, TypeError, UnicodeDecodeError):
        return []  # treated as absent: the files in the folder are read
    return [Path(str(name)).name for name in names]  # early rosbag2 wrote the folder before each


def _found(folder: Path, named: list[Path], parts: list[Path]) -> tuple[list[Path], list[Finding]]:
    """Return which of the named files can be read, and the findings about the others."""
    present = [file for file in named if file.is_file()]
    missing = [file for file in named if not file.is_file()]
    packed = [file.name for file in present if file.name.endswith(PACKED)]
    if packed:
        unpacked = [file.with_suffix("") for file in present if file.name.endswith(PACKED)]
        if not all(file.is_file() for file in unpacked):
            raise LogError(f"{packed[0]} is compressed with zstd; unpack it first (zstd -d {packed[0]})", path=folder)
        present = [file.with_suffix("") if file.name.endswith(PACKED) else file for file in present]
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


def _numbered(folder: Path, parts: list[Path]) -> list[Path]:
    """Return the parts of a folder without metadata; raise LogError if they are several recordings."""
    if not parts:
        packed = next(file.name for file in sorted(folder.iterdir()) if file.name.endswith(PACKED))
        raise LogError(f"{packed} is compressed with zstd; unpack it first (zstd -d {packed})", path=folder)
    recordings = {(re.sub(r"_\d+$", "", file.stem), file.suffix) for file in parts}
    if len(recordings) > 1:
        names = ", ".join(file.name for file in parts[:5])
        raise LogError(
            f"holds {len(recordings)} recordings ({names}); name one of them, or join them with --with", path=folder
        )
    return parts


def _gaps(parts: list[Path]) -> list[Finding]:
    found = [re.fullmatch(r"(.*)_(\d+)", file.stem) for file in parts]
    numbers = {int(match[2]) for match in found if match}
    missing = sorted(set(range(max(numbers, default=0) + 1)) - numbers) if len(numbers) > 1 else []
    if not missing:
        return []
    names = ", ".join(str(number) for number in missing)
    return [Finding("MISSING-PART", f"part {names} is missing: the parts are numbered from 0", lost_data=True)]
