"""The canonical CSV folder: written by hand, read back, and broken in the ways people break it."""

from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from logs import MAP, logged_csv, lost, refusal
from recordings import T0, saved, write_csv
from usbldr.filters.errors import LogError
from usbldr.io.decoding.collected import read_whole
from usbldr.io.log import Log
from usbldr.io.reading.read import read_log
from usbldr.io.tables import csv_text
from usbldr.io.tables.csv_log import csv_log

WHEN = '[compass]\ncolumns = { time_unix_s = "when", heading = "hdg" }\n'
DVL = f"time_ns,received_ns,starboard_mps,forward_mps\n{T0},{T0 + 7},0.1,1.25\n{T0 + 2},{T0 + 5},,-1e-3"


def read_text(folder: Path, text: str, name: str = "compass") -> Log:
    return read_log(saved(folder / f"{name}.csv", text))


def test_a_stem_is_a_topic_and_its_columns_determine_the_type_and_keep_the_order_of_the_file(tmp_path: Path) -> None:
    others = {"events": "when,what\n12:00,launch", "depth": "time_ns,depth_m\n1,3.5"}
    folder = write_csv(tmp_path / "dive", dvl=DVL, nav__imu_heading="time_ns,heading_deg\n1,359.5", **others)
    (folder / "notes.md").write_text("a, b\n", encoding="utf-8")
    (folder / "usbldr.toml").write_text("# a, b\n", encoding="utf-8")

    log = csv_log(folder)
    topics = {topic.name: topic for topic in log.topics()}
    dvl = read_whole(log, {"/dvl": ["header.stamp", "starboard_mps", "forward_mps"]})["/dvl"]

    types = {"/depth": "usbldr/depth", "/dvl": "usbldr/dvl", "/events": "", "/nav/imu_heading": "usbldr/compass"}
    assert {name: topic.type for name, topic in topics.items()} == types
    assert (topics["/dvl"].count, topics["/dvl"].first_ns, topics["/dvl"].last_ns) == (2, T0 + 5, T0 + 7)
    assert topics["/events"].problem.startswith("its columns match no sensor (when, what); name them")
    np.testing.assert_array_equal(dvl.received_ns, [T0 + 7, T0 + 5])
    np.testing.assert_array_equal(dvl.columns["header.stamp"], [T0, T0 + 2])
    np.testing.assert_array_equal(dvl.columns["starboard_mps"], [0.1, np.nan])
    np.testing.assert_array_equal(dvl.columns["forward_mps"], [1.25, -1e-3])


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("dvl", "time_ns,starboard_mps,fwd\n1,2,3",
         "{folder}: /dvl cannot be read as dvl: dvl.csv has no column forward_mps (its columns: time_ns, "
         "starboard_mps, fwd); name them with the key columns of the sensor's section in usbldr.toml; usbldr init "
         "writes a draft"),
        ("compass", "time_ns,heading_deg\n1,south\n2,north", '{file}: line 2: heading_deg is "south", not a number'),
        ("compass", "time_ns,heading_deg,heading_deg\n1,2,3",
         "{file}: has two columns heading_deg (its columns: time_ns, heading_deg, heading_deg); rename one"),
        ("dvl", "1600000000,0.5,1.25\n1600000001,0.5,1.25",
         "{folder}: /dvl cannot be read as dvl: dvl.csv has no header: its first line holds values, so its "
         "columns are 1, 2, ...; name them with the key columns of the sensor's section in usbldr.toml; usbldr init "
         "writes a draft"),
    ],
)  # fmt: skip
def test_a_file_that_cannot_be_read_is_one_sentence(tmp_path: Path, name: str, text: str, said: str) -> None:
    folder = write_csv(tmp_path / "dive", **{name: text})
    file = folder / f"{name}.csv"

    expected = said.replace("{file}", str(file)).replace("{folder}", str(folder))
    assert refusal(LogError, read_log, folder if "{folder}" in said else file) == expected


NO_TIME = 'compass.csv: 1 of 3 rows are left out: line 4: time_ns is "{}", not a whole number of nanoseconds'
NO_END = "line 4, the last, has no line end and is left out: it may be cut; append a line end if it is whole"
INSERTED = "3 of 6 rows are left out: line 5: it has 4 cells, the first line 3; so are lines 6, 7"


