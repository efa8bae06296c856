"""A filter in a loop of one's own, on a vehicle or in a simulator: each measurement is used when it arrives.

Every call is a step of its own, run by the code that replays a log: a log with one record per epoch gives the same
track to the last bit. A log with several records per epoch differs a little, as replay takes them at the epoch.
"""

import copy
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from usbldr.filters.errors import LogError, UsageError
from usbldr.filters.estimators.protocol import Step
from usbldr.filters.frames import convergence_rad, heading_deg, rotated
from usbldr.filters.models.calibration import AUTO, layout_for
from usbldr.filters.models.motion import VehicleMotion
from usbldr.filters.models.parameters import Parameters
from usbldr.filters.models.sensors import Measurement, UsblFix
from usbldr.filters.models.states import POSITION
from usbldr.filters.models.usual_motion import TurnHistory, VelocityHistory
from usbldr.filters.replay.dead_reckoning import LEAST_START_SD_M, fix_sensitivity
from usbldr.filters.replay.methods import FilterSettings, method_named, methods_that
from usbldr.filters.replay.prior import prior_at
from usbldr.filters.replay.run import SINGULAR_TEXT, make_estimator
from usbldr.filters.replay.running_filter import RunningFilter
from usbldr.filters.replay.steps import VehicleSensors
from usbldr.filters.types import Array, Update, Vector


@dataclass(frozen=True, slots=True)
class OnlineEstimate:
    """The estimate at one time."""

    time_s: float
    position_m: Vector  # (2,) east, north
    position_cov_m2: Array  # (2, 2)
    heading_deg: float  # clockwise from the north of the headings that it was given, 0 to 360
    velocity_mps: Vector  # (2,) starboard, forward
    states: Mapping[str, float]  # all n by name, as in Trajectory: yaw psi in radians counter-clockwise
    cov: Array  # (n, n) of the states in that order


