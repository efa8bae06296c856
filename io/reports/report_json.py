"""The machine-readable files of one run: report.json and the CSV tables. SI units, as named."""

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import msgspec
import numpy as np
import pandas as pd

from usbldr.filters.evaluation.consistency import consistency_text
from usbldr.filters.evaluation.error_report import ErrorReport
from usbldr.filters.evaluation.influence import Influence, most_influential
from usbldr.filters.identification.identification import Identification
from usbldr.filters.models.calibration import estimated_errors
from usbldr.filters.replay.methods import METHODS
from usbldr.filters.types import Timeline, Trajectory, Truth
from usbldr.filters.updates import UpdateTable
from usbldr.io.log import column_at
from usbldr.io.provenance import provenance_values
from usbldr.io.reader import utc
from usbldr.io.reports.run import Run, pose_table
from usbldr.io.reports.run_directory import REPORT, json_text
from usbldr.io.reports.run_provenance import made_by, provenance_content
from usbldr.io.reports.tracks import (
    pieces_of,
    track_content,
    track_table,
    write_csv,
    write_geojson,
    write_kml,
    write_pieces,
    write_tum,
)

BOUNDS = {"filter": False, "smoother": True}  # whether it is of smoothed tracks


def fixes_table(timeline: Timeline, trajectory: Trajectory) -> pd.DataFrame:
    """Return each USBL fix with its outcome; dr and usbl have none."""
    fixes = UpdateTable.of(trajectory.updates).of_sensor("usbl")
    innovation_m = fixes.vectors("innovation")
    x, y = (trajectory.names.index(state) for state in ("x", "y"))
    judged = pd.DataFrame(
        {
            "innovation_east_m": innovation_m[:, 0],
            "innovation_north_m": innovation_m[:, 1],
            "shift_east_m": fixes.shift(x),
            "shift_north_m": fixes.shift(y),
            "nis": fixes.nis.round(4),
            "dof": fixes.dof,
            "outcome": fixes.outcome,
            "why": list(map(_reason, fixes.outcome, fixes.nominal_probability, fixes.nis, fixes.dof)),
        },
        index=fixes.row,
    ).astype({"outcome": "str", "why": "str"})
    place = {"east_m": timeline.fix_m[:, 0], "north_m": timeline.fix_m[:, 1]}
    table = pd.DataFrame({"time_s": timeline.fix_time_s, "received_s": timeline.fix_received_s, **place})
    outcome, why = ("not used", "outside the span of the run") if len(fixes) else ("", "the method is not a filter")
    table = table.join(judged).fillna({"dof": 0, "outcome": outcome, "why": why})
    return table.astype({"dof": int})


def _reason(outcome: str, nominal_probability: float, nis: float, dof: int) -> str:
    """Return why a fix was not used fully; "" for one that was."""
    if outcome == "down-weighted":
        return f"probably an outlier: probability of the nominal noise {nominal_probability:.2f}"
    return f"rejected by the gate or the guard: NIS {nis:.1f}, expected {dof}" if outcome == "rejected" else ""


def errors_table(report: ErrorReport) -> pd.DataFrame:
    """Return the errors at the scored epochs, after the alignment; the sigmas include that of the truth, if known."""
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
    origin = None if run.log.map_unknown else run.log.origin
    write_pieces(folder / f"track_{fast}.csv", (track_table(part, origin) for part in pieces_of(trajectory)))
    poses = (table for part in pieces_of(trajectory) if (table := pose_table(run.log, part)) is not None)
    if trajectory.state("psi") is not None and trajectory.cov is not None:
        write_pieces(folder / f"pose_{fast}.csv", poses)
    write_csv(folder / "fixes.csv", fixes)
    time_s, place_m, yaw = trajectory.time_s, trajectory.position_m, trajectory.state("psi")
    if report is None:
        known = np.isfinite(place_m).all(axis=1)
        time_s, place_m, yaw = time_s[known], place_m[known], None if yaw is None else yaw[known]
    else:
        write_csv(folder / f"errors_{slow}.csv", errors_table(report))
        yaw = None if yaw is None else np.interp(report.time_s, time_s, yaw) + report.alignment.rotation_rad
        time_s, place_m = report.time_s, report.estimate_m
    depth = column_at(time_s, run.log.tables.get("depth"), "depth_m")  # of both tracks: errors are horizontal
    write_tum(folder / "track.tum", run.log.start_ns, time_s, place_m, yaw, depth)
    if report is not None:
        write_tum(folder / "truth.tum", run.log.start_ns, time_s, report.truth_m, None, depth)
    shifted = report is not None and report.alignment.name == "shift"
    if run.log.origin is not None and (shifted or not run.log.map_unknown):
        moved, fixes, truth = _on_the_map(run, fixes)
        write_geojson(folder / "track.geojson", moved, truth, fixes, run.log.origin)
        title = f"{run.label} on {run.log.path.name}"
        depth = column_at(moved.time_s, run.log.tables.get("depth"), "depth_m")
        write_kml(folder / "track.kml", title, moved, truth, run.log.origin, depth)


