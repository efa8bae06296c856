"""Posterior Cramer-Rao bounds of a simulated dive, from its true states.

A dive of ``paper-drawn`` is one draw from the filters' own model, so the mean over seeds of each dive's bound is the
local bound of docs/studies/bounds.md, and a good filter reaches it. For another scenario the bound holds for
the process noise that the filters assume, and errors may be smaller.
"""

import math
from typing import NamedTuple

import numpy as np

from usbldr.filters.bounds.pcrlb import Bounds, bounds
from usbldr.filters.models.calibration import layout_for
from usbldr.filters.models.parameters import Parameters
from usbldr.filters.models.states import StateLayout
from usbldr.filters.replay.prior import prior
from usbldr.filters.replay.steps import steps, vehicle_motion
from usbldr.filters.simulation.simulate import SimulatedDive
from usbldr.filters.types import Array, Timeline, Vector

OF_SIGMA = math.sqrt(2 / math.pi)  # fixed: the mean absolute error of a Gaussian


class PositionBound(NamedTuple):
    """The least sigma of east and north at the M epochs of the slow grid."""

    time_s: Vector  # (M,)
    filter_sd_m: Array  # (M, 2)
    smoother_sd_m: Array  # (M, 2)

    @property
    def filter_m(self) -> list[float]:
        """The least mean |east| and |north| of a filter."""
        return (OF_SIGMA * self.filter_sd_m.mean(axis=0)).tolist()

    @property
    def smoother_m(self) -> list[float]:
        """The least mean |east| and |north| of a smoother."""
        return (OF_SIGMA * self.smoother_sd_m.mean(axis=0)).tolist()

    def metrics(self, smooth: bool) -> dict[str, float]:
        """Return the least errors of a filter, or of a smoother, by their names in report.json."""
        sd_m = self.smoother_sd_m if smooth else self.filter_sd_m
        east_m, north_m = self.smoother_m if smooth else self.filter_m
        rmse_m = math.sqrt(2 * float(np.mean(np.square(sd_m))))  # of the horizontal error
        return {"mean_abs_east_m": east_m, "mean_abs_north_m": north_m, "rmse_horizontal_m": rmse_m}


def position_bound(simulated: SimulatedDive, timeline: Timeline, parameters: Parameters) -> PositionBound:
    """Return the posterior Cramer-Rao bound of the position on the slow grid (see `dive_bounds`)."""
    rows = layout_for(parameters.calibrate).rows("x", "y")
    covariances = dive_bounds(simulated, timeline, parameters)
    filter_sd_m, smoother_sd_m = (np.sqrt(cov[timeline.slow][:, rows, rows]) for cov in covariances)
    return PositionBound(timeline.time_s[timeline.slow], filter_sd_m, smoother_sd_m)


def dive_bounds(simulated: SimulatedDive, timeline: Timeline, parameters: Parameters) -> Bounds:
    """Return the least covariances, at the epochs of the timeline, of the states that the assumptions calibrate.

    The timeline is that of the dive's own records. Raises UsageError if there is no bound (pcrlb.py).
    """
    layout = layout_for(parameters.calibrate)
    return bounds(
        tuple(steps(timeline, parameters, layout)),
        vehicle_motion(timeline, parameters, layout),
        true_states(simulated, layout, timeline.time_s),
        prior(timeline, parameters, layout).cov,
    )


def true_states(simulated: SimulatedDive, layout: StateLayout, time_s: Vector) -> Array:
    """Return the states of the layout at instants (K,): (K, n).

    The USBL's correlated error is set to its mean, 0, and the truth is interpolated between the stamps of the DVL:
    Jacobians do not depend on the first and hardly on the second.
    """
    truth, scenario = simulated.truth, simulated.scenario
    dvl, compass, late = scenario.dvl, scenario.compass, scenario.usbl.timing
    over_time = {
        "psi": truth.yaw_rad,
        "u": truth.velocity_mps[:, 0],
        "v": truth.velocity_mps[:, 1],
        "r": truth.turn_rate_radps,
        "x": truth.position_m[:, 0],
        "y": truth.position_m[:, 1],
    }
    constant = {
        "dvl_scale": dvl.scale_error,
        "dvl_mount": dvl.misalignment_rad,
        "heading_bias": compass.bias_rad,
        "deviation_sin": compass.deviation_rad[0],
        "deviation_cos": compass.deviation_rad[1],
        "usbl_latency": late.latency_s + late.clock_offset_s - dvl.timing.latency_s - dvl.timing.clock_offset_s,
        "usbl_bias_east": 0.0,
        "usbl_bias_north": 0.0,
        "current_east": scenario.current_mps[0],
        "current_north": scenario.current_mps[1],
    }
    columns = [
        np.interp(time_s, truth.time_s, over_time[name]) if name in over_time else np.full(len(time_s), constant[name])
        for name in layout.names
    ]
    return np.column_stack(columns)
