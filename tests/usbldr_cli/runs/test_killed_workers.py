"""Workers that are killed from outside, what is kept of a run that is prepared, and what makes stored results stale."""

import os
import shutil
import signal
import threading
import time
import weakref
from collections.abc import Callable
from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from multiprocessing import active_children
from pathlib import Path

import pytest

import usbldr.filters
from checkout import SAMPLES
from commands import write_short
from usbldr.filters.errors import UsbldrError
from usbldr.filters.kernel import KERNEL
from usbldr.io.reading.opening import DEFAULT_REQUEST
from usbldr.io.session import open_log
from usbldr_cli.options.run_options import RunChoices
from usbldr_cli.runs import executors
from usbldr_cli.runs.executors import LocalProcesses
from usbldr_cli.runs.jobs import run_jobs
from usbldr_cli.runs.one_run import RunPlan, prepare_run
from usbldr_cli.runs.worker_checks import code_digest, digest_of
from usbldr_cli.runs.workers import Job

CHOICES = RunChoices(20, None, 0, None, None, "none", "start", 5.0, 1.0, "none")


def test_runs_of_a_killed_worker_are_repeated_and_give_the_same_numbers(tmp_path: Path) -> None:
    log = write_short(tmp_path / "dive", "paper", 20.0)
    units = [Job(str(log), "cpf", replace(CHOICES, seed=seed)) for seed in range(6)]
    (tmp_path / "store").mkdir()
    killed: list[int] = []

    def kill_one_after_the_first_run() -> None:
        while not list((tmp_path / "store").glob("*.json")):
            time.sleep(0.002)
        killed.extend(process.pid for process in active_children()[:1] if process.pid)
        for pid in killed:
            os.kill(pid, signal.SIGKILL)

    killer = threading.Thread(target=kill_one_after_the_first_run, daemon=True)
    killer.start()
    found = run_jobs(units, LocalProcesses(2), tmp_path / "store")
    killer.join()

    assert killed
    assert [one.metrics for one in found] == [one.metrics for one in run_jobs(units, LocalProcesses(1))]
    assert not [one.fault for one in found if one.fault]


def test_runs_that_always_die_end_the_command_with_a_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    counts: list[int] = []

    def pool(count: int, shared: object) -> AbstractContextManager[Callable[..., Future[None]]]:
        counts.append(count)
        return nullcontext(dies)

    def dies(call: object, task: object) -> Future[None]:
        dead: Future[None] = Future()
        dead.set_exception(BrokenProcessPool())
        return dead

    monkeypatch.setattr(executors, "_pool", pool)

    with pytest.raises(UsbldrError, match=r"killed from outside 3 times.*try fewer --jobs"):
        run_jobs([Job("dive", "cpf", CHOICES)] * 6, LocalProcesses(4))

    assert counts == [4, 2, 1]  # fewer at once, because memory may have run out


def test_headings_end_when_the_run_is_prepared() -> None:
    choices = RunChoices(2, None, 0, None, None, "none", "start", 5.0, 1.0)
    path = SAMPLES / "paper.mcap"
    log = open_log(path, DEFAULT_REQUEST)
    records = weakref.ref(log.tables["compass"])

    plan = RunPlan(str(path), "adf", choices)

    log, epochs, *_ = prepare_run(plan, log).without_headings()

    assert records() is None
    assert log.tables["compass"].empty
    assert epochs.yaw_count.sum() == log.provenance["compass"].used


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """A package of filters: two files of Python and a kernel with its type stub."""
    (tmp_path / "kernel").mkdir()
    for file in ("cpf.py", "kernel/__init__.py", "kernel/_kernel.abi3.so", "kernel/_kernel.pyi"):
        (tmp_path / file).write_text(file)
    return tmp_path


@pytest.mark.parametrize("compiled", [True, False])
@pytest.mark.parametrize("file", ["cpf.py", "kernel/__init__.py", "kernel/_kernel.abi3.so", "kernel/_kernel.pyi"])
def test_every_file_that_makes_results_counts_and_no_other(package: Path, file: str, compiled: bool) -> None:
    before, of_the_other = digest_of(package, compiled=compiled), digest_of(package, compiled=not compiled)
    (package / file).write_text("changed")
    counts = file.endswith(".py") or (compiled and file.endswith(".so"))
    assert (digest_of(package, compiled=compiled) != before) == counts
    assert before != of_the_other


def test_the_installed_kernel_is_among_the_files(tmp_path: Path) -> None:
    if KERNEL.advance is None:
        pytest.skip(f"no compiled kernel: {KERNEL.reason}")
    copy = shutil.copytree(Path(usbldr.filters.__file__).parent, tmp_path / "filters")
    assert digest_of(copy, compiled=True) == code_digest()
    (kernel,) = copy.glob("kernel/_kernel*.so")
    kernel.write_bytes(kernel.read_bytes() + b"0")
    assert digest_of(copy, compiled=True) != code_digest()
