"""The tables of paper.md: each is made from the rows of the study, as Markdown, with what made it underneath.

Errors are means of |east| and |north| in metres over the epochs of a dive, averaged over dives, ± the standard error.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from paper import runs
from paper.runs import Cell, Rows, Way, drifting, shared
from usbldr.filters.bounds.dive_bounds import PositionBound
from usbldr.filters.evaluation.seed_statistics import average
from usbldr.io.reports.markdown_report import markdown_table
from usbldr.io.reports.report_text import Table
from usbldr_cli.runs.seed_table import ComparisonRow, difference, row_consistency, row_metrics

AXES = ("mean_abs_east_m", "mean_abs_north_m")
FAT_TAILED = ("pf", "pf-wekf")  # a few lost dives make their mean mean nothing
PUBLISHED = {"pf": ".61/.59", "upf": ".37/.41", "cpf": ".31/.30"}
PUBLISHED_LAKE = {"pf": "1.26/.96", "upf": "1.07/.88", "cpf": ".96/.75"}


def filters(rows: Rows) -> str:
    """Return every filter on the paper's simulation, with each set of states."""
    ways = (*runs.UNFILTERED, *runs.LEADING, *runs.ALIKE, *runs.NAMED, *runs.LITERAL)
    body = []
    for way in ways:
        cells = [("paper", replace(way, calibrate=calibrate)) for calibrate in runs.STATES]
        found = [rows.get(cell) for cell in cells]
        ran = [row for row in found if row is not None]
        nees, seeds = _alike(_mean(row, "nees_mean", 2) for row in ran), _alike(len(row.seeds) for row in ran)
        published = PUBLISHED.get(way.method.removesuffix("-literal"), "") if not way.smooth else ""
        body.append((way.label, *(errors(row) if row else "" for row in found), nees, seeds, published))
    heads = (*runs.STATES.values(), "NEES", "seeds", "the paper")
    return _made(Table("|east|/|north|, m", heads, tuple(body)), "filters", rows, ("paper", Way("cpf", "scale")))


def drawn(rows: Rows, limit: PositionBound) -> str:
    """Return errors over the bound where the filters' model is true."""
    ways = (Way("adf", "scale"), Way("cpf", "scale"), Way("ekf", "scale"), Way("ekf", "scale", gate=0.99))
    body = []
    for way in (*ways, Way("adf", "scale", smooth=True)):
        row = rows["paper-drawn", way]
        least = limit.smoother_m if way.smooth else limit.filter_m
        ratio = " / ".join(_with_se(*over(row, axis, bound)) for axis, bound in zip(AXES, least, strict=True))
        efficiency = "/".join(f"{100 / over(row, axis, bound)[0]:.0f}" for axis, bound in zip(AXES, least, strict=True))
        bound = f"{in_metres(least[0])}/{in_metres(least[1])}"
        body.append((way.label, errors(row), bound, ratio, f"{efficiency} %", nees_text(row), str(len(row.seeds))))
    heads = ("error, m", "PCRLB × .798, m", "error over bound", "efficiency", "NEES", "seeds")
    return _made(Table("paper-drawn, + scale", heads, tuple(body)), "drawn", rows, ("paper-drawn", ways[0]))


def assumed(rows: Rows, limits: Mapping[str, PositionBound]) -> str:
    """Return the bounds on `paper` for the Q that the filters assume, without any efficiency."""
    body = []
    for calibrate, limit in limits.items():
        forward, smoothed = (rows["paper", Way("adf", calibrate, smooth=smooth)] for smooth in (False, True))
        bounds = (f"{in_metres(one[0])}/{in_metres(one[1])}" for one in (limit.filter_m, limit.smoother_m))
        least, least_smoothed = bounds
        body.append((runs.STATES[calibrate], errors(forward), least, errors(smoothed), least_smoothed))
    heads = ("adf, m", "bound for the assumed Q", "adf --smooth, m", "bound for the assumed Q")
    return _made(Table("paper", heads, tuple(body)), "assumed", rows, ("paper", Way("adf", "scale", smooth=True)))


