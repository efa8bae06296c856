"""The doctor on dives whose faults are known, because the test put them there."""

import json
import re
import tomllib
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from commands import drafted, findings, finished, output_of, replayed, report_of, run
from curved import CONVENTIONS, FLIPPED, changed, cured_by, curved_dive, in_radians, stating, written
from logs import logged_csv
from recordings import SECOND, T0, Row, point, write_csv
from usbldr.filters.identification.evidence import Explained, explained
from usbldr.filters.identification.identification import Identification, SensorErrorEvidence
from usbldr.filters.models.parameters import Parameters
from usbldr.filters.types import Timeline
from usbldr.io.doctor.cross_check import convention_warnings, cross_check
from usbldr.io.doctor.gross_errors import unit_or_scale_key
from usbldr.io.reader import Records
from usbldr.io.reading.epochs import timeline
from usbldr.io.reading.read import Request, read_log
from usbldr.io.recordings.mcap_log import McapLog

MIRRORED: Mapping[str, Any] = {"dvl": "FRD", "imu": "NED", "usbl": "NED"}
SENSOR_ERRORS = {"USBL-LATENCY", "DVL-LEVER", "DVL-CLOCK", "DVL-SCALE", "LEVER-OR-LATENCY", "RIVAL-EXPLANATIONS"}


@pytest.mark.parametrize(
    ("dive", "named"),
    [
        ({"imu": "NED", "gps": True}, {"HEADING-CONVENTION": 'state convention = "NED" under [compass]'}),
        ({"imu": "NED", "gps": True, "gravity": -9.8}, {"HEADING-CONVENTION": 'convention = "NED"'}),
        ({"dvl": "FRD", "gps": True}, {"DVL-AXES": 'state axes = "FRD" under [dvl]'}),
        (MIRRORED, {"CONVENTION-UNDECIDED": "nothing in the log decides"}),
        (MIRRORED | {"gps": True}, dict.fromkeys(FLIPPED, "excluded by: GPS")),
        ({"gps": True, "gravity": -9.8}, {"CONVENTION-CONTRADICTED": "gravity"}),
        ({"gps": True, "straight": True}, {"CONVENTION-UNOBSERVABLE": "does not distinguish"}),
    ],
)
def test_a_convention_is_named_if_the_log_decides_it_and_no_other(tmp_path, dive, named):
    found = findings(written(tmp_path, **dive))

    assert set(found) & CONVENTIONS == set(named)
    for code, words in named.items():
        assert words in found[code]["text"]
        assert (found[code]["level"] == "error") == (code in FLIPPED)


def test_a_scale_that_changes_within_the_log_is_named_with_its_time_and_its_metres(tmp_path: Path) -> None:
    rows = curved_dive(gps=True)
    first = next(k for k, row in enumerate(rows) if row[0] >= T0 + 150 * SECOND)

    found = findings(written(tmp_path, [*rows[:first], *faster(rows[first:], 1.3)]))["SENSOR-CHANGE"]

    assert found["time_s"] == pytest.approx(150.0, abs=12.0)
    scale = re.search(r"speeds ([+-][\d.]+)% compared with before", found["text"])
    assert float(scale[1]) == pytest.approx(30.0, abs=2.0)
    t = np.arange(10.0, 290.0, 0.1)  # of the fixes
    heading, forward, starboard = 0.02 * t + 0.9 * np.sin(t / 31), 1 + 0.3 * np.sin(t / 17), 0.4 * np.sin(t / 41) + 0.2
    velocity = (forward - 1j * starboard) * np.exp(-1j * heading) * 0.3 * (t >= 150.0)
    assert found["worst"] == pytest.approx(np.std(np.cumsum(velocity) * 0.1), rel=0.1)


def test_a_dive_by_the_defaults_and_a_scenario_are_healthy(tmp_path: Path) -> None:
    said = output_of("doctor", written(tmp_path, gps=True))

    assert re.search(r"CONVENTION-CHECKED: .* m RMS with axes FLU, convention ENU, frame ENU", said)
    assert "HEADING-CHECKED" in said
    assert "0 errors" in said
    assert "0 errors" in output_of("doctor", "paper")  # without a file


