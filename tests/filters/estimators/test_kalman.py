"""The single-Gaussian filters against another library's and against each other."""

import functools
import math

import numpy as np
import pytest
from filterpy.kalman import CubatureKalmanFilter, JulierSigmaPoints, KalmanFilter, UnscentedKalmanFilter

from textbook import PRIOR, Drift, estimates, position_steps
from usbldr.filters.estimators.gate_recovery import Recovery
from usbldr.filters.estimators.gaussian_bank import predict, project, replicate, update
from usbldr.filters.estimators.kalman import KalmanFilter as OurKalmanFilter
from usbldr.filters.estimators.mode_updates import Gate, collapse, moment_matched
from usbldr.filters.estimators.protocol import Estimate, Prior, Step
from usbldr.filters.models.calibration import STATES, layout_for
from usbldr.filters.models.motion import VehicleMotion
from usbldr.filters.models.noise import Contamination, Gaussian, Mixture
from usbldr.filters.models.parameters import ProcessNoise
from usbldr.filters.models.sensors import DirectState, Measurement, UsblFix, compass_model, dvl_models
from usbldr.filters.models.sigma_points import cubature, linearised, unscented
from usbldr.filters.models.states import StateLayout

Q = (0.05, 0.02)
run = functools.partial(estimates, seed=None)


def test_on_a_linear_model_ekf_ckf_and_ukf_are_the_kalman_filter_of_another_library() -> None:
    z = np.cumsum(np.random.default_rng(0).normal(1.0, 1.0, size=60))
    noise = Gaussian().modes(np.array([[0.8]]))
    other = KalmanFilter(dim_x=2, dim_z=1)
    other.x, other.P = PRIOR.mean[:, None].copy(), PRIOR.cov.copy()
    other.F, other.H = np.array([[1.0, 1.0], [0.0, 1.0]]), np.array([[1.0, 0.0]])
    other.Q, other.R = np.diag(Q), np.array([[0.8]])
    want = []
    for k, value in enumerate(z):
        if k:
            other.predict()
        other.update(value)
        want.append((other.x[:, 0].copy(), other.P.copy()))

    for rule in (linearised, cubature, unscented):
        for mode_update in (moment_matched, collapse):
            got = run(OurKalmanFilter(Drift(Q), rule, mode_update), position_steps(z, noise))
            for estimate, (mean, cov) in zip(got, want, strict=True):
                np.testing.assert_allclose(estimate.mean, mean, atol=1e-10)
                np.testing.assert_allclose(estimate.cov, cov, atol=1e-10)


@pytest.mark.parametrize("rule", [cubature, unscented], ids=["ckf", "ukf"])
def test_on_a_bent_model_ckf_and_ukf_are_those_of_another_library(rule) -> None:
    """Only the move is non-linear: our three parts equal one pass of sigma points while r has no spread."""
    rng = np.random.default_rng(1)
    n, dt, R = 6, 0.5, 0.3 * np.eye(2)
    process = ProcessNoise(0.1, 0.02, 0.05, 0.0)
    q = np.diag(np.array([0.02, 0.05, 0.05, 0.0, 0.1, 0.1]) ** 2 * dt)
    m0 = np.array([0.4, 0.3, 1.5, 0.0, 0.0, 0.0])
    P0 = np.diag([0.3, 0.2, 0.2, 1e-12, 1.0, 1.0]) ** 2

    def fx(x: np.ndarray, dt: float) -> np.ndarray:
        psi, u, v, r, east, north = np.ravel(x)
        c, s = math.cos(psi), math.sin(psi)
        y = np.array([psi + r * dt, u, v, r, east + (u * c - v * s) * dt, north + (u * s + v * c) * dt])
        return y.reshape(np.shape(x))

    def hx(x: np.ndarray) -> np.ndarray:
        return x[4:6]

    if rule is cubature:
        other = CubatureKalmanFilter(dim_x=n, dim_z=2, dt=dt, hx=hx, fx=fx)
        other.x = m0[:, None].copy()
    else:
        # its points come from an upper root: ours with psi first is the lower one
        points = JulierSigmaPoints(n, kappa=3 - n, sqrt_method=lambda A: np.linalg.cholesky(A).T)
        other = UnscentedKalmanFilter(dim_x=n, dim_z=2, dt=dt, hx=hx, fx=fx, points=points)
        other.x = m0.copy()
    other.P, other.Q, other.R = P0.copy(), q, R
    bank = replicate(m0, P0, 1)
    motion = VehicleMotion(StateLayout(), process)
    for k in range(15):
        z = np.array([-0.4 * k, 0.6 * k]) + rng.normal(size=2)
        other.predict()
        bank = predict(bank, motion, rule, k * dt, (k + 1) * dt)
        np.testing.assert_allclose(bank.mean[:, 0], np.ravel(other.x), atol=2e-6)
        np.testing.assert_allclose(bank.cov[:, :, 0], other.P, atol=2e-6)
        # the fix is linear: the update has one right answer
        reading = Measurement(z, UsblFix(StateLayout(), 0.0), Gaussian().modes(R), "usbl", "position", k, 0.0)
        bank = update(bank, project(bank, reading, rule), R[:, :, None])
        H = np.eye(6)[4:6]
        K = other.P @ H.T @ np.linalg.inv(H @ other.P @ H.T + R)
        other.x = (np.ravel(other.x) + K @ (z - H @ np.ravel(other.x))).reshape(np.shape(other.x))
        other.P = (np.eye(6) - K @ H) @ other.P
        other.P = 0.5 * (other.P + other.P.T)
        np.testing.assert_allclose(bank.mean[:, 0], np.ravel(other.x), atol=2e-6)


