"""The doctor on dives whose faults are known, because the test put them there."""

import json
import re
import tomllib
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from commands import findings, run
from curved import curved_dive, in_radians
from recordings import SECOND, T0, Row, point, write_csv, write_mcap, yaw
from usbldr.filters.errors import LogError
from usbldr.io.doctor.gross_errors import unit_or_scale_key
from usbldr.io.reader import Records
from usbldr.io.reading.read import Request, read_log
from usbldr.io.recordings.mcap_log import McapLog


def test_a_dive_by_the_defaults_is_healthy(tmp_path: Path) -> None:
    log = write_mcap(tmp_path / "dive.mcap", curved_dive(gps=True))

    done = run("doctor", log)

    assert done.return_value == 0, done.output
    assert re.search(r"CONVENTION-CHECKED: .* m RMS with axes FLU, convention ENU, frame ENU", done.output)
    assert "HEADING-CHECKED" in done.output
    assert "0 errors" in done.output


@pytest.mark.parametrize("gravity", [-9.8, 0.0])
def test_a_yaw_that_counts_the_other_way_is_found_with_its_option(tmp_path: Path, gravity: float) -> None:
    log = write_mcap(tmp_path / "dive.mcap", curved_dive(imu="NED", usbl="ENU", gps=True, gravity=gravity))

    found = findings(log)

    assert found["HEADING-CONVENTION"]["level"] == "error"
    assert 'state convention = "NED" under [compass]' in found["HEADING-CONVENTION"]["text"]
    assert {"MAP-FRAME", "DVL-AXES", "CONVENTION-UNDECIDED"}.isdisjoint(found)
    assert run("doctor", log).return_value == 1


def test_replay_warns_of_a_better_reading_and_changes_nothing(tmp_path: Path) -> None:
    log = write_mcap(tmp_path / "dive.mcap", curved_dive(imu="NED", gps=True))
    options = ["--filter", "dr", "--output", str(tmp_path / "run")]

    done = run("replay", log, *options)

    assert done.return_value == 0
    assert "but NED fits better; dead-reckoning-to-fix residual: " in done.stderr
    assert done.stderr.count("[HEADING-CONVENTION]") == 1
    report = json.loads((tmp_path / "run" / "report.json").read_text())
    assert "HEADING-CONVENTION" in [finding["code"] for finding in report["findings"]]
    texts = [convention["text"] for convention in report["sensors"]["compass"]["conventions"]]
    assert "convention ENU (by type)" in texts


def test_a_mirrored_dvl_is_found(tmp_path: Path) -> None:
    log = write_mcap(tmp_path / "dive.mcap", curved_dive(dvl="FRD", gps=True))

    found = findings(log)

    assert 'state axes = "FRD" under [dvl]' in found["DVL-AXES"]["text"]
    assert {"MAP-FRAME", "HEADING-CONVENTION"}.isdisjoint(found)


@pytest.mark.long
def test_a_mirror_image_of_the_whole_log_is_undecided_until_something_tells(tmp_path: Path) -> None:
    mirrored: dict[str, Any] = {"dvl": "FRD", "imu": "NED", "usbl": "NED"}
    bare = write_mcap(tmp_path / "bare.mcap", curved_dive(**mirrored))
    told_by_gps = write_mcap(tmp_path / "gps.mcap", curved_dive(**mirrored, gps=True))
    told_by_gravity = write_mcap(tmp_path / "gravity.mcap", curved_dive(**mirrored, gravity=-9.8))

    assert "CONVENTION-UNDECIDED" in findings(bare)
    for log, source in ((told_by_gps, "GPS"), (told_by_gravity, "gravity")):
        found = findings(log)
        assert "CONVENTION-UNDECIDED" not in found
        assert f"excluded by: {source}" in found["MAP-FRAME"]["text"]
        assert {"DVL-AXES", "HEADING-CONVENTION"} <= set(found)


def test_replay_and_doctor_exclude_the_mirror_image_by_the_same_evidence(tmp_path: Path) -> None:
    log = write_mcap(tmp_path / "dive.mcap", curved_dive(dvl="FRD", imu="NED", usbl="NED", gravity=-9.8))

    replayed = run("replay", str(log), "--filter", "nudge", "--output", str(tmp_path / "out"))

    assert findings(log)["MAP-FRAME"]["text"] in replayed.stderr


