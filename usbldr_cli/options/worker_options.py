"""The options that say where runs are made: processes of this machine, or workers of a Dask scheduler."""

import functools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import click


@dataclass(frozen=True, slots=True)
class WorkerChoices:
    """The options, as given."""

    jobs: int | None = None  # processes; None: one per core
    scheduler: str | None = None  # address of a Dask scheduler


def worker_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add --jobs and --scheduler; the command gets them as one WorkerChoices, ``workers``."""

    @functools.wraps(command)
    def packed(jobs: int | None, scheduler: str | None, **given: Any) -> Any:
        return command(workers=WorkerChoices(jobs, scheduler), **given)

    scheduled = click.option(
        "--scheduler", metavar="ADDRESS", help="Run on the workers of a Dask scheduler, as tcp://host:8786."
    )
    several = click.option(
        "--jobs", "-j", metavar="N", type=click.IntRange(min=1), help="Runs in parallel.  [default: one per core]"
    )
    return several(scheduled(packed))