def test_replay_warns_of_a_better_reading_and_changes_nothing(tmp_path: Path) -> None:
    done = run("replay", written(tmp_path, imu="NED", gps=True), "--filter", "dr", "--output", tmp_path / "run")

    assert done.return_value == 0
    assert "but NED fits better; dead-reckoning-to-fix residual: " in done.stderr
    assert done.stderr.count("[HEADING-CONVENTION]") == 1
    report = report_of(tmp_path / "run")
    assert "HEADING-CONVENTION" in [finding["code"] for finding in report["findings"]]
    texts = [convention["text"] for convention in report["sensors"]["compass"]["conventions"]]
    assert "convention ENU (by type)" in texts


def test_replay_warns_of_no_turn_for_which_there_is_no_evidence(tmp_path: Path) -> None:
    log = read_log(written(tmp_path, curved_dive(mount_deg=7.0)), Request("none"))
    line, unfounded = timeline(log), SensorErrorEvidence("heading", -5.0, exists=False, estimates=())

    for found, warned in ((None, True), (Identification(Parameters(), (unfounded,)), False)):
        assert ("DVL-MOUNT" in [one.code for one in convention_warnings(log, line, found)]) == warned


def test_replay_and_doctor_exclude_the_mirror_image_by_the_same_evidence(tmp_path: Path) -> None:
    log = written(tmp_path, **MIRRORED, gravity=-9.8)

    found = findings(log)

    assert set(found) & CONVENTIONS == FLIPPED
    assert "excluded by: gravity" in found["MAP-FRAME"]["text"]
    assert found["MAP-FRAME"]["text"] in run("replay", log, "-f", "dr", "-o", tmp_path / "run").stderr


@pytest.mark.parametrize("stated", ["", 'frame = "NED"\n'])
def test_a_gps_whose_own_frame_is_only_the_default_decides_no_mirror_image(tmp_path: Path, stated: str) -> None:
    """A program writes fixes and GPS alike as x and y, which are north and east."""
    rows = curved_dive(**MIRRORED)
    rows += [point(ns, v["point.x"], v["point.y"], topic="/gps") for ns, at, _, v in rows if at == "/usbl"]
    log = written(tmp_path, sorted(rows, key=lambda row: row[0]))
    toml = f'[gps]\ntopic = "/gps"\ncolumns = {{ x = "point.x", y = "point.y" }}\n{stated}'

    found = findings(log, "--config", stating(log, toml))

    assert set(found) & CONVENTIONS == (FLIPPED if stated else {"CONVENTION-UNDECIDED"})


@pytest.mark.parametrize("conventions", [{"imu": "NED"}, {"dvl": "FRD"}])
def test_the_mount_is_found_whatever_else_is_wrong(tmp_path: Path, conventions: Mapping[str, Any]) -> None:
    found = findings(written(tmp_path, mount_deg=-50.0, gps=True, **conventions))

    assert found["DVL-MOUNT"]["worst"] == pytest.approx(-50.0, abs=1.0)
    assert "mount_deg = -" in found["DVL-MOUNT"]["text"]
    assert "if the USBL head is turned instead, state its place" in found["DVL-MOUNT"]["text"]


def test_what_the_doctor_names_cures_the_log(tmp_path: Path) -> None:
    log = written(tmp_path, mount_deg=30.0, **MIRRORED, gps=True, late_s=1.5)
    sections = ('[dvl]\naxes = "FRD"\nmount_deg = 30.0', '[compass]\nconvention = "NED"', '[usbl]\nframe = "NED"')

    ill, cured = findings(log), cured_by(log, "\n".join([*sections, "latency_s = 1.5\n"]))

    assert {*FLIPPED, "DVL-MOUNT", "USBL-LATENCY"} <= set(ill)
    assert ill["USBL-LATENCY"]["worst"] == pytest.approx(1.5, abs=0.1)
    assert all(one["level"] != "error" for one in cured.values())
    assert {"DVL-MOUNT", "HEADING-BIAS", "USBL-LATENCY"}.isdisjoint(cured)


