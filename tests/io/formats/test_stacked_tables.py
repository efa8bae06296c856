"""Text files of several tables, one below the other, are read as a folder with a file for each would be."""

import re
from datetime import datetime, timedelta
from pathlib import Path
from zipfile import ZipFile

import pandas as pd
import pytest
from openpyxl import Workbook

from logs import codes
from recordings import SECOND, T0, saved, saved_lines, write_csv
from usbldr.io.formats.detect import open_reader
from usbldr.io.limits import VARIABLE
from usbldr.io.reading.read import read_log
from usbldr.io.tables.table_log import TableLog

ROWS = 12
TABLES = {
    "dvl": ("Time [s],DVL starboard [m/s],DVL forward [m/s]", "{},0.25,{}.5"),
    "compass": ("Time [s],Heading [deg]", "{},{}.5"),
    "usbl": ("Time [s],USBL east [m],USBL north [m]", "{},{}.25,7.5"),
}
PARTS = {
    name: [names, *(row.format(T0 // SECOND + k, k) for k in range(ROWS))] for name, (names, row) in TABLES.items()
}


UNITS = {PARTS["dvl"][0]: "s,m/s,m/s", PARTS["compass"][0]: "UTC,deg"}


def stacked(before: str, separator: str = ",") -> list[str]:
    """Return the lines of all tables; ``before`` each are lines with its name in place of {}."""
    lines = [line for name, part in PARTS.items() for line in (*before.format(name).split("\n"), *part)]
    return [line.replace(",", separator) for line in lines]


def by_turns(parts: int) -> list[str]:
    """Return the lines of all tables in so many parts each, by turns, and their names before each."""
    per = ROWS // parts
    turns = [(name, part[0], part[1 + k * per :][:per]) for k in range(parts) for name, part in PARTS.items()]
    return [line for name, names, rows in turns for line in (f"[{name}]", names, *rows)]


LAYOUTS = {
    "a blank line": stacked(""),
    "a blank line, and sensors' names": [
        line and f"{'Sensor' if line.startswith('Time') else name},{line}"
        for name, part in PARTS.items()
        for line in ("", *part)
    ],
    "parts by turns": by_turns(4),
    "parts with units": [line for one in by_turns(2) for line in ([one, UNITS[one]] if one in UNITS else [one])],
    "titles": stacked("[{}]"),
    "titles behind blank lines": stacked("\n{} data"),
    "comments and settings": ["Job,Otter", *stacked("# {}\nDate: 2020-09-13\nrate,5\nowner,me")],
    "lines of a spreadsheet": stacked("{},,", ";"),
    "their units": [line for one in stacked("== {} ==") for line in ([one, UNITS[one]] if one in UNITS else [one])],
}


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize(("line_end", "coding"), [("\n", "utf-8"), ("\r\n", "utf-8-sig"), ("\r\n", "utf-16")])
def test_each_table_is_read(tmp_path: Path, layout: str, line_end: str, coding: str) -> None:
    apart = read_log(write_csv(tmp_path / "apart", **{name: "\n".join(part) for name, part in PARTS.items()}))

    log = read_log(saved(tmp_path / "dive.csv", line_end.join([*LAYOUTS[layout], ""]).encode(coding)))

    assert {role: of.used for role, of in log.provenance.items()} == dict.fromkeys(TABLES, ROWS)
    assert "UNDECODED" not in codes(log)
    for role, table in apart.tables.items():
        assert log.tables[role].equals(table)
    (text,) = [finding.text for finding in log.findings if finding.code == "CONCATENATED"]
    titles = re.fullmatch("the file holds 3 tables, one below the other: (\\w+), (\\w+), (\\w+)", text).groups()
    assert layout.startswith("a blank line") or all(map(str.startswith, titles, TABLES))


@pytest.mark.parametrize("before", ["{} data", "# {}"])
def test_names_between_blanks_begin_a_table(tmp_path: Path, before: str) -> None:
    plain = {"dvl": "t_s stbd_mps fwd_mps", "compass": "t_s hdg_deg", "usbl": "t_s usbl_east_m usbl_north_m"}
    rows = {name: [row.replace(",", "  ") for row in PARTS[name][1:]] for name in plain}
    lines = [line for name in plain for line in (before.format(name), plain[name], *rows[name], "")]

    log = read_log(saved_lines(tmp_path / "dive.txt", lines))

    assert {role: of.topic for role, of in log.provenance.items()} == {
        name: f"/{name}{'_data' * ('data' in before)}" for name in TABLES
    }
    assert {role: of.used for role, of in log.provenance.items()} == dict.fromkeys(TABLES, ROWS)


def test_a_line_is_named_by_its_number_in_the_file(tmp_path: Path) -> None:
    lines = stacked("[{}]")
    lines[20] += ",9,9"
    log = read_log(saved_lines(tmp_path / "dive.csv", lines))

    assert "compass.csv: 1 of 12 rows are left out: line 21: it has 4 cells" in codes(log)["UNDECODED"]


@pytest.mark.parametrize("between", ["", "# logger restarted", "a remark", "[dvl]"])
def test_a_table_that_goes_on_behind_its_names_is_one(tmp_path: Path, between: str) -> None:
    names, *rows = PARTS["dvl"]

    log = open_reader(saved_lines(tmp_path / "dive.csv", ["A title", "", names, *rows[:6], between, names, *rows[6:]]))

    assert isinstance(log, TableLog)
    assert [topic.count for topic in log.topics()] == [ROWS]


@pytest.mark.parametrize("shown", ["yyyy-mm-dd h:mm:ss", "YYYY-MM-DD HH:MM:SS", "mm:ss.0"])
def test_the_sheets_of_a_workbook_are_tables(tmp_path: Path, shown: str) -> None:
    """Also a date and a time of day in cells of their own; a sheet without a table is none."""
    book = Workbook()
    book.create_sheet("Notes").append(["Vessel", "Otter"])
    for name, heads in (("compass", ["Date", "Time", "Heading (deg)"]), ("depth", ["UTC", "Depth (m)"])):
        sheet = book.create_sheet(name)
        for row in ([f"Dive of {name}"], [], heads):
            sheet.append(row)
        for k in range(3):
            moment = datetime(2020, 9, 13, 23, 59, 59) + timedelta(seconds=k)
            sheet.append([moment.date(), moment.time(), 10 + k] if name == "compass" else [moment, 1.5 + k])
            if name == "depth":
                sheet.cell(4 + k, 1).number_format = shown
    book.save(tmp_path / "dive.xlsx")

    log = read_log(tmp_path / "dive.xlsx")

    assert "DATE-OF-OTHERS" not in codes(log)
    assert log.start_ns == pd.Timestamp("2020-09-13T23:59:59").value
    assert log.tables["compass"][["time_s", "heading_deg"]].to_numpy().tolist() == [[0, 10], [1, 11], [2, 12]]
    assert log.tables["depth"]["depth_m"].tolist() == [1.5, 2.5, 3.5]


def test_a_workbook_of_one_sheet_is_named_as_its_file(tmp_path: Path) -> None:
    for name in ("usbl", "compass"):
        book = Workbook()
        book.active.title = "Sheet1"
        for line in PARTS[name]:
            book.active.append([cell if cell[0].isalpha() else float(cell) for cell in line.split(",")])
        book.save(tmp_path / f"{name}.xlsx")

    log = read_log(tmp_path)

    assert {role: len(table) for role, table in log.tables.items()} == {"usbl": ROWS, "compass": ROWS}


def test_cells_without_a_value_behind_the_last_are_not_copied(tmp_path: Path, monkeypatch) -> None:
    book = Workbook()
    for line in PARTS["usbl"]:
        book.active.append([cell if cell[0].isalpha() else float(cell) for cell in line.split(",")])
    book.active.cell(5_000, 2_000).number_format = "0.00"  # 10 MB of commas
    book.save(tmp_path / "usbl.xlsx")
    monkeypatch.setenv(VARIABLE, "0.001")  # of 256 MB and more

    assert len(read_log(tmp_path / "usbl.xlsx").tables["usbl"]) == ROWS


def test_sheets_whose_names_differ_by_odd_characters_are_all_read(tmp_path: Path) -> None:
    book = Workbook(write_only=True)
    for name in ("Depth (A)", "Depth <A>"):
        sheet = book.create_sheet(name)
        for row in (["Time [s]", "Depth [m]"], [1.0, 2.0], [2.0, 3.0]):
            sheet.append(row)
    book.save(tmp_path / "dive.xlsx")

    assert [topic.count for topic in open_reader(tmp_path / "dive.xlsx").topics()] == [2, 2]


def test_a_sheet_cannot_name_a_file_elsewhere(tmp_path: Path) -> None:
    book = Workbook()
    book.active.title = "dvl"
    book.active.append(["time_s", "forward_mps", "starboard_mps"])
    book.active.append([0.0, 1.0, 0.0])
    book.save(tmp_path / "good.xlsx")
    with ZipFile(tmp_path / "good.xlsx") as good, ZipFile(tmp_path / "dive.xlsx", "w") as hostile:
        for name in good.namelist():
            content = good.read(name)
            hostile.writestr(name, content.replace(b'name="dvl"', f'name="{tmp_path}/evil"'.encode()))

    open_reader(tmp_path / "dive.xlsx").topics()

    assert {path.name for path in tmp_path.iterdir()} == {"good.xlsx", "dive.xlsx"}