@pytest.mark.parametrize(
    ("text", "left", "said"),
    [
        *((f"time_ns,heading_deg\n1,2\n\n{cell},4\n3,6\n", [2, 6], NO_TIME.format(cell[:60]))
          for cell in ("1.5e3", "", "9" * 20, "9" * 5000, "1_0")),
        ("time_ns,heading_deg\n1,2\n2,3\n3,44", [2, 3], f"compass.csv: {NO_END}"),
        # behind a column that was inserted, also if the last cell is blank
        ("time_ns,heading_deg,sd_deg\n1,0,1\n2,1,1\n3,2,1\n4,12.4,,\n5,12.4,4,\n6,12.4,5,1\n", [0, 1, 2],
         f"compass.csv: {INSERTED}"),
        ('time_ns,heading_deg,remark\n1,0.5,"lost\n2,1.5,\n3,2.5,lost"\n4,3.5,\n', [1.5, 3.5],
         "compass.csv: 2 of 4 rows are left out: line 2: a quotation mark is missing; so are lines 4"),
    ],
    ids=["exponent", "empty", "late", "endless", "underscore", "the last", "inserted", "quotation mark"],
)  # fmt: skip
def test_a_row_that_is_broken_is_left_out_and_named_by_its_line(tmp_path, text, left, said):
    log = read_text(tmp_path, text)

    assert log.tables["compass"]["heading_deg"].tolist() == left
    (finding,) = [finding for finding in log.findings if finding.lost_data]
    assert finding.text == said
    assert finding.code == ("TRUNCATED" if NO_END in said else "UNDECODED")
    assert finding.topic == ("/compass" if "time_ns is" in said else "")


def test_one_bad_cell_costs_one_row(tmp_path: Path) -> None:
    rows = "".join(f"{T0 + k},{k}\n" for k in range(100))
    bad = rows.replace(f"{T0 + 7},7", f"{T0 + 7},north").replace(f"{T0 + 50},50", f"{T0 + 50},5O")
    bad = bad.replace(f"{T0 + 90},90", f"{T0 + 90}").replace(f"{T0 + 91},91", f"{T0 + 91},91,5")
    bad = bad.replace(f"{T0 + 92},92", f'{T0 + 92},"92').replace(f"{T0 + 93},93", f"{T0 + 93},93,,")
    log = read_log(write_csv(tmp_path / "dive", compass="time_ns,heading_deg\n" + bad))

    heading = log.tables["compass"]["heading_deg"].to_numpy()
    texts = [finding.text for finding in log.findings if finding.code == "UNDECODED"]

    np.testing.assert_array_equal(heading, [float(k) for k in range(100) if k not in (7, 50, 90, 91, 92)])
    assert texts == [
        'compass.csv: 2 of 100 rows are left out: line 9: heading_deg is "north", not a number; so are lines 52',
        "compass.csv: 3 of 100 rows are left out: line 92: it has 1 cells, the first line 2; so are lines 93, 94",
    ]


@pytest.mark.parametrize("when", ["1e30", "1e15", "nan"])
def test_seconds_beyond_all_calendars_are_left_out_and_named_by_their_line(tmp_path: Path, when: str) -> None:
    (text,) = lost(logged_csv(tmp_path, WHEN, compass=f"when,hdg\n1,2\n{when},4"))

    assert text.endswith(f'line 3: when is "{when}", not a number of seconds before 2116')


@pytest.mark.parametrize(
    "text",
    [
        "time_ns;starboard_mps;forward_mps\n1;0,5;-1,25e-1\n2;,25;3",
        "time_ns\tstarboard_mps\tforward_mps\n1\t0.5\t-0.125\n2\t0.25\t3",
    ],
)
def test_semicolons_part_columns_with_decimal_commas(tmp_path: Path, text: str) -> None:
    dvl = read_text(tmp_path, text + "\n", "dvl").tables["dvl"]

    np.testing.assert_array_equal(dvl["starboard_mps"], [0.5, 0.25])
    np.testing.assert_array_equal(dvl["forward_mps"], [-0.125, 3])


@pytest.mark.parametrize(
    "text",
    [
        "\ufefftime_ns, heading_deg \n1,0.5\n2,1.5",
        "% time_ns,field.heading_deg\n1,0.5\n2,1.5",
        "%time_ns , heading_deg\n1,0.5\n2,1.5",
        *(f"{first}\ntime_ns;heading_deg\n1;0,5\n2;1,5" for first in ("sep=;", '"sep=;"', "SEP=;")),
        'time_ns,heading_deg,remark\n1,0.5,"bottom, lost\nagain"\n2,1.5,',
        'time_ns,heading_deg,remark\n1,0.5,"one\n\ntwo ""three""\nfour"\n2,1.5,',
    ],
)
def test_marks_prefixes_a_named_separator_and_quoted_line_breaks_cost_no_row(tmp_path: Path, text: str) -> None:
    log = read_text(tmp_path, f"{text}\n")

    assert log.tables["compass"]["heading_deg"].tolist() == [0.5, 1.5]
    assert log.start_ns == 1
    assert not lost(log)


def column(*cells: str) -> str:
    """Return a file with one of the columns, which are parted by semicolons."""
    return "time_ns;east_m;north_m\n" + "".join(f"{k};{cell};6\n" for k, cell in enumerate(cells, start=1))


ASKED = "line 2: east_m holds {}: is that a thousands separator or a decimal point?"


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("usbl", column("1.170", "788", "849"), ASKED.format('"1.170" and "788"')),
        ("usbl", column("0", "1,170", "-788", "849"), ASKED.format('"1.170" and "-788"')),
        ("dvl", "time_ns,forward_mps,starboard_mps\n1,0,995617,-0,006023\n2,1,01,0,03\n",
         "line 2: it has 5 cells, the first line 3; decimal commas need another separator"),
    ],
)  # fmt: skip
def test_marks_that_may_be_decimal_or_not_are_asked_about(tmp_path: Path, name: str, text: str, said: str) -> None:
    assert said in refusal(LogError, read_text, tmp_path, text, name)


