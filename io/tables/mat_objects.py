"""Objects in MATLAB's files, such as datetime and timetable: the format of their contents is not documented."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from usbldr.filters.errors import LogError

OPAQUE = ("s0", "s1", "s2", "arr")  # fixed by SciPy: the fields of an object of versions 5 to 7
DECODE = "MATLAB_object_decode"  # fixed by MATLAB: the attribute of an object of version 7.3


def objects_of(variables: Mapping[str, Any]) -> dict[str, str]:
    """Return name -> class of the objects among variables that SciPy read; itself it names only those of structures."""
    found: dict[str, str] = {}
    for label, value in variables.items():
        if getattr(getattr(value, "dtype", None), "names", None) == OPAQUE:
            name, _, kind, _ = value.flat[0]
            found[name.decode(errors="replace") or label] = kind.decode(errors="replace")
    return found


def unread(objects: Mapping[str, str]) -> tuple[str, ...]:
    """Return what is said of objects (name -> class), beside the names of columns."""
    return tuple(
        f"{name} (a {kind}: store posixtime)" if kind == "datetime" else f"{name} (a {kind}, not read)"
        for name, kind in objects.items()
    )


def refuse_objects(file: Path, others: Sequence[str]) -> None:
    """Raise LogError if a file without tables holds objects."""
    if others:
        raise LogError(f"holds no vectors of numbers, but {', '.join(others)}", path=file)
