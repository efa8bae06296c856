"""Files and folders that appear whole or not at all; a fault of writing is a sentence with its exit code."""

import errno
import os
import shutil
import tempfile
from collections.abc import Generator
from contextlib import contextmanager, suppress
from pathlib import Path

from usbldr.filters.errors import StorageError, UsageError, UsbldrError

STORAGE = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)  # fixed: faults of the disk, not of the place


def has_ending(path: Path) -> bool:
    """Return whether a name ends like that of a file: .txt, .mp4, but not .5 or .2026-05-12."""
    return path.suffix[1:2].isalpha()


def write_fault(place: Path | str, fault: OSError, advice: str = "choose another place") -> UsbldrError:
    """Return what to raise for a fault of writing: StorageError for one of the disk, else UsageError."""
    why = fault.strerror or fault
    if fault.errno in STORAGE:
        return StorageError(f"{place}: cannot be written ({why}): make room on its disk, or {advice}")
    return UsageError(f"{place}: cannot be written ({why}): {advice}")


@contextmanager
def writing(place: Path | str, advice: str = "choose another place") -> Generator[None]:
    """Raise what `write_fault` returns for an OSError of the block, which writes to the place."""
    try:
        yield
    except OSError as fault:
        raise write_fault(place, fault, advice) from fault


@contextmanager
def replacing(target: Path, advice: str) -> Generator[Path]:
    """Give a path of the same name in a hidden folder beside a file or folder, which replaces that when the block ends.

    If the block fails or is interrupted, everything is as before. Raises what `write_fault` returns for an OSError.
    """
    made_parents = [folder for folder in target.parents if not folder.exists()]
    temporary, old = None, target
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        temporary = Path(tempfile.mkdtemp(dir=target.parent, prefix=f".{target.name}.", suffix=".part"))
        new, old = temporary / target.name, temporary / f"{target.name}.old"
        yield new
        if target.exists():
            os.replace(target, old)
        os.replace(new, target)
    except OSError as fault:
        raise write_fault(target, fault, advice) from fault
    finally:
        if old.exists() and not target.exists():  # interrupted between the two renames
            os.replace(old, target)
        if temporary is not None:
            shutil.rmtree(temporary, ignore_errors=True)
        for folder in made_parents:
            with suppress(OSError):  # it holds something, or was not made
                folder.rmdir()
