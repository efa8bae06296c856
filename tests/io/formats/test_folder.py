"""Folders with a file that was spoilt: read as far as it can be, else it is named and the exit code is 3."""

import codecs
import os
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet

import table_recordings
from commands import drafted, run
from damage import recorded
from damaged_formats import FORMATS
from recordings import SECOND, T0, saved_lines, sentence, short_dive, write_bag, write_csv, write_mcap, write_rosbag2
from table_recordings import Tables, as_csv, as_hdf5, as_mat, as_parquet
from usbldr.filters.errors import LogError
from usbldr.io import session
from usbldr.io.formats.detect import open_reader
from usbldr.io.messages.roles import choose_roles
from usbldr.io.reading.opening import Request, open_configured
from usbldr.io.reading.read import read_log

OF_ITS_OWN = "it is a log of its own (CSV file)"
COUNT = 300  # [rows]
TIMES = [T0 + k * SECOND for k in range(COUNT)]
GPS = "time_ns,lat_deg,lon_deg\n" + "".join(f"{t},{45 + k / 1e5:.7f},{7 + k / 1e5:.7f}\n" for k, t in enumerate(TIMES))
UNSPOILT: Mapping[str, Callable[[str], bytes]] = {
    "comments": lambda text: f"# GPS of the vehicle, 3 m above\n% WGS 84\n#\n{text}".encode(),
    "thousands of comments": lambda text: ("# a setting\n" * 3000 + text).encode(),
    "zeros before it": lambda text: bytes(100_003) + text.encode(),
    "zeros before it in UTF-16": lambda text: bytes(100_002) + text.encode("utf-16-be"),
    "UTF-32 with a mark": lambda text: text.encode("utf-32"),
    "UTF-32 without": lambda text: text.encode("utf-32-be"),
    "a title": lambda text: f"Export of dive 7\nSerial,1234,A\n\n{text}".encode(),
    "the names in a comment": lambda text: f"# A receiver\n# {text}".encode(),
    "UTF-16 with a mark": lambda text: text.encode("utf-16"),
    "UTF-16, big-endian, with a mark": lambda text: codecs.BOM_UTF16_BE + text.encode("utf-16-be"),
    "UTF-16 without a mark": lambda text: text.encode("utf-16-le"),
    "UTF-16, big-endian, without a mark": lambda text: text.encode("utf-16-be"),
    "zeros at its end": lambda text: text.encode() + bytes(5000),
    "columns in another order behind": lambda text: reordered(text).encode(),
}


def reordered(text: str) -> str:
    """Write the second half of a table with its columns the other way round, under their names."""
    head, *rows = text.splitlines()
    half = len(rows) // 2
    turned = [",".join(reversed(line.split(","))) for line in (head, *rows[half:])]
    return "\n".join([head, *rows[:half], *turned]) + "\n"


def dive(folder: Path) -> Path:
    return write_csv(
        folder,
        dvl="time_ns,forward_mps,starboard_mps\n" + "\n".join(f"{t},{1 + k / 1000},0.5" for k, t in enumerate(TIMES)),
        compass="time_ns,heading_deg\n" + "\n".join(f"{t},{k % 359}" for k, t in enumerate(TIMES)),
        gps=GPS,
    )


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return dive(tmp_path / "dive")


@pytest.mark.parametrize("what", UNSPOILT)
def test_what_surrounds_or_encodes_a_table_costs_none_of_it(folder: Path, what: str) -> None:
    (folder / "gps.csv").write_bytes(UNSPOILT[what](GPS))

    log = read_log(folder)

    assert log.provenance["gps"].used == COUNT
    np.testing.assert_allclose(log.tables["gps"]["lat_deg"], 45 + np.arange(COUNT) / 1e5, atol=1e-9)
    assert not any(finding.lost_data for finding in log.findings)


@pytest.mark.parametrize("writer", [as_csv, as_parquet, as_hdf5, as_mat])
def test_a_table_of_a_sensor_without_rows_is_named(tmp_path: Path, writer: Callable[[Path, Tables], Path]) -> None:
    time_ns, k = np.array(TIMES), np.arange(COUNT) / 1e5
    dvl = {"time_ns": time_ns, "starboard_mps": k, "forward_mps": k}
    log = writer(tmp_path, {"dvl": dvl, "gps": {"time_ns": time_ns[:0], "lat_deg": k[:0], "lon_deg": k[:0]}})

    (lost,) = (one for one in choose_roles(log, open_reader(log).topics(), {}, {}).findings if one.topic == "/gps")

    assert lost.lost_data
    assert "has no records" in lost.text


