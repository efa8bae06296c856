"""Random errors of simulated sensors: their moments, tails and time constants against closed forms."""

import dataclasses
import math

import numpy as np
import pytest

from usbldr.filters.models.noise import Contamination, Gaussian, Mixture, StudentT
from usbldr.filters.simulation.scenario import Accuracy, AcousticHead, CorrelatedError, Leg, Multipath, Outliers, Timing
from usbldr.filters.simulation.simulate import (
    correlated_error,
    draw_noise,
    in_intervals,
    multipath_errors,
    outlier_errors,
    simulate,
)
from usbldr.io.scenarios.shipped import find_scenario

PAPER = find_scenario("paper")
STILL = dataclasses.replace(PAPER, legs=(Leg(20_000.0, 0.0, 0.0),), yaw_rad=0.0, duration_s=20_000.0)


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def test_the_noise_of_equation_23_has_its_variance_and_its_tails() -> None:
    R = np.diag([4.0, 0.25])

    e = draw_noise(Mixture(), R, 200_000, rng()) / np.sqrt(np.diag(R))

    # 0.7 * 1 + 0.3 * 10; beyond 3 sigma: 0.7 * 0.0027 + 0.3 * P(|N| > 3 / sqrt 10); standard errors .017 and .0007
    np.testing.assert_allclose((e**2).mean(axis=0), 3.7, atol=0.08)
    np.testing.assert_allclose((np.abs(e) > 3).mean(axis=0), 0.7 * 0.0027 + 0.3 * 0.34278, atol=0.003)


@pytest.mark.parametrize(("per_scalar", "expected"), [(True, 0.0), (False, 0.21 * 81)])
def test_scalars_share_their_mode_only_where_the_record_draws_it(per_scalar: bool, expected: float) -> None:
    e = draw_noise(Mixture(per_scalar=per_scalar), np.eye(2), 200_000, rng(1))

    # two scalars of one mode: cov(e1^2, e2^2) = variance of the mode's own variance = 0.7 * 0.3 * (10 - 1)^2
    assert np.cov((e**2).T)[0, 1] == pytest.approx(expected, abs=1.0)


def test_noise_of_a_record_keeps_its_covariance_between_axes() -> None:
    R = np.array([[4.0, 1.5], [1.5, 1.0]])

    e = draw_noise(Gaussian(per_scalar=False), R, 200_000, rng(2))

    np.testing.assert_allclose(np.cov(e.T), R, atol=0.05)


@pytest.mark.parametrize("per_scalar", [True, False])
def test_student_noise_is_the_distribution_itself_and_not_the_modes_that_filters_take(per_scalar: bool) -> None:
    e = draw_noise(StudentT(dof=4.0, per_scalar=per_scalar), np.diag([4.0, 0.25]), 200_000, rng(3)) / [2.0, 0.5]

    # two-sided points of t with 4 degrees of freedom from the printed table; the modes end about 30 sigma
    for share, point in ((0.10, 2.132), (0.05, 2.776), (0.01, 4.604), (0.001, 8.610)):
        got = (np.abs(e) > point).mean(axis=0)
        np.testing.assert_allclose(got, share, atol=4 * math.sqrt(share / len(e)))
    together = (np.abs(e) > 2.776).all(axis=1).mean()
    assert together == pytest.approx(0.0025, abs=0.0005) if per_scalar else together > 0.01


def test_a_contamination_strikes_its_share_of_whole_records_with_its_own_size() -> None:
    e = draw_noise(Contamination(share=0.1, sd=30.0), np.eye(2), 100_000, rng(4))

    far = np.abs(e) > 5  # of a good record nothing, of a gross error 1 - 5 / 30 * 0.7957 = 0.868 of each scalar
    np.testing.assert_allclose(far.mean(axis=0), 0.0868, atol=0.004)
    assert far.all(axis=1).mean() == pytest.approx(0.1 * 0.868**2, abs=0.004)


@pytest.mark.parametrize("family", [Gaussian(), Mixture(), Mixture(per_scalar=False), StudentT(), Contamination()])
def test_a_covariance_for_each_record_draws_as_one_for_all_where_they_are_equal(family) -> None:
    R = np.diag([4.0, 0.25])

    one, each = draw_noise(family, R, 50, rng(5)), draw_noise(family, np.tile(R, (50, 1, 1)), 50, rng(5))

    np.testing.assert_array_equal(one, each)


