"""The health of a run as sentences: consistency, sensors, particles, surfacings, drift, outages, and its fixes."""

import math
from collections.abc import Sequence

from usbldr.filters.evaluation.consistency import EXPECTED_COVERAGE, FixUpdates, SensorUpdates, consistency_text
from usbldr.filters.evaluation.metrics import SURFACING_GAP_S
from usbldr.filters.models.calibration import estimated_errors
from usbldr.filters.types import OutageRecovery
from usbldr.io.reports.estimate_text import error_text, evidence_text, fixed_errors_text, noise_changes_text
from usbldr.io.reports.run import Run


def health_lines(run: Run) -> list[tuple[str, str]]:
    """Return sentences on consistency, sensors, particles, surfacings, drift, outages and run time."""
    report = run.scored.report
    lines: list[tuple[str, str]] = []
    if report is not None:
        if (nees := report.nees) is not None:
            text = f"{nees.mean:.2f}: {consistency_text(nees, report.alignment.name == 'shift')}"
            text += f" (expected 2, 95 % bounds {nees.low:.2f} to {nees.high:.2f})"
            if report.mostly_shift and report.shift.nees is not None:
                text += f"; {report.shift.nees:.2f} without the constant shift"
            lines.append(("NEES", text))
        if report.sigma_shares is not None:
            inside = ", ".join(f"{100 * share:.0f}" for share in report.sigma_shares)
            expected = ", ".join(f"{100 * share:.0f}" for share in EXPECTED_COVERAGE)
            lines.append(("sigmas", f"{inside} % of the errors inside 1, 2, 3 sigma (expected {expected} %)"))
        if (heading := report.heading) is not None:
            text = f"error {heading.rmse_deg:.2f} deg RMS, mean {heading.bias_deg:+.2f} deg clockwise"
            lines.append(("heading", f"{text}, at most {heading.max_abs_deg:.1f} deg"))
        if (velocity := report.velocity) is not None:
            starboard, forward = velocity.rmse_starboard_mps, velocity.rmse_forward_mps
            lines.append(("velocity", f"error {forward:.3f} m/s forward, {starboard:.3f} m/s to starboard (RMS)"))
        for sensor, updates in report.sensors.items():
            lines.append((sensor, _sensor(updates, report.fixes if sensor == "usbl" else None)))
        if (white := report.whiteness) is not None:
            text = f"innovations of fixes along the track {white.along_sigmas:z.1f}, across {white.across_sigmas:z.1f}"
            lines.append(("whiteness", f"{text} sigma (white: within 2)"))
        ess, accepted = report.health
        if ess is not None:
            moved = "" if accepted is None else f", {100 * accepted:.0f} % of the MCMC moves accepted"
            lines.append(("ESS", f"{100 * ess:.0f} % of {run.scored.trajectory.particles} particles{moved}"))
        found = run.identification  # a warning has what it leaves undecided
        if calibrated := estimated_errors(run.scored.trajectory, found.undecided):
            lines.append(("calibrated", ", ".join(map(error_text, calibrated))))
        if found.evidence:
            lines.append(("evidence", evidence_text(found.evidence)))
            if fixed := fixed_errors_text(found.decided):
                lines.append(("corrected", fixed))
        if changes := run.identification.noise_changes:
            lines.append(("noise", f"estimated from the whole log: {noise_changes_text(changes)}"))
        if report.surfacing is not None:
            mean_m, percent = report.surfacing
            share = "" if percent is None else f", {percent:.2f} % of the distance travelled"
            many = f" (mean of {len(report.surfacings)})" if len(report.surfacings) > 1 else ""
            when = f"error at the first truth after a gap over {SURFACING_GAP_S:.0f} s"
            lines.append(("surfacing", f"{when}: {mean_m:.2f} m{many}{share}"))
        if math.isfinite(seconds := run.scored.trajectory.seconds):
            length_s = float(run.timeline.time_s[-1] - run.timeline.time_s[0])
            lines.append(("run time", f"{seconds:.2f} s, {length_s / max(seconds, 1e-9):.0f} times real time"))
    for scored in (run.scored, *run.reference_tracks):
        judged = scored.report
        if judged is not None and judged.travel is not None and judged.travel.drift_percent is not None:
            text = f"{judged.travel.drift_percent:.2f} % of the {judged.travel.distance_m:.0f} m travelled"
            lines.append(("DR drift", f"{judged.horizontal.final_m:.2f} m at the end, {text}"))
            break
    if run.timeline.outages:
        lines.append(("outages", _outages(run)))
    if recoveries := run.scored.trajectory.recoveries:
        lines.append(("recovery", _recovery(recoveries)))
    return lines


