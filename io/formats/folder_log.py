"""A folder as a log: a rosbag2 recording, tables (CSV, Parquet), or files of instruments; what is not read is named."""

import re
from collections.abc import Callable, Collection, Iterator, Sequence
from itertools import islice
from pathlib import Path

from usbldr.filters.errors import LogError, UsageError, listed
from usbldr.io.file_access.open_file import real_path
from usbldr.io.findings import Finding
from usbldr.io.formats.compressed_log import ENDINGS, compressed_log, plain_name
from usbldr.io.limits import limit
from usbldr.io.messages.roles import choose_roles
from usbldr.io.messages.topic_names import suggested_sensors
from usbldr.io.reader import Reader
from usbldr.io.recordings.joined import JoinedLog, LogPart
from usbldr.io.recordings.rosbag2_log import holds_recording, open_rosbag2, recording_files
from usbldr.io.tables.array_tables import array_log
from usbldr.io.tables.csv_log import csv_log
from usbldr.io.tables.csv_text import compressed_texts, text_files
from usbldr.io.tables.parquet_tables import ENDING, NAME, is_parted, parquet_files, parquet_table

FILES = 10_000  # [files] of a folder that are examined; a dive has some hundred
SHOWN = 5  # [files] that a sentence names
LEVELS = 3  # of folders within a folder in which files like those of a log are looked for
UNREAD = (".xml", ".kml", ".kmz", ".npz", ".pkl")
"""Endings of settings and results, or of records, which no reader reads."""
OF_EITHER = (*UNREAD, ".geojson")
"""Endings of files that are named if they are named like a sensor, and a loss unless a file of the same stem is read:
they may be another form of that."""
NO_RECORDS = frozenset(
    ending
    for endings in (
        ".png .jpg .jpeg .gif .bmp .tif .tiff .webp .heic .svg .eps .ico .psd .xcf .cr2 .nef .arw .dng",  # pictures
        ".mp4 .mov .avi .mkv .wmv .webm .m4v .mts .mp3 .wav .flac .ogg .m4a .srt",  # films and sounds
        ".md .rst .pdf .doc .docx .odt .rtf .tex .bib .ppt .pptx .odp .html .htm .css .url .eml .msg",  # papers
        ".toml .yaml .yml .ini .cfg .conf .xsd .urdf .xacro .launch .rviz .lock .env",  # settings
        ".py .pyc .ipynb .m .mlx .r .jl .c .h .cc .cpp .hpp .java .js .ts .go .rs .sh .bat .ps1 .cmd .idl .srv",  # code
        ".exe .dll .so .msi .deb .whl .lnk .swp .bak .old .orig .db3-wal .db3-shm .db3-journal",  # of computers
        " ".join(UNREAD),
    )
    for ending in endings.split()
)
"""Endings of files that cannot hold records, although they may be named like a sensor, as a picture of it."""
BACKUP = re.compile(r"#?(.+?)(~|#|\.bak|\.old|\.orig|\.tmp)", re.IGNORECASE)
"""The names that editors give to earlier or unsaved states of a file, with its name."""
OF_COMPUTERS = ("._", "~$", "Thumbs.db", "_SUCCESS", "_metadata", "_common_metadata")
"""With which the names of files begin that no user knows of."""
RECORDINGS = ("MCAP", "ROS 1 bag", "rosbag2 (sqlite3)")
"""Formats of which a file is a log by itself: several in a folder are several dives, unless the user joins them."""


def folder_log(path: Path, open_file: Callable[[Path], Reader], apart: Collection[Path] = ()) -> Reader | None:
    """Return the log of a folder, None if it holds none; ``open_file`` opens one of its files.

    ``apart``: real paths of files that are read in their own right, although they lie in the folder.
    """
    files = [file for file in sorted(path.iterdir()) if not (_is_hidden(file) or _is_other_folder(file))]
    files = [file for file in files if real_path(file) not in apart] if apart else files
    if len(files) > limit(FILES):
        raise LogError(f"holds more than {limit(FILES)} files; name those of the dive", path=path)
    copies = _copies(files)
    files = [file for file in files if file not in copies]
    readers, used = _together(path, open_file, {*files})
    others = [file for file in files if file not in used]
    if readers:
        added, apart = _adding(path, readers, others, open_file)
        others = [file for file in others if file not in [reader.path for reader in added]]
        return _one_log(path, [*readers, *added], [*_passed_over(copies), *_not_read(others, open_file, apart)])
    readers, unread = _alone(path, others, open_file)
    if readers:
        return _one_log(path, readers, [*_passed_over(copies), *unread])
    folders = [file for file in others if file.is_dir() and not _is_empty(file)]
    if folders and all(suggested_sensors(folder.name) for folder in folders):
        texts = [file for folder in folders for file in text_files(folder)]
        others = [file for one in others for file in (_inner(one) if one in folders else [one]) if file not in texts]
        if texts:
            return _one_log(path, [csv_log(path, files=texts)], _not_read(others, open_file))
    if folders:
        names = ", ".join(folder.name for folder in folders[:SHOWN])
        raise LogError(f"holds folders with files like those of a log ({names}); name one of them", path=path)
    if lost := next((finding for finding in unread if finding.lost_data), None):
        raise LogError(f"holds nothing that can be read: {lost.text}", path=path)
    return None


