"""The bounds against the Kalman filter's errors, Riccati's equation, a batch solution and the paper's own recursion.

True states are held against the readings that they explain, and a dive's bounds against an EKF's own covariances.
"""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are

from textbook import PRIOR, Drift, position_steps
from usbldr.filters.bounds.dive_bounds import PositionBound, dive_bounds, true_states
from usbldr.filters.bounds.pcrlb import BATCH_SIZE, Bounds, bounds, local_bounds, parallel_sum
from usbldr.filters.errors import UsageError
from usbldr.filters.estimators.protocol import Step
from usbldr.filters.models.calibration import STATES, layout_for
from usbldr.filters.models.motion import VehicleMotion
from usbldr.filters.models.noise import Gaussian, Mixture, Noise
from usbldr.filters.models.parameters import Parameters, ProcessNoise, Start
from usbldr.filters.models.sensors import DirectState, Measurement, UsblFix
from usbldr.filters.models.states import StateLayout
from usbldr.filters.replay.methods import FilterSettings
from usbldr.filters.replay.run import run
from usbldr.filters.replay.steps import steps
from usbldr.filters.simulation.scenario import Accuracy, Leg, Scenario, Timing
from usbldr.filters.simulation.simulate import simulate
from usbldr.filters.types import Timeline
from usbldr.io.reading.epochs import timeline
from usbldr.io.scenarios.shipped import find_scenario
from usbldr.io.scenarios.simulated_log import simulated_log

Q = (0.3, 0.1)
R = 0.8
NOISE = Gaussian().modes(np.array([[R]]))
EPOCHS = 40
F = np.array([[1.0, 1.0], [0.0, 1.0]])
PROCESS = ProcessNoise(0.1, 0.05, 0.08, 0.04)
PRIOR_COV = np.diag([0.2, 0.3, 0.3, 0.1, 2.0, 2.0]) ** 2


def linear(q: tuple[float, float] = Q, noise: Noise = NOISE) -> Bounds:
    steps = list(position_steps(np.zeros(EPOCHS), noise))
    return bounds(steps, Drift(q), np.zeros((EPOCHS, 2)), PRIOR.cov)


def batch(q: tuple[float, float], known: int) -> np.ndarray:
    """Return the covariance of every state given the first ``known`` readings, (EPOCHS, 2, 2), from one big Gaussian.

    All states are one linear function of the first state and of every step's noise: no recursion, no inverse of Q.
    """
    powers = [np.linalg.matrix_power(F, k) for k in range(EPOCHS)]
    response = np.zeros((EPOCHS, 2, EPOCHS, 2))  # of state k to source j: j = 0 the first state, else noise
    for k in range(EPOCHS):
        for j in range(k + 1):
            response[k, :, j] = powers[k - j]
    A = response.reshape(2 * EPOCHS, 2 * EPOCHS)
    sources = np.kron(np.eye(EPOCHS), np.diag(q))
    sources[:2, :2] = PRIOR.cov
    joint = A @ sources @ A.T
    H = np.kron(np.eye(EPOCHS), [[1.0, 0.0]])[:known]
    rest = joint - joint @ H.T @ np.linalg.solve(H @ joint @ H.T + R * np.eye(known), H @ joint)
    return np.array([rest[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] for k in range(EPOCHS)])


def test_of_a_linear_gaussian_model_the_filter_bound_settles_where_riccati_says() -> None:
    predicted = solve_discrete_are(F.T, np.array([[1.0], [0.0]]), np.diag(Q), np.array([[R]]))
    gain = predicted[:, :1] / (predicted[0, 0] + R)

    np.testing.assert_allclose(linear().filtered[-1], predicted - gain @ predicted[:1], rtol=1e-9)


@pytest.mark.parametrize("q", [Q, (0.3, 0.0), (0.0, 0.0)], ids=["drifting", "constant velocity", "no noise at all"])
def test_of_a_linear_gaussian_model_both_bounds_are_the_batch_solution(q: tuple[float, float]) -> None:
    got = linear(q)

    np.testing.assert_allclose(got.smoothed, batch(q, EPOCHS), rtol=1e-7, atol=1e-12)
    for k in (0, 1, 7, EPOCHS - 1):
        np.testing.assert_allclose(got.filtered[k], batch(q, k + 1)[k], rtol=1e-7, atol=1e-12)


