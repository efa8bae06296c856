"""Files that programs of survey companies and laboratories export: read, proposed, or refused in one sentence."""

import tomllib
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from commands import drafted
from logs import columns, logged_csv, places, read_as, refusal
from recordings import SECOND, T0, saved, write_csv
from usbldr.filters.errors import LogError, UsageError
from usbldr.io.formats.detect import open_reader
from usbldr.io.reading.read import Request, read_log

T0_S = T0 // SECOND
DVL = "time_ns,forward_mps,starboard_mps\n" + "".join(f"{T0_S * SECOND + k * SECOND},1.0,0\n" for k in range(30))
FIX = "time_ns,lat_deg,lon_deg\n" + "".join(f"{(T0_S + k) * SECOND},{45 + 9e-6 * k:.7f},7\n" for k in range(30))
HEADINGS = FIX.replace("lat_deg,lon_deg", "heading_deg,sd_deg")


@pytest.mark.parametrize(
    ("names", "row"),
    [
        ("Time [s],,Heading (deg),,", "{t},a,{h},,"),
        ("Time [s]|Heading (deg)", "{t}|{h}"),
        (" Time [s] | Heading (deg) \n----------+---------------", " {t} | {h} "),
        ("mission date,mission time of day (s),Heading (deg)", "13/09/2020,{sod},{h}"),
        ("Time (GPST),Heading (deg)", "2020/09/13 12:{gps},{h}"),
        ("Time,Heading (deg)", "2020-257T12:{utc},{h}"),
        ("Time,Heading (deg)", "2020:257:12:{utc}.0,{h}"),
        ("Time [s],Heading (deg)", "{d},{h}"),
        ("timestamp (seconds since 01/01/1970), system, Heading (deg)", "{t}, lauv, {h}"),
        ("Time..s.,Heading..deg.", "{t},{h}"),
        ("time [seconds since 2000-01-01 00:00:00],Heading (deg)", "{j2000},{h}"),
        ("utime,Heading (deg)", "{t}000000,{h}"),
        ("Time,Heading (deg)", "{t}.0 sec,{h}"),
        ("Time,Heading (deg)", "20200913{all},{h}"),
        ("Time,Heading (deg)", "2020257{all}.0,{h}"),
        ("%  GPST      latitude(deg)  heading(deg)", "2020/09/13 12:{gps}.000   45.1   {h}"),
        ("UTC_Year,UTC_Month,UTC_Day,UTC_Hour,UTC_Minute,UTC_Second,Heading (deg)", "2020,9,13,12,{hms},{h}"),
        ("YR,MO,DA,HH,MM,SS,HH/100,Heading (deg)", "20,9,13,12,{hms},00,{h}"),
        ("timestampPosixSec,timestampPosixMicroSec,Heading (deg)", "{t},0,{h}"),
        ("Year,Decimal Yearday (UTC),Heading (deg)", "2020,{doy},{h}"),
        ("Vehicle: ROV 2\nDate: 13.09.2020\n\nUTC Time;Heading (deg)", "12:{utc};{h}"),
        ("Date: 13.09.2020\nms since midnight,Heading (deg)", "{sod}000,{h}"),
        ("ntp_time,Heading (deg)", "{ntp}.0,{h}"),
        ("Timestamp [us],UTC Date,UTC Time,Heading (deg)", "1234567000,2020-09-13,12:{utc},{h}"),
        ("event_ms,Heading (deg)", "{t}000,{h}"),
        ("Time [min],Heading (deg)", "{min},{h}"),
        ("Date,Time,Heading (deg)", "{day},12:{utc},{h}"),
        ("Time,Heading (deg)\ndatetime,float", "2020-09-13T12:{utc},{h}"),
        ("time,heading (deg)\nUTC,degrees_true", "2020-09-13T12:{utc}Z,{h}"),
        ("| Time | Heading (deg) |\n|:---|---:|", "| 2020-09-13 12:{utc} | {h} |"),
        ("Time,Heading (deg)", "2020-09-13 14:{utc}.0 +0200 CEST,{h}"),
        ('"Time [s]","Heading (deg)"', '"{row}",{t},{h}'),
        ("Local Time,UTC Time,Heading (deg)", "2020-09-13 14:{utc},2020-09-13 12:{utc},{h}"),
        ("UTC Date (ddmmyy),UTC Time (hhmmss.ss),Heading (deg)", "130920,{all}.00,{h}"),
        (",compass,compass\n,Heading (deg),Roll (deg)\ntime,,", "2020-09-13T12:{utc}+00:00,{h},0"),
        ("Date,Time,Time (full),Heading (deg)", "13.09.2020,12:26,12:{utc},{h}"),
        ("Date,HH:MM:SS,HH:MM,Heading (deg)", "13.09.2020,12:{utc},12:26,{h}"),
        ("year,doy,Heading (deg)", "2020,{doy},{h}"),
        ("year,Julian Day,Heading (deg)", "2020,{doy},{h}"),
        ("Time,Heading (deg)", "2020/257/12:{utc}.00,{h}"),
        ("Time,Heading (deg)", "2020-257 12:{utc},{h}"),
        ("Start: 2020-09-13 12:26:40\nTime [s],Heading (deg)", "{t},{h}"),
    ],
    ids=["blank names", "pipes", "printed", "REMUS", "GPS time", "day of year", "colons", "Fortran", "Dune", "R", "CF",
         "LCM", "MATLAB", "digits", "digits of a year", "RTKLIB", "Xsens", "WinADCP", "Nucleus",
         "UDAS", "date before", "of midnight", "NTP", "SBG", "unit alone", "minutes",
         "merged cells", "types", "ERDDAP", "Markdown", "Go", "R's rows", "local and UTC", "notations", "pandas",
         "the finer one behind", "the finer one before", "doy", "Julian day", "slashes", "a dash", "no start"],
)  # fmt: skip
def test_a_heading_is_read_with_its_time(tmp_path: Path, names: str, row: str) -> None:
    rows: list[str] = []
    for k in range(4):
        t, clock = T0_S + k, f"26:{40 + k}"
        gps = f"26:{58 + k}" if k < 2 else f"27:0{k - 2}"  # 18 s ahead
        values = {"t": t, "h": 10.5 + k, "sod": 44800 + k, "utc": clock, "gps": gps, "hms": clock.replace(":", ",")}
        values["j2000"] = t - 946_684_800
        values |= {"doy": f"{257 + (44800 + k) / 86400:.12f}", "ntp": t + 2_208_988_800}
        values |= {
            "min": f"{t // 60}{t % 60 / 60:.12f}".replace("0.", ".", 1),
            "day": "13.09.2020" * (k == 0),
            "row": k + 1,
        }
        values["all"] = f"12{clock.replace(':', '')}"
        rows.append(row.format(**values, d=f"{t / 1e9:.9f}D+09"))
    log = read_log(saved(tmp_path / "compass.csv", "\n".join([names, *rows]) + "\n"))

    assert log.start_ns == T0_S * SECOND
    table = log.tables["compass"][["time_s", "heading_deg"]]
    assert table.to_numpy().tolist() == [[float(k), 10.5 + k] for k in range(4)]
    assert not [one for one in log.findings if "as UTC" in one.text]


