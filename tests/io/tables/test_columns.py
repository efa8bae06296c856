"""CSV files whose columns only their owner knows, and long tables of one value a row, which pandas writes."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from logs import logged_csv, refusal
from recordings import SECOND, T0, saved, write_csv
from usbldr.filters.errors import UsageError
from usbldr.io.decoding.collected import read_whole
from usbldr.io.formats.detect import open_reader
from usbldr.io.reading.read import read_log

DVL = "epoch, vx, vy, vz, ok, sigma\n1600000000.5, 1000, -200, 30, 1, 40\n1600000001.000000001, 1100, 0, 0, 0, 40"
CONFIGURATION = """
[dvl]
columns = { time_unix_s = "epoch", x = "vx", y = "vy", z = "vz", valid = "ok", sd_mps = "sigma" }
axes = "FSD"
unit = "mm/s"
sd_mps = "message"
[compass]
columns = { time_ns = "t", received_ns = "heard", heading = "yaw" }
convention = "ENU"
unit = "rad"
[usbl]
columns = { time_ns = "t", x = "n", y = "e", sd_m = "acc" }
frame = "NED"
[depth]
columns = { time_unix_s = "sec", pressure = "p" }
unit = "bar"
"""


def dive(folder: Path, configuration: str = CONFIGURATION) -> Path:
    ahrs = f"t,heard,yaw\n{T0},{T0 + 4},0\n{T0 + 10**9},{T0 + 10**9},1.5707963267948966"
    fixes, press = f"t,n,e,acc\n{T0 + 6 * 10**8},10,-20,1.5", f"sec,p\n{T0 // 10**9},2.01325"
    write_csv(folder, velocities=DVL, ahrs=ahrs, fixes=fixes, press=press)
    (folder / "usbldr.toml").write_text(configuration, encoding="utf-8")
    return folder


def test_columns_are_read_as_the_configuration_names_them(tmp_path: Path) -> None:
    log = read_log(dive(tmp_path / "dive"))
    tables = log.tables

    np.testing.assert_allclose(tables["dvl"]["forward_mps"], [1.0, 1.1], rtol=1e-15)
    np.testing.assert_allclose(tables["dvl"]["starboard_mps"], [-0.2, 0.0], rtol=1e-15)
    np.testing.assert_allclose(tables["dvl"]["up_mps"], [-0.03, 0.0], rtol=1e-15)
    np.testing.assert_allclose(tables["dvl"]["sd_mps"], 0.04, rtol=1e-15)
    assert list(tables["dvl"]["valid"]) == [True, False]
    np.testing.assert_allclose(tables["compass"]["heading_deg"], [90.0, 0.0], atol=1e-12)
    np.testing.assert_array_equal(tables["usbl"][["east_m", "north_m"]], [[-20.0, 10.0]])
    np.testing.assert_allclose(tables["usbl"]["cov_ee_m2"], 2.25)
    np.testing.assert_allclose(tables["depth"]["depth_m"], 1e5 / (1025.0 * 9.80665), rtol=1e-12)
    stamps = [log.start_ns + round(t * 1e9) for t in tables["dvl"]["time_s"]]
    assert stamps == [1600000000500000000, 1600000001000000001]  # exact, of seconds with decimals
    assert log.start_ns == T0


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ([('x = "vx"', 'x = "vxx"')], "{0}: no topic has the columns epoch, ok, sigma, vxx, vy, vz of [dvl]: "
         "/velocities has no vxx; state topic, too"),
        ([("[dvl]", '[dvl]\ntopic = "/velocities"\n#')], None),
        ([("[dvl]", '[dvl]\ntopic = "velocities"'), ('"vx"', '"u"')],
         "{0}/velocities.csv: /velocities has no u ([dvl] columns x) (it has epoch, vx, vy, vz, ok, sigma)"),
        ([('time_unix_s = "epoch", x', "x")], "{0}/velocities.csv: [dvl] columns must name exactly one of time_ns, "
         "time_unix_us, time_unix_ms, time_unix_s, time_s, time_datenum, time_excel, time_julian, time_mjd, "
         "time_labview, time_ntp, time_filetime, time_ticks"),
    ],
)  # fmt: skip
def test_columns_that_are_not_there_are_named(tmp_path, changes, sentence):
    text = CONFIGURATION
    for was, now in changes:
        text = text.replace(was, now, 1)
    folder = dive(tmp_path / "dive", text)
    if sentence is None:
        assert len(read_log(folder).tables["dvl"]) == 2
        return

    assert refusal(UsageError, read_log, folder) == sentence.format(folder)


WIDE = pd.DataFrame(
    {
        "time_s": [T0 // SECOND + k / 4 for k in range(8)],
        "dvl forward [m/s]": np.arange(1, 9) / 8,
        "dvl starboard [m/s]": -np.arange(1, 9) / 16,
        "heading [deg]": [np.nan, 1.5] * 4,  # every other time
    }
)


@pytest.mark.parametrize("form", ["csv", "parquet"])
@pytest.mark.parametrize("order", ["time_s", "name"])
@pytest.mark.parametrize("names", [("name", "value"), ("_field", "_value"), ("Series", "Value")])
def test_a_long_table_is_the_wide_one(tmp_path: Path, order: str, names: tuple[str, str], form: str) -> None:
    long = WIDE.melt("time_s", var_name="name", value_name="value").dropna().sort_values(order, kind="stable")
    frame, file = long.rename(columns=dict(zip(("name", "value"), names, strict=True))), tmp_path / f"dive.{form}"
    (frame.to_csv if form == "csv" else frame.to_parquet)(file, index=False)

    log = read_log(file)

    np.testing.assert_array_equal(log.tables["dvl"][["forward_mps", "starboard_mps"]], WIDE.iloc[:, 1:3])
    np.testing.assert_array_equal(log.tables["compass"]["heading_deg"], [1.5] * 4)
    assert np.diff(log.tables["dvl"]["time_s"]).tolist() == [0.25] * 7


def test_names_and_units_of_several_columns_are_one_name(tmp_path: Path) -> None:
    rows = [f"{T0 // SECOND},gyro,heading,{angle},rad" for angle in (0.5, 0.75)]  # twice at one time
    log = open_reader(saved(tmp_path / "dive.csv", "\n".join(["time_s,topic,field,value,unit", *rows, ""])))

    assert read_whole(log, {"/dive": ["heading_deg"]})["/dive"].columns["heading_deg"] == pytest.approx(
        np.degrees([0.5, 0.75])
    )


@pytest.mark.parametrize("who", ["device", "Source", "instrument", "sensor"])
def test_values_of_two_devices_are_not_mixed(tmp_path: Path, who: str) -> None:
    values = {"dvl,forward [m/s]": 1, "dvl,starboard [m/s]": 0, "usbl,east [m]": 7, "usbl,north [m]": 8}
    rows = "".join(f"{T0 // SECOND + k},{of},{value + k}\n" for k in range(3) for of, value in values.items())

    log = logged_csv(tmp_path, "", dive=f"time_s,{who},name,value\n{rows}")

    assert log.tables["dvl"]["forward_mps"].tolist() == [1, 2, 3]
    assert log.tables["usbl"][["east_m", "north_m"]].to_numpy().tolist() == [[7, 8], [8, 9], [9, 10]]


def test_parameters_and_their_values_are_no_long_table(tmp_path: Path) -> None:
    (topic,) = open_reader(saved(tmp_path / "dive.csv", "name,value\nrate,5\nmount,0.5\n")).topics()

    assert "its columns match no sensor (name, value)" in topic.problem
