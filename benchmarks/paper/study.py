"""Make paper.md and its pictures: the study that sets our filters beside the paper's numbers and the bounds.

    python benchmarks/paper/study.py --seeds 20

Finished runs are kept in a folder and used again, so an interrupted study goes on where it was.
"""

import argparse
import re
import sys
import time
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # paper and field are packages

from paper import goals as paper_goals
from paper import tables
from paper.bounds import limits
from paper.figures import write_figures
from paper.readings import ROWS
from paper.runs import STATES, Rows, Way, plan, run_plan, write_sweeps
from usbldr.filters.bounds.dive_bounds import PositionBound
from usbldr.filters.errors import UsbldrError
from usbldr.filters.replay.methods import METHODS
from usbldr.io.reports.run_directory import write_atomically
from usbldr.io.scenarios.shipped import find_scenario
from usbldr_cli.runs.executors import executor
from usbldr_cli.runs.seed_table import ComparisonRow, difference
from workers import add_worker_options, worker_choices

ROOT = Path(__file__).resolve().parents[2]
BOUND_DIVES = 16  # over which the bound is averaged: from dive to dive it differs by some 3 %
TEXT = Path(__file__).with_name("text.md")


def main() -> int:
    options = arguments()
    began = time.monotonic()
    sweeps, store = options.runs / "sweeps", options.runs / "units"
    store.mkdir(parents=True, exist_ok=True)
    write_sweeps(sweeps)
    wanted = plan(options.seeds, sweeps, options.unseen)
    try:
        with executor(worker_choices(options)) as where:
            print(f"{sum(wanted.values())} runs of {len(wanted)} rows, {where.workers} at a time; kept in {store}")
            rows = run_plan(wanted, where, store)
    except UsbldrError as fault:
        print(f"benchmarks/paper/study.py: {fault}", file=sys.stderr)
        return fault.exit_code
    reused = sum(outcome.reused for row in rows.values() for outcome in row.outcomes)
    print(f"{reused} runs were finished already; runs took {minutes(began)}")

    of_drawn = limits(find_scenario("paper-drawn"), ("scale",), range(min(BOUND_DIVES, 2 * options.seeds)))
    of_paper = {calibrate: limits(find_scenario("paper"), _keys(calibrate), (0,)) for calibrate in STATES}
    write_figures(
        options.output / "paper", rows, sweeps, options.seeds, {"paper-drawn": of_drawn, "paper": of_paper["scale"]}
    )
    of_range = limits(find_scenario("paper-range"), ("scale",), (0,))
    goals = paper_goals.goals(rows, of_drawn, paper_goals.timed())
    text = document(rows, sweeps, options.seeds, goals, of_drawn, of_paper, of_range)
    write_atomically(options.output / "paper.md", text.encode())
    faults = {f"{log}, {way.label}: {row.fault}" for (log, way), row in rows.items() if row.fault}
    print(*sorted(f"failed: {fault}" for fault in faults), f"{options.output / 'paper.md'}: {minutes(began)}", sep="\n")
    return 1 if faults else 0


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=20, help="dives of each scenario, at least 2; 50 for the goals")
    add_worker_options(parser)
    parser.add_argument("--runs", type=Path, default=ROOT / "paper-runs", help="folder of finished runs")
    parser.add_argument("--output", type=Path, default=ROOT / "docs" / "studies", help="folder of paper.md and paper/")
    parser.add_argument("--without-unseen", dest="unseen", action="store_false", help="without the unseen dive")
    options = parser.parse_args()
    if options.seeds < 2:
        parser.error("--seeds: standard errors need 2 dives or more")
    return options


def document(
    rows: Rows,
    sweeps: Path,
    seeds: int,
    goals: list[paper_goals.Goal],
    of_drawn: PositionBound,
    of_paper: Mapping[str, PositionBound],
    of_range: PositionBound,
) -> str:
    """Return docs/studies/paper.md: the text with every table and number in its place."""
    parts = {
        "made": f"SEEDS={seeds}, usbldr {version('usbldr')}, NumPy {version('numpy')}",
        "seeds": str(seeds),
        "summary": summary(rows, goals, of_drawn),
        "goals": paper_goals.table(goals),
        "ranking": ranking(rows),
        "filters": tables.filters(rows),
        "drift": tables.drift(rows, sweeps),
        "counts": tables.counts(rows),
        "outliers": tables.outliers(rows, sweeps),
        "features": tables.features(rows),
        "drawn": tables.drawn(rows, of_drawn),
        "assumed": tables.assumed(rows, of_paper),
        "slant": tables.slant(rows),
        "slant_bound": tables.least(of_range),
        "delays": tables.delays(rows),
        "lake": tables.lake(rows),
        "unseen": tables.unseen(rows),
    }
    return filled(TEXT.read_text(encoding="utf-8"), parts)


