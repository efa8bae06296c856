"""Fields of any sentence, line or object by name, and layout files that define them."""

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import logs
from logs import MAP, codes, counts, logged_nmea
from recordings import SECOND, T0, saved, saved_lines, sentence
from usbldr.filters.errors import UsageError
from usbldr.io.decoding.collected import read_whole
from usbldr.io.decoding.nmea_lines import WORD_LINE
from usbldr.io.decoding.nmea_sentences import find_sentences
from usbldr.io.formats.detect import open_reader
from usbldr.io.reader import TIME_OF_DAY
from usbldr.io.reading.inputs import input_files
from usbldr.io.reading.read import Request

# the example of Water Linked's serial protocol, and that of Nortek's manual
RECORDED_GGA = "$GPGGA,075617.34,7002.968962,N,02938.350607,E,2,12,0.6,-0.52,M,20.34,M,7.0,0907*6F"
WRZ = "wrz,0.120,-0.400,2.000,y,1.30,1.855,1e-07;0;1.4;0;1.2;0;0.2;0;1e+09,7,14,123.00,1*50"
PNORBT7 = "$PNORBT7,1452244916.7508,1.234,-1.234,0.1234,0.1234,0.1234,12.34,23.45,23.45,23.45,23.45*39"
HEAD = "head = { lat_deg = 45.0, lon_deg = 7.0 }\n"


@given(
    cells=st.lists(st.floats(-1e6, 1e6) | st.integers(-(10**12), 10**12) | st.just(""), min_size=1, max_size=12),
    name=st.sampled_from(["PACME", "GPXYZ", "PIXSE"]),
)
def test_every_field_of_any_sentence_has_its_number(cells: list, name: str) -> None:
    body = ",".join([name, *map(str, cells)])
    found = find_sentences("a", [f"1600000000 {sentence(body)}"]).by_name[name]
    names = [str(k) for k in range(1, len(cells) + 1)]

    records, undecoded = found.records(names)

    assert undecoded == 0
    assert [one for one in found.info(name).fields if not one.endswith(TIME_OF_DAY)] == names
    for number, cell in zip(names, cells, strict=True):
        (value,) = records.columns[number].tolist()
        assert value == cell or (cell == "" and np.isnan(value))


@pytest.mark.parametrize(
    ("line", "section", "columns", "wanted"),
    [
        (sentence("PACME,1.5,0.25"), "dvl", 'x = "1", y = "2"', {"dvl.forward_mps": [1.5]}),
        (sentence("PACME,VX=1500,VY=250"), "dvl", 'x = "VX [mm/s]", y = "VY [mm/s]"', {"dvl.forward_mps": [1.5]}),
        (sentence("PUHAW,UVH,1.5,0.25,90.0"), "dvl", 'x = "2", y = "3"', {"dvl.forward_mps": [1.5]}),
        (WRZ, "dvl", 'x = "1", y = "2", valid = "4"', {"dvl.forward_mps": [0.12]}),
        ('{"speed": {"fwd": 1.5}, "v": [9, 0.25]}', "dvl", 'x = "speed.fwd", y = "v[1]"', {"dvl.forward_mps": [1.5]}),
        (sentence("PACME,3215.0,S,06445.0,W"), "gps", 'lat_deg = "1", lat_side = "2", lon_deg = "3", lon_side = "4"',
         {"gps.lat_deg": [-32.25], "gps.lon_deg": [-64.75]}),
    ],
)  # fmt: skip
def test_columns_name_any_field(tmp_path, line, section, columns, wanted):
    log = logged_nmea(tmp_path, f"1600000000 {line}", toml=f"[{section}]\ncolumns = {{ {columns} }}\n")

    assert logs.columns(log, wanted) == {name: pytest.approx(values) for name, values in wanted.items()}


def test_a_type_in_the_first_field_makes_a_topic(tmp_path: Path) -> None:
    lines = [sentence("PIXSE,ATITUD,-1.641,-0.490"), sentence("PIXSE,POSITI,60.1,10.2,3.0")]
    log = open_reader(saved_lines(tmp_path / "a.txt", lines))

    assert [topic.name for topic in log.topics()] == ["/PIXSE_ATITUD", "/PIXSE_POSITI"]