def _one_log(path: Path, readers: Sequence[Reader], findings: Sequence[Finding]) -> Reader:
    if len(readers) == 1 and not findings:
        return readers[0]
    return JoinedLog(path, tuple(LogPart(reader) for reader in readers), tuple(findings))


def _copies(files: Sequence[Path]) -> list[Path]:
    """Return those of the files that are backups of others, or links to them."""
    names = {file.name for file in files}
    originals = {real_path(file) for file in files if not file.is_symlink()}
    backups = {file for file in files if (found := BACKUP.fullmatch(file.name)) and found[1] in names}
    return [file for file in files if file in backups or (file.is_symlink() and real_path(file) in originals)]


def _passed_over(copies: Sequence[Path]) -> list[Finding]:
    """Name the backups and links that are not read."""
    names = listed([file.name for file in copies], SHOWN)
    text = f"not read of this folder, as backups of its files or links to them: {names}"
    return [Finding("NOT-READ", text)] if copies else []


def _is_hidden(file: Path) -> bool:
    """Return whether a file is none of the user's; one with a dot before the name of a sensor is a hidden log."""
    if not file.name.startswith("."):
        return file.name.startswith(OF_COMPUTERS)
    return file.is_dir() or file.name.startswith(OF_COMPUTERS) or not _named_like_a_sensor(file)


def _is_other_folder(file: Path) -> bool:
    """Return whether this is a folder without files of logs: pictures, runs; not an empty one named like a sensor."""
    if not file.is_dir() or any(inner.suffix for inner in _inner(file)):
        return False
    return not suggested_sensors(file.name) or not (any(_inner(file)) or _is_empty(file))


def _is_empty(folder: Path) -> bool:
    """Return whether a folder and those within it have no files."""
    return not any(file.is_file() for file in folder.rglob("*"))


def _is_filled(file: Path) -> bool:
    return file.is_file() and file.stat().st_size > 0


def _inner(folder: Path) -> Iterator[Path]:
    """Yield the files of a folder that may hold records, also those of folders within it; a run holds none."""
    yield from islice((file for file in _files_within(folder, LEVELS) if _may_hold_records(file)), FILES)


def _files_within(folder: Path, levels: int) -> Iterator[Path]:
    if (folder / "report.json").is_file():
        return
    for file in sorted(folder.iterdir()):
        if not file.is_dir():
            yield file
        elif levels > 1 and not file.name.startswith("."):
            yield from _files_within(file, levels - 1)


def _together(
    path: Path, open_file: Callable[[Path], Reader], among: Collection[Path]
) -> tuple[list[Reader], set[Path]]:
    """Return the readers of those files that are one log by their format, and these files."""
    if holds_recording(path):
        return [open_rosbag2(path, open_file)], recording_files(path)
    if is_parted(path):
        parts = [*parquet_files(path)]
        return [array_log(path, NAME, [parquet_table(file, path.stem)]) for file in parts], {*parts}
    texts = [file for file in text_files(path) if file in among]
    packed = {file: kind for file, kind in compressed_texts(path).items() if file in among}
    tables = [file for file in parquet_files(path) if file in among]
    parted = [folder for folder in sorted(path.iterdir()) if folder in among and is_parted(folder)]
    readers = [open_file(folder) for folder in parted]
    if packed:
        readers.append(compressed_log(path, packed, lambda copies: csv_log(path, files=[*texts, *copies])))
    elif texts:
        readers.append(csv_log(path, files=texts))
    if tables:
        readers.append(array_log(path, NAME, [parquet_table(file) for file in tables]))
    copied = {file.with_name(file.name + ending) for file in (*texts, *tables) for ending in ENDINGS}
    damaged = [file for file in sorted(among) if file.suffix == ENDING and file not in tables and _is_filled(file)]
    more, unread = _readable(damaged, open_file)
    return [*readers, *more], {*texts, *packed, *tables, *parted, *copied, *(set(damaged) - unread)}


def _readable(files: Sequence[Path], open_file: Callable[[Path], Reader]) -> tuple[list[Reader], set[Path]]:
    """Return the readers of the files that can be read, and the others."""
    readers: list[Reader] = []
    unread: set[Path] = set()
    for file in files:
        try:
            readers.append(open_file(file))
        except LogError:
            unread.add(file)
    return readers, unread