@pytest.mark.parametrize(
    ("dive", "code", "worst", "times_s", "words"),
    [
        ({"gross": (100, 101, 200)}, "USBL-OUTLIERS", pytest.approx(12.0, abs=1.5), (110, 111, 210), "3 of 280 fixes"),
        ({"gps": True, "gross": tuple(range(100, 140))}, "FALSE-FIXES", 40, (110,), "as the whole log shows"),
    ],
)
def test_gross_fixes_are_counted_and_placed_also_in_a_row(tmp_path, dive, code, worst, times_s, words):
    found = findings(written(tmp_path, **dive))[code]

    assert (found["level"], found["worst"], found["topic"]) == ("warning", worst, "/usbl")
    assert min(abs(found["time_s"] - time_s) for time_s in times_s) <= 0.5 * (code == "FALSE-FIXES")
    assert words in found["text"]


def test_late_fixes_doubled_records_and_lost_lock_are_found(tmp_path: Path) -> None:
    rows = [row for row in curved_dive() for _ in range(2 if row[1] == "/dvl" else 1)]
    blind = changed(rows[800:900], "/dvl", **{f"twist__linear__{axis}": 327.67 for axis in "xyz"})

    found = findings(written(tmp_path, [*rows[:800], *blind, *rows[900:]]))

    assert found["USBL-DELAYED"]["worst"] == pytest.approx(0.8, abs=0.01)
    assert "records repeat another's stamp and values" in found["REPEATED"]["text"]
    assert "have the no-bottom-lock value 327.67 m/s" in found["DVL-INVALID"]["text"]
    assert found["DVL-INVALID"]["worst"] == pytest.approx(327.67)
    blind_s = [(row[0] - T0) / SECOND for row in blind if row[1] == "/dvl"]
    assert found["LOST-LOCK"]["time_s"] == pytest.approx(blind_s[0] - 0.5)
    assert found["LOST-LOCK"]["worst"] == pytest.approx(blind_s[-1] - blind_s[0] + 1.0)


def csv(columns: str, *lines: object) -> str:
    """Return a CSV file of a record a second."""
    return "\n".join([f"time_ns,{columns}", *(f"{T0 + k * SECOND},{line}" for k, line in enumerate(lines))])


@pytest.mark.parametrize(("unit", "times"), [("m/s", 1.0), ("mm/s", 1000.0)])
def test_the_worst_of_the_invalid_records_is_none_of_the_valid_ones(tmp_path: Path, unit: str, times: float) -> None:
    """The vehicle makes 1.3 m/s where the DVL sees the bottom; of what it says without, 0.25 m/s is the most."""
    blind = [f"{times * 0.05 * k},0,0" for k in range(6)]
    folder = write_csv(
        tmp_path / "dive",
        velocity=csv("x,y,valid", *[f"{times * 1.3},0,1"] * 60, *blind),
        compass=csv("heading_deg", *[0] * 66),
        usbl=csv("east_m,north_m", *(f"0,{1.3 * k}" for k in range(66))),
    )
    columns = '{ time_ns = "time_ns", x = "x", y = "y", valid = "valid" }'
    (folder / "usbldr.toml").write_text(f'[dvl]\ncolumns = {columns}\naxes = "FSD"\nunit = "{unit}"\n')

    found = findings(folder)["DVL-INVALID"]

    assert (found["worst"], found["unit"]) == (pytest.approx(0.25), "m/s")


def test_gps_under_water_is_found(tmp_path: Path) -> None:
    folder = write_csv(
        tmp_path / "dive",
        dvl=csv("starboard_mps,forward_mps", *["0,1"] * 60),
        compass=csv("heading_deg", *[0] * 60),
        usbl=csv("east_m,north_m", *(f"0,{k}" for k in range(60))),
        gps=csv("lat_deg,lon_deg", *["45,7"] * 60),
        depth=csv("depth_m", *(0.1 if k < 20 else k / 10 for k in range(60))),
    )

    found = findings(folder)["GPS-UNDERWATER"]

    assert "40 of 60 fixes were made under water" in found["text"]
    assert (found["worst"], found["time_s"]) == (pytest.approx(5.9), 59.0)
    assert found["text"] in {finding.text for finding in read_log(folder).findings}
    assert "GPS-UNDERWATER" not in {finding.code for finding in read_log(folder, Request(truth="none")).findings}


