"""The text of a run's report as titles, rows and sentences, which the terminal and report.md format.

Every number is in report.json under its own name; "" if it does not apply.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

from usbldr.filters.errors import printable
from usbldr.filters.evaluation.error_report import ErrorReport, Window
from usbldr.filters.evaluation.influence import most_influential
from usbldr.filters.replay.methods import METHODS
from usbldr.filters.windows import TimeWindow, windows_text
from usbldr.io.geodesy import OriginKind
from usbldr.io.reports.run import Run

ORDERS = {"validity": "used at their time of validity", "arrival": "used when they arrived"}

TRUTHS = {"gps": "GPS", "slam": "SLAM, not GPS", "simulated": "simulated", "other": "other than GPS"}


class TextTable(NamedTuple):
    """A title, column heads and rows of text; the first column labels its row."""

    title: str
    heads: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    numbers: bool = True  # beside the labels: to the right; False: words


def order_text(run: Run) -> str:
    """Return when fixes were used, and if numbers of the run know later ones."""
    if run.method not in METHODS:
        return "not used: this track was computed elsewhere"
    text = ORDERS[run.order]
    if run.order == "arrival" and (run.identification.evidence or run.identification.noise_changes):
        return f"{text}; noise and sensor errors were identified from the whole log, later fixes included"
    return text


GPS_ORIGINS = (OriginKind.FIRST_GPS, OriginKind.FIRST_TRUTH)  # which may be the truth: the report says so


def context(run: Run) -> list[tuple[str, str]]:
    """Return what every number depends on: log, truth and its coverage, order of fixes, alignment."""
    length_s = float(run.timeline.time_s[-1])
    lines = [("log", f"{printable(run.log.path.name)} ({run.log.format}), {length_s:.0f} s")]
    if run.configuration is not None and run.log.configuration is not None:
        lines.append(("settings", run.log.configuration.name))
    windows = run.identification.parameters.aid
    aid = [("aid", aid_text(windows))] if windows else []
    if run.log.origin is not None and run.log.origin.kind in GPS_ORIGINS and not run.log.map_unknown:
        lines.append(("origin", f"{run.log.origin.kind}, as none is stated under [map]"))
    report = run.scored.report
    if report is None:
        return [*lines, ("truth", "none"), *aid, ("fixes", order_text(run))]
    m = report.matching
    share = f"{m.matched} of {m.candidates} epochs ({100 * m.matched / m.candidates:.0f} % of the run)"
    lines.append(("truth", f"{TRUTHS.get(report.truth_kind, report.truth_kind)}: {report.truth_source}"))
    lines.append(("compared", f"{share} against {m.truth_rows} truth samples{_left_out(report)}"))
    if report.window != Window():
        lines.append(("window", window_text(report.window)))
    lines += aid
    lines.append(("fixes", order_text(run)))
    lines.append(("alignment", report.alignment.sentence))
    if report.place_unknown:
        lines.append(("map origin", UNKNOWN_PLACE))
    return lines


UNKNOWN_PLACE = (
    "not stated, so that the place of the truth on the map of the fixes is unknown: one constant shift says nothing "
    "about a track; state origin_lat_deg and origin_lon_deg under [map]"
)


def _left_out(report: ErrorReport) -> str:
    m = report.matching
    counts = {
        "before or after the truth": m.outside_truth,
        "outside the window": m.outside_window,
        "in gaps of the truth": m.in_gap,
        "in GPS-aided windows": m.aided,
        "without a position": m.undefined,
    }
    text = ", ".join(f"{count} {why}" for why, count in counts.items() if count)
    return f"; left out: {text}" if text else ""


def window_text(window: Window) -> str:
    """Describe the window that is scored."""
    start = "the start" if math.isinf(window.start_s) else f"{window.start_s:g} s"
    end = "the end" if math.isinf(window.end_s) else f"{window.end_s:g} s"
    return f"scored from {start} to {end} of the log"


def aid_text(windows: Sequence[TimeWindow]) -> str:
    """Describe the windows in which GPS aided the filter."""
    return f"GPS fixes used as measurements from {windows_text(windows)} of the log, which are not scored"


def error_table(report: ErrorReport) -> TextTable:
    """Return the error of east, north and their length, evo's statistics first."""
    heads = ("rmse", "mean", "median", "std", "min", "max", "p95", "bias", "final")
    h = report.horizontal
    rows: list[tuple[str, ...]] = []
    for name, e in (("|east|", report.east), ("|north|", report.north)):
        numbers = (e.rmse_m, e.mean_abs_m, e.median_abs_m, e.std_abs_m, e.min_abs_m, e.max_abs_m, e.p95_abs_m, e.bias_m)
        rows.append((name, *metres(*numbers), ""))
    numbers = (h.rmse_m, h.mean_m, h.median_m, h.std_m, h.min_m, h.max_m, h.p95_m)
    rows.append(("horizontal", *metres(*numbers), "", *metres(h.final_m)))
    return TextTable("error in m", heads, tuple(rows))