BESIDE = {"dvl": DVL, "compass": HEADINGS, "usbl": FIX}
PROPOSED = [  # files, their names and rows; their sensors, and the keys of the first: which name it has
    ("a50", "time,vx,vy,status,time_of_validity", "200,1.5,0.5,0,{t}000000", "dvl", "time_unix_us:4 x:1 y:2"),
    ("dvl_0", "timestamp,velocity[0],velocity[1]", "{t}000000,1.5,0.5", "dvl", "time_unix_us:0 x:1 y:2"),
    ("1_vehicle_visual_odometry_0", "timestamp,velocity[0],velocity[1]", "{t}000000,1.5,0.5", "dvl",
     "time_unix_us:0 x:1 y:2"),
    ("DVL1000.bt", "dateTime,timestamp,velocityX,velocityY", "13/09/2020 14:26:40,{t}.5,1.5,0.5", "dvl",
     "time_unix_s:1 x:2 y:3"),
    ("nortek", "timestampPosix,velocityX,velocityY,xVelocityIsValid,yVelocityIsValid,varX", "{t},1.5,0.5,1,1,0", "dvl",
     "time_unix_s:0 x:1 y:2 valid:3"),
    ("Nortek_BT", "dateTime,velX,velY,timeVel1", "13/09/2020 12:27:{k:02},1.5,0.5,0.1", "dvl", "time_unix_s:0 x:1 y:2"),
    ("plot", "receive time,header.stamp,/dvl/data.velocity.x,/dvl/data.velocity.y", "{t}.5,{t},1.5,0.5", "dvl",
     "time_unix_s:1 x:2 y:3"),
    ("log", "Time [s],Gyro,DVL fwd [m/s],DVL stbd [m/s]", "{t},1{k}.5,1.5,0.5", "compass dvl",
     "time_unix_s:0 heading:1"),
    ("log", "t [s],yaw_enu [rad]", "{t},0.{k}", "compass", "time_unix_s:0 heading:1"),
    ("nav", "Time [s],ROV Easting [m],ROV Northing [m],Vessel Easting [m],Vessel Northing [m]", "{t},{e},{n},7,8",
     "usbl", "time_unix_s:0 x:1 y:2"),
    ("nav", "Time [s],Ship N,Ship E,ROV N,ROV E", "{t},7,8,{n},{e}", "usbl", "time_unix_s:0 x:4 y:3"),
    ("nav", "Time [s],ROV E,ROV N,USBL E,USBL N", "{t},7,8,{e},{n}", "usbl", "time_unix_s:0 x:3 y:4"),
    ("dykk", "Time [s],HiPAP Nord,HiPAP Øst", "{t},{n},{e}", "usbl", "time_unix_s:0 x:2 y:1"),
    ("nav", "Time [s],USBL Hochwert,USBL Rechtswert", "{t},{n},{e}", "usbl", "time_unix_s:0 x:2 y:1"),
    ("nav", "Time [s],ROV Lat (dd mm.mmm),ROV Lon (ddd mm.mmm)", "{t},45 00.{n} N,7 00.{e} E", "usbl",
     "time_unix_s:0 lat_deg:1 lon_deg:2"),
    ("ROV_track", "Time [s],Latitude,Longitude", "{t},45.{n},7.{e}", "usbl", "time_unix_s:0 lat_deg:1 lon_deg:2"),
    ("pinpoint", "Time [s],Beacon Id,Range (m),Easting (m),Northing (m)", "{t},5,30,{e},2", "usbl",
     "time_unix_s:0 x:3 y:4 target:1"),
    ("sinaps_positions", "Time [s],remote_address,x,y,integrity", "{t},2,{e},2,120", "usbl",
     "time_unix_s:0 x:2 y:3"),
    ("position_acoustic_filtered", "Time [s],x,y,z", "{t},{e},2,5", "usbl", "time_unix_s:0 x:1 y:2"),
    ("position_acoustic_raw position_acoustic_filtered", "Time [s],x,y", "{t},{e},2", "usbl", "time_unix_s:0 x:1 y:2"),
]  # fmt: skip


@pytest.mark.parametrize(("files", "names", "row", "sensors", "keys"), PROPOSED)
def test_columns_of_other_programs_are_proposed(tmp_path, files, names, row, sensors, keys):
    rows = "".join(row.format(t=T0_S + k, e=500 + k, n=700 - k, k=k) + "\n" for k in range(30))
    beside = {name: text for name, text in BESIDE.items() if name not in sensors}
    write_csv(tmp_path, **beside, **dict.fromkeys(files.split(), f"{names}\n{rows}"))

    stated = tomllib.loads(drafted(tmp_path))[sensors.split()[0]]

    wanted = {key: names.split(",")[int(place)] for key, place in (one.split(":") for one in keys.split())}
    assert stated["columns"] == wanted
    assert stated["topic"] == f"/{files.split()[0]}"
    assert "enu" not in names or stated["convention"] == "ENU"


def test_times_since_power_on_are_times_in_the_unit_of_their_name(tmp_path: Path) -> None:
    log = read_log(saved(tmp_path / "compass.csv", "time_boot_us,Heading (deg)\n3900000000,10.5\n3900500000,11.5\n"))

    assert columns(log, ["compass.time_s"]) == {"compass.time_s": [0.0, 0.5]}


@pytest.mark.parametrize(
    ("begin", "said"),
    [
        (b"FTP NEW 2 \r\nVER 16.1.0\r\n", "is a Hypack raw file"),
        (b"\xed\xa1\xda\x01" + bytes(90), "is an LCM log"),
        (b"2026-05-14 09:30:00.00: ATT {TimeUS : 120000000, Roll : 0.0}\n", "is what mavlogdump prints; read the .BIN"),
        (b"-- PostgreSQL database dump\nSET client_encoding = 'UTF8';\n", "is a dump of a database"),
    ],
)
def test_what_cannot_be_read_is_named(tmp_path: Path, begin: bytes, said: str) -> None:
    assert said in refusal(LogError, open_reader, saved(tmp_path / "dive.raw", begin * 20))