def least(limit: PositionBound) -> str:
    """Return a bound in words, east before north."""
    forward, smoothed = ("/".join(map(in_metres, one)) for one in (limit.filter_m, limit.smoother_m))
    return f"{forward} m for any filter, {smoothed} m for any smoother"


def slant(rows: Rows) -> str:
    """Return the other reading of "USBL error 2 %"."""
    ways = [Way("usbl"), Way("ekf", "scale"), Way("adf", "scale"), Way("cpf", "scale")]
    cells = [("paper-range", way) for way in (*ways, Way("adf", "scale", smooth=True))]
    return plain("paper-range", cells, rows, "slant")


def delays(rows: Rows) -> str:
    """Return what late fixes and late stamps cost."""
    cpf, adf, online = Way("cpf", "scale"), Way("adf", "scale"), Way("adf", "scale", order="arrival")
    lines: tuple[tuple[str, str, Way, str], ...] = (
        ("fixes arrive 1 s late, with correct stamps", "delay", cpf, "paper"),
        ("the same", "delay", adf, "paper"),
        ("the same, each epoch as the vehicle could have known it", "delay", online, "paper"),
        ("stamps are 1 s late, not modelled", runs.LATE, adf, "paper"),
        ("nothing is late", "square", adf, ""),
        ("stamps are 0.8 s late, not modelled", "latency", adf, "square"),
        ("the same, the latency as a state", "latency", Way("adf", "scale,latency"), "square"),
    )
    body = []
    for what, log, way, against in lines:
        row = rows[log, way]
        ratio = f"{times(row, rows[against, replace(adf, method=way.method)]):.2f}" if against else ""
        body.append((what, Path(log).stem, _titled(way), errors(row), ratio, str(len(row.seeds))))
    heads = ("scenario", "filter", "error, m", "times the undelayed", "seeds")
    return _made(Table("what is late", heads, tuple(body)), "delays", rows, ("delay", Way("cpf", "scale")))


def counts(rows: Rows) -> str:
    """Return the error against the number of particles."""
    names = ("cpf", "upf", "pf")
    found = {f"{N}": [rows["paper", Way(name, particles=N)] for name in names] for N in runs.COUNTS}
    return _made(_sweep("N, 6 states", names, found), "counts", rows, ("paper", Way("cpf", particles=20)))


def outliers(rows: Rows, sweeps: Path) -> str:
    """Return the error against the share of readings with ten times the variance."""
    found = {f"{100 * p:.0f} %": [rows[shared(sweeps, p), way] for way in runs.SWEPT] for p in runs.SHARES}
    table = _sweep("share", [way.label for way in runs.SWEPT], found)
    return _made(table, "outliers", rows, ("paper", Way("adf")))


def drift(rows: Rows, sweeps: Path) -> str:
    """Return the error against the process noise that six states assume instead of the scale."""
    ways = (Way("cpf"), Way("adf"))
    found = {f"{size:g} m/√s": [rows[drifting(sweeps, size), way] for way in ways] for size in runs.DRIFTS}
    table = _sweep("assumed drift", ("cpf, 6 states", "adf, 6 states"), found, with_nees=True)
    return _made(table, "drift", rows, ("paper", Way("cpf")))


def _sweep(
    title: str, heads: Sequence[str], found: Mapping[str, Sequence[ComparisonRow]], with_nees: bool = False
) -> Table:
    """Return a line for each value that was tried."""
    body = []
    for label, of_value in found.items():
        cells = [errors(row) + (f", NEES {_mean(row, 'nees_mean', 2)}" if with_nees else "") for row in of_value]
        body.append((label, *cells, _alike(len(row.seeds) for row in of_value)))
    return Table(title, (*heads, "seeds"), tuple(body))


