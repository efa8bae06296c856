"""The format of a log, recognised by its first bytes, never by its name."""

import struct
from collections.abc import Callable, Collection, Mapping
from importlib import import_module
from pathlib import Path

from usbldr.filters import plugins
from usbldr.filters.errors import LogError, UsbldrError
from usbldr.io.decoding.definitions import SHIPPED, Definitions
from usbldr.io.file_access.container_ends import BAG, HDF5, MCAP, PARQUET, SQLITE, container_at
from usbldr.io.file_access.decompression import compression_of
from usbldr.io.file_access.open_file import BEGIN_BYTES, begin_of, is_tar, opened, parts_within
from usbldr.io.reader import Reader
from usbldr.io.tables.foreign_texts import foreign_file

MATLAB_4, MATLAB_4_NAME = struct.Struct("<5I"), 64  # fixed: the numbers before the name of a matrix; its bytes at most


def _is_other_text(head: bytes) -> bool:
    """Return whether a text is of one of these formats, although its lines look like those of another one."""
    return head.startswith(b"FMT, 128") or (head.startswith(b"%%") and b"\n%%%%(1)" in head)


def _is_matlab_4(path: Path) -> bool:
    """Return whether a file begins with a matrix of MATLAB's version 4: kind, sizes, whether complex, and its name."""
    with opened(path) as file:
        head, name = file.read(MATLAB_4.size), file.read(MATLAB_4_NAME)
    if len(head) < MATLAB_4.size:
        return False
    kind, *_, imaginary, length = MATLAB_4.unpack(head)
    label, end, _ = name[:length].partition(b"\0")
    return (
        kind < 100
        and imaginary < 2
        and 0 < length <= len(name)
        and bool(end)
        and label.decode("latin-1").isidentifier()
    )


def _csv(path: Path, head: bytes, known: Definitions) -> Reader | None:
    from usbldr.io.formats.stacked_tables import stacked_log
    from usbldr.io.tables.csv_begin import looks_like_csv
    from usbldr.io.tables.csv_log import csv_log

    table = looks_like_csv(head) and not _is_other_text(head)
    return (stacked_log(path) or csv_log(path)) if table else None


def _by_look(
    module: str, test: str | bytes, opens: str, with_definitions: bool = False
) -> Callable[[Path, bytes, Definitions], Reader | None]:
    """Return how a format is recognised: by its first bytes, or by a function of these in the module that reads it.

    That is imported only then; ``with_definitions``: it also takes those of messages that a log does not define.
    """

    def reader(path: Path, head: bytes, known: Definitions) -> Reader | None:
        if isinstance(test, bytes) and not head.startswith(test):
            return None
        part = import_module(f"usbldr.io.{module}")
        if isinstance(test, str) and (_is_other_text(head) or not getattr(part, test)(head)):
            return None
        return getattr(part, opens)(path, *([known] if with_definitions else []))

    return reader


def _json(path: Path, head: bytes, known: Definitions) -> Reader | None:
    from usbldr.io.tables.json_columns import json_columns_log, looks_like_json_columns
    from usbldr.io.tables.json_lines_log import json_lines_log

    columns = json_columns_log(path) if looks_like_json_columns(head) else None
    return columns or (None if _is_other_text(head) else json_lines_log(path, head))


def _of_plugin(part: plugins.Plugin) -> Callable[[Path, bytes, Definitions], Reader | None]:
    """Return how a format of another package is recognised: by its function of the path and the first bytes."""

    def reader(path: Path, head: bytes, known: Definitions) -> Reader | None:
        try:
            return part.value(path, head)
        except UsbldrError:
            raise
        except Exception as err:  # foreign code may raise anything
            text = f"cannot be read: plugin {part.name} of {part.source} failed ({type(err).__name__}: {err})"
            raise LogError(text, path=path) from err

    return reader