def test_matched_takes_the_mixture_for_one_wide_gaussian() -> None:
    z = np.random.default_rng(3).normal(size=30)
    mixture = run(OurKalmanFilter(Drift(Q), cubature, moment_matched), position_steps(z, Mixture().modes(np.eye(1))))
    one_gaussian = Gaussian().modes(3.7 * np.eye(1))
    wide = run(OurKalmanFilter(Drift(Q), cubature, moment_matched), position_steps(z, one_gaussian))
    for a, b in zip(mixture, wide, strict=True):
        np.testing.assert_allclose(a.mean, b.mean, atol=1e-12)
        np.testing.assert_allclose(a.cov, b.cov, atol=1e-12)


def test_a_gated_filter_drops_one_outlier_and_comes_back_from_a_lockout() -> None:
    noise = Contamination(0.05, 50.0).modes(np.eye(1))
    gated = OurKalmanFilter(Drift((1e-4, 1e-6)), cubature, Gate(), recoveries={"east": Recovery((0,), 10, True)})
    one_outlier = np.where(np.arange(40) == 20, 60.0, np.arange(40) * 1.0)
    jumped = np.arange(60) * 1.0 + np.where(np.arange(60) >= 20, 80.0, 0.0)

    dropped = run(gated, position_steps(one_outlier, noise))
    recovered = run(gated, position_steps(jumped, noise))

    assert [k for k, e in enumerate(dropped) if e.updates[0].outcome == "rejected"] == [20]
    assert all(e.updates[0].outcome == "rejected" for e in recovered[20:30])
    assert recovered[30].updates[0].outcome != "rejected"
    assert abs(recovered[30].mean[0] - jumped[30]) < 5  # at once, not by inches
    assert abs(recovered[-1].mean[0] - jumped[-1]) < 1
    assert [k for k, e in enumerate(recovered) if np.any(e.widening)] == [30]
    assert not any(np.any(e.widening) for e in dropped)


def refused_ten_times_and_once_more(sensor: str, axis: str, model, z: np.ndarray) -> tuple[Estimate, Estimate]:
    """Return the estimates before the first and after the eleventh of measurements that a gate refuses."""
    layout = layout_for(tuple(STATES))
    root = 0.1 * np.random.default_rng(4).normal(size=(len(layout), len(layout)))
    prior = Prior(np.r_[0.4, 0.1, 1.2, 0.0, 5.0, -3.0, np.zeros(len(layout) - 6)], root @ root.T)
    noise = Gaussian().modes(1e-4 * np.eye(len(z)))
    motion = VehicleMotion(layout, ProcessNoise())
    steps = [Step(k, 0.0, 0.0, (Measurement(z, model(layout), noise, sensor, axis, k, 0.0),)) for k in range(11)]
    found = run(OurKalmanFilter(motion, linearised, Gate()), [Step(0, 0.0, 0.0, ()), *steps], prior)
    return found[0], found[-1]


