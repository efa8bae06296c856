"""Moments through a function, against all 2n points written out and against finite differences."""

import numpy as np
import pytest

from usbldr.filters.models import sensors
from usbldr.filters.models.calibration import STATES, layout_for
from usbldr.filters.models.motion import GaussMarkovIncrement, PositionIncrement, YawIncrement
from usbldr.filters.models.sensors import BodyVelocity, DirectState, UsblFix
from usbldr.filters.models.sigma_points import Unscented, cubature, linearised
from usbldr.filters.models.states import StateLayout

LAYOUT = StateLayout()
ERRING = layout_for(tuple(STATES))  # with every calibration state
STARBOARD, FORWARD = sensors.dvl_models(ERRING, (0.4, -1.1, 0.2))
FUNCTIONS = {
    "turn": YawIncrement(3, 0.1),
    "move": PositionIncrement((0,), (1, 2), 0.7),
    "compass": sensors.compass_model(LAYOUT),
    "dvl at the reference point": DirectState(1),
    "dvl on a lever": sensors.dvl_models(LAYOUT, (0.4, -1.1, 0.2))[0],
    "erring dvl, starboard": STARBOARD,
    "erring dvl, forward": FORWARD,
    "dvl through the water": sensors.dvl_models(layout_for(("current",)), (0.0, 0.0, 0.0))[1],
    "dvl with a scale": sensors.dvl_models(layout_for(("scale",)), (0.0, 0.0, 0.0))[1],
    "erring compass": sensors.compass_model(ERRING),
    "biased compass": sensors.compass_model(layout_for(("heading",))),
    "correlated error": GaussMarkovIncrement(
        ERRING.rows("usbl_bias_east", "usbl_bias_north"), np.array([0.8, 0.6]), np.array([0.0, 0.3])
    ),
    "late fix with a correlated error": UsblFix(ERRING, -0.3, (0.4, -1.1, 0.2)),
    "fix of the epoch": UsblFix(LAYOUT, 0.0),
    "fix of some time ago": UsblFix(LAYOUT, -1.7),
    "fix on a lever": UsblFix(LAYOUT, -0.3, (0.4, -1.1, 0.2)),
    "north of a fix": UsblFix(LAYOUT, -0.3, (0.4, -1.1, 0.2), (1,)),
}


@pytest.fixture(params=FUNCTIONS, ids=list(FUNCTIONS))
def function(request):
    return FUNCTIONS[request.param]


def random_gaussian(rng: np.random.Generator, n: int = len(ERRING)) -> tuple[np.ndarray, np.ndarray]:
    root = rng.normal(size=(n, n)) * 0.03  # angles stay well within half a turn
    return rng.normal(size=n), root @ root.T + 0.01 * np.eye(n)


def every_point(g, m: np.ndarray, P: np.ndarray, kappa: float):
    """The textbook: 2n + 1 points of a Cholesky root that takes the curved states first."""
    n = len(m)
    order = [*g.nonlinear, *(i for i in range(n) if i not in g.nonlinear)]
    root = np.zeros((n, n))
    root[order] = np.linalg.cholesky(P[np.ix_(order, order)])
    points = np.concatenate(
        [m[:, None], m[:, None] + np.sqrt(n + kappa) * root, m[:, None] - np.sqrt(n + kappa) * root], axis=1
    )
    weights = np.array([kappa / (n + kappa)] + [0.5 / (n + kappa)] * (2 * n))
    values = g.predict(points)
    mean = values @ weights
    dy, dx = values - mean[:, None], points - m[:, None]
    return mean, (weights * dy) @ dy.T, (weights * dx) @ dy.T


@pytest.mark.parametrize("kappa", [0.0, 1.5, -3.0])
def test_few_points_and_the_affine_rest_equal_all_the_points(function, kappa: float) -> None:
    rng = np.random.default_rng(0)
    for _ in range(20):
        m, P = random_gaussian(rng)

        mean, cov, cross = Unscented(kappa)(function, m[:, None], P[:, :, None])

        want_mean, want_cov, want_cross = every_point(function, m, P, kappa)
        np.testing.assert_allclose(mean[:, 0], want_mean, atol=1e-12)
        np.testing.assert_allclose(cov[:, :, 0], want_cov, atol=1e-11)
        np.testing.assert_allclose(cross[:, :, 0], want_cross, atol=1e-12)


def test_cubature_is_unscented_with_kappa_0_and_julier_takes_n_plus_kappa_3(function) -> None:
    m, P = random_gaussian(np.random.default_rng(1))

    for a, b in ((cubature, Unscented(0.0)), (Unscented(), Unscented(3.0 - len(ERRING)))):
        for left, right in zip(
            a(function, m[:, None], P[:, :, None]), b(function, m[:, None], P[:, :, None]), strict=True
        ):
            np.testing.assert_array_equal(left, right)


def test_each_jacobian_agrees_with_finite_differences(function) -> None:
    rng = np.random.default_rng(2)
    columns, n = function.nonlinear + function.linear, len(ERRING)
    for _ in range(10):
        x = rng.normal(size=(n, 1))

        J = np.broadcast_to(function.jacobian(x), (len(function.predict(x)), len(columns), 1))

        for i in range(n):
            step = np.zeros((n, 1))
            step[i] = 1e-6
            slope = (function.predict(x + step) - function.predict(x - step)) / 2e-6
            want = J[:, columns.index(i)] if i in columns else np.zeros_like(slope)
            np.testing.assert_allclose(slope, want, atol=1e-8)


