"""Clocks of sensors that a test has set: how far they are off is known."""

import math
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from commands import findings, replayed, run
from curved import FLIPPED, changed, cured_by, curved_dive, stating, written
from recordings import SECOND, T0, Row, point
from usbldr.filters.errors import UsageError
from usbldr.filters.identification.evidence import Explained
from usbldr.filters.identification.identification import Identification
from usbldr.filters.models.parameters import Parameters
from usbldr.filters.types import Timeline, Vector
from usbldr.io.doctor import clocks
from usbldr.io.doctor.clocks import sensor_clock_error
from usbldr.io.doctor.cross_check import convention_warnings, cross_check
from usbldr.io.doctor.gross_errors import SingleError
from usbldr.io.doctor.interpretations import InterpretationResult, compare_interpretations
from usbldr.io.drills.drill import Drill, damaged
from usbldr.io.drills.fault_text import fault_of
from usbldr.io.findings import Finding
from usbldr.io.log import Log
from usbldr.io.reading.epochs import timeline
from usbldr.io.reading.read import Request, read_log

SET_NS, STEP_S = T0 + 150 * SECOND + 1, 25
TOPICS = {"dvl": "/dvl", "compass": "/imu", "usbl": "/usbl"}


def ahead(topic: str, by_s: float) -> list[Row]:
    """Return a dive with a topic's stamps on a clock that is ahead; log times stay."""
    by_ns = round(by_s * SECOND)
    return changed(curved_dive(gps=True), topic, header__stamp=lambda values: values["header.stamp"] + by_ns)


@pytest.mark.parametrize("ahead_s", [-18.0, 37.0, 150.0])
@pytest.mark.long
def test_fixes_on_another_clock_are_no_turned_dvl(tmp_path: Path, ahead_s: float) -> None:
    """GPS time is 18 s ahead of UTC."""
    log, cure = written(tmp_path, ahead("/usbl", ahead_s)), f"[usbl]\nlatency_s = {ahead_s}\n"

    ill, cured = findings(log), cured_by(log, cure)

    assert ill["CLOCK-OFFSET"]["worst"] == pytest.approx(ahead_s, abs=0.2)
    assert ("GPS time and UTC" in ill["CLOCK-OFFSET"]["text"]) == (abs(ahead_s) == 18.0)
    assert (FLIPPED | {"DVL-MOUNT", "USBL-LATENCY", "TRUTH-CLOCK"}).isdisjoint(ill)
    assert "CLOCK-OFFSET" in replayed(log)
    assert {"CLOCK-OFFSET", "DVL-MOUNT", "USBL-LATENCY"}.isdisjoint(cured)


@pytest.mark.long
def test_a_truth_with_the_clock_of_the_fixes_shows_whose_clock_is_wrong(tmp_path: Path) -> None:
    by_ns = 18 * SECOND
    rows = curved_dive(gps=True)
    for topic in ("/dvl", "/imu"):
        rows = changed(rows, topic, header__stamp=lambda values: values["header.stamp"] + by_ns)

    found = findings(written(tmp_path, rows))

    assert "state latency_s = 18.00 under [dvl] and [compass]" in found["CLOCK-OFFSET"]["text"]
    assert "TRUTH-CLOCK" not in found


@pytest.mark.parametrize(
    ("how", "weight"),
    [
        ("a weight of 20%", lambda age: 0.8**age * np.where(age == age.max(), 1.0, 0.2)),
        ("the mean of the last 15:", lambda age: age < 15),
    ],
)
@pytest.mark.long
def test_smoothed_fixes_are_named_and_no_clock_is(tmp_path: Path, how: str, weight: Callable[[Vector], Vector]) -> None:
    def smooth(axis: str) -> Callable[[Mapping[str, Any]], float]:
        fixes_m = list[float]()

        def mean(values: Mapping[str, Any]) -> float:
            fixes_m.insert(0, float(values[axis]))
            return float(np.average(fixes_m, weights=weight(np.arange(float(len(fixes_m))))))

        return mean

    rows = changed(curved_dive(gps=True), "/usbl", point__x=smooth("point.x"), point__y=smooth("point.y"))

    log = written(tmp_path, rows)
    found = findings(log)

    assert how in found["USBL-SMOOTHED"]["text"]
    assert {"TRUTH-CLOCK", "USBL-LATENCY", "CLOCK-OFFSET"}.isdisjoint(found)
    warnings = replayed(log, "-f", "adf")
    assert "USBL-SMOOTHED" in warnings
    assert "CLOCK-OFFSET" not in warnings


