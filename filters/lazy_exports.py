"""Public names of a package that are imported when they are first used, so that importing the package costs nothing.

The one list of them is the stub of the package, ``__init__.pyi``, which type checkers read in its place.
"""

import importlib
import re
import sys
from collections.abc import Callable
from pathlib import Path

EXPORT = re.compile(r"^from (\S+) import (\w+) as \2$", re.MULTILINE)


def lazy_exports(package: str, file: str) -> tuple[list[str], Callable[[str], object]]:
    """Return a package's ``__all__`` and its ``__getattr__``; ``file`` is the one that the stub lies beside."""
    stub = Path(file).with_suffix(".pyi").read_text(encoding="utf-8")
    modules = {name: module for module, name in EXPORT.findall(stub)}

    def load(name: str) -> object:
        if name not in modules:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        value = getattr(importlib.import_module(modules[name]), name)
        setattr(sys.modules[package], name, value)  # the next use is a plain attribute
        return value

    return sorted(modules), load
