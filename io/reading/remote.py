"""Logs behind a URL (s3://bucket/dive.mcap), copied to this machine while they are read.

The configuration beside the log is copied with it, and so are the files that the configuration names.
"""

import tempfile
from collections.abc import Generator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import Any

from usbldr.filters.errors import LogError, UsageError, UsbldrError
from usbldr.io.reading.opening import Request, configuration_of
from usbldr.io.settings.configuration import configuration_places


def is_url(log: str | Path) -> bool:
    """Return whether a log is named by a URL."""
    return "://" in str(log)


@contextmanager
def local_log(log: str, request: Request) -> Generator[Path]:
    """Give the path of a log: its own, or of a URL that of a copy, which lasts as long as the context.

    Raises LogError if it cannot be copied, UsageError if no library is installed that reads such URLs.
    """
    if not is_url(log):
        yield Path(log)
        return
    parent, _, name = log.rstrip("/").rpartition("/")
    if name in ("", ".", ".."):
        raise LogError("is not the URL of a file or folder", path=log)
    with tempfile.TemporaryDirectory(prefix="usbldr-log-") as folder:
        copy = Path(folder) / name
        try:
            _copy(log, copy, request)
            yield copy
        except UsbldrError as fault:  # name what the user named
            raise type(fault)(str(fault).replace(str(copy.parent), parent)) from fault


def _copy(log: str, copy: Path, request: Request) -> None:
    """Copy a log, its configuration, and the files beside it that the configuration names."""
    try:
        fsspec: Any = import_module("fsspec.core")
    except ImportError as err:
        raise UsageError(f"{log}: URLs need fsspec: pip install 'usbldr[cluster]'") from err
    try:
        storage, there = fsspec.url_to_fs(log.rstrip("/"))
        if not storage.exists(there):
            raise LogError("no such file or folder", path=log)
        storage.get(there, str(copy), recursive=storage.isdir(there))
        for place in configuration_places(copy, copy.is_dir()):
            _copy_beside(storage, there, copy, place)
        stated = configuration_of(copy, request).settings
        for named in [*(file.path for file in stated.file), *([stated.truth.file] if stated.truth.file else [])]:
            _copy_beside(storage, there, copy, copy.parent / named)
    except ImportError as err:
        raise UsageError(f"{log}: {err} (s3: pip install 'usbldr[s3]')") from err
    except UsbldrError:
        raise
    except Exception as err:  # each kind of storage has errors of its own
        raise LogError(f"cannot be copied ({err})", path=log) from err


def _copy_beside(storage: Any, there: str, copy: Path, place: Path) -> None:
    """Copy a file from beside the log, if there is one."""
    inside = place.resolve().is_relative_to(copy.parent.resolve()) and not place.exists()
    if inside:
        source = f"{there.rpartition('/')[0]}/{place.resolve().relative_to(copy.parent.resolve())}"
        if storage.isfile(source):
            place.parent.mkdir(parents=True, exist_ok=True)
            storage.get_file(source, str(place))
