"""Fixes that lie together beside the track: they are named, and the sigma covers both places."""

from dataclasses import replace

import numpy as np
import pytest

from usbldr.filters.identification.evidence import identify
from usbldr.filters.models.noise import Contamination
from usbldr.filters.models.parameters import Parameters, ProcessNoise
from usbldr.filters.replay.run import run
from usbldr.filters.types import Array, Timeline, Trajectory
from weaving import Faults, weaving_dive

ASSUMED = Parameters(process=ProcessNoise(0.005, 0.001, 0.02, 0.02), usbl=Contamination())
DIVE = weaving_dive(Faults())
COUNT = len(DIVE.fix_time_s)
AWAY_M = np.array([30.0, 40.0])


def track_of(line: Timeline) -> Trajectory:
    return run("adf", line, identify(line, ASSUMED).parameters)


def moved(every: int, by_m: Array) -> Timeline:
    rows = np.arange(COUNT) % every == 1
    return replace(DIVE, fix_m=DIVE.fix_m + rows[:, None] * by_m)


@pytest.mark.parametrize("every", [2, 3])
def test_two_sets_of_fixes_are_named_and_the_sigma_covers_the_other(every: int) -> None:
    track = track_of(moved(every, AWAY_M))

    (text,) = (text for text in track.warnings if "RIVAL-FIXES" in text)
    fewer, more = sorted((COUNT // every, COUNT - COUNT // every))
    assert "lie together 50 m off (at " in text
    if every == 3:
        assert "50 m off (at 37°)" in text
    assert not any("hardly all" in other for other in track.warnings)
    share = (fewer / more) ** 4 / (1 + (fewer / more) ** 4)
    np.testing.assert_allclose(track.open_cov_m2[0], share * np.outer(AWAY_M, AWAY_M), rtol=0.35)


@pytest.mark.parametrize("every", [4, 10])
def test_a_few_are_outliers(every: int) -> None:
    track = track_of(moved(every, AWAY_M))

    assert not any("RIVAL-FIXES" in text for text in track.warnings)
    assert track.open_cov_m2 is not None
    assert np.abs(track.open_cov_m2).max() < 1e-3  # of what the log leaves open of a latency and a lever arm


def test_outliers_that_do_not_lie_together_are_no_rivals() -> None:
    track = track_of(moved(2, np.random.default_rng(1).normal(0.0, 60.0, (COUNT, 2))))

    assert not any("RIVAL-FIXES" in text for text in track.warnings)
