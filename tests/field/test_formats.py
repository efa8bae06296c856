"""One dive, four formats, one configuration: the same tables and the same track."""

from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from checkout import FIELD_CONFIGURATIONS
from usbldr.io.log import Log
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
    np.testing.assert_array_equal(log.truth.position_m, reference.truth.position_m)
    np.testing.assert_array_equal(log.truth.time_s, reference.truth.time_s)
    assert [finding.text for finding in log.findings] == [finding.text for finding in reference.findings]