def test_gravity_that_contradicts_gps_is_told(tmp_path: Path) -> None:
    log = write_mcap(tmp_path / "dive.mcap", curved_dive(gps=True, gravity=-9.8))

    found = findings(log)

    assert "gravity" in found["CONVENTION-CONTRADICTED"]["text"]
    assert "HEADING-CONVENTION" not in found


@pytest.mark.parametrize("conventions", [{}, {"imu": "NED", "usbl": "NED"}, {"imu": "NED"}, {"dvl": "FRD"}])
def test_the_mount_is_found_whatever_else_is_wrong(tmp_path: Path, conventions: dict[str, Any]) -> None:
    log = write_mcap(tmp_path / "dive.mcap", curved_dive(mount_deg=-50.0, gps=True, **conventions))

    found = findings(log)

    assert found["DVL-MOUNT"]["worst"] == pytest.approx(-50.0, abs=1.0)
    assert "mount_deg = -" in found["DVL-MOUNT"]["text"]


def test_what_the_doctor_names_cures_the_log(tmp_path: Path) -> None:
    log = write_mcap(
        tmp_path / "dive.mcap", curved_dive(mount_deg=30.0, dvl="FRD", imu="NED", usbl="NED", gps=True, late_s=1.5)
    )
    (tmp_path / "usbldr.toml").write_text(
        '[dvl]\naxes = "FRD"\nmount_deg = 30.0\n[compass]\nconvention = "NED"\n[usbl]\nframe = "NED"\nlatency_s = 1.5\n'
    )

    ill, cured = findings(log, "--config", "none"), findings(log)

    assert {"DVL-AXES", "HEADING-CONVENTION", "MAP-FRAME", "DVL-MOUNT", "USBL-LATENCY"} <= set(ill)
    assert ill["USBL-LATENCY"]["worst"] == pytest.approx(1.5, abs=0.1)
    assert all(one["level"] != "error" for one in cured.values())
    assert {"DVL-MOUNT", "HEADING-BIAS", "USBL-LATENCY"}.isdisjoint(cured)


def test_a_straight_line_is_no_evidence(tmp_path: Path) -> None:
    log = write_mcap(tmp_path / "dive.mcap", curved_dive(straight=True, gps=True))

    found = findings(log)

    assert "CONVENTION-UNOBSERVABLE" in found
    assert {"DVL-AXES", "HEADING-CONVENTION", "MAP-FRAME"}.isdisjoint(found)


def test_gross_fixes_are_counted_and_the_worst_is_placed(tmp_path: Path) -> None:
    log = write_mcap(tmp_path / "dive.mcap", curved_dive(gross=(100, 101, 300), gps=False))

    found = findings(log)["USBL-OUTLIERS"]

    assert "3 of 580 fixes" in found["text"]
    assert found["worst"] == pytest.approx(12.0, abs=1.5)
    assert found["time_s"] in (110.0, 111.0, 310.0)


def test_late_fixes_doubled_records_and_lost_lock_are_found(tmp_path: Path) -> None:
    rows = [row for row in curved_dive() for _ in range(2 if row[1] == "/dvl" else 1)]
    blind = [(*r[:3], dict(r[3]) | {f"twist.linear.{axis}": 327.67 for axis in "xyz"}) for r in rows[800:900]]
    log = write_mcap(tmp_path / "dive.mcap", [*rows[:800], *(b if b[1] == "/dvl" else r for r, b in zip(rows[800:900], blind, strict=True)), *rows[900:]])  # fmt: skip  # noqa: E501

    found = findings(log)

    assert found["USBL-DELAYED"]["worst"] == pytest.approx(0.8, abs=0.01)
    assert "records repeat another's stamp and values" in found["REPEATED"]["text"]
    assert "have the no-bottom-lock value 327.67 m/s" in found["DVL-INVALID"]["text"]
    assert found["DVL-INVALID"]["worst"] == pytest.approx(327.67)
    blind_s = [(row[0] - T0) / SECOND for row in blind if row[1] == "/dvl"]
    assert found["LOST-LOCK"]["time_s"] == pytest.approx(blind_s[0] - 0.5)
    assert found["LOST-LOCK"]["worst"] == pytest.approx(blind_s[-1] - blind_s[0] + 1.0)


