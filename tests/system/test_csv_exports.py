"""CSV as programs export it, with invented headers and real conventions: a run after ``init`` and ``replay``."""

import csv
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from commands import findings, output_of, run
from usbldr.filters.errors import LogError
from usbldr.filters.models.parameters import Parameters
from usbldr.io.reading.read import read_log
from usbldr_cli.main import cli

LENGTH_S = 120.0
KNOT_MPS = 1852 / 3600
CLOCK = "%H:%M:%S.%f"
DAY = "2026-01-01"  # on which the dive is
METRES_PER_DEGREE = np.array([111_131.8, 78_846.8])  # of latitude and longitude, at 45 degrees


@pytest.fixture(scope="module")
def dive(tmp_path_factory: pytest.TempPathFactory) -> dict[str, pd.DataFrame]:
    """Return the sensors of a dive with turns: time as pandas knows it, values in usbldr's units."""
    folder = tmp_path_factory.mktemp("dive") / "turns"
    cli(["simulate", "turns", "-o", str(folder)], standalone_mode=False)
    tables = {name: pd.read_csv(folder / f"{name}.csv") for name in ("dvl", "compass", "usbl", "gps")}
    usbl = tables["usbl"]
    usbl[["lat_deg", "lon_deg"]] = (45.0, -30.0) + usbl[["north_m", "east_m"]].to_numpy() / METRES_PER_DEGREE
    timed = {name: table.assign(t=pd.to_datetime(table["time_ns"])) for name, table in tables.items()}
    end = timed["dvl"]["t"].iloc[0] + pd.Timedelta(seconds=LENGTH_S)
    return {name: table[table["t"] < end] for name, table in timed.items()}


@dataclass(frozen=True)
class Export:
    """How a program writes times, and the columns of each sensor: header -> values."""

    time: Callable[[pd.Series], dict[str, object]]
    names: Mapping[str, Mapping[str, str | Callable[[pd.DataFrame], object]]]
    separator: str = ","
    quoted: bool = False  # numbers with decimal commas, in quotes
    before: str = ""  # the names of columns


def one(name: str, form: str) -> Callable[[pd.Series], dict[str, object]]:
    return lambda t: {name: t.dt.strftime(form)}


def two(date: str, day: str, clock: str, form: str) -> Callable[[pd.Series], dict[str, object]]:
    return lambda t: {date: t.dt.strftime(day), clock: t.dt.strftime(form)}


def since_1970(name: str, unit: float) -> Callable[[pd.Series], dict[str, object]]:
    return lambda t: {name: (t.astype("int64") / unit).map("{:.6f}".format)}


def days(name: str, at_1970: int) -> Callable[[pd.Series], dict[str, object]]:
    return lambda t: {name: (t.astype("int64") / 86_400e9 + at_1970).map("{:.10f}".format)}


def gps_week(week: str, time: str, unit_s: float = 1.0) -> Callable[[pd.Series], dict[str, object]]:
    """Return the week since 1980-01-06 and the time of the week by GPS, which is 18 s ahead of UTC."""

    def columns(t: pd.Series) -> dict[str, object]:
        since = t - pd.Timestamp("1980-01-06") + pd.Timedelta(seconds=18)
        weeks = since // pd.Timedelta(weeks=1)
        return {week: weeks, time: ((since - weeks * pd.Timedelta(weeks=1)).dt.total_seconds() / unit_s).round(3)}

    return columns