def test_a_foreign_file_beside_tables_is_named_with_what_to_do(tmp_path: Path) -> None:
    write_csv(tmp_path, dvl=DVL)
    (tmp_path / "0001_0930.RAW").write_text("FTP NEW 2 \nVER 16.1.0\n" * 20, encoding="ascii")

    (finding,) = open_reader(tmp_path).findings()

    assert finding.text.startswith("0001_0930.RAW is not read: it is a Hypack raw file; export the positions")
    assert not finding.lost_data


def test_rows_of_another_table_are_named_with_what_to_do(tmp_path: Path) -> None:
    rows = f"Time [s],Heading (deg)\n{T0_S},10.5\nTime [s],Depth (m)\n{T0_S},3\n{T0_S + 1},3\n"
    (lost,) = [one for one in read_log(saved(tmp_path / "compass.csv", rows)).findings if one.lost_data]

    said = "it belongs to a table of other columns (Time [s], Depth (m)); save each table as a file of its own"
    assert lost.text == f"compass.csv: 2 of 3 rows are left out: line 4: {said}; so are lines 5"


@pytest.mark.parametrize("end", [f"{T0_S + 2}\n", "(2 rows)\n1600000002,12.5\n", "1600000002,12"])
def test_a_last_line_that_may_be_a_cut_row_is_lost_data(tmp_path: Path, end: str) -> None:
    log = read_log(saved(tmp_path / "compass.csv", f"Time [s],Heading (deg)\n{T0_S},10.5\n{T0_S + 1},11.5\n{end}"))

    assert [one.lost_data for one in log.findings if one.code != "COLUMNS-BY-NAME"] == [True]


@pytest.mark.parametrize("names", ["Easting [m],Northing [m]", "USBL E,USBL N"])
@pytest.mark.parametrize(
    "line",
    ["# UTM zone 32N", "Projection: WGS84 UTM Zone 32 North;;", "; projection UTM (N) zone 32", "Grid,EPSG:32632"],
)
def test_the_grid_that_a_line_before_the_names_states_is_proposed(tmp_path: Path, line: str, names: str) -> None:
    fixes = "".join(f"{T0_S + k},500000.0,{4_983_000 + k:.1f}\n" for k in range(30))
    write_csv(tmp_path, dvl=DVL, compass=HEADINGS, usbl=f"{line}\nTime [s],{names}\n{fixes}")

    written = drafted(tmp_path).replace('# grid = "', 'grid = "')  # without pyproj
    assert tomllib.loads(written)["usbl"]["grid"] == "EPSG:32632"


@pytest.mark.parametrize(("beside", "kind"), [("Target Name", "usbldr/usbl"), ("Note", "")])
def test_targets_of_a_usbl_system_are_fixes(tmp_path: Path, beside: str, kind: str) -> None:
    write_csv(tmp_path, export=f"Time [s],{beside},Target Easting [m],Target Northing [m]\n{T0_S},ROV,1.5,2.5\n")

    assert [topic.type for topic in open_reader(tmp_path).topics()] == [kind]


@pytest.mark.parametrize(
    ("file", "names", "cells", "vehicle_m"),
    [
        ("APOS_TP_B21", "Latitude [deg],Longitude [deg],Depth", "45.5,7.5,20", []),
        ("hipap", "Slant Range [m],Bearing [deg],Depth [m]", "25,90,20", []),
        ("log", "USBL Range [m],USBL Bearing [deg],USBL Depth [m]", "25,90,20", []),
        ("usbl", "Lat [deg],Lon [deg],Heading (deg),Depth [m]", "45.5,7.5,30,12", [12.0]),
    ],
)
def test_the_depth_of_a_fix_is_no_depth_of_the_vehicle(tmp_path, file, names, cells, vehicle_m):
    """One without a unit is left out; in a table of other sensors, too, it is the vehicle's."""
    rows = f"Time [s],{names}\n" + "".join(f"{T0_S + k},{cells}\n" for k in range(3))
    toml = "[usbl]\nhead = { east_m = 0, north_m = 0, depth_m = 5 }\n" if "Range" in names else ""
    log = logged_csv(tmp_path, toml, **{file: rows})

    assert [*log.tables["depth"]["depth_m"].unique()] == vehicle_m if vehicle_m else "depth" not in log.tables
    if toml:
        np.testing.assert_allclose(log.tables["usbl"]["east_m"], 20.0)  # 25 m, 15 m below the head


NO_NUMBER = f"Time [s],Heading (deg)\n{T0_S},1 bar\n{T0_S + 1},\n{T0_S + 2},2 bar\n"
OF_APOS = "".join(f"{T0_S + k},M{k % 2},{45 + k % 2},7\n" for k in range(4))


@pytest.mark.parametrize(
    ("name", "text", "fault", "said"),
    [
        ("compass", NO_NUMBER, LogError, r'line 2: Heading \(deg\) is "1 bar", not a number$'),
        ("depth", 'Time [s],Depth (m)\n1,"1,250"\n2,"1,251"\n', LogError, r'Depth \(m\) is "1,250", not a number'),
        ("usbl", 'Time [s],Position\n1,"45.1, 7.2"\n', LogError, r"in the cells of Position \(45.1, 7.2\); write each"),
        ("usbl", "Time [s],Position\n1,45-30.0N 007-12.0E\n", LogError, "several values in the cells of Position"),
        ("usbl", "Time [s],place\n1,POINT (7.2 45.1)\n", LogError, "several values in the cells of place"),
        ("dvl", 'Time [s],velocity\n1,"[1.5, 0.5]"\n', LogError, "several values in the cells of velocity"),
        ("dvl", 'Time [s],data\n1,"{""x"": 1.5}"\n', LogError, "several values in the cells of data"),
        ("APOS_positions", f"Time [s],TP name,Latitude [deg],Longitude [deg]\n{OF_APOS}", UsageError,
         r"2 targets: M0 \(2 fixes\), M1 \(2 fixes\)"),
    ],
)  # fmt: skip
def test_rows_of_several_devices_or_without_one_number_are_refused(tmp_path, name, text, fault, said):
    with pytest.raises(fault, match=said):
        read_log(write_csv(tmp_path, **{name: text}))


