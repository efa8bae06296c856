"""Constant errors of the sensors as states: which there are, how they start, and what was found of them.

Inside, angles are counter-clockwise radians; at the border they are clockwise degrees, as headings are. Everywhere an
error is the sensor's: positive means that it reads too much. The equations stand in sensors.py.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from usbldr.filters.errors import UsageError
from usbldr.filters.models.parameters import SensorErrors
from usbldr.filters.models.quantities import ReportedQuantity, sensor_errors_of
from usbldr.filters.models.states import MOTION_STATES, StateLayout
from usbldr.filters.types import Trajectory, Vector

SENSOR_ERRORS = sensor_errors_of(SensorErrors)
STATES: Mapping[str, tuple[str, ...]] = {error.key: tuple(error.states) for error in SENSOR_ERRORS.values()}
"""The keys of --calibrate and the states that each adds."""
AUTO = "auto"
"""Asks for those that the log can tell: observability.py answers before a filter runs."""
MAX_SIGMA_RATIO = 0.8  # of the sigma before: what stays wider has hardly been observed


REPORTED_QUANTITIES: Mapping[str, ReportedQuantity] = {
    state: reported for error in SENSOR_ERRORS.values() for state, reported in error.states.items()
}


class EstimatedError(NamedTuple):
    """One error as the filter saw it over time."""

    name: str  # with its unit
    unit: str
    value: Vector  # (T,)
    sd: Vector  # (T,)

    @property
    def title(self) -> str:
        """The name in words, without the unit."""
        return self.name.removesuffix(f"_{self.unit}").replace("_", " ")


def layout_for(calibrate: Sequence[str]) -> StateLayout:
    """Return the layout with these keys' states behind those of the motion; raise UsageError for an unknown key."""
    unknown = [key for key in calibrate if key not in STATES]
    if unknown:
        raise UsageError(f"no error of a sensor is called {unknown[0]!r} (to calibrate: {', '.join(STATES)})")
    return StateLayout(MOTION_STATES + tuple(name for key in STATES if key in calibrate for name in STATES[key]))


def prior_sd(errors: SensorErrors) -> Mapping[str, float]:
    """Return each state's 1-sigma before anything is measured; all means are 0."""
    return {state: getattr(errors, field) for field, error in SENSOR_ERRORS.items() for state in error.states}


def assumed_sd(errors: SensorErrors) -> Mapping[str, float]:
    """Return each error's 1-sigma before anything is measured, by its name and in its unit at the border."""
    return {
        REPORTED_QUANTITIES[state].name: abs(REPORTED_QUANTITIES[state].factor) * sd
        for state, sd in prior_sd(errors).items()
    }


def estimated_errors(trajectory: Trajectory) -> tuple[EstimatedError, ...]:
    """Return the errors that a filter estimated, in the units of the border; none for a track without them."""
    if trajectory.cov is None:
        return ()
    told: list[EstimatedError] = []
    for row, state in enumerate(trajectory.names):
        if state in REPORTED_QUANTITIES:
            name, unit, factor, *_ = REPORTED_QUANTITIES[state]
            sd = abs(factor) * np.sqrt(np.maximum(trajectory.cov[:, row, row], 0.0))
            told.append(EstimatedError(name, unit, factor * trajectory.mean[:, row] + 0.0, sd))  # no -0.0
    return tuple(told)
