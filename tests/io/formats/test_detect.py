"""Formats are recognised by content; unsupported ones are named."""

import tarfile
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
import scipy.io

from damage import recorded
from damaged_formats import FORMATS as RECORDINGS
from logs import refusal
from recordings import SECOND, T0, saved, sentence, write_csv
from usbldr.filters.errors import LogError
from usbldr.io.decoding.definitions import SHIPPED
from usbldr.io.formats.detect import BEGIN_BYTES, open_reader
from usbldr.io.formats.detect import FORMATS as FORMATS_READ

CONVERTED = "line ends were converted by git or a text transfer, which destroys it; copy it again in binary mode"
FORMATS = (
    "MCAP files, ROS 1 bags, rosbag2 (folders and .db3 files), MAVLink telemetry logs (.tlog), DataFlash logs (.BIN), "
    "PD0 files, PD4 and PD5 files, PD6 text, MOOS logs (.alog), LSF logs of IMC messages, "
    "Parquet files and folders of them, Arrow files (Feather), HDF5 files (also netCDF-4), MATLAB files (.mat), "
    "JSON lines and columns, spreadsheets (.xlsx), text files of NMEA sentences and CSV folders"
)


@pytest.mark.parametrize("form", RECORDINGS)
@pytest.mark.parametrize("name", ["dive", "dive.csv", "dive.mcap"])
def test_a_file_is_what_it_holds_whatever_its_name(form: str, name: str) -> None:
    with recorded(form) as (file, _, _, _):
        log = open_reader(file)
        kind, topics = log.format, len(log.topics())
        renamed = open_reader(file.rename(file.with_name(name)))

        assert (renamed.format, len(renamed.topics())) == (kind, topics)


def test_every_format_has_a_recording() -> None:
    """So that tests over all recordings are tests over all formats."""
    found: set[str] = set()
    for form in RECORDINGS:
        with recorded(form) as (file, _, whole, _):
            found |= {name for name, reader in FORMATS_READ.items() if reader(file, whole[:BEGIN_BYTES], SHIPPED)}

    assert found == set(FORMATS_READ)


STARTED = b"".join(b"[%9d] usb: device %d\n" % (k, k % 7) for k in range(2000))  # as a computer logs its start
NOISE = np.random.default_rng(0).integers(0, 256, 40_000, dtype=np.uint8).tobytes() + b"\n"


@pytest.mark.parametrize("before", [STARTED, NOISE], ids=["messages", "noise"])
@pytest.mark.parametrize(
    ("line", "topic"),
    [
        (sentence("HEHDT,30.5,T"), "/HEHDT"),
        ('{"type": "compass", "ts": 1600000000.5, "heading_deg": 30.5}', "/compass"),
        (":TS,20091312264000,35.0,+15.0,20.0,1500.0,  0\n:BS,  +250, +1500,    +0,A", "/BS"),
        ("USBLLONG,1600000000.5,1600000000.4,2,10.5,20.5,30.5", "/USBLLONG"),
    ],
)
def test_lines_of_records_are_read_behind_anything_else(tmp_path: Path, before: bytes, line: str, topic: str) -> None:
    log = open_reader(saved(tmp_path / "dive.log", before, f"{line}\n" * 2000))

    assert {one.name: one.count for one in log.topics()}[topic] == 2000
    assert any(one.text.startswith("dive.log: ") for one in log.findings())


def test_what_holds_no_records_anywhere_stays_unknown(tmp_path: Path) -> None:
    for head in (STARTED, NOISE):
        assert "unknown format" in refusal(LogError, open_reader, saved(tmp_path / "dive.log", head * 4))


def matlab_4() -> bytes:
    file = BytesIO()
    scipy.io.savemat(file, {"time_s": np.arange(3.0)}, format="4")
    return file.getvalue()