class OnlineFilter:
    """A filter of METHODS that takes one measurement at a time.

    It starts at the first fix after a heading and a velocity, with a sigma of at least 3 m, or, with a start in its
    parameters, as soon as it has both. Measurements up to then are kept for the start and return None. Any later
    measurement may be late: the filter goes back to its time, as far as 10 s, and runs forward again. Times are seconds
    from any zero of yours. A call that raises leaves the filter as it was.

    Headings count from the north of the plane of the fixes. With ``origin_lat_deg``, the latitude of its origin, they
    count from true north where the vehicle is, and the meridians converge.
    """

    def __init__(
        self,
        method: str,
        parameters: Parameters,
        settings: FilterSettings = FilterSettings(),
        origin_lat_deg: float | None = None,
    ) -> None:
        """Raise UsageError for a method that is no filter and for settings that need the whole dive or do not fit."""
        if not method_named(method).is_filter:
            raise UsageError(f"{method} is no filter (filters: {methods_that(lambda m: m.is_filter)})")
        if settings.smooth or AUTO in parameters.calibrate:
            raise UsageError(
                "smoothing and calibrate = auto need the whole dive: leave smoothing out, and name the errors to "
                "estimate"
            )
        if origin_lat_deg is not None and not abs(origin_lat_deg) < 90:
            raise UsageError(f"origin_lat_deg = {origin_lat_deg:g} must lie between -90 and 90 degrees")
        self.method, self.parameters, self.settings = method, parameters, settings
        self._origin_lat_deg = origin_lat_deg
        self._layout = layout_for(parameters.calibrate)
        self._history, self._turns = VelocityHistory(), TurnHistory()  # since the start
        motion = VehicleMotion(self._layout, parameters.process, parameters.errors, self._history, self._turns)
        self._estimator = make_estimator(method_named(method), motion, settings, parameters)
        self._sensors = VehicleSensors(parameters, self._layout)
        self._running: RunningFilter | None = None
        self._yaw: tuple[float, float] | None = None  # the last reading before the start and its sigma, radians
        self._mps: Vector | None = None  # (2,) likewise
        self._count = 0  # of the steps so far

    @property
    def started(self) -> bool:
        """Whether there is an estimate."""
        return self._running is not None

    @property
    def estimate(self) -> OnlineEstimate:
        """What is known at the time of the latest call; raises UsageError before the start."""
        running = self._require_start()
        mean, cov = running.estimate.mean, running.estimate.cov
        states = dict(zip(self._layout.names, mean.tolist(), strict=True))
        velocity = np.array([states["u"], states["v"]])
        heading = float(heading_deg(np.array(states["psi"] - self._north_rad(mean[POSITION]))))
        place = np.ix_(POSITION, POSITION)
        return OnlineEstimate(running.steps[-1].t1_s, mean[POSITION], cov[place], heading, velocity, states, cov)

    def predict(self, time_s: float) -> None:
        """Let time pass; raises UsageError before the start, and for a time before the latest."""
        now_s = self._require_start().steps[-1].t1_s
        _require("predict", (time_s,))
        if time_s < now_s:
            raise UsageError(f"predict: {time_s:g} s lies before the latest time, {now_s:g} s")
        self._advance(time_s, ())

    def velocity(self, time_s: float, starboard_mps: float, forward_mps: float, sd_mps: float) -> Update | None:
        """Take the velocity over the bottom that a DVL measured, with its sigma per axis."""
        _require("velocity", (time_s, starboard_mps, forward_mps), sd_mps)
        mps = np.array([starboard_mps, forward_mps], dtype=float)
        if self._running is None:
            self._mps = mps
            return self._start_as_stated(time_s)
        sd_mps *= self._sensors.dvl_sd_scale
        axes = (one.measurement(self._count, time_s, mps[k : k + 1], sd_mps) for k, one in enumerate(self._sensors.dvl))
        updates = self._advance(time_s, tuple(axes))
        self._history.add(time_s, mps)
        return Update.combined(updates)._replace(axis="velocity")

    def heading(self, time_s: float, heading_deg: float, sd_deg: float) -> Update | None:
        """Take a heading in degrees clockwise from north (see the class)."""
        _require("heading", (time_s, heading_deg), sd_deg)
        yaw_rad, sd_rad = -math.radians(heading_deg), math.radians(sd_deg)
        if self._running is None:
            self._yaw = (yaw_rad, sd_rad)
            return self._start_as_stated(time_s)
        yaw_rad += self._north_rad(self._running.estimate.mean[POSITION])
        sd_rad *= self._sensors.compass_sd_scale
        measured = self._sensors.compass.measurement(self._count, time_s, np.array([yaw_rad]), sd_rad)
        update = self._advance(time_s, (measured,))[0]
        self._turns.add(time_s, yaw_rad)
        return update

    def fix(self, time_s: float, east_m: float, north_m: float, cov_m2: ArrayLike) -> Update | None:
        """Take a USBL fix of the transponder, with its covariance (2, 2), at its time of validity, when it arrives."""
        cov = np.asarray(cov_m2, dtype=float)
        if cov.shape != (2, 2) or not np.allclose(cov, cov.T, equal_nan=True):
            raise UsageError("fix: cov_m2 is no symmetric matrix of 2 x 2: give the covariance of east and north in m²")
        _require("fix", (time_s, east_m, north_m), float(np.linalg.eigvalsh(cov)[0]) if np.isfinite(cov).all() else 0.0)
        p, fix_m = self.parameters, np.array([east_m, north_m], dtype=float)
        cov = p.usbl_sd_scale**2 * (cov + cov.T) / 2
        if self._running is not None:
            model = UsblFix(self._layout, 0.0, p.usbl_lever_m)
            measured = Measurement(fix_m, model, p.usbl.modes(cov), "usbl", "position", self._count, time_s)
            return self._advance(time_s, (measured,))[0]
        if self._yaw is not None and p.start is None:
            position_m = fix_m - rotated(self._yaw[0], np.array(p.usbl_lever_m[:2]))
            self._start(time_s, position_m, max(LEAST_START_SD_M, math.sqrt(cov.diagonal().max())), of_usbl=True)
        return None

    def _start_as_stated(self, time_s: float) -> None:
        start = self.parameters.start
        if start is not None:
            self._start(time_s, np.array([start.east_m, start.north_m]), start.sd_m)

    def _start(self, time_s: float, position_m: Vector, sd_m: float, of_usbl: bool = False) -> None:
        """Start at a position, stated or of a fix, if heading and velocity are known."""
        if self._yaw is None or self._mps is None:
            return
        yaw = (self._yaw[0] + self._north_rad(position_m), self._yaw[1])
        carried = np.zeros((2, len(self._layout)))
        if of_usbl:
            carried = fix_sensitivity(rotated(yaw[0], self._mps), self._layout.names)
        prior = prior_at(position_m, sd_m, yaw, self._mps, self.parameters, self._layout, carried)
        self._running = RunningFilter(self._estimator, prior, self.settings.seed)
        self._running.advance(Step(0, time_s, time_s, ()))
        self._count = 1

    def _north_rad(self, position_m: Vector) -> float:
        """Return the yaw on the plane of the north that headings count from at a position (2,)."""
        return 0.0 if self._origin_lat_deg is None else float(convergence_rad(self._origin_lat_deg, position_m))

    def _require_start(self) -> RunningFilter:
        if self._running is None:
            raise UsageError(
                f"{self.method} has not started: it needs a heading, a velocity, and then a fix or a start in its "
                "parameters"
            )
        return self._running

    def _advance(self, time_s: float, measurements: tuple[Measurement, ...]) -> Sequence[Update]:
        """Run a step that ends at a time, and again those that end later; return what became of its measurements."""
        before = self._require_start()
        if time_s < before.steps[0].t0_s:
            raise UsageError(
                f"the measurement of {time_s:g} s comes too late: {self.method} is at {before.steps[-1].t1_s:g} s "
                f"and goes back to {before.steps[0].t0_s:g} s"
            )
        running = copy.copy(before)
        try:
            later = running.go_back(sum(step.t1_s > time_s for step in running.steps))
            t0_s = later[0].t0_s if later else running.steps[-1].t1_s
            updates = running.advance(Step(self._count, t0_s, time_s, measurements)).updates
            for step in later:
                running.advance(step._replace(t0_s=max(step.t0_s, time_s)))
        except np.linalg.LinAlgError as err:
            raise LogError(f"{self.method}: {SINGULAR_TEXT}") from err
        self._running, self._count = running, self._count + 1
        return updates


def _require(what: str, numbers: Sequence[float], spread: float = 1.0) -> None:
    """Raise UsageError unless all numbers are finite and a sigma, or the least variance, is positive."""
    if not (np.isfinite(numbers).all() and 0 < spread < math.inf):
        raise UsageError(f"{what}: time and values must be finite numbers, and the sigma or covariance positive")
