"""Long tables, one value a row: pandas writes them from wide ones, which they equal."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from logs import logged_csv
from recordings import SECOND, T0
from usbldr.io.decoding.collected import read_whole
from usbldr.io.formats.detect import open_log

WIDE = pd.DataFrame(
    {
        "time_s": [T0 // SECOND + k / 4 for k in range(8)],
        "dvl forward [m/s]": np.arange(1, 9) / 8,
        "dvl starboard [m/s]": -np.arange(1, 9) / 16,
        "heading [deg]": [np.nan, 1.5] * 4,  # every other time
    }
)


@pytest.mark.parametrize("order", ["time_s", "name"])
@pytest.mark.parametrize("names", [("name", "value"), ("_field", "_value"), ("Series", "Value")])
def test_a_long_table_is_the_wide_one(tmp_path: Path, order: str, names: tuple[str, str]) -> None:
    long = WIDE.melt("time_s", var_name="name", value_name="value").dropna().sort_values(order, kind="stable")
    text = long.rename(columns=dict(zip(("name", "value"), names, strict=True))).to_csv(index=False)

    log = logged_csv(tmp_path, "", dive=text)

    np.testing.assert_array_equal(log.tables["dvl"][["forward_mps", "starboard_mps"]], WIDE.iloc[:, 1:3])
    np.testing.assert_array_equal(log.tables["compass"]["heading_deg"], [1.5] * 4)
    assert np.diff(log.tables["dvl"]["time_s"]).tolist() == [0.25] * 7


def test_names_and_units_of_several_columns_are_one_name(tmp_path: Path) -> None:
    rows = [f"{T0 // SECOND},gyro,heading,{angle},rad" for angle in (0.5, 0.75)]  # twice at one time
    (tmp_path / "dive.csv").write_text("\n".join(["time_s,topic,field,value,unit", *rows, ""]), encoding="utf-8")

    log = open_log(tmp_path / "dive.csv")

    assert read_whole(log, {"/dive": ["heading_deg"]})["/dive"].columns["heading_deg"] == pytest.approx(
        np.degrees([0.5, 0.75])
    )


@pytest.mark.parametrize("who", ["device", "Source", "instrument", "sensor"])
def test_values_of_two_devices_are_not_mixed(tmp_path: Path, who: str) -> None:
    rows = "".join(
        f"{T0 // SECOND + k},{device},{name},{value + k}\n"
        for k in range(3)
        for device, name, value in [
            ("dvl", "forward [m/s]", 1),
            ("dvl", "starboard [m/s]", 0),
            ("usbl", "east [m]", 7),
            ("usbl", "north [m]", 8),
        ]
    )

    log = logged_csv(tmp_path, "", dive=f"time_s,{who},name,value\n{rows}")

    assert log.tables["dvl"]["forward_mps"].tolist() == [1, 2, 3]
    assert log.tables["usbl"][["east_m", "north_m"]].to_numpy().tolist() == [[7, 8], [8, 9], [9, 10]]


def test_parameters_and_their_values_are_no_long_table(tmp_path: Path) -> None:
    (tmp_path / "dive.csv").write_text("name,value\nrate,5\nmount,0.5\n", encoding="utf-8")

    (topic,) = open_log(tmp_path / "dive.csv").topics()

    assert "its columns match no sensor (name, value)" in topic.problem
