"""Noise from the log itself: held to dense normal densities, to what simulators put in, and to silence on the truth."""

import math
from dataclasses import replace

import numpy as np
import pytest

from usbldr.filters.identification.dvl_likelihood import dvl_likelihoods
from usbldr.filters.identification.identification import Identification, TunedParameter
from usbldr.filters.identification.newton import maximise
from usbldr.filters.identification.tuning import tune
from usbldr.filters.identification.usbl_likelihood import dr_residuals, fix_likelihoods
from usbldr.filters.models.noise import Contamination, Gaussian, Mixture
from usbldr.filters.models.parameters import Parameters, ProcessNoise, SensorErrors, Start
from usbldr.filters.types import Timeline
from usbldr.io.scenarios.shipped import find_scenario
from usbldr.io.scenarios.simulated_log import simulated_log
from usbldr.io.timeline import timeline
from weaving import Faults, weaving_dive

PLAIN = Parameters(process=ProcessNoise(0.005, 0.001, 0.02, 0.02), usbl=Gaussian(), start=Start(0.0, 0.0, 0.5))


def by_name(found: Identification) -> dict[str, TunedParameter]:
    return {told.name: told for told in found.tuned}


def log_density(x: np.ndarray, cov: np.ndarray) -> float:
    _, logdet = np.linalg.slogdet(2 * np.pi * cov)
    return -0.5 * float(logdet + x @ np.linalg.solve(cov, x))


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
    A, peak = np.array([[4.0, 1.0], [1.0, 2.0]]), np.array([2.0, -1.0])
    found = maximise(
        lambda points: np.array([-0.5 * (p - peak) @ A @ (p - peak) for p in points]), np.array([0.5, 0.5]), 3.0
    )

    information = A + np.eye(2) / 9
    assert found.point == pytest.approx(np.linalg.solve(information, A @ peak + 0.5 / 9), abs=1e-6)
    assert found.sd == pytest.approx(np.sqrt(np.linalg.inv(information).diagonal()), rel=1e-6)
    assert found.converged


def test_the_search_climbs_where_the_likelihood_is_not_even_concave() -> None:
    found = maximise(lambda points: np.array([-50 * math.log1p(float(p @ p)) for p in points]), np.array([6.0]), 100.0)

    assert found.point == pytest.approx([0.0], abs=0.05)
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


def test_a_vehicle_that_rests_for_ten_minutes_and_then_moves_is_heard_as_it_moves() -> None:
    rng = np.random.default_rng(4)
    line = parked(count=450)  # half an hour
    walk = np.cumsum(0.05 * np.sqrt(0.2) * rng.standard_normal((len(line.time_s), 2)), axis=0)
    walk = np.where(line.time_s[:, None] < 600.0, 0.0, walk - walk[3000])
    moving = replace(line, dvl_mps=walk + 0.05 * rng.standard_normal(walk.shape)).with_fixes(np.arange(0))

    found = by_name(tune(moving, PLAIN))["velocity_walk_mps"]

    assert found.after == pytest.approx(0.05 * math.sqrt(2 / 3), rel=0.15)  # in the mean square


def test_fixes_at_rest_are_as_likely_as_their_joint_normal_density() -> None:
    line = replace(parked(count=20), dvl_sd_mps=np.zeros(4 * 20 * 5 + 1))
    calm = ProcessNoise(position_m=0.1, velocity_mps=0.0)
    stated = replace(PLAIN, process=calm, calibrate=("usbl-bias",))
    members = [
        replace(stated, usbl_sd_scale=scale, errors=SensorErrors(usbl_bias_m=c0, usbl_bias_s=T))
        for scale, c0, T in ((1.0, 0.3, 60.0), (0.5, 2.0, 10.0))
    ]
    found = fix_likelihoods(dr_residuals(line, stated), members).log_likelihood

    t = line.fix_time_s
    for member, log_l in zip(members, found, strict=True):
        c0, T = member.errors.usbl_bias_m, member.errors.usbl_bias_s
        moved = 0.5**2 + 0.1**2 * np.minimum.outer(t, t)
        shared = c0**2 * np.exp(-np.abs(np.subtract.outer(t, t)) / T)
        white = member.usbl_sd_scale**2 * np.eye(len(t))
        axes = [log_density(line.fix_m[:, k], moved + shared + R * white) for k, R in enumerate((1.0, 2.0))]
        assert log_l == pytest.approx(sum(axes), rel=1e-9)


def test_the_wrong_mixture_becomes_that_of_the_paper() -> None:
    """Eq. (23): share .3, ratio 10; 1000 fixes of two axes leave 5 % of each, and the sigma of a fix is 1 m."""
    log = simulated_log(find_scenario("paper"), 0)
    wrong = replace(log.parameters, usbl=Mixture(0.1, 4.0), usbl_sd_scale=1.6, calibrate=("scale",))
    found = by_name(tune(timeline(log), wrong))

    assert found["usbl_outlier_share"].after == pytest.approx(0.30, abs=3 * 0.026)
    assert found["usbl_outlier_variance_ratio"].after == pytest.approx(10.0, rel=3 * 0.08)
    assert found["usbl_sd_scale"].after == pytest.approx(1.0, rel=3 * 0.033)


