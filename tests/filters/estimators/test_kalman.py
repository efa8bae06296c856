"""The single-Gaussian filters and their smoother against another library's, the bound, grids and the textbook."""

import functools
import math
from dataclasses import replace

import numpy as np
import pytest
from filterpy.kalman import CubatureKalmanFilter, JulierSigmaPoints, KalmanFilter, UnscentedKalmanFilter

from textbook import PRIOR, Drift, estimates, grid_posterior, position_steps
from uncalibrated import dive_without_calibration
from usbldr.filters.bounds.pcrlb import bounds
from usbldr.filters.errors import UsageError
from usbldr.filters.estimators.gaussian_bank import Projection, inverse_and_logdet, predict, project, replicate, update
from usbldr.filters.estimators.kalman import KalmanFilter as OurKalmanFilter
from usbldr.filters.estimators.kalman import Recovery
from usbldr.filters.estimators.mode_updates import Gate, collapse, mode_likelihoods, moment_matched
from usbldr.filters.estimators.protocol import Estimate, Prior, Step
from usbldr.filters.estimators.rts_smoother import smooth
from usbldr.filters.models.calibration import STATES, layout_for
from usbldr.filters.models.motion import VehicleMotion
from usbldr.filters.models.noise import Contamination, Gaussian, Mixture, StudentT
from usbldr.filters.models.parameters import ProcessNoise
from usbldr.filters.models.sensors import DirectState, Measurement, UsblFix, compass_model, dvl_models
from usbldr.filters.models.sigma_points import cubature, linearised, unscented
from usbldr.filters.models.states import StateLayout
from usbldr.filters.replay.methods import METHODS, FilterSettings
from usbldr.filters.replay.run import run as run_dive
from usbldr.io.reading.epochs import timeline
from usbldr.io.scenarios.shipped import find_scenario

Q = (0.05, 0.02)
LOUD = (0.3, 0.2)
NOISE = Gaussian().modes(np.array([[0.8]]))
run = functools.partial(estimates, seed=None)


def filtered(
    z: np.ndarray, rule=linearised, q: tuple[float, float] = LOUD, mode_update=moment_matched
) -> tuple[np.ndarray, np.ndarray]:
    """Return our filter's means (K, 2) and covariances (K, 2, 2)."""
    reported = run(OurKalmanFilter(Drift(q), rule, mode_update), position_steps(z, NOISE))
    return np.array([e.mean for e in reported]), np.array([e.cov for e in reported])


@pytest.mark.parametrize("rule", [linearised, cubature, unscented], ids=["ekf", "ckf", "ukf"])
def test_on_a_linear_model_filter_and_smoother_are_those_of_another_library(rule) -> None:
    z = np.cumsum(np.random.default_rng(0).normal(1.0, 1.0, size=80))
    other = KalmanFilter(dim_x=2, dim_z=1)
    other.x, other.P = PRIOR.mean[:, None].copy(), PRIOR.cov.copy()
    other.F, other.H = np.array([[1.0, 1.0], [0.0, 1.0]]), np.array([[1.0, 0.0]])
    other.Q, other.R = np.diag(LOUD), np.array([[0.8]])
    kept = []
    for k, value in enumerate(z):
        if k:
            other.predict()
        other.update(value)
        kept.append((other.x.copy(), other.P.copy()))
    forward_mean, forward_cov = (np.array(part) for part in zip(*kept, strict=True))
    want_mean, want_cov, _, _ = other.rts_smoother(forward_mean, forward_cov)

    for mode_update in (moment_matched, collapse):
        mean, cov = filtered(z, rule, mode_update=mode_update)
        np.testing.assert_allclose(mean, forward_mean[:, :, 0], atol=1e-10)
        np.testing.assert_allclose(cov, forward_cov, atol=1e-10)
        mean, cov = smooth(mean, cov, np.ones(80), np.zeros((80, 2)), np.arange(80.0), Drift(LOUD), rule)
        np.testing.assert_allclose(mean, want_mean[:, :, 0], atol=1e-9)
        np.testing.assert_allclose(cov, want_cov, atol=1e-9)


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


@pytest.mark.parametrize("family", [Gaussian(), Mixture(), Contamination(), StudentT()], ids=lambda f: type(f).__name__)
@pytest.mark.parametrize("z", [0.3, 2.0, 6.0, -11.0])
def test_collapse_keeps_the_moments_of_the_grid_posterior(family, z: float) -> None:
    noise = family.modes(np.array([[0.7]]))
    bank = replicate(np.array([0.5]), np.array([[2.0]]), 1)
    seen = project(bank, Measurement(np.array([z]), DirectState(0), noise, "usbl", "east", 0, 0.0), cubature)

    after, log_l, rejected = collapse(bank, seen, noise)

    mean, variance, evidence = grid_posterior(0.5, 2.0, z, noise)
    assert after.mean[0, 0] == pytest.approx(mean, abs=1e-8)
    assert after.cov[0, 0, 0] == pytest.approx(variance, abs=1e-8)
    assert math.exp(log_l[0]) == pytest.approx(evidence, rel=1e-8)
    assert not rejected