def test_a_correlated_error_has_its_sigma_from_the_first_record_on_and_forgets_in_its_time_constant() -> None:
    t = np.array([0.0, 1.0, 4.0, 34.0])
    starts = np.array([correlated_error(CorrelatedError(0.5, 10.0), t, 2, rng(seed)) for seed in range(20_000)])

    np.testing.assert_allclose(starts.std(axis=0), 0.5, rtol=0.03)
    for k, gap_s in enumerate(np.diff(t)):
        for axis in (0, 1):
            got = np.corrcoef(starts[:, k, axis], starts[:, k + 1, axis])[0, 1]
            assert got == pytest.approx(math.exp(-gap_s / 10.0), abs=0.03)
    assert np.corrcoef(*starts[:, 1].T)[0, 1] == pytest.approx(0.0, abs=0.03)


def test_outliers_strike_their_share_at_their_distances_in_all_directions() -> None:
    e = outlier_errors(Outliers(0.05, 5.0, 40.0), 20_000, 2, rng(6))
    far = np.hypot(*e.T)

    hit = far > 0
    assert hit.mean() == pytest.approx(0.05, abs=0.006)  # four standard errors
    assert 5 <= far[hit].min() <= far[hit].max() <= 40
    assert far[hit].mean() == pytest.approx(22.5, abs=4 * 35 / math.sqrt(12 * hit.sum()))
    quarters = np.bincount((np.arctan2(*e[hit].T) // (np.pi / 2)).astype(int) + 2, minlength=4)
    np.testing.assert_allclose(quarters / hit.sum(), 0.25, atol=4 * math.sqrt(0.25 * 0.75 / hit.sum()))


def test_outliers_of_a_compass_go_either_way() -> None:
    e = outlier_errors(Outliers(0.1, 0.2, 0.3), 20_000, 1, rng(7))

    hit = e[e[:, 0] != 0, 0]
    assert len(hit) == pytest.approx(2000, abs=4 * math.sqrt(1800))
    assert ((np.abs(hit) >= 0.2) & (np.abs(hit) <= 0.3)).all()
    assert (hit > 0).mean() == pytest.approx(0.5, abs=4 * 0.5 / math.sqrt(len(hit)))


def test_the_false_fixes_of_a_cluster_agree_and_those_of_two_clusters_do_not() -> None:
    t = np.arange(1000.0)
    echoes = Multipath(4.0, 15.0, scatter_m=0.2, share=0.9, clusters_s=((100.0, 300.0), (500.0, 700.0)))

    e = multipath_errors(echoes, t, 1000.0, rng(8))

    far = np.hypot(*e.T) > 2
    first, second = in_intervals(((100.0, 300.0),), t), in_intervals(((500.0, 700.0),), t)
    assert not e[~first & ~second].any()
    for cluster in (first, second):
        assert far[cluster].mean() == pytest.approx(0.9, abs=0.09)
        np.testing.assert_allclose(e[cluster & far].std(axis=0), 0.2, atol=0.05)
        assert 3.5 < np.hypot(*e[cluster & far].mean(axis=0)) < 15.5
    assert np.hypot(*(e[first & far].mean(axis=0) - e[second & far].mean(axis=0))) > 1


def test_clusters_at_random_begin_and_last_as_often_and_as_long_as_stated() -> None:
    t = np.arange(0.0, 400_000.0)
    e = multipath_errors(Multipath(5.0, 50.0, every_s=400.0, lasts_s=10.0), t, 400_000.0, rng(9))

    # an M/G/infinity queue: idle for exp(-lasts / every) of the time, in stretches of ``every`` on average
    struck = e[:, 0] != 0
    assert struck.mean() == pytest.approx(1 - math.exp(-10 / 400), abs=0.004)
    ends = np.flatnonzero(np.diff(struck))
    idle_s = np.diff(ends)[0 if struck[0] else 1 :: 2]
    assert idle_s.mean() == pytest.approx(400, abs=4 * 400 / math.sqrt(len(idle_s)))


def test_noise_by_range_and_bearing_lies_along_and_across_the_line_of_sight() -> None:
    # the vehicle stays at the surface, the head 30 m deep and 300 m east, 400 m north of it: 3, 4, 5
    head, accuracy = AcousticHead(300.0, 400.0, 30.0), Accuracy(0.6, 0.002, math.radians(1.0))
    usbl = dataclasses.replace(STILL.usbl, noise=Gaussian(), head=head, accuracy=accuracy)
    seen = simulate(dataclasses.replace(STILL, usbl=usbl), 3)
    slant = math.sqrt(500**2 + 30**2)
    along, across = (seen.usbl.value @ np.array([[0.6, 0.8], [0.8, -0.6]])).T

    assert along.std() == pytest.approx(math.hypot(0.6, 0.002 * slant), rel=0.03)
    assert across.std() == pytest.approx(math.radians(1.0) * slant, rel=0.03)
    assert np.corrcoef(along, across)[0, 1] == pytest.approx(0.0, abs=0.04)
    np.testing.assert_allclose(np.cov(seen.usbl.value.T), seen.fix_cov_m2[0], rtol=0.06)


def test_a_share_of_the_range_is_the_sigma_of_both_axes() -> None:
    legs = (Leg(1.0, 3.0, 4.0),)
    moving = dataclasses.replace(find_scenario("paper-range"), legs=legs, yaw_rad=0.0, duration_s=20_000.0)
    dive = simulate(dataclasses.replace(moving, usbl=dataclasses.replace(moving.usbl, noise=Gaussian())), 0)

    t = dive.usbl.time_s[1:]
    ratio = (dive.usbl.value - dive.gps.value)[1:] / (5.0 * t[:, None])

    np.testing.assert_allclose(ratio.std(axis=0), 0.02, rtol=0.03)
    np.testing.assert_allclose(dive.fix_cov_m2[1:, 0, 0], (0.02 * 5.0 * t) ** 2)
    assert not dive.fix_cov_m2[:, 0, 1].any()


def test_dropouts_lose_their_share_and_leave_the_rest_as_it_was() -> None:
    for sensor in ("dvl", "compass", "usbl", "gps"):
        timing = Timing(dropout_share=0.2)
        lossy = dataclasses.replace(PAPER, **{sensor: dataclasses.replace(getattr(PAPER, sensor), timing=timing)})

        whole, left = getattr(simulate(PAPER, 1), sensor), getattr(simulate(lossy, 1), sensor)

        kept = np.isin(whole.time_s, left.time_s)
        assert kept.mean() == pytest.approx(0.8, abs=4 * 0.4 / math.sqrt(len(kept)))
        np.testing.assert_array_equal(whole.value[kept], left.value)


ERROR_STREAMS = {
    "correlated": CorrelatedError(0.3, 30.0),
    "outliers": Outliers(0.2, 50.0, 60.0),
    "multipath": Multipath(20.0, 30.0, scatter_m=1.0, every_s=100.0, lasts_s=20.0),
    "bias_m": (1.0, 2.0),
    "timing": Timing(jitter_s=0.4, delay_s=1.0, delay_spread_s=2.0),
}


@pytest.mark.parametrize("effect", list(ERROR_STREAMS))
def test_an_effect_adds_the_same_whether_it_is_alone_or_among_others(effect: str) -> None:
    """Correlated errors and clusters know when a fix was made, so jitter is compared by itself."""
    others = {name: error for name, error in ERROR_STREAMS.items() if name not in (effect, "timing")}
    alone, all_of_them = {effect: ERROR_STREAMS[effect]}, others | {effect: ERROR_STREAMS[effect]}
    quiet = dataclasses.replace(STILL, duration_s=500.0)

    def fixes(effects) -> np.ndarray:
        return simulate(dataclasses.replace(quiet, usbl=dataclasses.replace(quiet.usbl, **effects)), 2).usbl.value[:499]

    if effect == "timing":
        others = {name: error for name, error in others.items() if name in ("outliers", "bias_m")}
        np.testing.assert_array_equal(fixes(others), fixes(others | alone))
        return
    np.testing.assert_allclose(fixes(all_of_them) - fixes(others), fixes(alone) - fixes({}), atol=1e-9)
    assert np.abs(fixes(alone) - fixes({})).max() > 0.1


@pytest.mark.parametrize("sensor", ["dvl", "compass", "gps"])
def test_every_sensor_can_have_correlated_errors_and_outliers(sensor: str) -> None:
    quiet = dataclasses.replace(STILL, duration_s=2000.0)
    errors = {"correlated": CorrelatedError(0.3, 50.0), "outliers": Outliers(0.02, 50.0, 60.0)}
    faulty = dataclasses.replace(quiet, **{sensor: dataclasses.replace(getattr(quiet, sensor), **errors)})

    added = getattr(simulate(faulty, 5), sensor).value - getattr(simulate(quiet, 5), sensor).value

    struck = np.linalg.norm(added, axis=1) > 20
    assert struck.mean() == pytest.approx(0.02, abs=4 * math.sqrt(0.02 / len(struck)))
    calm = added[~struck]
    assert calm.std() == pytest.approx(0.3, rel=0.35)  # some 2000 / 100 independent values for each axis
    assert not np.any(simulate(faulty, 5).usbl.value != simulate(quiet, 5).usbl.value)