def test_white_noise_of_fixes_comes_out_whatever_sigma_they_state() -> None:
    """800 numbers tell a sigma to 2.5 %."""
    line = weaving_dive(Faults())
    found = by_name(tune(replace(line, fix_cov_m2=9 * line.fix_cov_m2), PLAIN))

    assert found["usbl_sd_scale"].after == pytest.approx(1 / 3, rel=0.1)


def test_the_walk_and_the_noise_of_a_velocity_come_out_as_closely_as_the_widths_say() -> None:
    """16 errors, each over its width: their mean square is 1, and within 0.32 to 2.1 in 99 of 100 runs."""
    line = weaving_dive(Faults(), seconds=200).with_fixes(np.arange(0))
    errors: list[float] = []
    for seed in range(8):
        rng = np.random.default_rng(seed)
        walk = np.cumsum(0.03 * np.sqrt(0.2) * rng.standard_normal((len(line.time_s), 2)), axis=0)
        seen = replace(
            line, dvl_mps=walk + 0.02 * rng.standard_normal(walk.shape), dvl_sd_mps=np.full(len(walk), 0.005)
        )
        found = by_name(tune(seen, PLAIN))
        for name, right in (("dvl_sd_scale", 4.0), ("velocity_walk_mps", 0.03)):
            width = math.log(found[name].high / found[name].low) / 2
            errors.append(math.log(found[name].after / right) / width)

    assert 0.32 < float(np.mean(np.square(errors))) < 2.1


def test_a_dvl_is_never_trusted_more_than_stated() -> None:
    line = weaving_dive(Faults(), seconds=200).with_fixes(np.arange(0))
    rng = np.random.default_rng(2)
    walk = np.cumsum(0.03 * np.sqrt(0.2) * rng.standard_normal((len(line.time_s), 2)), axis=0)
    quiet = walk + 0.005 * rng.standard_normal(walk.shape)
    seen = replace(line, dvl_mps=quiet, dvl_sd_mps=np.full(len(walk), 0.02))

    made = tune(seen, PLAIN)

    assert made.parameters.dvl_sd_scale == 1.0
    assert set(by_name(made)) == {"velocity_walk_mps"}


def test_gross_errors_come_out_with_their_share_and_size() -> None:
    line = weaving_dive(Faults(), seconds=1000)
    rng = np.random.default_rng(3)
    gross = rng.random(len(line.fix_m)) < 0.1
    spoiled = replace(line, fix_m=line.fix_m + 4.0 * gross[:, None] * rng.standard_normal(line.fix_m.shape))
    found = by_name(tune(spoiled, replace(PLAIN, usbl=Contamination())))

    assert found["usbl_outlier_share"].after == pytest.approx(float(gross.mean()), abs=0.02)
    assert found["usbl_outlier_sd_m"].after == pytest.approx(4.0, rel=0.25)


def test_a_number_that_the_log_hardly_knows_stays_as_it_was() -> None:
    line = weaving_dive(Faults())
    assumed = replace(PLAIN, usbl=Contamination(), calibrate=("usbl-bias",))
    found = tune(line.with_fixes(np.arange(2)), assumed)

    assert (found.parameters.usbl, found.parameters.errors) == (assumed.usbl, assumed.errors)
    for name in ("usbl_outlier_share", "usbl_outlier_sd_m", "usbl_bias_time_s"):
        assert not by_name(found)[name].identified
        assert by_name(found)[name].high > 2 * by_name(found)[name].after


def test_states_that_are_not_estimated_are_not_tuned_and_a_0_stays_0() -> None:
    found = tune(weaving_dive(Faults()), replace(PLAIN, process=ProcessNoise(velocity_mps=0.0)))

    assert set(by_name(found)) == {"dvl_sd_scale", "usbl_sd_scale"}
    assert found.parameters.process.velocity_mps == 0.0


def test_the_truth_tells_nothing_and_the_same_log_tells_the_same() -> None:
    line = weaving_dive(Faults())
    lied = replace(line, gps_time_s=line.time_s, gps_m=np.full((len(line.time_s), 2), 1e4))

    assert tune(line, PLAIN) == tune(line, PLAIN) == tune(lied, PLAIN)


def test_a_log_without_fixes_tells_of_its_dvl() -> None:
    found = tune(weaving_dive(Faults()).with_fixes(np.arange(0)), PLAIN)

    assert set(by_name(found)) == {"velocity_walk_mps"}


def test_what_a_silent_dvl_leaves_open_grows_while_it_is_silent_and_not_before() -> None:
    line = weaving_dive(Faults())
    silent = (line.time_s > 100.0) & (line.time_s < 160.0)
    log = dr_residuals(replace(line, dvl_count=np.where(silent, 0, line.dvl_count)), PLAIN)

    within = (line.fix_time_s > 100.0) & (line.fix_time_s <= 160.0)
    assert log.dvl_gap_s3[within].sum() == pytest.approx(60.0**3 / 3)  # a velocity that walks 1 m/s in 1 s
    assert log.dvl_gap_s3[~within].max() < 0.1
    assert log.dvl_noise_m2[within].sum() == pytest.approx((line.dvl_sd_mps[0] * 60.0) ** 2)


def test_a_log_whose_dvl_never_speaks_is_no_fault() -> None:
    line = weaving_dive(Faults())

    log = dr_residuals(replace(line, dvl_count=np.zeros_like(line.dvl_count)), PLAIN)

    assert log.dvl_noise_m2.tolist() == [0.0] * len(line.fix_time_s)
