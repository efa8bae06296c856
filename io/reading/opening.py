"""Open a log as the user names it: find its configuration, name its columns, join its files."""

import hashlib
import re
from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from datetime import date
from pathlib import Path
from typing import Literal

import msgspec

from usbldr.filters.errors import LogError, UsageError
from usbldr.io.decoding.definitions import with_folders
from usbldr.io.file_access.open_file import opened, real_path
from usbldr.io.formats.detect import open_reader
from usbldr.io.instruments.nmea_log import carried_sentences
from usbldr.io.messages.configured import configured_columns, time_units_ns
from usbldr.io.messages.roles import ROLES
from usbldr.io.reader import NamedColumns, Reader
from usbldr.io.recordings.joined import UNDATED, JoinedLog, LogPart
from usbldr.io.recordings.parts_log import with_dates, with_parts
from usbldr.io.settings.auv_nav import auv_nav_content, is_auv_nav
from usbldr.io.settings.configuration import find_configuration, parse_configuration, with_set_keys
from usbldr.io.settings.layout_files import LayoutFile, layout_files
from usbldr.io.settings.sensor_sections import Configuration, FileSection
from usbldr.io.settings.validation import read_document
from usbldr.io.stages import say, stage
from usbldr.io.tables.parquet_tables import is_parted

DAY_NS = 86_400_000_000_000  # fixed


@dataclass(frozen=True, slots=True)
class ConfigurationFile:
    """A configuration that has been read; without a file, all defaults."""

    file: Path | None = None
    settings: Configuration = Configuration()
    content: Mapping[str, object] | None = None  # as the file states it
    left_out: str = ""  # what auv_nav's files state and usbldr has no key for


@dataclass(frozen=True, slots=True)
class Request:
    """The options of the user; they override the configuration."""

    configuration: str | ConfigurationFile | None = None  # a file, one that was read, or "none": ignore usbldr.toml
    topics: Mapping[str, str] = field(default_factory=dict[str, str])  # role -> topic or "none"
    truth: str | None = None  # a file, a topic or "none"
    joined: tuple[str, ...] = ()  # further files of the same dive
    msg_path: tuple[str, ...] = ()  # folders of .msg files, for messages that a log does not define
    truth_frame: Literal["ENU", "NED", "latlon"] | None = None
    part: str | None = None  # of a log whose clock goes back: its number, or "joined"
    set_keys: tuple[str, ...] = ()  # SECTION.KEY=VALUE over the configuration


DEFAULT_REQUEST = Request()


@dataclass(frozen=True, slots=True)
class OpenedLog:
    """A log ready to be read, and its configuration."""

    reader: Reader
    paths: tuple[Path, ...]  # of the log and the files joined to it
    configuration: Configuration
    file: Path | None  # of the configuration
    layouts: tuple[LayoutFile, ...] = ()
    left_out: str = ""  # of the configuration


def configuration_of(log: Path, request: Request) -> ConfigurationFile:
    """Return the configuration of a log, read now unless the request has it; raise UsageError if it is invalid."""
    if isinstance(request.configuration, ConfigurationFile):
        return request.configuration
    file = find_configuration(log, request.configuration)
    found = ConfigurationFile()
    if file is not None:
        content, left_out = auv_nav_content(file) if is_auv_nav(file) else (read_document(file), "")
        settings = _with_own_paths(parse_configuration(content, file), file.parent)
        found = ConfigurationFile(file, settings, content, left_out)
    if request.set_keys:
        content = with_set_keys(found.content or {"schema": 1}, request.set_keys)
        settings = parse_configuration(content, f"--set {' '.join(request.set_keys)}")
        found = replace(found, settings=settings, content=content)
    return found


def _with_own_paths(stated: Configuration, folder: Path) -> Configuration:
    """Return a configuration whose paths count from its folder; those that are not there, from the log's."""

    def from_here(name: str) -> str:
        return str((folder / name).resolve()) if (folder / name).exists() else name

    truth = msgspec.structs.replace(stated.truth, file=stated.truth.file and from_here(stated.truth.file))
    files = tuple(msgspec.structs.replace(one, path=from_here(one.path)) for one in stated.file)
    return msgspec.structs.replace(stated, truth=truth, file=files)


def with_configuration(log: Path, request: Request) -> Request:
    """Return the request with the configuration read, so that it is parsed once; opening the log reports its errors."""
    with suppress(UsageError):
        return replace(request, configuration=configuration_of(log, request))
    return request