@pytest.mark.parametrize("writer", [as_csv, as_parquet])
def test_a_table_without_rows_is_not_asked_for_its_unit(tmp_path: Path, writer: Callable[[Path, Tables], Path]) -> None:
    none = np.empty(0)
    log = writer(tmp_path, {"dvl": {"utc": none, "forward_mps": none, "starboard_mps": none}})

    (topic,) = open_reader(log).topics()

    assert topic.problem.removeprefix("dvl").removeprefix(".csv") == " has no rows"


@pytest.mark.parametrize(
    ("make", "why"),
    [
        (lambda file: file.symlink_to("gone.csv"), "a link to a file that is not there"),
        (lambda file: file.symlink_to(file.name), "a link to a file that is not there"),
        (os.mkfifo, "neither a file nor a folder"),
        (lambda file: file.write_bytes(bytes(9000)), "nothing but zeros"),
        (Path.touch, "the file is empty"),
        (Path.mkdir, "the folder is empty"),
        (lambda file: (file / "2026").mkdir(parents=True), "the folder is empty"),
        (lambda file: write_csv(file, gps=GPS),
         "it is a folder of files like those of a log; --with gps.csv adds them"),
    ],
)  # fmt: skip
def test_what_is_no_file_but_named_like_one_is_named(folder: Path, make: Callable[[Path], object], why: str) -> None:
    (folder / "gps.csv").unlink()
    make(folder / "gps.csv")
    (folder / "photos").mkdir()

    (lost,) = open_configured(folder, Request()).reader.findings()

    assert lost.text.startswith("gps.csv is not read: ")
    assert why in lost.text
    assert lost.lost_data


@pytest.mark.parametrize(
    "name", ["gps.csv~", "gps.csv.bak", "gps.csv.OLD", "#gps.csv#", "gps.csv.gz.tmp", "gps_latest.csv"]
)
def test_a_backup_or_a_link_is_passed_over_unless_it_is_all_there_is(folder: Path, name: str) -> None:
    (folder / "~$gps.csv").write_text(GPS, encoding="utf-8")
    if "latest" in name:
        (folder / name).symlink_to("gps.csv")
    else:
        (folder / name).write_text(GPS, encoding="utf-8")
    if ".gz" in name:
        (folder / "gps.csv").rename(folder / "gps.csv.gz")

    log = open_reader(folder)

    (passed_over,) = log.findings()
    assert passed_over.text == f"not read of this folder, as backups of its files or links to them: {name}"
    assert not passed_over.lost_data
    assert [topic.count for topic in log.topics()] == [COUNT] * 3
    (folder / name).rename(folder / "fixes.bak")
    assert len(open_reader(folder).topics()) == 3 + ("latest" not in name)


def test_what_is_no_text_before_a_table_is_named(folder: Path) -> None:
    (folder / "gps.csv").write_bytes(b"\7\1\2of another file\n" + GPS.encode())

    (lost,) = read_log(folder).findings

    assert lost.lost_data
    assert "line 1: it is no text" in lost.text


@pytest.mark.parametrize("before", [b"", b"# exported\n", bytes(512), b"\7" * 9000])
def test_tables_of_several_kinds_are_one_log(folder: Path, before: bytes) -> None:
    (folder / "gps.csv").unlink()
    parquet.write_table(pa.table({"time_ns": TIMES, "lat_deg": [45.0] * COUNT, "lon_deg": [7.0] * COUNT}), "g.parquet")
    (folder / "gps.parquet").write_bytes(before + Path("g.parquet").read_bytes())

    log = read_log(folder)

    assert {role: one.used for role, one in log.provenance.items()} == dict.fromkeys(("dvl", "compass", "gps"), COUNT)
    assert any(finding.lost_data for finding in log.findings) == bool(before.strip(b"\0"))


@pytest.mark.parametrize("form", FORMATS)
def test_a_recording_of_any_format_beside_a_dive_is_read_or_named(folder: Path, form: str) -> None:
    with recorded(form) as (file, _, whole, _):
        (folder / f"usbl_2{file.suffix}").write_bytes(whole)
        for definitions in file.parent.glob("IMC.xml"):
            (folder / definitions.name).write_bytes(definitions.read_bytes())

    log = open_reader(folder)

    read = {topic.name: topic.count for topic in log.topics()}
    named = " ".join(finding.text for finding in log.findings() if finding.lost_data)
    own = {f"/{stem}": f"{stem}.csv is not read" in named for stem in ("dvl", "compass", "gps")}
    assert all(unread or read.get(topic) == COUNT for topic, unread in own.items())
    assert f"usbl_2{file.suffix} is not read" in named or any(read[topic] for topic in read.keys() - own.keys())


