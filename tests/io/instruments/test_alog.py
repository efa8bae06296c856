"""Logs of MOOS as pLogger writes them: applications are topics, and their numbers are fields."""

from pathlib import Path

import numpy as np

from logs import losses, read_as
from moos_recordings import COUNT, HEAD, line, write_alog
from recordings import SECOND, T0, saved
from usbldr.io.decoding.collected import read_whole
from usbldr.io.doctor.draft import draft
from usbldr.io.formats.detect import open_reader
from usbldr.io.instruments.alog_log import alog_log
from usbldr.io.reading.opening import Request

COLUMNS = """
[dvl]
columns = { x = "DVL_VEL_X", y = "DVL_VEL_Y" }
axes = "FSU"
[compass]
columns = { heading = "COMPASS_HEADING" }
[gps]
columns = { lat_deg = "GPS_LATITUDE", lon_deg = "GPS_LONGITUDE" }
"""


def test_what_an_application_posts_together_is_a_record(tmp_path: Path) -> None:
    log = read_as(write_alog(tmp_path / "a.alog"), COLUMNS)

    assert log.format == "MOOS log"
    assert log.start_ns == T0 + SECOND // 4
    np.testing.assert_array_equal(log.tables["dvl"]["forward_mps"], 1 + np.arange(COUNT) / 64)
    np.testing.assert_array_equal(log.tables["dvl"]["starboard_mps"], 0.25)
    np.testing.assert_array_equal(log.tables["dvl"]["time_s"], np.arange(COUNT))
    np.testing.assert_allclose(log.tables["gps"]["time_s"], np.arange(COUNT) - 0.2, rtol=0, atol=1e-9)
    np.testing.assert_array_equal(log.tables["compass"]["heading_deg"], np.arange(COUNT) / 4)
    np.testing.assert_allclose(log.tables["gps"]["lat_deg"], 60 + np.arange(COUNT) * 1e-6, rtol=0, atol=1e-12)
    assert not any(finding.lost_data for finding in log.findings)


def test_topics_are_applications_and_fields_their_numbers_which_are_proposed_by_usual_names(tmp_path: Path) -> None:
    topics = {topic.name: topic for topic in open_reader(write_alog(tmp_path / "a.alog")).topics()}

    assert topics.keys() == {"/iCompass", "/iDVL", "/gGPS"}
    assert topics["/iDVL"].fields == ("DVL_VEL_Y", "DVL_VEL_X", "DVL_TEMPERATURE")
    assert topics["/iDVL"].count == COUNT
    assert topics["/iDVL"].type == "moos/iDVL"

    found = draft(write_alog(tmp_path / "a.alog"), Request()).proposals

    assert {role: dict(one.columns) for role, one in found.items()} == {
        "dvl": {"x": "DVL_VEL_X", "y": "DVL_VEL_Y"},
        "compass": {"heading": "COMPASS_HEADING"},
        "gps": {"lat_deg": "GPS_LATITUDE", "lon_deg": "GPS_LONGITUDE"},
    }


def test_types_may_be_marked_and_times_may_count_from_1970(tmp_path: Path) -> None:
    texts = ["D:1.5", "S:2.5", "TRUE", "D:3.5"]
    rows = "".join(line(T0 / SECOND + k, "V", "app", text) for k, text in enumerate(texts))
    file = saved(tmp_path / "a.alog", f"%% LOGSTART {T0 // SECOND}.00\n%% DATATYPE MARKING ON\n{rows}")
    records = read_whole(open_reader(file), {"/app": ["V"]})["/app"]

    assert records.columns["V"].tolist() == [1.5, 2.5, 1.0, 3.5]
    assert (records.received_ns - T0).tolist() == [k * SECOND for k in range(4)]