def test_of_a_linear_gaussian_model_the_filter_bound_is_the_spread_of_the_optimal_filters_errors() -> None:
    """20,000 dives are drawn and filtered; all 160 sample covariances within 4.5 standard errors of Wishart's law."""
    rng = np.random.default_rng(0)
    dives, want = 20_000, linear().filtered
    x = PRIOR.mean[:, None] + np.linalg.cholesky(PRIOR.cov) @ rng.normal(size=(2, dives))
    m, P = np.repeat(PRIOR.mean[:, None], dives, axis=1), PRIOR.cov
    for k in range(EPOCHS):
        if k:
            x = F @ x + np.sqrt(Q)[:, None] * rng.normal(size=x.shape)
            m, P = F @ m, F @ P @ F.T + np.diag(Q)
        gain = P[:, :1] / (P[0, 0] + R)
        m = m + gain * (x[0] + math.sqrt(R) * rng.normal(size=dives) - m[0])
        P = P - gain @ P[:1]
        error, C = x - m, want[k]

        standard_error = np.sqrt((np.outer(C.diagonal(), C.diagonal()) + C**2) / dives)
        assert np.all(np.abs(error @ error.T / dives - C) < 4.5 * standard_error)


def test_with_mixture_noise_a_reading_counts_as_one_of_the_variance_that_its_information_has() -> None:
    """R = 0.8 with eq. (23) tells as much as N(0, 0.8 / 0.52894): the number is from quadrature, see test_fisher.py."""
    mixture = linear(noise=Mixture().modes(np.array([[R]])))
    plain = linear(noise=Gaussian().modes(np.array([[R / 0.52894]])))

    np.testing.assert_allclose(mixture.filtered, plain.filtered, rtol=2e-5)
    np.testing.assert_allclose(mixture.smoothed, plain.smoothed, rtol=2e-5)


def moved(x: np.ndarray, dt: float) -> np.ndarray:
    psi, u, v, r, east, north = x
    c, s = np.cos(psi + r * dt / 2), np.sin(psi + r * dt / 2)
    return np.array([psi + r * dt, u, v, r, east + (u * c - v * s) * dt, north + (u * s + v * c) * dt])


def wriggling_dives(count: int, process: ProcessNoise, prior_cov: np.ndarray) -> tuple[list[Step], np.ndarray]:
    """Return 25 steps of compass, DVL and late fixes, and truths (25, 6, count) drawn from motion and prior."""
    rng = np.random.default_rng(3)
    layout, dt = StateLayout(), 0.5
    scalar = Mixture().modes(np.array([[0.04]]))
    mean = np.array([0.3, 0.2, 1.2, 0.1, 5.0, -3.0])
    x = mean[:, None] + np.linalg.cholesky(prior_cov) @ rng.normal(size=(6, count))
    q = VehicleMotion(layout, process).noise(0.0, dt)
    steps, truth = [], []
    for k in range(25):
        t0, t1 = max(k - 1, 0) * dt, k * dt
        if k:
            x = moved(x, dt) + np.sqrt(q)[:, None] * rng.normal(size=x.shape)
        readings = [Measurement(np.zeros(1), DirectState(row), scalar, "dvl", "", k, t1) for row in (0, 1, 2)]
        if k % 4 == 0:
            fix = UsblFix(layout, -0.3, (0.4, -1.0, 0.0))
            readings.append(Measurement(np.zeros(2), fix, Gaussian().modes(np.eye(2)), "usbl", "position", k, t1))
        steps.append(Step(k, t0, t1, tuple(readings)))
        truth.append(x)
    return steps, np.array(truth)


def differences(function, x: np.ndarray) -> np.ndarray:
    """Return a Jacobian by central differences, (k, n)."""
    eps = 1e-5
    columns = [(function(x + eps * e) - function(x - eps * e)) / (2 * eps) for e in np.eye(len(x))]
    return np.stack(columns, axis=1)


@pytest.mark.parametrize("count", [1, 12])
def test_of_a_bent_model_it_is_the_recursion_of_the_paper_and_the_inverse_of_the_joint_information(count: int) -> None:
    """Eqs. (21), (34) to (36) of Tichavsky et al., written out with inverses, expectations over the drawn truths."""
    steps, truth = wriggling_dives(count, PROCESS, PRIOR_COV)
    motion = VehicleMotion(StateLayout(), PROCESS)

    got = bounds(steps, motion, truth if count > 1 else truth[:, :, 0], PRIOR_COV)

    fisher = {1: 0.52894 / 0.04 * np.eye(1), 2: np.eye(2)}
    J = np.linalg.inv(PRIOR_COV)
    joint = np.zeros((25, 6, 25, 6))
    joint[0, :, 0] = J
    for k, step in enumerate(steps):
        draws = range(count)
        if k:
            W = np.linalg.inv(np.diag(motion.noise(step.t0_s, step.t1_s)))
            Fs = [differences(lambda x: moved(x, 0.5), truth[k - 1, :, i]) for i in draws]
            D11 = np.mean([f.T @ W @ f for f in Fs], axis=0)
            D12 = -np.mean(Fs, axis=0).T @ W
            J = W - D12.T @ np.linalg.inv(J + D11) @ D12
            joint[k - 1, :, k - 1] += D11
            joint[k - 1, :, k] += D12
            joint[k, :, k - 1] += D12.T
            joint[k, :, k] += W
        for reading in step.measurements:
            Hs = [differences(lambda x, g=reading.model: g.predict(x[:, None])[:, 0], truth[k, :, i]) for i in draws]
            G = np.mean([h.T @ fisher[len(h)] @ h for h in Hs], axis=0)
            J = J + G
            joint[k, :, k] += G
        np.testing.assert_allclose(got.filtered[k], np.linalg.inv(J), rtol=2e-5, atol=1e-8)
    everything = np.linalg.inv(joint.reshape(150, 150)).reshape(25, 6, 25, 6)
    for k in range(25):
        np.testing.assert_allclose(got.smoothed[k], everything[k, :, k], rtol=2e-5, atol=1e-8)


