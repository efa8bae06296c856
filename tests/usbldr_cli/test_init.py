"""usbldr init: what it writes is what the log was made by, and replay accepts it unchanged."""

import datetime
import json
import re
import tomllib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from commands import drafted, findings, output_of, report_of, run, spoil, write_short
from curved import curved_dive, in_radians, written
from logs import MAP, read_as, refusal
from recordings import SECOND, T0, Row, define, point, saved, saved_lines, short_dive, write_csv, write_mcap
from table_recordings import WRITERS
from usbldr.filters.errors import LogError, UsageError
from usbldr.io.doctor.doctor import examine
from usbldr.io.doctor.init_sensors import compass_lines
from usbldr.io.findings import Finding
from usbldr.io.messages.field_names import ALONG_EARTH
from usbldr.io.reading.read import Request, read_log
from usbldr.io.settings.toml_text import inline

MIRRORED: dict[str, Any] = {"dvl": "FRD", "imu": "NED", "usbl": "NED", "gravity": -9.8}


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A dive against all defaults, with a DVL at -50 degrees, and GPS."""
    return write_mcap(tmp_path_factory.mktemp("init") / "dive.mcap", curved_dive(**MIRRORED, mount_deg=-50.0, gps=True))


def initialised(log: Path, target: Path, *options: object) -> tuple[str, dict[str, Any]]:
    """Return the text that init writes, and what it states; replay accepts it unchanged."""
    output_of("init", log, "--output", target, "--force", *options)
    accepted(log, target)
    text = target.read_text(encoding="utf-8")
    return text, tomllib.loads(text)


def accepted(log: Path, target: Path) -> None:
    output_of(
        "replay", log, "--config", target, "-f", "dr", "--plots", "none", "--force", "-o", target.with_name("run")
    )


def asked_in(log: Path, file: Path) -> tuple[str, str]:
    """Return the sentence with which init refuses a log, and the text of the file to complete."""
    done = run("init", log, "--output", file)
    assert isinstance(done.exception, LogError)
    return str(done.exception), file.read_text(encoding="utf-8")


DVL_COLUMNS = {"time_unix_s": "time", "x": "vx", "y": "vy", "z": "vz"}
PROPOSED = "# CHECK: proposed from the names of its fields; confirm quantities, units and axes"


def test_the_file_says_how_the_log_was_made_and_where_each_value_comes_from(log: Path, tmp_path: Path) -> None:
    target = tmp_path / "found.toml"

    done = run("init", log, "--output", target)

    assert done.output.startswith(f"{target}: written; check the 2 lines marked CHECK\n")
    text = target.read_text(encoding="utf-8")
    found = tomllib.loads(text)
    assert found["dvl"].items() >= {"topic": "/dvl", "axes": "FRD"}.items()
    assert found["dvl"]["mount_deg"] == pytest.approx(-50.0, abs=1.0)
    assert (found["compass"]["convention"], found["usbl"]["frame"]) == ("NED", "NED")
    assert found["depth"]["topic"] == "none"
    keys = [line for line in text.splitlines() if " = " in line and not line.startswith(("#", "schema"))]
    assert len(keys) > 15
    assert [line for line in keys if "  # " not in line] == []


@pytest.mark.long
def test_replay_accepts_the_file_and_the_doctor_finds_the_log_cured(log: Path, tmp_path: Path) -> None:
    target = tmp_path / "found.toml"
    run("init", log, "--output", target)

    done = run("replay", log, "--config", target, "--filter", "ekf", "--output", tmp_path / "run")

    assert done.return_value == 0, done.output
    assert "CONVENTION]" not in done.stderr
    cured = findings(log, "--config", str(target))
    assert all(one["level"] != "error" for one in cured.values())
    assert "DVL-MOUNT" not in cured


def test_the_file_stands_where_replay_looks_and_is_not_overwritten(tmp_path: Path) -> None:
    log, place = write_mcap(tmp_path / "dive.mcap", curved_dive(seconds=60)), tmp_path / "dive.usbldr.toml"

    output_of("init", log)
    place.write_text("schema = 1\n# mine\n", encoding="utf-8")
    said = refusal(UsageError, output_of, "init", log)

    assert said == f"{place} exists already: choose another file for --output, or --force"
    assert place.read_text(encoding="utf-8") == "schema = 1\n# mine\n"
    output_of("init", log, "--force")
    assert "# mine" not in place.read_text(encoding="utf-8")


def test_an_unknown_map_is_said_and_the_place_where_fixes_meet_gps_is_proposed_only(tmp_path: Path) -> None:
    """The dive's map begins at 45 north, 7 east, which no message says; the first GPS fix lies 10 s from it."""
    rows = [row for row in curved_dive(gps=True) if row[1] != "/gps/fix" or row[0] % (60 * SECOND) < 3 * SECOND]
    log = write_mcap(tmp_path / "dive.mcap", rows)

    done = run("init", log)

    assert "state origin_lat_deg and origin_lon_deg under [map], or head under [usbl]" in done.output
    text = (tmp_path / "dive.usbldr.toml").read_text(encoding="utf-8")
    assert {"map", "truth"}.isdisjoint(tomllib.loads(text))  # the kind of the truth follows its topic
    place = re.search(r"# origin_lat_deg = (\S+) +# CHECK: proposed from GPS .*\n# origin_lon_deg = (\S+)", text)
    assert place
    assert float(place[1]) == pytest.approx(45.0, abs=1e-5)
    assert float(place[2]) == pytest.approx(7.0, abs=1e-5)