def test_a_text_of_names_and_values_has_fields(tmp_path: Path) -> None:
    """The report is that of pNodeReporter's documentation; of a name that comes twice the first counts."""
    numbers = "UTC_TIME=1252348077.59,X=51.71,Y=-35.50,LAT=43.824981,LON=-70.329755,SPD=2.00,"
    numbers += "HDG=118.85,YAW=118.84754,DEP=4.63,LENGTH=3.8"
    report = f"NAME=alpha,TYPE=UUV,{numbers},MODE=MODE@ACTIVE:LOITERING"
    texts = [("NODE_REPORT_LOCAL", report), ("USBL_FIX", "S:who=7, x = 1.5 ,y=-2,ok=true,x=9"), ("USBL_FIX", "x=2.5")]
    texts += [("POLYGON", "pts={0,0:10,20},label=one,edge=3"), ("EMPTY", "a=,=5,b,c==1,1=2,-d=3")]
    log = open_reader(
        saved(tmp_path / "a.alog", HEAD, *(line(k, name, "app", value) for k, (name, value) in enumerate(texts)))
    )

    (topic,) = log.topics()
    records = read_whole(log, {"/app": topic.fields})["/app"].columns

    pairs = (number.split("=") for number in numbers.split(","))
    expected = {f"NODE_REPORT_LOCAL.{name}": float(value) for name, value in pairs}
    assert {path: column[0] for path, column in records.items() if path.startswith("NODE")} == expected
    others = {path: column[1:] for path, column in records.items() if not path.startswith("NODE")}
    nan = np.nan
    expected = {"x": [1.5, 2.5, nan], "y": [-2.0, nan, nan], "ok": [1.0, nan, nan], "who": [7.0, nan, nan]}
    assert others.keys() == {"POLYGON.edge", *(f"USBL_FIX.{name}" for name in expected)}
    for name, values in expected.items():
        np.testing.assert_array_equal(others[f"USBL_FIX.{name}"], values)
    np.testing.assert_array_equal(others["POLYGON.edge"], [nan, nan, 3.0])


def test_values_that_are_missing_do_not_move_to_the_next_reading(tmp_path: Path) -> None:
    """Of five readings the second lacks Y, the third X; the others are 5 ms apart: no record has values of two."""
    rows = [(0.0, "X", 1), (0.001, "Y", 2), (0.1, "X", 3), (0.2, "Y", 4)]
    rows += [(0.3, "X", 5), (0.3, "Y", 6), (0.305, "X", 7), (0.305, "Y", 8)]
    file = saved(tmp_path / "a.alog", HEAD, *(line(time_s, name, "app", value) for time_s, name, value in rows))

    columns = read_whole(open_reader(file), {"/app": ["X", "Y"]})["/app"].columns

    np.testing.assert_array_equal(columns["X"], [1, 3, np.nan, 5, 7])
    np.testing.assert_array_equal(columns["Y"], [2, np.nan, 4, 6, 8])


def test_a_moos_log_cut_within_its_header_says_so(tmp_path: Path) -> None:
    log = alog_log(saved(tmp_path / "a.alog", HEAD[:-5]))

    assert log.topics() == ()
    assert any(finding.lost_data for finding in log.findings())


def test_lines_that_are_no_postings_are_counted(tmp_path: Path) -> None:
    log = open_reader(
        saved(tmp_path / "a.alog", HEAD, line(0, "X", "app", 1.5), "a text\nof two lines\n", line(1, "X", "app", 2.5))
    )

    assert read_whole(log, {"/app": ["X"]})["/app"].columns["X"].tolist() == [1.5, 2.5]
    assert losses(log.findings()) == {
        "a.alog: 2 lines have no time, variable and source, the first is line 6; left out": True
    }


def test_a_damaged_number_costs_one_value(tmp_path: Path) -> None:
    whole, value = write_alog(tmp_path / "a.alog").read_text(), "iDVL:driver     1.500000"
    text = whole.replace(value, value.replace(".", "x"), 1)
    assert text != whole
    log = open_reader(saved(tmp_path / "a.alog", text))

    values = read_whole(log, {"/iDVL": ["DVL_VEL_X"]})["/iDVL"].columns["DVL_VEL_X"]
    assert values.tolist() == [1 + k / 64 for k in range(COUNT) if k != 32]
    assert losses(log.findings()) == {"/iDVL: 1 values of DVL_VEL_X are no numbers; left out": True}


def test_a_variable_of_texts_that_seldom_is_a_number_is_no_number(tmp_path: Path) -> None:
    rows = [line(k, "MODE", "app", "1" if k == 3 else "survey") + line(k, "X", "app", k) for k in range(9)]

    assert open_reader(saved(tmp_path / "a.alog", HEAD, *rows)).topics()[0].fields == ("X",)
