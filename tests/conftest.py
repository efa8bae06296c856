"""Shared fixtures: where the field logs lie, and runs that draw nothing."""

import os
import signal
from pathlib import Path

import pytest
from hypothesis import settings

import usbldr_cli.figures.run_figures
from checkout import ROOT

settings.register_profile("usbldr", deadline=None)  # time decides no test
settings.load_profile("usbldr")


@pytest.fixture(autouse=True, scope="session")
def _hears_interruptions() -> None:
    """A shell starts background jobs deaf to SIGINT, and what a test starts would inherit that."""
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(scope="session")
def field_logs() -> Path:
    """Return the folder of third-party logs, which are not ours to ship; skip where it is absent."""
    beside = ROOT.parent / "shared" / "logs"
    folder = Path(os.environ.get("USBLDR_FIELD_LOGS", beside))
    if not folder.is_dir():
        pytest.skip(f"no field logs at {folder} (set USBLDR_FIELD_LOGS)")
    return folder


@pytest.fixture(autouse=True)
def _without_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let no run of this process draw its pictures, which take longer than all the rest; their own tests draw them."""
    monkeypatch.setattr(usbldr_cli.figures.run_figures, "run_pictures", lambda *_: [])
