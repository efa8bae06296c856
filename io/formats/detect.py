"""The format of a log, recognised by its first bytes, never by its name."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple

from usbldr.filters.errors import LogError
from usbldr.io.decoding.definitions import SHIPPED, Definitions
from usbldr.io.reader import Reader

UNSUPPORTED_FORMATS: Mapping[bytes, str] = {
    b"#ROSBAG V1": "a ROS 1 bag of an old version; convert it to version 2.0 first (rosbag fix IN.bag OUT.bag)",
    b"\x89MCAP": "an MCAP file of an unsupported version; convert it to version 0",
    b"\x28\xb5\x2f\xfd": "compressed with zstd; unpack it first (zstd -d)",
    b"\x1f\x8b": "compressed with gzip; unpack it first (gunzip)",
    b"BZh": "compressed with bzip2; unpack it first (bunzip2)",
    b"\xfd7zXZ": "compressed with xz; unpack it first (unxz)",
    b"PK\x03\x04": "a zip archive; unpack it first (unzip)",
    b"\x7f\x7f": "a PD0 file as ADCPs write it; convert it to CSV or a bag first",
}
"""Other formats by their first bytes, with what to do about them."""


def _is_mcap(path: Path, head: bytes) -> bool:
    return head.startswith(b"\x89MCAP0\r\n")


def _is_bag(path: Path, head: bytes) -> bool:
    return head.startswith(b"#ROSBAG V2.0\n")


def _is_rosbag2(path: Path, head: bytes) -> bool:
    from usbldr.io.formats.rosbag2_log import holds_recording

    return holds_recording(path) if path.is_dir() else head.startswith(b"SQLite format 3\x00")


def _is_nmea(path: Path, head: bytes) -> bool:
    from usbldr.io.formats.nmea_log import looks_like_nmea

    return looks_like_nmea(head)


def _is_csv(path: Path, head: bytes) -> bool:
    from usbldr.io.formats.csv_text import looks_like_csv, text_files

    return any(text_files(path)) if path.is_dir() else looks_like_csv(head)


def _mcap(path: Path, known: Definitions) -> Reader:
    from usbldr.io.formats.mcap_log import McapLog

    return McapLog(path, known)


def _bag(path: Path, known: Definitions) -> Reader:
    from usbldr.io.formats.bag_log import BagLog

    return BagLog(path)


def _rosbag2(path: Path, known: Definitions) -> Reader:
    from usbldr.io.formats.rosbag2_log import open_rosbag2

    return open_rosbag2(path, known)


def _nmea(path: Path, known: Definitions) -> Reader:
    from usbldr.io.formats.nmea_log import NmeaFile

    return NmeaFile(path)


def _csv(path: Path, known: Definitions) -> Reader:
    from usbldr.io.formats.csv_log import CsvLog

    return CsvLog(path)


class Format(NamedTuple):
    """How a format is recognised and opened."""

    matches: Callable[[Path, bytes], bool]  # by path and the first bytes (empty for a folder)
    open: Callable[[Path, Definitions], Reader]  # with the definitions of messages that a log does not define


FORMATS: Mapping[str, Format] = {
    "MCAP files": Format(_is_mcap, _mcap),
    "ROS 1 bags": Format(_is_bag, _bag),
    "rosbag2 (folders and .db3 files)": Format(_is_rosbag2, _rosbag2),
    "text files of NMEA sentences": Format(_is_nmea, _nmea),
    "CSV folders": Format(_is_csv, _csv),
}
"""One line per format; its reader is imported only when it is opened."""


def open_log(path: Path, known: Definitions = SHIPPED) -> Reader:
    """Return the reader that fits; raise LogError for a missing, empty or unknown file."""
    if not path.exists():
        raise LogError("no such file or folder", path=path)
    head = b""
    try:
        if not path.is_dir():
            with path.open("rb") as file:
                head = file.read(4096)
        for matches, opened in FORMATS.values():
            if matches(path, head):
                return opened(path, known)
    except PermissionError as err:
        raise LogError(f"cannot be read ({err.strerror})", path=path) from err
    *others, last = FORMATS
    accepted = f"{', '.join(others)} and {last}"
    if path.is_dir():
        inside = ", ".join(sorted(child.name for child in path.iterdir())[:5]) or "nothing"
        raise LogError(
            f"this folder holds no recording and no CSV file with a header (it holds {inside}); "
            f"usbldr reads {accepted}",
            path=path,
        )
    if not head:
        raise LogError("the file is empty", path=path)
    foreign = next((what for magic, what in UNSUPPORTED_FORMATS.items() if head.startswith(magic)), None)
    if foreign:
        raise LogError(f"is {foreign}", path=path)
    from usbldr.io.formats.csv_text import lacks_header

    if lacks_header(head):
        raise LogError("has no header: its first line holds numbers; insert a line with the column names", path=path)
    raise LogError(f"unknown format (starts with {head[:12]!r}); usbldr reads {accepted}", path=path)