@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("gps.xlsx", "is a zip archive, or a spreadsheet"),
        ("dvl_2.ad2cp", "unknown format"),
        ("usbl.raw", "unknown format"),
        (".gps_2.csv", "it is a log of its own (CSV file); --with .gps_2.csv adds it"),
        ("day1/raw/gps.csv", "it is a folder of files like those of a log; --with day1/raw adds them"),
    ],
)
def test_a_file_like_a_sensor_is_named_unless_its_ending_rules_it_out(folder: Path, name: str, why: str) -> None:
    for beside in ("dvl.png", "track.kml", "usbl.py", "._gps.csv", ".gitignore", ".git/dvl.csv", "dvl_photos/usbl.jpg"):
        (folder / beside).parent.mkdir(exist_ok=True)
        (folder / beside).write_bytes(b"\1\2")
    (folder / "runs" / "dive-cpf").mkdir(parents=True)
    (folder / "runs" / "dive-cpf" / "report.json").write_text("{}", encoding="utf-8")
    (folder / "runs" / "dive-cpf" / "fixes.csv").write_text(GPS, encoding="utf-8")
    assert open_reader(folder).findings() == ()
    (folder / name).parent.mkdir(parents=True, exist_ok=True)
    (folder / name).write_bytes(GPS.encode() if name.endswith(".csv") else b"PK\3\4" if name.endswith("x") else b"\1\2")

    (lost,) = open_reader(folder).findings()

    assert lost.text.startswith(f"{name.split('/')[0]} is not read: ")
    assert why in lost.text
    assert lost.lost_data


def test_files_of_other_endings_are_named_and_read_if_their_contents_are_known(folder: Path) -> None:
    parquet.write_table(pa.table({"time_ns": TIMES, "depth_m": [1.0] * COUNT}), folder / "depth.pq")
    (folder / "profile.svp").write_bytes(b"\1\2")

    log = open_reader(folder)

    said = [("not read of this folder: profile.svp; --with FILE adds one", False)]
    assert [(f.text, f.lost_data) for f in log.findings()] == said
    assert {topic.name: topic.count for topic in log.topics()}["/depth"] == COUNT


@pytest.mark.parametrize("text", ["\n\n  \n", "\r\n" * 9, " \t\n" * 5000])
def test_a_file_of_blank_lines_is_named(folder: Path, text: str) -> None:
    (folder / "gps.csv").write_text(text, encoding="utf-8")

    (lost,) = open_reader(folder).findings()

    assert lost.text.startswith("gps.csv is not read: ")
    assert lost.lost_data


@pytest.mark.parametrize(
    ("file", "text", "why"),
    [
        ("gps.xml", '<?xml version="1.0"?><a/>', "gps.xml is not read: is XML; export"),
        ("gps.geojson", '{"type": "FeatureCollection"}', "gps.geojson: named like the gps, but of"),
        ("gps_ublox.txt", "$PUBX,00,122640.10,4500.0,N\n" * COUNT, "gps_ublox.txt: named like the gps, but of"),
    ],
)  # fmt: skip
def test_a_file_named_for_a_sensor_that_the_log_lacks_is_named_and_asked_for(folder, file, text, why):
    (folder / file).write_text(text, encoding="ascii")
    lost_beside = [one.lost_data for one in open_reader(folder).findings()]  # of the stem of gps.csv, or another one
    (folder / "gps.csv").unlink()

    (said,) = [one for one in read_log(folder).findings if one.code in ("NOT-READ", "TOPIC-UNREAD")]

    assert said.text.startswith(why)
    assert said.lost_data
    assert lost_beside == [file == "gps_ublox.txt"]
    assert f'# [gps]\n# topic = "?"                           # CHECK: {said.text}\n' in drafted(folder)