@pytest.mark.parametrize("unit", ["m/s", "mm/s"])
def test_the_worst_of_the_invalid_records_is_none_of_the_valid_ones(tmp_path: Path, unit: str) -> None:
    """The vehicle makes 1.3 m/s where the DVL sees the bottom; of what it says without, 0.25 m/s is the most."""
    times = {"m/s": 1.0, "mm/s": 1000.0}[unit]
    text = ["time_ns,x,y,valid", *(f"{T0 + k * SECOND},{times * 1.3},0,1" for k in range(60))]
    text += [f"{T0 + (60 + k) * SECOND},{times * 0.05 * k},0,0" for k in range(6)]
    folder = write_csv(
        tmp_path / "dive",
        velocity="\n".join(text),
        compass="\n".join(["time_ns,heading_deg", *(f"{T0 + k * SECOND},0" for k in range(66))]),
        usbl="\n".join(["time_ns,east_m,north_m", *(f"{T0 + k * SECOND},0,{1.3 * k}" for k in range(66))]),
    )
    columns = '{ time_ns = "time_ns", x = "x", y = "y", valid = "valid" }'
    (folder / "usbldr.toml").write_text(f'[dvl]\ncolumns = {columns}\naxes = "FSD"\nunit = "{unit}"\n')

    found = findings(folder)["DVL-INVALID"]

    assert (found["worst"], found["unit"]) == (pytest.approx(0.25), "m/s")


def test_two_topics_for_a_role_are_an_error_and_the_one_with_more_messages_is_examined(tmp_path: Path) -> None:
    rows = curved_dive()
    others = [(*point(T0 + k * SECOND, 0, 0, topic="/usbl/raw"),) for k in range(5)]
    log = write_mcap(tmp_path / "dive.mcap", sorted([*rows, *others], key=lambda row: row[0]))

    done = run("doctor", log)

    assert done.return_value == 1
    assert "ROLE-UNDECIDED: 2 topics could be the usbl" in done.output
    assert "doctor uses /usbl" in done.output
    assert "HEADING-CHECKED" in done.output


def test_a_log_without_a_sensor_is_ill_and_one_that_is_none_is_unreadable(tmp_path: Path) -> None:
    no_dvl = write_mcap(tmp_path / "no_dvl.mcap", [row for row in curved_dive() if row[1] != "/dvl"])
    none = tmp_path / "none.mcap"
    none.write_bytes(b"no log at all")

    missing, unreadable = run("doctor", no_dvl), run("doctor", none)

    assert missing.return_value == 1
    assert "SENSOR-MISSING: no dvl data (sensors in this log: compass, usbl)" in missing.output
    assert isinstance(unreadable.exception, LogError)


def test_gps_under_water_is_found(tmp_path: Path) -> None:
    seconds = range(60)
    stamps = [T0 + k * SECOND for k in seconds]
    folder = write_csv(
        tmp_path / "dive",
        dvl="\n".join(["time_ns,starboard_mps,forward_mps", *(f"{ns},0,1" for ns in stamps)]),
        compass="\n".join(["time_ns,heading_deg", *(f"{ns},0" for ns in stamps)]),
        usbl="\n".join(["time_ns,east_m,north_m", *(f"{ns},0,{k}" for k, ns in enumerate(stamps))]),
        gps="\n".join(["time_ns,lat_deg,lon_deg", *(f"{ns},45,7" for ns in stamps)]),
        depth="\n".join(["time_ns,depth_m", *(f"{ns},{0.1 if k < 20 else k / 10}" for k, ns in enumerate(stamps))]),
    )

    found = findings(folder)["GPS-UNDERWATER"]

    assert "40 of 60 fixes were made under water" in found["text"]
    assert (found["worst"], found["time_s"]) == (pytest.approx(5.9), 59.0)
    assert found["text"] in {finding.text for finding in read_log(folder).findings}
    assert "GPS-UNDERWATER" not in {finding.code for finding in read_log(folder, Request(truth="none")).findings}