@pytest.mark.long
def test_headings_that_the_fixes_show_to_be_radians_are_written_as_such(tmp_path: Path) -> None:
    log = write_mcap(tmp_path / "dive.mcap", in_radians(curved_dive(gps=True)))

    run("init", log)

    text = (tmp_path / "dive.usbldr.toml").read_text(encoding="utf-8")
    assert re.search(r'^unit = "rad" +# by the fixes, instead of deg$', text, re.MULTILINE)
    assert re.search(r"# Dead-reckoning-to-fix residual: 0\.\d\d m RMS", text)  # in radians, the rest could be checked
    assert tomllib.loads(text)["dvl"]["mount_deg"] == 0.0
    cured = findings(log)
    assert {"HEADING-RADIANS", "DVL-MOUNT"}.isdisjoint(cured)
    assert all(one["level"] != "error" for one in cured.values())


def test_what_nobody_can_tell_is_marked(tmp_path: Path) -> None:
    raw = [point(T0 + k * SECOND, 0.0, 0.0, topic="/usbl/raw") for k in range(5)]
    undecided = write_mcap(tmp_path / "dive.mcap", sorted([*curved_dive(), *raw], key=lambda row: row[0]))

    done = run("init", undecided)

    assert "check the 4 lines marked CHECK" in done.output
    text = (tmp_path / "dive.usbldr.toml").read_text(encoding="utf-8")
    assert "with the most messages; it could be /usbl/raw" in text
    assert len(re.findall(r'^# \w+ = "\w+" +# CHECK: only the default, and the log fits', text, re.MULTILINE)) == 2
    assert "mirror image (axes FRD, convention NED, frame NED) fits as well" in text


def test_axes_of_fixes_that_wander_are_those_with_the_largest_evidence(tmp_path: Path) -> None:
    """By 25 m, on a dive whose DVL is read with the wrong hand: the residuals alone do not tell."""
    rows = []
    for row in curved_dive(dvl="FRD"):
        t, v = (row[0] - T0) / SECOND, row[3]
        east, north = 25 * np.sin(t / 40), 25 * np.cos(t / 57)
        moved = {**v, "point.x": v["point.x"] + east, "point.y": v["point.y"] + north} if "point.x" in v else v
        rows.append((*row[:3], moved))

    _, found = initialised(write_mcap(tmp_path / "dive.mcap", rows), tmp_path / "found.toml")

    assert found["dvl"]["axes"] == "FRD"


def test_sensors_of_no_known_topic_are_asked_for(tmp_path: Path) -> None:
    compass = write_mcap(tmp_path / "dive.mcap", [row for row in curved_dive() if row[1] == "/imu"])
    file = tmp_path / "dive.usbldr.toml"

    said, text = asked_in(compass, file)

    why = "no topic is known to be dvl or usbl"
    assert said == f"{compass}: {why}; {file} is written: complete the lines marked CHECK"
    assert tomllib.loads(text)["compass"]["topic"] == "/imu"
    assert re.search(rf'^# \[usbl\]\n# topic = "\?" +# CHECK: {why}\n# col', text, re.MULTILINE)


def test_a_table_whose_columns_say_nothing_gets_a_file_to_complete(tmp_path: Path) -> None:
    log = write_csv(tmp_path / "made", a="Aika;eteen;oikea;suunta;itä;pohjoinen\n1;2;3;4;5;6")

    said, text = asked_in(log / "a.csv", tmp_path / "made.toml")

    assert "init" not in said
    assert "#   /a: Aika, eteen, oikea, suunta, itä, pohjoinen\n" in text
    assert re.findall(r'^# \[(\w+)\]\n# topic = "/a"', text, re.MULTILINE) == ["dvl", "compass", "usbl"]


