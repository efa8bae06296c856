"""What a reader is told of a run, as titles, rows and sentences: the terminal and report.md only set it.

Every number stands in report.json under its own name; "" where it does not apply.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

from usbldr.filters.evaluation.consistency import EXPECTED_COVERAGE, FixUpdates, SensorUpdates, consistency_text
from usbldr.filters.evaluation.error_report import ErrorReport, Window
from usbldr.filters.evaluation.influence import most_influential
from usbldr.filters.evaluation.metrics import SURFACING_GAP_S
from usbldr.filters.models.calibration import EstimatedError, estimated_errors
from usbldr.filters.models.parameters import StateObservability
from usbldr.filters.types import OutageRecovery
from usbldr.filters.windows import TimeWindow, windows_text
from usbldr.io.reports.report_json import Run
from usbldr.io.reports.tuned_config import tuned_text

ORDERS = {"validity": "used at their time of validity", "arrival": "used when they arrived"}

TRUTHS = {
    "gps": "GPS",
    "slam": "SLAM, not GPS",
    "simulated": "simulated",
    "other": "other than GPS",
}


class Table(NamedTuple):
    """A title, column heads and rows of text; the first column labels its row."""

    title: str
    heads: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


def context(run: Run) -> list[tuple[str, str]]:
    """Return what has to stand beside every number: log, truth and its share, order of fixes, alignment."""
    length_s = float(run.timeline.time_s[-1])
    lines = [("log", f"{run.log.path.name} ({run.log.format}), {length_s:.0f} s")]
    if run.configuration is not None and run.log.configuration is not None:
        lines.append(("settings", run.log.configuration.name))
    windows = run.log.assumptions.aid
    aid = [("aid", aid_text(windows))] if windows else []
    report = run.scored.report
    if report is None:
        return [*lines, ("truth", "none"), *aid, ("fixes", ORDERS[run.order])]
    m = report.matching
    share = f"{m.matched} of {m.candidates} epochs ({100 * m.matched / m.candidates:.0f} % of the run)"
    lines.append(("truth", f"{TRUTHS.get(report.truth_kind, report.truth_kind)}: {report.truth_source}"))
    lines.append(("compared", f"{share}, resting on {m.truth_rows} truth samples{_left_out(report)}"))
    if report.window != Window():
        lines.append(("window", window_text(report.window)))
    lines += aid
    lines.append(("fixes", ORDERS[run.order]))
    lines.append(("alignment", report.alignment.sentence))
    return lines


def _left_out(report: ErrorReport) -> str:
    m = report.matching
    reasons = {
        "before or after the truth": m.outside_truth,
        "outside the window": m.outside_window,
        "in gaps of the truth": m.in_gap,
        "where GPS aids": m.aided,
        "without a position": m.undefined,
    }
    said = ", ".join(f"{count} {why}" for why, count in reasons.items() if count)
    return f"; left out: {said}" if said else ""


def window_text(window: Window) -> str:
    """Say which truth rows were chosen."""
    start = "the start" if math.isinf(window.start_s) else f"{window.start_s:g} s"
    end = "the end" if math.isinf(window.end_s) else f"{window.end_s:g} s"
    return f"truth rows from {start} to {end} of the log"


def aid_text(windows: Sequence[TimeWindow]) -> str:
    """Say where GPS aided the filters."""
    return f"GPS fixes used as measurements from {windows_text(windows)} of the log, where nothing is scored"


def error_table(report: ErrorReport) -> Table:
    """Return the error of east, north and their length, evo's statistics first."""
    heads = ("rmse", "mean", "median", "std", "min", "max", "p95", "bias", "final")
    h = report.horizontal
    rows: list[tuple[str, ...]] = []
    for name, e in (("|east|", report.east), ("|north|", report.north)):
        numbers = (e.rmse_m, e.mean_abs_m, e.median_abs_m, e.std_abs_m, e.min_abs_m, e.max_abs_m, e.p95_abs_m, e.bias_m)
        rows.append((name, *metres(*numbers), ""))
    numbers = (h.rmse_m, h.mean_m, h.median_m, h.std_m, h.min_m, h.max_m, h.p95_m)
    rows.append(("horizontal", *metres(*numbers), "", *metres(h.final_m)))
    return Table("error in m", heads, tuple(rows))


