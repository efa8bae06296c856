"""The door: what a log that cannot be used says, and what a half-readable one still gives."""

import hashlib
from pathlib import Path

import pytest

from logs import logged, only, read_as, refusal
from recordings import SECOND, T0, fix, point, short_dive, twist, write_csv, write_mcap, write_payloads, yaw
from usbldr.filters.errors import LogError
from usbldr.io.log import COLUMNS
from usbldr.io.reading.read import Request, read_log, require
from usbldr.io.reading.survey import survey


def test_a_short_dive_becomes_canonical_tables(tmp_path: Path) -> None:
    file = write_mcap(tmp_path / "dive.mcap", [*short_dive(), fix(T0, 45.0, 7.0)])

    log = read_log(file)

    columns = {role: COLUMNS[role] for role in ("dvl", "compass", "usbl", "gps")}
    assert {role: tuple(table.columns) for role, table in log.tables.items()} == columns
    assert log.format == "MCAP"
    assert log.start_ns == T0
    assert log.sha256 == hashlib.sha256(file.read_bytes()).hexdigest()
    assert log.configuration is None
    counts = dict.fromkeys(("dvl", "compass", "usbl"), (11, 11)) | {"gps": (1, 1)}
    assert {role: (p.messages, p.used) for role, p in log.provenance.items()} == counts


def test_a_missing_sensor_is_an_error_only_for_who_needs_it(tmp_path: Path) -> None:
    file = write_mcap(tmp_path / "dive.mcap", [yaw(T0, 0), point(T0, 1, 2)])
    log = read_log(file)

    require(log, ("compass", "usbl"))
    assert refusal(LogError, require, log, ("dvl", "compass")) == (
        f"{file}: no dvl data (sensors in this log: compass, usbl); name its topic by --dvl TOPIC, "
        "or add the file that holds it by --with FILE; without it, --filter usbl judges the raw fixes"
    )


FIRST, LATER = (T0, T0 + SECOND), T0 + 3600 * SECOND
APART = [*(twist(t, 1, 0) for t in FIRST), *(yaw(t, 0) for t in FIRST), point(LATER, 0, 0)]
SPANS = (
    "the sensors do not overlap in time: "
    "dvl 2020-09-13T12:26:40.000Z to 2020-09-13T12:26:41.000Z, "
    "compass 2020-09-13T12:26:40.000Z to 2020-09-13T12:26:41.000Z, "
    "usbl 2020-09-13T13:26:40.000Z to 2020-09-13T13:26:40.000Z; "
    'if a clock is wrong, try time = "log" or state latency_s (3600 under [usbl], if these times are of a time '
    "zone 1 h ahead)"
)
CUT = "holds no messages (the file is truncated or damaged at byte 36 of 60: 0 messages could be read)"


@pytest.mark.parametrize(
    ("rows", "cut", "said"), [([], None, "holds no messages"), (short_dive(), 60, CUT), (APART, None, SPANS)]
)
def test_a_log_without_messages_or_one_moment_of_all_sensors_says_so_and_if_it_was_cut(tmp_path, rows, cut, said):
    file = write_mcap(tmp_path / "dive.mcap", rows)
    file.write_bytes(file.read_bytes()[:cut])

    assert refusal(LogError, read_log, file) == f"{file}: {said}"


def test_sensors_of_another_time_zone_are_named_together(tmp_path: Path) -> None:
    later = T0 + 7200 * SECOND
    rows = [point(T0, 0, 0), twist(later, 1, 0), yaw(later, 0)]

    said = refusal(LogError, read_log, write_mcap(tmp_path / "dive.mcap", rows))

    assert "(7200 under [dvl] and [compass], if these times are of a time zone 2 h ahead)" in said