def test_collapse_of_a_two_dimensional_fix_keeps_the_moments_of_the_mixture_of_updates() -> None:
    rng = np.random.default_rng(0)
    root = rng.normal(size=(6, 6))
    bank = replicate(rng.normal(size=6), root @ root.T, 1)
    noise = Mixture(0.4, 20.0).modes(np.array([[0.5, 0.2], [0.2, 0.9]]))
    reading = Measurement(np.array([2.0, -3.0]), UsblFix(StateLayout(), -0.4), noise, "usbl", "position", 0, 0.0)
    seen = project(bank, reading, cubature)

    after, *_ = collapse(bank, seen, noise)

    branches, weights = [], []
    for share, R in zip(noise.probabilities, noise.cov, strict=True):
        S = seen.cov[:, :, 0] + R
        K = seen.cross[:, :, 0] @ np.linalg.inv(S)
        e = seen.innovation[:, 0]
        branches.append((bank.mean[:, 0] + K @ e, bank.cov[:, :, 0] - K @ S @ K.T))
        weights.append(share * math.exp(-0.5 * e @ np.linalg.solve(S, e)) / math.sqrt(np.linalg.det(S)))
    p = np.array(weights) / sum(weights)
    mean = sum(w * m for w, (m, _) in zip(p, branches, strict=True))
    cov = sum(w * (P + np.outer(m - mean, m - mean)) for w, (m, P) in zip(p, branches, strict=True))
    np.testing.assert_allclose(after.mean[:, 0], mean, atol=1e-12)
    np.testing.assert_allclose(after.cov[:, :, 0], cov, atol=1e-12)
    np.testing.assert_array_equal(after.cov, after.cov.swapaxes(0, 1))


def test_per_scalar_and_joint_updates_agree_where_the_noise_is_gaussian_and_round() -> None:
    rng = np.random.default_rng(1)
    root = rng.normal(size=(6, 6))
    bank = replicate(rng.normal(size=6), root @ root.T, 1)
    R, z = 0.8 * np.eye(2), np.array([1.0, 2.0])
    joint = Measurement(z, UsblFix(StateLayout(), 0.0), Gaussian().modes(R), "usbl", "position", 0, 0.0)
    together, *_ = moment_matched(bank, project(bank, joint, cubature), joint.noise)
    apart = bank
    for axis in (0, 1):
        noise = Gaussian().modes(R[:1, :1])
        model = UsblFix(StateLayout(), 0.0, axes=(axis,))
        scalar = Measurement(z[axis : axis + 1], model, noise, "usbl", "east", 0, 0.0)
        apart, *_ = moment_matched(apart, project(apart, scalar, cubature), noise)

    np.testing.assert_allclose(apart.mean, together.mean, atol=1e-12)
    np.testing.assert_allclose(apart.cov, together.cov, atol=1e-12)


def test_a_thousand_updates_leave_covariances_symmetric_and_positive() -> None:
    """An asymmetric P in batched updates once grew into negative variances after some 400 s."""
    rng = np.random.default_rng(2)
    bank = replicate(np.zeros(6), np.diag([0.1, 1, 1, 0.1, 9, 9.0]), 8)
    noise = Mixture().modes(np.array([[0.5, 0.1], [0.1, 0.6]]))
    for k in range(1000):
        bank = bank._replace(cov=bank.cov + 1e-4 * np.eye(6)[:, :, None])
        z = rng.normal(size=2)
        reading = Measurement(z, UsblFix(StateLayout(), -0.1), noise, "usbl", "position", k, 0.0)
        bank, *_ = collapse(bank, project(bank, reading, cubature), noise)

    np.testing.assert_array_equal(bank.cov, bank.cov.swapaxes(0, 1))
    assert np.linalg.eigvalsh(np.moveaxis(bank.cov, -1, 0)).min() > 0


def test_small_inverses_agree_with_lapack() -> None:
    rng = np.random.default_rng(3)
    for k in (1, 2, 3):
        root = rng.normal(size=(4, 7, k, k))
        S = np.moveaxis(root @ root.swapaxes(-1, -2) + 0.1 * np.eye(k), 1, -1)
        inverse, logdet = inverse_and_logdet(S)
        for j in range(4):
            for i in range(7):
                np.testing.assert_allclose(inverse[j, :, :, i], np.linalg.inv(S[j, :, :, i]), rtol=1e-9)
                assert logdet[j, i] == pytest.approx(np.linalg.slogdet(S[j, :, :, i])[1], abs=1e-9)


def test_the_modes_likelihood_survives_a_hopeless_outlier() -> None:
    noise = Mixture().modes(np.array([[1.0]]))
    seen = Projection(np.array([[1e4]]), np.array([[[1.0]]]), np.array([[[1.0]]]))

    weighed = mode_likelihoods(seen, noise)

    assert np.isfinite(weighed.log_likelihood).all()
    np.testing.assert_allclose(weighed.probability.sum(axis=0), 1)


