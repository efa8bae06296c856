"""What becomes of a fault while files are written: a sentence with the exit code of its cause."""

import errno
from collections.abc import Generator
from contextlib import contextmanager
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
