"""The autocorrelation of fixes' scores, against series whose autocorrelation is known."""

import numpy as np
import pytest

from usbldr.filters.evaluation.whiteness import whiteness, whiteness_warning
from usbldr.filters.types import Trajectory, Update

COUNT = 2000


def track(scores: np.ndarray, heading_deg: float, outcome: str = "used") -> Trajectory:
    """A vehicle that heads in one direction at 1 m/s, with a fix a second."""
    t = np.arange(float(len(scores)))
    state = np.array([-np.radians(heading_deg), 0.0, 1.0, 0.0, 0.0])
    updates = tuple(
        Update("usbl", "position", k, k, (0.0, 0.0), (1.0, 1.0), 2.0, 2, outcome, 1.0, scores=tuple(score))
        for k, score in enumerate(scores.tolist())
    )
    return Trajectory("ekf", ("psi", "u", "v", "x", "y"), t, np.tile(state, (len(t), 1)), None, updates)


def first_order(rho: float, seed: int) -> np.ndarray:
    """A first-order autoregression of variance 1: its autocorrelation at lag l is rho^l."""
    rng, found = np.random.default_rng(seed), [0.0]
    for noise in rng.normal(size=COUNT - 1):
        found.append(rho * found[-1] + np.sqrt(1 - rho**2) * noise)
    return np.array(found)


def test_white_scores_have_no_correlation_and_no_warning() -> None:
    sums = []
    for seed in range(40):
        found = whiteness(track(np.random.default_rng(seed).normal(size=(COUNT, 2)), 30.0))
        assert max(abs(found.along), abs(found.across)) < 4.5 * found.se
        assert whiteness_warning(found) is None
        sums += [found.along_sigmas, found.across_sigmas]

    assert abs(np.mean(sums)) < 4 / np.sqrt(80)
    assert np.std(sums) == pytest.approx(1.0, abs=0.3)  # four standard errors


@pytest.mark.parametrize(
    ("heading_deg", "column", "where"), [(0.0, 1, "along"), (90.0, 0, "along"), (0.0, 0, "across")]
)
def test_a_correlation_along_or_across_the_track_is_found_there(heading_deg: float, column: int, where: str) -> None:
    """North is the second score, east the first. The autocorrelations of the process, 0.5^lag, add to 1."""
    sums = []
    for seed in range(16):
        scores = np.random.default_rng(100 + seed).normal(size=(COUNT, 2))
        scores[:, column] = first_order(0.5, seed)
        found = whiteness(track(scores, heading_deg))

        assert getattr(found, where) == pytest.approx(0.5, abs=0.08)
        assert abs(found.across if where == "along" else found.along) < 4 * found.se
        assert f"{where} the track" in str(whiteness_warning(found))
        sums.append(getattr(found, f"{where}_sigmas"))

    assert np.mean(sums) == pytest.approx(np.sqrt(COUNT / 20), rel=0.2)  # four standard errors


def test_few_or_rejected_fixes_say_nothing() -> None:
    scores = np.tile(first_order(0.9, 0)[:, None], (1, 2))

    assert whiteness(track(scores[:99], 0.0)) is None
    assert whiteness(track(scores, 0.0, "rejected")) is None
