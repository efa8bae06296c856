"""Faults of benchmarks/drills/faults.py and of the shipped drills that a default run must undo."""

import runpy

import numpy as np
import pytest

import usbldr
from checkout import ROOT
from usbldr.io.conventions.shown_noise import examined
from usbldr.io.drills.drill import damaged
from usbldr.io.drills.suite import STANDARD, read_suite

STUDY = runpy.run_path(str(ROOT / "benchmarks" / "drills" / "faults.py"))


@pytest.mark.parametrize("seed", [4108, 4112])
def test_near_and_frequent_echoes_are_left_out(seed: int) -> None:
    """Half and a quarter of the fixes are echoes, 5 m off; the dives cost 3.0 and .8 m if only far runs are known."""
    log = usbldr.open_log(str(STUDY["DIVE"]), usbldr.Request(configuration="none"), seed)

    _, error_m = STUDY["errors_m"](STUDY["echoes"](0.4, 5.0, 30)(log, seed), "adf", usbldr.RunSettings())

    assert np.mean(error_m) < 0.4


@pytest.mark.parametrize(
    "name",
    [
        "false fixes after an outage",
        "false fixes for 60 s",
        "one heading repeated for 60 s",
        "heading off by 40° for 60 s",
        "heading jumps 15° for good",
        "DVL scale 5 %, heading bias 3°",
        "DVL 2 m ahead",
        "fixes stamped 2 s late",
    ],
)
def test_a_drill_costs_at_most_two_and_a_half_times_the_dives_without_it(name: str) -> None:
    """The two dives alone cost .21 m; after an outage, 9.2 m while false fixes could make velocities false."""
    (drill,) = (one for one in read_suite(STANDARD) if one.name == name)
    dives = (usbldr.open_log("turns", usbldr.Request(configuration="none"), seed) for seed in range(2))
    logs = [examined(damaged(log, drill, seed)) for seed, log in enumerate(dives)]

    error_m = [np.mean(STUDY["errors_m"](log, "adf", usbldr.RunSettings())[1]) for log in logs]

    assert np.mean(error_m) < 2.5 * 0.21
