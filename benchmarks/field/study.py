"""Make field.md and its pictures: every filter on every field log, and what each feature and default is worth.

    python benchmarks/field/study.py

The logs are third-party: USBLDR_FIELD_LOGS names their folder. Finished runs are kept in a folder and used again. The
logs that are held back are run only with --held-back: they judge the defaults, so they are not used before those
are frozen.
"""

import argparse
import os
import sys
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from importlib.metadata import version
from multiprocessing import get_context
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # paper and field are packages

from field import goals as field_goals
from field import tables
from field.agreement import Likeness, agreement
from field.changes import SENSITIVITY
from field.figures import draw_consistency, draw_paper_filters, draw_run, pictures
from field.logs import CASES, Case, dive, field_folder
from field.plan import PAPER_LOGS, Rows, plan
from field.runs import run_plan
from paper.study import filled, minutes
from usbldr.filters.errors import UsbldrError
from usbldr.io.reports.run_directory import write_atomically
from usbldr_cli.runs.executors import executor
from workers import add_worker_options, worker_choices

ROOT = Path(__file__).resolve().parents[2]
TEXT = Path(__file__).with_name("text.md")
NOT_RUN = "*Not run yet: `make field` runs it.*"
CAPTIONS = {
    "track": "Track of `adf` with truth and fixes; right: around the largest error",
    "errors": "East and north errors with the filter's own 2-sigma band",
    "calibration": "Estimated sensor errors with their 2-sigma band",
    "innovations": "Innovations, and NIS of each sensor",
    "consistency": "NEES over time, and its distribution beside the expected one",
    "filters": "The paper's filters on this log, as in its Figure 3 (in its lake trial pf had 1.26 m east and 0.96 m "
    "north, upf 1.07 and 0.88, cpf 0.96 and 0.75)",
}


def main() -> int:
    options = arguments()
    began = time.monotonic()
    store, figures = options.runs / "units", options.output / "field"
    try:
        folder = field_folder()
        for one in (store, figures):
            one.mkdir(parents=True, exist_ok=True)
        cases = [
            case for case in CASES.values() if case.name in options.logs and (options.held_back or not case.held_back)
        ]
        wanted = plan(cases, options.sensitivity)
        with executor(worker_choices(options)) as where:
            print(f"{sum(wanted.values())} runs of {len(wanted)} rows, {where.workers} at a time; kept in {store}")
            rows = run_plan(wanted, where, store, folder)
        print(f"runs took {minutes(began)}", flush=True)
        drawn = draw(cases, rows, options.jobs or os.cpu_count() or 1, folder, figures)
        agreed = {case.name: agreement(dive(case.name, 0, folder)) for case in cases}
    except UsbldrError as fault:
        print(f"benchmarks/field/study.py: {fault}", file=sys.stderr)
        return fault.exit_code
    write_atomically(options.output / "field.md", document(cases, rows, drawn, agreed).encode())
    faults = sorted(
        {f"{row.log}, {way.label} {change}: {row.fault}" for (_, way, change), row in rows.items() if row.fault}
    )
    print(*(f"failed: {fault}" for fault in faults), f"{options.output / 'field.md'}: {minutes(began)}", sep="\n")
    return 1 if faults else 0


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    add_worker_options(parser)
    parser.add_argument("--runs", type=Path, default=ROOT / "field-runs", help="folder of finished runs")
    parser.add_argument("--output", type=Path, default=ROOT / "docs" / "studies", help="folder of field.md and field/")
    parser.add_argument("--logs", nargs="+", default=list(CASES), choices=list(CASES), help="these alone")
    parser.add_argument(
        "--without-sensitivity", dest="sensitivity", action="store_false", help="two thirds of the time"
    )
    parser.add_argument("--held-back", action="store_true", help="also the logs that judge the frozen defaults")
    return parser.parse_args()