def lake(rows: Rows) -> str:
    """Return the simulated lake beside what the paper found on the real one."""
    calibrated = (Way("adf", "scale,misalignment"), Way("adf", "scale,heading"))
    cells = [("lake", way) for way in (*runs.UNFILTERED, *runs.ON_LAKE, *calibrated)]
    return plain("lake (simulated)", cells, rows, "lake", {"paper's lake": PUBLISHED_LAKE})


def unseen(rows: Rows) -> str:
    """Return the dive on which no default was chosen."""
    cells = [cell for cell in rows if cell[0] == runs.UNSEEN]
    if not cells:
        return "*Not run yet: `make paper` runs it.*"
    order = [*runs.UNFILTERED, *runs.ON_UNSEEN]
    cells.sort(key=lambda cell: (cell[1].calibrate != "none", order.index(replace(cell[1], calibrate="none"))))
    return plain("unseen", cells, rows, "unseen")


def features(rows: Rows) -> str:
    """Return the effect of each change: differences over the same dives."""
    gated, scale, both = runs.GATED, "scale", "scale,misalignment"
    pairs: tuple[tuple[str, str, Way, Way], ...] = (
        ("a gate instead of one Gaussian", "paper", Way("ekf"), gated),
        ("the mixture likelihood instead of one Gaussian", "paper", Way("ekf"), Way("adf")),
        ("the mixture likelihood instead of a gate", "paper", gated, Way("adf")),
        ("cubature points instead of a Jacobian", "paper", Way("ekf"), Way("ckf")),
        ("unscented points instead of cubature points", "paper", Way("cpf"), Way("upf")),
        ("100 particles over noise modes instead of one Gaussian", "paper", Way("adf"), Way("cpf")),
        ("1000 particles instead of 100", "paper", Way("cpf"), Way("cpf", particles=1000)),
        ("a fading factor", "paper", Way("ukf"), Way("afukf")),
        ("an adapted predicted covariance", "paper", Way("ekf"), Way("aekf")),
        ("the DVL's scale as a state", "paper", Way("adf"), Way("adf", scale)),
        ("the DVL's misalignment as a state, which is zero here", "paper", Way("adf", scale), Way("adf", both)),
        ("the smoother", "paper", Way("adf", scale), Way("adf", scale, smooth=True)),
        ("the latency of the stamps as a state", "latency", Way("adf", scale), Way("adf", "scale,latency")),
        ("scale and misalignment as states", "lake", Way("adf"), Way("adf", both)),
        ("scale and heading bias as states", "lake", Way("adf"), Way("adf", "scale,heading")),
    )
    body = []
    for what, log, before, after in pairs:
        mine, other = rows[log, after], rows[log, before]
        change = difference(mine, other)
        if change is None or change.se is None:
            body.append((what, log, _titled(before), _titled(after), "failed", "", ""))
            continue
        percent = 100 * change.mean / (other.mean("mean_horizontal_m") or 1.0)
        sign = "*" if change.significant else ""
        size = f"{change.mean:+.3f} ± {change.se:.3f}{sign}"
        seeds = str(min(len(mine.seeds), len(other.seeds)))
        body.append((what, log, _titled(before), _titled(after), size, f"{percent:+.0f} %{sign}", seeds))
    heads = ("scenario", "from", "to", "horizontal error, m", "", "seeds")
    return _made(Table("change", heads, tuple(body)), "features", rows, ("paper", Way("adf", "scale")))


def plain(
    title: str, cells: Sequence[Cell], rows: Rows, function: str, published: dict[str, dict[str, str]] | None = None
) -> str:
    """Return a table with a line for each cell."""
    body = []
    for log, way in cells:
        row = rows[log, way]
        beside = [values.get(way.method, "") if not way.smooth else "" for values in (published or {}).values()]
        horizontal = _with_se(*_average(row, "mean_horizontal_m")) if row.good else ""
        body.append((_titled(way), errors(row), horizontal, nees_text(row), str(len(row.seeds)), *beside))
    heads = ("|east|/|north|, m", "horizontal, m", "NEES", "seeds", *(published or {}))
    return _made(Table(title, heads, tuple(body)), function, rows, cells[-1])


