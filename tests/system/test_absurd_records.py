"""Numbers that no sensor means, and logs of hardly a record: findings or one sentence, and never a warning."""

import math
import random
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from commands import run
from curved import curved_dive
from logs import codes
from recordings import HEADING, POSE_COVARIANCE, PRESSURE, SECOND, T0, TWIST_COVARIANCE, Row, write_mcap
from usbldr.io.provenance import Convention
from usbldr.io.reading.read import read_log
from usbldr_cli.figures.run_figures import run_pictures

ODD = (1e300, -1e300, 1e308, math.nan, math.inf, -math.inf, 0.0, 1e-300, 1e17, 1e10, 1e6, -1e6)
FIELDS = {
    "/dvl": ("twist.linear.x", "twist.linear.y", "twist.linear.z"),
    "/imu": ("orientation.x", "orientation.z", "orientation.w", "linear_acceleration.z"),
    "/usbl": ("point.x", "point.y", "point.z"),
    "/gps/fix": ("latitude", "longitude", "altitude"),
    "/depth": ("fluid_pressure", "variance"),
}
STAMPS = (0, 1, T0, (2**31 - 1) * SECOND)
WHICH: dict[str, Callable[[int], bool]] = {"all": lambda _: True, "one": lambda n: n == 7, "half": lambda n: n % 2 == 1}


def whole_dive() -> list[Row]:
    rows = [row for row in curved_dive(gps=True) if row[0] < T0 + 90 * SECOND]
    stamps = range(T0, T0 + 90 * SECOND, SECOND)
    rows += [(t, "/depth", PRESSURE, {"header.stamp": t, "fluid_pressure": 150000.0}) for t in stamps]
    return sorted(rows, key=lambda row: row[0])


BASE = whole_dive()


def changed(topic: str, field: str, value: object, which: str = "all") -> list[Row]:
    """Return the dive with a field of a topic's messages changed, of those that are chosen."""
    seen, rows = 0, list[Row]()
    for row in BASE:
        hit = row[1] == topic and WHICH[which](seen)
        seen += row[1] == topic
        rows.append((*row[:3], dict(row[3]) | {field: value}) if hit else row)
    return sorted(rows, key=lambda row: row[0])


def retyped(topic: str, kind: str, fields: dict[str, str], **more: object) -> list[Row]:
    """Return the dive with a topic's messages of another type: new field -> old field."""
    rows: list[Row] = []
    for row in BASE:
        values = {new: row[3][old] for new, old in fields.items()} if row[1] == topic else {}
        of_all = {name.replace("__", "."): value for name, value in more.items()}
        rows.append((row[0], topic, kind, values | of_all) if values else row)
    return rows


def with_covariance(value: float) -> dict[str, list[Row]]:
    square, stamp = np.full(36, value), {"header.stamp": "header.stamp"}
    of_point = stamp | {f"pose.pose.position.{axis}": f"point.{axis}" for axis in "xyz"}
    of_twist = stamp | {f"twist.twist.linear.{axis}": f"twist.linear.{axis}" for axis in "xyz"}
    return {
        f"{value} as covariance of the fixes": retyped("/usbl", POSE_COVARIANCE, of_point, pose__covariance=square),
        f"{value} as covariance of the DVL": retyped("/dvl", TWIST_COVARIANCE, of_twist, twist__covariance=square),
        f"{value} as covariance of the heading": changed("/imu", "orientation_covariance", square[:9]),
        f"{value} as every heading": [
            (r[0], "/heading", HEADING, {"data": value}) if r[1] == "/imu" else r for r in BASE
        ],
    }


def few(topic: str, count: int) -> list[Row]:
    """Return the dive with some messages of a topic, or of each, only."""
    seen, rows = Counter[str](), list[Row]()
    for row in BASE:
        seen[row[1]] += 1
        if seen[row[1]] <= count or topic not in (row[1], "each"):
            rows.append(row)
    return rows


def logs() -> dict[str, list[Row]]:
    """Return all the logs by what is odd about them."""
    made = {
        f"{value} in {which} of {topic} {field}": changed(topic, field, value, which)
        for topic, fields in FIELDS.items()
        for field in fields
        for value in ODD
        for which in WHICH
    }
    for value in ODD:
        made |= with_covariance(value)
    for topic in FIELDS:
        for stamp in STAMPS:
            made |= {f"{which} of {topic} at {stamp}": changed(topic, "header.stamp", stamp, which) for which in WHICH}
    for topic in (*FIELDS, "each"):
        made |= {f"{count} of {topic}": few(topic, count) for count in (0, 1, 2, 3, 5) if topic != "each" or count}
    made["every stamp alike"] = [(T0, *row[1:3], dict(row[3]) | {"header.stamp": T0}) for row in BASE]
    made |= {f"every log time {t}": [(t, *row[1:]) for row in BASE] for t in (0, 1, 2**62, 2**63 - 1)}
    return made


def commands(log: Path) -> list[list[str]]:
    target = str(log.with_name("run"))
    return [
        ["info", str(log)],
        ["doctor", str(log)],
        ["init", str(log), "--force", "--output", str(log.with_name("found.toml"))],
        ["replay", str(log), "-f", "ekf", "--force", "-q", "-o", target],
    ]


@pytest.mark.parametrize("some", [pytest.param(12, marks=pytest.mark.long), pytest.param(None, marks=pytest.mark.slow)])
def test_odd_logs_end_in_findings_or_one_sentence(tmp_path: Path, some: int | None) -> None:
    every = logs()
    for what in random.Random(1).sample(sorted(every), some or len(every)):
        log = write_mcap(tmp_path / "odd.mcap", every[what])
        for command in commands(log):
            run(*command)


@pytest.mark.slow
def test_pictures_of_odd_logs_are_drawn_without_a_warning(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("usbldr_cli.figures.run_figures.run_pictures", run_pictures)
    every = logs()
    for what in [*random.Random(2).sample(sorted(every), 25), "1 of each", "every stamp alike", "1 of /usbl"]:
        log = write_mcap(tmp_path / "odd.mcap", every[what])
        run(*commands(log)[-1])


@pytest.mark.parametrize(
    ("topic", "field", "value", "code", "cause"),
    [
        ("/usbl", "point.x", 3e9, "USBL-INVALID", "1 beyond 20000 km"),
        ("/depth", "fluid_pressure", 3e9, "DEPTH-INVALID", "1 beyond 12 km"),
        ("/imu", "orientation.z", 1e200, "COMPASS-INVALID", "1 not a number"),
    ],
)
def test_a_record_of_another_world_is_left_out_and_counted(tmp_path, topic, field, value, code, cause):
    log = read_log(write_mcap(tmp_path / "dive.mcap", changed(topic, field, value, "one")))

    assert codes(log)[code].endswith(f"records are invalid and left out ({cause})")


def test_a_variance_without_bounds_is_unknown(tmp_path: Path) -> None:
    log = read_log(write_mcap(tmp_path / "dive.mcap", with_covariance(1e17)["1e+17 as covariance of the fixes"]))

    assert Convention("sd_m", 1.0, "default", "m") in log.provenance["usbl"].conventions
