"""Noise from the log itself, against dense normal densities and against what simulators put in.

False fixes in a row: the mixing of both hypotheses, against the law of total moments and exact mixtures.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from textbook import log_density
from usbldr.filters.estimators.gaussian_bank import GaussianBank
from usbldr.filters.identification import clusters
from usbldr.filters.identification.newton import maximise
from usbldr.filters.identification.noise_fit import (
    dvl_likelihoods,
    estimate_compass_noise,
    estimate_dvl_noise,
    estimate_usbl_noise,
)
from usbldr.filters.identification.usbl_likelihood import Member, fix_likelihoods
from usbldr.filters.models.noise import Contamination, Gaussian, Mixture
from usbldr.filters.models.parameters import Parameters, ProcessNoise, SensorErrors, Start
from usbldr.filters.replay.run import run
from usbldr.filters.types import Array, Outage, Timeline
from usbldr.filters.windows import columns_at
from usbldr.io.reading.epochs import timeline
from usbldr.io.scenarios.shipped import find_scenario
from usbldr.io.scenarios.simulated_log import simulated_log
from weaving import DIVE, Faults, mean_nees, weaving_dive

STATED = ProcessNoise(0.005, 0.001, 0.02, 0.02)
PLAIN = Parameters(process=STATED, dvl=Gaussian(), usbl=Gaussian(), start=Start(0.0, 0.0, 0.5))


def usbl_noise(line: Timeline, given: Parameters) -> Parameters:
    """Return the noise of the fixes on a dive without sensor errors."""
    return estimate_usbl_noise(line, Member(given, frozenset()), given)


def parked(count: int, spread_m: float = 1.0) -> Timeline:
    """A vehicle at rest at the origin, with a DVL that reads noise and fixes at odd times."""
    rng = np.random.default_rng(1)
    line = weaving_dive(Faults(), seconds=4 * count)
    fix_s = np.sort(rng.uniform(0, 4 * count, count))
    K = len(line.time_s)
    return replace(
        line,
        dvl_mps=0.1 * rng.standard_normal((K, 2)),
        dvl_sd_mps=np.full(K, 0.05),
        dr_mps=np.zeros((K, 2)),
        dr_yaw_rad=np.zeros(K),
        fix_time_s=fix_s,
        fix_received_s=fix_s,
        fix_m=spread_m * rng.standard_normal((count, 2)),
        fix_cov_m2=np.tile(np.diag([1.0, 2.0]), (count, 1, 1)),
    )


def test_the_search_ends_at_the_closed_form_where_the_likelihood_is_normal() -> None:
    A, peak, centre = np.array([[4.0, 1.0], [1.0, 2.0]]), np.array([2.0, -1.0]), np.array([0.5, 0.5])

    def log_likelihood(points: Sequence[np.ndarray]) -> np.ndarray:
        return np.array([-0.5 * (p - peak) @ A @ (p - peak) for p in points])

    found = maximise(log_likelihood, centre, np.array([3.0, 1.0]), centre)

    prior = np.diag([1 / 9, 1.0])
    information = A + prior
    assert found.point == pytest.approx(np.linalg.solve(information, A @ peak + prior @ [0.5, 0.5]), abs=1e-6)
    assert found.converged


@pytest.mark.parametrize("ripple", [0.5, 2.0, 5.0])
@pytest.mark.parametrize("start", [6.0, -5.0, 3.3])
def test_the_search_passes_local_maxima_of_a_likelihood_that_is_not_smooth(ripple: float, start: float) -> None:
    def log_likelihood(points: Sequence[np.ndarray]) -> np.ndarray:
        return np.array([-2 * float(p @ p) + ripple * math.sin(40 * p[0]) for p in points])

    found = maximise(log_likelihood, np.array([0.0]), np.array([100.0]), np.array([start]))

    assert abs(found.point[0]) <= math.sqrt(ripple)  # every point further away is worse than every point near 0
    assert found.converged


def test_velocities_are_as_likely_as_their_joint_normal_density() -> None:
    line = parked(count=5)
    members = [
        replace(PLAIN, dvl_sd_scale=scale, process=ProcessNoise(velocity_mps=q)) for scale, q in ((1, 0.1), (2, 0.3))
    ]
    found = dvl_likelihoods(line, members)

    z, t = line.dvl_mps[1:] - line.dvl_mps[0], line.time_s[1:]
    for member, log_l in zip(members, found, strict=True):
        q, sd = member.process.velocity_mps, member.dvl_sd_scale * 0.05
        cov = 0.5**2 + q**2 * np.minimum.outer(t, t) + sd**2 * np.eye(len(t))
        assert log_l == pytest.approx(log_density(z[:, 0], cov) + log_density(z[:, 1], cov), rel=1e-9)


def test_stretches_of_a_log_are_as_likely_as_each_by_itself() -> None:
    """1001 records are three stretches of 300, spread evenly; each has its own sigma and its own gap."""
    line = parked(count=50)
    t = line.time_s + np.where(line.time_s > 100.0, 7.3, 0.0)
    line = replace(line, time_s=t, dvl_sd_mps=0.05 + 0.0001 * np.arange(len(t)))

    found = dvl_likelihoods(line, [PLAIN])

    expected = 0.0
    for first in (0, 350, 701):
        alone = slice(first, first + 300)
        z, since = line.dvl_mps[alone][1:] - line.dvl_mps[first], t[alone][1:] - t[first]
        cov = 0.5**2 + 0.02**2 * np.minimum.outer(since, since) + np.diag(line.dvl_sd_mps[alone][1:] ** 2)
        expected += log_density(z[:, 0], cov) + log_density(z[:, 1], cov)
    assert found == pytest.approx([expected], rel=1e-9)


def test_the_walk_of_a_vehicle_that_rests_first_is_that_of_its_motion() -> None:
    rng = np.random.default_rng(4)
    line = parked(count=450)  # half an hour
    walk = np.cumsum(0.05 * np.sqrt(0.2) * rng.standard_normal((len(line.time_s), 2)), axis=0)
    walk = np.where(line.time_s[:, None] < 600.0, 0.0, walk - walk[3000])
    moving = replace(line, dvl_mps=walk + 0.05 * rng.standard_normal(walk.shape)).with_fixes(np.arange(0))

    found = estimate_dvl_noise(moving, PLAIN).process.velocity_mps

    assert found == pytest.approx(0.05 * math.sqrt(2 / 3), rel=0.15)  # in the mean square


def test_fixes_at_rest_are_as_likely_as_their_joint_normal_density(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(clusters, "BETWEEN_S", math.inf)
    line = replace(parked(count=20), dvl_sd_mps=np.zeros(4 * 20 * 5 + 1))
    calm = ProcessNoise(position_m=0.1, velocity_mps=0.0)
    stated = replace(PLAIN, process=calm)
    members = [
        replace(stated, usbl_sd_scale=scale, errors=SensorErrors(usbl_bias_m=c0, usbl_bias_s=T))
        for scale, c0, T in ((1.0, 0.3, 60.0), (0.5, 2.0, 10.0))
    ]
    found = fix_likelihoods(line, [Member(member, frozenset()) for member in members]).log_likelihood

    t = line.fix_time_s
    for member, log_l in zip(members, found, strict=True):
        c0, T = member.errors.usbl_bias_m, member.errors.usbl_bias_s
        moved = 0.5**2 + 0.1**2 * np.minimum.outer(t, t)
        shared = c0**2 * np.exp(-np.abs(np.subtract.outer(t, t)) / T)
        white = member.usbl_sd_scale**2 * np.eye(len(t))
        axes = [log_density(line.fix_m[:, k], moved + shared + R * white) for k, R in enumerate((1.0, 2.0))]
        assert log_l == pytest.approx(sum(axes), rel=1e-9)


def test_a_wrong_mixture_becomes_that_of_the_paper() -> None:
    """Eq. (23): share .3, ratio 10; 1000 fixes of two axes leave 5 % of each, and the sigma of a fix is 1 m."""
    log = simulated_log(find_scenario("paper"), 0)
    wrong = replace(log.parameters, usbl=Mixture(0.1, 4.0), usbl_sd_scale=1.6)
    found = estimate_usbl_noise(timeline(log), Member(wrong, frozenset(["scale"])), wrong)

    assert isinstance(found.usbl, Mixture)
    assert found.usbl.share == pytest.approx(0.30, abs=3 * 0.026)
    assert found.usbl.variance_ratio == pytest.approx(10.0, rel=3 * 0.08)
    assert found.usbl_sd_scale == pytest.approx(1.0, rel=3 * 0.033)


@pytest.mark.parametrize("factor", [0.25, 1.0, 4.0])
def test_the_sigma_of_white_fixes_is_found_whatever_they_state(factor: float) -> None:
    """800 numbers give a sigma to 2.5 %."""
    found = usbl_noise(replace(DIVE, fix_cov_m2=factor**2 * DIVE.fix_cov_m2), PLAIN)

    assert found.usbl_sd_scale == pytest.approx(1 / factor, rel=0.1)


def test_the_sigma_of_a_dvl_grows_if_its_records_scatter_more_than_stated_and_never_shrinks() -> None:
    line = weaving_dive(Faults(), seconds=200).with_fixes(np.arange(0))
    rng = np.random.default_rng(2)
    walk = np.cumsum(0.03 * np.sqrt(0.2) * rng.standard_normal((len(line.time_s), 2)), axis=0)
    seen = replace(line, dvl_mps=walk + 0.02 * rng.standard_normal(walk.shape))

    noisy, quiet = (
        estimate_dvl_noise(replace(seen, dvl_sd_mps=np.full(len(walk), sd_mps)), PLAIN) for sd_mps in (0.005, 0.08)
    )

    assert noisy.dvl_sd_scale == pytest.approx(4.0, rel=0.1)
    assert noisy.process.velocity_mps == pytest.approx(0.03, rel=0.3)
    assert quiet.dvl_sd_scale == 1.0


@pytest.mark.parametrize(("stated", "found"), [(1.0, 1.0), (0.5, 2.0), (3.0, 1.0)])
def test_the_sigma_of_a_compass_grows_if_its_headings_scatter_more_than_stated(stated: float, found: float) -> None:
    line = weaving_dive(Faults(), seconds=400)  # which turns all the time
    line = replace(line, yaw_sd_rad=stated * line.yaw_sd_rad, yaw_rad=np.where(line.time_s < 20.0, 0.0, line.yaw_rad))

    scale = estimate_compass_noise(line, PLAIN).compass_sd_scale

    assert scale == pytest.approx(found, rel=0.06)
    assert estimate_compass_noise(line, replace(PLAIN, compass_sd_scale=1.5 * scale)).compass_sd_scale == 1.5 * scale
    assert estimate_compass_noise(line, replace(PLAIN, compass=Contamination())).compass_sd_scale == 1.0


def test_a_velocity_that_hardly_changes_does_not_lower_the_assumed_walk() -> None:
    """A walk learnt while cruising would refuse the manoeuvre that follows."""
    line = weaving_dive(Faults(), seconds=200).with_fixes(np.arange(0))
    noise = np.random.default_rng(2).standard_normal(line.dvl_mps.shape)
    steady = replace(line, dvl_mps=1.0 + line.dvl_sd_mps[:, None] * noise)

    assert estimate_dvl_noise(steady, PLAIN).process.velocity_mps == PLAIN.process.velocity_mps


@pytest.mark.parametrize(("share", "sd_m"), [(0.1, 4.0), (0.4, 30.0)])
def test_gross_errors_are_found_with_their_share_and_size(share: float, sd_m: float) -> None:
    line = weaving_dive(Faults(), seconds=1000)
    rng = np.random.default_rng(3)
    gross = rng.random(len(line.fix_m)) < share
    spoiled = replace(line, fix_m=line.fix_m + sd_m * gross[:, None] * rng.standard_normal(line.fix_m.shape))
    found = usbl_noise(spoiled, replace(PLAIN, usbl=Contamination())).usbl

    assert isinstance(found, Contamination)
    assert found.share == pytest.approx(float(gross.mean()), abs=0.04)
    assert found.sd == pytest.approx(sd_m, rel=0.25)


@pytest.mark.parametrize(("slow_m", "walk_m"), [(3.0, 0.0), (0.0, 0.3)])
def test_a_slow_error_of_the_fixes_and_a_walk_of_dead_reckoning_share_what_scatters(slow_m: float, walk_m: float):
    """An error of 150 s has eight values in 20 minutes, which a random walk may have by chance."""
    found, nees = list[Parameters](), list[float]()
    for seed in range(6):
        line, rng = weaving_dive(Faults(), seed=seed, seconds=1200), np.random.default_rng(seed)
        clean, dt_s = run("adf", line, PLAIN), np.diff(line.fix_time_s, prepend=line.fix_time_s[0])
        error_m = [rng.normal(0.0, slow_m, 2)]
        for kept in np.exp(-dt_s[1:] / 150.0):
            error_m.append(kept * error_m[-1] + slow_m * np.sqrt(1 - kept**2) * rng.normal(size=2))
        walked_m = np.cumsum(walk_m * np.sqrt(dt_s)[:, None] * rng.normal(size=(len(dt_s), 2)), axis=0)
        line = replace(line, fix_m=line.fix_m + error_m + walked_m)
        found.append(usbl_noise(line, replace(PLAIN, usbl=Contamination())))
        track = run("adf", line, replace(found[-1], calibrate=("usbl-bias",)))
        moved_m = columns_at(track.time_s, line.fix_time_s, walked_m)
        mean = np.column_stack([clean.mean[:, :-2], clean.position_m + moved_m])
        nees.append(mean_nees(track, replace(clean, mean=mean)) / 2)

    walks_m, slow_sds_m = zip(*[(one.process.position_m, one.errors.usbl_bias_m) for one in found], strict=True)
    assert np.median(walks_m) == pytest.approx(walk_m, rel=0.2, abs=0.04)  # a walk alone would be 0.35
    assert np.median(slow_sds_m) == pytest.approx(slow_m or PLAIN.errors.usbl_bias_m, rel=0.3)
    assert sum(one < 3.0 for one in nees) >= 5
    if slow_m:  # of the first dive both are likely
        assert 0.05 < walks_m[0] < 0.2
        assert slow_sds_m[0] > 2.0


def test_two_fixes_hardly_move_the_noise_from_what_is_stated() -> None:
    stated = Contamination()
    found = usbl_noise(DIVE.with_fixes(np.arange(2)), replace(PLAIN, usbl=stated))

    assert isinstance(found.usbl, Contamination)
    assert found.usbl.share == pytest.approx(stated.share, rel=0.2)
    assert found.usbl.sd == pytest.approx(stated.sd, rel=0.2)
    assert found.errors.usbl_bias_s == pytest.approx(PLAIN.errors.usbl_bias_s, rel=0.2)


def test_a_number_that_is_0_stays_0() -> None:
    still = replace(PLAIN, process=ProcessNoise(position_m=0.0, velocity_mps=0.0))
    line = weaving_dive(Faults(), seconds=100)

    assert estimate_dvl_noise(line, still).process.velocity_mps == 0.0
    assert usbl_noise(line, still).process.position_m == 0.0


def test_a_silent_dvl_leaves_the_position_open_while_it_is_silent() -> None:
    """A velocity that walks q in a second leaves q^2 T^3 / 3 after T: far fixes are as likely as near ones then."""
    silent, T = (DIVE.time_s > 100.0) & (DIVE.time_s < 160.0), DIVE.fix_time_s
    shifted_m = DIVE.fix_m + np.where(T > 159.0, 3.0, 0.0)[:, None]
    sparse = replace(DIVE, dvl_count=np.where(silent, 0, DIVE.dvl_count), fix_m=shifted_m)
    sparse = sparse.with_fixes((T < 100.0) | (T > 159.0))

    with_dvl, without = (
        fix_likelihoods(one, [Member(PLAIN, frozenset())]).log_likelihood[0]
        for one in (replace(sparse, dvl_count=DIVE.dvl_count), sparse)
    )

    assert without > with_dvl + 10


def test_the_walk_of_dead_reckoning_never_shrinks_and_the_correlated_error_of_fixes_does() -> None:
    """The dive has neither."""
    given = replace(PLAIN, process=ProcessNoise(0.05, 0.001, 0.02, 0.02))
    found = usbl_noise(DIVE, given)

    assert found.process.position_m == given.process.position_m
    assert found.errors.usbl_bias_m < given.errors.usbl_bias_m / 2


def test_false_fixes_in_a_row_are_not_taken_for_noise() -> None:
    """A minute of fixes from elsewhere, in a dive of 400 s."""
    there = (DIVE.fix_time_s >= 200) & (DIVE.fix_time_s < 260)
    given = replace(PLAIN, usbl=Contamination())
    right, found = (
        usbl_noise(replace(DIVE, fix_m=DIVE.fix_m + np.outer(off, [25.0, -20.0])), given)
        for off in (np.zeros(len(there)), there)
    )

    assert found.process.position_m < 2 * right.process.position_m
    assert found.errors.usbl_bias_m < 2 * right.errors.usbl_bias_m
    assert found.usbl_sd_scale == pytest.approx(right.usbl_sd_scale, rel=0.1)


def test_a_minute_without_headings_leaves_the_direction_open() -> None:
    """Dead reckoning of this weaving dive is then wrong by tens of metres."""
    missing = (DIVE.time_s >= 200) & (DIVE.time_s < 260)
    yaw = np.interp(DIVE.time_s, DIVE.time_s[~missing], DIVE.dr_yaw_rad[~missing])
    gap = replace(DIVE, dr_yaw_rad=yaw, yaw_count=np.where(missing, 0, DIVE.yaw_count))

    right, found = usbl_noise(DIVE, PLAIN), usbl_noise(gap, PLAIN)

    assert found.process.position_m < 3 * right.process.position_m


def test_what_a_vehicle_does_while_its_dvl_is_silent_is_no_noise_of_the_fixes() -> None:
    """It weaves on for minutes, and dead reckoning goes straight on."""
    silent = DIVE.time_s > 150
    lost = replace(
        DIVE,
        dvl_count=np.where(silent, 0, DIVE.dvl_count),
        dr_mps=np.where(silent[:, None], DIVE.dr_mps[750], DIVE.dr_mps),
        outages=(Outage("dvl", 150.0, float(DIVE.time_s[-1])),),
    )

    assert usbl_noise(lost, PLAIN) == usbl_noise(DIVE.with_fixes(DIVE.fix_time_s <= 150), PLAIN)


MEMBERS = 3


def two_hypotheses(seed: int) -> GaussianBank:
    """Return three members of position and offset, each with both hypotheses; the first has no offset."""
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(4, 4, 2 * MEMBERS))
    root[2:, :, :MEMBERS] = 0.0
    mean = rng.normal(size=(4, 2 * MEMBERS))
    mean[2:, :MEMBERS] = 0.0
    share = rng.uniform(0.2, 0.8, MEMBERS)
    return GaussianBank(mean, np.einsum("ikm,jkm->ijm", root, root), np.log(np.concatenate([share, 1 - share])))


def switching(dt_s: float) -> tuple[float, float]:
    begins, ends = clusters.switching(np.array([dt_s]))
    return float(begins[0]), float(ends[0])


def position_moments(bank: GaussianBank) -> tuple[Array, Array]:
    merged = clusters.members(bank)
    return merged.mean[:2], merged.cov[:2, :2]


def test_switching_does_not_move_the_position() -> None:
    bank = two_hypotheses(1)

    after = clusters.mixed(bank, *switching(20.0))

    for before_one, after_one in zip(position_moments(bank), position_moments(after), strict=True):
        np.testing.assert_allclose(after_one, before_one, atol=1e-12)
    assert not after.mean[2:, :MEMBERS].any()
    assert not after.cov[2:, :, :MEMBERS].any()


def test_clusters_begin_and_end_at_the_stated_rates() -> None:
    bank = two_hypotheses(2)
    right, false = np.split(np.exp(bank.log_weight), 2)

    after_right, after_false = np.split(np.exp(clusters.mixed(bank, *switching(5.0)).log_weight), 2)

    ends, begins = 1 - math.exp(-5 / clusters.CLUSTER_S), 1 - math.exp(-5 / clusters.BETWEEN_S)
    np.testing.assert_allclose(after_right, right * (1 - begins) + false * ends)
    np.testing.assert_allclose(after_right + after_false, 1.0)


def test_a_fix_that_may_begin_a_cluster_has_the_density_of_the_mixture() -> None:
    sd_m, z = 2.0, np.array([12.0, -5.0])
    one = GaussianBank(np.zeros((4, 1)), np.diag([sd_m**2, sd_m**2, 0.0, 0.0])[:, :, None], np.zeros(1))
    bank = clusters.mixed(clusters.both_hypotheses(one), *switching(1.0))

    H = np.array([[1.0, 0.0, 1.0, 0.0], [0.0, 1.0, 0.0, 1.0]])
    spreads = [H @ bank.cov[:, :, k] @ H.T for k in (0, 1)]
    _, total = clusters.reweighted(bank, np.array([log_density(z, S) for S in spreads]))

    def density(variance_m2: float) -> float:
        return math.exp(-0.5 * float(z @ z) / variance_m2) / (2 * math.pi * variance_m2)

    begins = 1 - math.exp(-1 / clusters.BETWEEN_S)
    wide_m2 = sd_m**2 + clusters.OFFSET_SD_M**2
    expected = (1 - begins) * density(sd_m**2) + begins * density(wide_m2)
    assert math.exp(total[0]) == pytest.approx(expected, rel=1e-9)
