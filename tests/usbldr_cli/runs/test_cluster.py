"""Runs on a real Dask scheduler with two workers: results equal to local ones, lost workers, refusals."""

import os
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Generator
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from commands import free_port, run, spoil, write_short
from usbldr.filters.errors import UsageError
from usbldr_cli.options.run_options import RunChoices
from usbldr_cli.options.worker_options import WorkerChoices
from usbldr_cli.runs import cluster, jobs, worker_checks
from usbldr_cli.runs.executors import LocalProcesses, executor
from usbldr_cli.runs.job_store import JobResult, read_trace
from usbldr_cli.runs.worker_checks import UnfitWorkerError, expected, installed
from usbldr_cli.runs.workers import Job

pytest.importorskip("distributed")
CHOICES = RunChoices(20, None, 0, None, None, "none", "start", 5.0, 1.0, "none")


def start(*arguments: object) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-m", f"distributed.cli.{arguments[0]}", *map(str, arguments[1:]), "--no-dashboard"]
    environment = os.environ | {"OMP_NUM_THREADS": "1"}
    return subprocess.Popen(command, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def worker(address: str) -> subprocess.Popen[bytes]:
    return start("dask_worker", address, "--nthreads", "1", "--no-nanny", "--death-timeout", "60")


@pytest.fixture(scope="module")
def address() -> Generator[str]:
    scheduler = start("dask_scheduler", "--host", "127.0.0.1", "--port", port := free_port())
    yield f"tcp://127.0.0.1:{port}"
    scheduler.kill()
    scheduler.wait()


@pytest.fixture(scope="module")
def workers(address: str) -> Generator[list[subprocess.Popen[bytes]]]:
    started = [worker(address), worker(address)]
    yield started
    for one in started:
        one.kill()
        one.wait()


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_short(tmp_path_factory.mktemp("logs") / "dive", "paper", 20.0)


def reported(outcomes: list[JobResult]) -> tuple[object, object]:
    traces = [read_trace(one.trace) for one in outcomes if one.trace is not None]
    return [(one.metrics, one.warnings, one.fault) for one in outcomes], [t.estimate_m.tobytes() for t in traces]


def refusal(asked: WorkerChoices) -> str:
    with pytest.raises(UsageError) as refused, executor(asked):
        pass
    return str(refused.value)


def test_a_scheduler_without_workers_is_a_sentence(address: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cluster, "WORKERS_S", 0.2)

    assert re.search(
        r"has no workers, also after 0.2 s: start some with `PYTHONSAFEPATH=1 dask worker", refusal(asked(address))
    )


def test_a_scheduler_that_does_not_answer_is_a_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cluster, "CONNECT_S", 0.5)

    assert "no Dask scheduler answered within 0.5 s" in refusal(asked(f"tcp://127.0.0.1:{free_port()}"))


def test_what_is_no_address_and_what_contradicts_itself_are_sentences() -> None:
    assert "foo is not an address such as tcp://host:8786" in refusal(asked("foo"))
    assert "leave it out with --scheduler" in refusal(WorkerChoices(2, "tcp://host:8786"))


def test_without_the_extra_the_sentence_says_how_to_install_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)

    assert "pip install 'usbldr[cluster]'" in refusal(asked("tcp://host:8786"))


def asked(address: str) -> WorkerChoices:
    return WorkerChoices(scheduler=address)