def test_the_place_of_a_head_is_asked_for_in_the_section_of_the_fixes(csv: Path, tmp_path: Path) -> None:
    fixes = "".join(f"{T0 // SECOND + k * 30},{100 + k * 25},{90 + k}\n" for k in range(30))
    (csv / "usbl.csv").write_text(f"t,range,bearing\n{fixes}", encoding="utf-8")
    file = tmp_path / "found.toml"

    said, text = asked_in(csv, file)

    assert "/usbl holds ranges and bearings; state head = {...} under [usbl], or beacon" in said
    asked = re.findall(r"^# (head = .*?\}) +# CHECK: /usbl holds ranges", text, re.MULTILINE)
    assert text.count("CHECK: /usbl") == len(asked) == 1
    assert tomllib.loads(text)["usbl"]["columns"]["slant_range_m"] == "range"
    file.write_text(text.replace(f"# {asked[0]}", re.sub(r"\?", "3.0", asked[0])), encoding="utf-8")
    accepted(csv, file)


def test_sensors_that_do_not_overlap_get_a_file_that_says_so(tmp_path: Path) -> None:
    late: list[Row] = []
    for ns, topic, kind, values in curved_dive():
        at_ns = ns + 7200 * SECOND * (topic == "/dvl")
        late.append((at_ns, topic, kind, {**values, "header.stamp": at_ns} if topic == "/dvl" else values))
    log = write_mcap(tmp_path / "dive.mcap", sorted(late, key=lambda row: row[0]))

    _, text = asked_in(log, tmp_path / "found.toml")

    assert "# CHECK: the sensors do not overlap in time" in text
    topics = {role: tomllib.loads(text)[role]["topic"] for role in ("dvl", "compass", "usbl")}
    assert topics == {"dvl": "/dvl", "compass": "/imu", "usbl": "/usbl"}


def test_the_keys_of_a_configuration_are_kept_with_what_was_found(log: Path, tmp_path: Path) -> None:
    stated = saved(
        log.with_name("stated.toml"),
        'schema = 1\n[dvl]\naxes = "FLU"\nlever_arm_m = [0.1, 0.2, 0.0]\n[process]\nposition_m = 0.05\n'
        '[usbl]\nnoise = { kind = "gaussian" }\n[[file]]\npath = "dive.mcap"\nclock_offset_s = 0.0\n',
    )
    asked = ("--config", stated, "--set", "compass.sd_deg=2")

    text, found = initialised(log, log.with_name("found.toml"), *asked)

    assert found["dvl"].items() >= {"axes": "FLU", "lever_arm_m": [0.1, 0.2, 0.0]}.items()
    assert found["compass"].items() >= {"sd_deg": 2, "convention": "NED"}.items()
    assert (found["process"], found["usbl"]["noise"]) == ({"position_m": 0.05}, {"kind": "gaussian"})
    assert found["file"] == [{"path": "dive.mcap", "clock_offset_s": 0.0}]
    assert re.search(r'^axes = "FLU" +# stated in stated.toml; found: axes = "FRD"', text, re.MULTILINE)


def test_paths_of_a_kept_configuration_count_from_the_new_one(log: Path, tmp_path: Path) -> None:
    layout = 'schema = 1\nabout = "a"\n[[layout]]\nsensor = "dvl"\ntype = "a/B"\ncolumns = { x = "x", y = "y" }\n'
    truth = f"time_ns,east_m,north_m\n{T0 + SECOND},1,1\n{T0 + 9 * SECOND},2,2"
    there = write_csv(tmp_path / "there", true=truth)
    here = write_csv(tmp_path / "here", depth=f"time_ns,depth_m\n{T0},1")
    saved(there / "acme.toml", layout)
    stated = saved(there / "stated.toml", 'schema = 1\nlayouts = ["acme.toml"]\n[truth]\nfile = "true.csv"\n')

    _, found = initialised(log, here / "found.toml", "--config", stated, "--with", here / "depth.csv")

    assert (found["layouts"], found["truth"]["file"]) == (["../there/acme.toml"], "../there/true.csv")
    assert [Path(one["path"]).name for one in found["file"]] == ["depth.csv"]


LOCK, GYRO, ACOUSTIC = "new_msgs/msg/BottomLock", "new_msgs/msg/NorthSeeker", "new_msgs/msg/Acoustic"
define(
    {
        ACOUSTIC: "std_msgs/Header header\nfloat64 east_m\nfloat64 north_m\nfloat64 depth_m\n",
        LOCK: "float64 stamp_s\nfloat32[3] velocity_mm_s\nfloat32[3] water_velocity\nbool bottom_lock\n",
        GYRO: "std_msgs/Header header\nfloat64 heading_rate\nfloat64 heading_rad\n",
    }
)


def of_unknown_types(rows: list[Row]) -> list[Row]:
    """Return the dive with unknown types in place of the twist and of the heading."""
    made: list[Row] = []
    for ns, topic, kind, values in rows:
        if topic == "/dvl":
            along = np.array([values[f"twist.linear.{axis}"] * 1000 for axis in "xyz"], dtype=np.float32)
            made.append((ns, "/acme/lock", LOCK, {"velocity_mm_s": along, "stamp_s": ns / 1e9, "bottom_lock": True}))
        elif topic == "/heading":
            made.append((ns, "/acme/seeker", GYRO, {"header.stamp": ns, "heading_rad": values["data"]}))
        else:
            made.append((ns, topic, kind, values))
    return made


