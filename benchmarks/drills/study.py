"""Make drills.md and its pictures: filters under faults, worst cases on top.

    python benchmarks/drills/study.py --seeds 8

Scenarios, and the field logs where USBLDR_FIELD_LOGS has them. Finished runs are kept in a folder and used again, so
an interrupted study goes on where it was.
"""

import argparse
import sys
import time
from importlib.metadata import version
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # drills, field and paper are packages

from drills import tables
from drills.runs import run_log
from drills.ways import DEFAULT, OF_PAPERS, WAYS, DrilledLog, label, logs
from paper.study import filled, minutes
from usbldr.filters.errors import UsbldrError
from usbldr.io.drills.drill import Drill
from usbldr.io.drills.suite import STANDARD, read_suite
from usbldr.io.reports.run_directory import write_atomically
from usbldr_cli.figures.drawing import save_whole
from usbldr_cli.figures.drill import error_figure, ratio_figure
from usbldr_cli.figures.style import in_style
from usbldr_cli.runs.drill_rows import DrillReport, worst_first
from usbldr_cli.runs.executors import executor
from workers import add_worker_options, worker_choices

ROOT = Path(__file__).resolve().parents[2]
HERE = Path(__file__).parent
DRAWN = 3  # drills of each log with a picture of their own


def main() -> int:
    options = arguments()
    began = time.monotonic()
    store, figures = options.runs / "units", options.output / "drills"
    for one in (store, figures):
        one.mkdir(parents=True, exist_ok=True)
    try:
        chosen = [log for log in logs(options.seeds) if not options.logs or log.name in options.logs]
        standard = picked(read_suite(STANDARD), options.only)
        of_papers = picked(read_suite(str(HERE / "papers.toml")), options.only)
        parts: list[str] = []
        with executor(worker_choices(options)) as where:
            for log in chosen:
                report = run_log(log, WAYS, standard, where, store)
                parts.append(section(log, report, figures))
                print(f"{log.name}: {minutes(began)}", flush=True)
            papers = run_log(chosen[0], OF_PAPERS, of_papers, where, store)
    except UsbldrError as fault:
        print(f"benchmarks/drills/study.py: {fault}", file=sys.stderr)
        return fault.exit_code
    write_atomically(options.output / "drills.md", document(options.seeds, parts, papers, chosen[0]).encode())
    print(f"{options.output / 'drills.md'}: {minutes(began)}")
    return 0


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=8, help="dives of `turns`; a quarter of them of the other logs")
    add_worker_options(parser)
    parser.add_argument("--runs", type=Path, default=ROOT / "drill-runs", help="folder of finished runs")
    parser.add_argument(
        "--output", type=Path, default=ROOT / "docs" / "studies", help="folder of drills.md and drills/"
    )
    parser.add_argument("--logs", nargs="*", default=[], help="only these logs")
    parser.add_argument("--only", default="", help="only drills whose name contains this")
    return parser.parse_args()


def picked(drills: tuple[Drill, ...], only: str) -> tuple[Drill, ...]:
    """Return the drills whose name contains a text; all of them if none does."""
    return tuple(drill for drill in drills if only in drill.name) or drills[:1]


def section(log: DrilledLog, report: DrillReport, figures: Path) -> str:
    """Return the part of one log, and draw its pictures."""
    dives = report.usual[0].dives
    kinds = ("dive", "dives") if dives else ("seed of faults and particles", "seeds of faults and particles")
    count = f"{log.seeds} {kinds[log.seeds != 1]}"
    texts = [
        f"## {log.name}",
        f"{count}. {tables.named(report)}",
        tables.summary(report, label(DEFAULT)),
        "Mean horizontal error in metres, and in brackets that over the error without faults:",
        tables.drills_by_filter(report),
        "Drift from the start of the faults to their end in metres, and seconds until the position is re-acquired:",
        tables.outages(report),
        "NEES, 2 is right:",
        tables.consistency(report),
        *draw(log, report, figures),
    ]
    return "\n\n".join(texts)


def draw(log: DrilledLog, report: DrillReport, folder: Path) -> list[str]:
    """Draw all drills of a log and the worst of them; return the lines that show the pictures."""
    names = list(dict.fromkeys(row.drill.name for row in worst_first(report.rows)))[:DRAWN]
    lines: list[str] = []
    with in_style():
        pictures = [(log.name, "Error with the faults over error without them", ratio_figure(report.rows))]
        for k, name in enumerate(names):
            rows = [row for row in report.rows if row.drill.name == name]
            pictures.append((f"{log.name}-{k + 1}", f"Horizontal error: {name}", error_figure(rows)))
        for name, caption, figure in pictures:
            if figure is not None:
                save_whole(figure, folder / f"{name}.png")
                lines.append(f"![{caption}](drills/{name}.png)\n\n*{caption} ({log.name})*")
    return lines


def document(seeds: int, parts: list[str], papers: DrillReport, log: DrilledLog) -> str:
    """Return docs/studies/drills.md: the text with every table in its place."""
    return filled(
        (HERE / "text.md").read_text(encoding="utf-8"),
        {
            "made": f"SEEDS={seeds}, usbldr {version('usbldr')}",
            "logs": "\n\n".join(parts),
            "papers_log": log.name,
            "papers": tables.drills_by_filter(papers),
        },
    )


if __name__ == "__main__":
    sys.exit(main())