@pytest.mark.parametrize("east", [["1.170", "788", "849", "0.5"], ["1,170", "0,788", "2"], ["1,170", "2", "2"]])
def test_a_point_beside_other_decimals_parts_no_thousands(tmp_path: Path, east: Sequence[str]) -> None:
    read = read_text(tmp_path, column(*east), "usbl").tables["usbl"]["east_m"]

    assert read.tolist() == [float(cell.replace(",", ".")) for cell in east]


@pytest.mark.parametrize("rows", [1, 6, 7])
def test_cells_kept_in_pieces_are_those_of_the_file(tmp_path: Path, rows: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(csv_text, "PIECE", 3)
    lines = [f"{T0 + k};{k},5;{-k}" for k in range(rows)]
    lines[rows // 2] = f"{T0 + rows // 2};;1,25"
    text = "\n".join(["time_ns;starboard_mps;forward_mps", *lines])

    log = csv_log(write_csv(tmp_path / "dive", dvl=text))
    dvl = read_whole(log, {"/dvl": ["starboard_mps", "forward_mps"]})["/dvl"]

    at = np.arange(rows)
    np.testing.assert_array_equal(dvl.received_ns, T0 + at)
    np.testing.assert_array_equal(dvl.columns["starboard_mps"], np.where(at == rows // 2, np.nan, at + 0.5))
    np.testing.assert_array_equal(dvl.columns["forward_mps"], np.where(at == rows // 2, 1.25, -at))


def test_times_may_be_dates(tmp_path: Path) -> None:
    sheet = "when,hdg\n2020-09-13T12:26:40.123456789Z,1\n2020-09-13 14:26:41+02:00,2\n2020-09-13T14:26:42+02,3"

    log = logged_csv(tmp_path, WHEN, compass=sheet)

    assert log.start_ns == T0 + 123_456_789
    np.testing.assert_allclose(log.tables["compass"]["time_s"], [0, 0.876543211, 1.876543211], atol=1e-9)


def test_words_may_state_whether_a_record_is_valid(tmp_path: Path) -> None:
    rows = "".join(f"{k},0,1,{word}\n" for k, word in enumerate(("True", "False", "1", "0", "true"), start=1))

    dvl = read_text(tmp_path, f"time_ns,starboard_mps,forward_mps,valid\n{rows}", "dvl").tables["dvl"]

    assert list(dvl["valid"]) == [True, False, True, False, True]


def test_gps_may_come_on_the_plane_or_by_latitude(tmp_path: Path) -> None:
    sheets = ("time_ns,east_m,north_m,sd_m\n1,0,100.02,0.5", "time_ns,lat_deg,lon_deg\n1,45.0009,7.0")

    by_metres, by_degrees = (logged_csv(tmp_path, MAP, gps=sheet).tables["gps"] for sheet in sheets)

    assert by_metres["lat_deg"].iloc[0] == pytest.approx(45.0009, abs=1e-7)
    assert by_metres["sd_m"].iloc[0] == 0.5
    assert by_degrees["north_m"].iloc[0] == pytest.approx(100.02, abs=0.05)
    assert by_degrees["lat_deg"].iloc[0] == 45.0009


def test_truth_in_the_folder_is_the_truth(tmp_path: Path) -> None:
    compass, truth_ = "time_ns,heading_deg\n10,2\n20,2", "time_ns,east_m,north_m\n10,1,2\n20,3,4"
    truth = read_log(write_csv(tmp_path / "dive", compass=compass, truth=truth_)).truth

    np.testing.assert_array_equal(truth.position_m, [[1, 2], [3, 4]])
    assert (truth.source, truth.kind) == ("/truth", "other")


@settings(max_examples=30)
@given(cut=st.integers(11, 24), separator=st.sampled_from([",", ";", "\t", " "]))
def test_a_table_without_names_may_begin_within_a_row(cut: int, separator: str) -> None:
    """As behind a lost sector: the rest of that row is lost data, and the other rows are read."""
    rows = [[f"{T0 // 10**9 + k}", f"{k}.5", f"{1 + k / 100}", f"-{k / 7:.3f}"] for k in range(60)]
    text = "".join(separator.join(row) + "\n" for row in rows)
    toml = '[dvl]\ncolumns = { time_unix_s = "1", x = "3", y = "4" }\nunit = "m/s"\naxes = "FSD"\n'
    with TemporaryDirectory() as folder:
        log = logged_csv(Path(folder), toml, dvl=text[cut:])

    assert log.tables["dvl"]["forward_mps"].tolist() == [float(row[2]) for row in rows[1:]]
    assert lost(log) == ["dvl.csv: 1 of 60 rows are left out: line 1: its beginning is lost"]
