"""Shared fixtures: where the field logs lie, and runs that draw nothing and start no process."""

import os
import signal
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import settings

import usbldr_cli.figures.run_figures
from checkout import ROOT
from usbldr.filters.plugins import VARIABLE as PLUGINS
from usbldr.filters.replay.methods import METHODS
from usbldr_cli.runs import jobs
from usbldr_cli.runs.executors import LocalProcesses

settings.register_profile("usbldr", deadline=None)  # time decides no test
settings.load_profile("usbldr")


@pytest.fixture(autouse=True, scope="session")
def _hears_interruptions() -> None:
    """A shell starts background jobs deaf to SIGINT, and what a test starts would inherit that."""
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(autouse=True, scope="session")
def _one_job_runs_here() -> Iterator[None]:
    """Make runs in this process, where a test does not ask for several: starting one takes longer than most runs."""
    elsewhere = LocalProcesses.finished

    def finished(self: LocalProcesses, call: Any, tasks: Iterable[Any], shared: Any) -> Iterator[Any]:
        if self.workers > 1:
            yield from elsewhere(self, call, tasks, shared)
            return
        jobs._open.cache_clear()
        jobs._read.cache_clear()
        for place, task in enumerate(tasks):
            yield place, call(task, shared)

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(LocalProcesses, "finished", finished)
        patched.setattr(os, "cpu_count", lambda: 1)  # of commands without --jobs
        yield


@pytest.fixture(scope="session")
def field_logs() -> Path:
    """Return the folder of third-party logs, which are not ours to ship; skip where it is absent."""
    beside = ROOT.parent / "shared" / "logs"
    folder = Path(os.environ.get("USBLDR_FIELD_LOGS", beside))
    if not folder.is_dir():
        pytest.skip(f"no field logs at {folder} (set USBLDR_FIELD_LOGS)")
    return folder


@pytest.fixture(autouse=True)
def _plugins_end_with_their_test(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Forget what --plugin added in this process: it would be part of the provenance of every later run."""
    monkeypatch.setenv(PLUGINS, "")
    known = set(METHODS)
    yield
    for name in set(METHODS) - known:
        del METHODS[name]


@pytest.fixture(autouse=True)
def _without_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let no run of this process draw its pictures, which take longer than all the rest; their own tests draw them."""
    monkeypatch.setattr(usbldr_cli.figures.run_figures, "run_pictures", lambda *_: [])