METRIC = {
    "dvl": {"DVL Forward [m/s]": "forward_mps", "DVL Starboard [m/s]": "starboard_mps"},
    "compass": {"Heading [deg]": "heading_deg"},
    "usbl": {"USBL Latitude [deg]": "lat_deg", "USBL Longitude [deg]": "lon_deg"},
    "gps": {"GPS Latitude [deg]": "lat_deg", "GPS Longitude [deg]": "lon_deg"},
}
SNAKE = {
    "dvl": {"vel_fwd_mps": "forward_mps", "vel_stbd_mps": "starboard_mps"},
    "compass": {"heading_true_deg": "heading_deg"},
    "usbl": {"beacon_lat": "lat_deg", "beacon_lon": "lon_deg"},
    "gps": {"gps_lat": "lat_deg", "gps_lon": "lon_deg"},
}
KNOTS: Mapping[str, Mapping[str, str | Callable[[pd.DataFrame], object]]] = METRIC | {
    "dvl": {
        "Fwd (knots)": lambda table: table["forward_mps"] / KNOT_MPS,
        "Port (knots)": lambda table: -table["starboard_mps"] / KNOT_MPS,
    }
}
YAW = SNAKE | {"compass": {"yaw_deg": "heading_deg"}}
NOTES = {
    "dvl": {"Velocity Forward [m/s]": "forward_mps", "Velocity Starboard [m/s]": "starboard_mps"},
    "compass": {"Gyro Heading (T)": "heading_deg"},
    "usbl": {"Transponder Lat (WGS84)": "lat_deg", "Transponder Long (WGS84)": "lon_deg"},
    "gps": {"GPS Lat (WGS84)": "lat_deg", "GPS Long (WGS84)": "lon_deg"},
}
GERMAN = {
    "dvl": {"V voraus [m/s]": "forward_mps", "V stb [m/s]": "starboard_mps"},
    "compass": {"Heading rw [°]": "heading_deg"},
    "usbl": {"Transponder Breite [°]": "lat_deg", "Transponder Länge [°]": "lon_deg"},
    "gps": {"GPS Breite [°]": "lat_deg", "GPS Länge [°]": "lon_deg"},
}
SHORT = {
    "dvl": {"BT_Spd_Fwd_kn": lambda table: table["forward_mps"] / KNOT_MPS,
            "BT_Spd_Stbd_kn": lambda table: table["starboard_mps"] / KNOT_MPS},
    "compass": {"FOG_True_Hdg": "heading_deg"},
    "usbl": {"Tgt_Lat": "lat_deg", "Tgt_Lon": "lon_deg"},
    "gps": {"Lat": "lat_deg", "Lon": "lon_deg"},
}  # fmt: skip