def _on_the_map(run: Run, fixes: pd.DataFrame) -> tuple[Trajectory, pd.DataFrame, Truth | None]:
    """Return track, fixes and truth as a map shows them.

    If their map has no stated origin, track and fixes are moved by the shift that was fitted to the truth; a truth on
    such a map is left out.
    """
    track, report = run.scored
    if not run.log.map_unknown or report is None:
        return track, fixes, None if report is not None and report.place_unknown else run.truth
    east_m, north_m = report.alignment.shift_m
    mean = track.mean.copy()
    mean[:, track.names.index("x")] += east_m
    mean[:, track.names.index("y")] += north_m
    moved = fixes.assign(east_m=fixes["east_m"] + east_m, north_m=fixes["north_m"] + north_m)
    return replace(track, mean=mean), moved, run.truth


def _grid_names(run: Run) -> tuple[str, str]:
    """Return the names of the two time grids in file names: "5hz" and "1hz", or "fixes" for raw fixes."""
    if run.method not in METHODS:
        return "estimate", "estimate"
    if METHODS[run.method].scored_at_fixes:
        return "fixes", "fixes"
    t = run.timeline.time_s
    rates = [1 / float(np.median(np.diff(times))) if len(times) > 1 else 1.0 for times in (t, t[run.timeline.slow])]
    return f"{rates[0]:.4g}hz", f"{rates[1]:.4g}hz"


def write_json(folder: Path, run: Run) -> None:
    """Write report.json, the last file of a run: it lists all others."""
    files = sorted(path.name for path in folder.iterdir())
    content = json_values({**report_content(run), "files": files})
    (folder / REPORT).write_text(json_text(content) + "\n", encoding="utf-8")


def report_content(run: Run) -> dict[str, Any]:
    """Return the content of report.json but for its list of files."""
    log, (trajectory, report) = run.log, run.scored
    t, undecided = run.timeline.time_s, run.identification.undecided
    return {
        **made_by(),
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
        "request": run.request,
        "configuration": {"file": log.configuration and log.configuration.name, "content": run.configuration},
        "assumptions": _assumptions(run.identification),
        "track": track_content(trajectory),
        "calibration": {
            e.name: {"value": e.value[-1], "sd": e.sd[-1]} for e in estimated_errors(trajectory, undecided)
        },
        "undecided": {one.name: {"value": one.value, "sd": one.sd} for one in undecided.values()},
        "influential_fixes": [_influence(fix) for fix in most_influential(trajectory)],
        "leave_one_out": [{**one._asdict(), "fix": _influence(one.fix)} for one in run.without_fixes],
        "reacquisitions": trajectory.reacquisitions,
        "outage_recoveries": trajectory.recoveries,
        "fix_statistics": run.fix_statistics,
        "sensors": {role: provenance_values(p) for role, p in log.provenance.items()},
        "findings": log.findings,
        "outages": run.timeline.outages,
        "truth": _truth(run.truth),
        **_scores(report),
        "reference_tracks": {other.trajectory.label: _scores(other.report) for other in run.reference_tracks},
        **({} if (bound := run.bound) is None else {"bound": {name: bound.metrics(k) for name, k in BOUNDS.items()}}),
        "warnings": run.warnings,
        "verdict": run.verdict,
        "provenance": provenance_content(run.made),
        "timing": {"filter_time_s": trajectory.seconds},  # of the machine, so it is no metric
    }


def _influence(fix: Influence) -> dict[str, Any]:
    return {**fix._asdict(), "shift_m": fix.shift_m}


def _assumptions(found: Identification) -> dict[str, Any]:
    """Return the assumptions of the run, with the name of each noise family."""
    content: dict[str, Any] = json_values(found.parameters)
    for sensor in ("dvl", "compass", "usbl", "gps"):
        content[sensor] = {"family": type(getattr(found.parameters, sensor)).__name__, **content[sensor]}
    return content | {"evidence": found.evidence, "noise_changes": found.noise_changes}


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


def _scores(report: ErrorReport | None) -> dict[str, Any]:
    """Return the errors of one track; a metric that does not apply is null."""
    if report is None:
        return {"metrics": None}
    return {
        "window": report.window,
        "aid": report.aid,
        "alignment": {
            "name": report.alignment.name,
            "rotation_clockwise_deg": math.degrees(0.0 - report.alignment.rotation_rad),
            "shift_east_m": report.alignment.shift_m[0],
            "shift_north_m": report.alignment.shift_m[1],
            "lever_starboard_m": report.alignment.lever_m[0],
            "lever_forward_m": report.alignment.lever_m[1],
        },
        "matching": report.matching,
        "metrics": report.flat(),
        "consistency": consistency_text(report.nees, report.alignment.name == "shift") or None,
        "place_unknown": report.place_unknown,
        "relative_errors": report.relative,
        "surfacings": report.surfacings,
    }


def json_values(value: object) -> Any:
    """Convert values to JSON types: NaN and infinity become null, named tuples and dataclasses become objects."""
    return msgspec.json.decode(msgspec.json.encode(_named(value), enc_hook=_plain))


def _named(value: Any) -> Any:
    """Return named tuples, also within each other, as objects."""
    if hasattr(value, "_asdict"):
        value = value._asdict()
    if isinstance(value, dict):
        return {name: _named(part) for name, part in cast("dict[str, Any]", value).items()}
    return [_named(part) for part in cast("list[Any]", value)] if isinstance(value, tuple | list) else value


def _plain(value: Any) -> Any:
    """Return what msgspec does not know as what it knows."""
    if isinstance(value, Mapping):
        return dict(cast(Mapping[object, object], value))
    return value.tolist() if isinstance(value, np.ndarray | np.generic) else str(value)  # pyright: ignore
