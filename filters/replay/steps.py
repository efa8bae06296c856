"""The measurements of each epoch: the records of its interval, and the fixes valid since the epoch before.

A DVL or compass record belongs to the epoch in whose interval it lies. A fix is used at the first epoch at or after its
time of validity, with its offset, however late it arrived.
"""

import functools
from collections.abc import Callable, Iterator

import numpy as np

from usbldr.filters.estimators.protocol import Step
from usbldr.filters.models import sensors
from usbldr.filters.models.noise import Noise, NoiseFamily
from usbldr.filters.models.parameters import Parameters
from usbldr.filters.models.sensors import Measurement, UsblFix
from usbldr.filters.models.states import StateLayout
from usbldr.filters.replay.position_fixes import PositionFixes, gps_fixes, usbl_fixes
from usbldr.filters.types import Indices, Timeline, Vector


class StepSource:
    """The measurements of a timeline, by epoch."""

    def __init__(self, timeline: Timeline, parameters: Parameters, layout: StateLayout) -> None:
        self.time_s = timeline.time_s
        self.vehicle = VehicleMeasurements(timeline, parameters, layout)
        both = (usbl_fixes(timeline, parameters, layout), gps_fixes(timeline, parameters))
        self.fixes = tuple(FixMeasurements(timeline.time_s, fixes) for fixes in both)

    def step(self, k: int, received_by_s: float = np.inf) -> Step:
        """Return the step to epoch k with those of its fixes that had arrived by then."""
        readings = [*self.vehicle.at(k), *(reading for fixes in self.fixes for reading in fixes.at(k, received_by_s))]
        readings.sort(key=lambda reading: (reading.time_s, reading.sensor))  # stable: order in the log
        return Step(k, float(self.time_s[max(k - 1, 0)]), float(self.time_s[k]), tuple(readings))

    def arrivals(self) -> tuple[Indices, Indices]:
        """Return for each fix the epoch that uses it, and the first epoch at or after its arrival."""
        used = np.concatenate([fixes.first_epoch for fixes in self.fixes])
        received_s = np.concatenate([fixes.fixes.received_s for fixes in self.fixes])
        return used, np.maximum(used, np.searchsorted(self.time_s, received_s, side="left"))


def steps(timeline: Timeline, parameters: Parameters, layout: StateLayout) -> Iterator[Step]:
    """Yield a step per epoch, with all fixes."""
    readings = StepSource(timeline, parameters, layout)
    return (readings.step(k) for k in range(len(timeline.time_s)))


class VehicleMeasurements:
    """The compass and DVL measurements of an epoch."""

    def __init__(self, timeline: Timeline, parameters: Parameters, layout: StateLayout) -> None:
        self.timeline, self.sensors = timeline, VehicleSensors(parameters, layout)

    def at(self, k: int) -> Iterator[Measurement]:
        """Yield the measurements of epoch k."""
        line = self.timeline
        time_s = float(line.time_s[k])
        if line.yaw_count[k]:
            yaw_rad, sd_rad = line.yaw_rad[k : k + 1], float(line.yaw_sd_rad[k])
            yield self.sensors.compass(k, time_s, yaw_rad, sd_rad, int(line.yaw_count[k]))
        if line.dvl_count[k]:
            yield from self.sensors.dvl(k, time_s, line.dvl_mps[k], float(line.dvl_sd_mps[k]), int(line.dvl_count[k]))


class VehicleSensors:
    """Compass and DVL as the parameters describe them: from readings to measurements."""

    def __init__(self, parameters: Parameters, layout: StateLayout) -> None:
        self._compass = sensors.compass_model(layout)
        self._dvl = sensors.dvl_models(layout, parameters.dvl_lever_m)
        self._compass_noise = _scalar_noise(parameters.compass)
        self._dvl_noise = _scalar_noise(parameters.dvl)
        self._dvl_sd_scale = parameters.dvl_sd_scale

    def compass(self, row: int, time_s: float, yaw_rad: Vector, sd_rad: float, count: int = 1) -> Measurement:
        """Return the measurement of a yaw (1,) that is the mean of ``count`` records with this sigma each."""
        noise = self._compass_noise(sd_rad, count)
        nonlinear = bool(self._compass.nonlinear)
        return Measurement(yaw_rad, self._compass, noise, "compass", "yaw", row, time_s, nonlinear)

    def dvl(self, row: int, time_s: float, mps: Vector, sd_mps: float, count: int = 1) -> Iterator[Measurement]:
        """Yield the measurements of a velocity (2,), starboard and forward, the mean of ``count`` records."""
        noise = self._dvl_noise(self._dvl_sd_scale * sd_mps, count)
        for axis, name in enumerate(("starboard", "forward")):
            model = self._dvl[axis]
            yield Measurement(mps[axis : axis + 1], model, noise, "dvl", name, row, time_s, bool(model.nonlinear))


class FixMeasurements:
    """The measurements of fixes, each of both axes."""

    def __init__(self, epochs_s: Vector, fixes: PositionFixes) -> None:
        self.epochs_s, self.fixes = epochs_s, fixes
        self.first_epoch = np.searchsorted(epochs_s, fixes.time_s, side="left")
        self._begin: list[int] = np.searchsorted(self.first_epoch, np.arange(len(epochs_s) + 1)).tolist()  # by epoch

    def at(self, k: int, received_by_s: float) -> Iterator[Measurement]:
        """Yield the fixes that epoch k uses and that arrived by ``received_by_s``, with their offset from it."""
        if self._begin[k] == self._begin[k + 1]:
            return
        sensor, rows, times_s, received_s, positions_m, covs_m2, family, lever_m, layout = self.fixes
        for f in range(self._begin[k], self._begin[k + 1]):
            if received_s[f] > received_by_s:
                continue
            row, time_s, z, R = int(rows[f]), float(times_s[f]), positions_m[f], covs_m2[f]
            model = UsblFix(layout, time_s - float(self.epochs_s[k]), lever_m)
            yield Measurement(z, model, family.modes(R), sensor, "position", row, time_s)


def _scalar_noise(family: NoiseFamily) -> Callable[[float, int], Noise]:
    """Return a function from the sigma of one record and the number of averaged records to the modes of a scalar."""

    @functools.lru_cache(maxsize=1024)
    def modes(sd: float, count: int) -> Noise:
        return family.modes(np.array([[sd**2 / count]]))

    return modes
