"""Records in JSON, however they are arranged in a file and however their times are written."""

import json
from collections.abc import Callable, Sequence
from contextlib import suppress
from datetime import UTC, datetime, timedelta
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from logs import losses
from recordings import saved
from usbldr.filters.errors import LogError
from usbldr.io.decoding.collected import read_whole
from usbldr.io.formats.detect import open_reader

Rows = Sequence[dict[str, Any]]
COUNT = 60
DAY_MS = 86_400_000
CENTURY_MS = st.integers(10**12, 3 * 10**12)  # 2001 to 2065: later ones may count from 1904
OWN_MS = st.integers(0, 10**6)  # [ms] since power-on


def moment(ms: int) -> datetime:
    return datetime.fromtimestamp(ms // 1000, UTC) + timedelta(milliseconds=ms % 1000)


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
TIMES: dict[str, tuple[st.SearchStrategy[int], Callable[[int], Any]]] = {  # name -> in ms from 1970 on, as written
    "time": (CENTURY_MS, lambda ms: ms / 1000),
    "timestamp": (CENTURY_MS, lambda ms: ms),
    "time_ns": (CENTURY_MS, lambda ms: ms * 1_000_000),
    "created": (CENTURY_MS, lambda ms: moment(ms).isoformat()),
    "date": (CENTURY_MS, lambda ms: f"{moment(ms):%d.%m.%Y %H:%M:%S.%f}"),
    "time_s": (OWN_MS, lambda ms: ms / 1000),
    "time_us": (OWN_MS, lambda ms: ms * 1000),
    "t": (OWN_MS, lambda ms: ms / 1000),
    "utc": (st.integers(0, DAY_MS - 1), lambda ms: f"{moment(ms):%H:%M:%S.%f}"),
    "stamp": (CENTURY_MS, lambda ms: {"sec": ms // 1000, "nanosec": ms % 1000 * 10**6}),
}


@pytest.mark.parametrize("arrangement", ARRANGED)
@settings(max_examples=10)
@given(
    name=st.sampled_from(sorted(TIMES)),
    data=st.data(),
    step_ms=st.integers(1, DAY_MS // 4),
    degrees=st.lists(st.floats(-90, 90), min_size=3, max_size=30),
)
def test_each_record_is_read_at_its_time(arrangement: str, name: str, data: Any, step_ms: int, degrees: Any) -> None:
    assume(arrangement != "a line of places" or name not in ("date", "stamp", "utc"))  # which no program writes
    begins_ms, written = TIMES[name]
    first_ms = data.draw(begins_ms)
    times_ms = [first_ms + step_ms * k for k in range(len(degrees))]
    rows = [{name: written(ms), "lat": lat, "lon": 7.0} for ms, lat in zip(times_ms, degrees, strict=True)]
    by_features = "feature" in arrangement or "places" in arrangement
    field = "geometry.coordinates.1" if by_features else "lat"

    with TemporaryDirectory() as folder:
        log = open_reader(saved(Path(folder) / "gps.json", ARRANGED[arrangement](rows)))
        read = read_whole(log, {"/gps": [field]})["/gps"]

    assert read.received_ns.tolist() == [ms * 1_000_000 for ms in times_ms]
    assert read.columns[field].tolist() == degrees
    assert not any(losses(log.findings()).values())


def test_a_time_that_cannot_be_read_is_named_and_counted(tmp_path: Path) -> None:
    rows = [{"time": "late" if k == 5 else moment(10**12 + k).isoformat(), "lat": 45, "lon": 7} for k in range(COUNT)]

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
