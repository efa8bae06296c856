"""The paper's simulation, section 3.1, over 20 seeds: the accuracy that cpf and adf are held to."""

from concurrent.futures import ProcessPoolExecutor

import numpy as np
import pytest

from uncalibrated import dive_without_calibration
from usbldr.filters.evaluation.evaluation import evaluate
from usbldr.filters.replay.methods import FilterSettings
from usbldr.filters.replay.run import run
from usbldr.io.reading.epochs import timeline
from usbldr.io.scenarios.shipped import find_scenario

PAPER = find_scenario("paper")

SEEDS = range(20)


def one(name: str, seed: int) -> dict[str, float]:
    """Run one filter on one realisation with the noise model that the scenario writes beside its log."""
    log = dive_without_calibration(PAPER, seed)
    line = timeline(log)
    track = run(name, line, log.parameters, FilterSettings(particles=100, seed=seed))
    assert log.truth is not None
    report = evaluate(track, log.truth, times_s=line.time_s[line.slow])
    return {name: value for name, value in report.flat().items() if value is not None}


@pytest.fixture(scope="module")
def metrics() -> dict[str, dict[str, np.ndarray]]:
    with ProcessPoolExecutor(2) as pool:
        waiting = {name: [pool.submit(one, name, seed) for seed in SEEDS] for name in ("cpf", "adf")}
        rows = {name: [job.result() for job in jobs] for name, jobs in waiting.items()}
    return {
        name: {key: np.array([row.get(key, np.nan) for row in found]) for key in found[0]}
        for name, found in rows.items()
    }


def test_cpf_is_closer_than_the_papers(metrics) -> None:
    """The paper has 0.31 m east and 0.30 m north."""
    assert metrics["cpf"]["mean_abs_east_m"].mean() <= 0.26
    assert metrics["cpf"]["mean_abs_north_m"].mean() <= 0.28


def test_cpf_knows_how_wrong_it_is(metrics) -> None:
    assert 1.5 <= metrics["cpf"]["nees_mean"].mean() <= 3.0
    for sensor in ("dvl", "compass", "usbl"):
        assert metrics["cpf"][f"nis_mean_{sensor}"].mean() == pytest.approx(1.0, abs=0.05)  # per scalar


def test_cpfs_particles_stay_alive(metrics) -> None:
    assert metrics["cpf"]["ess_mean_ratio"].min() > 0.5
    assert metrics["cpf"]["acceptance_mean"].mean() > 0.9


def test_adf_equals_cpf_within_five_per_cent(metrics) -> None:
    """The posterior is almost Gaussian: the likelihood buys the accuracy, not the particles."""
    for axis in ("east", "north"):
        name = f"mean_abs_{axis}_m"
        assert metrics["adf"][name].mean() == pytest.approx(metrics["cpf"][name].mean(), rel=0.05)