@pytest.mark.parametrize("before", ["", "2020/09/13 12:26:40.1 ", "2020-09-13T12:26:40.100Z,", "1600000000.1;"])
def test_lines_of_pd6_may_follow_the_time_of_a_logger(tmp_path: Path, before: str) -> None:
    lines = [":SA, +0.00, +0.00, 12.50", ":TS,20091312264000,35.0,+15.0,20.0,1500.0,  0", ":BS,  +250, +1500,    +0,A"]
    log = open_reader(saved(tmp_path / "dvl.log", "".join(f"{before}{line}\r\n" for line in lines * 3)))

    assert (log.format, [(topic.name, topic.count) for topic in log.topics()]) == ("PD6 text", [("/BS", 3)])


@pytest.mark.parametrize("place", ["lat_deg,lon_deg", "east_m,north_m"])
def test_positions_and_headings_of_a_ship_in_one_table_are_two_topics_of_it(tmp_path: Path, place: str) -> None:
    folder = write_csv(tmp_path, ship=f"time_ns,{place},heading_deg\n{T0},45,7,30\n")

    assert {one.name for one in open_reader(folder).topics()} == {"/ship/compass", "/ship/gps"}


def test_init_says_why_a_file_that_is_named_for_a_missing_sensor_is_not_read(tmp_path: Path) -> None:
    folder = write_csv(tmp_path / "dive", dvl=DVL, compass=HEADINGS)
    (folder / "usbl.json").write_text('{"type": "FeatureCollection", "features": [' + 9999 * "{}, " + "{}]}")

    assert '# topic = "?"                           # CHECK: usbl.json is not read: is JSON, but' in drafted(folder)


PAIR = '{{"time": "{}", "position": [{:.8f}, {:.8f}]}}\n'
FEATURE = '{{"type": "Feature", "properties": {{"time": "{0}"}}, "geometry": {{"coordinates": [{2:.8f}, {1:.8f}]}}}}\n'
JSON = {"position[0]": PAIR, "geometry.coordinates[1]": FEATURE, "a collection": FEATURE}


@pytest.mark.parametrize(
    ("lat", "lon", "unit"),
    [
        (59.0, 10.5, "rad"),
        (0.5, 1.2, "deg"),
        (59.0, 10.5, "Y"),
        (59.0, 10.5, "X"),
        *((59.0, 10.5, unit) for unit in JSON),
    ],
)
def test_positions_without_a_unit_are_in_the_one_that_fits_the_velocities(tmp_path, lat, lon, unit):
    """Circles of 60 m at 1 m/s: 111.2 km are a degree of latitude. X and Y are degrees, too; ``unit``: the latitude."""
    t = np.arange(400)
    turned = t / 60
    north_deg, east_deg = np.sin(turned) * 60 / 111.2e3, (1 - np.cos(turned)) * 60 / 111.2e3
    places = np.column_stack([lat + north_deg, lon + east_deg / np.cos(np.radians(lat))])
    places = np.radians(places) if unit == "rad" else places
    fixes = "".join(f"{T0_S + k},{a:.10f},{b:.10f}\n" for k, (a, b) in zip(t, places, strict=True))
    headings = "".join(
        f"{(T0_S + k) * SECOND},{angle:.3f}\n" for k, angle in zip(t, np.degrees(turned) % 360, strict=True)
    )
    velocities = "".join(f"{(T0_S + k) * SECOND},1,0\n" for k in t)
    sheets = {"dvl": f"{DVL.partition(chr(10))[0]}\n{velocities}", "compass": f"time_ns,heading_deg\n{headings}"}
    names = {"Y": "time,Y,X", "X": "time,X,Y"}.get(unit, "time,lat,lon")
    folder = write_csv(tmp_path / "dive", **sheets, usbl=f"{names}\n{fixes}", gps=f"{names}\n{fixes}")
    for file in (folder / "usbl.csv", folder / "gps.csv") if unit in JSON else ():
        rows = zip(pd.to_datetime(T0_S + t, unit="s"), places, strict=True)
        texts = [JSON[unit].format(when.isoformat(), *at) for when, at in rows]
        whole = '{"type": "FeatureCollection",\n"features": [\n' + ",".join(texts) + "]}"
        file.with_suffix(".geojson").write_text(whole if unit == "a collection" else "".join(texts))
        file.unlink()

    draft = drafted(folder)

    proposed = {tomllib.loads(draft)[sensor]["columns"]["lat_deg"] for sensor in ("usbl", "gps")}
    named = {"rad": "lat [rad]", "deg": "lat", "a collection": "geometry.coordinates[1]"}
    assert proposed == {named.get(unit, unit)}
    log = read_as(folder, draft)
    assert log.tables["gps"][["lat_deg", "lon_deg"]].iloc[0].tolist() == pytest.approx([lat, lon], abs=1e-7)
    assert ("POSITION-RADIANS" in {one.code for one in log.findings}) == (unit == "deg")


@pytest.mark.parametrize("names", ["Range [m],Bearing [deg]", "Beacon,X [m],Y [m]"])
def test_init_places_fixes_from_the_ship_beside_them(tmp_path: Path, names: str, monkeypatch) -> None:
    """Circles of 60 m at 1 m/s, north-east of a ship that turns and goes north; bearings count from its bow."""
    identified: list[object] = []  # logs: once, however many places of the head are tried
    monkeypatch.setattr("usbldr.io.doctor.cross_check._identified", lambda log, *_: identified.append(log))
    t = np.arange(120)
    turned, ship_deg, ship_m = t / 60, 20 * np.sin(t / 40), 0.2 * t
    east, north = 160 + (1 - np.cos(turned)) * 60, 90 + np.sin(turned) * 60 - ship_m
    bow_deg = np.degrees(np.arctan2(east, north)) - ship_deg
    away, bow = np.hypot(east, north), np.radians(bow_deg)
    cells = [away, bow_deg] if "Bearing" in names else [0 * t, away * np.sin(bow), away * np.cos(bow)]
    rows = zip(t + T0_S, *cells, 45 + ship_m / 111_131.8, 0 * t - 30, ship_deg % 360, strict=True)
    fixes = "".join(",".join(f"{cell:.7f}" for cell in row) + "\n" for row in rows)
    headings = zip(t + T0_S, np.degrees(turned) % 360, strict=True)
    sheets = {"dvl": "time_ns,forward_mps,starboard_mps\n" + "".join(f"{T0_S + k}000000000,1,0\n" for k in t)}
    sheets["compass"] = "time_ns,heading_deg\n" + "".join(f"{k}000000000,{angle:.3f}\n" for k, angle in headings)
    ship = "Ship Lat [deg],Ship Lon [deg],Ship Heading [deg]"
    folder = write_csv(tmp_path / "dive", **sheets, usbl=f"Time [s],{names},{ship}\n{fixes}")

    draft = drafted(folder)

    assert len(identified) == 1
    assert 'head = { topic = "/usbl/ship/gps", heading_topic = "/usbl/ship/compass" }' in draft
    assert 'frame = "body"' in draft
    assert places(read_as(folder, draft)) == pytest.approx(np.column_stack([east, north + ship_m]), abs=0.2)