@pytest.mark.long
def test_a_worker_that_is_killed_half_way_changes_no_bit(address, workers, log, tmp_path):
    units = [Job(str(log), "cpf", replace(CHOICES, seed=seed)) for seed in range(8)]
    units.append(replace(units[0], log=str(tmp_path / "nothing")))  # a fault is a result, and is not tried again
    stores = [tmp_path / name for name in ("there", "here")]
    for store in stores:
        store.mkdir()
    written: list[int] = []

    def kill_after_the_first(results: Generator[tuple[int, Any]]) -> Generator[tuple[int, Any]]:
        for found in results:
            if not written:
                workers[0].kill()
                workers[0].wait()
            written.append(found[0])
            yield found

    with cluster.connected(address) as where:
        where.client.wait_for_workers(2, timeout=60)
        killing: Any = SimpleNamespace(
            elsewhere=True, workers=2, finished=lambda *given: kill_after_the_first(where.finished(*given))
        )
        there = jobs.run_jobs(units, killing, stores[0])

    assert workers[0].poll() == -signal.SIGKILL
    assert sorted(written) == list(range(9))
    assert reported(there) == reported(jobs.run_jobs(units, LocalProcesses(1), stores[1]))
    assert "nothing: no such file, folder or scenario" in str(there[-1].fault)
    assert len(list(stores[0].glob("*.json"))) == 8


@pytest.mark.usefixtures("workers")
def test_compare_runs_there_and_a_second_time_takes_what_is_stored(address, log, tmp_path, monkeypatch):
    monkeypatch.chdir(log.parent)  # a name that means nothing in the folder of a worker
    words = ("compare", "dive", "-f", "usbl,ekf", "-q", "-o", tmp_path / "out", "--scheduler", address)

    first, again = run(*words), run(*words)

    assert first.exit_code == 0
    assert "ekf" in first.stdout
    assert first.stdout == again.stdout
    assert "2 of 2 runs were finished already" in again.stderr


@pytest.mark.usefixtures("workers")
def test_a_worker_of_another_version_refuses_and_names_both(address, log, monkeypatch):
    here = installed()._replace(version="9.9.9")
    monkeypatch.setattr(worker_checks, "installed", lambda: here)

    with cluster.connected(address) as where, pytest.raises(UnfitWorkerError) as refused:
        jobs.run_jobs([Job(str(log), "ekf", CHOICES)], where)

    assert re.search(rf"runs usbldr {version('usbldr')} \(.*this command usbldr 9.9.9 \(", str(refused.value))


def ordered(unit: Job) -> jobs.Order:
    return jobs.Order((unit,), expected(unit))


@pytest.fixture
def unit(log: Path, tmp_path: Path) -> Job:
    """A job on a copy of the log."""
    return Job(str(shutil.copytree(log, tmp_path / "dive")), "ekf", CHOICES)


def test_a_worker_whose_log_differs_or_is_not_there_refuses(unit: Job) -> None:
    order = ordered(unit)
    spoil(Path(unit.log) / "usbldr.toml", "sd_m = 1.0", "sd_m = 3.0")

    with pytest.raises(UnfitWorkerError, match=r"dive or a file that belongs to it differs on"):
        jobs.run_order(order, frozenset())
    shutil.rmtree(unit.log)
    with pytest.raises(UnfitWorkerError, match=r"does not have .*dive: keep logs where all workers reach them"):
        jobs.run_order(order, frozenset())


def test_a_log_that_changed_since_the_last_order_is_read_again(unit: Job) -> None:
    (before,) = jobs.run_order(ordered(unit), frozenset())
    spoil(Path(unit.log) / "usbldr.toml", "sd_m = 1.0", "sd_m = 3.0")

    (after,) = jobs.run_order(ordered(unit), frozenset())

    assert before.key != after.key


def test_a_worker_with_several_threads_refuses(monkeypatch: pytest.MonkeyPatch) -> None:
    crowded = SimpleNamespace(address="tcp://host:1", state=SimpleNamespace(nthreads=2))
    monkeypatch.setattr("distributed.get_worker", lambda: crowded)

    with pytest.raises(UsageError, match=r"has 2 threads.*--nthreads 1"):
        cluster.call_on_worker(lambda task, shared: task, 1, None)


def test_a_worker_takes_over_the_limits_of_the_command(log: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("USBLDR_LIMITS", "7")
    order = ordered(Job(str(log), "usbl", CHOICES))
    monkeypatch.setenv("USBLDR_LIMITS", "3")

    jobs.run_order(order, frozenset())

    assert os.environ["USBLDR_LIMITS"] == "7"
