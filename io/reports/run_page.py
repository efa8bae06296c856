"""The page of a run: verdict, errors, figures, health, calibration, influential fixes, conventions, findings."""

import shlex
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from usbldr.filters.evaluation.consistency import consistency_text
from usbldr.filters.evaluation.error_report import ErrorReport
from usbldr.filters.evaluation.influence import influences
from usbldr.filters.models.calibration import assumed_sd, estimated_errors
from usbldr.filters.replay.methods import METHODS
from usbldr.io.provenance import convention_text
from usbldr.io.reader import utc
from usbldr.io.reports.estimate_text import in_unit, with_sigma
from usbldr.io.reports.health_text import fix_text, health_lines
from usbldr.io.reports.page import Code, Labelled, Page, PageSection, Picture, Plot, bullets, labelled, markdown
from usbldr.io.reports.report_text import (
    INFLUENCE,
    LEAVE_ONE_OUT_NOTE,
    RELATIVE,
    TextTable,
    context,
    error_table,
    influence_table,
    leave_one_out_table,
    method_table,
    order_text,
    relative_table,
)
from usbldr.io.reports.run import Run
from usbldr.io.reports.run_provenance import RunProvenance, checkout_commit, machine, made_by


def write_markdown(folder: Path, run: Run, pictures: Sequence[tuple[str, str]]) -> None:
    """Write report.md, which links to the figures beside it: file names and captions."""
    page = run_page(run, tuple(Picture(*picture) for picture in pictures))
    (folder / "report.md").write_text(markdown(page), encoding="utf-8")


def run_page(run: Run, figures: Sequence[Picture | Plot]) -> Page:
    """Return the page of a run with its figures."""
    report = run.scored.report
    errors = () if report is None else (error_table(report), method_table(run))
    relative = () if report is None or not report.relative else (RELATIVE, relative_table(report))
    fixes, left_out = influence_table(run), run.without_fixes
    usbl = [("USBL fixes", text)] if (text := fix_text(run)) else []
    findings = tuple((finding.code, finding.text) for finding in run.log.findings)
    sections = (
        PageSection("", (Labelled((*summary_lines(run), *context(run))),)),
        PageSection("Warnings", bullets(run.warnings)),
        PageSection("Errors", errors),
        PageSection("Figures", tuple(figures)),
        PageSection("Health", labelled([*health_lines(run), *usbl])),
        PageSection("Relative errors", relative),
        PageSection("Sensor errors", (CALIBRATION, table) if (table := calibration_table(run)).rows else ()),
        PageSection("Influential fixes", (INFLUENCE, fixes) if fixes.rows else ()),
        PageSection("Fixes left out", (LEAVE_ONE_OUT_NOTE, leave_one_out_table(run)) if left_out else ()),
        PageSection("How the log was read", (_sensors(run), Labelled(_origin(run)))),
        PageSection("Findings", labelled(findings)),
        provenance_section(run.made),
        PageSection("How to read this", bullets(_definitions(run))),
    )
    return Page(f"{run.label} on {run.log.path.name}", run.verdict, sections)


def summary_lines(run: Run) -> list[tuple[str, str]]:
    """Return whether the sigmas are honest and where the track is worst, in words."""
    report = run.scored.report
    if report is None:
        return []
    honest = consistency_text(report.nees, report.alignment.name == "shift") or "the track has no covariance"
    return [("consistency", honest), ("largest error", _largest(run, report))]


def _largest(run: Run, report: ErrorReport) -> str:
    """Return the largest error and what happened there: an outage, or the fix that moved the track most."""
    worst = int(np.argmax(report.horizontal_m))
    at_s = float(report.time_s[worst])
    text = f"{report.horizontal_m[worst]:.2f} m at {at_s:.0f} s"
    outages = [one for one in run.timeline.outages if one.start_s <= at_s <= one.end_s]
    if outages:
        return text + ", ".join(f", {at_s - one.start_s:.0f} s into an outage of {one.sensor}" for one in outages)
    used_s = [fix.time_s for fix in influences(run.scored.trajectory).values() if fix.outcome != "rejected"]
    last_s = max((time_s for time_s in used_s if time_s <= at_s), default=None)
    return text if last_s is None else f"{text}, {at_s - last_s:.0f} s after the last fix that was used"


