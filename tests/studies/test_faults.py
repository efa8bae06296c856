"""Faults of benchmarks/drills/faults.py that a default run must undo."""

import runpy

import numpy as np
import pytest

import usbldr
from checkout import ROOT

STUDY = runpy.run_path(str(ROOT / "benchmarks" / "drills" / "faults.py"))


@pytest.mark.parametrize("seed", [4108, 4112])
def test_near_and_frequent_echoes_are_left_out(seed: int) -> None:
    """Half and a quarter of the fixes are echoes, 5 m off; the dives cost 3.0 and .8 m if only far runs are known."""
    log = usbldr.open_log(str(STUDY["DIVE"]), usbldr.Request(configuration="none"), seed)

    _, error_m = STUDY["errors_m"](STUDY["echoes"](0.4, 5.0, 30)(log, seed), "adf", usbldr.RunSettings())

    assert np.mean(error_m) < 0.4
