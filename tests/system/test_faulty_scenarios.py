"""Dives in which much is wrong, as files and as tables: what is written comes back, and no true error is stated."""

import dataclasses
import math
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from everything import SCENARIO
from usbldr.filters.models.noise import Contamination, Gaussian, Mixture
from usbldr.filters.simulation.scenario import Accuracy, Compass, Dvl, Gps, Timing, Usbl
from usbldr.filters.simulation.simulate import simulate
from usbldr.io.conventions.implausible import without_implausible
from usbldr.io.reading.read import read_log
from usbldr.io.scenarios.shipped import find_scenario
from usbldr.io.scenarios.simulated_log import START_NS, configuration_text, simulated_log, write_scenario

PAPER = find_scenario("paper")
TIMINGS = {"compass": SCENARIO.dvl.timing, "usbl": SCENARIO.dvl.timing, "gps": Timing(clock_offset_s=0.25)}
LATE = {name: dataclasses.replace(getattr(SCENARIO, name), timing=timing) for name, timing in TIMINGS.items()}
FAULTY = dataclasses.replace(SCENARIO, **LATE)
HONEST = dataclasses.replace(
    FAULTY,
    current_mps=(0.0, 0.0),
    dvl=Dvl(5.0, 0.05, lever_m=(0.5, 0.6, -0.7)),
    compass=Compass(10.0, math.radians(0.6), Contamination(0.1, math.radians(20.0), per_scalar=True)),
    usbl=Usbl(1.0, Accuracy(1.0), Gaussian(per_scalar=False), lever_m=(0.0, -2.0, 1.0)),
    gps=Gps(1.0, 0.02, Mixture(0.1), lever_m=(1.0, 2.0, 3.0)),
)
"""What is stated to a filter of FAULTY, as if it were so."""


def test_of_everything_that_is_wrong_the_configuration_tells_nothing() -> None:
    assert configuration_text(FAULTY, 0, {}) == configuration_text(HONEST, 0, {})
    assert simulated_log(FAULTY, 0).parameters == simulated_log(HONEST, 0).parameters


def test_what_is_told_stands_in_the_tables_and_what_is_true_in_the_records() -> None:
    log, dive = simulated_log(FAULTY, 1), simulate(FAULTY, 1)

    assert set(log.tables["dvl"]["sd_mps"]) == {0.05}
    np.testing.assert_allclose(log.tables["compass"]["sd_deg"], 0.6)
    fixes = log.tables["usbl"]
    np.testing.assert_array_equal(fixes[["cov_ee_m2", "cov_en_m2"]], dive.fix_cov_m2[:, 0])
    np.testing.assert_array_equal(fixes[["east_m", "north_m"]], dive.usbl.value)
    assert log.parameters.dvl_lever_m == (0.5, 0.6, -0.7)
    assert log.parameters.usbl_lever_m == (0.0, -2.0, 1.0)


def test_a_log_begins_with_its_first_record_and_not_with_the_dive() -> None:
    log, dive = simulated_log(FAULTY, 1), simulate(FAULTY, 1)

    first_s = min(dive.dvl.time_s[0], dive.compass.time_s[0], dive.usbl.time_s[0])
    assert -0.5 <= first_s < 0
    assert log.start_ns == START_NS + round(first_s * 1e9)
    assert min(log.tables[sensor]["time_s"].iloc[0] for sensor in ("dvl", "compass", "usbl")) == 0
    np.testing.assert_allclose(log.truth.time_s, dive.gps.time_s - first_s)


@pytest.mark.parametrize("name", ["dive.mcap", "dive.bag", "dive.db3", "dive_db3", "dive"])
def test_a_faulty_dive_reads_back_as_it_was_simulated(tmp_path: Path, name: str) -> None:
    written, _ = write_scenario(FAULTY, 5, tmp_path / name)

    read = read_log(tmp_path / name)

    assert (read.start_ns, read.origin, read.parameters) == (written.start_ns, written.origin, written.parameters)
    assert list(read.tables) == list(written.tables)
    for sensor, table in without_implausible(written).tables.items():  # DVL and compass have spikes
        columns = [column for column in table.columns if column != "up_mps"]
        pd.testing.assert_frame_equal(
            read.tables[sensor][columns], table[columns], rtol=1e-12, atol=1e-8 if sensor == "gps" else 1e-9
        )
    assert not read.tables["dvl"]["valid"].all()
    assert (read.truth.kind, read.truth.max_gap_s) == (written.truth.kind, written.truth.max_gap_s)
    np.testing.assert_array_equal(read.truth.time_s, written.truth.time_s)
    np.testing.assert_allclose(read.truth.position_m, written.truth.position_m, atol=1e-8)
    np.testing.assert_array_equal(read.truth.sd_m, written.truth.sd_m)


def test_a_sensor_that_never_spoke_has_no_table() -> None:
    silent = dataclasses.replace(PAPER.usbl, timing=Timing(silences_s=((0.0, 2000.0),)))

    assert set(simulated_log(dataclasses.replace(PAPER, usbl=silent), 0).tables) == {"dvl", "compass", "gps"}
