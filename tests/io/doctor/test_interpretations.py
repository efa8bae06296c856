"""Conventions are not judged by fixes that no interpretation fits."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from curved import FLIPPED, curved_dive, written
from usbldr.io.doctor.cross_check import convention_warnings
from usbldr.io.log import Log
from usbldr.io.reading.epochs import timeline
from usbldr.io.reading.read import Request, read_log


def through_the_water(log: Log, from_s: float, to_s: float, east_mps: float, north_mps: float) -> Log:
    """Return the log with a DVL that saw the water for a while, in a current."""
    table, compass = log.tables["dvl"], log.tables["compass"]
    time_s = table["time_s"].to_numpy()
    heading = np.radians(np.interp(time_s, compass["time_s"], np.unwrap(compass["heading_deg"], period=360.0)))
    there = (time_s >= from_s) & (time_s < to_s)
    forward_mps = there * (east_mps * np.sin(heading) + north_mps * np.cos(heading))
    starboard_mps = there * (east_mps * np.cos(heading) - north_mps * np.sin(heading))
    seen = {"forward_mps": table["forward_mps"] - forward_mps, "starboard_mps": table["starboard_mps"] - starboard_mps}
    return replace(log, tables={**log.tables, "dvl": table.assign(**seen)})


@pytest.mark.parametrize("east_mps", [-0.6, 0.6])
@pytest.mark.parametrize("north_mps", [-0.6, 0.6])
def test_an_unmodelled_current_is_no_wrong_axis(tmp_path: Path, east_mps: float, north_mps: float) -> None:
    log = through_the_water(
        read_log(written(tmp_path, curved_dive(gps=True)), Request("none")), 100.0, 200.0, east_mps, north_mps
    )

    codes = {one.code for one in convention_warnings(log, timeline(log))}

    assert not codes & FLIPPED


@pytest.mark.parametrize("imu", ["ENU", "NED"])
def test_a_wrong_heading_is_still_named_beside_a_current(tmp_path: Path, imu: str) -> None:
    log = through_the_water(
        read_log(written(tmp_path, curved_dive(imu=imu, gps=True)), Request("none")), 100.0, 130.0, 0.2, 0.1
    )

    codes = {one.code for one in convention_warnings(log, timeline(log))}

    assert ("HEADING-CONVENTION" in codes) == (imu == "NED")
