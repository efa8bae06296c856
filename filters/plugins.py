"""Parts of other packages: filters, formats and message types that this repository does not hold.

An installed package offers them by entry points; --plugin names a filter of a module or a file. Nothing is looked for
in the current folder. docs/extend.md shows both.
"""

import functools
import hashlib
import importlib
import importlib.util
import os
import sys
from collections.abc import Iterable
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

from usbldr.filters.errors import UsageError

METHODS, FORMATS, LAYOUTS = "usbldr.methods", "usbldr.formats", "usbldr.layouts"  # groups of entry points
VARIABLE = "USBLDR_PLUGINS"
"""Environment variable with the values of --plugin, one a line: processes that a command starts read it, too."""


class Plugin(NamedTuple):
    """A part of another package."""

    name: str  # of the entry point, or as --plugin names it
    value: Any
    source: str  # package with its version, or file, and the digest of its code


FAULTS: list[str] = []
"""A sentence for each entry point that cannot be used."""


def installed() -> bool:
    """Return whether installed packages offer anything."""
    return any(entry_points(group=group) for group in (METHODS, FORMATS, LAYOUTS))


@functools.cache
def offered(group: str) -> tuple[Plugin, ...]:
    """Return what installed packages offer in a group of entry points, by name; FAULTS says what of it is broken."""
    found: list[Plugin] = []
    for entry in sorted(entry_points(group=group), key=lambda entry: (entry.name, entry.value)):
        try:
            found.append(Plugin(entry.name, entry.load(), _source(sys.modules[entry.module], _package(entry))))
        except (Exception, SystemExit) as err:  # foreign code may raise anything
            refuse(Plugin(entry.name, None, _package(entry)), f"{entry.value}: {type(err).__name__}: {err}")
    return tuple(found)


def refuse(part: Plugin, why: str) -> None:
    """Leave out a part of an installed package."""
    FAULTS.append(f"plugin {part.name} of {part.source.split(' (')[0]} is not used: {why}")


def asked_for() -> Iterable[str]:
    """Return the values of --plugin."""
    return os.environ.get(VARIABLE, "").splitlines()


def named(text: str) -> Plugin:
    """Return the part that --plugin names, MODULE:NAME or FILE.py:NAME; raise UsageError if it cannot be had."""
    place, colon, name = text.rpartition(":")
    if not colon or not place or not name:
        raise UsageError(f"--plugin {text}: name a module or file and the filter in it, as in my_filters.py:MINE")
    try:
        module = _module(place)
        value = getattr(module, name)
    except (Exception, SystemExit) as err:
        raise UsageError(f"--plugin {text}: {type(err).__name__}: {err}") from err
    return Plugin(text, value, _source(module, Path(place).name))


def _module(place: str) -> ModuleType:
    if not place.endswith(".py"):
        return importlib.import_module(place)
    file = Path(place).resolve()
    name = f"usbldr_plugin_{file.stem}_{hashlib.sha256(str(file).encode()).hexdigest()[:8]}"
    if name not in sys.modules:
        spec = importlib.util.spec_from_file_location(name, file)
        assert spec is not None  # the suffix is .py
        assert spec.loader is not None
        module = sys.modules[name] = importlib.util.module_from_spec(spec)  # before it runs: dataclasses look it up
        try:
            spec.loader.exec_module(module)
        except BaseException:  # also on Ctrl-C: a module that ran in part must not be imported again as whole
            del sys.modules[name]
            raise
    return sys.modules[name]


def _package(entry: EntryPoint) -> str:
    return f"{entry.dist.name} {entry.dist.version}" if entry.dist is not None else entry.module


def _source(module: ModuleType, package: str) -> str:
    """Return the package and the digest of the Python files beside the module, or of the module alone."""
    file = Path(module.__file__) if module.__file__ else None
    digest = hashlib.sha256()
    for one in [] if file is None else sorted(file.parent.glob("*.py")) if module.__package__ else [file]:
        digest.update(one.read_bytes())
    return f"{package} (sha256 {digest.hexdigest()})"


def sources() -> tuple[str, ...]:
    """Return where all parts of other packages come from, with their digests: they may change a result."""
    found = [part for group in (METHODS, FORMATS, LAYOUTS) for part in offered(group)]
    return tuple(sorted({part.source for part in (*found, *map(named, asked_for()))}))