@pytest.mark.parametrize(
    ("sensor", "axis", "model", "z", "widened_states"),
    [
        ("usbl", "position", lambda layout: UsblFix(layout, 0.0), np.array([50.0, 80.0]), {"x", "y"}),
        ("dvl", "forward", lambda layout: dvl_models(layout, (0.0, 0.0, 0.0))[1], np.array([1e6]), {"v"}),
        ("compass", "yaw", compass_model, np.array([3.0]), set()),
    ],
)
def test_refusals_widen_only_what_the_sensor_measures_of_the_motion(sensor, axis, model, z, widened_states) -> None:
    layout = layout_for(tuple(STATES))
    before, after = refused_ten_times_and_once_more(sensor, axis, model, z)

    assert {layout.names[row] for row in np.flatnonzero(np.asarray(after.widening))} == widened_states
    apart = [row for row, name in enumerate(layout.names) if name not in ("u", "v", "x", "y")]
    spread = np.ix_(apart, apart)
    assert (after.cov[spread].diagonal() <= before.cov[spread].diagonal() * (1 + 1e-9)).all()


def test_a_position_that_gives_way_hardly_moves_sensor_errors() -> None:
    """The jump of a track by 94 m says nothing of a compass: independent noise explains it."""
    before, after = refused_ten_times_and_once_more(
        "usbl", "position", lambda layout: UsblFix(layout, 0.0), np.array([50.0, 80.0])
    )
    layout = layout_for(("scale", "misalignment", "heading", "deviation", "latency", "usbl-bias"))

    np.testing.assert_allclose(after.mean[list(layout.rows("x", "y"))], [50.0, 80.0], atol=1.0)
    for name in ("dvl_scale", "heading_bias", "deviation_sin", "deviation_cos", "usbl_latency"):
        row = layout.index(name)
        assert abs(after.mean[row] - before.mean[row]) < math.sqrt(before.cov[row, row])


def test_a_gate_follows_a_manoeuvre_within_a_second_and_no_spike() -> None:
    """The vehicle speeds up by 0.5 m/s at once; a spike of 3 m/s changes the velocity by less than its sigma."""
    motion = VehicleMotion(StateLayout(), ProcessNoise())
    prior = Prior(np.array([0.0, 0, 1, 0, 0, 0]), np.diag([0.01, 0.02, 0.02, 0.001, 1, 1]) ** 2)
    noise = Gaussian().modes(np.array([[0.02**2]]))

    def forward(z: np.ndarray) -> list[float]:
        read = [(Measurement(z[k : k + 1], DirectState(2), noise, "dvl", "forward", k, 0.0),) for k in range(len(z))]
        steps = [Step(k, 0.2 * k, 0.2 * (k + 1), reading) for k, reading in enumerate(read)]
        return [e.mean[2] for e in run(OurKalmanFilter(motion, cubature, Gate()), steps, prior)]

    t = np.arange(40)

    assert abs(forward(np.where(t < 20, 1.0, 1.5))[24] - 1.5) < 0.05
    assert abs(np.array(forward(np.where(t == 20, 4.0, 1.0))) - 1.0).max() < 0.02


def test_a_good_scalar_does_not_excuse_the_refused_one_beside_it() -> None:
    """East is 60 m off and refused, north is right: east's refusals alone must reopen the gate."""
    noise = Contamination(0.05, 50.0).modes(np.eye(1))
    motion = VehicleMotion(StateLayout(), ProcessNoise(1e-3, 1e-4, 1e-3, 1e-5))
    prior = Prior(np.array([0.0, 0, 0, 0, 60.0, 0.0]), np.diag([0.01, 0.01, 0.01, 0.001, 1, 1]) ** 2)
    axes = [(name, UsblFix(StateLayout(), 0.0, axes=(axis,))) for axis, name in enumerate(("east", "north"))]
    fixes = [
        [Measurement(np.zeros(1), model, noise, "usbl", name, k, float(k)) for name, model in axes] for k in range(20)
    ]
    steps = [Step(k, float(max(k - 1, 0)), float(k), tuple(both)) for k, both in enumerate(fixes)]

    east = [estimate.mean[4] for estimate in run(OurKalmanFilter(motion, cubature, Gate()), steps, prior)]

    assert east[5] > 50
    assert abs(east[-1]) < 3
