"""The options that say where runs are made: processes of this machine, or workers of a Dask scheduler."""

from dataclasses import dataclass

import click

from usbldr_cli.options.option import option, packed_options


@dataclass(frozen=True, slots=True)
class WorkerChoices:
    """The options, as given."""

    jobs: int | None = None  # processes; None: one per core
    scheduler: str | None = None  # address of a Dask scheduler


worker_options = packed_options(
    WorkerChoices,
    "workers",
    (
        option(
            "--jobs", "-j", metavar="N", type=click.IntRange(min=1), help="Runs in parallel.  [default: one per core]"
        ),
        option(
            "--scheduler",
            metavar="ADDRESS",
            help="Run on the workers of a Dask scheduler, as tcp://host:8786.",
            rare=True,
        ),
    ),
)
"""Add --jobs and --scheduler; the command gets them as one WorkerChoices, ``workers``."""
