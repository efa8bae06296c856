"""The files and folders that a log is read from, so that none of them is overwritten."""

import os
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from usbldr.filters.errors import UsageError
from usbldr.io.file_access.open_file import real_path
from usbldr.io.reading.opening import ConfigurationFile, Request, configuration_of, stated_layouts
from usbldr.io.reading.position_files import find_truth_file


class InputFile(NamedTuple):
    """A file or folder that a log is read from."""

    role: str  # "log", "with", "configuration", "truth", "layout"
    path: Path


def input_files(log: Path, request: Request) -> tuple[InputFile, ...]:
    """Return the log, its configuration, the files joined to it and its truth file.

    A configuration that cannot be read names no files: reading the log reports the error.
    """
    configuration = ConfigurationFile()
    with suppress(UsageError):
        configuration = configuration_of(log, replace(request, set_keys=()))
        configuration = configuration_of(log, request)  # which a sweep has several of
    joined = [Path(name) for name in request.joined]
    joined += [log.resolve().parent / stated.path for stated in configuration.settings.file]
    truth = configuration.settings.truth.file if request.truth is None else request.truth
    truth_file = find_truth_file(truth, log, from_option=request.truth is not None) if truth else None
    found = {"log": [log], "with": joined, "configuration": [configuration.file], "truth": [truth_file]}
    found |= {"layout": [*stated_layouts(configuration)]}
    return tuple(InputFile(role, path) for role, paths in found.items() for path in paths if path is not None)


def output_conflict(place: Path, read: Iterable[Path], inside: bool) -> str | None:
    """Return why a path must not be written: it is an input, or contains one; None if it may be.

    With ``inside``, it must not be inside an input folder, either.
    """
    target = real_path(place)
    for k, path in enumerate(read):
        own = real_path(path)
        if target == own or (os.path.exists(target) and os.path.exists(own) and os.path.samefile(target, own)):
            return "is the log" if k == 0 else "is also an input"
        if target in own.parents:
            return f"contains the input {path}"
        if inside and own in target.parents:
            return f"is inside the input {path}"
    return None


def refuse_inputs(place: Path, read: Iterable[Path]) -> None:
    """Raise UsageError for a path that is, contains, or is inside an input."""
    if what := output_conflict(place, read, inside=True):
        raise UsageError(f"{place}: {what}; choose another name")
