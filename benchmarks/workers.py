"""The options of every study that say where its runs are made."""

import argparse

from usbldr_cli.options.worker_options import WorkerChoices


def add_worker_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--jobs", type=int, help="runs in parallel; default: one per core")
    parser.add_argument("--scheduler", metavar="ADDRESS", help="of a Dask scheduler (docs/cluster.md)")


def worker_choices(options: argparse.Namespace) -> WorkerChoices:
    return WorkerChoices(options.jobs, options.scheduler)