PANEL = """[compass]
columns = { time_unix_s = "t", heading = "Heading" }
[depth]
columns = { time_unix_s = "t", depth_m = "Depth" }
"""
OF_AUTOPILOT = '[gps]\ncolumns = { time_unix_s = "time", lat_deg = "lat", lon_deg = "lon" }\n'
MINUTES = OF_AUTOPILOT.replace('"lat"', '"Lat (ddmm.mmmm)"').replace('"lon"', '"Lon (dddmm.mmmm)"')
MINUTES = MINUTES.replace(" }", ', lat_side = "N/S", lon_side = "E/W" }')
NANO = "UTC_Year,UTC_Month,UTC_Day,UTC_Hour,UTC_Minute,UTC_Second,UTC_Nano,Heading (deg)\n"


@pytest.mark.parametrize(
    ("toml", "file", "text", "wanted"),
    [
        # 20 cm is not one of metres, and its row is left out
        (PANEL, "panel", f"t,Heading,Depth\n{T0_S},1.5 deg,2.5 m\n{T0_S + 1},2.5 deg,20 cm\n",
         {"compass.heading_deg": [1.5], "depth.depth_m": [2.5]}),
        ("", "compass", f"Time [s],GPS Heading (deg),C True Heading (deg)\n{T0_S},1,2\n", {"compass.heading_deg": [2]}),
        ("", "compass", f"Time [s],Heading true [deg],Heading mag [deg]\n{T0_S},1,2\n", {"compass.heading_deg": [1]}),
        ("", "compass", NANO + "".join(f"2020,9,13,12,26,{40 + k},{250_000_000 * k},10\n" for k in range(3)),
         {"compass.time_s": [0.0, 1.25, 2.5]}),
        ('[compass]\ncolumns = { time_unix_s = "1", heading = "4" }', "compass",
         "".join(f"{T0_S + k},{250_000_000 * k},imu,10\n" for k in range(3)), {"compass.time_s": [0.0, 1.25, 2.5]}),
        ("", "nav", f'Time [s],Heading (deg),Depth (m)\n"{T0_S},000","10,0","1,250"\n"{T0_S + 1},000","10,1","1,2"\n',
         {"compass.heading_deg": [10.0, 10.1], "depth.depth_m": [1.25, 1.2]}),
        ("", "usbl", "Chantier\nHeure;USBL East [m];USBL North [m]\n13.09.2020 12:26:40;597 402,12;4 983 000,5\n",
         {"usbl.east_m": [597402.12], "usbl.north_m": [4983000.5]}),
        (MINUTES, "gps", f"time,Lat (ddmm.mmmm),N/S,Lon (dddmm.mmmm),E/W\n{T0_S},4530.0000,S,00715.0000,E\n",
         {"gps.lat_deg": [-45.5], "gps.lon_deg": [7.25]}),
        (OF_AUTOPILOT, "gps", f"time,lat,N/S,lon,E/W\n{T0_S},4530.0000,S,00715.0000,W\n",
         {"gps.lat_deg": [-45.5], "gps.lon_deg": [-7.25]}),
        (OF_AUTOPILOT, "gps", f"time,lat,lon\n{T0_S},45.0,\u22127.0\n", {"gps.lon_deg": [-7.0]}),
        # as autopilots write them, beyond all degrees and minutes
        (OF_AUTOPILOT, "gps", f"time,lat,lon\n{T0_S},450000000,-70000000\n{T0_S + 1},450000360,-70000000\n",
         {"gps.lat_deg": pytest.approx([45.0, 45.000036]), "gps.lon_deg": pytest.approx([-7.0, -7.0])}),
    ],
    ids=["units in cells",  "the heading that is true", "not magnetic", "nanoseconds", "ROS 2", "decimal commas",
         "thousands", "notations", "sides that are not stated", "minus signs", "ten millionths of degrees"],
)  # fmt: skip
def test_values_are_those_that_names_and_cells_mean(tmp_path, toml, file, text, wanted):
    log = logged_csv(tmp_path, toml, **{file: text})

    assert columns(log, wanted) == wanted
    assert log.start_ns == T0


@pytest.mark.parametrize("unit", ["", " (deg)"])
def test_of_two_true_headings_the_sentence_chooses_one(tmp_path: Path, unit: str) -> None:
    """As an iVer writes them; that of the GPS is its course."""
    names = f"Time (s),DFS Depth (m),GPS True Heading{unit},Compass True Heading{unit},C True Heading{unit}"
    rows = "".join(f"{T0_S + k},9,1,{20 + k},30\n" for k in range(5))
    folder = write_csv(tmp_path, compass=f"{names}\n{rows}")

    said = refusal(LogError, read_log, folder)
    line = said.partition("choose one under [compass]: ")[2]

    assert f"(Compass True Heading{unit}, C True Heading{unit})" in said
    log = read_as(folder, f"[compass]\n{line}\n")
    assert log.tables["compass"]["heading_deg"].tolist() == [20, 21, 22, 23, 24]