@pytest.mark.parametrize(("topic", "section", "ahead_s"), [("/dvl", "dvl", 18.0), ("/imu", "compass", -18.0)])
@pytest.mark.long
def test_a_clock_that_only_the_fixes_contradict_is_named(tmp_path: Path, topic: str, section: str, ahead_s: float):
    """Log times are of the same clock, as in a table."""
    by_ns = round(ahead_s * SECOND)
    moved = [(row[0] + by_ns * (row[1] == topic), *row[1:]) for row in ahead(topic, ahead_s)]
    log = written(tmp_path, sorted(moved, key=lambda row: row[0]), f"[{section}]\nlatency_s = 1.0\n")
    code = f"{section.upper()}-CLOCK"

    ill = findings(log)[code]
    key = re.search(rf"state (latency_s = (\S+)) under \[{section}\]", ill["text"])

    assert key is not None
    assert float(key[2]) == pytest.approx(ahead_s, abs=0.5)
    assert f"{abs(ahead_s - 1):.0f}.0 s {'late' if ahead_s > 0 else 'early'} against the other sensors" in ill["text"]
    assert "(GPS time and UTC are 18 s apart)" in ill["text"]
    assert code in replayed(log, "-f", "adf", "--plots", "none")
    assert {code, "DVL-MOUNT", "SENSOR-CHANGE", "FALSE-FIXES"}.isdisjoint(cured_by(log, f"[{section}]\n{key[1]}\n"))


HEADINGS_OFF = "compass:40deg@160:220"


@pytest.fixture(scope="module")
def with_fault(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str, str], Log]:
    """Return the function that puts a fault into the records of a dive."""
    log = read_log(written(tmp_path_factory.mktemp("clean"), curved_dive()), Request("none"))
    return lambda kind, text: damaged(log, Drill("", (fault_of(kind, text),)), 0)


def candidate(log: Log) -> tuple[Timeline, InterpretationResult, tuple[SingleError, float] | None]:
    """Return the timeline of a log, its interpretations, and the clock that fits best."""
    line = timeline(log)
    result = compare_interpretations(log, line)
    assert result is not None
    return line, result, sensor_clock_error(log, line, result)


def test_a_clock_is_a_candidate_if_a_fifth_of_the_residual_vanishes_with_it(with_fault) -> None:
    spans = [f"@{from_s}:{from_s + 60}" for from_s in range(40, 240, 20)]
    found = [candidate(with_fault("bias", f"compass:40deg{span}"))[1:] for span in spans]

    shares = [clock[1] / result.interpretations[0].residual_m for result, clock in found if clock]
    assert 0 < len(shares) < len(found)
    assert max(shares) <= 0.8


@pytest.mark.parametrize("fault", ["dvl:2s", "compass:-2s"])
def test_a_clock_that_replay_corrects_is_no_candidate(with_fault: Callable[[str, str], Log], fault: str) -> None:
    """The least that is far, 4 s, fits no better than 0."""
    *_, clock = candidate(with_fault("clock", fault))

    assert clock is None


@pytest.mark.long
def test_a_candidate_is_refused_that_explains_less_than_headings_that_are_off_for_a_minute(with_fault) -> None:
    log = with_fault("bias", HEADINGS_OFF)
    line, _, clock = candidate(log)

    assert clock is not None
    assert clock[0].code not in {one.code for one in cross_check(log, line).findings}