def dashes(column: str, sides: str) -> Callable[[pd.DataFrame], object]:
    """Return how a column of degrees is written as degrees, minutes and seconds between dashes."""

    def written(table: pd.DataFrame) -> object:
        seconds = (table[column].abs() * 3600e7).round().astype("int64")  # 1e-7 s
        parts = zip(seconds // (3600 * 10**7), seconds // (60 * 10**7) % 60, seconds % (60 * 10**7) / 1e7, strict=True)
        side = np.where(table[column] < 0, sides[1], sides[0])
        return [f"{d}-{m:02d}-{s:010.7f}{one}" for (d, m, s), one in zip(parts, side, strict=True)]

    return written


HYPACK = KNOTS | {
    sensor: {f"{name} WGS84 Latitude": dashes("lat_deg", "NS"), f"{name} WGS84 Longitude": dashes("lon_deg", "EW")}
    for sensor, name in (("usbl", "USBL"), ("gps", "GPS"))
}
NUMBERED = METRIC | {
    "usbl": {
        "usbl1_lat": "lat_deg",
        "usbl1_lon": "lon_deg",
        "usbl2_lat": lambda table: table["lat_deg"] + 0.001,
        "usbl2_lon": lambda table: table["lon_deg"] + 0.001,
    }
}
EXPORTS = {
    "dashes": Export(two("DATE", "%m/%d/%Y", "TIME", "%H:%M:%S.%f"), HYPACK, "\t"),
    "numbered": Export(one("time", "%Y-%m-%d %H:%M:%S.%f"), NUMBERED),
    "twice": Export(
        lambda t: {
            "Date": t.dt.strftime("%d.%m.%Y"),
            "HH:MM": t.dt.strftime("%H:%M"),
            "HH:MM:SS": t.dt.strftime(CLOCK),
        },
        METRIC,
        ";",
    ),
    "quoted": Export(one("Time", "%d.%m.%Y %H:%M:%S,%f"), METRIC, quoted=True),
    "since_start": Export(
        lambda t: {"Time [s]": (t - pd.Timestamp(DAY)).dt.total_seconds()},
        METRIC,
        before=f"Recorder 4\nStart: {DAY} 00:00:00 UTC\n",
    ),
    "german": Export(two("Datum", "%d.%m.%Y", "Uhrzeit", "%H:%M:%S.%f"), GERMAN, ";"),
    "short": Export(two("LogDate", "%d.%m.%Y", "LogTime", "%H:%M:%S.%f"), SHORT),
    "point_dates": Export(one("Time", "%d.%m.%Y %H:%M:%S.%f"), METRIC, ";"),
    "us_dates": Export(one("Timestamp", "%m/%d/%Y %I:%M:%S.%f %p"), METRIC),
    "iso_zone": Export(one("UTC", "%Y-%m-%dT%H:%M:%S.%fZ"), KNOTS),
    "date_and_time": Export(two("Date", "%d/%m/%Y", "Time", "%H:%M:%S.%f"), METRIC),
    "iso_date_and_time": Export(two("Date", "%Y-%m-%d", "Time", "%H:%M:%S.%f"), SNAKE),
    "seconds_of_day": Export(
        lambda t: {"Date": t.dt.strftime("%Y/%m/%d"), "Seconds of day": (t - t.dt.normalize()).dt.total_seconds()},
        KNOTS,
    ),
    "unix_seconds": Export(since_1970("unix_time", 1e9), SNAKE),
    "unix_ms": Export(since_1970("timestamp", 1e6), YAW),
    "month_names": Export(one("Date Time", "%d-%b-%Y %H:%M:%S.%f"), METRIC, "\t"),
    "local_zone": Export(one("time", "%Y/%m/%d %H:%M:%S.%f+00:00"), SNAKE),
    "spreadsheet_days": Export(days("Time", 25_569), METRIC),
    "matlab_days": Export(days("datenum", 719_529), METRIC),
    "digits": Export(two("DATE", "%Y%m%d", "TIME", "%H%M%S.%f"), METRIC),
    "time_first": Export(one("Time", "%H:%M:%S.%f %d/%m/%y"), METRIC),
    "elapsed": Export(lambda t: {"elapsed_s": (t - pd.Timestamp(DAY)).dt.total_seconds()}, METRIC),
    "day_of_year": Export(
        lambda t: {"Day of year": t.dt.day_of_year, "Year": t.dt.year, "Time": t.dt.strftime(CLOCK)}, METRIC
    ),
    "gps_week": Export(gps_week("GPS Week", "TOW [s]"), SNAKE),
    "gps_week_ms": Export(gps_week("GPSWeek", "GPSTimeOfWeek", 1e-3), METRIC),
    "notes": Export(one("Timestamp (UTC)", "%d %b %Y %H:%M:%S.%f"), NOTES),
}


def write(folder: Path, export: Export, dive: Mapping[str, pd.DataFrame]) -> None:
    folder.mkdir()
    for sensor, table in dive.items():
        columns = {
            head: table[value] if isinstance(value, str) else value(table)
            for head, value in export.names[sensor].items()
        }
        written = pd.DataFrame(export.time(table["t"]) | columns)
        decimal = "," if export.separator == ";" or export.quoted else "."
        lines = written.to_csv(
            index=False,
            sep=export.separator,
            decimal=decimal,
            quoting=csv.QUOTE_ALL if export.quoted else csv.QUOTE_MINIMAL,
        )
        (folder / f"{sensor}.csv").write_text(export.before + lines, encoding="utf-8")


@pytest.mark.parametrize("name", EXPORTS)
@pytest.mark.long
def test_an_export_is_read_after_init_alone(name: str, dive: dict[str, pd.DataFrame], tmp_path: Path) -> None:
    """Every value is that of the dive, to the digits of the times; a run on the same values would be the same run."""
    write(tmp_path / "log", EXPORTS[name], dive)

    said = output_of("init", tmp_path / "log")
    assert "written" in said
    draft = (tmp_path / "log" / "usbldr.toml").read_text(encoding="utf-8")
    assert ("that no sensor uses" in draft) == (name in ("numbered", "twice"))  # columns beside those that are read
    log = read_log(tmp_path / "log")

    for sensor, table in dive.items():
        after_s = (table["time_ns"] - table["time_ns"].iloc[0]) / 1e9
        np.testing.assert_allclose(log.tables[sensor]["time_s"], after_s, rtol=0, atol=1e-3)
        for column in () if sensor == "usbl" else METRIC[sensor].values():
            np.testing.assert_allclose(log.tables[sensor][column], table[column], rtol=0, atol=1e-9)
    assert log.origin is not None
    away_deg = dive["usbl"][["lat_deg", "lon_deg"]].to_numpy() - (log.origin.lat_deg, log.origin.lon_deg)
    fixes_m = log.tables["usbl"][["north_m", "east_m"]]
    np.testing.assert_allclose(fixes_m, away_deg * METRES_PER_DEGREE, rtol=0, atol=0.02)
    assert log.parameters == Parameters(calibrate=("auto",))
    assert log.truth.kind == "gps"
    assert name == "elapsed" or abs(log.start_ns - dive["dvl"]["time_ns"].iloc[0]) < 1e6


@pytest.mark.parametrize("form", ["gaps", "held", "{} Time", "Time.{}"])
@pytest.mark.long
def test_one_table_of_all_sensors_is_replayed_with_gaps_held_values_or_tables_side_by_side(form, dive, tmp_path):
    tables = [
        table[["t", *names.values()]].set_axis(["t", *names], axis=1)
        for table, names in ((dive[sensor], METRIC[sensor]) for sensor in dive)
    ]
    whole = pd.concat(tables).groupby("t", as_index=False).first()
    whole = whole.ffill() if form == "held" else whole
    whole["Time"] = whole.pop("t").dt.strftime("%m/%d/%Y %I:%M:%S.%f %p")
    if "Time" in form:  # each sensor has its own times, and its own count of rows
        names = ["Time", *map(form.format, ("Compass", "USBL", "GPS") if form[0] == "{" else (1, 2, 3))]
        renamed = (table.rename(columns={"t": name}) for table, name in zip(tables, names, strict=True))
        whole = pd.concat([table.reset_index(drop=True) for table in renamed], axis=1)
    whole.to_csv(tmp_path / "survey.csv", index=False)

    output_of("init", tmp_path / "survey.csv")
    options = ["-f", "adf", "--calibrate", "none", "--plots", "none", "-q", "-o", tmp_path / "run"]
    line = run("replay", tmp_path / "survey.csv", *options).stdout

    assert "adf: mean horizontal error 0.2" in line or "adf: mean horizontal error 0.1" in line, line


@pytest.mark.long
def test_init_states_no_convention_that_the_names_of_columns_contradict(dive, tmp_path):
    names = METRIC | {
        sensor: METRIC[sensor] | {f"{name} Longitude [deg]": lambda table: -table["lon_deg"]}
        for sensor, name in (("usbl", "USBL"), ("gps", "GPS"))
    }
    write(tmp_path / "log", Export(since_1970("unix_time", 1e9), names), dive)

    output_of("init", tmp_path / "log", "-o", tmp_path / "found.toml")
    text = (tmp_path / "found.toml").read_text(encoding="utf-8")

    (line,) = [line for line in text.splitlines() if "the names of its columns say how it was read" in line]
    assert line.startswith('# convention = "compass"')
    assert "but ENU fits the fixes better" in line
    assert "\n# mount_deg = " in text  # it belongs to the other convention
    said = findings(tmp_path / "log", "--config", str(tmp_path / "found.toml"))
    assert "KEY-UNUSED" not in said
    assert "its longitudes have the wrong sign" in said["MAP-FRAME"]["text"]


@pytest.mark.long
def test_init_says_why_the_columns_that_it_would_propose_cannot_be_used(dive, tmp_path):
    in_um = {
        name: lambda table, own=own: 1e6 * table[own]
        for name, own in (("Fwd", "forward_mps"), ("Stbd", "starboard_mps"))
    }
    write(tmp_path / "log", Export(since_1970("unix_time", 1e9), METRIC | {"dvl": in_um}), dive)

    with pytest.raises(LogError) as caught:
        output_of("init", tmp_path / "log", "-o", tmp_path / "found.toml")

    why = "the columns that the names suggest cannot be used: all 600 records of /dvl (dvl) are invalid: 600 faster"
    assert caught.value.text.startswith(why)
    assert f"CHECK: {why}" in (tmp_path / "found.toml").read_text(encoding="utf-8")


def test_a_folder_whose_own_configuration_names_the_columns_of_the_truth_is_used_by_every_command(dive, tmp_path):
    """The truth is that of the GPS in the log: the errors are the same."""
    folder, run_of = tmp_path / "log", ["-f", "adf", "--plots", "none", "-q", "-o"]
    write(folder, EXPORTS["unix_seconds"], dive)
    by_gps = output_of("replay", folder, *run_of, tmp_path / "by_gps")
    reference = pd.read_csv(folder / "gps.csv").set_axis(["stamp", "Breite", "phi"], axis=1)
    reference.to_csv(folder / "reference.csv", index=False)
    (folder / "gps.csv").unlink()
    names = 'columns = { time_unix_s = "stamp", lat_deg = "Breite", lon_deg = "phi" }\n'
    (folder / "usbldr.toml").write_text(f'schema = 1\n[truth]\nfile = "reference.csv"\n{names}', encoding="utf-8")

    output_of("init", folder, "-o", tmp_path / "found.toml")
    info = output_of("info", folder)
    by_file = output_of("replay", folder, *run_of, tmp_path / "by_file")
    track = tmp_path / "by_file" / "track_5hz.csv"
    judged = run("evaluate", folder, "--estimate", track, "--plots", "none", "-q", "-o", tmp_path / "judged")

    found = tomllib.loads((tmp_path / "found.toml").read_text(encoding="utf-8"))["truth"]
    assert found == {"file": "log/reference.csv", **tomllib.loads(names)}
    assert "columns time_unix_s = stamp, lat_deg = Breite, lon_deg = phi (configuration)" in info
    assert "no sensor uses" not in info
    assert "mean horizontal error" in by_gps
    assert by_file == by_gps
    assert judged.stdout.partition(":")[2] == by_gps.partition(":")[2]
    assert judged.stderr == ""  # how columns were read is a remark
    (folder / "usbldr.toml").write_text(f"schema = 1\n[truth]\n{names}", encoding="utf-8")
    assert "which file under [truth] or --truth names" in findings(folder)["KEY-UNUSED"]["text"]