def fix_text(run: Run) -> str:
    """Return what the fixes of a dive were like: how many are good, their noise, their scatter; "" if unknown."""
    fixes = run.fix_statistics
    if fixes is None:
        return ""
    parts = {"in range": (fixes.range_m, "m"), "in bearing": (fixes.bearing_deg, "deg")}
    if fixes.range_m is None:
        parts = {"east": (fixes.east_m, "m"), "north": (fixes.north_m, "m")}
    text = f"{fixes.fixes}, one in {fixes.interval_s:.1f} s; {100 * fixes.good_share:.0f} % good, "
    text += f"{fixes.outliers} gross outlier{'' if fixes.outliers == 1 else 's'}"
    ranges = [f"{one.from_m:.0f} to {one.to_m:.0f} m {100 * one.good_share:.0f} %" for one in fixes.by_range]
    text += f"; good by horizontal range: {', '.join(ranges)}" if ranges else ""
    for part in ("white", "slow"):
        noise = [
            f"{getattr(found, part).sd:.2f} ± {getattr(found, part).sd_of_sd:.2f} {unit} {name}"
            for name, (found, unit) in parts.items()
            if found
        ]
        text += f"; {part} noise {' and '.join(noise)} (1 sigma)" if noise else ""
    if (found := fixes.scatter) is not None:
        share = f", {found.drms_percent:.1f} % of the range" if math.isfinite(found.drms_percent) else ""
        text += f"; off the smoothed track without each {found.drms_m:.2f} m DRMS{share}, {found.cep50_m:.2f} m CEP50, "
        text += f"{found.cep95_m:.2f} m CEP95"
    return text


PER_FIX = {1: " per coordinate", 2: " per fix"}  # its noise is heavy-tailed of each by itself, or of both together


def _sensor(updates: SensorUpdates, fixes: FixUpdates | None) -> str:
    what, of = ("updates", updates) if fixes is None else ("fixes", fixes)
    counts = {"down-weighted": of.down_weighted, "rejected": of.rejected}
    text = "".join(f", {count} {outcome}" for outcome, count in counts.items() if count)
    per = PER_FIX.get(round(updates.nis_expected or 0), "") if fixes else ""
    nis = "" if updates.nis_mean is None else f"NIS {updates.nis_mean:.2f} (expected {updates.nis_expected:.0f}{per}); "
    gap = "" if fixes is None else f"; longest gap {fixes.longest_gap_s:.1f} s"
    return f"{nis}{what}: {of.used} used{text}{gap}"


def _outages(run: Run) -> str:
    texts: list[str] = []
    for sensor in sorted({outage.sensor for outage in run.timeline.outages}):
        mine = [outage for outage in run.timeline.outages if outage.sensor == sensor]
        longest = max(mine, key=lambda outage: outage.end_s - outage.start_s)
        span = f"{longest.end_s - longest.start_s:.1f} s at {longest.start_s:.0f} s"
        texts.append(f"{sensor} {len(mine)}, longest {span}" if len(mine) > 1 else f"{sensor} {span}")
    return "; ".join(texts)


def _recovery(recoveries: Sequence[OutageRecovery]) -> str:
    """Describe the recovery whose fixes were farthest from the track."""
    one = max(recoveries, key=lambda one: one.sigmas)
    text = (
        f"at {one.end_s:.0f} s, after {one.end_s - one.start_s:.1f} s without a fix: the fixes were "
        f"{one.residual_m:.2f} m ({one.sigmas:.1f} sigma) from the track and moved it by {one.correction_m:.2f} m; "
        f"its sigma was {one.sd_start_m:.2f} m before and {one.sd_end_m:.2f} m after the gap"
    )
    return text if len(recoveries) == 1 else f"{len(recoveries)} times; the worst {text}"