STAMPED = WRZ.replace(",7,14,", f",{T0 // 1000},{T0 // 1000 + 100},").partition("*")[0]
INVALID = STAMPED.replace(",y,", ",n,").replace(str(T0 // 1000), str(T0 // 1000 + 200_000), 1)
USBLLONG = "USBLLONG,1600000001.0,1600000000.5,2,1,2,3,30.0,40.0,-5.0,0.0,0.0,1.57,20000,-30,200,0.25"


@pytest.mark.parametrize(
    ("lines", "toml", "start_ns", "wanted"),
    [
        ([f"1600000000.1 {STAMPED}", f"1600000000.3 {INVALID}"], "", T0,
         {"dvl.forward_mps": [0.12] * 2, "dvl.starboard_mps": [-0.4] * 2, "dvl.up_mps": [-2] * 2,
          "dvl.valid": [True, False]}),
        ([f"1600000001 {USBLLONG}"], f"{MAP}[usbl]\n{HEAD}", T0 + SECOND // 2,
         {"usbl.east_m": pytest.approx([30]), "usbl.north_m": pytest.approx([40]),
          "usbl.cov_ee_m2": pytest.approx([0.25**2], rel=1e-3)}),
        ([PNORBT7], "", pytest.approx(1_452_244_916_750_800_000, abs=1000), {"dvl.forward_mps": [0.1234]}),
    ],
    ids=["Water Linked's serial protocol", "a fix of EvoLogics from the head", "Nortek's example"],
)  # fmt: skip
def test_a_line_of_an_instrument_is_its_record(tmp_path, lines, toml, start_ns, wanted):
    log = logged_nmea(tmp_path, *lines, toml=toml)

    assert logs.columns(log, wanted) == wanted
    assert log.start_ns == start_ns
    assert ("water_linked_dvl.toml (usbldr, sha256 " in codes(log)["LAYOUT-FILE"]) == ("wrz" in lines[0])


LAYOUT = '[[layout]]\nsensor = "dvl"\nsentence = "PNORBT7"\ncolumns = { x = "5", y = "4", z = "6" }\naxes = "SFU"\n'


def test_a_layout_file_of_the_configuration_comes_first(tmp_path: Path) -> None:
    (tmp_path / "more").mkdir()
    (tmp_path / "more" / "acme.toml").write_text(LAYOUT, encoding="utf-8")
    toml = 'layouts = ["more/acme.toml"]\n'

    line = PNORBT7.replace("0.1234,0.1234", "0.5,0.25", 1).partition("*")[0]

    log = logged_nmea(tmp_path, f"1600000000 {line}", toml=toml)

    assert log.tables["dvl"][["starboard_mps", "forward_mps"]].to_numpy().tolist() == [[0.25, 0.5]]
    assert "acme.toml (configuration, sha256 " in codes(log)["LAYOUT-FILE"]
    assert ("layout", "acme.toml") in [(one.role, one.path.name) for one in input_files(log.path, Request())]


def test_the_users_folder_counts_and_the_logs_does_not(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    place = tmp_path / "config" / "usbldr" / "layouts"
    place.mkdir(parents=True)
    (tmp_path / "layouts").mkdir()
    for folder in (tmp_path, tmp_path / "layouts"):
        saved(folder / "acme.toml", LAYOUT)
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    monkeypatch.chdir(tmp_path)

    beside = logged_nmea(tmp_path, PNORBT7)
    (place / "acme.toml").write_text(LAYOUT, encoding="utf-8")
    own = logged_nmea(tmp_path, PNORBT7)

    assert "nortek_dvl.toml (usbldr" in codes(beside)["LAYOUT-FILE"]
    assert "acme.toml (user folder" in codes(own)["LAYOUT-FILE"]


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("[[layout]]\nsensor = 'dvl'\ncolumns = { x = '1' }", "state either type or sentence"),
        (
            "[[layout]]\nsensor = 'sonar'\ntype = 'a'\ncolumns = { x = '1' }",
            r"sensor: sonar is not allowed \(allowed: dvl, ",
        ),
        ("[[layout]]\nsensor = 'dvl'\ntype = 'a'\ncolumns = { x = '1' }\nexec = 'rm'", "has no key exec"),
    ],
)
def test_a_layout_file_that_says_anything_else_is_refused(tmp_path: Path, text: str, fault: str) -> None:
    saved(tmp_path / "acme.toml", text)

    with pytest.raises(UsageError, match=f"acme.toml.*{fault}"):
        logged_nmea(tmp_path, PNORBT7, toml='layouts = ["acme.toml"]\n')


def test_a_layout_file_that_names_a_field_which_is_not_there_is_reported(tmp_path: Path) -> None:
    saved(tmp_path / "acme.toml", '[[layout]]\nsensor = "dvl"\nsentence = "PACME"\ncolumns = { x = "1", y = "9" }\n')
    lines = [f"{1600000000 + k} {sentence(f'PACME,{k},2')}" for k in range(3)]
    log = logged_nmea(tmp_path, *lines, sentence("HEHDT,1.0,T"), toml='layouts = ["acme.toml"]\n')

    assert logs.only(log, "LAYOUT-FILE") == "/PACME: not read as dvl by the layout file acme.toml: it has no 9"


def test_the_field_of_an_object_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    lines = [json.dumps({"ts": T0 // SECOND + k, "pose": {"e": "off" if k == 5 else k, "n": 2}}) for k in range(9)]
    toml = '[usbl]\ncolumns = { time_unix_s = "ts", x = "pose.e", y = "pose.n" }\n'
    log = logs.read_as(saved_lines(tmp_path / "a.jsonl", lines), toml)

    (text,) = logs.lost(log)
    assert text.endswith("do not match their definition in the file; the first has no such pose.e")


@pytest.mark.parametrize("each", [1, 4])
def test_lines_of_a_dvl_are_read_beside_sentences_with_an_address(tmp_path: Path, each: int) -> None:
    lines = [f"{1600000000 + k} {one}" for k in range(9) for one in (*[WRZ] * each, "$HCHDT,35.06,T*29", RECORDED_GGA)]
    lines += [f"1600000010 {WRZ.replace('0.120', '0.121')}", "1600000011 HCHDT,35.06,T*29"]
    log = open_reader(saved(tmp_path / "a.log", "\n".join(lines) + "\n"))

    by_words = each > 1  # then an address without its $ is a word, and its checksum is right
    counts = {"/wrz": 9 * each, "/HCHDT": 9 + by_words, "/GPGGA": 9}
    assert {topic.name: topic.count for topic in log.topics()} == counts
    assert f": {2 - by_words} of " in next(found.text for found in log.findings() if found.code == "NMEA-CHECKSUM")


def test_lines_of_instruments_without_a_checksum_are_read_beside_sentences(tmp_path: Path) -> None:
    """Not what is left of an address, nor words."""
    some = [USBLLONG, WRZ.partition("*")[0], *[RECORDED_GGA] * 5, "PGGA,075617.34,7002.9,N", "started, version 2,x"]
    log = open_reader(saved_lines(tmp_path / "a.log", (f"{1600000000 + k} {one}" for k in range(9) for one in some)))

    assert counts(log) == {"/USBLLONG": 9, "/wrz": 9, "/GPGGA": 45}
    assert "a.log: 18 lines hold no NMEA sentence" in [one.text for one in log.findings()]


@pytest.mark.parametrize("count", ["", "7:", "+++AT:95:", "192.168.0.207:9200: "])
@pytest.mark.parametrize(
    "clock", ["", "{0:.3f} ", "{0:.3f},", "{0:.3f}: ", "2020-09-13T12:26:{1:06.3f}Z,", "[12:26:{1:06.3f}] "]
)
def test_a_count_of_bytes_or_a_time_before_a_word_changes_nothing(tmp_path: Path, clock: str, count: str) -> None:
    dated = clock.startswith(("{", "2"))
    times = [1600000001.25 + k for k in range(9)]
    fixes = [USBLLONG if dated else USBLLONG.replace("1600000001.0", str(time)) for time in times]
    begins = [clock.format(time, time - 1599999960) for time in times]
    log = open_reader(saved_lines(tmp_path / "a.log", map("{}{}{}".format, begins, [count] * 9, fixes)))

    read = read_whole(log, {"/USBLLONG": ["2", "7"]})["/USBLLONG"]
    assert read.columns["7"].tolist() == [30] * 9
    assert (read.received_ns - T0 - np.arange(9) * SECOND).tolist() == [5 * SECOND // 4] * 9
    assert counts(log) == {"/USBLLONG": 9}


def test_a_header_of_words_is_a_csv_file(tmp_path: Path) -> None:
    assert open_reader(saved(tmp_path / "a.csv", "sensor,time_s,x\ndvl,1,2\ndvl,2,3\n")).format == "CSV file"


def test_any_object_is_a_topic_by_its_type(tmp_path: Path) -> None:
    rows = [{"type": "nav", "t": k, "a": {"b": k}} if k % 2 else {"u": k} for k in range(6)]
    file = saved_lines(tmp_path / "a.jsonl", (f"160000000{k} {json.dumps(row)}" for k, row in enumerate(rows)))

    topics = {topic.name: topic for topic in open_reader(file).topics()}

    assert {name: topic.count for name, topic in topics.items()} == {"/object": 3, "/nav": 3}
    assert topics["/nav"].has("a.b")


@pytest.mark.parametrize(
    ("name", "of", "said"),
    [
        ("time", lambda k: f"2020-09-13T12:26:4{k}.5Z", []),
        ("timestamp", lambda k: 1600000000.5 + k, []),
        ("t_ms", lambda k: 1600000000500 + 1000 * k, []),
        ("time_ns", lambda k: 1600000000500000000 + 10**9 * k, []),
        ("y", lambda k: k, ["a.jsonl: 5 objects have no time that is known; they are taken as 1 s apart"]),
    ],
)
def test_an_object_may_hold_its_time_and_else_objects_are_a_second_apart(tmp_path, name, of, said):
    rows = [{"type": "nav", "x": 1600000001.0, "truth_time": 5, name: of(k)} for k in range(5)]
    log = open_reader(saved_lines(tmp_path / "a.jsonl", map(json.dumps, rows)))

    read = read_whole(log, {"/nav": ["x"]})["/nav"]
    assert np.diff(read.received_ns).tolist() == [10**9] * 4
    assert said or read.received_ns[0] == 1600000000500000000
    assert [finding.text for finding in log.findings()] == said


def test_the_word_that_a_line_begins_with_is_not_part_of_a_number() -> None:
    assert WORD_LINE.search("1600000000.5 wrz,1,2") is not None
    assert WORD_LINE.search("2020-09-13T12:26:40Z USBLLONG,1,2") is not None
    assert WORD_LINE.search("1.0e5,2,3") is None
    assert WORD_LINE.search("1.5,2.5,ABC,3") is None
    assert WORD_LINE.search("1600000000.5,usbl,1,2") is None  # a row of a table
