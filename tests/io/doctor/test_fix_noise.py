"""Gross errors of fixes and their stated sigma: a heavy tail is no fault, and a wrong sigma is one."""

from dataclasses import replace

import numpy as np
import pytest

from usbldr.filters.identification.identification import Identification
from usbldr.filters.types import Vector
from usbldr.io.doctor.fix_noise import exceeds_heavy_tail, fix_noise_findings
from usbldr.io.reading.epochs import timeline
from usbldr.io.reading.opening import Request
from usbldr.io.session import open_log


def student_t(count: int, seed: int, dof: float = 4.0) -> Vector:
    """Distances of a bivariate Student-t, drawn as a normal over the root of a chi-square."""
    rng = np.random.default_rng(seed)
    normal = rng.standard_normal((count, 2)) / np.sqrt(rng.chisquare(dof, count) / dof)[:, None]
    return np.hypot(*normal.T)


def test_a_heavy_tail_is_taken_for_gross_errors_once_in_a_hundred_logs_at_most() -> None:
    assert sum(exceeds_heavy_tail(student_t(700, seed)) for seed in range(200)) <= 2


@pytest.mark.parametrize(("share", "size"), [(0.004, 40.0), (0.03, 15.0), (0.5, 8.0)])
def test_gross_errors_are_told_from_a_heavy_tail_be_they_few_and_far_or_many(share: float, size: float) -> None:
    rng = np.random.default_rng(3)
    sigmas = np.hypot(*rng.standard_normal((2, 700)))
    sigmas[: round(share * 700)] = size

    assert exceeds_heavy_tail(sigmas)


@pytest.mark.parametrize(("ratio", "reported"), [(0.5, True), (0.7, False), (1.4, False), (1.6, True)])
def test_a_stated_sigma_is_reported_if_it_makes_nees_wrong_by_more_than_two(ratio: float, reported: bool) -> None:
    log = open_log("turns", Request(configuration="none"))
    parameters = replace(log.parameters, usbl_sd_scale=0.8)  # as configured
    found = Identification(replace(parameters, usbl_sd_scale=0.8 * ratio))

    printed = fix_noise_findings(replace(log, parameters=parameters), timeline(log), found)

    noise = [one for one in printed if one.code == "USBL-NOISE"]
    assert bool(noise) == reported
    assert all(f"sd_scale = {0.8 * ratio:.2g} under [usbl]" in one.text for one in noise)