CALIBRATION = (
    "What the filter estimated beside the track, at the end of the run, and the log odds of such an error by the log "
    "(3: 20 to 1)."
)


def calibration_table(run: Run) -> TextTable:
    """Return the estimated sensor errors with their sigmas, the sigma that was assumed before, and the evidence."""
    assumed = assumed_sd(run.identification.parameters.errors)
    odds = {found.name: one.log_odds for one in run.identification.evidence for found in one.estimates}
    rows: list[tuple[str, ...]] = []
    for error in estimated_errors(run.scored.trajectory, run.identification.undecided):
        factor, unit = in_unit(error.unit)
        found = with_sigma(factor * float(error.value[-1]), factor * float(error.sd[-1]))
        evidence = f"{odds[error.name]:+.1f}" if error.name in odds else ""
        rows.append((error.title, found, f"{factor * assumed[error.name]:.3g}", unit, evidence))
    return TextTable("sensor error", ("estimate", "sigma before", "unit", "evidence"), tuple(rows))


def provenance_section(made: RunProvenance) -> PageSection:
    """Return the command that repeats a report, what it read, and versions; of a checkout, also its commit."""
    used = machine()
    libraries = ", ".join(f"{name} {number}" for name, number in used["libraries"].items())
    place = f"{used['platform']['system']} {used['platform']['machine']}, kernel {used['kernel']}"
    commit = f" (commit {checkout_commit()})" if checkout_commit() else ""
    versions = f"usbldr {made_by()['tool']['version']}{commit}, Python {used['python']}, {libraries}; {place}"
    files = tuple((one.role, one.file, one.sha256) for one in made.inputs)
    table = (TextTable("input", ("file", "sha256"), files, numbers=False),) if files else ()
    command = (Code(shlex.join(made.command)),) if made.command else ()
    return PageSection("How this was made", (*command, *table, Labelled((("versions", versions),))))


def _sensors(run: Run) -> TextTable:
    rows: list[tuple[str, ...]] = []
    for role, p in run.log.provenance.items():
        conventions = "; ".join(map(convention_text, p.conventions))
        rows.append((role, p.topic, p.type, f"{p.used} of {p.messages}", p.chosen_by, conventions))
    return TextTable(
        "sensor", ("topic", "type", "records used", "chosen by", "conventions"), tuple(rows), numbers=False
    )


def _origin(run: Run) -> tuple[tuple[str, str], ...]:
    origin = run.log.origin
    place = "unknown, so there are no latitudes and longitudes"
    if origin is not None:
        place = f"{origin.lat_deg:.9f} N, {origin.lon_deg:.9f} E ({origin.kind})"
    return ("start", utc(run.log.start_ns)), ("origin", place), ("sha256", run.log.sha256)


def _definitions(run: Run) -> list[str]:
    lines = [
        "Errors are estimate minus truth; truth is interpolated linearly to the times of the track, but not across "
        "its long gaps.",
        "Mean, median, std, min, max and p95 of east and north are of the absolute error; bias is the mean signed "
        "error. CEP50 and CEP95 are the median and the 95th percentile of the horizontal error.",
        "NEES is the squared error normalised by the filter's covariance (plus that of the truth, if known). Its "
        "bounds use the effective number of independent errors, because successive errors are correlated.",
        "`track_*.csv` is the track as the filter estimated it; `errors_*.csv`, `track.tum` and `truth.tum` are what "
        "was scored, after the alignment. Without a truth, `track.tum` is the track as estimated.",
        "Every number here is in `report.json` under its own name.",
    ]
    if run.method not in METHODS:
        lines.append("The track was computed elsewhere; usbldr only judges it.")
    elif run.order == "validity":
        lines.append("Fixes were used at their time of validity, as in post-processing; a vehicle receives them later.")
    else:
        lines.append(f"Fixes were {order_text(run)}.")
    return lines
