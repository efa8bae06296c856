"""A clock that was set forward within the log: named, no outage, undone by the proposed key."""

from pathlib import Path

import pandas as pd
import pytest

from commands import findings, run
from curved import curved_dive, stating, written
from recordings import SECOND, T0, Row
from usbldr.filters.errors import UsageError
from usbldr.io.doctor.cross_check import convention_warnings
from usbldr.io.findings import Finding
from usbldr.io.reading.epochs import timeline
from usbldr.io.reading.read import Request, read_log

SET_NS, STEP_S = T0 + 150 * SECOND + 1, 25
TOPICS = {"dvl": "/dvl", "compass": "/imu", "usbl": "/usbl"}


def stepped(rows: list[Row], topic: str, log_time_too: bool, step_s: int = STEP_S) -> list[Row]:
    """Return the dive with a topic's clock set forward in the middle, and perhaps that of its recorder."""

    def late(row: Row) -> Row:
        if row[1] != topic or row[3]["header.stamp"] < SET_NS:
            return row
        values = dict(row[3]) | {"header.stamp": row[3]["header.stamp"] + step_s * SECOND}
        return (row[0] + step_s * SECOND * log_time_too, *row[1:3], values)

    return sorted(map(late, rows), key=lambda row: row[0])


def warned(log: Path, config: str = "none") -> dict[str, Finding]:
    """Return code -> finding of what replay warns of, which needs no identification."""
    opened = read_log(log, Request(config))
    return {one.code: one for one in convention_warnings(opened, timeline(opened))}


@pytest.mark.parametrize(
    ("sensor", "log_time_too", "step_s"),
    [
        ("dvl", True, STEP_S),
        ("compass", False, STEP_S),
        ("usbl", True, STEP_S),
        *((each, True, 3600) for each in TOPICS),
    ],
)
def test_a_clock_that_was_set_is_named_and_undone_by_its_key(tmp_path, sensor, log_time_too, step_s):
    """Also by an hour, after which nothing lies within the time of the other sensors."""
    rows = curved_dive()
    clean = written(tmp_path / "clean", rows)
    log = written(tmp_path / "stepped", stepped(rows, TOPICS[sensor], log_time_too, step_s))

    ill = warned(log)["CLOCK-STEP"]
    proposed, section = ill.text.split("state ")[1].split(" under ")
    cure = stating(log, f"{section}\n{proposed}\n")

    assert (section, ill.topic) == (f"[{sensor}]", TOPICS[sensor])
    assert ill.worst == pytest.approx(step_s, abs=0.01)
    assert "[CLOCK-STEP]" in run("replay", log, "--config", "none", "--output", tmp_path / "run").stderr
    assert "CLOCK-STEP" not in warned(log, cure)
    cured, wanted = (read_log(path, Request(config)) for path, config in ((log, cure), (clean, "none")))
    for name in TOPICS:
        pd.testing.assert_frame_equal(cured.tables[name], wanted.tables[name])


@pytest.mark.parametrize("sensor", TOPICS)
def test_an_outage_is_no_step_and_no_step_longer_than_all_gaps_is_undone(tmp_path: Path, sensor: str) -> None:
    def in_gap(row: Row) -> bool:
        return row[1] == TOPICS[sensor] and SET_NS < row[3]["header.stamp"] < SET_NS + STEP_S * SECOND

    rows = [row for row in curved_dive() if not in_gap(row)]
    log = written(tmp_path, rows)

    assert "CLOCK-STEP" not in warned(log)
    gap = rf"the longest gap between stamps of {TOPICS[sensor]} is 2[56]\.\d\d s"
    with pytest.raises(UsageError, match=rf": \[{sensor}\] clock_step_s = 70, but {gap}"):
        warned(log, stating(log, f"[{sensor}]\nclock_step_s = 70\n"))


def test_the_doctor_names_the_step_of_a_clock(tmp_path: Path) -> None:
    assert findings(written(tmp_path, stepped(curved_dive(), "/dvl", True)))["CLOCK-STEP"]["topic"] == "/dvl"