@pytest.mark.parametrize(
    ("names", "straight"),
    [("q[0],q[1],q[2],q[3]", False), ("q[0],q[1],q[2],q[3]", True), ("q_0,q_1,q_2,q_3", False), ("qw,qx,qy,qz", False)],
)
def test_quaternions_and_microseconds_of_an_autopilot_are_proposed(tmp_path: Path, names: str, straight: bool) -> None:
    """A folder of ulog2csv: half a heading's sine and cosine turn north to the bow; the vehicle's clock times all.

    Straight on, a compass that swings fits noisy fixes a little worse than headings that another order makes constant.
    """
    turned = np.radians(100 + (2 * np.sin(np.arange(30) / 3) if straight else np.arange(30.0)))
    way = np.full(30, np.radians(100.0)) if straight else turned
    noise_m = np.random.default_rng(3).normal(0.0, 0.5 * straight, (2, 30))
    half, north_m, east_m = turned / 2, np.cumsum(np.cos(way)) + noise_m[0], np.cumsum(np.sin(way)) + noise_m[1]
    lat, lon = 45 + 9e-6 * north_m, 7 + 9e-6 * east_m / np.cos(np.radians(45))
    rows = [f"{30_000_000 + k * 10**6}" for k in range(30)]
    turns = [f"{t},{t},{np.cos(h):.6f},0,0,{np.sin(h):.6f}\n" for t, h in zip(rows, half, strict=True)]
    places = [f"{t},{(T0_S + k) * 10**6},{round(lat[k] * 1e7)},{round(lon[k] * 1e7)}\n" for k, t in enumerate(rows)]
    write_csv(
        tmp_path / "dive",
        vehicle_attitude_0=f"timestamp,timestamp_sample,{names}\n{''.join(turns)}",
        vehicle_gps_position_0=f"timestamp,time_utc_usec,lat,lon\n{''.join(places)}",
        dvl="timestamp,vx,vy,vz\n" + "".join(f"{t},1,0,0\n" for t in rows),
        usbl="timestamp,lat,lon\n" + "".join(f"{t},{lat[k]:.7f},{lon[k]:.7f}\n" for k, t in enumerate(rows)),
    )

    draft = drafted(tmp_path / "dive")

    columns = {role: tomllib.loads(draft)[role]["columns"] for role in ("dvl", "compass", "usbl", "gps")}
    assert {one["time_unix_us"] for one in columns.values()} == {"timestamp"}
    assert ",".join(columns["compass"][f"q{part}"] for part in "wxyz") == names
    heading = read_as(tmp_path / "dive", draft, Request(set_keys=("compass.convention=NED",))).tables["compass"]
    assert heading["heading_deg"].tolist() == pytest.approx(np.degrees(turned).tolist(), abs=1e-3)


@pytest.mark.parametrize("column", ["vehicle", "Vehicle ID", "Beacon No", "Object"])
@pytest.mark.parametrize("units", [" [deg]", ""])
def test_the_line_that_the_refusal_of_two_vehicles_states_chooses_one(tmp_path: Path, column: str, units: str) -> None:
    rows = "".join(f"{T0_S + k},{('ROV', 'TMS')[k % 2]},{45 + k % 2},7\n" for k in range(10))
    write_csv(tmp_path, usbl=f"Time [s],{column},lat{units},lon{units}\n{rows}")
    named = f'columns = {{ time_unix_s = "Time", target = "{column}", lat_deg = "lat", lon_deg = "lon" }}\n'

    said = refusal(UsageError, read_as, tmp_path, "" if units else f"[usbl]\n{named}")
    line = said.partition("choose one under [usbl]: ")[2]
    log = read_as(tmp_path, f"[usbl]\n{line}\n{'' if units else named}")

    assert "2 targets: ROV (5 fixes), TMS (5 fixes)" in said
    assert log.origin.lat_deg == 45
    assert len(log.tables["usbl"]) == 5


@pytest.mark.parametrize(
    ("column", "words"),
    [("Solution", ["Fixed", "Float"]), ("Mode", ["Survey", "Transit"]), ("Words", [f"word {k}x" for k in range(9)]),
     ("Words", ["AUTO"] * 10 + ["HOLD"] * 10), ("Words", ["good", "bad"])],
)  # fmt: skip
def test_words_that_change_from_row_to_row_may_be_no_devices(tmp_path: Path, column: str, words: list[str]) -> None:
    """They are of a state, too many, change seldom, or judge."""
    rows = "".join(f"{T0_S + k},{words[k % len(words)]},{45 + 1e-5 * k},7\n" for k in range(20))
    write_csv(tmp_path, usbl=f"Time [s],{column},lat [deg],lon [deg]\n{rows}")

    log = read_log(tmp_path)

    assert len(log.tables["usbl"]) == 20
    assert not [one.text for one in log.findings if f"from {column}" in one.text]


def test_two_vehicles_that_take_turns_are_refused_also_in_stated_columns(tmp_path: Path) -> None:
    rows = "".join(f"{T0_S + k},{('MV Otter', 'ROV')[k % 2]},{45 + 1e-3 * (k % 2)},7\n" for k in range(10))
    write_csv(tmp_path, usbl=f"Time [s],Object,lat,lon\n{rows}")
    named = '[usbl]\ncolumns = { time_unix_s = "Time", lat_deg = "lat", lon_deg = "lon" }\n'

    assert "2 targets: MV Otter (5 fixes), ROV (5 fixes)" in refusal(UsageError, read_as, tmp_path, named)


def test_an_arrow_file_of_several_batches_is_read_whole(tmp_path: Path) -> None:
    time_s, heading_deg = [float(T0_S + k) for k in range(10)], [10.5 * k for k in range(10)]
    table = pd.DataFrame({"Time [s]": time_s, "Heading (deg)": heading_deg})
    table.to_feather(tmp_path / "compass.arrow", chunksize=4)

    found = read_log(tmp_path / "compass.arrow").tables["compass"]

    assert found["heading_deg"].tolist() == heading_deg
    assert found["time_s"].tolist() == list(range(10))


def test_a_table_that_cannot_be_read_leaves_the_others(tmp_path: Path) -> None:
    heading = "".join(f"{T0_S + k},{k}\n" for k in range(10))
    notes = f"Time [s],Note,Note\n{T0_S},calm,sea\n"
    write_csv(tmp_path, compass=f"Time [s],Heading (deg)\n{heading}", notes=notes)

    assert len(read_log(tmp_path).tables["compass"]) == 10


@pytest.mark.parametrize(("last", "lost"), [("ERROR", True), ("Mean:", False)])
def test_a_word_instead_of_the_last_time_is_lost_data_unless_it_is_a_summary(tmp_path: Path, last: str, lost: bool):
    heading = "".join(f"{T0_S + k},{k}\n" for k in range(10))
    write_csv(tmp_path, compass=f"Time [s],Heading (deg)\n{heading}{last},4\n")

    (found,) = (one for one in read_log(tmp_path).findings if one.code == "UNDECODED")
    assert found.lost_data == lost