def _adding(
    path: Path, readers: Sequence[Reader], files: Sequence[Path], open_file: Callable[[Path], Reader]
) -> tuple[list[Reader], set[Path]]:
    """Return the readers of those files that hold or are named for a sensor which the other readers lack.

    A recording or a table is a log by itself, and so is a file with one of their topics: recordings with such a sensor
    are returned apart.
    """

    def sensors(reader: Reader) -> set[str]:
        topics = reader.topics()
        roles = choose_roles(path, topics, {}, {})
        names = [topic.name for topic in topics] + [reader.path.stem] * (len(topics) > 0 and reader.path != path)
        return {*roles.chosen, *roles.unresolved}.union(*map(suggested_sensors, names))

    present = set[str]().union(*map(sensors, readers))
    found, _ = _readable([file for file in files if _is_filled(file) and _may_hold_records(file)], open_file)
    taken = {topic.name for reader in readers for topic in reader.topics()}
    found = [one for one in found if taken.isdisjoint(topic.name for topic in one.topics())]
    found = [one for one in found if sensors(one) - present]
    apart = {one.path for one in found if one.format.startswith(RECORDINGS) and sensors(one) - present - {"depth"}}
    return [one for one in found if not one.format.startswith((*RECORDINGS, "CSV", NAME))], apart


def _alone(
    path: Path, files: Sequence[Path], open_file: Callable[[Path], Reader]
) -> tuple[list[Reader], list[Finding]]:
    """Return the files of a folder that are read one by one, and findings on the others."""
    readers, _ = _readable([file for file in files if _is_filled(file) and _may_hold_records(file)], open_file)
    recordings = [reader.path.name for reader in readers if reader.format.startswith(RECORDINGS)]
    if len(recordings) > 1:
        names = ", ".join(recordings[:SHOWN])
        text = f"holds {len(recordings)} recordings ({names}); name one of them, or join them with --with"
        raise LogError(text, path=path)
    read = {reader.path for reader in readers}
    left = [file for file in files if file not in read]
    return readers, _not_read(left, open_file)


def _may_hold_records(file: Path) -> bool:
    return Path(plain_name(file)).suffix.lower() not in NO_RECORDS


def _not_read(
    files: Sequence[Path], open_file: Callable[[Path], Reader], apart: Collection[Path] = ()
) -> list[Finding]:
    """Name the files that are not read; of the first others, foreign formats.

    A loss if one is named like a sensor, or ``apart``: a recording of a sensor that the log lacks.
    """
    either = [file for file in files if _may_hold_records(file) or file.suffix.lower() in OF_EITHER]
    sensors = [file for file in either if _named_like_a_sensor(file) or file in apart]
    findings: list[Finding] = []
    for file in sensors:
        lost = file.suffix.lower() not in OF_EITHER or file.stem not in {
            one.stem for one in file.parent.iterdir() if one not in files
        }
        findings.append(Finding("NOT-READ", f"{file.name} is not read: {_why(file, open_file)}", lost_data=lost))
    others = [file for file in files if file not in sensors and _may_hold_records(file)]
    foreign = {file: why for file in others[:SHOWN] if (why := _why(file, open_file)).startswith("is ")}
    findings += [Finding("NOT-READ", f"{file.name} is not read: it {why}") for file, why in foreign.items()]
    others = [file.name for file in others if file not in foreign]
    if others:
        text = f"not read of this folder: {listed(others, SHOWN)}; --with FILE adds one"
        findings.append(Finding("NOT-READ", text))
    return findings


def _named_like_a_sensor(file: Path) -> bool:
    """Return whether a file, a folder or a file within that folder is named like a sensor."""
    stem = file.name.lstrip(".").partition(".")[0]
    if suggested_sensors(stem) or stem.lower().split("__")[-1] == "truth":
        return True
    return file.is_dir() and any(map(_named_like_a_sensor, _inner(file)))


def _why(file: Path, open_file: Callable[[Path], Reader]) -> str:
    if file.is_symlink() and not file.exists():
        return "it is a link to a file that is not there"
    if file.is_dir() and not _is_empty(file):
        inner = sorted(_inner(file), key=_named_like_a_sensor)[-1]
        place = inner.parent.relative_to(file.parent)
        return f"it is a folder of files like those of a log; --with {place} adds them"
    if file.is_dir() or (file.is_file() and not _is_filled(file)):
        return f"the {'folder' if file.is_dir() else 'file'} is empty"
    try:
        return f"it is a log of its own ({open_file(file).format}); --with {file.name} adds it"
    except (LogError, UsageError) as fault:
        return fault.text