def test_a_gate_refuses_the_unlikely_and_uses_the_nominal_mode_alone() -> None:
    noise = Contamination(0.05, 10.0).modes(np.array([[1.0]]))
    bank = replicate(PRIOR.mean, PRIOR.cov, 1)
    far = Measurement(np.array([12.0]), DirectState(0), noise, "usbl", "east", 0, 0.0)
    near = far._replace(z=np.array([1.0]))
    gate = Gate(0.99)

    kept, _, refused = gate(bank, project(bank, far, cubature), noise)
    taken, *_ = gate(bank, project(bank, near, cubature), noise)

    assert refused
    assert kept is bank
    np.testing.assert_allclose(taken.mean, update(bank, project(bank, near, cubature), noise.cov[0, :, :, None]).mean)


PAPER = find_scenario("paper")


@pytest.mark.parametrize("q", [(0.3, 0.2), (0.3, 0.0), (0.0, 0.0)], ids=["drifting", "constant velocity", "no noise"])
def test_on_a_linear_model_its_covariance_is_the_smoothers_bound(q: tuple[float, float]) -> None:
    """The bound adds up information from the future and knows no gain."""
    z = np.zeros(80)  # of which no covariance depends
    want = bounds(list(position_steps(z, NOISE)), Drift(q), np.zeros((80, 2)), PRIOR.cov)

    mean, cov = filtered(z, q=q)
    np.testing.assert_allclose(cov, want.filtered, rtol=1e-7, atol=1e-12)
    _, smoothed = smooth(mean, cov, np.ones(80), np.zeros((80, 2)), np.arange(80.0), Drift(q), linearised)

    np.testing.assert_allclose(smoothed, want.smoothed, rtol=1e-6, atol=1e-9)


def test_an_inflated_or_widened_prediction_counts_as_more_noise() -> None:
    z = np.random.default_rng(1).normal(size=12).cumsum()
    mean, cov = filtered(z)
    doubled, lost, none = np.ones(12), np.zeros((12, 2)), np.zeros((12, 2))
    doubled[6], lost[6] = 2.0, 1e12  # [m2] independent noise: the past says nothing of what comes after

    how = ((np.ones(12), none), (doubled, none), (np.ones(12), lost))
    whole, inflated, widened = (smooth(mean, cov, *of, np.arange(12.0), Drift(LOUD), linearised)[1] for of in how)

    np.testing.assert_allclose(widened[5], cov[5], rtol=1e-6)
    np.testing.assert_array_equal(widened[6:], whole[6:])
    assert whole[5, 0, 0] < inflated[5, 0, 0] < cov[5, 0, 0]


def test_a_state_that_is_known_exactly_stays_known() -> None:
    """Velocity without variance or noise: the position alone is smoothed, as by solving for it alone."""
    still = Drift((0.3, 0.0))
    mean = np.array([[0.0, 1.0], [1.2, 1.0], [1.9, 1.0]])
    cov = np.zeros((3, 2, 2))
    cov[:, 0, 0] = 0.5, 0.4, 0.3

    smoothed_mean, smoothed_cov = smooth(mean, cov, np.ones(3), np.zeros((3, 2)), np.arange(3.0), still, cubature)

    gain = 0.4 / (0.4 + 0.3)
    assert smoothed_mean[1, 0] == pytest.approx(1.2 + gain * (1.9 - 2.2))
    assert smoothed_cov[1, 0, 0] == pytest.approx(0.4 + gain**2 * (0.3 - 0.7))
    np.testing.assert_array_equal(smoothed_mean[:, 1], 1.0)
    assert not smoothed_cov[:, 1].any()


@pytest.mark.parametrize("name", ["ekf", "ckf", "adf", "cpf", "pf-wekf"])
def test_smoothing_leaves_the_last_epoch_and_narrows_the_others(name: str) -> None:
    log = dive_without_calibration(replace(PAPER, duration_s=60.0), 3)
    line = timeline(log)
    assumed = replace(log.parameters, calibrate=("scale", "misalignment"))
    plain, smoothed = (run_dive(name, line, assumed, FilterSettings(particles=20, smooth=on)) for on in (False, True))

    assert (plain.label, smoothed.label) == (name, f"{name} smoothed")
    np.testing.assert_array_equal(smoothed.mean[-1], plain.mean[-1])
    assert smoothed.cov is not None
    assert plain.cov is not None
    spread = np.einsum("kii->ki", plain.cov)
    narrowed = np.einsum("kii->ki", smoothed.cov)
    if name != "cpf":  # whose covariance is that of a mixture, which the pass takes for one Gaussian
        assert (narrowed <= spread * (1 + 1e-6)).all()
    assert narrowed[:200, 4:6].mean() < 0.8 * spread[:200, 4:6].mean()
    np.testing.assert_array_equal(smoothed.cov[:-1], smoothed.cov[:-1].swapaxes(1, 2))


def test_only_what_is_near_a_gaussian_is_smoothed() -> None:
    log = dive_without_calibration(replace(PAPER, duration_s=5.0), 0)
    line = timeline(log)
    with pytest.raises(UsageError, match="pf is too far from a Gaussian"):
        run_dive("pf", line, log.parameters, FilterSettings(smooth=True))
    assert METHODS["pf"].smoother_transform is None