@pytest.mark.parametrize(("odds", "named"), [(19.0, False), (21.0, True)])
def test_the_evidence_for_a_clock_is_strong_at_odds_of_20_to_1(with_fault, monkeypatch, odds, named):
    log, found = with_fault("bias", HEADINGS_OFF), Identification(Parameters(), log_evidence=-500.0)
    line, result, _ = candidate(log)
    monkeypatch.setattr(clocks, "explained_by", lambda *_: Explained(-500.0 + math.log(odds), lambda: found))

    assert (clocks.clock_by_evidence(log, line, result, found) is not None) == named


@pytest.mark.parametrize(("fault", "named"), [("dvl:18s", "DVL-CLOCK"), ("usbl:37s", "CLOCK-OFFSET")])
def test_a_clock_of_a_sensor_hides_no_step_and_no_offset_of_the_fixes(with_fault, monkeypatch, fault, named):
    log, found, corrected = with_fault("clock", fault), Identification(Parameters()), Identification(Parameters())
    line, codes = timeline(log), ("CLOCK-STEP", "DVL-CLOCK")
    step, clock = (Finding(code, "its clock is wrong") for code in codes)
    stubs = {
        "clock_step_findings": [step],
        "clock_by_evidence": ([clock], Explained(0.0, lambda: corrected), line),
        "_identified": found,
    }
    for name, value in stubs.items():
        monkeypatch.setattr(f"usbldr.io.doctor.cross_check.{name}", lambda *_, value=value: value)

    check = cross_check(log, line)
    assert (check.identification is corrected) == (named == "DVL-CLOCK")
    for by in (check.findings, convention_warnings(log, line, found)):
        assert {one.code for one in by} & {*codes, "CLOCK-OFFSET"} == {"CLOCK-STEP", named}


@pytest.mark.parametrize(("topic", "section", "ahead_s"), [("/dvl", "dvl", 18.0), ("/imu", "compass", -18.0)])
@pytest.mark.long
def test_the_clock_that_no_driver_explains_is_wrong(tmp_path: Path, topic: str, section: str, ahead_s: float) -> None:
    log = written(tmp_path, ahead(topic, ahead_s))

    ill, cured = findings(log)["CLOCK-OFFSET"], cured_by(log, f"[{section}]\nlatency_s = {ahead_s}\n")

    assert (ill["topic"], ill["worst"]) == (topic, pytest.approx(-ahead_s))
    assert f"state latency_s = {ahead_s:.2f} under [{section}]" in ill["text"]
    assert {"CLOCK-OFFSET", "DVL-MOUNT", "DVL-CLOCK"}.isdisjoint(cured)


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
        ("compass", False, STEP_S),
        ("usbl", True, STEP_S),
        ("dvl", True, 3600),
        *(
            pytest.param(sensor, True, step_s, marks=pytest.mark.slow)
            for sensor, step_s in (("dvl", STEP_S), ("compass", 3), ("compass", 3600), ("usbl", 3600))
        ),
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

    log = written(tmp_path, [row for row in curved_dive() if not in_gap(row)])

    assert "CLOCK-STEP" not in warned(log)
    gap = rf"the longest gap between stamps of {TOPICS[sensor]} is 2[56]\.\d\d s"
    with pytest.raises(UsageError, match=rf": \[{sensor}\] clock_step_s = 70, but {gap}"):
        warned(log, stating(log, f"[{sensor}]\nclock_step_s = 70\n"))


def test_the_doctor_names_the_step_of_a_clock(tmp_path: Path) -> None:
    assert findings(written(tmp_path, stepped(curved_dive(), "/dvl", True)))["CLOCK-STEP"]["topic"] == "/dvl"


def test_fixes_of_two_transponders_at_one_time_are_no_step_of_a_clock(tmp_path: Path) -> None:
    """One lies still, so that half of all intervals are 0 and the others no gaps."""
    rows = curved_dive(seconds=60)
    still = [point(row[3]["header.stamp"], 30.0, 40.0, delay_s=0.8) for row in rows if row[1] == "/usbl"]
    log = read_log(written(tmp_path, sorted([*rows, *still], key=lambda row: row[0])))

    assert len(log.tables["usbl"]) == 2 * len(still)
    assert not clocks.clock_step_findings(log, timeline(log), [(False, False, False)])
