"""One run in values, and its machine-readable files: report.json and the CSV tables. SI units, as the names say."""

import dataclasses
import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np
import pandas as pd

from usbldr.filters.bounds.dive_bounds import PositionBound
from usbldr.filters.evaluation.consistency import DOF, consistency_text
from usbldr.filters.evaluation.error_report import ErrorReport
from usbldr.filters.evaluation.influence import Influence, LeaveOneOut, influences, most_influential
from usbldr.filters.evaluation.summary_sentence import summary_sentence
from usbldr.filters.models.calibration import estimated_errors
from usbldr.filters.models.parameters import Assumptions
from usbldr.filters.types import Timeline, Trajectory, Truth, Update
from usbldr.io.log import Log
from usbldr.io.provenance import provenance_values
from usbldr.io.reader import utc
from usbldr.io.reports.run_directory import REPORT
from usbldr.io.reports.tracks import track_table, write_csv, write_geojson, write_kml, write_tum

SCHEMA = 2  # fixed: the version of report.json


class ScoredTrack(NamedTuple):
    """A track and its errors; no errors where the log has no truth."""

    trajectory: Trajectory
    report: ErrorReport | None


@dataclass(frozen=True, slots=True)
class Run:
    """Everything that the report of one run tells."""

    log: Log
    timeline: Timeline
    scored: ScoredTrack
    reference_tracks: tuple[ScoredTrack, ...] = ()  # usbl and dr, judged in the same way
    order: str = "validity"  # of the fixes
    seed: int = 0
    options: Mapping[str, object] = field(default_factory=dict[str, object])  # as the user gave them
    configuration: Mapping[str, object] | None = None  # content of the configuration file
    without_fixes: tuple[LeaveOneOut, ...] = ()  # runs without one fix, where the user asked for them
    bound: PositionBound | None = None  # of a scenario, if the user asked for it

    @property
    def label(self) -> str:
        """What to call the track: the method, and what was done to it."""
        return self.scored.trajectory.label

    @property
    def method(self) -> str:
        """Name of the method."""
        return self.scored.trajectory.method

    @property
    def truth(self) -> Truth | None:
        """The reference that judged the run."""
        return self.log.truth

    @property
    def verdict(self) -> str:
        """Return the sentence that every table ends in."""
        if self.scored.report is None:
            return f"{self.label}: no truth in {self.log.path.name}, so nothing to judge it by"
        return summary_sentence(
            self.scored.report, [other.report for other in self.reference_tracks if other.report is not None]
        )

    @property
    def warnings(self) -> tuple[str, ...]:
        """Return what the filter and its evaluation had to warn of."""
        report = self.scored.report
        judged = () if report is None else report.warnings
        known = self.log.assumptions
        if report is not None and not known.calibrate and _too_sure(report):
            hint = "--calibrate auto estimates those errors of the sensors that the log can tell"
            if known.observed:
                hint = "no error of a sensor that it could estimate shows in the log; see usbldr doctor for others"
            judged = (*judged, f"{self.label} claims to know its place far better than it does: {hint}")
        return self.scored.trajectory.warnings + judged


def _too_sure(report: ErrorReport) -> bool:
    """Return whether the sigmas are less than half of what the errors show, and no chance explains it."""
    return report.nees is not None and report.nees.mean > max(4 * DOF, report.nees.high)


def fixes_table(timeline: Timeline, trajectory: Trajectory) -> pd.DataFrame:
    """Return each USBL fix with what the filter made of it; dr and usbl judge none."""
    by_row = {update.row: update for update in trajectory.updates if update.sensor == "usbl"}
    rows = [_fix_outcome(by_row.get(row), judges=bool(by_row)) for row in range(len(timeline.fix_time_s))]
    table = pd.DataFrame(rows, columns=["innovation_east_m", "innovation_north_m", "nis", "dof", "outcome", "why"])
    table.insert(0, "time_s", timeline.fix_time_s)
    table.insert(1, "received_s", timeline.fix_received_s)
    table.insert(2, "east_m", timeline.fix_m[:, 0])
    table.insert(3, "north_m", timeline.fix_m[:, 1])
    shifts = influences(trajectory)
    for place, axis in ((6, "east"), (7, "north")):
        name = f"shift_{axis}_m"
        told = [getattr(shifts[row], name) if row in shifts else math.nan for row in range(len(table))]
        table.insert(place, name, told)
    return table.round({"nis": 4})