def command(log: str, way: Way, seeds: int) -> str:
    """Return what makes a row again on the command line."""
    name = f"benchmarks/paper/{Path(log).name}" if log.endswith(".toml") else log
    parts = [f"usbldr compare {name} --filters {way.method} --seeds {seeds}"]
    parts += [f"--calibrate {way.calibrate}"] if way.calibrate != "none" else []
    parts += [way.label.removeprefix(way.method).strip()] if way.label != way.method else []
    return " ".join(parts)


def errors(row: ComparisonRow) -> str:
    """Return mean |east| and |north| with their standard errors; medians where the mean means nothing."""
    if not row.good:
        return f"failed: {row.fault}"
    if row.method in FAT_TAILED or _lost(row):
        median = "/".join(in_metres(average(list(row.values(axis).values())).median) for axis in AXES)
        mean = "/".join(in_metres(row.mean(axis) or 0.0) for axis in AXES)
        return f"median {median}" + (f" (mean {mean}, {100 * _lost(row):.0f} % lost)" if _lost(row) else "")
    return " / ".join(_with_se(*_average(row, axis)) for axis in AXES)


def over(row: ComparisonRow, metric: str, bound: float) -> tuple[float, float | None]:
    """Return an error in multiples of a bound, with its standard error."""
    mean, se = _average(row, metric)
    return mean / bound, None if se is None else se / bound


def times(row: ComparisonRow, other: ComparisonRow) -> float:
    """Return how many times as large a row's horizontal error is over the seeds that both have."""
    mine, theirs = row.values("mean_horizontal_m"), other.values("mean_horizontal_m")
    both = mine.keys() & theirs.keys()
    return sum(mine[seed] for seed in both) / sum(theirs[seed] for seed in both)


def nees_text(row: ComparisonRow) -> str:
    """Return the mean NEES and whether it is what it should be."""
    reported = row_consistency(row)
    return f"{_mean(row, 'nees_mean', 2)}, {reported}" if reported else ""


def _lost(row: ComparisonRow) -> float:
    return row_metrics(row).get("diverged_share") or 0.0


def _made(table: Table, function: str, rows: Rows, example: Cell) -> str:
    """Return the table and a line that says what made it."""
    again = command(*example, len(rows[example].seeds))
    text = f"*Made by `{function}` of `benchmarks/paper/tables.py`. To repeat a row: `{again}`.*"
    return f"{markdown_table(table)}\n\n{text}"


def _titled(way: Way) -> str:
    """Return the filter with what it calibrates."""
    return way.label if way.calibrate == "none" else f"{way.label} --calibrate {way.calibrate}"


def _average(row: ComparisonRow, metric: str) -> tuple[float, float | None]:
    found = average(list(row.values(metric).values()))
    return found.mean, found.se


def _mean(row: ComparisonRow, metric: str, digits: int) -> str:
    value = row.mean(metric)
    if value is None:
        return ""
    return f"{value:.{digits}f}" if value < 1000 else f"{value:.0e}"


def _with_se(mean: float, se: float | None) -> str:
    return in_metres(mean) if se is None else f"{in_metres(mean)} ± {in_metres(se)}"


def in_metres(value: float) -> str:
    """Return millimetres below 10 m, where they may mean something."""
    return f"{value:.3f}" if value < 10 else f"{value:.1f}" if value < 1000 else f"{value:.1e}"


def _alike(values: Iterable[object]) -> str:
    """Return the value that all share, or every one."""
    texts = [str(value) for value in values]
    return texts[0] if len({*texts}) == 1 else "; ".join(texts)
