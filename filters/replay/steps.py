"""The measurements of each epoch: the records of its interval, and the fixes valid since the epoch before.

A DVL or compass record belongs to the epoch in whose interval it lies. A fix is used at the first epoch at or after its
time of validity, with its offset, however late it arrived.
"""

from collections.abc import Iterator
from functools import cached_property
from typing import NamedTuple

import numpy as np

from usbldr.filters.estimators.gaussian_bank import replicate
from usbldr.filters.estimators.protocol import Steps, rejected_update
from usbldr.filters.models.motion import VehicleMotion
from usbldr.filters.models.noise import NoiseFamily
from usbldr.filters.models.parameters import Parameters
from usbldr.filters.models.readings import Readings, scalar_noise
from usbldr.filters.models.sensors import Measurement, UsblFix, compass_model, dvl_models
from usbldr.filters.models.sigma_points import StateFunction
from usbldr.filters.models.states import StateLayout
from usbldr.filters.models.usual_motion import TurnHistory, VelocityHistory
from usbldr.filters.replay.position_fixes import PositionFixes, false_fixes, gps_fixes, usbl_fixes
from usbldr.filters.types import Array, Indices, Timeline, Update, Vector


class StepSource:
    """The steps of a timeline, with their readings as columns."""

    def __init__(self, timeline: Timeline, parameters: Parameters, layout: StateLayout) -> None:
        self.time_s, self.parameters = timeline.time_s, parameters
        fixes = usbl_fixes(timeline, parameters, layout), gps_fixes(timeline, parameters)
        self.fixes = tuple(_fix_readings(timeline.time_s, each) for each in fixes)
        self.readings = (*_vehicle_readings(timeline, VehicleSensors(parameters, layout)), *self.fixes)
        self._false = _fix_readings(timeline.time_s, false_fixes(timeline, parameters, layout))

    def steps(self, first: int, last: int) -> Steps:
        """Return the steps to the epochs from first on, without last, with all fixes."""
        t0_s = self.time_s[np.maximum(np.arange(first, last) - 1, 0)]
        return Steps(first, t0_s, self.time_s[first:last], [one.between(first, last) for one in self.readings])

    def left_out(self, first: int, mean: Array, cov: Array) -> list[Update]:
        """Return false fixes as rejected updates, by the estimates of K epochs from first on: (K, n), (K, n, n)."""
        false = self._false.between(first, first + len(mean))
        rows = (false.epoch - first).tolist()
        return [rejected_update(replicate(mean[k], cov[k], 1), false.measurement(r)) for r, k in enumerate(rows)]

    @cached_property
    def every(self) -> Steps:
        """All steps."""
        return self.steps(0, len(self.time_s))

    def arrivals(self) -> tuple[Indices, Indices]:
        """Return for each fix the epoch that uses it, and the first epoch at or after its arrival."""
        used = np.concatenate([fixes.epoch for fixes in self.fixes])
        received_s = np.concatenate([fixes.received_s for fixes in self.fixes])
        return used, np.maximum(used, np.searchsorted(self.time_s, received_s, side="left"))


def steps(timeline: Timeline, parameters: Parameters, layout: StateLayout) -> Steps:
    """Return a step per epoch, with all fixes."""
    return StepSource(timeline, parameters, layout).every


def vehicle_motion(line: Timeline, parameters: Parameters, layout: StateLayout) -> VehicleMotion:
    """Return the motion, with the records at their epochs that show what is usual in their gaps."""
    dvl, compass = line.dvl_count > 0, line.yaw_count > 0
    return VehicleMotion(
        layout,
        parameters.process,
        parameters.errors,
        VelocityHistory.of(line.time_s[dvl], line.dvl_mps[dvl]),
        TurnHistory.of(line.time_s[compass], line.yaw_rad[compass]),
    )


def _vehicle_readings(line: Timeline, sensors: "VehicleSensors") -> Iterator[Readings]:
    """Yield the readings of the compass, and of both axes of the DVL."""
    k = np.flatnonzero(line.yaw_count)
    t, variance = line.time_s[k], (sensors.compass_sd_scale * line.yaw_sd_rad[k]) ** 2 / line.yaw_count[k]
    yield sensors.compass.readings(k, t, line.yaw_rad[k], variance)
    k = np.flatnonzero(line.dvl_count)
    t, variance = line.time_s[k], (sensors.dvl_sd_scale * line.dvl_sd_mps[k]) ** 2 / line.dvl_count[k]
    for axis, kind in enumerate(sensors.dvl):
        yield kind.readings(k, t, line.dvl_mps[k, axis], variance)


def _fix_readings(epochs_s: Vector, fixes: PositionFixes) -> Readings:
    """Return the fixes that an epoch uses, each of both axes, with their offsets from it."""
    first_epoch = np.searchsorted(epochs_s, fixes.time_s, side="left")
    inside = np.flatnonzero(first_epoch < len(epochs_s))
    epoch, time_s = first_epoch[inside], fixes.time_s[inside]
    model = UsblFix(fixes.layout, 0.0, fixes.lever_m)
    columns = (fixes.row[inside], time_s, fixes.received_s[inside], fixes.position_m[inside], fixes.cov_m2[inside])
    return Readings(fixes.sensor, "position", model, fixes.family, False, (), epoch, *columns, time_s - epochs_s[epoch])


class ScalarSensor(NamedTuple):
    """One axis of a sensor as the parameters describe it."""

    sensor: str
    axis: str
    model: StateFunction
    family: NoiseFamily
    bilinear: bool  # see Measurement
    held: tuple[int, ...]  # likewise

    def readings(self, row: Indices, time_s: Vector, z: Vector, variance: Vector) -> Readings:
        """Return the readings of epochs, (R,) each."""
        return Readings(*self, row, row, time_s, time_s, z[:, None], variance[:, None, None])

    def measurement(self, row: int, time_s: float, z: Vector, sd: float) -> Measurement:
        """Return the measurement of one record, (1,)."""
        noise = scalar_noise(self.family, sd**2)
        return Measurement(z, self.model, noise, self.sensor, self.axis, row, time_s, self.bilinear, self.held)


class VehicleSensors:
    """Compass and DVL as the parameters describe them."""

    def __init__(self, parameters: Parameters, layout: StateLayout) -> None:
        others = set(range(len(layout.names))) - {*layout.rows("psi", "r")}
        held = tuple(sorted(others)) if layout.existing("deviation_sin") else ()  # see apply_gain
        self.compass = ScalarSensor("compass", "yaw", compass_model(layout), parameters.compass, False, held)
        starboard, forward = dvl_models(layout, parameters.dvl_lever_m)
        axes = (("starboard", starboard), ("forward", forward))
        self.dvl = [ScalarSensor("dvl", axis, model, parameters.dvl, bool(model.nonlinear), ()) for axis, model in axes]
        self.dvl_sd_scale = parameters.dvl_sd_scale
        self.compass_sd_scale = parameters.compass_sd_scale


def sensor_kinds(parameters: Parameters, layout: StateLayout) -> list[tuple[StateFunction, NoiseFamily]]:
    """Return the model and the noise family of each kind of measurement that steps can have."""
    sensors = VehicleSensors(parameters, layout)
    fixes = (parameters.usbl, parameters.usbl_lever_m, layout), (parameters.gps, parameters.gps_lever_m, StateLayout())
    return [
        *((one.model, one.family) for one in (sensors.compass, *sensors.dvl)),
        *((UsblFix(of, 0.0, lever_m), family) for family, lever_m, of in fixes),
    ]