def test_a_folder_named_parquet_is_one_table_in_parts(folder: Path) -> None:
    (folder / "gps.csv").unlink()
    (folder / "gps.parquet").mkdir()
    (folder / "gps.parquet" / "_SUCCESS").touch()
    table = pa.table({"time_ns": TIMES, "lat_deg": [45 + k / 1e5 for k in range(COUNT)], "lon_deg": [7.0] * COUNT})
    for k in range(3):
        parquet.write_table(table[100 * k : 100 * k + 100], folder / "gps.parquet" / f"part-0000{k}.parquet")

    log, alone = read_log(folder), open_reader(folder / "gps.parquet")

    assert log.provenance["gps"].used == COUNT
    np.testing.assert_allclose(log.tables["gps"]["lat_deg"], 45 + np.arange(COUNT) / 1e5, atol=1e-9)
    assert log.findings == ()
    assert [(topic.name, topic.count) for topic in alone.topics()] == [("/gps", COUNT)]
    write_csv(folder / "gps.parquet", dvl=GPS)
    for path in (folder, folder / "gps.parquet"):
        (lost,) = open_reader(path).findings()
        assert lost.lost_data
        assert lost.text.endswith(f"dvl.csv is not read: {OF_ITS_OWN}; --with dvl.csv adds it")
    (folder / "gps.parquet" / "dvl.csv").unlink()
    (folder / "gps.parquet" / "year=2027").mkdir()
    dive(folder / "gps.parquet" / "year=2027")
    (lost,) = open_reader(folder).findings()
    assert lost.text.startswith("gps.parquet is not read: it is a folder of files like those of a log")


@pytest.mark.parametrize(
    ("name", "text", "why"),
    [
        ("gps_2", "2027-01-01T00:00:00.5Z,45.0,7.0\n2027-01-01T00:00:01.5Z,45.0,7.1\n",
         "has no header: its first line holds values; write that of /gps before it; rename it if"),
        ("usbl_b", "2027-01-01 00:00:00Z,-3.5,1e2\n2027-01-01 00:00:01Z,-3.6,1e2\n",
         "so its columns are 1, 2, ...; name them with the key columns of the sensor's section"),
        ("dvl_002", "when,forward,sideways\n1,2,3\n", "its columns match no sensor (when, forward, sideways)"),
        ("ship_compass", "Time [s],Heading [turn]\n1,2\n", "has a column Heading [turn] without a known unit"),
    ],
)  # fmt: skip
def test_a_table_of_a_sensor_that_cannot_be_read_beside_the_one_that_is_read_is_a_loss(tmp_path, name, text, why):
    folder = write_csv(dive(tmp_path / "dive"), imu_raw="t,ax\n1,2\n", dvl_settings="key,value\nrange,20\n")
    assert not any(finding.lost_data for finding in read_log(folder).findings)
    write_csv(folder, **{name: text})

    log = read_log(folder)

    (lost,) = (finding for finding in log.findings if finding.lost_data)
    assert (lost.code, lost.topic) == ("TOPIC-UNREAD", f"/{name}")
    assert why in lost.text
    assert log.provenance["gps"].used == log.provenance["dvl"].used == COUNT


@pytest.fixture(autouse=True)
def _in_a_folder_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def test_a_folder_of_sentences_is_a_log_whatever_its_files_are_called(tmp_path: Path) -> None:
    for hour in range(3):
        bodies = (f"GPGGA,{10 + hour}{k:02d}00,4500.0,N,00700.0,E,1,9,0.6,0,M,20,M,," for k in range(9))
        lines = (f"2020-09-13T{10 + hour}:{k:02d}:00Z {sentence(body)}" for k, body in enumerate(bodies))
        saved_lines(tmp_path / f"port7_{hour}", lines)

    log = open_reader(tmp_path)

    assert log.format == "NMEA text"
    assert [(topic.name, topic.count) for topic in log.topics()] == [("/GPGGA", 27)]


@pytest.mark.parametrize("name", ["dive", "dvl_tests"])
def test_sentences_of_a_sensor_that_the_tables_lack_are_part_of_the_dive(tmp_path: Path, name: str) -> None:
    folder = dive(tmp_path / name)
    bodies = [f"PNORBT7,{T0 / 1e9 + k:.1f},1,-3,{k / 100:.2f},0.25,-0.5,0.003,25,25,25,25" for k in range(COUNT)]
    (folder / "nortek.log").write_text("".join(sentence(body) + "\n" for body in bodies), encoding="ascii")
    (beside_a_table,) = open_reader(folder).findings()
    assert beside_a_table.text.startswith("nortek.log is not read: it is a log of its own")
    (folder / "dvl.csv").unlink()

    log = read_log(folder)

    assert log.tables["dvl"]["forward_mps"].tolist() == [k / 100 for k in range(COUNT)]
    assert log.tables["dvl"]["time_s"].tolist() == log.tables["compass"]["time_s"].tolist() == list(range(COUNT))


