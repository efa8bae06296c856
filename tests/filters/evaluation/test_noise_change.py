"""What a change of the noise, or a fault, does to a run; the autocorrelation of scores, against known series."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from uncalibrated import dive_without_calibration
from usbldr.filters.evaluation.consistency import whiteness, whiteness_warning
from usbldr.filters.evaluation.fault_response import fault_response
from usbldr.filters.evaluation.noise_change import noise_change, noise_warnings
from usbldr.filters.models.noise import Gaussian
from usbldr.filters.replay.run import run
from usbldr.filters.types import Trajectory, Update
from usbldr.io.reading.epochs import timeline
from usbldr.io.scenarios.shipped import find_scenario

SECONDS = np.arange(1000.0)
DRAWN = settings(derandomize=True)  # an estimate is off by four sigma once in 10,000 draws


@settings(DRAWN, max_examples=30)
@given(seed=st.integers(0, 10_000), at=st.integers(200, 800), factor=st.sampled_from([0.4, 2.5]))
def test_a_change_is_found_near_its_time_with_its_factor(seed: int, at: int, factor: float) -> None:
    scores = np.random.default_rng(seed).normal(size=1000) * np.where(at > SECONDS, 1.0, factor) / max(factor, 1.0)

    found = noise_change(SECONDS, scores**2)

    assert found.time_s == pytest.approx(at, abs=40)
    assert found.factor == pytest.approx(factor, rel=0.35)


@settings(DRAWN, max_examples=60)
@given(seed=st.integers(0, 10_000), tails=st.sampled_from([4, 1000]), correlated=st.sampled_from([1, 5]))
def test_constant_noise_has_no_change_with_heavy_tails_or_correlated(seed: int, tails: int, correlated: int) -> None:
    drawn = np.random.default_rng(seed).standard_t(tails, size=1000)
    smooth = np.convolve(drawn, np.ones(correlated) / np.sqrt(correlated), "same")

    assert noise_change(SECONDS, np.square(smooth, dtype=float)) is None


def test_few_or_no_values_say_nothing() -> None:
    assert noise_change(SECONDS[:40], np.where(SECONDS[:40] < 20, 0.1, 5.0)) is None
    assert noise_change(SECONDS, np.full(1000, np.nan)) is None


def test_fixes_that_a_run_leaves_out_say_nothing_of_the_noise() -> None:
    log = dive_without_calibration(replace(find_scenario("square"), duration_s=200.0), 0)
    line, false = timeline(log), tuple(range(0, 200, 10))
    moved_m = line.fix_m.copy()
    moved_m[list(false)] += 40.0

    assumed = replace(log.parameters, usbl=Gaussian(), false_fixes=false)
    track = run("adf", replace(line, fix_m=moved_m), assumed)

    assert not any("times as large as their sigmas" in text for text in track.warnings)
    assert any("innovations of the usbl are" in text for text in noise_warnings(track))


T = np.arange(0.0, 301.0)
USUAL = np.column_stack([np.full(len(T), 0.6), np.full(len(T), 0.8)])  # 1 m long


@pytest.mark.parametrize(
    ("error_m", "drift_m", "reacquired_s"),
    [
        (np.where(T[:, None] > 100, [-0.6, 0.8], USUAL), 1.2, 0.0),  # as long as before, elsewhere
        # the window 199 to 208 s still has one error of 50 m in it: 5.9 m
        (np.where(((T > 100) & (T < 200))[:, None], [30.0, 40.0], USUAL), np.hypot(29.4, 39.2), 40.0),
        (USUAL * np.select([T == 180, T > 100], [0.0, 20.0], 1.0)[:, None], 19.0, None),  # crosses the truth at 180 s
    ],
    ids=["elsewhere", "until 200 s", "for good"],
)
def test_the_drift_is_a_displacement_and_the_end_is_when_the_next_ten_seconds_are_good(error_m, drift_m, reacquired_s):
    assert fault_response(T, error_m, T, USUAL, (100.0, 160.0)) == (pytest.approx(drift_m), reacquired_s)


def test_an_error_that_is_as_large_without_the_fault_counts_as_re_acquired() -> None:
    usual = USUAL * np.where(T > 160, 8.0, 1.0)[:, None]
    found = fault_response(T, 1.4 * usual, T, usual, (100.0, 160.0))
    assert found.reacquired_s == 0.0


def test_a_fault_until_the_end_has_a_drift_and_is_never_re_acquired() -> None:
    error = USUAL + np.clip(T - 100, 0, None)[:, None] * [0.0, 0.1]
    assert fault_response(T, error, T, USUAL, (100.0, 300.0)) == (pytest.approx(20.0), None)
    assert fault_response(T[200:], error[200:], T, USUAL, (100.0, 160.0)) is None


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
