"""The folder of a run: it appears under its name when it is complete, and replaces only another run."""

import json
import os
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from usbldr.filters.errors import UsageError
from usbldr.io.writing import replacing

REPORT = "report.json"  # written last, names every file of the run


@contextmanager
def run_directory(target: Path, force: bool = False) -> Generator[Path]:
    """Give a new folder to write into; it becomes ``target`` when the block ends, and is removed if the block fails.

    An existing folder is replaced only with ``force``, only if it is a run directory with no foreign file in it,
    and only when the new one is complete. Raise UsageError before anything is written.
    """
    target = target.expanduser().resolve()
    check_free(target, force)
    with replacing(target, "choose another --output") as new:
        new.mkdir()
        yield new


def check_free(target: Path, force: bool) -> None:
    """Raise UsageError for a folder that a run may not replace (see `run_directory`)."""
    if not target.exists():
        return
    if not target.is_dir():
        raise UsageError(f"{target} is a file: --output takes the name of a new folder")
    held = set(os.listdir(target))
    if not held:
        return
    if not force:
        raise UsageError(f"{target} exists already: choose another --output, or --force to replace that run")
    foreign = sorted(held - _own_files(target))
    if foreign:
        raise UsageError(
            f"{target} holds {foreign[0]}, which usbldr did not write, so --force does not replace it: "
            "choose another --output"
        )


def _own_files(target: Path) -> set[str]:
    """Return the files that the report in the folder lists; none if there is no such report."""
    try:
        report: Any = json.loads((target / REPORT).read_text(encoding="utf-8"))
        return {REPORT, *map(str, report["files"])} if report["tool"]["name"] == "usbldr" else set()
    except (OSError, ValueError, KeyError, TypeError):
        return set()


def json_text(content: object) -> str:
    """Return content as the JSON of every file that usbldr writes."""
    return json.dumps(content, indent=1, allow_nan=False, ensure_ascii=False)


def write_atomically(path: Path, content: bytes) -> None:
    """Write a file that appears under its name when it is complete."""
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        part.write_bytes(content)
        os.replace(part, path)
    finally:
        part.unlink(missing_ok=True)
