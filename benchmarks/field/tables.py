"""The tables of field.md, each made from the rows of the study as Markdown.

Errors are horizontal, in metres, means over the epochs of a log; where there are several dives, means over them.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from field.agreement import Likeness
from field.changes import ABLATIONS, FACTORS, HALF, SENSITIVITY, TWICE
from field.goals import HORIZONTAL, NEES, worst
from field.logs import Case
from field.plan import (
    AUTO,
    BEST,
    FILTERS,
    PAPER_LOGS,
    Rows,
    cut_ways,
    online,
    paper_ways,
    thinned_names,
    thinned_ways,
    titled,
)
from paper.runs import Way
from paper.tables import in_metres, times
from usbldr.filters.identification.linearisation import KEYS, REPORTED
from usbldr.filters.models.calibration import STATES
from usbldr.io.reports.markdown_report import markdown_table
from usbldr.io.reports.report_text import Table
from usbldr_cli.runs.job_store import read_trace
from usbldr_cli.runs.seed_table import ComparisonRow, difference, row_consistency

HEADS = ("calibrate", "mean abs E", "mean abs N", "horizontal", "NEES", "consistency")
LAKE_TRIAL = (
    ("pf", "1.26", "0.96", "", ""),
    ("upf", "1.07", "0.88", "", ""),
    ("cpf", "0.96", "0.75", "", ""),
)  # the paper's section 3.2
NO_CHANGE = "·"  # the log does not use what was changed


def main(case: Case, rows: Rows) -> str:
    """Return every filter on one log, once for each definition of its errors."""
    return "\n\n".join(_filters(case, name, rows) for name in case.scored)


def _filters(case: Case, name: str, rows: Rows) -> str:
    body = [_plain(way.method, "", rows[name, way, ""]) for way in (Way("usbl"), Way("dr"))]
    for calibrate in ("none", AUTO):
        for way in FILTERS:
            way = replace(way, calibrate=calibrate)
            late = rows[name, replace(way, order=online(case)), ""]
            after = () if online(case) == "validity" else (rows[name, way, ""],)
            body.append(_plain(way.label, calibrate, late, *after))
        smoothed = rows[name, Way("adf", calibrate, smooth=True), ""]
        line = _plain("adf --smooth", calibrate, smoothed)
        if online(case) != "validity":  # a smoothed track knows the whole dive
            line = (*line[:2], "", "", "", "", "", *_size(smoothed))
        body.append(line)
    width = max(len(line) for line in body)
    heads = (*HEADS, "horizontal, validity", "NEES, validity")[: width - 1]
    filled = tuple((*line, *[""] * (width - len(line))) for line in body)
    return markdown_table(Table(f"{name}, m", heads, filled))


def _plain(label: str, calibrate: str, row: ComparisonRow, *after: ComparisonRow) -> tuple[str, ...]:
    if not row.good:
        return (label, calibrate, f"failed: {row.fault}", "", "", "", "")
    axes = (metres(row.mean(f"mean_abs_{axis}_m")) for axis in ("east", "north"))
    beside = (cell for one in after for cell in _size(one))
    return (label, calibrate, *axes, *_size(row), row_consistency(row), *beside)


def _size(row: ComparisonRow) -> tuple[str, str]:
    return metres(row.mean(HORIZONTAL)), number(row.mean(NEES))


def paper_filters(cases: Sequence[Case], rows: Rows) -> str:
    """Return the filters of the paper's lake trial on the dives of real vehicles, beside what it published."""
    body: list[tuple[str, ...]] = [("the paper's lake trial", *cells) for cells in LAKE_TRIAL]
    for case in (one for one in cases if one.name in PAPER_LOGS):
        for name in case.scored:
            for way, change in paper_ways(case):
                label, _, *cells = _plain(way.method, AUTO, rows[name, way, change])
                body.append((name, label, *cells[:4]))
    heads = ("filter", *HEADS[1:5])
    return markdown_table(Table("dive, m", heads, tuple(body)))


