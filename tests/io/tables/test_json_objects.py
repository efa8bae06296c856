"""Records in JSON, however they are arranged in a file and however their times are written."""

import json
from collections.abc import Callable, Sequence
from contextlib import suppress
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest

from logs import losses
from recordings import SECOND, T0, saved
from usbldr.filters.errors import LogError
from usbldr.io.decoding.collected import read_whole
from usbldr.io.formats.detect import open_reader

Rows = Sequence[dict[str, Any]]
COUNT, STEP_MS = 60, 250
MOMENTS = [datetime.fromtimestamp(T0 // SECOND, UTC) + timedelta(milliseconds=STEP_MS * k) for k in range(COUNT)]
SINCE_MS = T0 // 1_000_000
NOON_MS = (MOMENTS[0].hour * 3600 + MOMENTS[0].minute * 60 + MOMENTS[0].second) * 1000


def stamp_of(k: int) -> tuple[int, int]:
    return divmod((SINCE_MS + STEP_MS * k) * 10**6, SECOND)


def feature(row: dict[str, Any]) -> dict[str, Any]:
    rest = {name: value for name, value in row.items() if name not in ("lat", "lon")}
    place = {"type": "Point", "coordinates": [row["lon"], row["lat"]]}
    return {"type": "Feature", "geometry": place, "properties": rest}


def features(rows: Rows) -> dict[str, Any]:
    return {"type": "FeatureCollection", "features": [feature(row) for row in rows]}


def line_string(rows: Rows) -> dict[str, Any]:
    name = next(name for name in rows[0] if name not in ("lat", "lon"))
    places = {"type": "LineString", "coordinates": [[row["lon"], row["lat"]] for row in rows]}
    one = {"type": "Feature", "geometry": places, "properties": {name: [row[name] for row in rows]}}
    return {"type": "FeatureCollection", "features": [one]}


ARRANGED: dict[str, Callable[[Rows], str]] = {
    "lines": lambda rows: "".join(json.dumps(row) + "\n" for row in rows),
    "lines behind a comment": lambda rows: "# receiver 1\n// x\n" + "".join(json.dumps(row) + "\n" for row in rows),
    "array": lambda rows: json.dumps(rows),
    "indented array": lambda rows: json.dumps(rows, indent=2),
    "a line each of an array": lambda rows: "[\n" + ",\n".join(map(json.dumps, rows)) + "\n]\n",
    "by number": lambda rows: json.dumps({str(k): row for k, row in enumerate(rows)}),
    "within an object": lambda rows: json.dumps({"vehicle": "a", "data": rows}, indent=1),
    "within two": lambda rows: json.dumps({"log": {"vehicle": "a", "rows": rows}}, indent="\t"),
    "features": lambda rows: json.dumps(features(rows)),
    "indented features": lambda rows: json.dumps(features(rows), indent=2),
    "a line of places": lambda rows: json.dumps(line_string(rows), indent=2),
}
TIMES: dict[str, tuple[str, Callable[[int], Any], int]] = {
    "s": ("time", lambda k: SINCE_MS / 1000 + STEP_MS * k / 1000, SINCE_MS),
    "ms": ("timestamp", lambda k: SINCE_MS + STEP_MS * k, SINCE_MS),
    "ns": ("time_ns", lambda k: (SINCE_MS + STEP_MS * k) * 1_000_000, SINCE_MS),
    "ISO": ("created", lambda k: MOMENTS[k].isoformat(), SINCE_MS),
    "day first": ("date", lambda k: f"{MOMENTS[k]:%d.%m.%Y %H:%M:%S.%f}", SINCE_MS),
    "s of its own clock": ("time_s", lambda k: 7 + STEP_MS * k / 1000, 7000),
    "us of its own clock": ("time_us", lambda k: 7_000_000 + 1000 * STEP_MS * k, 7000),
    "s without a unit": ("t", lambda k: 7 + STEP_MS * k / 1000, 7000),
    "time of day": ("utc", lambda k: f"{MOMENTS[k]:%H:%M:%S.%f}", NOON_MS),
    "stamp": ("stamp", lambda k: dict(zip(("sec", "nanosec"), stamp_of(k), strict=True)), SINCE_MS),
}  # fmt: skip


WRITTEN = [
    (arrangement, time)
    for arrangement in ARRANGED
    for time in TIMES
    if arrangement != "a line of places" or time not in ("day first", "stamp", "time of day")  # which no program writes
]


@pytest.mark.parametrize(("arrangement", "time"), WRITTEN)
def test_each_record_is_read_at_its_time(tmp_path: Path, arrangement: str, time: str) -> None:
    name, of, first_ms = TIMES[time]
    rows = [{name: of(k), "lat": 45 + k / 1000, "lon": 7.0} for k in range(COUNT)]
    log = open_reader(saved(tmp_path / "gps.json", ARRANGED[arrangement](rows)))

    by_features = "feature" in arrangement or "places" in arrangement
    field = "geometry.coordinates.1" if by_features else "lat"
    read = read_whole(log, {"/gps": [field]})["/gps"]

    assert read.received_ns.tolist() == [(first_ms + STEP_MS * k) * 1_000_000 for k in range(COUNT)]
    assert read.columns[field].tolist() == [45 + k / 1000 for k in range(COUNT)]
    assert not any(losses(log.findings()).values())


def test_a_time_that_cannot_be_read_is_named_and_counted(tmp_path: Path) -> None:
    rows = [{"time": "late" if k == 5 else MOMENTS[k].isoformat(), "lat": 45, "lon": 7} for k in range(COUNT)]

    (lost,) = losses(open_reader(saved(tmp_path / "gps.json", ARRANGED["lines"](rows))).findings())

    assert (
        lost
        == '/gps: 1 of 60 objects have a time that cannot be read: time is "late", not a number of seconds before 2116'
    )


@pytest.mark.parametrize(
    "text",
    [
        '{"a": [{"stamp": {"sec": "x", "nanosec": null}}, {"stamp": {"sec": 1.5, "nanosec": 2}}]}',
        '{"a": ' * 900 + "[]" + "}" * 900,
        '[{"time": true}, {"time": null}, {"time": []}, 5, "x"]',
        '{\n"time": [1, 2, 3],\n"0": {"0": [1, 2, 3]}}',
        '{"time": ["1", 2, null], "x": [1, 2, 3]}',
    ],
)
def test_odd_objects_are_read_or_refused(tmp_path: Path, text: str) -> None:
    with suppress(LogError):
        log = open_reader(saved(tmp_path / "a.json", text))
        read_whole(log, {topic.key: list(topic.fields) for topic in log.topics() if topic.count})


def test_what_records_share_may_not_fill_the_memory(tmp_path: Path) -> None:
    shared = {"note": "n" * 100_000, "time": [*range(60_000)], "x": [*range(60_000)]}

    with pytest.raises(LogError, match="too much for its size"):
        open_reader(saved(tmp_path / "a.json", json.dumps({"log": shared}, indent=1))).topics()
