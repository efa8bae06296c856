"""Sensor errors as states: their names, their prior sigmas, and their estimates in units for users.

Inside the filters, angles are counter-clockwise radians; for users they are clockwise degrees, as headings are. An
error is positive if the sensor reads too much. sensors.py has the equations.
"""

from collections.abc import Collection, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from usbldr.filters.errors import UsageError, did_you_mean
from usbldr.filters.models.parameters import SensorErrors
from usbldr.filters.models.quantities import ReportedQuantity, sensor_errors_of
from usbldr.filters.models.states import MOTION_STATES, StateLayout
from usbldr.filters.types import Trajectory, Vector

SENSOR_ERRORS = sensor_errors_of(SensorErrors)
STATES: Mapping[str, tuple[str, ...]] = {error.key: tuple(error.states) for error in SENSOR_ERRORS.values()}
"""The keys of --calibrate and the states that each adds."""
AUTO = "auto"
"""Estimate the errors that the log has evidence for: evidence.py decides before a filter runs."""
MAX_SIGMA_RATIO = 0.8  # of posterior over prior sigma; above it an error is hardly observable


REPORTED_QUANTITIES: Mapping[str, ReportedQuantity] = {
    state: reported for error in SENSOR_ERRORS.values() for state, reported in error.states.items()
}


class EstimatedError(NamedTuple):
    """One sensor error, estimated over T epochs."""

    name: str  # with its unit
    unit: str
    value: Vector  # (T,)
    sd: Vector  # (T,)

    @property
    def title(self) -> str:
        """The name in words, without its unit."""
        return self.name.removesuffix(f"_{self.unit}").replace("_", " ")


def layout_for(calibrate: Sequence[str]) -> StateLayout:
    """Return the layout with the states of these keys after the motion states; raise UsageError for an unknown key."""
    unknown = [key for key in calibrate if key not in STATES]
    if unknown:
        hint = did_you_mean(unknown[0], STATES)
        raise UsageError(f"unknown sensor error {unknown[0]!r} to calibrate{hint} (known: {', '.join(STATES)})")
    return StateLayout(MOTION_STATES + tuple(name for key in STATES if key in calibrate for name in STATES[key]))


def prior_sd(errors: SensorErrors) -> dict[str, float]:
    """Return state -> prior 1-sigma, in the units of the states; all prior means are 0."""
    return {state: getattr(errors, field) for field, error in SENSOR_ERRORS.items() for state in error.states}


def assumed_sd(errors: SensorErrors) -> Mapping[str, float]:
    """Return error name -> prior 1-sigma, in the units for users."""
    return {
        REPORTED_QUANTITIES[state].name: abs(REPORTED_QUANTITIES[state].factor) * sd
        for state, sd in prior_sd(errors).items()
    }


def estimated_errors(trajectory: Trajectory, without: Collection[str] = ()) -> tuple[EstimatedError, ...]:
    """Return the errors that a filter estimated, in the units for users, but for those that the log leaves undecided.

    Empty for a track without such states.
    """
    if trajectory.cov is None:
        return ()
    estimated: list[EstimatedError] = []
    for row, state in enumerate(trajectory.names):
        if state in REPORTED_QUANTITIES and REPORTED_QUANTITIES[state].name not in without:
            name, unit, factor, *_ = REPORTED_QUANTITIES[state]
            sd = abs(factor) * np.sqrt(np.maximum(trajectory.cov[:, row, row], 0.0))
            estimated.append(EstimatedError(name, unit, factor * trajectory.mean[:, row] + 0.0, sd))  # no -0.0
    return tuple(estimated)