@pytest.mark.parametrize(
    ("usbl", "said"),
    [
        ("02/05/2026", "day and month of dvl and usbl are exchanged"),
        ("03/02/2026", "state path and clock_offset_s of its file"),
    ],
)
def test_no_sensor_is_of_a_zone_farther_than_any(tmp_path: Path, usbl: str, said: str) -> None:
    """As of a file whose program writes the day first, and of one that is a day or more ahead."""
    date = "05/02/2026 00:00:00"
    files = {"dvl": f"Time,forward_mps,starboard_mps\n{date},1,0", "compass": f"Time,heading_deg\n{date},1"}
    log = write_csv(tmp_path / "dive", **files, usbl=f"Time,lat_deg,lon_deg\n{usbl} 00:00:00,45,7")

    text = refusal(LogError, read_log, log)

    assert " h ahead" not in text
    assert said in text


def test_a_file_of_another_time_zone_is_named_with_the_keys_that_move_it(tmp_path: Path) -> None:
    """The vehicle's file has a first velocity only minutes after its first heading, and no unit of its pressure."""
    rows = [f"2026-07-08 12:{20 + k}:00,{k},{',' if k < 4 else '0.5,0.1'},1.1" for k in range(40)]
    fixes = [f"2026-07-08 10:{20 + k}:09,45,7" for k in range(39)]
    auv = "\n".join(["Time,Heading [deg],DVL X [m/s],DVL Y [m/s],Pressure", *rows])
    log = write_csv(tmp_path / "dive", auv=auv, ship="\n".join(["Time,USBL Lat [deg],USBL Lon [deg]", *fixes]))
    stated = 'clock_offset_s = 7200 beside path = "dive/auv.csv" under [[file]]'

    said = survey(log, Request()).fault

    units = "(Pa, hPa, kPa, dbar, bar, psi)"
    why = f"a column Pressure without a known unit {units}; write it behind the name"
    assert f"{why}; --depth none leaves it out; the sensors" in said
    assert f"if the times of dvl and compass are of a time zone 2 h ahead, state {stated}" in said
    moved = '[[file]]\npath = "dive/auv.csv"\nclock_offset_s = 7200\n[depth]\ntopic = "none"\n'
    assert {*read_as(log, moved).tables} == {"dvl", "compass", "usbl"}