def test_linearised_moments_are_h_p_h(function) -> None:
    m, P = random_gaussian(np.random.default_rng(3))
    columns = list(function.nonlinear + function.linear)
    H = np.zeros((len(function.predict(m[:, None])), len(m)))
    H[:, columns] = np.broadcast_to(function.jacobian(m[:, None]), (len(H), len(columns), 1))[:, :, 0]

    mean, cov, cross = linearised(function, m[:, None], P[:, :, None])

    np.testing.assert_allclose(mean[:, 0], function.predict(m[:, None])[:, 0])
    np.testing.assert_allclose(cov[:, :, 0], H @ P @ H.T, atol=1e-12)
    np.testing.assert_allclose(cross[:, :, 0], P @ H.T, atol=1e-12)


def test_a_bank_goes_through_member_by_member(function) -> None:
    rng = np.random.default_rng(4)
    members = [random_gaussian(rng) for _ in range(5)]
    m, P = np.stack([a for a, _ in members], -1), np.stack([b for _, b in members], -1)
    for rule in (linearised, cubature):
        together = rule(function, m, P)

        for i in range(5):
            alone = rule(function, m[:, i : i + 1], P[:, :, i : i + 1])
            for a, b in zip(together, alone, strict=True):
                np.testing.assert_allclose(a[..., i], b[..., 0], atol=1e-14)


def test_a_state_without_variance_has_no_points() -> None:
    m, P = np.ones((6, 3)), np.zeros((6, 6, 3))

    mean, cov, cross = cubature(FUNCTIONS["move"], m, P)

    np.testing.assert_array_equal(mean, FUNCTIONS["move"].predict(m))
    assert not cov.any()
    assert not cross.any()


def test_a_yaw_that_is_hardly_known_does_not_make_the_way_known() -> None:
    """Points at a whole turn would find the vehicle going straight on: the way across would have no variance."""
    m, P = np.array([[0.3, 0.0, 1.2, 0.0, 0.0, 0.0]]).T, np.zeros((6, 6, 1))
    for sd_rad in (0.7, 1.0, 2 * np.pi / np.sqrt(6), 5.0, 20.0):
        P[0, 0] = sd_rad**2
        for rule in (cubature, Unscented()):
            moved = rule(FUNCTIONS["move"], m, P)

            across = np.array([np.cos(0.3), np.sin(0.3)])
            sd_m = np.sqrt(across @ moved.cov[:, :, 0] @ across)
            assert sd_m > 0.6 * 1.2 * 0.7 * min(sd_rad, 1.0)  # what a Gaussian yaw of 1 rad leaves of speed and time
            assert np.hypot(*moved.mean[:, 0]) > 0.6 * 1.2 * 0.7


def test_of_a_bank_only_the_members_that_lost_their_yaw_are_linearised() -> None:
    rng = np.random.default_rng(6)
    members = [random_gaussian(rng, 6) for _ in range(4)]
    m, P = np.stack([a for a, _ in members], -1), np.stack([b for _, b in members], -1)
    P[0, 0, 2] += 9.0

    reported = cubature(FUNCTIONS["move"], m, P)

    for got, straight in zip(reported, linearised(FUNCTIONS["move"], m, P), strict=True):
        np.testing.assert_array_equal(got[..., 2], straight[..., 2])
        assert not np.allclose(got[..., 1], straight[..., 1], atol=1e-6)


def test_a_fix_of_the_epoch_is_no_special_case() -> None:
    m, P = random_gaussian(np.random.default_rng(5))
    picked = cubature(UsblFix(LAYOUT, 0.0), m[:, None], P[:, :, None])
    bent = cubature(UsblFix(LAYOUT, -1e-12), m[:, None], P[:, :, None])
    for a, b in zip(picked, bent, strict=True):
        np.testing.assert_allclose(a, b, atol=1e-10)


def test_a_fix_of_some_time_ago_lies_back_along_a_turning_track() -> None:
    """On a circle the chord points along the heading of half way: exact in direction, and in length to third order."""
    psi, forward, rate, ago = 0.4, 1.5, 0.1, -0.8
    x = np.array([psi, 0.0, forward, rate, 10.0, 20.0])[:, None]
    # circle by integration: heading psi + r t, V_E = -v sin, V_N = v cos
    t = np.linspace(0, ago, 200_001)
    east = 10.0 + float(np.trapezoid(-forward * np.sin(psi + rate * t), t))
    north = 20.0 + float(np.trapezoid(forward * np.cos(psi + rate * t), t))

    h = UsblFix(LAYOUT, ago).predict(x)[:, 0]

    np.testing.assert_allclose(h, [east, north], atol=forward * abs(ago) * (rate * ago) ** 2 / 24 * 1.01)


def test_angles_differ_by_the_shorter_way_round() -> None:
    compass = sensors.compass_model(LAYOUT)
    assert compass.residual(np.array([[3.1]]), np.array([[-3.1]]))[0, 0] == pytest.approx(6.2 - 2 * np.pi)
    assert compass.residual(np.array([[100 * np.pi + 0.1]]), np.array([[0.0]]))[0, 0] == pytest.approx(0.1)


@pytest.mark.parametrize("axis", [0, 1])
def test_a_dvl_whose_scale_alone_errs_reads_what_the_general_one_does(axis: int) -> None:
    layout = layout_for(("scale",))
    x = np.random.default_rng(6).normal(size=(len(layout), 5))
    u, v, r = layout.rows("u", "v", "r")
    general = BodyVelocity((u, v), r, axis, scale_row=layout.index("dvl_scale"))

    short = sensors.dvl_models(layout, (0.0, 0.0, -1.0))[axis]

    np.testing.assert_allclose(short.predict(x), general.predict(x))
