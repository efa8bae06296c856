"""One dive, four formats, one configuration: the same tables and the same track."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from checkout import FIELD_CONFIGURATIONS
from usbldr.filters.replay.run import run
from usbldr.io.log import Log
from usbldr.io.reading.epochs import timeline
from usbldr.io.reading.read import Request, read_log

CONFIGURATION = FIELD_CONFIGURATIONS / "uib_field.toml"


@cache
def uib(logs: Path, name: str) -> Log:
    return read_log(logs / "uib_field" / name, Request(str(CONFIGURATION)))


@pytest.mark.parametrize("name", ["uib_field.bag", "uib_field_db3", "csv"])
def test_every_format_of_uib_field_gives_the_same_log(field_logs: Path, name: str) -> None:
    reference, log = uib(field_logs, "uib_field.mcap"), uib(field_logs, name)

    assert log.start_ns == reference.start_ns
    assert list(log.tables) == list(reference.tables) == ["dvl", "compass", "usbl"]
    for sensor, table in log.tables.items():
        pd.testing.assert_frame_equal(table, reference.tables[sensor], check_exact=True)
        assert log.provenance[sensor].conventions == reference.provenance[sensor].conventions
    assert log.truth is not None
    assert reference.truth is not None
    np.testing.assert_array_equal(log.truth.position_m, reference.truth.position_m)
    np.testing.assert_array_equal(log.truth.time_s, reference.truth.time_s)
    assert [finding.text for finding in log.findings] == [finding.text for finding in reference.findings]


def test_every_format_of_uib_field_gives_the_same_track(field_logs: Path) -> None:
    tracks = []
    for name in ("uib_field.mcap", "uib_field.bag", "uib_field_db3", "csv"):
        log = uib(field_logs, name)
        tracks.append(run("adf", timeline(log), replace(log.parameters, calibrate=())).position_m)

    for track in tracks[1:]:
        np.testing.assert_allclose(track, tracks[0], rtol=0, atol=1e-6)
    assert np.ptp(tracks[0], axis=0).min() > 10.0  # it went somewhere
