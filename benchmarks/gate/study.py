"""Make gate.md: how often `usbldr check` is wrong, from gate runs with other random numbers.

    python benchmarks/gate/study.py --seeds 200

Finished runs are kept in gate-runs and used again.
"""

import argparse
import os
import sys
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import NamedTuple

from usbldr.filters.replay.methods import METHODS
from usbldr.io.reports.run_directory import write_atomically
from usbldr.io.settings.regression_baseline import BaselineRow, read_baseline
from usbldr_cli.runs.baseline_rows import jobs_of_row
from usbldr_cli.runs.executors import LocalProcesses
from usbldr_cli.runs.jobs import run_jobs
from usbldr_cli.tables.check_verdicts import REGRESSION, compare_metric

ROOT = Path(__file__).resolve().parents[2]
LOSSES = (1.05, 1.10, 1.20)  # times the errors: 10 % is the loss that a gate should find
RESEEDED = range(1, 1 << 20)  # the baseline has seed 0


class ReseededRow(NamedTuple):
    """A row of the baseline, and its metrics with other seeds."""

    row: BaselineRow
    particles: bool  # else each seed is a dive of its own
    metrics: list[Mapping[str, float]]


def main() -> int:
    options = arguments()
    options.runs.mkdir(parents=True, exist_ok=True)
    baseline = read_baseline(ROOT / "sample_logs" / "baseline.toml")
    rows: list[ReseededRow] = []
    for row in baseline.rows:
        unit = jobs_of_row(baseline.file, row)[0]
        if not (METHODS[row.filter].draws or unit.simulated):
            continue  # such a row has no random numbers: it cannot alarm falsely
        single = replace(row, seeds=1)
        units = [replace(unit, choices=replace(unit.choices, seed=seed)) for seed in RESEEDED[: options.seeds]]
        results = run_jobs(units, LocalProcesses(options.jobs), options.runs)
        rows.append(ReseededRow(single, not unit.simulated, [one.metrics for one in results if one.fault is None]))
    write_atomically(options.output / "gate.md", page(rows, options.seeds, len(baseline.rows)).encode())
    return 0


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=str(__doc__))
    parser.add_argument("--seeds", type=int, default=200)
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--runs", type=Path, default=ROOT / "gate-runs")
    parser.add_argument("--output", type=Path, default=ROOT / "docs" / "studies")
    return parser.parse_args()


def with_loss(metrics: Mapping[str, float], loss: float) -> dict[str, float]:
    """Return the metrics of the same track with every error ``loss`` times as large: NEES grows by its square."""
    return {
        name: value * (loss**2 if name == "nees_mean" else loss if name.endswith("_m") else 1.0)
        for name, value in metrics.items()
    }


def regressions(row: BaselineRow, metrics: Mapping[str, float]) -> list[str]:
    """Return the metrics that the gate reports."""
    judged = {
        name: compare_metric(name, metric, metrics.get(name)) for name, metric in row.metrics.items() if name in metrics
    }
    return [name for name, change in judged.items() if change.verdict == REGRESSION]


def share(one: ReseededRow, loss: float = 1.0, errors_alone: bool = False) -> str:
    """Return the share of the runs of a row that the gate reports."""
    reported = [regressions(one.row, with_loss(metrics, loss)) for metrics in one.metrics]
    found = [any(name.endswith("_m") or not errors_alone for name in names) for names in reported]
    return f"{100 * sum(found) / max(1, len(found)):.1f} %"


def page(rows: Sequence[ReseededRow], seeds: int, count: int) -> str:
    particles = [one for one in rows if one.particles]
    return TEXT.format(
        seeds=seeds,
        version=version("usbldr"),
        fixed=count - len(rows),
        count=count,
        particles=table(particles, LOSSES),
        dives=table([one for one in rows if not one.particles], ()),
        gate=f"{100 * whole(particles):.0f} %",
    )


def whole(rows: Sequence[ReseededRow]) -> float:
    """Return the share of gate runs in which one of the rows alarms; the seed is that of all rows."""
    runs = list(zip(*([bool(regressions(one.row, m)) for m in one.metrics] for one in rows), strict=True))
    return sum(map(any, runs)) / max(1, len(runs))


def table(rows: Sequence[ReseededRow], losses: Sequence[float]) -> str:
    heads = [
        "row",
        "runs",
        "false alarms",
        "by errors alone",
        *(f"{100 * (loss - 1):.0f} % loss found" for loss in losses),
    ]
    lines = [f"| {' | '.join([*heads, 'false alarms by'])} |", f"|---|{'---:|' * (len(heads) - 1)}---|"]
    for one in rows:
        reported = Counter(name for metrics in one.metrics for name in regressions(one.row, metrics))
        by = ", ".join(f"`{name}` {count}" for name, count in reported.most_common(3)) or "-"
        cells = [one.row.name, str(len(one.metrics)), share(one), share(one, errors_alone=True)]
        lines.append(f"| {' | '.join([*cells, *(share(one, loss) for loss in losses), by])} |")
    return "\n".join(lines)


TEXT = """\
# False alarms of the gate

`usbldr check sample_logs/baseline.toml` with {seeds} other seeds (1 to {seeds}; the baseline has 0), usbldr {version}.
Made by `python benchmarks/gate/study.py --seeds {seeds}`.

A false alarm is a regression although nothing got worse. {fixed} of the {count} rows have no random numbers and give
no false alarm: they repeat within 1e-9 on any machine. The others are run here with other random numbers. This is the
worst case: on another machine only a few draws may differ.

A loss means that every error on the same track is 1.05, 1.10 or 1.20 times as large (NEES grows by the square). It is
found if a metric of the row is a regression.

## Rows with particles, on the same log

{particles}

At least one of these rows gives a false alarm in {gate} of the gate runs.

## Rows with another dive for each seed, one dive each

{dives}

The errors of different dives scatter by far more than the limits: keep the seeds and the logs of a gate.
"""


if __name__ == "__main__":
    sys.exit(main())
