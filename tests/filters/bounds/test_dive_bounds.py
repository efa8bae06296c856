"""True states against the readings that they explain, and a dive's bounds against an EKF's own covariances."""

import math
from dataclasses import replace

import numpy as np
import pytest

from usbldr.filters.bounds.dive_bounds import dive_bounds, true_states
from usbldr.filters.models.calibration import STATES, layout_for
from usbldr.filters.models.noise import Gaussian
from usbldr.filters.models.parameters import Parameters, ProcessNoise, Start
from usbldr.filters.replay.methods import FilterSettings
from usbldr.filters.replay.run import run
from usbldr.filters.replay.steps import steps
from usbldr.filters.simulation.scenario import Accuracy, Leg, Scenario, Timing
from usbldr.filters.simulation.simulate import simulate
from usbldr.filters.types import Timeline
from usbldr.io.reading.epochs import timeline
from usbldr.io.scenarios.shipped import find_scenario
from usbldr.io.scenarios.simulated_log import simulated_log

PAPER = find_scenario("paper")

TURNING = replace(
    PAPER,
    duration_s=60.0,
    legs=(Leg(30.0, 0.1, 1.2, math.radians(4.0)), Leg(30.0, -0.1, 1.0, math.radians(-5.0))),
    **{sensor: replace(getattr(PAPER, sensor), noise=Gaussian()) for sensor in ("dvl", "compass", "usbl")},
    process=ProcessNoise(),  # generic: it allows for the turns
    start=Start(0.0, 0.0, 0.01),
)


def seen(scenario: Scenario, calibrate: tuple[str, ...]) -> tuple[Timeline, Parameters]:
    log = simulated_log(scenario, seed=3)
    return timeline(log), replace(log.parameters, calibrate=calibrate)


def test_the_true_states_explain_every_reading_of_sensors_that_err_but_have_no_noise() -> None:
    keys = tuple(STATES)
    wrong = replace(
        TURNING,
        dvl=replace(TURNING.dvl, sd_mps=1e-9, scale_error=0.02, misalignment_rad=0.03),
        compass=replace(TURNING.compass, sd_rad=1e-9, bias_rad=0.05, deviation_rad=(0.02, -0.01)),
        usbl=replace(TURNING.usbl, accuracy=Accuracy(sd_m=1e-9), timing=Timing(latency_s=0.4)),
    )
    line, parameters = seen(wrong, keys)
    layout = layout_for(keys)

    states = true_states(simulate(wrong, seed=3), layout, line.time_s)

    checked = 0
    for step in steps(line, parameters, layout):
        for reading in step.measurements:
            want = reading.model.predict(states[step.epoch][:, None])
            away_from_corner = reading.sensor != "usbl" or not 29.5 < reading.time_s < 30.5
            if away_from_corner:
                # a fix 0.4 s ago is on a chord for the model, on an arc in truth: some 0.1 mm apart
                np.testing.assert_allclose(reading.model.residual(reading.z[:, None], want), 0, atol=3e-4)
                checked += 1
    assert checked > 900


@pytest.mark.parametrize("calibrate", [(), ("scale",), ("scale", "heading")], ids=", ".join)
@pytest.mark.parametrize("smooth", [False, True], ids=["filter", "smoother"])
def test_with_gaussian_noise_the_bound_is_what_an_ekf_says_of_itself(calibrate: tuple[str, ...], smooth: bool) -> None:
    """The EKF has its Jacobians at its own estimates, a few centimetres and hundredths of a degree off the truth."""
    line, parameters = seen(TURNING, calibrate)
    claimed = run("ekf", line, parameters, FilterSettings(smooth=smooth)).cov
    assert claimed is not None

    got = dive_bounds(simulate(TURNING, seed=3), line, parameters)[smooth]

    sd, want = (np.sqrt(np.einsum("kii->ki", cov))[10:] for cov in (got, claimed))
    np.testing.assert_allclose(sd, want, rtol=0.03)