@pytest.mark.parametrize("who", ["device_id", "sensor", "Vehicle", "Source", "Serial No", "Receiver", "unit"])
@pytest.mark.parametrize(
    ("role", "names", "keys", "columns"),
    [
        ("dvl", "Forward [m/s],Starboard [m/s]", ("x", "y"), ["forward_mps", "starboard_mps"]),
        ("compass", "Heading (deg),Roll (deg),Pitch (deg)", ("heading", "roll_deg", "pitch_deg"), ["heading_deg"]),
        ("depth", "Depth (m)", ("depth_m",), ["depth_m"]),
        ("gps", "Latitude (deg),Longitude (deg)", ("lat_deg", "lon_deg"), ["lat_deg", "lon_deg"]),
    ],
)
def test_the_line_that_the_refusal_of_two_devices_states_chooses_one(tmp_path, role, names, keys, columns, who):
    count = names.count(",") + 1
    cells = [",".join(str((10 * (k % 2) + k) / 10 + c) for c in range(count)) for k in range(10)]
    write_csv(tmp_path, **{role: f"Time [s],{who},{names}\n" + "".join(
        f"{T0_S + k},{('B', 'A')[k % 2]},{row}\n" for k, row in enumerate(cells)
    )})  # fmt: skip
    stated = [f'{key} = "{name}"' for key, name in zip(keys, names.split(","), strict=True)]
    columns_line = ", ".join(['time_unix_s = "Time"', *stated, 'device = "unit"'])
    toml = f"[{role}]\n" + (f"columns = {{ {columns_line} }}\n" if who == "unit" else "")

    said = refusal(UsageError, read_as, tmp_path, toml)
    log = read_as(tmp_path, toml + said.partition(f"choose one under [{role}]: ")[2])

    assert f"/{role} holds records of 2 devices: A (5 records), B (5 records)" in said
    assert len(log.tables[role]) == 5
    assert log.convention(role, "device").value == "A"
    shown = {"lat_deg": "north_m", "lon_deg": "east_m"}
    assert (log.tables[role][shown.get(columns[0], columns[0])].diff().dropna() > 0).all()


@pytest.mark.parametrize("devices", [["1"], ["1", ""], [f"{k}" for k in range(20)]])
def test_one_device_and_numbers_of_something_else_choose_nothing(tmp_path: Path, devices: list[str]) -> None:
    rows = (f"{T0_S + k},{devices[k % len(devices)]},1,0\n" for k in range(20))
    write_csv(tmp_path, dvl=f"Time [s],device_id,Forward [m/s],Starboard [m/s]\n{''.join(rows)}")

    assert len(read_as(tmp_path, "").tables["dvl"]) == 20
    assert "/dvl holds no record of 30 (its devices: " in refusal(UsageError, read_as, tmp_path, "[dvl]\ndevice = 30")


def test_init_keeps_the_columns_of_a_table_of_two_devices_as_comments(tmp_path: Path) -> None:
    rows = "".join(f"{T0_S + k},{k % 2},1,0\n" for k in range(20))

    turns = "".join(f"{T0 + k * SECOND},{k}\n" for k in range(20))
    draft = drafted(write_csv(tmp_path, dvl=f"time,device,vx,vy\n{rows}", compass=f"time_ns,heading_deg\n{turns}"))

    assert 'holds records of 2 devices: 0 (10 records), 1 (10 records); choose one under [dvl]: device = "0"' in draft
    assert '# columns = { time_unix_s = "time", x = "vx", y = "vy" }' in draft


@pytest.mark.parametrize("names", ["lat,lon", "Latitude,Longitude", "Lat,Long", "GPS lat,GPS lon"])
@pytest.mark.parametrize("start", ["0,0", "0.000000,0.000000", ","])
@pytest.mark.parametrize("parquet", [False, True])
def test_positions_that_can_only_be_degrees_need_no_unit(tmp_path, names, start, parquet):
    rows = [f"{T0_S + k},{start if k < 2 else f'{45 + k / 1e4:.4f},-0.1'},7" for k in range(6)]
    file = write_csv(tmp_path, gps=f"time,{names},depth\n" + "\n".join(rows)) / "gps.csv"
    if parquet:
        pd.read_csv(file).to_parquet(tmp_path / "gps.parquet")
        file.unlink()

    log = read_log(tmp_path / "gps.parquet" if parquet else tmp_path)

    assert set(log.tables) == {"gps"}  # a depth needs a unit
    assert log.tables["gps"]["lat_deg"].tolist() == pytest.approx([45.0002, 45.0003, 45.0004, 45.0005])
    assert log.tables["gps"]["lon_deg"].tolist() == pytest.approx([-0.1] * 4)


@pytest.mark.parametrize("name", ["Heading", "hdg", "Heading (T)"])
@pytest.mark.parametrize(
    ("start", "read"), [("359.9", True), ("", True), ("NaN", True), ("-9999", True), ("1.5", None)]
)
@pytest.mark.parametrize("parquet", [False, True])
def test_headings_beyond_two_turns_in_radians_are_degrees(tmp_path, name, start, read, parquet):
    rows = [f"{T0_S + k},{start if k < 2 else '3.14' if read is None else 100 + k},7" for k in range(9)]
    file = write_csv(tmp_path, compass=f"time,{name},depth\n" + "\n".join(rows)) / "compass.csv"
    if parquet:
        pd.read_csv(file).to_parquet(tmp_path / "compass.parquet")
        file.unlink()

    (compass,) = open_reader(tmp_path / "compass.parquet" if parquet else tmp_path).topics()

    assert bool(compass.count) == bool(read)
    if read:
        log = read_log(tmp_path / "compass.parquet" if parquet else tmp_path)
        assert log.tables["compass"]["heading_deg"].tolist()[-7:] == [102 + k for k in range(7)]


def test_a_heading_without_a_unit_beside_velocities_is_left_to_init(tmp_path: Path) -> None:
    (dvl,) = open_reader(write_csv(tmp_path, dvl=f"time,vx,vy,heading\n{T0_S},1,0,90\n")).topics()

    assert not dvl.count


@pytest.mark.parametrize("place", ["0.7,0.1", "0,0", "4512.5,700.5", "450000000,70000000", "N 45,E 7"])
def test_positions_that_may_be_something_else_are_left_to_init(tmp_path: Path, place: str) -> None:
    rows = "".join(f"{T0_S + k},{place}\n" for k in range(6))

    (usbl,) = open_reader(write_csv(tmp_path, usbl=f"time,lat,lon\n{rows}")).topics()

    assert bool(usbl.problem) == ("N" not in place)


