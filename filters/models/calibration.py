"""Constant errors of the sensors as states: which there are, how they start, and what was found of them.

Inside, angles are counter-clockwise radians; at the border they are clockwise degrees, as headings are. Everywhere an
error is the sensor's: positive means that it reads too much. The equations stand in sensors.py.
"""

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from usbldr.filters.errors import UsageError
from usbldr.filters.models.parameters import SensorErrors
from usbldr.filters.models.states import MOTION_STATES, StateLayout
from usbldr.filters.types import Trajectory, Vector

STATES: Mapping[str, tuple[str, ...]] = {
    "scale": ("dvl_scale",),
    "misalignment": ("dvl_mount",),
    "heading": ("heading_bias",),
    "deviation": ("deviation_sin", "deviation_cos"),
    "latency": ("usbl_latency",),
    "usbl-bias": ("usbl_bias_east", "usbl_bias_north"),
}
"""The keys of --calibrate and the states that each adds."""
AUTO = "auto"
"""Asks for those that the log can tell: observability.py answers before a filter runs."""


MAX_SIGMA_RATIO = 0.8  # of the sigma before: what stays wider has hardly been observed


class ReportedQuantity(NamedTuple):
    """How a state is told to people."""

    name: str  # with its unit
    unit: str
    factor: float  # from the state to that unit


DEGREES = math.degrees(1.0)  # fixed: in a radian
REPORTED_QUANTITIES: Mapping[str, ReportedQuantity] = {
    "dvl_scale": ReportedQuantity("dvl_scale", "", 1.0),
    "dvl_mount": ReportedQuantity("dvl_mount_deg", "deg", -DEGREES),
    "heading_bias": ReportedQuantity("heading_bias_deg", "deg", -DEGREES),
    "deviation_sin": ReportedQuantity("deviation_sin_deg", "deg", DEGREES),  # of the heading: H + A sin H + B cos H
    "deviation_cos": ReportedQuantity("deviation_cos_deg", "deg", -DEGREES),
    "usbl_latency": ReportedQuantity("usbl_latency_s", "s", 1.0),
    "usbl_bias_east": ReportedQuantity("usbl_bias_east_m", "m", 1.0),
    "usbl_bias_north": ReportedQuantity("usbl_bias_north_m", "m", 1.0),
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
    return {
        "dvl_scale": errors.scale,
        "dvl_mount": errors.misalignment_rad,
        "heading_bias": errors.heading_rad,
        "deviation_sin": errors.deviation_rad,
        "deviation_cos": errors.deviation_rad,
        "usbl_latency": errors.latency_s,
        "usbl_bias_east": errors.usbl_bias_m,
        "usbl_bias_north": errors.usbl_bias_m,
    }


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
            name, unit, factor = REPORTED_QUANTITIES[state]
            sd = abs(factor) * np.sqrt(np.maximum(trajectory.cov[:, row, row], 0.0))
            told.append(EstimatedError(name, unit, factor * trajectory.mean[:, row] + 0.0, sd))  # no -0.0
    return tuple(told)
