"""Files of Doppler logs written by the book: PD0, PD6, JSON lines; and a PD0 file of a river boat."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from dvl_recordings import COUNT, ensemble, velocity, write_json, write_pd0, write_pd6
from recordings import SECOND, T0, saved_lines
from usbldr.filters.errors import LogError, UsageError
from usbldr.io.decoding.collected import read_whole
from usbldr.io.formats.detect import open_reader
from usbldr.io.reading.opening import Request
from usbldr.io.reading.read import read_log


def json_lines(folder: Path) -> list[str]:
    return write_json(folder / "a.jsonl").read_text(encoding="utf-8").splitlines()


@pytest.mark.parametrize("coordinates", [1, 2])
def test_bottom_track_of_pd0_is_the_bottoms_motion(tmp_path: Path, coordinates: int) -> None:
    log = read_log(write_pd0(tmp_path / "a.pd0", coordinates))
    dvl = log.tables["dvl"]

    assert log.format == "PD0"
    assert log.start_ns == T0 - 40 * SECOND + 500_000_000
    np.testing.assert_allclose(dvl["starboard_mps"], -0.25)
    np.testing.assert_allclose(dvl["forward_mps"], 1.5)
    np.testing.assert_allclose(dvl["up_mps"], -0.01)
    np.testing.assert_allclose(log.tables["compass"]["heading_deg"], (355 + np.arange(COUNT) / 2) % 360)
    np.testing.assert_allclose(log.tables["depth"]["depth_m"], 10 + np.arange(COUNT) / 10)
    gps = read_whole(open_reader(tmp_path / "a.pd0"), {"/gga": ["latitude", "longitude", "quality"]})["/gga"]
    assert gps.columns["latitude"].tolist() == [64.5 + k * 1e-6 for k in range(COUNT)]
    assert set(gps.columns["longitude"].tolist()) == {-149.0}
    np.testing.assert_allclose(np.diff(dvl["time_s"]), 1.0)
    np.testing.assert_allclose(dvl["time_s"] - log.tables["gps"]["time_s"], 0.25)


def test_velocities_along_beams_become_those_of_the_instrument(tmp_path: Path) -> None:
    """A vehicle that moves by (x, y, z) sees its velocity along each beam: the projection, away from the bottom."""
    x, y, z = 0.6, -1.2, 0.1  # of the bottom
    s, c = np.sin(np.radians(30)), np.cos(np.radians(30))
    beams = (x * s + z * c, -x * s + z * c, -y * s + z * c, y * s + z * c)
    file = write_pd0(tmp_path / "a.pd0", 0, tuple(round(1000 * v) for v in beams))  # type: ignore[arg-type]
    dvl = read_log(file).tables["dvl"]

    np.testing.assert_allclose(dvl[["starboard_mps", "forward_mps", "up_mps"]].iloc[0], [-x, -y, -z], atol=2e-3)


def test_altitudes_of_a_dvl_are_those_of_its_good_records(tmp_path: Path, field_logs: Path) -> None:
    """PD0 has a range by each beam, 0 if there is none."""
    pd0 = read_log(write_pd0(tmp_path / "a.pd0")).altitude
    np.testing.assert_allclose(pd0["altitude_m"], np.mean([700, 710, 705]))
    reports = read_log(write_json(tmp_path / "a.json")).altitude
    assert reports is not None
    assert len(reports) == COUNT - 1
    assert set(reports["altitude_m"]) == {2.5}
    assert read_log(write_pd6(tmp_path / "a.pd6")).altitude is None
    river = read_log(field_logs / "mhkit_riverpro" / "RiverPro_test01.PD0").altitude
    assert 0.5 < river["altitude_m"].min() < river["altitude_m"].max() < 10  # of a river


def test_a_beam_without_velocity_makes_an_invalid_record(tmp_path: Path) -> None:
    parts = [ensemble(k, 0, (1, 2, 3, -32768 if k == 7 else 4)) for k in range(COUNT)]
    (tmp_path / "a.pd0").write_bytes(b"".join(parts))

    assert read_log(tmp_path / "a.pd0").tables["dvl"]["valid"].tolist() == [k != 7 for k in range(COUNT)]


def test_velocities_of_pd0_in_earth_axes_are_refused(tmp_path: Path) -> None:
    with pytest.raises(LogError, match=r"40 in earth coordinates; velocities along beams or in earth axes cannot be"):
        read_log(write_pd0(tmp_path / "a.pd0", 3))


def test_a_river_boats_pd0_has_the_values_of_an_independent_reader(field_logs: Path) -> None:
    """The CSV file is not ours: it has the velocities with four decimals, and none if a beam has none."""
    folder = field_logs / "mhkit_riverpro"
    log = open_reader(folder / "RiverPro_test01.PD0")
    (file,) = (folder / "csv").glob("*dvl.csv")
    rows = list(csv.DictReader(file.open(encoding="utf-8")))
    track = read_whole(log, {"/bottom_track": ["x", "y", "z"]})["/bottom_track"].columns
    heading = read_whole(log, {"/heading": ["heading_deg"]})["/heading"].columns["heading_deg"]

    assert [topic.count for topic in log.topics()][:2] == [273, 273]
    assert log.findings() == ()
    for axis, name, sign in (("x", "port_mps", 1), ("y", "forward_mps", -1), ("z", "up_mps", -1)):
        expected = np.array([float(row[name] or "nan") for row in rows])
        whole = np.isfinite(track["x"] + track["y"])
        np.testing.assert_allclose(np.where(whole, sign * track[axis], np.nan), expected, atol=6e-5)
    np.testing.assert_allclose(heading, [float(row["heading_magnetic_deg"]) for row in rows], atol=1e-9)


def test_pd6_is_read_in_ships_axes(tmp_path: Path) -> None:
    log = read_log(write_pd6(tmp_path / "a.pd6"))
    dvl = log.tables["dvl"]

    assert log.start_ns == T0
    assert {role: p.topic for role, p in log.provenance.items()} == {"dvl": "/BS", "compass": "/SA", "depth": "/TS"}
    np.testing.assert_allclose(dvl["starboard_mps"], -0.42)
    np.testing.assert_allclose(dvl["forward_mps"], (100 + np.arange(COUNT)) / 1000)
    assert dvl["valid"].tolist() == [k != 3 for k in range(COUNT)]
    np.testing.assert_allclose(dvl["time_s"], np.arange(COUNT) / 100)
    np.testing.assert_allclose(log.tables["compass"]["heading_deg"], (355 + np.arange(COUNT) / 2) % 360)
    np.testing.assert_allclose(log.tables["depth"]["depth_m"], 10 + np.arange(COUNT) / 10)
    named = read_log(tmp_path / "a.pd6", Request(topics={"dvl": "/BI"})).tables["dvl"]
    np.testing.assert_allclose(named[["starboard_mps", "forward_mps", "up_mps"]].iloc[0], [-0.42, 0.1, -2.0])
    with pytest.raises(UsageError, match="it holds velocities in earth axes; record instrument or ship coordinates"):
        read_log(tmp_path / "a.pd6", Request(topics={"dvl": "/BE"}))


def test_sensors_of_pd6_that_write_zeros_are_none(tmp_path: Path) -> None:
    log = open_reader(write_pd6(tmp_path / "a.pd6", sensors=False))

    assert [topic.name for topic in log.topics()] == ["/BI", "/BS", "/BE"]


def test_reports_of_water_linked_are_read(tmp_path: Path) -> None:
    file = write_json(tmp_path / "a.jsonl")
    log = read_log(file)
    dvl = log.tables["dvl"]

    assert log.format == "JSON lines"
    assert not any(finding.lost_data for finding in log.findings)
    np.testing.assert_allclose(dvl["forward_mps"], 0.5 + np.arange(COUNT) / 100)
    np.testing.assert_allclose(dvl["starboard_mps"], -0.25)
    np.testing.assert_allclose(dvl["up_mps"], -0.125)
    assert dvl["valid"].tolist() == [k != 3 for k in range(COUNT)]
    np.testing.assert_allclose(dvl["received_s"] - dvl["time_s"], 0.05, atol=1e-9)
    for role, why in {"compass": "counts from where dead reckoning began", "usbl": "holds dead reckoning"}.items():
        with pytest.raises(UsageError, match=why):
            read_log(file, Request(topics={role: "/position_local"}))


@pytest.mark.parametrize(
    "form", ["array", "rows of an array", "indented", "indented array", "two on a line", "text behind"]
)
def test_reports_are_read_however_the_lines_are_cut(tmp_path: Path, form: str) -> None:
    lines = json_lines(tmp_path)
    text = {
        "array": f"[{', '.join(lines)}]",
        "rows of an array": "[\n" + ",\n".join(lines) + "\n]",
        "indented": "\n".join(json.dumps(json.loads(line), indent=2) for line in lines),
        "indented array": json.dumps([json.loads(line) for line in lines], indent=4),
        "two on a line": "\n".join(map("".join, zip(lines[::2], [*lines[1::2], ""], strict=True))),
        "text behind": "\n".join(f"{line} # rx 212 bytes" for line in lines),
    }[form]

    logs = [open_reader(tmp_path / "a.jsonl"), open_reader(saved_lines(tmp_path / "b.json", [text]))]

    read = [read_whole(log, {"/velocity": ["vx", "time_of_validity"]})["/velocity"] for log in logs]
    np.testing.assert_array_equal(read[1].received_ns, read[0].received_ns)
    np.testing.assert_array_equal(read[1].columns["vx"], read[0].columns["vx"])
    assert [finding.text for finding in logs[1].findings()] == []


def test_an_object_that_is_not_closed_costs_its_lines_alone(tmp_path: Path) -> None:
    texts = [json.dumps(json.loads(line), indent=2) for line in json_lines(tmp_path)]
    texts[4] = texts[4].removesuffix("}")

    logs = [open_reader(tmp_path / "a.jsonl"), open_reader(saved_lines(tmp_path / "b.json", texts))]

    whole, left = (sum(topic.count for topic in log.topics()) for log in logs)
    assert (whole - left, [finding.lost_data for finding in logs[1].findings()]) == (1, [True])


@pytest.mark.parametrize("cut", ['"vx"', '"type"', "}"])
def test_a_report_that_ends_early_is_named(tmp_path: Path, cut: str) -> None:
    lines = json_lines(tmp_path)
    lines[4] = lines[4].replace(f", {cut}", f"}} {cut}", 1) if cut != "}" else lines[4][:-1]

    found = open_reader(saved_lines(tmp_path / "b.jsonl", lines)).findings()

    assert "lines are no JSON, the first is line 5" in next(one.text for one in found if one.lost_data)


def test_reports_before_the_clock_was_set_count_from_power_on(tmp_path: Path) -> None:
    reports = [one for one in map(json.loads, json_lines(tmp_path)) if one.get("type") == "velocity"]
    for k, report in enumerate(reports[:20]):
        report |= {"time_of_validity": 30_000_000 + 200_000 * k, "time_of_transmission": 30_050_000 + 200_000 * k}

    log = open_reader(saved_lines(tmp_path / "b.jsonl", map(json.dumps, reports)))
    read = read_whole(log, {"/velocity": ["time_of_validity"]})["/velocity"]

    assert read.received_ns[:20].tolist() == [30_050_000_000 + 200_000_000 * k for k in range(20)]
    (text,) = [finding.text for finding in log.findings() if finding.code == "NO-DATE"]
    assert text.startswith("b.jsonl: its clock was set later")


def test_positions_of_underwater_gps_need_a_time_before_each(tmp_path: Path) -> None:
    place = {"cog": -1, "fix_quality": 1, "hdop": 1.9, "lat": 63.4, "lon": 10.4, "numsats": 11, "sog": 0}
    places = [{**place, "lat": 63.4 + k * 1e-6} for k in range(COUNT)]
    bare = saved_lines(tmp_path / "bare.txt", map(json.dumps, places))
    whole = saved_lines(
        tmp_path / "whole.txt", (json.dumps(p | {"ts": T0 // SECOND + k}) for k, p in enumerate(places))
    )
    timed = (f"2020-09-13T12:26:40.{k:02d}Z {json.dumps(p)}" for k, p in enumerate(places))

    (finding,) = open_reader(bare).findings()
    log = read_log(saved_lines(tmp_path / "timed.txt", timed), Request(topics={"usbl": "/global"}))

    assert finding.text == "bare.txt: 40 lines have no time; log them with one before each line"
    assert (len(log.tables["usbl"]), log.start_ns) == (COUNT, T0)
    assert read_whole(open_reader(whole), {"/global": ["lat"]})["/global"].received_ns[-1] == T0 + (COUNT - 1) * SECOND
    assert not open_reader(whole).findings()


def test_reports_of_the_first_version_of_json_are_timed_one_after_the_other(tmp_path: Path) -> None:
    left_out = ("type", "time_of_validity", "time_of_transmission", "covariance")
    reports = ({k: v for k, v in velocity(k).items() if k not in left_out} for k in range(COUNT))
    lines = [json.dumps({**report, "time": 200.0, "format": "json_v1"}) for report in reports]

    log = read_log(saved_lines(tmp_path / "dvl.txt", lines))

    assert log.format == "JSON lines"
    assert log.provenance["dvl"].used == COUNT - 1  # one is invalid
    assert log.tables["dvl"]["received_s"].diff().dropna().round(9).isin([0.2, 0.4]).all()
    assert [finding.code for finding in log.findings if finding.code == "NO-DATE"] == ["NO-DATE"]


@pytest.mark.parametrize(
    "line", ['{{"topic": "/rov/{}", "log_time": {}, "lat": {}, "lon": 7}}', 'rov/{} {{"t": {}, "lat": {}, "lon": 7}}']
)
def test_objects_of_several_topics_are_not_mixed(tmp_path: Path, line: str) -> None:
    """As ``mcap cat --json`` and ``mosquitto_sub -v`` print them."""
    lats, seconds = {"usbl": 45, "gps": 46}, range(T0 // SECOND, T0 // SECOND + COUNT)
    texts = [line.format(name, t, lat) for t in seconds for name, lat in lats.items()]
    log = open_reader(saved_lines(tmp_path / "dive.log", texts))

    read = read_whole(log, {"/rov/usbl": ["lat"], "/rov/gps": ["lat"]})

    assert {name: {*of.columns["lat"]} for name, of in read.items()} == {f"/rov/{name}": {lats[name]} for name in lats}
    assert read["/rov/gps"].received_ns.tolist() == [t * SECOND for t in seconds]


@pytest.mark.parametrize("form", ["objects", "arrays", "sensors"])
def test_each_record_that_an_object_collects_is_one(tmp_path: Path, form: str) -> None:
    times = [[T0 // SECOND + k + j / 4 for j in range(4)] for k in range(COUNT)]
    objects = [[{"t": t, "heading_deg": k + 0.5} for t in four] for k, four in enumerate(times)]
    line = {
        "objects": lambda k: {"topic": "compass", "sent": 7, "samples": objects[k]},
        "arrays": lambda k: {"topic": "compass", "t": times[k], "heading_deg": [k + 0.5] * 4, "offsets": [1, 2]},
        "sensors": lambda k: {
            "ts": times[k][3],
            "compass": objects[k],
            "gps": [{"t": times[k][0], "lat": 45, "lon": 7}],
        },
    }[form]
    log = open_reader(saved_lines(tmp_path / "dive.jsonl", (json.dumps(line(k)) for k in range(COUNT))))
    read = read_whole(log, {"/compass": ["heading_deg"]})["/compass"]

    assert read.received_ns.tolist() == [T0 + k * SECOND // 4 for k in range(4 * COUNT)]
    assert read.columns["heading_deg"].tolist() == [k + 0.5 for k in range(COUNT) for _ in range(4)]
    assert {one.name for one in log.topics()} == {"/compass", "/gps"} - ({"/gps"} if form != "sensors" else set())
