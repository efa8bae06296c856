"""How a report was made: command, inputs with their digests, versions, machine. No number of a result is in here."""

import functools
import platform
import subprocess
import sys
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

from usbldr.filters.kernel import KERNEL
from usbldr.filters.plugins import sources
from usbldr.io.reading.inputs import InputFile
from usbldr.io.reading.opening import digest_paths

SCHEMA = 4  # fixed: the version of every JSON file that usbldr writes
GIT_S = 5.0  # [s] that git may take to name a commit: a checkout on a slow disk
LIBRARIES = ("numpy", "pandas", "mcap", "rosbags", "pymap3d", "pygeomag")
"""Libraries whose version could change a number of a report."""


class ReadFile(NamedTuple):
    """A file or folder that a run read."""

    role: str  # "log", "with", "configuration", "truth"
    file: str  # its name, without the folder
    sha256: str


@dataclass(frozen=True, slots=True)
class RunProvenance:
    """What the user asked for, and what was read for it."""

    command: tuple[str, ...] = ()  # as given; empty outside the command line
    inputs: tuple[ReadFile, ...] = ()


def read_files(inputs: Sequence[InputFile], log_sha256: str | None = None) -> tuple[ReadFile, ...]:
    """Return the inputs with their digests; ``log_sha256`` is that of the log with all files joined to it, if known."""
    alone = sum(one.role in ("log", "with") for one in inputs) == 1
    known = {"log": log_sha256} if alone else {}
    return tuple(ReadFile(role, path.name, known.get(role) or digest_paths([path])) for role, path in inputs)


def made_by() -> dict[str, Any]:
    """Return the head of every JSON file: the version of its names, and the program that wrote it."""
    return {"schema": SCHEMA, "tool": {"name": "usbldr", "version": version("usbldr")}}


def machine() -> dict[str, Any]:
    """Return what a number may depend on: Python, libraries, platform, variant of the kernel, plugins."""
    return {
        "python": platform.python_version(),
        "libraries": {name: version(name) for name in LIBRARIES},
        "platform": {"system": sys.platform, "machine": platform.machine()},
        "kernel": KERNEL.name,
        "plugins": list(sources()),
    }


@functools.cache
def checkout_commit() -> str | None:
    """Return the commit of the checkout that runs, "-dirty" if its files are changed; None if it is installed."""
    root = Path(__file__).resolve().parents[2]
    if not (root / ".git").exists():
        return None
    words = ["git", "-C", str(root), "describe", "--always", "--abbrev=40", "--exclude=*", "--dirty"]
    with suppress(OSError, subprocess.SubprocessError):
        return subprocess.run(words, capture_output=True, text=True, timeout=GIT_S, check=True).stdout.strip()
    return None


def provenance_content(run: RunProvenance) -> dict[str, Any]:
    """Return the provenance as JSON has it."""
    inputs = [one._asdict() for one in run.inputs]
    return {"command": list(run.command), "inputs": inputs, "commit": checkout_commit(), **machine()}