def _fix_outcome(update: Update | None, judges: bool) -> tuple[float, float, float, int, str, str]:
    """Return the columns of the table that say what the filter made of one fix."""
    if update is None:
        why = "outside the span of the run" if judges else "the method judges no fix"
        return math.nan, math.nan, math.nan, 0, "not used" if judges else "", why
    why = {
        "used": "",
        "down-weighted": f"more likely an outlier: probability {update.nominal_probability:.2f} of the nominal noise",
        "rejected": f"refused by the gate or the guard: NIS {update.nis:.1f} where {update.dof} is right",
    }[update.outcome]
    east_m, north_m = update.innovation
    return east_m, north_m, update.nis, update.dof, update.outcome, why


def errors_table(report: ErrorReport) -> pd.DataFrame:
    """Return the errors at the scored epochs, after the alignment; the sigmas include the truth's own where known."""
    sd = np.full(report.error_m.shape, np.nan) if report.sd_m is None else report.sd_m
    return pd.DataFrame(
        {
            "time_s": report.time_s,
            "error_east_m": report.error_m[:, 0],
            "error_north_m": report.error_m[:, 1],
            "sd_east_m": sd[:, 0],
            "sd_north_m": sd[:, 1],
        }
    )


def write_tables(folder: Path, run: Run) -> None:
    """Write the CSV tables and the tracks for other programs."""
    trajectory, report = run.scored
    fast, slow = _grid_names(run)
    fixes = fixes_table(run.timeline, trajectory)
    write_csv(folder / f"track_{fast}.csv", track_table(trajectory, run.log.origin))
    write_csv(folder / "fixes.csv", fixes)
    if report is not None:
        write_csv(folder / f"errors_{slow}.csv", errors_table(report))
        yaw = None if (psi := trajectory.state("psi")) is None else np.interp(report.time_s, trajectory.time_s, psi)
        if yaw is not None:
            yaw = yaw + report.alignment.rotation_rad
        write_tum(folder / "track.tum", run.log.start_ns, report.time_s, report.estimate_m, yaw)
        write_tum(folder / "truth.tum", run.log.start_ns, report.time_s, report.truth_m)
    if run.log.origin is not None:
        write_geojson(folder / "track.geojson", trajectory, run.truth, fixes, run.log.origin)
        write_kml(folder / "track.kml", f"{run.label} on {run.log.path.name}", trajectory, run.truth, run.log.origin)


def _grid_names(run: Run) -> tuple[str, str]:
    """Return what to call the track's and the errors' own times: "5hz" and "1hz", or "fixes" for raw fixes."""
    if run.method == "usbl":
        return "fixes", "fixes"
    t = run.timeline.time_s
    rates = [1 / float(np.median(np.diff(times))) if len(times) > 1 else 1.0 for times in (t, t[run.timeline.slow])]
    return f"{rates[0]:.4g}hz", f"{rates[1]:.4g}hz"


def write_json(folder: Path, run: Run) -> None:
    """Write report.json, the last file of a run: it names all others."""
    files = sorted(path.name for path in folder.iterdir())
    text = json.dumps(
        json_values({**report_content(run), "files": files}), indent=1, allow_nan=False, ensure_ascii=False
    )
    (folder / REPORT).write_text(text + "\n", encoding="utf-8")