def test_two_topics_for_a_role_are_an_error_and_the_one_with_more_messages_is_examined(tmp_path: Path) -> None:
    others = [point(T0 + k * SECOND, 0, 0, topic="/usbl/raw") for k in range(5)]

    done = run("doctor", written(tmp_path, sorted([*curved_dive(), *others], key=lambda row: row[0])))

    assert done.return_value == 1
    assert "ROLE-UNDECIDED: 2 topics could be the usbl" in done.output
    assert "doctor uses /usbl" in done.output
    assert "HEADING-CHECKED" in done.output


def test_a_heading_logged_later_than_the_dvl_is_found(tmp_path: Path) -> None:
    rows = [(row[0] + (SECOND // 2 if row[1] == "/imu" else 0), *row[1:]) for row in curved_dive()]

    found = findings(written(tmp_path, sorted(rows, key=lambda row: row[0])))["CLOCK-OFFSET"]

    assert found["topic"] == "/imu"
    assert found["worst"] == pytest.approx(0.5)


def test_headings_in_radians_are_told_from_degrees_by_the_fixes(tmp_path: Path) -> None:
    log = written(tmp_path, in_radians(curved_dive()))

    assert 'state unit = "rad" under [compass]' in cured_by(log, '[compass]\nunit = "deg"\n')["HEADING-RADIANS"]["text"]
    assert "HEADING-RADIANS" not in cured_by(log, '[compass]\nunit = "rad"\n')


def test_headings_in_radians_are_found_on_circles_too(tmp_path: Path) -> None:
    """Six degrees instead of a turn: by them the fixes move unlike dead reckoning."""
    time_s = np.arange(0.0, 600.0, 0.5)
    heading_rad = np.mod(0.8 + time_s / 40, 2 * np.pi)
    track_m = np.cumsum(0.5 * np.exp(1j * (np.pi / 2 - heading_rad)))
    fix_m = track_m + np.random.default_rng(0).normal(0.0, 0.5, (2, len(time_s))).T @ [1, 1j]
    rows = {
        "dvl": ("time_s,starboard_mps,forward_mps", [f"{t},0.0,1.0" for t in time_s]),
        "compass": ("time_s,hdg", [f"{t},{angle}" for t, angle in zip(time_s, heading_rad, strict=True)]),
        "usbl": ("time_s,east_m,north_m", [f"{t},{p.real},{p.imag}" for t, p in zip(time_s, fix_m, strict=True)][::4]),
    }
    sheets = {name: "\n".join([head, *cells]) for name, (head, cells) in rows.items()}
    log = logged_csv(tmp_path, '[compass]\ncolumns = { time_s = "time_s", heading = "hdg" }\n', **sheets)

    found = {one.code: one.text for one in cross_check(log, timeline(log)).findings}

    assert 'state unit = "rad" under [compass]' in found["HEADING-RADIANS"]


def csv_dive(folder: Path, rows: list[Row]) -> Path:
    """Write a dive's velocities, headings and fixes as CSV files of our own columns, as they are numbered."""
    dvl, compass, usbl = "time_ns,starboard_mps,forward_mps", "time_ns,heading_deg", "time_ns,east_m,north_m"
    lines = {"/dvl": [dvl], "/heading": [compass], "/usbl": [usbl]}
    for ns, topic, _, values in rows:
        numbers = [value for name, value in values.items() if name.endswith((".x", ".y", "data"))]
        reported = [-numbers[1], numbers[0]] if topic == "/dvl" else numbers
        lines[topic].append(",".join(map(str, (values.get("header.stamp", ns), *reported))))
    dvl, compass, usbl = ("\n".join(reported) for reported in lines.values())
    return write_csv(folder, dvl=dvl, compass=compass, usbl=usbl)


@pytest.mark.long
def test_a_csv_folder_of_radians_is_told_what_mends_it(tmp_path: Path) -> None:
    """Of a column heading_deg the unit is settled, so that the column has to be named, too."""
    folder = csv_dive(tmp_path / "dive", in_radians(curved_dive()))

    advice = str(findings(folder)["HEADING-RADIANS"]["text"]).partition("; state ")[2].removesuffix(" under [compass]")
    mended = cured_by(folder, "[compass]\n" + advice.replace(" and unit", "\nunit"))

    assert {"HEADING-RADIANS", "KEY-UNUSED", "UNUSABLE"}.isdisjoint(mended)
    assert abs(mended["HEADING-CHECKED"]["worst"]) < 1


@pytest.mark.parametrize(("per_turn", "unit"), [(6400, "mil"), (36000, "0.01deg")])
@pytest.mark.long
def test_headings_beyond_a_turn_are_in_the_unit_that_fits_the_fixes(tmp_path: Path, per_turn: int, unit: str) -> None:
    folder = csv_dive(tmp_path / "dive", in_radians(curved_dive(), 180 / np.pi))
    table = pd.read_csv(folder / "compass.csv")[200:]
    turns = table["heading_deg"] % 360 / 360
    table.assign(heading=per_turn * turns).drop(columns="heading_deg").to_csv(folder / "compass.csv", index=False)

    draft = drafted(folder)

    assert tomllib.loads(draft)["compass"]["unit"] == unit
    assert abs(tomllib.loads(draft)["dvl"]["mount_deg"]) < 1


def faster(rows: list[Row], times: float) -> list[Row]:
    """Return the dive with the velocities of its DVL in another unit."""
    x, y, z = (f"twist.linear.{axis}" for axis in "xyz")
    scaled = {path.replace(".", "__"): lambda values, path=path: times * values[path] for path in (x, y, z)}
    return changed(rows, "/dvl", **scaled)


@pytest.mark.parametrize(
    ("times", "advice", "proposed"),
    [
        (1.944, 'state unit = "knots" under [dvl]', 'unit = "knots"'),
        (2.5, "state scale_error = 1.5", "scale_error = 1.5"),
        (0.01, "no unit explains it: check what its driver writes", "CHECK: velocities are 0.01 times those between"),
    ],
)
@pytest.mark.long
def test_velocities_of_another_unit_are_told_by_the_fixes_hide_nothing_else_and_are_taken_off_by_init(
    tmp_path: Path, times: float, advice: str, proposed: str
) -> None:
    log = written(tmp_path, faster(curved_dive(gps=True, late_s=1.0, mount_deg=20.0), times))

    found, draft = findings(log), drafted(log)

    assert found["DVL-UNIT"]["level"] == "error"
    assert found["DVL-UNIT"]["worst"] == pytest.approx(times, rel=0.01)
    assert advice in found["DVL-UNIT"]["text"]
    assert {"DVL-UNIT", "DVL-MOUNT", "USBL-LATENCY"} <= set(found)
    assert (FLIPPED | {"DVL-SCALE", "CLOCK-OFFSET"}).isdisjoint(found)
    assert found["DVL-MOUNT"]["worst"] == pytest.approx(20.0, abs=0.5)
    assert "[DVL-UNIT]" in replayed(log)
    assert proposed in draft
    assert ("[DVL-UNIT]" in replayed(log, "--config", stating(log, draft))) == ("CHECK" in proposed)


def test_the_unit_that_a_dvl_was_read_by_wrongly_is_named(tmp_path: Path) -> None:
    log = written(tmp_path, toml='[dvl]\nunit = "mm/s"\n')

    assert findings(log)["DVL-UNIT"]["text"].endswith('state unit = "m/s" under [dvl]')
    for times, unit in [(3.281, "ft/s"), (3.41, "ft/s"), (3.425, "ft/s"), (3.47, "km/h"), (3.6, "km/h")]:
        assert unit_or_scale_key(read_log(log, Request("none")), times) == ("unit", f'"{unit}"')


@pytest.mark.long
def test_a_csv_folder_of_knots_is_told_the_scale(tmp_path: Path) -> None:
    """Of a column forward_mps the unit is settled: stating another would change nothing."""
    folder = csv_dive(tmp_path / "dive", faster(in_radians(curved_dive(), 180 / np.pi), 1.944))

    draft = drafted(folder)

    stated = tomllib.loads(draft)["dvl"]["scale_error"]
    assert f"state scale_error = {stated} under [dvl]" in findings(folder)["DVL-UNIT"]["text"]
    assert stated == pytest.approx(0.944, abs=0.02)
    assert {"DVL-UNIT", "KEY-UNUSED", "UNUSABLE"}.isdisjoint(cured_by(folder, draft))


@pytest.mark.parametrize("order", [(3, 0, 1, 2), (0, 1, 2, 3)])
@pytest.mark.long
def test_fixes_tell_which_part_of_a_numbered_quaternion_is_its_scalar(tmp_path: Path, order: tuple[int, ...]) -> None:
    """Half a heading's sine and cosine turn north to the bow, about the axis that points down.

    The vehicle hardly drifts sideways, so that a mirrored DVL fits slightly better, but for the names of its columns.
    """
    t, rng = np.arange(0, 300, 0.5), np.random.default_rng(3)
    heading = 0.02 * t + 0.9 * np.sin(t / 31)
    s, c, drift = np.sin(heading), np.cos(heading), 0.008 * np.sin(t / 41)
    east_north = np.cumsum(0.5 * np.column_stack([s + drift * c, c - drift * s]), axis=0)
    fixes = (east_north + rng.normal(0, 0.3, east_north.shape))[20:-20:2]
    parts = np.column_stack([0 * t, 0 * t, np.sin(heading / 2), np.cos(heading / 2)])[:, list(order)]
    tables = {
        "dvl": (t, {"starboard_mps": -drift, "forward_mps": 1 + 0 * t}),
        "compass": (t, {f"q{number}": parts[:, number] for number in range(4)}),
        "usbl": (t[20:-20:2], {"east_m": fixes[:, 0], "north_m": fixes[:, 1]}),
    }
    for name, (times_s, values) in tables.items():
        times_ns = T0 + (times_s * SECOND).astype(np.int64)
        pd.DataFrame({"time_ns": times_ns, **values}).to_csv(tmp_path / f"{name}.csv", index=False)

    sections = tomllib.loads(drafted(tmp_path))

    named = [sections["compass"]["columns"][key] for key in ("qx", "qy", "qz", "qw")]
    assert named == [f"q{order.index(part)}" for part in range(4)]
    assert sections["compass"]["convention"] == "NED"
    assert sections["dvl"]["axes"] == "SFU"  # as its columns say


def test_fixes_that_stay_where_they_are_tell_no_unit(tmp_path: Path) -> None:
    """They move by their noise alone, which no velocity explains, however small."""
    rng = np.random.default_rng(2)
    rows = [point(row[0], *rng.normal(0, 0.3, 2)) if row[1] == "/usbl" else row for row in curved_dive()]

    assert "DVL-UNIT" not in replayed(written(tmp_path, rows))


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    ("topic", "values"),
    [
        ("/dvl", {"twist__linear__x": 1e-12, "twist__linear__y": 0.0}),
        ("/dvl", {"twist__linear__x": np.nan}),
        ("/imu", {"orientation__z": 0.0, "orientation__w": 1.0}),
        ("/imu", {"linear_acceleration__z": np.nan}),
        ("/usbl", {"point__x": 3.0, "point__y": 4.0}),
        ("/usbl", {"point__x": 1e12}),
    ],
)
def test_senseless_sensors_end_in_findings_alone(tmp_path: Path, topic: str, values: Mapping[str, float]) -> None:
    found = findings(written(tmp_path, changed(curved_dive(gps=True), topic, **values)))

    assert FLIPPED.isdisjoint(found)
    assert found


@pytest.mark.parametrize(("first", "second", "sign"), [("x", "y", -1.0), ("y", "x", 1.0)])
def test_replay_warns_of_reversed_or_exchanged_axes(tmp_path: Path, first: str, second: str, sign: float) -> None:
    wrong = {
        f"twist__linear__{axis}": lambda values, other=other: sign * values[f"twist.linear.{other}"]
        for axis, other in (("x", first), ("y", second))
    }
    log = written(tmp_path, changed(curved_dive(gps=True), "/dvl", **wrong))
    key, value, code = ("mount_deg", "180.0", "DVL-MOUNT") if first == "x" else ("axes", '"LFU"', "DVL-AXES")

    said, cured = replayed(log), replayed(log, "--config", stating(log, f"[dvl]\n{key} = {value}\n"))

    assert re.findall(r"\[(DVL-\w+)\]", said) == [code]
    assert f"state {key} = {value.removeprefix('-')} under [dvl]" in said.replace("-180.0", "180.0")
    assert "[DVL-" not in cured


@pytest.mark.parametrize("frame", ["ENU", "NED"])
def test_velocities_in_earth_axes_are_named(tmp_path: Path, frame: str) -> None:
    rows = curved_dive(gps=True)
    stamps, angles = np.array([(row[0], yaw_rad(row)) for row in rows if row[1] == "/imu"]).T
    for k, row in enumerate(rows):
        if row[1] == "/dvl":
            body = complex(row[3]["twist.linear.x"], row[3]["twist.linear.y"])
            earth = body * np.exp(1j * np.interp(row[0], stamps, np.unwrap(angles)))
            pair = (earth.real, earth.imag) if frame == "ENU" else (earth.imag, earth.real)
            rows[k] = (*row[:3], dict(row[3]) | dict(zip(("twist.linear.x", "twist.linear.y"), pair, strict=True)))
    log = written(tmp_path, rows)

    found, init = findings(log), finished("init", log, "-o", tmp_path / "a.toml")

    assert "its velocities are along east and north" in found["DVL-EARTH"]["text"]
    assert init.returncode == 3
    assert "record them in instrument axes" in init.stderr


def yaw_rad(row: Row) -> float:
    return 2 * np.arctan2(row[3]["orientation.z"], row[3]["orientation.w"])


@pytest.mark.long
def test_a_transponder_ahead_is_a_lever_arm_and_no_latency_until_it_is_stated(tmp_path: Path) -> None:
    rows = curved_dive(gps=True)
    stamps, angles = np.array([(row[0], yaw_rad(row)) for row in rows if row[1] == "/imu"]).T
    ahead: list[Row] = []
    for row in rows:
        if row[1] == "/usbl":
            angle = np.interp(row[3]["header.stamp"], stamps, np.unwrap(angles))  # counter-clockwise from east: forward
            moved = {"point.x": row[3]["point.x"] + 3 * np.cos(angle), "point.y": row[3]["point.y"] + 3 * np.sin(angle)}
            row = (*row[:3], dict(row[3]) | moved)
        ahead.append(row)
    log = written(tmp_path, ahead)

    ill, cured = findings(log), cured_by(log, "[usbl]\nlever_arm_m = [0.0, 3.0, 0.0]\n")

    assert ill["DVL-LEVER"]["worst"] == pytest.approx(3.0, abs=0.3)
    proposed = re.search(r"^# lever_arm_m = (\[.*\])", drafted(log), re.MULTILINE)
    assert proposed
    assert json.loads(proposed[1]) == pytest.approx([0.0, -3.0, 0.0], abs=0.3)  # DVL minus transponder
    assert set(ill) & SENSOR_ERRORS == {"DVL-LEVER"}
    assert not set(cured) & SENSOR_ERRORS


def test_all_is_parsed_decoded_and_identified_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Axes that the residuals settle are not asked of the sensor errors."""
    log = written(tmp_path, dvl="FRD", toml="[dvl]\nmount_deg = 30.0\n")
    parse, decode, calls = tomllib.loads, McapLog.blocks, Counter[str]()

    def counted_parse(text: str) -> dict[str, Any]:
        calls["parse"] += "mount_deg" in text
        return parse(text)

    def counted_decode(self: McapLog, wanted: Mapping[str, Sequence[str]]) -> Iterator[tuple[str, Records]]:
        calls["decode"] += 1
        return decode(self, wanted)

    def counted_identify(timeline: Timeline, given: Parameters) -> Explained:
        calls["identify"] += 1
        return explained(timeline, given)

    monkeypatch.setattr(tomllib, "loads", counted_parse)
    monkeypatch.setattr(McapLog, "blocks", counted_decode)
    monkeypatch.setattr("usbldr.io.doctor.sensor_errors.explained", counted_identify)

    assert "DVL-AXES" in findings(log)

    assert calls == {"parse": 1, "decode": 1, "identify": 1}
