"""MAVLink messages as the recorder of BlueOS writes them: JSON with the schema of the first message of a topic."""

import math
from pathlib import Path

import numpy as np
import pytest

from blueos_recordings import Row, delta, write_blueos
from recordings import SECOND, T0
from usbldr.filters.errors import LogError, UsageError
from usbldr.io.formats.detect import open_log
from usbldr.io.reading.opening import Request
from usbldr.io.reading.read import read_log


def dive() -> list[Row]:
    rows: list[Row] = []
    for k in range(20):
        t = T0 + k * SECOND
        yaw = math.radians((350 + 2 * k + 180) % 360 - 180)
        rows += [delta(t, 1 + k / 10, -0.5, 0.0 if k == 3 else 90.0)]
        rows += [(t, "ATTITUDE", {"time_boot_ms": 1000 * k, "roll": 0.0, "pitch": 0.0, "yaw": yaw})]
        fix = "NO_FIX" if k == 5 else "3D_FIX"
        place = {"lat": 476176249 + k, "lon": -1223610207, "h_acc": 1500 if k else 0}
        rows += [(t, "GPS_RAW_INT", {"fix_type": {"type": f"GPS_FIX_TYPE_{fix}"}, **place})]
        hdg = 65535 if k == 2 else 100 * k
        rows += [(t, "GLOBAL_POSITION_INT", {"lat": 476176249, "lon": -1223610207, "hdg": hdg})]
        rows += [(t, "SCALED_PRESSURE", {"press_abs": 1013.25}), (t, "SCALED_PRESSURE2", {"press_abs": 2018.456})]
        rows += [(t, "VFR_HUD", {"alt": -10.0, "heading": 3 * k}), (t, "HEARTBEAT", {"base_mode": {"bits": 81}})]
        rows += [(t, "AHRS2", {"yaw": 0.5}), (t, "GPS_INPUT", {"fix_type": {"type": "GPS_FIX_TYPE_3D_FIX"}, **place})]
    return rows


@pytest.mark.parametrize("name", ["", "mavlink"])
def test_a_recording_of_blueos_is_read_by_its_types(tmp_path: Path, name: str) -> None:
    log = read_log(write_blueos(tmp_path / "dive.mcap", dive(), name))

    topics = {role: provenance.topic for role, provenance in log.provenance.items()}
    assert topics == {
        "dvl": "mavlink/255/0/VISION_POSITION_DELTA",
        "compass": "mavlink/1/1/ATTITUDE",
        "gps": "mavlink/1/1/GPS_RAW_INT",
        "depth": "mavlink/1/1/SCALED_PRESSURE2",
    }
    dvl, gps = log.tables["dvl"], log.tables["gps"]
    np.testing.assert_allclose(dvl["forward_mps"], 1 + np.arange(20) / 10, rtol=1e-12)
    np.testing.assert_allclose(dvl["starboard_mps"], -0.5, rtol=1e-12)
    np.testing.assert_allclose(dvl["up_mps"], -0.05, rtol=1e-12)
    assert dvl["valid"].tolist() == [k != 3 for k in range(20)]
    np.testing.assert_allclose(log.tables["compass"]["heading_deg"], (350 + 2 * np.arange(20)) % 360, atol=1e-9)
    np.testing.assert_allclose(log.tables["depth"]["depth_m"], (201845.6 - 101325) / (1025 * 9.80665), rtol=1e-12)
    assert len(gps) == 19
    assert gps["sd_m"].tolist()[1:] == pytest.approx([1.5] * 18)
    assert log.origin is not None
    assert (log.origin.lat_deg, log.origin.lon_deg) == pytest.approx((47.6176249, -122.3610207), abs=1e-12)


def test_estimates_of_the_autopilot_are_used_if_named(tmp_path: Path) -> None:
    file = write_blueos(tmp_path / "dive.mcap", dive())
    prefix = "mavlink/1/1/"

    named = {"compass": f"{prefix}GLOBAL_POSITION_INT", "usbl": f"{prefix}GPS_INPUT", "depth": f"{prefix}VFR_HUD"}
    log = read_log(file, Request(topics=named))
    assert log.tables["compass"]["heading_deg"].tolist() == [k for k in range(20) if k != 2]
    assert log.tables["depth"]["depth_m"].tolist() == [10.0] * 20
    assert len(log.tables["usbl"]) == 20
    for topic, heading_deg in (("AHRS2", math.degrees(0.5)), ("VFR_HUD", 3.0)):
        log = read_log(file, Request(topics={"compass": prefix + topic}))
        assert log.tables["compass"]["heading_deg"].iloc[1] == pytest.approx(heading_deg)


def test_distances_over_no_interval_are_invalid(tmp_path: Path) -> None:
    rows = [delta(T0 + k * SECOND, 1.0, 0.0) for k in range(3)]
    rows[1][2]["time_delta_usec"] = 0  # type: ignore[index]
    log = read_log(write_blueos(tmp_path / "dive.mcap", rows))

    assert log.tables["dvl"]["valid"].tolist() == [True, False, True]


def test_velocities_in_earth_axes_are_refused(tmp_path: Path) -> None:
    rows: list[Row] = [(T0, "VISION_SPEED_ESTIMATE", {"x": 1.0, "y": 0.0, "z": 0.0})]
    file = write_blueos(tmp_path / "dive.mcap", rows)

    with pytest.raises(UsageError, match="it holds velocities in earth axes; let the DVL send VISION_POSITION_DELTA"):
        read_log(file)
    assert [topic.name for topic in open_log(file).topics()] == ["mavlink/255/0/VISION_SPEED_ESTIMATE"]
    with pytest.raises(LogError, match="no topic /x"):
        read_log(file, Request(topics={"dvl": "/x"}))
