"""Layout files: which field of a type of message, or of a sentence, holds what a sensor measured, as TOML.

They come with usbldr, from the user's folder, or by the key ``layouts`` of usbldr.toml; never from beside a log, where
anybody may put a file.
"""

import hashlib
import os
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Literal, TypeAlias

from usbldr.filters.errors import UsageError
from usbldr.io.axes import axis_signs
from usbldr.io.settings.noise_sections import Section
from usbldr.io.settings.validation import checked, read_document

Origin: TypeAlias = Literal["usbldr", "user folder", "configuration"]


class LayoutEntry(Section, frozen=True, kw_only=True):
    """One type of message, or one sentence, as a sensor; the other keys are those of the sensor's section."""

    sensor: Literal["dvl", "compass", "usbl", "gps", "depth"]
    columns: dict[str, str]
    type: str | None = None
    sentence: str | None = None
    axes: str | None = None
    unit: str | None = None
    convention: Literal["ENU", "NED", "compass"] | None = None
    kind: Literal["position", "latlon", "range_bearing"] | None = None
    frame: Literal["ENU", "NED", "body", "latlon"] | None = None
    relative_to: Literal["map", "head"] | None = None
    positive: Literal["down", "up"] | None = None

    def __post_init__(self) -> None:
        if (self.type is None) == (self.sentence is None):
            raise ValueError("state either type or sentence")
        if self.axes is not None:
            axis_signs(self.axes)

    @property
    def conventions(self) -> Mapping[str, str]:
        """The keys of the sensor's section that the entry states, but for its columns."""
        names = ("axes", "unit", "convention", "kind", "frame", "relative_to", "positive")
        return {name: value for name in names if (value := getattr(self, name)) is not None}


class LayoutDocument(Section, frozen=True, kw_only=True):
    """A whole layout file."""

    schema: Literal[1] = 1
    about: str = ""
    layout: tuple[LayoutEntry, ...] = ()


@dataclass(frozen=True, slots=True)
class LayoutFile:
    """A layout file that was read."""

    path: Path
    origin: Origin
    sha256: str
    entries: tuple[LayoutEntry, ...]


def layout_files(stated: Sequence[Path]) -> tuple[LayoutFile, ...]:
    """Return the files of the configuration, then those of the user's folder, then those of usbldr.

    Raises UsageError for one that cannot be read or holds anything else.
    """
    base = os.environ.get("APPDATA") if sys.platform == "win32" else os.environ.get("XDG_CONFIG_HOME")
    own = (Path(base) if base else Path.home() / ".config") / "usbldr" / "layouts"
    places: Sequence[tuple[Origin, Sequence[Path]]] = (
        ("configuration", stated),
        ("user folder", sorted(own.glob("*.toml")) if own.is_dir() else ()),
    )
    return (*(_read(path, origin) for origin, paths in places for path in paths), *_shipped())


@cache
def _shipped() -> tuple[LayoutFile, ...]:
    folder = Path(str(files("usbldr.io.settings"))) / "layouts"
    return tuple(_read(path, "usbldr") for path in sorted(folder.glob("*.toml")))


def _read(path: Path, origin: Origin) -> LayoutFile:
    if not path.is_file():
        raise UsageError(f"{path}: no such layout file")
    document = checked(read_document(path), LayoutDocument, path)
    return LayoutFile(path, origin, hashlib.sha256(path.read_bytes()).hexdigest(), document.layout)
