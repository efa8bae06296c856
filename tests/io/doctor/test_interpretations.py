"""Conventions are judged by what the messages say, and not by fixes that no interpretation fits."""

import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from commands import findings
from curved import CONVENTIONS, FLIPPED, changed, curved_dive, written
from logs import with_table
from recordings import HEADER, SECOND, T0, Row, define, fields
from usbldr.io.doctor import cross_check, interpretations
from usbldr.io.doctor.cross_check import convention_warnings
from usbldr.io.doctor.thresholds import THRESHOLDS
from usbldr.io.log import Log
from usbldr.io.reading.epochs import timeline
from usbldr.io.reading.read import Request, read_log


def through_the_water(log: Log, from_s: float, to_s: float, east_mps: float, north_mps: float) -> Log:
    """Return the log with a DVL that saw the water for a while, in a current."""
    table, compass = log.tables["dvl"], log.tables["compass"]
    time_s = table["time_s"].to_numpy()
    heading = np.radians(np.interp(time_s, compass["time_s"], np.unwrap(compass["heading_deg"], period=360.0)))
    there = (time_s >= from_s) & (time_s < to_s)
    forward_mps = there * (east_mps * np.sin(heading) + north_mps * np.cos(heading))
    starboard_mps = there * (east_mps * np.cos(heading) - north_mps * np.sin(heading))
    seen = {"forward_mps": table["forward_mps"] - forward_mps, "starboard_mps": table["starboard_mps"] - starboard_mps}
    return with_table(log, "dvl", table.assign(**seen))


@pytest.mark.parametrize(
    ("imu", "to_s", "current_mps", "named"),
    [
        *(("ENU", 200.0, (east, north), set[str]()) for east in (-0.6, 0.6) for north in (-0.6, 0.6)),
        ("ENU", 130.0, (0.2, 0.1), set[str]()),
        ("NED", 130.0, (0.2, 0.1), {"HEADING-CONVENTION"}),
    ],
)
def test_an_unmodelled_current_is_no_wrong_axis_and_hides_no_wrong_heading(tmp_path, imu, to_s, current_mps, named):
    log = read_log(written(tmp_path, curved_dive(imu=imu, gps=True)), Request("none"))
    log = through_the_water(log, 100.0, to_s, *current_mps)

    assert {one.code for one in convention_warnings(log, timeline(log))} & FLIPPED == named


def test_the_white_noise_of_fixes_is_that_of_an_axis_without_outliers(tmp_path: Path) -> None:
    log = read_log(written(tmp_path, curved_dive(gross=(20, 21, 90, 160))), Request("none"))

    assert interpretations.white_noise_m(timeline(log)) == pytest.approx(0.3, rel=0.1)


@pytest.mark.parametrize("by_as_read", [True, False])
@pytest.mark.parametrize("others_m", [None, 0.01], ids=["as usual", "the other one fits far better"])
def test_a_log_as_read_is_preferred_if_its_sensor_errors_explain_more_than_another(tmp_path, by_as_read, others_m):
    log = read_log(written(tmp_path, curved_dive(imu="ENU", gps=True)), Request("none"))
    log = through_the_water(log, 100.0, 200.0, 0.3, -0.2)
    line = timeline(log)
    result = interpretations.compare_interpretations(log, line)
    assert result is not None
    other = next(one for one in result.interpretations if one.mirror_class != result.as_read.mirror_class)
    if others_m is not None:  # as on a circle, where a current looks like a mirrored axis
        other = replace(other, fit=replace(other.fit, rms_m=others_m))
    wrong = replace(result, best=other, plausible=(other,))
    by = wrong.as_read if by_as_read else other
    found = cross_check._identified(log, cross_check.flipped(log, line, by.flips), wrong)

    assert found is not None
    judged, there = cross_check._by_evidence(log, line, wrong, by, found)

    assert (there.conclude() is found) == by_as_read
    assert judged.best.flips == result.as_read.flips
    assert [one.flips for one in judged.plausible] == [judged.best.flips]


def seen_from_the_vehicle(rows: list[Row], beacon_m: complex) -> list[Row]:
    """Return a dive with a heading clockwise from north whose fixes are a beacon's place ahead and to starboard."""
    imu = {ns: values for ns, topic, _, values in rows if topic == "/imu"}

    def seen(values: Mapping[str, Any]) -> dict[str, Any]:
        at_fix = imu[values["header.stamp"]]
        apart_m = beacon_m - complex(values["point.x"], values["point.y"])  # east + i north
        apart_m *= complex(at_fix["orientation.w"], at_fix["orientation.z"]) ** 2  # starboard + i forward
        return dict(values) | {"point.x": apart_m.imag, "point.y": apart_m.real}

    return [(*row[:3], seen(row[3])) if "point.x" in row[3] else row for row in rows]


def test_a_heading_that_turns_the_fixes_of_a_beacon_is_judged_with_them(tmp_path: Path) -> None:
    rows = seen_from_the_vehicle(curved_dive(imu="NED"), 60.0 - 40.0j)
    beacon = '[usbl]\nframe = "body"\naxes = "FRD"\nbeacon = { east_m = 60.0, north_m = -40.0 }\n'

    found = findings(written(tmp_path, rows, beacon))
    cured = findings(written(tmp_path, rows, f'{beacon}[compass]\nconvention = "NED"\n'))

    assert 'state convention = "NED" under [compass]' in found["HEADING-CONVENTION"]["text"]
    assert {"USBL-MOTION", "DVL-AXES"}.isdisjoint(found)
    assert {*cured}.isdisjoint(CONVENTIONS)