def draw(cases: Sequence[Case], rows: Rows, jobs: int, folder: Path, figures: Path) -> dict[str, list[str]]:
    """Draw every picture; return the files by log, the one with its outages as a log of its own."""
    wanted = pictures(cases)
    with ProcessPoolExecutor(jobs, get_context("spawn")) as pool:
        waiting = [pool.submit(draw_run, name, change, folder, figures) for name, change in wanted]
        found = {" ".join(which).strip(): future.result() for which, future in zip(wanted, waiting, strict=True)}
    for case in cases:
        found[case.name].append(draw_consistency(case, rows, figures))
        if case.name in PAPER_LOGS:
            found[case.name].append(draw_paper_filters(case, rows, figures))
    return found


def document(
    cases: Sequence[Case], rows: Rows, drawn: dict[str, list[str]], agreed: Mapping[str, Mapping[str, Likeness]]
) -> str:
    """Return docs/studies/field.md: the text with every table and picture in its place."""
    shown = [case for case in cases if not case.held_back]
    sensitive = any(change in SENSITIVITY for _, _, change in rows)
    goals = field_goals.goals(rows, shown)
    parts = {
        "made": f"usbldr {version('usbldr')}",
        "summary": summary(goals),
        "goals": field_goals.table(goals),
        "claimed": tables.claimed(shown, rows),
        "agreed": tables.agreed({case.name: agreed[case.name] for case in shown}),
        "main": sections(shown, rows),
        "paper_filters": tables.paper_filters(shown, rows),
        "states": tables.states(shown, rows, agreed),
        "cut": tables.cut(rows) if "stpere_marina" in agreed else NOT_RUN,
        "thinned": tables.thinned(shown, rows),
        "ablation": tables.ablation(shown, rows),
        "sensitivity": tables.sensitivity(shown, rows) if sensitive else NOT_RUN,
        "largest_changes": largest_changes(shown, rows) if sensitive else "",
        "held_back": held_back(cases, rows, drawn, agreed),
        "pictures": gallery(shown, drawn),
    }
    return filled(TEXT.read_text(encoding="utf-8"), parts)


def summary(goals: Sequence[field_goals.Goal]) -> str:
    """Say how many goals were met, and name those that were not."""
    missed = [f"{goal.what} ({goal.measured}, goal {goal.goal})" for goal in goals if not goal.met]
    met = f"{len(goals) - len(missed)} of the {len(goals)} goals below are met."
    return f"{met} Not met: {'; '.join(missed)}." if missed else met


def sections(cases: Sequence[Case], rows: Rows) -> str:
    """Return each log's table under its name and kind."""
    return "\n\n".join(f"### {case.name}\n\n*{case.truth}.*\n\n{tables.main(case, rows)}" for case in cases)


def largest_changes(cases: Sequence[Case], rows: Rows) -> str:
    """Say which defaults move a log's error by more than 5 %."""
    changes = [f"`{key}` on {name} ({percent:+.0f} %)" for key, name, percent in tables.largest_changes(cases, rows)]
    if not changes:
        return "None changes the error of any log by more than 5 %."
    return f"These change the error of a log by more than 5 %: {', '.join(changes)}."


def held_back(
    cases: Sequence[Case], rows: Rows, drawn: dict[str, list[str]], agreed: Mapping[str, Mapping[str, Likeness]]
) -> str:
    """Return the tables and pictures of the logs that were held back, or say that they were not run."""
    shown = [case for case in cases if case.held_back]
    if not shown:
        return "*Not run: `make field HELD_BACK=--held-back` runs the held-back logs.*"
    goals = field_goals.goals(rows, shown)
    parts = (
        field_goals.table(goals),
        tables.claimed(shown, rows),
        tables.agreed({case.name: agreed[case.name] for case in shown}),
        sections(shown, rows),
        tables.states(shown, rows, agreed),
        gallery(shown, drawn),
    )
    return "\n\n".join(parts)


def gallery(cases: Sequence[Case], drawn: dict[str, list[str]]) -> str:
    """Return the pictures of each log under its name."""
    parts: list[str] = []
    for name, files in drawn.items():
        if name.split(" ")[0] in {case.name for case in cases}:
            captions = [CAPTIONS[file.removesuffix(".png").rsplit("_", 1)[1]] for file in files]
            parts.append(f"### {name}: pictures")
            parts += [f"![{c}](field/{file})\n\n*{c}.*" for c, file in zip(captions, files, strict=True)]
    return "\n\n".join(parts)


if __name__ == "__main__":
    sys.exit(main())
