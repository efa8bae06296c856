"""A clock that was set forward within the log: named, no outage, undone by the proposed key."""

from pathlib import Path

import pandas as pd
import pytest

from commands import findings
from curved import curved_dive
from recordings import SECOND, T0, Row, write_mcap
from usbldr.filters.errors import UsageError
from usbldr.io.reading.read import Request, read_log

SET_NS, STEP_S = T0 + 300 * SECOND + 1, 25
TOPICS = {"dvl": "/dvl", "compass": "/imu", "usbl": "/usbl"}


def stepped(rows: list[Row], topic: str, log_time_too: bool) -> list[Row]:
    """Return the dive with a topic's clock set forward in the middle, and perhaps that of its recorder."""

    def late(row: Row) -> Row:
        if row[1] != topic or row[3]["header.stamp"] < SET_NS:
            return row
        values = dict(row[3]) | {"header.stamp": row[3]["header.stamp"] + STEP_S * SECOND}
        return (row[0] + STEP_S * SECOND * log_time_too, *row[1:3], values)

    return sorted(map(late, rows), key=lambda row: row[0])


@pytest.mark.long
@pytest.mark.parametrize("log_time_too", [True, False])
@pytest.mark.parametrize("sensor", TOPICS)
def test_a_clock_that_was_set_is_named_and_its_key_restores_the_records(
    tmp_path: Path, sensor: str, log_time_too: bool
) -> None:
    rows = curved_dive()
    clean = write_mcap(tmp_path / "clean.mcap", rows)
    log = write_mcap(tmp_path / "dive.mcap", stepped(rows, TOPICS[sensor], log_time_too))
    cure = tmp_path / "cure.toml"

    ill = findings(log)["CLOCK-STEP"]
    proposed, section = ill["text"].split("state ")[1].split(" under ")
    cure.write_text(f"{section}\n{proposed}\n")

    assert (section, ill["topic"]) == (f"[{sensor}]", TOPICS[sensor])
    assert ill["worst"] == pytest.approx(STEP_S, abs=0.01)
    assert "CLOCK-STEP" not in findings(log, "--config", str(cure))
    cured, wanted = (read_log(path, Request(config)) for path, config in ((log, str(cure)), (clean, "none")))
    for name in TOPICS:
        pd.testing.assert_frame_equal(cured.tables[name], wanted.tables[name])


@pytest.mark.long
@pytest.mark.parametrize("sensor", TOPICS)
def test_an_outage_is_no_step_of_a_clock(tmp_path: Path, sensor: str) -> None:
    rows = [
        row
        for row in curved_dive()
        if row[1] != TOPICS[sensor] or not SET_NS < row[3]["header.stamp"] < SET_NS + STEP_S * SECOND
    ]

    assert "CLOCK-STEP" not in findings(write_mcap(tmp_path / "dive.mcap", rows))


def test_a_step_that_no_gap_is_as_long_as_is_refused(tmp_path: Path) -> None:
    config = tmp_path / "step.toml"
    config.write_text("[dvl]\nclock_step_s = 7\n")

    with pytest.raises(UsageError, match=r"^clock_step_s = 7, but the longest gap between stamps of /dvl is 0\.50 s"):
        read_log(write_mcap(tmp_path / "dive.mcap", curved_dive()), Request(str(config)))