def test_columns_of_unknown_types_are_proposed_and_the_rest_fits_the_data(tmp_path: Path) -> None:
    log = write_mcap(tmp_path / "dive.mcap", of_unknown_types(in_radians(curved_dive(dvl="FRD"))))
    text, found = initialised(log, tmp_path / "found.toml")

    assert found["dvl"]["topic"] == "/acme/lock"
    assert found["dvl"]["columns"] == {
        "time_unix_s": "stamp_s",
        **{axis: f"velocity_mm_s[{number}]" for number, axis in enumerate("xyz")},
        "valid": "bottom_lock",
    }
    assert found["compass"]["columns"] == {"heading": "heading_rad"}
    assert found["dvl"]["axes"] == "FRD"
    assert text.count(PROPOSED) == 2


def test_the_words_of_ships_and_flags_of_receivers_are_proposed_and_used(tmp_path: Path) -> None:
    """An autopilot's export: a position counts only with a fix."""
    rows = [f"{(T0 + k * SECOND) // 1000},45.0,{7 + k * 1e-5:.5f},{3 * (k > 9)}" for k in range(40)]
    speeds = [f"{(T0 + k * SECOND) // 1000},0.8,0.1" for k in range(40)]
    log = write_csv(
        tmp_path / "dive",
        log_sensor_gps_0="\n".join(["timestamp,lat,lon,fix_type", *rows]),
        log_dvl_0="\n".join(["timestamp,vel_forward,vel_right", *speeds]),
    )

    found = tomllib.loads(drafted(log))

    assert "columns" not in found["gps"]  # read by their names: only degrees have such values
    assert found["dvl"]["columns"] == {"time_unix_us": "timestamp", "x": "vel_forward", "y": "vel_right"}
    assert found["dvl"]["axes"][:2] == "FS"
    read = read_log(log, Request(str(log / "drafted.toml"), topics={"compass": "none"}))
    assert (len(read.tables["gps"]), read.provenance["gps"].messages) == (30, 40)


def test_the_depth_of_a_transponder_is_no_depth_sensor(tmp_path: Path) -> None:
    rows = curved_dive(dvl="FRD")
    acoustic: list[Row] = [
        (ns, "/sensors/usbl", ACOUSTIC, {"header.stamp": ns, "east_m": x, "north_m": y, "depth_m": 20.0})
        for ns, x, y in records(rows)[2]
    ]
    log = write_mcap(tmp_path / "dive.mcap", sorted([*(r for r in rows if "point.x" not in r[3]), *acoustic]))

    _, found = initialised(log, tmp_path / "found.toml")

    assert found["usbl"]["columns"] == {"x": "east_m", "y": "north_m"}
    assert found["depth"]["topic"] == "none"


def records(rows: list[Row]) -> tuple[list[list[Any]], ...]:
    """Return time [ns] and values of DVL, heading and fixes."""
    dvl = [[ns, v["twist.linear.x"], v["twist.linear.y"]] for ns, at, _, v in rows if at == "/dvl"]
    heading = [[ns, v["data"]] for ns, at, _, v in rows if at == "/heading"]
    return dvl, heading, [[ns, v["point.x"], v["point.y"]] for ns, _, _, v in rows if "point.x" in v]


UNITLESS = records(in_radians(curved_dive(dvl="FRD"), float(np.degrees(1.0))))


@pytest.fixture
def csv(tmp_path: Path) -> Path:
    """Write the dive as files whose columns state no units: DVL in Unix seconds, heading in Unix milliseconds."""
    dvl, heading, fixes = UNITLESS
    return write_csv(
        tmp_path / "dive",
        dvl="\n".join(["time,vx,vy,vz", *(f"{ns / 1e9:.3f},{x},{y},0" for ns, x, y in dvl)]),
        ahrs="\n".join(["stamp,heading", *(f"{ns // 10**6},{value}" for ns, value in heading)]),
        usbl="\n".join(["time_ns,east_m,north_m", *(f"{ns},{x},{y}" for ns, x, y in fixes)]),
    )


@pytest.mark.parametrize("heading", ["heading", "azimuth", "course"])
def test_columns_of_csv_files_without_units_are_proposed(csv: Path, tmp_path: Path, heading: str) -> None:
    spoil(csv / "ahrs.csv", "heading", heading)

    text, found = initialised(csv, tmp_path / "found.toml")

    assert (found["dvl"]["columns"], found["dvl"]["axes"]) == (DVL_COLUMNS, "FRD")
    assert "columns" not in found["compass"]  # of such a size only degrees are
    assert text.count("# by the names of its columns") == text.count(PROPOSED) == 1