def claimed(cases: Sequence[Case], rows: Rows) -> str:
    """Return the errors beside those that the filter's own covariance implies."""
    body: list[tuple[str, ...]] = []
    for case in cases:
        for name in case.scored:
            row = rows[name, replace(BEST, order=online(case)), ""]
            inside = "/".join(f"{100 * (row.mean(f'inside_{k}_sigma') or 0):.0f}" for k in (1, 2, 3))
            body.append((name, case.truth, metres(row.mean(HORIZONTAL)), metres(_claim_m(row)), _size(row)[1], inside))
    heads = ("kind", "mean error", "claimed by adf", "NEES", "inside 1/2/3 sigma, %")
    return markdown_table(Table("log", heads, tuple(body)))


def _claim_m(row: ComparisonRow) -> float | None:
    """Return the mean length of an error with the claimed covariance, as if it were round: sqrt(pi/4 trace P)."""
    traces = [read_trace(outcome.trace) for outcome in row.good.values() if outcome.trace is not None]
    covs = [trace.cov_m2 for trace in traces if trace.cov_m2 is not None]
    if not covs:
        return None
    return float(np.mean([np.sqrt(math.pi / 4 * np.trace(cov, axis1=1, axis2=2)).mean() for cov in covs]))


def agreed(found: Mapping[str, Mapping[str, Likeness]]) -> str:
    """Return how the moves of fixes and truth compare with those of dead reckoning, log by log."""
    body = [
        (name, source, *_lead(one), f"{one.ratio:.3f}", f"{one.turn_deg:+.1f}°")
        for name, likenesses in found.items()
        for source, one in likenesses.items()
    ]
    heads = ("against DR", "ahead by", "at median speed", "length ratio", "rotated clockwise")
    return markdown_table(Table("log", heads, tuple(body)))


def _lead(one: Likeness) -> tuple[str, str]:
    if math.isnan(one.lead_s):
        return "not observable", ""
    return f"{one.lead_s:+.2f} s", f"{one.lead_m:+.2f} m"


def states(cases: Sequence[Case], rows: Rows, agreed: Mapping[str, Mapping[str, Likeness]]) -> str:
    """Return the sensor errors that exist in each log, their log odds, and the scale from plain lengths."""
    found = [rows[case.scored[0], replace(BEST, order=online(case)), ""] for case in cases]
    body = [(key, *(_state(key, row) for row in found)) for key in (*KEYS, "usbl-bias")]
    by_length = (f"{1 / agreed[case.name]['fixes'].ratio - 1:.3g}" for case in cases)
    body.append(("(scale from lengths of displacements)", *by_length))
    return markdown_table(Table("error", tuple(case.name for case in cases), tuple(body)))


def _state(key: str, row: ComparisonRow) -> str:
    first = next(iter(row.good.values()), None)
    if first is None:
        return ""
    estimates = [
        f"{first.metrics[f'found_{name}']:.3g} ± {first.metrics[f'found_sd_{name}']:.2g} {unit}".strip()
        for name, unit, *_ in (REPORTED[state] for state in {**KEYS, **STATES}[key])
        if f"found_{name}" in first.metrics
    ]
    odds = first.metrics.get(f"log_odds_{key}")
    return ("; ".join(estimates) or "does not exist") + ("" if odds is None else f" (log odds {odds:+.1f})")


def cut(rows: Rows) -> str:
    """Return every way of bridging two outages of ten minutes."""
    body = (
        _plain(titled(way), way.calibrate if way.method != "dr" else "", rows["stpere_marina", way, "cut"])
        for way in cut_ways()
    )
    return markdown_table(Table("stpere_marina, USBL cut, m", HEADS, tuple(body)))