def test_a_log_that_begins_after_today_is_named(tmp_path: Path) -> None:
    labview_ns = (2_082_844_800 + T0 // SECOND) * SECOND  # as many seconds since 1904
    dives = {"now": T0, "future": labview_ns}
    logs = {
        name: read_log(write_csv(tmp_path / name, compass=f"time_ns,heading_deg\n{ns},1")) for name, ns in dives.items()
    }

    found = {name: [f.text for f in log.findings if f.code == "CLOCK-FUTURE"] for name, log in logs.items()}

    assert found["now"] == []
    assert found["future"][0].startswith("future: its records begin at 2086-09-14T12:26:40.000Z, after today")


def test_gps_without_any_fix_is_a_finding_not_an_error(tmp_path: Path) -> None:
    file = write_mcap(tmp_path / "dive.mcap", [*short_dive(), fix(T0, 0.0, 0.0, status=-1)])

    log = read_log(file)

    assert "gps" not in log.tables
    assert log.truth is None
    said = f"{file}: all 1 records of /gps/fix (gps) are invalid: 1 without fix (status below 0)"
    assert only(log, "GPS-INVALID") == said


def test_the_map_is_the_origin_before_head_and_gps(tmp_path: Path) -> None:
    file = write_mcap(tmp_path / "dive.mcap", [*short_dive(), fix(T0, 45.0, 7.0)])
    head = "[usbl]\nhead = { lat_deg = 44.0, lon_deg = 7.0 }\n"
    sources: list[tuple[float, str]] = []
    for toml in ("[map]\norigin_lat_deg = 43.0\norigin_lon_deg = 7.0\n" + head, head, ""):
        origin = read_as(file, toml).origin
        sources.append((origin.lat_deg, origin.kind))

    assert sources == [(43.0, "[map]"), (44.0, "usbl head"), (45.0, "first gps fix")]


def test_the_digest_of_a_folder_changes_with_its_files_and_not_with_its_configuration(tmp_path: Path) -> None:
    folder = write_csv(tmp_path / "dive", compass="time_ns,heading_deg\n1,2")
    first = read_log(folder).sha256
    assert read_as(folder, "[compass]\nsd_deg = 2.0").sha256 == first

    write_csv(folder, compass="time_ns,heading_deg\n1,3")
    assert read_log(folder).sha256 != first


def test_a_log_of_unknown_encodings_alone_is_a_log_without_sensors(tmp_path: Path) -> None:
    schema = ("foxglove.LocationFix", "jsonschema", b"{}")
    file = write_payloads(tmp_path / "dive.mcap", "/gps/fix", "json", schema, [b"{}"])

    assert dict(read_log(file).tables) == {}


PLACE = (45.0, 7.0)
IN_RADIANS = (0.7854, 0.1222)
MAP = "[map]\norigin_lat_deg = {}\norigin_lon_deg = 7.0"


@pytest.mark.parametrize(
    ("usbl", "gps", "toml", "sentence"),
    [
        (PLACE, PLACE, "", None),
        (PLACE[::-1], PLACE, "", "/usbl/fix and /gps/fix are "),
        (PLACE, IN_RADIANS, "", "/usbl/fix and /gps/fix are "),
        (PLACE, PLACE, "[map]\norigin_lat_deg = 46.0\norigin_lon_deg = 7.0",
         "/usbl/fix and /gps/fix: 111 km from the map"),
        (PLACE, PLACE, "[map]\norigin_lat_deg = 45.3\norigin_lon_deg = 7.0", None),
    ],
)  # fmt: skip
def test_places_that_cannot_be_of_one_dive_are_told(tmp_path, usbl, gps, toml, sentence):
    places = ((usbl, "/usbl/fix"), (gps, "/gps/fix"))
    fixes = [fix(T0 + k * SECOND, *at, topic=name) for k in range(5) for at, name in places]

    log = logged(tmp_path, [*(row for row in short_dive() if row[1] != "/usbl"), *fixes], toml)

    found = [finding.text for finding in log.findings if finding.code == "PLACES-APART"]
    assert len(found) == (sentence is not None)
    assert all(text.startswith(sentence or "") for text in found)


def test_the_fixes_of_a_usbl_do_not_become_the_truth_where_the_gps_serves_as_usbl(tmp_path: Path) -> None:
    fixes = [fix(T0 + k * SECOND, *PLACE, topic=name) for k in range(5) for name in ("/usbl/fix", "/gps/fix")]
    log = write_mcap(tmp_path / "dive.mcap", [*(row for row in short_dive() if row[1] != "/usbl"), *fixes])

    right, swapped = read_as(log, MAP.format(45.0)), read_log(log, Request(topics={"usbl": "/gps/fix"}))

    assert (right.provenance["usbl"].topic, right.truth.source) == ("/usbl/fix", "/gps/fix")
    assert swapped.truth is None


@pytest.mark.parametrize(("unit_ns", "unit"), [(1_000, "us"), (1_000_000, "ms"), (SECOND, "s")])
def test_stamps_of_another_unit_are_refused_with_the_unit_that_fits(tmp_path: Path, unit_ns: int, unit: str) -> None:
    stamps = [(T0 + k * SECOND // 5) // unit_ns for k in range(301)]
    dvl = "\n".join(["time_ns,forward_mps,starboard_mps", *(f"{stamp},1,0" for stamp in stamps)])
    compass = "\n".join(["time_ns,heading_deg", *(f"{stamp},30" for stamp in stamps)])
    folder = write_csv(tmp_path / "dive", dvl=dvl, compass=compass)
    with pytest.raises(LogError, match=rf"log of 60 s; state columns = \{{ time_unix_{unit} = "):
        read_log(folder)
