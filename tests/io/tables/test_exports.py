"""Files that programs of survey companies and laboratories export: read, proposed, or refused in one sentence."""

import tomllib
from pathlib import Path

import pytest

from commands import run
from logs import refusal
from recordings import SECOND, write_csv
from usbldr.filters.errors import LogError
from usbldr.io.formats.detect import open_log
from usbldr.io.reading.read import read_log

T0_S = 1_600_000_000  # 2020-09-13 12:26:40 UTC
DVL = "time_ns,forward_mps,starboard_mps\n" + "".join(f"{T0_S * SECOND + k * SECOND},1.0,0\n" for k in range(30))
FIX = "time_ns,lat_deg,lon_deg\n" + "".join(f"{(T0_S + k) * SECOND},{45 + 9e-6 * k:.7f},7\n" for k in range(30))


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
        ("%  GPST      latitude(deg)  heading(deg)", "2020/09/13 12:{gps}.000   45.1   {h}"),
        (
            "UTC_Year,UTC_Month,UTC_Day,UTC_Hour,UTC_Minute,UTC_Second,Heading (deg)",
            "2020,9,13,12,{hms},{h}",
        ),
    ],
    ids=["blank names", "pipes", "printed", "REMUS", "GPS time", "day of year", "colons", "Fortran", "RTKLIB", "Xsens"],
)
def test_a_heading_is_read_with_its_time(tmp_path: Path, names: str, row: str) -> None:
    rows: list[str] = []
    for k in range(4):
        t, clock = T0_S + k, f"26:{40 + k}"
        gps = f"26:{58 + k}" if k < 2 else f"27:0{k - 2}"  # 18 s ahead
        values = {"t": t, "h": 10.5 + k, "sod": 44800 + k, "utc": clock, "gps": gps, "hms": clock.replace(":", ",")}
        rows.append(row.format(**values, d=f"{t / 1e9:.9f}D+09"))
    (tmp_path / "compass.csv").write_text("\n".join([names, *rows]) + "\n", encoding="ascii")

    log = read_log(tmp_path / "compass.csv")

    assert log.start_ns == T0_S * SECOND
    table = log.tables["compass"][["time_s", "heading_deg"]]
    assert table.to_numpy().tolist() == [[float(k), 10.5 + k] for k in range(4)]


@pytest.mark.parametrize(
    ("name", "text", "columns"),
    [
        ("a50", "time,vx,vy,status,time_of_validity\n200,1.5,0.5,0,{us}\n", {"time_unix_us": "time_of_validity"}),
        ("dvl_0", "timestamp,velocity[0],velocity[1]\n{us},1.5,0.5\n", {"x": "velocity[0]", "y": "velocity[1]"}),
        ("nortek", "timestampPosix,velocityX,velocityY,xVelocityIsValid,yVelocityIsValid,varX\n{s},1.5,0.5,1,1,0\n",
         {"time_unix_s": "timestampPosix", "x": "velocityX", "y": "velocityY", "valid": "xVelocityIsValid"}),
        ("plot", "receive time,header.stamp,/dvl/data.velocity.x,/dvl/data.velocity.y\n{s}.5,{s},1.5,0.5\n",
         {"time_unix_s": "header.stamp", "x": "/dvl/data.velocity.x", "y": "/dvl/data.velocity.y"}),
    ],
)  # fmt: skip
def test_columns_of_a_dvl_are_proposed(tmp_path: Path, name: str, text: str, columns: dict[str, str]) -> None:
    text = text.replace("{us}", str(T0_S * 10**6)).replace("{s}", str(T0_S))
    write_csv(tmp_path, **{name: text}, compass=FIX.replace("lat_deg,lon_deg", "heading_deg,sd_deg"), usbl=FIX)

    run("init", tmp_path, "--output", tmp_path / "found.toml")

    proposed = tomllib.loads((tmp_path / "found.toml").read_text("utf-8"))["dvl"]["columns"]
    assert columns.items() <= proposed.items()


@pytest.mark.parametrize(
    ("begin", "said"),
    [
        (b"FTP NEW 2 \r\nVER 16.1.0\r\n", "is a Hypack raw file"),
        (b"\xed\xa1\xda\x01" + bytes(90), "is an LCM log"),
        (b"-- PostgreSQL database dump\nSET client_encoding = 'UTF8';\n", "is a dump of a database"),
        (b" 1  09/13/20  12:26:40.0  45.100000  7.250000   12.50\n", "has no header"),
        (b"VFR 2020/09/13 12:26:40.0 1 0 SOLN_USBL 7.25 45.1 12.5 1 0.7 0\n", "has no header"),
    ],
)
def test_what_cannot_be_read_is_named(tmp_path: Path, begin: bytes, said: str) -> None:
    (tmp_path / "dive.raw").write_bytes(begin * 20)

    assert said in refusal(LogError, open_log, tmp_path / "dive.raw")


@pytest.mark.parametrize("line", ["# UTM zone 32N", "Projection: WGS84 UTM Zone 32 North;;", "Grid,EPSG:32632"])
def test_the_grid_that_a_line_before_the_names_states_is_proposed(tmp_path: Path, line: str) -> None:
    fixes = "".join(f"{T0_S + k},500000.0,{4_983_000 + k:.1f}\n" for k in range(30))
    fixes = f"{line}\nTime [s],Easting [m],Northing [m]\n{fixes}"
    write_csv(tmp_path, dvl=DVL, compass=FIX.replace("lat_deg,lon_deg", "heading_deg,sd_deg"), usbl=fixes)

    run("init", tmp_path, "--output", tmp_path / "found.toml")

    written = (tmp_path / "found.toml").read_text("utf-8").replace('# grid = "', 'grid = "')  # without pyproj
    assert tomllib.loads(written)["usbl"]["grid"] == "EPSG:32632"


@pytest.mark.parametrize(("beside", "kind"), [("Target Name", "usbldr/usbl"), ("Note", "")])
def test_targets_of_a_usbl_system_are_fixes(tmp_path: Path, beside: str, kind: str) -> None:
    write_csv(tmp_path, export=f"Time [s],{beside},Target Easting [m],Target Northing [m]\n{T0_S},ROV,1.5,2.5\n")

    (topic,) = open_log(tmp_path).topics()

    assert topic.type == kind