@stage("open the log")
def open_configured(path: Path, request: Request) -> OpenedLog:
    """Open a log with the files that belong to it.

    The clock offset of a file under [[file]] is subtracted from its times; the log itself may be one of them.
    Raises LogError for what cannot be read, UsageError for an invalid configuration.
    """
    try:
        if not path.exists():
            url = re.match(r"\w{2,}:/", str(path))  # Path leaves one slash of two; C:/ is a drive
            hint = "; a URL is read by compare, check and drill alone: copy the log to this machine" if url else ""
            raise LogError(f"no such file or folder{hint}", path=path)
    except OSError as err:  # a name that is too long, a folder that may not be entered
        raise LogError(f"cannot be read ({err.strerror})", path=path) from err
    if (path / "report.json").is_file() and (path / "track.tum").is_file():
        raise LogError(
            f"this is the run directory of a replay, not a log: usbldr compare {path} shows it, and --estimate "
            f"{path}/track.tum of usbldr evaluate judges its track",
            path=path,
        )
    stated = configuration_of(path, request)
    configuration = stated.settings
    folder = path.resolve().parent
    sections = {real_path(folder / f.path): f for f in configuration.file}
    paths = {real_path(path): path} | {real_path(folder / f.path): folder / f.path for f in configuration.file}
    paths |= {real_path(Path(name)): Path(name) for name in request.joined}
    own = [f for f in path.iterdir() if f.suffix != ".toml" and f.name[0] != "."] if path.is_dir() else []
    if own and {*map(real_path, own)} <= paths.keys():  # they are read one by one
        del paths[real_path(path)]
    parts = [_part(_opened(paths[real], configuration, request, paths), sections.get(real)) for real in paths]
    (first, *others) = parts
    reader = first.reader
    units_ns = time_units_ns(configured_columns(configuration, request.topics))
    if others or first.offset_ns or first.dated:
        reader = JoinedLog(path, tuple(sorted(parts, key=_first_ns)), time_units_ns=units_ns)
    reader = with_parts(with_dates(reader, units_ns), _chosen_topics(configuration, request))
    say(f"log: {path}, {reader.format}", f"configuration: {stated.file or 'none'}")
    layouts = layout_files(stated_layouts(stated))
    return OpenedLog(reader, tuple(paths.values()), configuration, stated.file, layouts, stated.left_out)


def _chosen_topics(configuration: Configuration, request: Request) -> list[str]:
    """Return the topics that the user names, for sensors, the truth and the head."""
    head, truth = configuration.usbl.head, request.truth or configuration.truth.topic
    named = [*request.topics.values(), *map(configuration.topic, ROLES), truth]
    named += [head.topic, head.heading_topic] if head else []
    return [name for name in named if name]


def stated_layouts(stated: ConfigurationFile) -> tuple[Path, ...]:
    """Return the layout files that a configuration names, as paths from its own folder."""
    folder = stated.file.parent if stated.file else Path()
    return tuple(folder / name for name in stated.settings.layouts)


def _part(reader: Reader, stated: FileSection | None) -> LogPart:
    """Return a file with its clock; raise UsageError if a date is stated, and its times have dates."""
    offset_ns = round(stated.clock_offset_s * 1e9) if stated else 0
    if stated is None or stated.date is None:
        return LogPart(reader, offset_ns)
    if not any(finding.code in UNDATED for finding in reader.findings()):
        raise UsageError("its times have dates; leave out date under [[file]]", path=reader.path)
    midnight_ns = (stated.date - date(1970, 1, 1)).days * DAY_NS
    return LogPart(reader, offset_ns - midnight_ns, dated=True)


def _first_ns(part: LogPart) -> int:
    """Return the first time of a file by the clock of the dive: files have no order of their own."""
    return min((t.first_ns for t in part.reader.topics() if t.first_ns is not None), default=0) - part.offset_ns


def _opened(path: Path, configuration: Configuration, request: Request, joined: Collection[Path]) -> Reader:
    """Open one file; name the columns of its tables as the configuration does, find the sentences in topics of text."""
    reader = open_reader(path, with_folders(request.msg_path), joined)
    stated = configured_columns(configuration, request.topics)
    reader = reader.with_columns(stated) if stated and isinstance(reader, NamedColumns) else reader
    sentences = carried_sentences(reader)
    if sentences is None:
        return reader
    return JoinedLog(reader.path, (LogPart(reader), LogPart(sentences)), kind=reader.format)


def digest_paths(paths: Sequence[Path]) -> str:
    """Return the digest of a file or folder; of several, the digest of their digests."""
    digests = [_sha256(path) for path in paths]
    return digests[0] if len(digests) == 1 else hashlib.sha256("\n".join(digests).encode()).hexdigest()


def _sha256(path: Path) -> str:
    """Return the digest of a file; of a folder, the digest of its files' digests by name, without its configuration."""
    if path.is_dir():
        files = [f for f in sorted(path.iterdir()) if (f.is_file() and f.suffix != ".toml") or is_parted(f)]
        return hashlib.sha256("\n".join(_sha256(file) for file in files).encode()).hexdigest()
    with opened(path) as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