def tables_of(csv: Path) -> dict[str, dict[str, np.ndarray]]:
    sheets = {file.stem: pd.read_csv(file) for file in csv.glob("*.csv")}
    return {name: {str(label): values.to_numpy() for label, values in sheet.items()} for name, sheet in sheets.items()}


@pytest.mark.parametrize(
    ("unit", "factor", "why"),
    [
        ("mm/s", 1000, "in m/s its velocities are impossible"),
        ("cm/s", 100, "estimated from the distances between fixes"),
    ],
)
def test_velocities_that_are_impossible_in_metres_are_proposed_in_another_unit(csv, tmp_path, unit, factor, why):
    dvl = pd.read_csv(csv / "dvl.csv")
    dvl[["vx", "vy"]] *= factor
    dvl.to_csv(csv / "dvl.csv", index=False)

    text, found = initialised(csv, tmp_path / "found.toml")

    assert (found["dvl"]["unit"], found["dvl"]["axes"]) == (unit, "FRD")
    assert f"# CHECK: {why}" in text


@pytest.mark.parametrize("form", ["Parquet", "HDF5", "MATLAB"])
def test_columns_of_binary_tables_without_units_are_proposed_as_those_of_csv_files(csv, tmp_path, form):
    log = WRITERS[form](tmp_path, tables_of(csv))

    (_, of_csv), (_, of_log) = (initialised(path, tmp_path / "found.toml") for path in (csv, log))

    assert of_log == of_csv


@pytest.mark.parametrize("name", ["time", "datenum"])
def test_day_numbers_of_matlab_are_proposed_as_such(csv: Path, tmp_path: Path, name: str) -> None:
    tables = tables_of(csv)
    since_midnight_s = int(tables["dvl"]["time"][0]) % 86_400 if name == "datenum" else 0  # a whole day may be a number
    for sheet, column, per_second in (("dvl", "time", 1), ("ahrs", "stamp", 10**3), ("usbl", "time_ns", SECOND)):
        tables[sheet][column] = tables[sheet][column] - since_midnight_s * per_second
    tables["dvl"][name] = tables["dvl"].pop("time") / 86_400 + datetime.date(1970, 1, 1).toordinal() + 366

    _, found = initialised(WRITERS["MATLAB"](tmp_path, tables), tmp_path / "found.toml")

    assert found["dvl"]["columns"] == {"time_datenum": name, "x": "vx", "y": "vy", "z": "vz"}
    assert found["compass"]["convention"] == "compass"


def test_of_two_kinds_of_position_one_is_proposed(csv: Path, tmp_path: Path) -> None:
    (csv / "gps.csv").write_text(f"t,east,north,lat,lon\n{T0 // SECOND},1,2,45,7\n")
    (csv / "usbl.csv").write_text(f"t,range,bearing,elevation,east,north\n{T0 // SECOND},9,90,45,1,2\n")

    _, found = initialised(csv, tmp_path / "found.toml")

    assert found["usbl"]["columns"] == {"time_unix_s": "t", "x": "east", "y": "north"}
    assert "columns" not in found["gps"]  # latitude and longitude by their names
    assert found["dvl"]["columns"] == DVL_COLUMNS


def test_columns_beside_those_that_names_tell_are_proposed(tmp_path: Path) -> None:
    names = "Time [s],Heading (deg),VX (body),VY (body),Target Lat,Target Lon,Battery"
    rows = [f"{T0 // SECOND + k},20,1,0,{43.1 + k * 1e-5:.6f},5.9,24" for k in range(20)]
    log = saved_lines(tmp_path / "nav.csv", [names, *rows])

    text, found = initialised(log, tmp_path / "found.toml")

    assert found["dvl"]["columns"] == {"time_unix_s": "Time [s]", "x": "VX (body)", "y": "VY (body)"}
    assert found["usbl"]["columns"] == {"time_unix_s": "Time [s]", "lat_deg": "Target Lat", "lon_deg": "Target Lon"}
    assert found["compass"]["topic"] == "/nav/compass"
    assert "#   /nav: Battery\n" in text


def test_columns_beside_those_that_a_configuration_states_have_its_time(tmp_path: Path) -> None:
    rows = [f"{T0 // SECOND + k}.0,0.5,0.1,{20 + k},{k / 10},{k},{k / 2},12.1" for k in range(10)]
    text = "\n".join(["clock,a,b,heading,depth,usbl_east,usbl_north,volts", *rows])
    log = write_csv(tmp_path / "dive", auv=text) / "auv.csv"
    columns = 'columns = { time_unix_s = "clock", x = "a", y = "b" }'
    stated = saved(tmp_path / "stated.toml", f'schema = 1\n[dvl]\ntopic = "/auv"\n{columns}\n')

    text = drafted(log, "--config", stated)

    found = tomllib.loads(text)
    assert found["compass"]["columns"] == {"time_unix_s": "clock", "heading": "heading"}
    assert found["usbl"]["columns"] == {"time_unix_s": "clock", "x": "usbl_east", "y": "usbl_north"}
    assert found["depth"]["columns"] == {"time_unix_s": "clock", "depth_m": "depth"}
    assert "can name:\n#   /auv: volts\n" in text