def test_a_heading_logged_later_than_the_dvl_is_found(tmp_path: Path) -> None:
    rows = [(row[0] + (SECOND // 2 if row[1] == "/imu" else 0), *row[1:]) for row in curved_dive()]
    log = write_mcap(tmp_path / "dive.mcap", sorted(rows, key=lambda row: row[0]))

    found = findings(log)["CLOCK-OFFSET"]

    assert found["topic"] == "/imu"
    assert found["worst"] == pytest.approx(0.5)


@pytest.mark.long
def test_headings_in_radians_are_told_from_degrees_by_the_fixes(tmp_path: Path) -> None:
    log = write_mcap(tmp_path / "dive.mcap", in_radians(curved_dive()))
    (tmp_path / "usbldr.toml").write_text('[compass]\nunit = "deg"\n')

    found = findings(log)

    assert 'state unit = "rad" under [compass]' in found["HEADING-RADIANS"]["text"]
    (tmp_path / "usbldr.toml").write_text('[compass]\nunit = "rad"\n')
    assert "HEADING-RADIANS" not in findings(log)


@pytest.mark.long
def test_a_csv_folder_of_radians_is_told_what_mends_it(tmp_path: Path) -> None:
    """Of a column heading_deg the unit is settled, so that the column has to be named, too."""
    folder = csv_dive(tmp_path / "dive", in_radians(curved_dive()))

    advice = str(findings(folder)["HEADING-RADIANS"]["text"]).partition("; state ")[2].removesuffix(" under [compass]")

    (folder / "usbldr.toml").write_text("[compass]\n" + advice.replace(" and unit", "\nunit"))
    mended = findings(folder)
    assert {"HEADING-RADIANS", "KEY-UNUSED", "UNUSABLE"}.isdisjoint(mended)
    assert abs(mended["HEADING-CHECKED"]["worst"]) < 1


def csv_dive(folder: Path, rows: list[Row]) -> Path:
    """Write a dive's velocities, headings and fixes as CSV files of our own columns, as they are numbered."""
    dvl, compass, usbl = "time_ns,starboard_mps,forward_mps", "time_ns,heading_deg", "time_ns,east_m,north_m"
    lines = {"/dvl": [dvl], "/heading": [compass], "/usbl": [usbl]}
    for ns, topic, _, values in rows:
        if topic not in lines:
            continue
        numbers = [value for name, value in values.items() if name.endswith((".x", ".y", "data"))]
        reported = [-numbers[1], numbers[0]] if topic == "/dvl" else numbers
        lines[topic].append(",".join(map(str, (values.get("header.stamp", ns), *reported))))
    dvl, compass, usbl = ("\n".join(reported) for reported in lines.values())
    return write_csv(folder, dvl=dvl, compass=compass, usbl=usbl)


@pytest.mark.parametrize(
    ("times", "advice"),
    [
        (1.944, 'state unit = "knots" under [dvl]'),
        (3.281, 'state unit = "ft/s" under [dvl]'),
        (3.6, 'state unit = "km/h" under [dvl]'),
        (2.5, "state scale_error = 1.5"),
        (0.01, "no unit explains it: check what its driver writes"),
    ],
)
@pytest.mark.long
def test_velocities_of_another_unit_are_told_by_the_fixes_and_hide_nothing_else(
    tmp_path: Path, times: float, advice: str
) -> None:
    rows = curved_dive(gps=True, late_s=1.0, mount_deg=20.0)
    log = write_mcap(tmp_path / "dive.mcap", [faster(row, times) for row in rows])

    found, right = findings(log), findings(write_mcap(tmp_path / "right.mcap", rows))

    assert found["DVL-UNIT"]["level"] == "error"
    assert found["DVL-UNIT"]["worst"] == pytest.approx(times, rel=0.01)
    assert advice in found["DVL-UNIT"]["text"]
    assert set(found) - set(right) == {"DVL-UNIT"}
    assert found["DVL-MOUNT"]["worst"] == pytest.approx(right["DVL-MOUNT"]["worst"], abs=0.3)
    assert "[DVL-UNIT]" in replayed(log)


def test_the_unit_that_a_dvl_was_read_by_wrongly_is_named(tmp_path: Path) -> None:
    log = write_mcap(tmp_path / "dive.mcap", curved_dive())
    (tmp_path / "usbldr.toml").write_text('[dvl]\nunit = "mm/s"\n')

    assert findings(log)["DVL-UNIT"]["text"].endswith('state unit = "m/s" under [dvl]')


@pytest.mark.parametrize(("times", "key", "value"), [(1.944, "unit", "knots"), (2.5, "scale_error", 1.5)])
def test_init_takes_off_what_the_dvl_reads_too_much(tmp_path: Path, times: float, key: str, value: str | float) -> None:
    log = write_mcap(tmp_path / "dive.mcap", [faster(row, times) for row in curved_dive()])

    drafted = drafted_for(log)

    stated = tomllib.loads(drafted.read_text())["dvl"][key]
    assert stated == (value if isinstance(value, str) else pytest.approx(value, abs=0.03))
    assert "DVL-UNIT" not in findings(log, "--config", str(drafted))


def test_init_asks_for_a_look_where_no_key_could_take_it_off(tmp_path: Path) -> None:
    log = write_mcap(tmp_path / "dive.mcap", [faster(row, 0.001) for row in curved_dive()])

    assert "CHECK: velocities are 0.001 times those between fixes" in drafted_for(log).read_text()


@pytest.mark.long
def test_a_csv_folder_of_knots_is_told_the_scale(tmp_path: Path) -> None:
    """Of a column forward_mps the unit is settled: stating another would change nothing."""
    folder = csv_dive(tmp_path / "dive", [faster(row, 1.944) for row in in_radians(curved_dive(), 180 / np.pi)])

    drafted = drafted_for(folder)

    stated = tomllib.loads(drafted.read_text())["dvl"]["scale_error"]
    assert f"state scale_error = {stated} under [dvl]" in findings(folder)["DVL-UNIT"]["text"]
    assert stated == pytest.approx(0.944, abs=0.02)
    assert {"DVL-UNIT", "KEY-UNUSED", "UNUSABLE"}.isdisjoint(findings(folder, "--config", str(drafted)))


@pytest.mark.parametrize(("times", "unit"), [(3.41, "ft/s"), (3.425, "ft/s"), (3.47, "km/h")])
def test_of_two_units_that_are_near_the_nearest_is_named(tmp_path: Path, times: float, unit: str) -> None:
    log = read_log(write_mcap(tmp_path / "dive.mcap", curved_dive()))

    assert unit_or_scale_key(log, times) == ("unit", f'"{unit}"')


def drafted_for(log: Path) -> Path:
    drafted = log.parent / "drafted.toml"
    run("init", log, "--output", drafted)
    return drafted


@pytest.mark.long
def test_fixes_that_stay_where_they_are_tell_no_unit(tmp_path: Path) -> None:
    """They move by their noise alone, which no velocity explains, however small."""
    rng = np.random.default_rng(2)
    rows = [point(row[0], *rng.normal(0, 0.3, 2)) if row[1] == "/usbl" else row for row in curved_dive()]

    assert "DVL-UNIT" not in findings(write_mcap(tmp_path / "dive.mcap", rows))


def faster(row: Row, times: float) -> Row:
    if row[1] != "/dvl":
        return row
    return (*row[:3], {key: times * value if key.startswith("twist") else value for key, value in row[3].items()})


def changed(topic: str, **values: float) -> Callable[[Row], Row]:
    """Set fields of a topic's messages; "__" in a name is a dot."""
    fields = {name.replace("__", "."): value for name, value in values.items()}
    return lambda row: (*row[:3], dict(row[3]) | fields) if row[1] == topic else row


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    "change",
    [
        changed("/dvl", twist__linear__x=1e-12, twist__linear__y=0.0),
        changed("/dvl", twist__linear__x=1.0, twist__linear__y=0.0),
        changed("/dvl", twist__linear__x=np.nan),
        changed("/imu", orientation__z=0.0, orientation__w=1.0),
        changed("/imu", linear_acceleration__z=np.nan),
        changed("/usbl", point__x=3.0, point__y=4.0),
        changed("/usbl", point__x=np.nan),
        changed("/usbl", point__x=1e12),
    ],
)
@pytest.mark.long
def test_senseless_sensors_end_in_findings_and_nothing_else(tmp_path: Path, change: Callable[[Row], Row]) -> None:
    log = write_mcap(tmp_path / "dive.mcap", [change(row) for row in curved_dive(gps=True)])

    found = findings(log)

    assert {"HEADING-CONVENTION", "MAP-FRAME", "DVL-AXES"}.isdisjoint(found)
    assert found


@pytest.mark.long
def test_a_scenario_is_examined_without_a_file() -> None:
    done = run("doctor", "paper")
    assert done.return_value == 0, done.output
    assert "0 errors" in done.output


def late(rows: list[Row], topic: str, by_s: float) -> list[Row]:
    """Return the dive with a topic's stamps on a clock that is ahead; log times stay."""
    field = "header.stamp"
    return [(*r[:3], dict(r[3]) | {field: r[3][field] + round(by_s * SECOND)}) if r[1] == topic else r for r in rows]


def replayed(log: Path, *options: str) -> str:
    """Return what replay says on stderr."""
    target = str(log.with_name("run"))
    return run("replay", log, "-f", "dr", "-q", "--force", "-o", target, *options).stderr


@pytest.mark.parametrize("ahead_s", [18.0, -18.0, 37.0])
@pytest.mark.long
def test_fixes_on_another_clock_are_no_turned_dvl(tmp_path: Path, ahead_s: float) -> None:
    """GPS time is 18 s ahead of UTC."""
    log = write_mcap(tmp_path / "dive.mcap", late(curved_dive(gps=True), "/usbl", ahead_s))
    cure = tmp_path / "cure.toml"
    cure.write_text(f"[usbl]\nlatency_s = {ahead_s}\n")

    ill, cured = findings(log), findings(log, "--config", str(cure))

    assert ill["CLOCK-OFFSET"]["worst"] == pytest.approx(ahead_s, abs=0.2)
    assert ("GPS time and UTC" in ill["CLOCK-OFFSET"]["text"]) == (abs(ahead_s) == 18.0)
    assert {"DVL-MOUNT", "USBL-LATENCY", "HEADING-CONVENTION", "MAP-FRAME"}.isdisjoint(ill)
    assert "CLOCK-OFFSET" in replayed(log)
    assert {"CLOCK-OFFSET", "DVL-MOUNT", "USBL-LATENCY"}.isdisjoint(cured)
    assert "CLOCK-OFFSET" not in replayed(log, "--config", str(cure))


@pytest.mark.parametrize(("topic", "section"), [("/dvl", "dvl"), ("/imu", "compass")])
@pytest.mark.parametrize("ahead_s", [18.0, -18.0])
@pytest.mark.long
def test_the_clock_that_no_driver_explains_is_the_wrong_one(
    tmp_path: Path, topic: str, section: str, ahead_s: float
) -> None:
    log = write_mcap(tmp_path / "dive.mcap", late(curved_dive(gps=True), topic, ahead_s))
    cure = tmp_path / "cure.toml"
    cure.write_text(f"[{section}]\nlatency_s = {ahead_s}\n")

    ill, cured = findings(log), findings(log, "--config", str(cure))

    assert ill["CLOCK-OFFSET"]["topic"] == topic
    assert f"state latency_s = {ahead_s:.2f} under [{section}]" in ill["CLOCK-OFFSET"]["text"]
    assert {"CLOCK-OFFSET", "DVL-MOUNT", "DVL-CLOCK"}.isdisjoint(cured)


@pytest.mark.parametrize(("first", "second", "sign"), [("x", "y", -1.0), ("y", "x", 1.0)])
def test_replay_warns_of_axes_that_are_reversed_or_exchanged(
    tmp_path: Path, first: str, second: str, sign: float
) -> None:
    rows = [
        (*r[:3], dict(r[3]) | {
            "twist.linear.x": sign * r[3][f"twist.linear.{first}"],
            "twist.linear.y": sign * r[3][f"twist.linear.{second}"],
        }) if r[1] == "/dvl" else r
        for r in curved_dive(gps=True)
    ]  # fmt: skip
    log = write_mcap(tmp_path / "dive.mcap", rows)
    cure = tmp_path / "cure.toml"
    cure.write_text("[dvl]\nmount_deg = 180.0\n" if first == "x" else '[dvl]\naxes = "FRD"\nmount_deg = -90.0\n')

    said, cured = replayed(log), replayed(log, "--config", str(cure))

    assert "[DVL-MOUNT]" in said
    assert ("[DVL-AXES]" in said) == (first == "y")
    assert "[DVL-" not in cured


@pytest.mark.long
def test_a_transponder_ahead_is_a_lever_arm_and_no_latency_until_it_is_stated(tmp_path: Path) -> None:
    rows = curved_dive(gps=True)
    yaws = [(r[0], 2 * np.arctan2(r[3]["orientation.z"], r[3]["orientation.w"])) for r in rows if r[1] == "/imu"]
    stamps, angles = np.array([t for t, _ in yaws]), np.unwrap([angle for _, angle in yaws])
    ahead: list[Row] = []
    for row in rows:
        if row[1] == "/usbl":
            angle = np.interp(row[3]["header.stamp"], stamps, angles)  # counter-clockwise from east: forward
            moved = {"point.x": row[3]["point.x"] + 3 * np.cos(angle), "point.y": row[3]["point.y"] + 3 * np.sin(angle)}
            row = (*row[:3], dict(row[3]) | moved)
        ahead.append(row)
    log = write_mcap(tmp_path / "dive.mcap", ahead)
    cure = tmp_path / "cure.toml"
    cure.write_text("[usbl]\nlever_arm_m = [0.0, 3.0, 0.0]\n")

    ill, cured = findings(log), findings(log, "--config", str(cure))

    run("init", log)

    assert ill["DVL-LEVER"]["worst"] == pytest.approx(3.0, abs=0.3)
    proposed = re.search(r"^# lever_arm_m = (\[.*\])", (tmp_path / "dive.usbldr.toml").read_text(), re.MULTILINE)
    assert proposed
    assert json.loads(proposed[1]) == pytest.approx([0.0, -3.0, 0.0], abs=0.3)  # DVL minus transponder
    sensor_errors = {"USBL-LATENCY", "DVL-LEVER", "DVL-CLOCK", "DVL-SCALE", "LEVER-OR-LATENCY", "RIVAL-EXPLANATIONS"}
    assert set(ill) & sensor_errors == {"DVL-LEVER"}
    assert not set(cured) & sensor_errors


def test_a_magnetic_heading_is_found_as_a_turn_that_the_declination_takes_off(tmp_path: Path) -> None:
    """At 12 degrees of declination, east positive, a magnetic compass reads 12 degrees less."""
    rows = [(*r[:2], *yaw_turned(r, 12.0)) if r[1] == "/imu" else r for r in curved_dive(gps=True)]
    log = write_mcap(tmp_path / "dive.mcap", rows)
    cure = tmp_path / "cure.toml"
    cure.write_text("[compass]\ndeclination_deg = 12.0\n")

    assert findings(log)["DVL-MOUNT"]["worst"] == pytest.approx(12.0, abs=1.0)
    assert "HEADING-CHECKED" in findings(log, "--config", str(cure))


def yaw_turned(row: Row, by_deg: float) -> tuple[str, Mapping[str, Any]]:
    """Return type and values of an Imu that is turned counter-clockwise."""
    angle = np.degrees(2 * np.arctan2(row[3]["orientation.z"], row[3]["orientation.w"]))
    turned = yaw(row[0], float(angle) + by_deg)
    return turned[2], turned[3]


def test_settings_are_parsed_once_and_messages_decoded_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    log = write_mcap(tmp_path / "dive.mcap", curved_dive(dvl="FRD", gps=True))
    (tmp_path / "usbldr.toml").write_text("[dvl]\nmount_deg = 30.0\n", encoding="utf-8")
    parse, decode, calls = tomllib.loads, McapLog.blocks, Counter[str]()

    def counted_parse(text: str) -> dict[str, Any]:
        calls["parse"] += "mount_deg" in text
        return parse(text)

    def counted_decode(self: McapLog, wanted: Mapping[str, Sequence[str]]) -> Iterator[tuple[str, Records]]:
        calls["decode"] += 1
        return decode(self, wanted)

    monkeypatch.setattr(tomllib, "loads", counted_parse)
    monkeypatch.setattr(McapLog, "blocks", counted_decode)

    assert "DVL-AXES" in findings(log)

    assert calls == {"parse": 1, "decode": 1}