SETTINGS = "is JSON, but not of one object a record; write it so, or as CSV"
ECHO = "is what ros2 topic echo prints; read the recording that it came from, or write its values as CSV"


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        (b"", "the file is empty"),
        (b"\0\1\2\3not a log", "unknown format (starts with b'\\x00\\x01\\x02\\x03not a lo'); usbldr reads " + FORMATS),
        (b"hello world", "unknown format (starts with b'hello world'); usbldr reads " + FORMATS),
        (b"#ROSBAG V1.2\n", "is a ROS 1 bag of an old version; convert it to version 2.0 first "
         "(rosbag fix IN.bag OUT.bag)"),
        (b"CDF\x01rest", "is a netCDF-3 file; convert it to netCDF-4 first (nccopy -k nc4 IN.nc OUT.nc)"),
        (matlab_4(), "is a MATLAB file of version 4; store it again in MATLAB with save(FILE, '-v7')"),
        (
            b"PK\x03\x04rest",
            "is a zip archive, or a spreadsheet, cut or of another kind; unpack it, or export the sheet as CSV",
        ),
        (b"FMT, 128, 89, FMT, BBnNZ, Type,Length,Name,Format,Columns\nGPS, 1, 2\n",
         "is a DataFlash log as text, as Mission Planner writes it; read the .BIN file that it was made from"),
        (b"%% LOGSTART 1779105600\n%%%%(1)     TIME\n0.000      1.5\n",
         "is a table of all variables at equal times that MOOS writes (.aslog); read the .alog file beside it"),
        (b"<html><body><table><tr><td>Time,Heading</td></tr>",
         "is an HTML page, whatever its name; export the sheet as CSV"),
        (b'<?xml version="1.0"?>\n<Workbook>', "is XML; export its values as CSV, with a line of names"),
        (b'{"dvl": {"time_s": [' + b"1.5, " * 50_000 + b"2.5]}}\n", SETTINGS),
        (b'{\n  "usbl": {\n    "x": 1\n  },\n  "list": [\n    {\n      "a": 1\n    }\n  ]\n}', SETTINGS),
        (b"header:\n  stamp:\n    sec: 1\n---\n", ECHO),
        (b"data: 1.5\n---\ndata: 2.5\n---\n", ECHO),
        (b"#BESTPOSA,COM1,0,78.5,FINESTEERING,2399,345618.000,02000020,cdba,1;SOL_COMPUTED,45.1,7.2*1f2e3d4c\n",
         "is a NovAtel receiver's log; write it as CSV (NovAtel Convert) or log NMEA sentences"),
        (b"dvl,vehicle=rov vx=1.5,vy=0.2 1600000000000000000\n",
         "is InfluxDB's line protocol; write its points as CSV (influx query --raw)"),
        (b"(1611234567.123456) can0 1F0#0102\n",
         "is a log of a CAN bus (candump); decode it by the DBC file of the bus, and write the values as CSV"),
        (b"RDI: 1600000000.500\talt:2.5 vx:1.5 vy:0.2\n",
         "is a log of ACFR's vehicles (RAW.auv); write the lines of each sensor as CSV, with a line of names"),
        (b"2020-09-13T12:26:40.000,FE,1C,0,1,1,1E,mavlink_attitude_t,time_boot_ms,0,roll,0.01,Len,36\n",
         "is telemetry as Mission Planner writes it as text; read the .tlog file that it was made from"),
        (b"[2020-09-13 12:26:40.000] [info] dvl: vx=1.5 vy=0.2\n",
         "is a log of a program's messages; write their values as CSV, with a line of names"),
        (b"time_s heading_deg\n1.5\n", "is a table with blanks between its columns, whose first row is not of as many "
         "numbers as there are names; write commas between the columns"),
        (b"\x89MCAP0\nrest", "is an MCAP file whose " + CONVERTED),
        (b"\x89MCAP0\r\r\nrest", "is an MCAP file whose " + CONVERTED),
        (b"#ROSBAG V2.0\r\nrest", "is a ROS 1 bag whose " + CONVERTED),
    ],
)  # fmt: skip
def test_what_is_no_log_is_named(tmp_path: Path, content: bytes, sentence: str) -> None:
    file = saved(tmp_path / "dive.mcap", content)

    assert refusal(LogError, open_reader, file) == f"{file}: {sentence}"


@pytest.mark.parametrize("name", ["usbl.tar", "usbl.tar.gz", "usbl.tgz"])
def test_an_archive_of_tables_is_no_table(tmp_path: Path, name: str) -> None:
    folder = write_csv(tmp_path / "dive", dvl="time_ns,forward_mps,starboard_mps\n1,1,2\n")
    with tarfile.open(folder / name, "w:gz" if name.endswith("gz") else "w") as archive:
        archive.add(folder / "dvl.csv", "dvl.csv")

    said = "is a tar archive; unpack it first (tar -xf)"
    assert refusal(LogError, open_reader, folder / name) == f"{folder / name}: {said}"
    (lost,) = open_reader(folder).findings()
    assert lost.text == f"{name} is not read: {said}"


def test_a_missing_file_is_an_error(tmp_path: Path) -> None:
    assert refusal(LogError, open_reader, tmp_path / "gone.mcap") == f"{tmp_path / 'gone.mcap'}: no such file or folder"


def test_a_folder_without_text_is_an_error_that_lists_its_content(tmp_path: Path) -> None:
    (tmp_path / "dive.pdf").write_bytes(b"%PDF\0")

    assert refusal(LogError, open_reader, tmp_path) == (
        f"{tmp_path}: this folder holds no recording and no CSV file with a header (it holds dive.pdf); "
        f"usbldr reads {FORMATS}"
    )


def test_the_end_mark_of_dos_is_no_line(tmp_path: Path) -> None:
    """Also where texts were joined by `copy a.csv + b.csv`."""
    header, rows = "time_ns,forward_mps,starboard_mps\n", [f"{T0 + k * SECOND},1.0,0.5\n" for k in range(40)]
    log = open_reader(saved(tmp_path / "dvl.csv", header, *rows[:20], "\x1a", header, *rows[20:], "\x1a"))

    assert [topic.count for topic in log.topics()] == [40]
    assert not any(finding.lost_data for finding in log.findings())