def test_a_state_that_is_known_stays_known_and_the_others_have_the_bound_without_it() -> None:
    process = ProcessNoise(0.1, 0.05, 0.08, 0.0)  # no turn, and none assumed
    prior_cov = np.diag([0.2, 0.3, 0.3, 0.0, 2.0, 2.0]) ** 2
    nearly = np.diag([0.2, 0.3, 0.3, 1e-7, 2.0, 2.0]) ** 2
    steps, truth = wriggling_dives(1, process, nearly)

    got = bounds(steps, VehicleMotion(StateLayout(), process), truth, prior_cov)
    want = bounds(steps, VehicleMotion(StateLayout(), process), truth, nearly)

    np.testing.assert_allclose(got.smoothed[:, 3], 0, atol=1e-15)
    np.testing.assert_allclose(got.smoothed, want.smoothed, atol=1e-9)
    np.testing.assert_allclose(got.filtered, want.filtered, atol=1e-9)


def test_truths_that_differ_have_no_bound_where_the_motion_bends_without_noise() -> None:
    process = ProcessNoise(0.0, 0.05, 0.08, 0.04)
    steps, truth = wriggling_dives(3, process, PRIOR_COV)
    motion = VehicleMotion(StateLayout(), process)

    bounds(steps, motion, truth[:, :, 0], PRIOR_COV)  # one truth has one
    with pytest.raises(UsageError, match="no bound over several truths"):
        bounds(steps, motion, truth, PRIOR_COV)


def test_local_bounds_are_the_mean_of_each_truths_own_and_lie_above_the_bound_of_all() -> None:
    """(E J)^-1 is at most E (J^-1), in the sense of matrices, for the joint information of the whole dive."""
    steps, truth = wriggling_dives(BATCH_SIZE + 3, PROCESS, PRIOR_COV)
    motion = VehicleMotion(StateLayout(), PROCESS)
    each = [bounds(steps, motion, truth[:, :, i], PRIOR_COV) for i in range(BATCH_SIZE + 3)]

    local, joint = (function(steps, motion, truth, PRIOR_COV) for function in (local_bounds, bounds))

    for i in (0, 1):  # filter, smoother
        np.testing.assert_allclose(local[i], np.mean([one[i] for one in each], axis=0), rtol=1e-9, atol=1e-13)
        assert np.linalg.eigvalsh(local[i] - joint[i]).min() > -1e-10
    assert joint.filtered[-1, 0, 0] < 0.99 * local.filtered[-1, 0, 0]


def test_parallel_is_the_inverse_of_the_sum_of_inverses() -> None:
    rng = np.random.default_rng(4)
    a, b = (root @ root.T for root in rng.normal(size=(2, 5, 5)))
    np.testing.assert_allclose(parallel_sum(a, b), np.linalg.inv(np.linalg.inv(a) + b), rtol=1e-8)
    assert parallel_sum(np.diag([0.0, 2.0]), np.diag([3.0, 1.0])).tolist() == [[0.0, 0.0], [0.0, 2.0 / 3.0]]


def test_the_bounds_of_absolute_errors_are_those_of_drawn_gaussians() -> None:
    sd_m = np.array([[0.5, 3.0], [2.0, 1.0]])
    draws = np.abs(np.random.default_rng(5).normal(size=(200_000, 2, 2)) * sd_m)
    bound = PositionBound(np.arange(2.0), sd_m, 2.0 * sd_m)
    np.testing.assert_allclose(bound.filter_m, draws.mean(axis=(0, 1)), rtol=0.01)
    np.testing.assert_allclose(bound.smoother_m, 2.0 * draws.mean(axis=(0, 1)), rtol=0.01)


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