def thinned(cases: Sequence[Case], rows: Rows) -> str:
    """Return the filters with rare fixes: error, NEES, and the longest run of rejected fixes."""
    body: list[tuple[str, ...]] = []
    for case in cases:
        name = case.scored[-1]
        for change in thinned_names():
            whole = metres(rows[name, Way("dr"), ""].mean(HORIZONTAL))
            cells = [_rare(rows[name, way, change]) for way in thinned_ways(case)]
            body.append((f"{name}, {change}", whole, *cells))
    heads = ("dr", *(titled(way) for way in thinned_ways(cases[0])))
    return markdown_table(Table("m; NEES; rejected in a row", heads, tuple(body)))


def _rare(row: ComparisonRow) -> str:
    if not row.good:
        return f"failed: {row.fault}"
    return "; ".join((*_size(row), f"{worst(row, 'refused_in_a_row'):.0f}"))


def ablation(cases: Sequence[Case], rows: Rows) -> str:
    """Return the increase of the error if a feature is removed."""
    features = (
        ("(none)", lambda way: (way, "")),
        ("mixture noise (Gaussian instead)", lambda way: (replace(way, method="ckf"), "")),
        ("mixture noise (gate instead)", lambda way: (replace(way, method="ckf", gate=0.99), "")),
        ("all states (--calibrate none)", lambda way: (replace(way, calibrate="none"), "")),
        *((name, lambda way, name=name: (way, name)) for name in ABLATIONS),
    )
    body = []
    for label, changed in features:
        cells = []
        for case in cases:
            name, way = case.scored[-1], replace(BEST, order=online(case))
            whole, less = rows[name, way, ""], rows[name, *changed(way)]
            cells.append(metres(whole.mean(HORIZONTAL)) if label == "(none)" else lost(less, whole))
        body.append((label, *cells))
    return markdown_table(Table("feature removed", tuple(case.scored[-1] for case in cases), tuple(body)))


def lost(less: ComparisonRow, whole: ComparisonRow) -> str:
    change = difference(less, whole)
    if change is None or less.fault:
        return f"failed: {less.fault}"
    if all(less.values(HORIZONTAL)[seed] == whole.values(HORIZONTAL).get(seed) for seed in less.values(HORIZONTAL)):
        return NO_CHANGE
    return f"{change.mean:+.3f} m, NEES {number(less.mean(NEES))}"


def sensitivity(cases: Sequence[Case], rows: Rows) -> str:
    """Return by how many per cent the error changes with each default halved and doubled, the largest change first."""
    names = list(dict.fromkeys(name.rsplit(" ", 1)[0] for name in SENSITIVITY))
    found = {name: [[percent(case, f"{name} {label}", rows) for label in FACTORS] for case in cases] for name in names}
    names.sort(key=lambda name: -max(abs(value or 0.0) for pair in found[name] for value in pair))
    body = ((f"`{name}`", *(f"{_signed(half)} / {_signed(twice)}" for half, twice in found[name])) for name in names)
    heads = tuple(f"{case.scored[-1]}, %" for case in cases)
    return markdown_table(Table(f"{HALF} / {TWICE}", heads, tuple(body)))


def largest_changes(cases: Sequence[Case], rows: Rows) -> Iterator[tuple[str, str, float]]:
    """Yield each default that moves a log's error by more than 5 %: its change, the log and the per cent."""
    for change in SENSITIVITY:
        for case in cases:
            moved = percent(case, change, rows)
            if moved is not None and abs(moved) > 5:
                yield change, case.scored[-1], moved


def percent(case: Case, change: str, rows: Rows) -> float | None:
    row = rows[case.scored[-1], BEST, change]
    if row.fault:
        return None
    return 100 * (times(row, rows[case.scored[-1], BEST, ""]) - 1)


def _signed(percent: float | None) -> str:
    if percent is None:
        return "failed"
    return NO_CHANGE if percent == 0 else f"{percent:+.1f}"


def metres(value: float | None) -> str:
    return "" if value is None else in_metres(value)


def number(value: float | None) -> str:
    """Return two decimals, fewer of what is huge."""
    return "" if value is None else f"{value:.2f}" if value < 100 else f"{value:.0f}"