@pytest.mark.parametrize(("places", "decided"), [("x_enu,y_enu", True), ("x,y", False), ("lat,lon", True)])
def test_a_yaw_counts_either_way_and_only_fixes_or_their_names_tell(tmp_path, places, decided):
    """Counter-clockwise from east, in radians, beside velocities to port; a depth whose unit is unknown hides none."""
    dvl, heading, fixes = UNITLESS
    seen = [(ns, 45 + y / 111_132, 7 + x / 78_717) if places == "lat,lon" else (ns, x, y) for ns, x, y in fixes]
    log = write_csv(
        tmp_path / "dive",
        dvl="\n".join(["time,vx,vy,Depth [fathom]", *(f"{ns / 1e9:.3f},{x},{-y},9" for ns, x, y in dvl)]),
        ahrs="\n".join(["time,yaw", *(f"{ns / 1e9:.3f},{np.radians((270 - v) % 360 - 180):.5f}" for ns, v in heading)]),
        usbl="\n".join([f"time,{places}", *(f"{ns / 1e9:.3f},{a:.8f},{b:.8f}" for ns, a, b in seen)]),
    )

    text, found = initialised(log, tmp_path / "found.toml")

    assert ("their mirror image" in text) == (not decided)
    assert found["compass"]["unit"] == "rad"
    assert not decided or (found["dvl"]["axes"], found["compass"]["convention"]) == ("FLU", "ENU")


@pytest.mark.parametrize(
    ("names", "found"),
    [
        ("vx,vy,lat,lon,battery_v", {"x": "vx", "y": "vy", "lat_deg": "lat", "lon_deg": "lon"}),
        ("dvl_vx,dvl_vy,gps_lat,gps_lon,lat", {"x": "dvl_vx", "y": "dvl_vy"}),  # the GPS by its own names
        ("vx,dvl_vy,latitude,lat,dvl_vx", {}),  # two candidates
        ("dvl_x,dvl_y,ned_vx,ned_vy,Latitude", {"x": "dvl_x", "y": "dvl_y"}),
        ("u_ms,v_ms,lat,lon,beacon", {"x": "u_ms", "y": "v_ms"}),
        ("u,v,lat,lon,beacon", {"x": "u", "y": "v"}),  # a position of the beacon?
    ],
)
def test_plain_names_in_one_table_of_all_sensors_are_proposed_if_they_are_the_only_ones(tmp_path, names, found):
    rows = [f"{T0 // SECOND + k}.0,{20 + k},{k},{k / 2},0.5,0.1,45.0,7.0,12.1" for k in range(10)]
    text = "\n".join([f"timestamp,heading,usbl_east,usbl_north,{names}", *rows])

    stated = tomllib.loads(drafted(write_csv(tmp_path / "dive", auv=text) / "auv.csv"))

    columns = {**stated.get("dvl", {}).get("columns", {}), **stated["gps"].get("columns", {})}
    assert {key: name for key, name in columns.items() if key != "time_unix_s"} == found


@pytest.mark.parametrize("parted", [False, True])
def test_fields_of_json_objects_are_proposed_each_for_its_sensor(tmp_path: Path, parted: bool) -> None:
    """With the DVL's flag for the DVL alone; objects may be of one sensor each, or files."""
    parts = [
        {"dvl": {"vx": 1.0, "vy": 0.1, "lock": False}},
        {"compass": {"heading_deg": 1.5}},
        {"usbl": {"lat": 45.0, "lon": 7.0}},
        {"gps": {"lat": 45.0, "lon": 7.0}},
    ]
    rows = [(part, {"ts": T0 / SECOND + k, **part}) for k in range(60) for part in parts]
    rows[0][1]["dvl"] = {**parts[0]["dvl"], "lock": True}
    for part, row in rows:
        with (tmp_path / f"{next(iter(part)) if parted else 'dive'}.jsonl").open("a", encoding="utf-8") as file:
            file.write(json.dumps(row) + "\n")
    log = tmp_path if parted else tmp_path / "dive.jsonl"

    info = run("info", log)
    found = tomllib.loads(drafted(log))

    assert (info.return_value, "; run usbldr init" in info.stdout) == (3, True)
    assert {role: found[role]["columns"] for role in ("dvl", "compass", "usbl", "gps")} == {
        "dvl": {"x": "dvl.vx", "y": "dvl.vy", "valid": "dvl.lock"},
        "compass": {"heading": "compass.heading_deg"},
        **{role: {"lat_deg": f"{role}.lat", "lon_deg": f"{role}.lon"} for role in ("usbl", "gps")},
    }
    if not parted:
        columns = {role: found[role]["columns"] for role in ("compass", "gps")}
        toml = "".join(f"[{role}]\ncolumns = {inline(one)}\n" for role, one in columns.items())
        read = read_log(log, Request(str(saved(tmp_path / "some.toml", toml)), topics={"dvl": "none", "usbl": "none"}))
        assert [len(read.tables[role]) for role in columns] == [60, 60]
        assert {"COMPASS-INVALID", "GPS-INVALID", "SAME-STAMP"}.isdisjoint(one.code for one in read.findings)


