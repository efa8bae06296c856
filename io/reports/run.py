"""The values of one run: what its reports, tables and figures are made of, and the pose beside each position."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from usbldr.filters.bounds.dive_bounds import PositionBound
from usbldr.filters.evaluation.consistency import DOF
from usbldr.filters.evaluation.error_report import ErrorReport
from usbldr.filters.evaluation.fix_statistics import FixStatistics, fix_statistics, left_out_residuals
from usbldr.filters.evaluation.influence import LeaveOneOut
from usbldr.filters.evaluation.summary_sentence import summary_sentence
from usbldr.filters.frames import rotated
from usbldr.filters.identification.identification import Identification
from usbldr.filters.replay.dead_reckoning import corrected, freed
from usbldr.filters.replay.methods import METHODS
from usbldr.filters.types import Timeline, Trajectory, Truth
from usbldr.filters.updates import UpdateTable
from usbldr.filters.windows import columns_at
from usbldr.io.log import Log, column_at
from usbldr.io.reports.run_provenance import RunProvenance

MOST = 0.8  # [-] of the fixes, by judgement: fewer do not show that the track is right
FAR = 2.0  # [-] of the distance within which they are: the truth is further from the track than the fixes


class ScoredTrack(NamedTuple):
    """A track and its errors; no errors if the log has no truth."""

    trajectory: Trajectory
    report: ErrorReport | None


@dataclass(frozen=True)
class Run:
    """Everything that the report of one run contains."""

    log: Log
    timeline: Timeline
    identification: Identification
    scored: ScoredTrack
    reference_tracks: tuple[ScoredTrack, ...] = ()  # usbl and dr, scored in the same way
    order: str = "validity"  # of the fixes
    seed: int = 0
    request: Mapping[str, object] = field(default_factory=dict[str, object])  # log and options as the user gave them
    configuration: Mapping[str, object] | None = None  # content of the configuration file
    without_fixes: tuple[LeaveOneOut, ...] = ()  # runs without one fix, if the user asked for them
    bound: PositionBound | None = None  # of a scenario, if the user asked for it
    made: RunProvenance = RunProvenance()

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
        """The reference that the run was scored against."""
        return self.log.truth

    @cached_property
    def fix_statistics(self) -> FixStatistics | None:
        """What the fixes of a filter's run were like; None for another track, or without fixes."""
        line, track = self.as_used, self.scored.trajectory
        outcomes = fix_outcomes(line, track)
        if not len(outcomes) or not (outcomes != "").any():
            return None
        good = np.asarray(outcomes == "used", dtype=np.bool_)
        time_s, fix_m = self._fixes
        away_m = None if line.fix_away_m is None else line.fix_away_m + fix_m - line.fix_m
        drop_m = self.log.depth_below_head_m(time_s)
        return fix_statistics(time_s, fix_m, away_m, good, track, self._fix_cov_m2, drop_m)

    @property
    def fix_residuals_m(self) -> NDArray[np.float64] | None:
        """Fixes less a track that leaves each of them out, (F, 2); None if unknown."""
        return left_out_residuals(*self._fixes, self.scored.trajectory, self._fix_cov_m2)

    @cached_property
    def as_used(self) -> Timeline:
        """The timeline with its fixes as the run used them: without smoothing, changes, and errors of their head."""
        parameters, settled = self.identification.parameters, self.identification.parameters.settled
        line = corrected(self.timeline, parameters)
        return freed(line, {name: settled[name] for name in parameters.settled_sd if name in settled})

    @cached_property
    def _fixes(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """When fixes were valid (F,), and where they place the point of the vehicle that the track is of, (F, 2)."""
        line, track = self.as_used, self.scored.trajectory
        parameters = self.identification.parameters
        latency, yaw_rad = track.state("usbl_latency"), track.state("psi")
        latency_s = parameters.settled.get("usbl_latency", 0.0) if latency is None else latency[-1]
        time_s = line.fix_time_s - latency_s
        if yaw_rad is None:
            return time_s, line.fix_m
        yaw_rad = np.interp(time_s, track.time_s, yaw_rad)
        return time_s, line.fix_m - rotated(yaw_rad, np.array(parameters.usbl_lever_m[:2]))

    @property
    def _fix_cov_m2(self) -> NDArray[np.float64]:
        """As the method used it for a fix that it took for a good one, (F, 2, 2)."""
        parameters = self.identification.parameters
        cov_m2 = parameters.usbl_sd_scale**2 * self.timeline.fix_cov_m2
        if not self.scored.trajectory.matched_noise or not len(cov_m2):
            return cov_m2
        return np.array([parameters.usbl.modes(one).mixture_cov for one in cov_m2])

    @property
    def _most_fixes_within_m(self) -> float:
        """The distance from the track within which MOST of the fixes are; NaN without fixes."""
        (time_s, fix_m), track = self._fixes, self.scored.trajectory
        away_m = np.hypot(*(fix_m - columns_at(time_s, track.time_s, track.position_m)).T)
        return float(np.quantile(away_m, MOST)) if len(time_s) else np.nan

    @property
    def verdict(self) -> str:
        """Return the last line of the report."""
        if self.scored.report is None:
            return f"{self.label}: {self.log.path.name} has no truth, so there are no errors"
        others = [other.report for other in self.reference_tracks if other.report is not None]
        return summary_sentence(self.scored.report, others)

    @property
    def warnings(self) -> tuple[str, ...]:
        """Return the warnings of the filter and of its evaluation."""
        report = self.scored.report
        scored = () if report is None else report.warnings
        if report is not None and report.nees is not None and _far_over_confident(report):
            hint = "--calibrate auto estimates the sensor errors that the log has evidence for"
            if self.identification.parameters.calibrate or self.identification.evidence:
                hint = "an error that the filter does not estimate is left; usbldr doctor looks for others"
            if self.method not in METHODS:
                hint = "its covariance is too small"
            elif (most_m := self._most_fixes_within_m) * FAR < report.shift.mean_m:
                hint = (
                    f"{100 * MOST:.0f} % of the fixes are within {most_m:.1f} m of the track, so that the truth is of "
                    "another vehicle (a ship's receiver), or all fixes share an error; usbldr doctor looks for others"
                )
            apart = f", without a constant shift {report.shift.nees:.1f}" if report.mostly_shift else ""
            nees = f"NEES {report.nees.mean:.1f}{apart}, expected {DOF}"
            scored = (*scored, f"{self.label} is far over-confident ({nees}): {hint}")
        return self.scored.trajectory.warnings + scored


def _far_over_confident(report: ErrorReport) -> bool:
    """Return whether the sigmas are less than half of what the errors show, beyond the bounds of NEES.

    What a clock of the truth explains is no fault of the sigmas.
    """
    if report.nees is None or not report.judged:
        return False
    mean = report.shift.nees if report.mostly_shift and report.shift.nees is not None else report.nees.mean
    return mean * report.clock_share > max(4 * DOF, report.nees.high)


def fix_outcomes(timeline: Timeline, trajectory: Trajectory) -> NDArray[np.str_]:
    """Return what became of each fix, (F,); "" if that is not known."""
    fixes = UpdateTable.of(trajectory.updates).of_sensor("usbl")
    outcomes = np.full(len(timeline.fix_time_s), "", dtype=fixes.outcome.dtype)
    outcomes[fixes.row] = fixes.outcome
    return outcomes


def pose_table(log: Log, trajectory: Trajectory) -> pd.DataFrame | None:
    """Return depth, altitude, roll, pitch, and the heading's covariance with the position; None without a heading.

    The altitude is that of the vehicle's reference point above the bottom: what the DVL measured, less its arm up.

    Unknown values are NaN. Headings are clockwise, the covariances with east and north in metres times degrees.
    """
    psi = trajectory.names.index("psi") if "psi" in trajectory.names else None
    if psi is None or trajectory.cov is None:
        return None
    x, y = trajectory.names.index("x"), trajectory.names.index("y")
    time_s = trajectory.time_s
    return pd.DataFrame(
        {
            "time_s": time_s,
            "depth_m": column_at(time_s, log.tables.get("depth"), "depth_m"),
            "altitude_m": column_at(time_s, log.altitude, "altitude_m") - log.parameters.dvl_lever_m[2],
            "roll_deg": column_at(time_s, log.attitude, "roll_deg"),
            "pitch_deg": column_at(time_s, log.attitude, "pitch_deg"),
            "sd_heading_deg": np.degrees(np.sqrt(trajectory.cov[:, psi, psi])),
            "cov_east_heading_mdeg": -np.degrees(trajectory.cov[:, x, psi]),
            "cov_north_heading_mdeg": -np.degrees(trajectory.cov[:, y, psi]),
        }
    )