def test_files_beside_a_recording_are_named_and_those_like_a_sensor_are_a_loss(tmp_path: Path) -> None:
    folder = write_rosbag2(tmp_path / "dive", short_dive())
    (folder / "notes.txt").write_text("calm", encoding="utf-8")
    said = [("not read of this folder: notes.txt; --with FILE adds one", False)]
    assert [(f.text, f.lost_data) for f in open_reader(folder).findings()] == said
    (folder / "gps.csv").write_text(GPS, encoding="utf-8")

    (lost,) = (finding for finding in open_reader(folder).findings() if finding.lost_data)

    assert lost.text == f"gps.csv is not read: {OF_ITS_OWN}; --with gps.csv adds it"
    assert run("info", folder).return_value == 3
    added = run("info", folder, "--with", folder / "gps.csv")
    assert added.return_value == 0
    assert "gps.csv is not read" not in added.output


@pytest.mark.parametrize("write", [write_mcap, write_bag])
def test_a_recording_of_a_sensor_that_the_tables_lack_is_a_loss(folder: Path, write: Callable[..., Path]) -> None:
    """The bag that tables were made of is none."""
    write(folder / "dive.rec", [row for row in short_dive() if row[1] == "/dvl"])
    assert [one.lost_data for one in open_reader(folder).findings()] == [False]

    (folder / "dvl.csv").unlink()

    (lost,) = open_reader(folder).findings()
    assert lost.lost_data
    assert lost.text.startswith("dive.rec is not read: it is a log of its own (")


def test_folders_within_a_folder_are_named_and_a_loss_if_a_file_is_named_like_a_sensor(tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    for number in (1, 2):
        dive(tmp_path / "a" / f"dive{number}")
    with pytest.raises(
        LogError, match=r"holds folders with files like those of a log \(dive1, dive2\); name one of them"
    ):
        open_reader(tmp_path / "a")
    found = open_reader(dive(tmp_path / "a")).findings()
    assert [(one.text[:5], one.lost_data) for one in found] == [("dive1", True), ("dive2", True)]


def test_a_folder_for_each_sensor_is_one_log(tmp_path: Path) -> None:
    for file in sorted(dive(tmp_path / "a").glob("*.csv")):
        (file.parent / file.stem).mkdir()
        file.rename(file.parent / file.stem / "data.csv")

    assert {topic.name for topic in open_reader(tmp_path / "a").topics()} == {"/compass", "/dvl", "/gps"}
    (tmp_path / "a" / "gps" / "data.csv").rename(tmp_path / "a" / "gps" / "first.csv")
    for name in ("gps/second.csv", "dvl/dvl.bin"):
        (tmp_path / "a" / name).write_bytes(GPS.encode() if name.startswith("gps") else b"\x01\x02" * 500)
    found = open_reader(tmp_path / "a")
    assert {topic.name for topic in found.topics()} == {"/compass", "/dvl", "/gps/first", "/gps/second"}
    (unread,) = found.findings()
    assert unread.lost_data
    assert "dvl.bin is not read" in unread.text
    (tmp_path / "a" / "dvl" / "dvl.bin").unlink()
    (tmp_path / "a" / "usbl").mkdir()
    assert [(one.text, one.lost_data) for one in open_reader(tmp_path / "a").findings()] == [
        ("usbl is not read: the folder is empty", True)
    ]
    (tmp_path / "b" / "usbl").mkdir(parents=True)
    with pytest.raises(LogError, match="holds nothing that can be read: usbl is not read: the folder is empty"):
        open_reader(tmp_path / "b")


def test_the_current_folder_has_a_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(dive(tmp_path / "dive_7"))

    assert session.open_log(".").path.name == "dive_7"


@pytest.mark.parametrize("writer", [as_csv, as_parquet], ids=["CSV", "Parquet"])
def test_a_file_of_the_folder_added_is_read_once(tmp_path: Path, writer: Callable[[Path, Tables], Path]) -> None:
    folder = writer(tmp_path, table_recordings.dive(COUNT))
    (file,) = folder.glob("gps.*")

    reader = open_configured(folder, Request(joined=(str(file),))).reader

    assert {topic.name: topic.count for topic in reader.topics()} == dict.fromkeys(("/dvl", "/compass", "/gps"), COUNT)