def deviated(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return an Imu beside iron: 12 sin H + 6 cos H degrees at the heading H."""
    yaw_rad = 2 * np.arctan2(values["orientation.z"], values["orientation.w"])
    yaw_rad -= np.radians(12 * np.cos(yaw_rad) + 6 * np.sin(yaw_rad))  # sin H = cos yaw
    return dict(values) | {"orientation.z": np.sin(yaw_rad / 2), "orientation.w": np.cos(yaw_rad / 2)}


@pytest.mark.long
def test_interpretations_are_compared_with_the_deviation_that_each_needs(tmp_path, monkeypatch):
    rows = [(*row[:3], deviated(row[3])) if row[1] == "/imu" else row for row in curved_dive(dvl="FRD", seconds=200)]
    blind = replace(THRESHOLDS, clearly_better_ratio=0.01, gross_residual_ratio=0.01)  # residuals do not decide
    monkeypatch.setattr(interpretations, "THRESHOLDS", blind)

    found = findings(written(tmp_path, rows))

    assert "but FRD fits better; with the sensor errors that each needs" in found["DVL-AXES"]["text"]
    assert {"HEADING-CONVENTION", "MAP-FRAME", "CONVENTION-UNOBSERVABLE", "SENSOR-CHANGE"}.isdisjoint(found)
    assert re.search(r"\(1[12]\.\d ± 0\.\d\) sin H \+ \([56]\.\d ± 0\.\d\) cos H", found["COMPASS-DEVIATION"]["text"])


DEPTH_M, PLACE = 12.0, "position_easting position_northing position_depth"
TYPES = {
    "seatrac_of_doctor/msg/ModemRec": HEADER + fields("uint8 src_id", "bool includes_position", f"int16 {PLACE}"),
    "usbllong_of_doctor/msg/AcousticModemUSBLLONG": HEADER + fields("float32 E N D"),
    "riptide_of_doctor/msg/Depth": HEADER + "float32 depth\n",
}
define(TYPES)
SEATRAC, USBLLONG, DEPTH = TYPES
AT_ORIGIN = "[usbl]\nhead = { lat_deg = 45.0, lon_deg = 7.0 }\n"


def told_by(kind: str, row: Row) -> Row:
    """Return a fix of the dive as another type tells it, with its depth counted down."""
    e, n = row[3]["point.x"], row[3]["point.y"]
    values: dict[str, Any] = {"E": e, "N": n, "D": DEPTH_M}
    if kind == SEATRAC:
        raws = zip(("easting", "northing", "depth"), (e, n, DEPTH_M), strict=True)
        values = {"includes_position": True} | {f"position_{axis}": round(10 * value) for axis, value in raws}
    return row[0], row[1], kind, {"header.stamp": row[3]["header.stamp"], **values}


def deep(rows: list[Row]) -> list[Row]:
    times = range(T0, T0 + 300 * SECOND, SECOND)
    depths = [(ns, "/depth", DEPTH, {"header.stamp": ns, "depth": DEPTH_M}) for ns in times]
    return sorted([*rows, *depths], key=lambda row: row[0])


@pytest.mark.parametrize(
    ("kind", "dive", "named"),
    [
        (SEATRAC, {}, {}),
        (USBLLONG, {}, {}),
        (SEATRAC, {"dvl": "FRD", "imu": "NED"}, {"DVL-AXES": "ENU", "HEADING-CONVENTION": "ENU"}),
        (SEATRAC, {"gravity": -9.8}, {"CONVENTION-CONTRADICTED": "gravity"}),
    ],
)
def test_a_type_settles_the_map_and_no_depth_mirrored_sensor_or_gravity_undoes_it(tmp_path, kind, dive, named):
    rows = [told_by(kind, row) if row[1] == "/usbl" else row for row in curved_dive(**dive)]

    found = findings(written(tmp_path, deep(rows), AT_ORIGIN))

    assert set(found) & CONVENTIONS == set(named)
    assert all(words in found[code]["text"] for code, words in named.items())
    if "DVL-AXES" not in named:
        assert "excluded by: the fixes are ENU by their type" in found["CONVENTION-CHECKED"]["text"]


@pytest.mark.parametrize(
    ("values", "code", "words"),
    [
        ({"point__z": DEPTH_M}, "MAP-FRAME", "depth: the fixes have z"),
        ({"point__z": -DEPTH_M}, "CONVENTION-CHECKED", "depth: the fixes have z"),
        ({"header__frame_id": "combined_map"}, "CONVENTION-UNDECIDED", "nothing in the log decides"),
        ({"header__frame_id": "menu"}, "CONVENTION-UNDECIDED", "nothing in the log decides"),
        ({"header__frame_id": "worldEnu"}, "CONVENTION-CHECKED", 'excluded by: frame_id "worldEnu"'),
        ({"header__frame_id": "map_enu"}, "CONVENTION-CHECKED", 'excluded by: frame_id "map_enu"'),
    ],
)
def test_where_no_type_settles_the_frame_the_sign_of_depth_or_a_whole_word_of_its_name_does(
    tmp_path: Path, values: dict[str, Any], code: str, words: str
) -> None:
    rows = changed(curved_dive(), "/usbl", **values)

    found = findings(written(tmp_path, deep(rows) if "point__z" in values else rows))

    assert words in found[code]["text"]
    assert ("MAP-FRAME" in found) == (code == "MAP-FRAME")