BOUND_NAMES = {False: "bound", True: "smoother bound"}  # by whether the track is smoothed


def method_table(run: Run) -> TextTable:
    """Return the method beside raw fixes and dead reckoning, and the bound of any filter and any smoother."""
    heads = ("|east|", "|north|", "horizontal", "rmse", "CEP50", "CEP95", "max", "epochs", "coverage")
    apart = run.scored.report is not None and run.scored.report.mostly_shift
    if apart:
        heads = (*heads, "shift", "without")
    rows: list[tuple[str, ...]] = []
    for scored in (run.scored, *run.reference_tracks):
        report = scored.report
        if report is None or any(row[0] == report.label for row in rows):
            continue
        h = report.horizontal
        axes_m = (report.east.mean_abs_m, report.north.mean_abs_m)
        numbers = metres(*axes_m, h.mean_m, h.rmse_m, h.median_m, h.p95_m, h.max_m)
        share = f"{100 * report.coverage.share:.0f} %"
        shift = metres(report.shift.length_m, report.shift.mean_m) if apart else ()
        rows.append((report.label, *numbers, f"{report.coverage.matched}", share, *shift))
    if run.bound is not None:
        for smooth, name in BOUND_NAMES.items():
            east, north, rmse = metres(*run.bound.metrics(smooth).values())
            rows.append((name, east, north, "", rmse, *[""] * (len(heads) - 4)))
    return TextTable("mean error in m", heads, tuple(rows))


RELATIVE = (
    "Change of the error over segments of the way, in percent of the distance travelled: it does not depend on a "
    "constant shift."
)


def relative_table(report: ErrorReport) -> TextTable:
    """Return the relative errors by the length of the segments."""
    heads = ("mean [%]", "rms [%]", "p95 [%]", "segments")
    rows: list[tuple[str, ...]] = []
    for one in report.relative:
        percent = (f"{value:.2f}" for value in (one.mean_percent, one.rms_percent, one.p95_percent))
        rows.append((f"{one.length_m:g} m", *percent, f"{one.segments}"))
    return TextTable("drift over", heads, tuple(rows))


INFLUENCE = (
    "The shift is how far the fix moved the track at its time, and in which direction; later fixes reduce the effect."
)
COMPASS_POINTS = ("N", "NE", "E", "SE", "S", "SW", "W", "NW")


def influence_table(run: Run) -> TextTable:
    """Return the fixes that moved the track most, with their innovations and outcomes."""
    heads = ("time [s]", "shift [m]", "direction", "innovation [m]", "outcome")
    rows = [
        (
            f"{fix.row}",
            f"{fix.time_s:.1f}",
            f"{fix.shift_m:.2f}",
            COMPASS_POINTS[round(math.atan2(fix.shift_east_m, fix.shift_north_m) / (math.pi / 4)) % 8],
            f"{math.hypot(fix.innovation_east_m, fix.innovation_north_m):.2f}",
            fix.outcome,
        )
        for fix in most_influential(run.scored.trajectory)
    ]
    return TextTable("fix", heads, tuple(rows))


LEAVE_ONE_OUT_NOTE = (
    "The dive is filtered again without one of the fixes that moved the track most; noise and calibration states stay "
    "those identified from the whole log. The shift is the distance between the two tracks. The change is the mean "
    "error without the fix minus that with it: negative if the track is better without the fix."
)


def leave_one_out_table(run: Run) -> TextTable:
    """Return the effect of leaving out each of some fixes, the largest first."""
    heads = ("time [s]", "largest shift [m]", "at [s]", "mean shift [m]", "change of mean error [m]")
    rows = [
        (
            f"{one.fix.row}",
            f"{one.fix.time_s:.1f}",
            f"{one.largest_shift_m:.2f}",
            f"{one.largest_at_s:.1f}",
            f"{one.mean_shift_m:.3f}",
            "" if math.isnan(one.error_change_m) else f"{one.error_change_m:+.3f}",
        )
        for one in sorted(run.without_fixes, key=lambda one: -one.largest_shift_m)
    ]
    return TextTable("without fix", heads, tuple(rows))


def metres(*values_m: float) -> tuple[str, ...]:
    """Return metres to the millimetre."""
    return tuple(f"{value:z.3f}" for value in values_m)