def method_table(run: Run) -> Table:
    """Return the method beside raw fixes and dead reckoning, and the bound of any filter and any smoother."""
    heads = ("|east|", "|north|", "horizontal", "rmse", "CEP50", "CEP95", "max", "epochs", "covered")
    rows: list[tuple[str, ...]] = []
    for scored in (run.scored, *run.reference_tracks):
        report = scored.report
        if report is None or any(row[0] == report.label for row in rows):
            continue
        h = report.horizontal
        axes_m = (report.east.mean_abs_m, report.north.mean_abs_m)
        numbers = metres(*axes_m, h.mean_m, h.rmse_m, h.median_m, h.p95_m, h.max_m)
        share = f"{100 * report.coverage.share:.0f} %"
        rows.append((report.label, *numbers, f"{report.coverage.matched}", share))
    if run.bound is not None:
        for name, errors_m in (("bound", run.bound.filter_m), ("smoother bound", run.bound.smoother_m)):
            rows.append((name, *metres(*errors_m), *[""] * (len(heads) - 2)))
    return Table("mean error in m", heads, tuple(rows))


INFLUENCE = (
    "Without that fix the track would have lain so far elsewhere at that moment; later fixes wear it off. A shift to "
    "the north-east says that the fix drew the track there."
)
COMPASS_POINTS = ("N", "NE", "E", "SE", "S", "SW", "W", "NW")


def influence_table(run: Run) -> Table:
    """Return the fixes that moved the track most, what they said, and what the filter made of them."""
    heads = ("time [s]", "moved the track by [m]", "to", "lay off by [m]", "was")
    rows = [
        (
            f"{fix.row}",
            f"{fix.time_s:.1f}",
            f"{fix.shift_m:.2f}",
            _towards(fix.shift_east_m, fix.shift_north_m),
            f"{math.hypot(fix.innovation_east_m, fix.innovation_north_m):.2f}",
            fix.outcome,
        )
        for fix in most_influential(run.scored.trajectory)
    ]
    return Table("fix", heads, tuple(rows))


LEAVE_ONE_OUT_NOTE = (
    "The whole dive filtered again, each time without one of the fixes that moved the track most when they came; noise "
    "and calibrated errors stay those that the whole log told. The shift is how far the two tracks lie apart; the "
    "error's change is without minus with: below 0 the track is better without the fix."
)


def leave_one_out_table(run: Run) -> Table:
    """Return what the track would have been without each of some fixes, the largest effect first."""
    heads = ("time [s]", "largest shift [m]", "at [s]", "mean shift [m]", "mean error changes by [m]")
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
    return Table("without fix", heads, tuple(rows))


def _towards(east_m: float, north_m: float) -> str:
    """Return the compass point of a shift."""
    return COMPASS_POINTS[round(math.atan2(east_m, north_m) / (math.pi / 4)) % 8]


def health_lines(run: Run) -> list[tuple[str, str]]:
    """Return sentences on consistency, sensors, particles, surfacings, drift, outages and speed."""
    report = run.scored.report
    lines: list[tuple[str, str]] = []
    if report is not None:
        if (nees := report.nees) is not None:
            lines.append(
                (
                    "NEES",
                    f"{nees.mean:.2f}: {consistency_text(nees)} (2 is right, {nees.low:.2f} to "
                    f"{nees.high:.2f} in 95 of 100 runs)",
                )
            )
        if report.sigma_shares is not None:
            inside = ", ".join(f"{100 * share:.0f}" for share in report.sigma_shares)
            right = ", ".join(f"{100 * share:.0f}" for share in EXPECTED_COVERAGE)
            lines.append(("sigmas", f"{inside} % of the errors inside 1, 2, 3 sigma ({right} are right)"))
        for sensor, updates in report.sensors.items():
            lines.append((sensor, _sensor(updates, report.fixes if sensor == "usbl" else None)))
        ess, accepted = report.health
        if ess is not None:
            moved = "" if accepted is None else f", {100 * accepted:.0f} % of the moves accepted"
            lines.append(("ESS", f"{100 * ess:.0f} % of {run.scored.trajectory.particles} particles{moved}"))
        if calibrated := estimated_errors(run.scored.trajectory):
            lines.append(("calibrated", ", ".join(_error_found(error) for error in calibrated)))
        if observed := run.log.assumptions.observed:
            lines.append(("observed", _observed(observed)))
        if settled := run.log.assumptions.noise_changes:
            lines.append(("by the log", ", ".join(f"{n.name} {n.after:.3g} (was {n.before:.3g})" for n in settled)))
        if report.surfacing is not None:
            mean_m, percent = report.surfacing
            way = "" if percent is None else f", {percent:.2f} % of the way"
            many = f" (mean of {len(report.surfacings)})" if len(report.surfacings) > 1 else ""
            when = f"at the first truth after a gap over {SURFACING_GAP_S:.0f} s{many}"
            lines.append(("surfacing", f"{mean_m:.2f} m {when}{way}"))
        if (speed := report.speed) is not None:
            lines.append(("speed", f"{speed.filter_time_s:.2f} s, {speed.real_time_factor:.0f} times real time"))
    if tuned := run.log.assumptions.tuned:
        lines.append(("tuned", "; ".join(tuned_text(number) for number in tuned)))
    for scored in (run.scored, *run.reference_tracks):
        judged = scored.report
        if judged is not None and judged.travel is not None and judged.travel.drift_percent is not None:
            text = f"{judged.travel.drift_percent:.2f} % of {judged.travel.distance_m:.0f} m travelled"
            lines.append((f"{judged.label} drift", f"{judged.horizontal.final_m:.2f} m at the end, {text}"))
            break
    if run.timeline.outages:
        lines.append(("outages", _outages(run)))
    if returns := run.scored.trajectory.recoveries:
        lines.append(("usbl back", _returns(returns)))
    return lines