@pytest.mark.parametrize("ending", ["csv", "jsonl"])
@pytest.mark.parametrize("counts", [True, False])
def test_a_column_that_numbers_the_fixes_is_no_flag(tmp_path: Path, ending: str, counts: bool, monkeypatch) -> None:
    monkeypatch.setattr("usbldr.io.doctor.cross_check._identified", lambda *_: None)  # takes seconds
    dvl = "".join(f"{T0 + k * SECOND},1,0\n" for k in range(60))
    headings = "".join(f"{T0 + k * SECOND},{k}\n" for k in range(60))
    sheets = {"dvl": f"time_ns,forward_mps,starboard_mps\n{dvl}", "compass": f"time_ns,heading_deg\n{headings}"}
    folder = write_csv(tmp_path / "dive", **sheets)
    rows = [{"time_s": T0 // SECOND + k, "e": k / 2, "n": k / 3, "Fix": k if counts else k % 2} for k in range(60)]
    texts = {"csv": pd.DataFrame(rows).to_csv(index=False), "jsonl": "".join(json.dumps(row) + "\n" for row in rows)}
    saved(folder / f"usbl.{ending}", texts[ending])

    draft = drafted(folder)

    assert ("valid" in tomllib.loads(draft)["usbl"]["columns"]) != counts
    columns = {"time_unix_s": "time_s", "x": "e", "y": "n", "valid": "Fix"}
    log = read_as(folder, f'[usbl]\ntopic = "/usbl"\nrelative_to = "map"\ncolumns = {inline(columns)}\n')
    assert len(log.tables["usbl"]) == (60 if counts else 30)
    assert ("FLAG-COUNTS" in {one.code for one in log.findings}) == counts


def test_velocities_along_north_and_east_are_no_dvls(tmp_path: Path) -> None:
    rows = [f"{T0 // SECOND + k},{k},{k / 9},0.1,0.2,45.0,7.{k:03}" for k in range(60)]
    names = "Time [s],Heading [deg],Depth [m],vel_north [m/s],vel_east [m/s],usbl_lat [deg],usbl_lon [deg]"
    log = saved(tmp_path / "log.csv", "\n".join([names, *rows]))

    said = asked_in(log, tmp_path / "found.toml")[0], str(run("replay", log, "--filter", "adf").exception)

    assert all("vel_north [m/s], vel_east [m/s]" in one and ALONG_EARTH in one for one in said)


def test_nothing_is_proposed_if_names_do_not_suffice_or_two_columns_are_of_one_quantity(csv, tmp_path):
    sheet = pd.read_csv(csv / "ahrs.csv")
    sheet.assign(imu_heading=sheet["heading"]).to_csv(csv / "ahrs.csv", index=False)
    nameless = {"heading_rate": 1.0, "heading_rad": 2.0}
    odd = [(row[0], "/dvl_heading", GYRO, nameless) if row[1] == "/dvl" else row for row in short_dive()]

    two = "/ahrs cannot be read as compass: ahrs.csv has c"
    none = "no topic is known to be dvl; without it, only --filter usbl works"
    for sensor, log, why in (("compass", csv, two), ("dvl", write_mcap(tmp_path / "dive.mcap", odd), none)):
        said, text = asked_in(log, tmp_path / f"{sensor}.toml")
        assert why in said
        assert sensor not in tomllib.loads(text)


def test_what_cannot_be_read_is_asked_for_in_a_file_that_names_the_rest(csv: Path, tmp_path: Path) -> None:
    file = tmp_path / "found.toml"
    spoil((csv / "ahrs.csv").rename(csv / "compass.csv"), "stamp,heading", "stamp,chi")

    said, text = asked_in(csv, file)

    assert said.endswith(f"{file} is written: complete the lines marked CHECK")
    assert "usbldr init" not in said
    assert tomllib.loads(text)["dvl"]["columns"] == DVL_COLUMNS
    why = "/compass cannot be read as compass: compass.csv has no column whose name states quantity and unit"
    assert f"CHECK: {why}" in text
    asked = '# [compass]\n# columns = { time_unix_ms = "stamp", heading = "?" }'
    assert asked in text
    spoil(file, asked, '[compass]\ncolumns = { time_unix_ms = "stamp", heading = "chi" }')
    accepted(csv, file)


def test_a_truth_that_cannot_be_read_is_asked_for_beside_all_that_fits(csv: Path, tmp_path: Path) -> None:
    (csv / "gps.csv").write_text(f"t,place\n{T0 // SECOND},here\n", encoding="utf-8")

    _, text = asked_in(csv, tmp_path / "found.toml")

    found = tomllib.loads(text)
    assert (found["dvl"]["axes"], "gps" in found) == ("FRD", False)
    assert '# [gps]\n# columns = { time_unix_s = "t", lat_deg = "?", lon_deg = "?" }' in text
    assert "CHECK: /gps cannot be read as gps: gps.csv has no column whose name states quantity and unit" in text


def test_positions_without_direction_and_time_in_other_units_are_proposed(tmp_path: Path) -> None:
    """A tracking program's x and y, a truth in microseconds, one table whose columns have the words of ships."""
    dvl, heading, fixes = UNITLESS
    rows = [f"{ns // 1000},{x},{y},,,," for ns, x, y in dvl] + [f"{ns // 1000},,,{value},,," for ns, value in heading]
    rows += [f"{ns // 1000},,,,{x},{y},1" for ns, x, y in fixes]
    truth = [f"{ns // 1000},{x},{y}" for ns, x, y in fixes]
    log = write_csv(
        tmp_path / "dive",
        log="\n".join(["t_us,u,v,hdg,usbl_x,usbl_y,usbl_z", *sorted(rows)]),
        truth="\n".join(["timestamp_us,x,y", *truth]),
    )

    _, found = initialised(log, tmp_path / "found.toml")

    assert found["dvl"]["columns"] == {"time_unix_us": "t_us", "x": "u", "y": "v"}
    assert found["usbl"]["columns"] == {"time_unix_us": "t_us", "x": "usbl_x", "y": "usbl_y"}
    assert found["dvl"]["axes"] == "FRD"


def test_a_truth_file_that_cannot_be_read_is_asked_for_and_its_columns_can_be_stated(csv: Path) -> None:
    rows = [f"{(T0 + k * SECOND) // 10**6},{45 + k * 1e-6},7" for k in range(30)]
    (csv / "truth.csv").write_text("\n".join(["clock,phi,lambda", *rows, ""]), encoding="utf-8")
    file = csv / "usbldr.toml"

    _, text = asked_in(csv, file)

    assert tomllib.loads(text)["dvl"]["axes"] == "FRD"
    asked = '# [truth]\n# columns = { time_unix_ms = "clock", lat_deg = "?", lon_deg = "?" }'
    assert asked in text
    stated = f'{MAP}[truth]\nfile = "truth.csv"\n'
    stated += 'columns = { time_unix_ms = "clock", lat_deg = "phi", lon_deg = "lambda" }'
    file.write_text(text.replace(asked, stated), encoding="utf-8")
    accepted(csv, file)


@pytest.mark.long
def test_a_table_on_gps_time_costs_nothing_once_init_has_stated_its_latency(tmp_path: Path) -> None:
    """GPS time is 18 s ahead of UTC; the numbers are those of the same dive with one clock."""
    found: dict[str, list[float]] = {}
    for sensor, ahead_s in (("usbl", 0), ("dvl", 18), ("compass", 18)):
        folder, made = write_short(tmp_path / sensor, "turns", 400.0), tmp_path / f"run_{sensor}"
        table = pd.read_csv(folder / f"{sensor}.csv")
        table.assign(time_ns=table["time_ns"] + ahead_s * SECOND).to_csv(folder / f"{sensor}.csv", index=False)
        (folder / "usbldr.toml").unlink()

        output_of("init", folder)
        output_of("replay", folder, "-f", "adf", "--plots", "none", "-o", made)

        text = (folder / "usbldr.toml").read_text(encoding="utf-8")
        assert tomllib.loads(text)[sensor]["latency_s"] == pytest.approx(ahead_s, abs=0.5)
        found[sensor] = [float(re.search(rf"{of}\D+([\d.]+)", text)[1]) for of in ("fix residual", "sd_scale")]
        found[sensor].append(report_of(made)["metrics"]["mean_horizontal_m"])
    assert found["dvl"] == pytest.approx(found["usbl"], rel=0.2)
    assert found["compass"] == pytest.approx(found["usbl"], rel=0.2)


def test_a_compass_without_stamps_has_one_latency_that_the_fixes_show(tmp_path: Path) -> None:
    found = examine(written(tmp_path, toml='[compass]\ntime = "log"\n'), Request(), with_errors=False)
    off = {"CLOCK-OFFSET": -0.3, "COMPASS-CLOCK": 18.0}
    named = tuple(Finding(code, "its clock is off", "/imu", None, late_s, "s") for code, late_s in off.items())

    assert found.log is not None
    lines = compass_lines(replace(found, findings=named), found.log)

    assert [entry for entry, _ in lines if "latency_s" in entry] == ["latency_s = 18.0"]