def report_content(run: Run) -> dict[str, Any]:
    """Return the content of report.json but for its list of files."""
    log, (trajectory, report) = run.log, run.scored
    t = run.timeline.time_s
    return {
        "schema": SCHEMA,
        "tool": {"name": "usbldr", "version": version("usbldr"), "numpy": np.__version__},
        "log": {"name": log.path.name, "sha256": log.sha256, "format": log.format},
        "time_base": {
            "start_ns": log.start_ns,
            "start_utc": utc(log.start_ns),
            "epochs": len(t),
            "epoch_s": round(float(np.median(np.diff(t))), 9) if len(t) > 1 else None,
            "end_s": float(t[-1]),
        },
        "origin": log.origin,
        "filter": run.label,
        "method": run.method,
        "particles": trajectory.particles,
        "seed": run.seed,
        "order": run.order,
        "options": run.options,
        "configuration": {"file": log.configuration and log.configuration.name, "content": run.configuration},
        "assumptions": _assumptions(log.assumptions),
        "calibration": {e.name: {"value": e.value[-1], "sd": e.sd[-1]} for e in estimated_errors(trajectory)},
        "influential_fixes": [_influence(fix) for fix in most_influential(trajectory)],
        "leave_one_out": [{**one._asdict(), "fix": _influence(one.fix)} for one in run.without_fixes],
        "reacquisitions": [one._asdict() for one in trajectory.reacquisitions],
        "outage_recoveries": [one._asdict() for one in trajectory.recoveries],
        "sensors": {role: provenance_values(p) for role, p in log.provenance.items()},
        "findings": log.findings,
        "outages": run.timeline.outages,
        "truth": _truth(run.truth),
        **_judged(report),
        "baselines": {other.trajectory.label: _judged(other.report) for other in run.reference_tracks},
        **({} if run.bound is None else {"bound": _bound(run.bound)}),
        "warnings": run.warnings,
        "verdict": run.verdict,
    }


def _bound(bound: PositionBound) -> dict[str, Any]:
    """Return the least mean errors that any filter, or smoother, could have."""
    names = ("mean_abs_east_m", "mean_abs_north_m")
    found = {"filter": bound.filter_m, "smoother": bound.smoother_m}
    return {name: dict(zip(names, errors_m, strict=True)) for name, errors_m in found.items()}


def _influence(fix: Influence) -> dict[str, Any]:
    return {**fix._asdict(), "shift_m": fix.shift_m}


def _assumptions(assumptions: Assumptions) -> dict[str, Any]:
    """Return the model side of the run; a noise family, which is known by its class alone, is named."""
    told: dict[str, Any] = json_values(assumptions)
    for sensor in ("dvl", "compass", "usbl", "gps"):
        told[sensor] = {"family": type(getattr(assumptions, sensor)).__name__, **told[sensor]}
    told["tuned"] = [number._asdict() for number in assumptions.tuned]
    told["noise_changes"] = [number._asdict() for number in assumptions.noise_changes]
    return told


def _truth(truth: Truth | None) -> dict[str, Any] | None:
    if truth is None:
        return None
    return {
        "kind": truth.kind,
        "source": truth.source,
        "rows": len(truth.time_s),
        "start_s": float(truth.time_s[0]) if len(truth.time_s) else None,
        "end_s": float(truth.time_s[-1]) if len(truth.time_s) else None,
        "max_gap_s": truth.max_gap_s,
    }


def _judged(report: ErrorReport | None) -> dict[str, Any]:
    """Return the errors of one track; a metric that does not apply is null."""
    if report is None:
        return {"metrics": None}
    return {
        "window": report.window._asdict(),
        "aid": report.aid,
        "alignment": {
            "name": report.alignment.name,
            "rotation_clockwise_deg": math.degrees(0.0 - report.alignment.rotation_rad),
            "shift_east_m": report.alignment.shift_m[0],
            "shift_north_m": report.alignment.shift_m[1],
        },
        "matching": report.matching._asdict(),
        "metrics": report.flat(),
        "consistency": consistency_text(report.nees) or None,
        "surfacings": [surfacing._asdict() for surfacing in report.surfacings],
    }


def json_values(value: object) -> Any:
    """Turn values into what JSON knows: NaN and infinity become null, dataclasses become objects."""
    if value is None or isinstance(value, bool | str | int):
        return value
    if isinstance(value, np.generic):
        return json_values(cast(object, value.item()))
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {f.name: json_values(getattr(value, f.name)) for f in dataclasses.fields(value)}
    if isinstance(value, Mapping):
        return {str(key): json_values(item) for key, item in cast(Mapping[object, object], value).items()}
    if isinstance(value, np.ndarray | Sequence | set | frozenset):
        return [json_values(item) for item in cast(Iterable[object], value)]
    return str(value)