def _sensor(updates: SensorUpdates, fixes: FixUpdates | None) -> str:
    """Say what became of a sensor's updates; of the USBL, what became of its fixes."""
    what, of = ("updates", updates) if fixes is None else ("fixes", fixes)
    counts = {"down-weighted": of.down_weighted, "rejected": of.rejected}
    told = "".join(f", {count} {fate}" for fate, count in counts.items() if count)
    nis = "" if updates.nis_mean is None else f"NIS {updates.nis_mean:.2f} ({updates.nis_expected:.0f} is right); "
    gap = "" if fixes is None else f"; at most {fixes.longest_gap_s:.1f} s without one"
    return f"{nis}{what}: {of.used} used{told}{gap}"


def _error_found(error: EstimatedError) -> str:
    """Tell a sensor's error as it stood at the end."""
    unit = f" {error.unit}" if error.unit else ""
    return f"{error.title} {error.value[-1]:.4f} ± {error.sd[-1]:.4f}{unit}"


def _observed(observed: Sequence[StateObservability]) -> str:
    """Say which errors of sensors the log can tell, and how far it narrows the sigma of each."""
    verdicts: dict[str, list[str]] = {}
    for told in observed:
        verdicts.setdefault(told.conclusion, []).append(f"{told.key} (sigma to {100 * told.sigma_ratio:.0f} %)")
    return "; ".join(f"{verdict}: {', '.join(keys)}" for verdict, keys in verdicts.items())


def _outages(run: Run) -> str:
    """Count the outages of each sensor and name its longest."""
    said: list[str] = []
    for sensor in sorted({outage.sensor for outage in run.timeline.outages}):
        mine = [outage for outage in run.timeline.outages if outage.sensor == sensor]
        longest = max(mine, key=lambda outage: outage.end_s - outage.start_s)
        span = f"{longest.end_s - longest.start_s:.1f} s at {longest.start_s:.0f} s"
        said.append(f"{sensor} {len(mine)}, the longest {span}" if len(mine) > 1 else f"{sensor} {span}")
    return "; ".join(said)


def _returns(returns: Sequence[OutageRecovery]) -> str:
    """Tell of the return of the USBL that lay farthest from the track."""
    one = max(returns, key=lambda one: one.sigmas)
    said = (
        f"after {one.end_s - one.start_s:.1f} s at {one.end_s:.0f} s the fixes lay {one.residual_m:.2f} m from the "
        f"track, {one.sigmas:.1f} sigma, and moved it {one.correction_m:.2f} m; its sigma had grown from "
        f"{one.sd_start_m:.2f} to {one.sd_end_m:.2f} m"
    )
    return said if len(returns) == 1 else f"{len(returns)} times; at worst {said}"


def metres(*values_m: float) -> tuple[str, ...]:
    """Return metres to the millimetre."""
    return tuple(f"{value:z.3f}" for value in values_m)
