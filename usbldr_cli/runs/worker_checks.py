"""What a worker elsewhere must have before it runs anything: the same code, and the same bytes of the log.

Results that are stored have the digest of the code that made them: those of other code are not used again.
"""

import functools
import hashlib
import os
import socket
from collections.abc import Mapping
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import usbldr.filters
from usbldr.filters.errors import LogError, UsageError
from usbldr.filters.kernel import KERNEL
from usbldr.filters.plugins import VARIABLE as PLUGINS
from usbldr.filters.plugins import asked_for, sources
from usbldr.io.limits import VARIABLE as LIMITS
from usbldr.io.reading.remote import local_log
from usbldr_cli.options.log_options import inputs, read_request
from usbldr_cli.runs.workers import Job

SHOWN = 8  # [characters] of a digest in a sentence
SET_BY_OPTIONS = (LIMITS, PLUGINS)
FILES = ("config", "truth", "joined", "msg_path")  # of a selection: what may be paths


class UnfitWorkerError(UsageError):
    """A worker lacks what the runs need; nothing that it would compute is a result."""


class Software(NamedTuple):
    """What makes the numbers of a run, as installed."""

    version: str
    code: str  # digest
    numpy: str
    compiled: bool

    def __str__(self) -> str:
        runs = "compiled kernel" if self.compiled else "no compiled kernel"
        return f"usbldr {self.version} (code {self.code[:SHOWN]}, NumPy {self.numpy}, {runs})"


def installed() -> Software:
    """Return what runs in this process; the digest is that of all code: filters, kernel, readers, commands."""
    digest = hashlib.sha256((code_digest() + _outer_digest()).encode())
    return Software(version("usbldr"), digest.hexdigest(), version("numpy"), KERNEL.advance is not None)


@functools.cache
def _outer_digest() -> str:
    import usbldr.io
    import usbldr_cli

    digest = hashlib.sha256()
    for package in (usbldr.io, usbldr_cli):
        files = Path(str(package.__file__)).parent.rglob("*")
        for file in sorted(file for file in files if file.suffix in (".py", ".toml")):
            digest.update(file.read_bytes())
    return digest.hexdigest()


class Expected(NamedTuple):
    """What the client has."""

    software: Software
    digest: str  # of the log and the files that belong to it; "" if it cannot be read
    environment: Mapping[str, str]  # what options set there: --limits and --plugin


def expected(job: Job) -> Expected:
    """Return what a worker has to have for a run."""
    request = read_request(**job.selection)
    try:
        with local_log(job.log, request) as path:
            digest = _digest(path, job.selection)
    except LogError:
        digest = ""  # the worker says what is wrong with the log
    return Expected(installed(), digest, {name: os.environ[name] for name in SET_BY_OPTIONS if name in os.environ})


def with_whole_paths(job: Job) -> Job:
    """Return the run with absolute paths of the files that exist here: a worker has another current folder."""
    selection = {name: _whole(value) if name in FILES else value for name, value in job.selection.items()}
    return replace(job, log=_whole(job.log), selection=selection)


def _whole(value: Any) -> Any:
    if isinstance(value, str):
        return os.path.abspath(value) if os.path.exists(value) else value
    return value if value is None else tuple(_whole(one) for one in value)


def require_software(wanted: Expected) -> None:
    """Raise UnfitWorkerError if this process has other software than the client; take over its limits and plugins."""
    from usbldr.filters.replay.methods import add_named

    for name in SET_BY_OPTIONS:
        os.environ.pop(name, None)
    os.environ.update(wanted.environment)
    for text in asked_for():
        add_named(text)
    here = installed()
    if here != wanted.software:
        raise UnfitWorkerError(
            f"worker on {socket.gethostname()} runs {here}, this command {wanted.software}: install the same for both"
        )


def require_log(log: str, wanted: Expected) -> None:
    """Raise UnfitWorkerError if a log is not here, but was at the client."""
    if wanted.digest and os.path.isabs(log) and not os.path.exists(log):
        raise UnfitWorkerError(
            f"worker on {socket.gethostname()} does not have {log}: keep logs where all workers reach them by "
            "the same path, or name them by URL"
        )


def require_digest(log: str, path: Path, selection: Mapping[str, Any], wanted: str) -> None:
    """Raise UnfitWorkerError if a log and its configuration, here at ``path``, differ from those of the client."""
    found = _digest(path, selection)
    if wanted and found != wanted:
        raise UnfitWorkerError(
            f"{log} or a file that belongs to it differs on {socket.gethostname()} (digest {found[:SHOWN]}) from what "
            f"this command reads ({wanted[:SHOWN]}): give all workers the same files"
        )


def _digest(path: Path, selection: Mapping[str, Any]) -> str:
    from usbldr.io.reading.opening import digest_paths

    if path.is_absolute() and not path.exists():
        return ""
    try:
        return digest_paths(inputs(str(path), read_request(**selection)))
    except OSError:
        return ""


def code_digest() -> str:
    """Return the digest of the installed filters, of plugins, of NumPy's version, and of the kernel if it runs."""
    return _own() + "".join(f" {source}" for source in sources())


@functools.cache
def _own() -> str:
    return digest_of(Path(usbldr.filters.__file__).parent, compiled=KERNEL.advance is not None)


def digest_of(filters: Path, *, compiled: bool) -> str:
    """Return the digest for the package at a path; its compiled kernel counts only if it is used.

    All variants of the kernel give the same numbers, so they do not count.
    """
    digest = hashlib.sha256(f"{version('usbldr')} {version('numpy')}".encode())
    kernel = filters.glob("kernel/_kernel*[!i]") if compiled else ()
    for file in sorted([*filters.rglob("*.py"), *kernel]):
        digest.update(file.read_bytes())
    return digest.hexdigest()