def filled(text: str, parts: Mapping[str, str]) -> str:
    """Return the text with each {{name}} replaced; KeyError for a name without a part, or a part without a name."""
    named = set(re.findall(r"{{(\w+)}}", text))
    if named != set(parts):
        raise KeyError(f"text and parts differ: {', '.join(sorted(named ^ set(parts)))}")
    return re.sub(r"{{(\w+)}}", lambda found: parts[found.group(1)], text)


def summary(rows: Rows, goals: list[paper_goals.Goal], of_drawn: PositionBound) -> str:
    """Return what the study found, in sentences whose numbers and verdicts are those measured."""
    cpf, scale, smoothed = (
        tables.errors(rows["paper", way]) for way in (Way("cpf"), Way("cpf", "scale"), Way("adf", "scale", smooth=True))
    )
    adf = rows["paper-drawn", Way("adf", "scale")]
    ratio = [tables.over(adf, axis, least)[0] for axis, least in zip(tables.AXES, of_drawn.filter_m, strict=True)]
    missed = [f"{goal.what} ({goal.measured}, goal {goal.goal})" for goal in goals if not goal.met]
    not_met = f"; not met: {', '.join(missed)}" if missed else ""
    return f"""\
- `cpf` with the paper's six states: {cpf} m. The paper reports .31/.30.
- With the DVL's scale as a state: {scale} m; with a smoother: {smoothed} m.
- If the model is true, the error of `adf` is {ratio[0]:.2f}/{ratio[1]:.2f} times the Cramér-Rao bound.
- {one_gaussian(rows)}
- {len(goals) - len(missed)} of the {len(goals)} goals below are met{not_met}."""


def ranking(rows: Rows) -> str:
    """Say how PF, UPF and CPF rank here."""
    pf, upf, cpf = (rows["paper", Way(name)] for name in ("pf", "upf", "cpf"))
    return (
        f"The paper has PF .61/.59, UPF .37/.41, CPF .31/.30. Here PF has {tables.errors(pf)}, "
        f"UPF {tables.errors(upf)}, CPF {tables.errors(cpf)}; UPF minus CPF over the same dives: "
        f"{apart(upf, cpf)[0]} horizontally."
    )


def one_gaussian(rows: Rows) -> str:
    """Say how far `adf` is from `cpf`."""
    sentences = []
    for calibrate, states in (("none", "six states"), ("scale", "the scale state")):
        gap, significant = apart(rows["paper", Way("adf", calibrate)], rows["paper", Way("cpf", calibrate)])
        sentences.append(f"{gap} ({'significant' if significant else 'not significant'}) with {states}")
    return (
        "`adf` (one Gaussian with the same likelihood, no particles) minus `cpf`, mean horizontal error over "
        f"the same dives: {', '.join(sentences)}. The accuracy comes from the likelihood and the states, not from the "
        "particles."
    )


def apart(row: ComparisonRow, other: ComparisonRow) -> tuple[str, bool]:
    """Say by how much one row errs more than another, and return whether that is significant."""
    gap = difference(row, other)
    assert gap is not None
    return f"{gap.mean:+.4f}" + (f" ± {gap.se:.4f}" if gap.se is not None else "") + " m", gap.significant


def minutes(began: float) -> str:
    seconds = time.monotonic() - began
    return f"{int(seconds // 60)} min {seconds % 60:.0f} s"


def _keys(calibrate: str) -> tuple[str, ...]:
    return () if calibrate == "none" else tuple(calibrate.split(","))


if __name__ in ("__main__", "__mp_main__"):  # in the processes of run_jobs, too
    METHODS.update(ROWS)
if __name__ == "__main__":
    sys.exit(main())
