"""The optional libraries that read some formats, and what they raise on damaged files."""

from collections.abc import Generator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import Any

from usbldr.filters.errors import LogError, UsageError, UsbldrError


def library(name: str, what: str, extra: str, file: Path) -> Any:
    """Return a library that is optional; raise UsageError that names the extra."""
    try:
        return import_module(name)
    except ImportError as err:
        needed = name.partition(".")[0]
        raise UsageError(f"{what} need {needed}: pip install 'usbldr[{extra}]'", path=file) from err


@contextmanager
def reading(file: Path, what: str) -> Generator[None]:
    """Turn whatever a library raises on a damaged file into LogError."""
    try:
        yield
    except UsbldrError:
        raise
    except Exception as err:  # each library has errors of its own for damaged bytes, few documented
        why = next(iter(str(err).splitlines()), "") or type(err).__name__
        raise LogError(f"cannot be read as {what}: damaged, cut or of an unknown kind ({why})", path=file) from err