@pytest.mark.parametrize(
    ("unit", "pascals"), [("hPa", 100), ("kPa", 1e3), ("dbar", 1e4), ("bar", 1e5), ("psi", 6894.757)]
)
@pytest.mark.parametrize(("surface_pa", "first_m", "known"), [(101_325, 0, 1), (101_325, 20, 0), (0, 0, 0)])
def test_a_pressure_is_in_the_unit_in_which_it_begins_at_that_of_the_air(
    tmp_path, unit, pascals, surface_pa, first_m, known
):
    depths = np.arange(30) + first_m
    values = (surface_pa + depths * 1025 * 9.80665) / pascals
    rows = "".join(f"{T0_S + k},{value:.5f}\n" for k, value in enumerate(values))
    write_csv(tmp_path, dvl=DVL, usbl=FIX, compass=HEADINGS, depth=f"time,Pressure\n{rows}")

    draft = drafted(tmp_path)

    section = tomllib.loads(draft)["depth"]
    assert section["columns"] == {"time_unix_s": "time", "pressure": "Pressure"}
    assert section.get("unit") == (unit if known else None)
    assert ('# unit = "?"' in draft and "under [depth]" in draft) == (not known)
    if known:
        assert read_as(tmp_path, draft).tables["depth"]["depth_m"].tolist() == pytest.approx(list(depths), abs=0.1)


@pytest.mark.parametrize(
    ("begin", "row", "columns", "wanted"),
    [
        ("", "1  09/13/20  12:26:4{k}.0  45.100000  7.250000   12.50", "3 4 5", (45.1, 7.25)),
        ("* NaviPac custom log\n* Date Time\n", "13.09.2020, 12:26:4{k}.0, 45.1, 7.2", "2 3 4", (45.1, 7.2)),
        ("", "VFR 2020/09/13 12:26:4{k}.0 1 0 SOLN_USBL 7.25 45.1 12.5 1 0.7 0", "3 8 7", (45.1, 7.25)),
        ("", "1.60000000{k}e+09\t4.51e+01\t7.2e+00", "1 2 3", (45.1, 7.2)),
        ("# from MATLAB\n", "160000000{k};45,1;7,2", "1 2 3", (45.1, 7.2)),
    ],
)
@pytest.mark.parametrize("name", ["usbl", "nav"])
def test_columns_without_names_are_named_by_number(tmp_path, begin, row, columns, wanted, name):
    text = begin + "".join(f"{row.format(k=k)}\n" for k in range(5))
    time, lat, lon = columns.split()
    (tmp_path / f"{name}.txt").write_text(text, encoding="utf-8")

    draft = drafted(tmp_path)
    log = read_as(tmp_path, f'[usbl]\ncolumns = {{ time_unix_s = "{time}", lat_deg = "{lat}", lon_deg = "{lon}" }}\n')

    assert f'columns = {{ time_unix_s = "{time}", lat_deg = "?", lon_deg = "?" }}' in draft
    assert (log.start_ns, len(log.tables["usbl"])) == (T0, 5)
    assert (log.origin.lat_deg, log.origin.lon_deg) == pytest.approx(wanted)


@pytest.mark.parametrize(
    "line",
    [
        "Start: 2020-09-13 12:26:40 UTC",
        "# Start time: 13/09/2020 14:26:40+02:00",
        "Logger 2\nBegin;2020-09-13T12:26:40Z;",
    ],
)
@pytest.mark.parametrize(("name", "unit"), [("Time [s]", 1.0), ("time_ms", 1e3), ("Elapsed [min]", 1 / 60)])
def test_times_count_from_the_start_that_a_line_before_the_names_states(tmp_path, line, name, unit):
    rows = "".join(f"{(k + 0.5) * unit:.12f};{10.5 + k}\n" for k in range(4))

    log = read_log(saved(tmp_path / "compass.csv", f"{line}\n{name};Heading (deg)\n{rows}"))

    assert log.start_ns == T0 + SECOND // 2
    assert log.tables["compass"]["time_s"].tolist() == pytest.approx([0.0, 1.0, 2.0, 3.0], abs=1e-6)
    assert [one.text for one in log.findings if "from which its times count" in one.text]


def test_another_moment_is_no_start(tmp_path: Path) -> None:
    text = "Exported: 2021-01-01 00:00:00\nTime [s],Heading (deg)\n5,10.5\n6,11.5\n"

    assert read_log(saved(tmp_path / "compass.csv", text)).start_ns == 5 * SECOND


def test_a_union_in_an_arrow_file_is_left_out_and_dictionaries_are_read(tmp_path: Path) -> None:
    arrow, ipc = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.ipc")
    heading_deg = [10.5 * (k % 3) for k in range(6)]
    union = arrow.UnionArray.from_dense(
        arrow.array([0, 1] * 3, arrow.int8()), arrow.array([0, 0, 1, 1, 2, 2], arrow.int32()),
        [arrow.array([1, 2, 3]), arrow.array(["a", "b", "c"])],
    )  # fmt: skip
    times = arrow.array([f"2020-09-13 12:26:4{k}" for k in range(6)]).dictionary_encode()
    table = arrow.table({"time": times, "status": union, "Heading (deg)": arrow.array(heading_deg).dictionary_encode()})
    with ipc.new_file(str(tmp_path / "compass.arrow"), table.schema) as written:
        written.write_table(table)

    log = read_log(tmp_path / "compass.arrow")

    assert log.tables["compass"]["heading_deg"].tolist() == heading_deg
    (left_out,) = [one.text for one in log.findings if one.code == "NOT-READ"]
    assert "status is not read: its type is dense_union<" in left_out


@pytest.mark.parametrize("further", ["usbl{}_{}", "Beacon {} {}"])
def test_of_devices_that_differ_in_a_number_the_first_is_proposed_and_the_others_are_named(tmp_path, further):
    names = [further.format(number, axis) for number in (1, 2) for axis in "xy"]
    write_csv(tmp_path, dvl=DVL, compass=HEADINGS)
    fixes = "".join(f"{T0_S + k},{k}.5,0.5,{50 + k},70\n" for k in range(30))
    (tmp_path / "usbl.csv").write_text(f"Time [s],{','.join(names)}\n{fixes}", encoding="utf-8")

    draft = drafted(tmp_path)

    stated = tomllib.loads(draft)["usbl"]["columns"]
    assert stated == {"time_unix_s": "Time [s]", "x": names[0], "y": names[1]}
    assert f"of several devices, the first ({names[2]}, {names[3]})" in draft