FORMATS: Mapping[str, Callable[[Path, bytes, Definitions], Reader | None]] = {
    "MCAP files": _by_look("recordings.mcap_log", MCAP, "McapLog", True),
    "ROS 1 bags": _by_look("recordings.bag_log", BAG, "BagLog"),
    "rosbag2 (folders and .db3 files)": _by_look("recordings.db3_log", SQLITE, "Db3Log", True),
    "MAVLink telemetry logs (.tlog)": _by_look("instruments.tlog_log", "looks_like_tlog", "telemetry_log"),
    "DataFlash logs (.BIN)": _by_look("instruments.dataflash_log", "looks_like_dataflash", "dataflash_log"),
    "PD0 files": _by_look("instruments.pd0_log", "looks_like_pd0", "pd0_log"),
    "PD4 and PD5 files": _by_look("instruments.pd45_log", "name_of_pd45", "pd45_log"),
    "PD6 text": _by_look("instruments.pd6_log", "looks_like_pd6", "pd6_log"),
    "MOOS logs (.alog)": _by_look("instruments.alog_log", "looks_like_alog", "alog_log"),
    "LSF logs of IMC messages": _by_look("instruments.lsf_log", "looks_like_lsf", "lsf_log"),
    "Parquet files and folders of them": _by_look("tables.parquet_tables", PARQUET, "parquet_log"),
    "Arrow files (Feather)": _by_look("tables.parquet_tables", b"ARROW1", "arrow_log"),
    "HDF5 files (also netCDF-4)": _by_look("tables.hdf5_tables", HDF5, "hdf5_log"),
    "MATLAB files (.mat)": _by_look("tables.mat_tables", "looks_like_mat", "mat_log"),
    "JSON lines and columns": _json,
    "spreadsheets (.xlsx)": _by_look("formats.stacked_tables", b"PK\x03\x04", "workbook_log"),
    "text files of NMEA sentences": _by_look("instruments.nmea_log", "form_of", "nmea_file"),
    "CSV folders": _csv,
    **{part.name: _of_plugin(part) for part in plugins.offered(plugins.FORMATS)},
}
"""One line per format: from the path, the first bytes and the definitions of messages that a log
does not define to its reader; to None if it is of another format. Those of other packages come last."""


OF_LINES = ("PD6 text", "JSON lines and columns", "text files of NMEA sentences")
"""Formats whose records are lines, between which others may lie."""


def _within(path: Path, head: bytes, known: Definitions) -> Reader | None:
    """Return the reader of lines that follow something else, as the messages with which a computer starts."""
    if is_tar(head) or foreign_file(head):
        return None
    found = (FORMATS[name](path, part, known) for part in parts_within(path) for name in OF_LINES)
    return next((reader for reader in found if reader is not None), None)


def _reader(path: Path, head: bytes, known: Definitions, apart: Collection[Path]) -> Reader | None:
    """Return the reader that fits, None if none does; one of several recordings if the file holds them."""
    if path.is_dir():
        from usbldr.io.formats.folder_log import folder_log

        return folder_log(path, lambda file: open_reader(file, known), apart)

    def matching() -> Reader | None:
        return next((reader for of in FORMATS.values() if (reader := of(path, head, known)) is not None), None)

    if not container_at(head, 0):
        reader = matching()
        if reader is not None or not head:
            return reader
    from usbldr.io.formats.concatenated import concatenated_log

    return concatenated_log(path, lambda copy: open_reader(copy, known)) or matching() or _within(path, head, known)


def open_reader(path: Path, known: Definitions = SHIPPED, apart: Collection[Path] = ()) -> Reader:
    """Return the reader that fits; raise LogError for a missing, empty or unknown file.

    ``apart``: real paths of files that a folder leaves out, because they are read in their own right.
    """
    head, place = b"", 0
    try:
        if not path.exists():
            raise LogError("no such file or folder", path=path)
        if not path.is_dir():
            head, place = begin_of(path, BEGIN_BYTES)
        if not place and (compression := compression_of(head)):
            from usbldr.io.formats.compressed_log import compressed_log

            return compressed_log(path, {path: compression}, lambda copies: open_reader(copies[0], known))
        reader = _reader(path, head, known, apart)
        if reader is not None:
            return reader
    except OSError as err:
        raise LogError(f"cannot be read ({err.strerror or err})", path=path) from err
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
        raise LogError("the file holds nothing but zeros" if path.stat().st_size else "the file is empty", path=path)
    if foreign := foreign_file(head):
        raise LogError(f"is {foreign}", path=path)
    if is_tar(head):
        raise LogError("is a tar archive; unpack it first (tar -xf)", path=path)
    if _is_matlab_4(path):
        raise LogError("is a MATLAB file of version 4; store it again in MATLAB with save(FILE, '-v7')", path=path)
    from usbldr.io.tables.csv_begin import has_blank_columns

    if has_blank_columns(head):
        why = "is a table with blanks between its columns, whose first row is not of as many numbers as there are names"
        raise LogError(f"{why}; write commas between the columns", path=path)
    raise LogError(f"unknown format (starts with {head[:12]!r}); usbldr reads {accepted}", path=path)
