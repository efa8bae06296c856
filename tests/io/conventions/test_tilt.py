"""Tilted vehicles, whose attitude and velocity scipy turns: dead reckoning has to find the straight line they went."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from logs import logged
from recordings import IMU, SECOND, T0, Row, point, pressure, twist
from usbldr.filters.errors import UsageError
from usbldr.filters.replay.dead_reckoning import dr
from usbldr.io.log import Log
from usbldr.io.reading import role_records
from usbldr.io.reading.epochs import timeline
from usbldr.io.reading.read import Request, read_log
from usbldr.io.writers.export import export

SECONDS, HEADING_DEG, ROLL_DEG = 100, 30.0, -8.0  # roll: port down
END_M = SECONDS * np.array([np.sin(np.radians(HEADING_DEG)), np.cos(np.radians(HEADING_DEG))])


def dive(
    up_mps: float = 0.0,
    pitch_deg: float = 25.0,
    frame: str = "ENU",
    mount_deg: float = 0.0,
    levelled: bool = False,
    depth: bool = True,
    swing_deg: float = 0.0,
    imu_late_ns: int = 0,
) -> list[Row]:
    """Go 1 m/s straight ahead over the ground, rising as given, with the bow up by the pitch; the DVL is noisy.

    ``mount_deg``: heading of the IMU's x axis minus that of the bow, of an upright vehicle. ``swing_deg``: amplitude
    of the pitch, once in 40 s. ``imu_late_ns``: its clock minus that of the log.
    """
    rng, rows = np.random.default_rng(3), list[Row]()
    enu, ned = frame == "ENU", [np.cos(np.radians(HEADING_DEG)), np.sin(np.radians(HEADING_DEG)), -up_mps]
    world = [ned[1], ned[0], up_mps] if enu else ned
    for k in range(5 * SECONDS + 1):
        pitch = pitch_deg + swing_deg * np.sin(2 * np.pi * k / 200)
        angles = (90.0 - HEADING_DEG, -pitch, ROLL_DEG) if enu else (HEADING_DEG, pitch, ROLL_DEG)
        body = Rotation.from_euler("ZYX", angles, degrees=True)
        level = Rotation.from_euler("Z", angles[0], degrees=True)
        imu = body * Rotation.from_euler("Z", -mount_deg if enu else mount_deg, degrees=True)
        attitude = dict(zip("xyzw", imu.as_quat().tolist(), strict=True))
        t = T0 + k * SECOND // 5
        stamp = {"header.stamp": t + imu_late_ns}
        rows.append((t, "/imu", IMU, stamp | {f"orientation.{a}": q for a, q in attitude.items()}))
        x, y, z = (level if levelled else body).inv().apply(world) + 0.01 * rng.normal(size=3)
        rows.append(twist(t, x, y, z))
        if depth:
            rows.append(pressure(t, 101325.0 + 1025.0 * 9.80665 * (100.0 - up_mps * k / 5)))
    return rows


def settings(frame: str = "ENU", dvl: str = "") -> str:
    axes = "FLU" if frame == "ENU" else "FRD"
    return f'[compass]\nconvention = "{frame}"\n[dvl]\naxes = "{axes}"\n{dvl}\n'


def end_m(log: Log) -> np.ndarray:
    return dr(timeline(log), np.zeros(2)).position_m[-1]


@pytest.mark.parametrize("frame", ["ENU", "NED"])
@pytest.mark.parametrize("up_mps", [0.0, -0.4, 0.3])
def test_a_tilted_vehicle_goes_as_far_as_a_level_one(tmp_path: Path, frame: str, up_mps: float) -> None:
    log = logged(tmp_path, dive(up_mps, frame=frame), settings(frame))

    assert end_m(log) == pytest.approx(END_M, abs=0.3)
    assert log.tables["dvl"]["up_mps"].mean() == pytest.approx(up_mps, abs=0.005)
    assert log.convention("dvl", "level").chosen_by == "data"


def test_velocities_that_are_level_already_stay_so(tmp_path: Path) -> None:
    log = logged(tmp_path, dive(-0.4, pitch_deg=-20.0, levelled=True), settings())

    assert end_m(log) == pytest.approx(END_M, abs=0.3)
    assert log.convention("dvl", "level").value == ""


def test_the_configuration_decides_without_a_depth_and_goes_before_it(tmp_path: Path) -> None:
    rows = dive(depth=False)

    as_recorded, reported = (end_m(logged(tmp_path, rows, settings(dvl=key))) for key in ("", "level = true"))

    assert reported == pytest.approx(END_M, abs=0.3)
    assert np.linalg.norm(as_recorded - END_M) > 7  # 100 m * (1 - cos 25 deg) and a roll
    stated = end_m(logged(tmp_path, dive(), settings(dvl="level = false")))  # though there is a depth
    assert np.linalg.norm(stated - END_M) > 7


def test_an_imu_beside_the_bow_tilts_about_its_own_axes(tmp_path: Path) -> None:
    """Its x axis points to starboard, so that the vehicle's pitch is its roll."""
    log = logged(tmp_path, dive(mount_deg=90.0), settings().replace("[dvl]", "bias_deg = 90.0\n[dvl]"))

    assert log.tables["dvl"]["up_mps"].mean() == pytest.approx(0.0, abs=0.005)
    assert np.hypot(*log.tables["dvl"][["starboard_mps", "forward_mps"]].mean()) == pytest.approx(1.0, abs=0.005)


def test_levelling_by_an_attitude_that_no_record_holds_is_a_sentence(tmp_path: Path) -> None:
    heading = (T0, "/compass_hdg", "std_msgs/msg/Float64", {"data": 30.0})

    with pytest.raises(UsageError, match=r"\[dvl\] level: no record of the compass holds an attitude"):
        logged(tmp_path, [twist(T0, 1.0, 0.0), heading], "[dvl]\nlevel = true", {"compass": "/compass_hdg"})


def test_an_export_is_level_and_stays_so(tmp_path: Path) -> None:
    log = logged(tmp_path, dive(-0.4), settings())

    export(log, tmp_path / "out.mcap")
    back = read_log(tmp_path / "out.mcap", Request())

    back_dvl, dvl = (one.tables["dvl"].to_numpy(dtype=float) for one in (back, log))
    np.testing.assert_allclose(back_dvl, dvl, atol=1e-9)


@pytest.mark.parametrize("pitch_deg", [25.0, -10.0, 0.0])
def test_the_lever_arm_of_a_tilted_vehicle_tilts_with_it(tmp_path: Path, pitch_deg: float) -> None:
    starboard, forward, up = lever_m = (0.5, 1.5, -0.8)
    body = Rotation.from_euler("ZYX", (90.0 - HEADING_DEG, -pitch_deg, ROLL_DEG), degrees=True)
    upright = Rotation.from_euler("Z", 90.0 - HEADING_DEG, degrees=True)
    transponder, flat = (attitude.apply((forward, -starboard, up)) for attitude in (body, upright))
    rows = dive(pitch_deg=pitch_deg) + [
        point(T0 + k * SECOND, 7.0 + transponder[0], 3.0 + transponder[1]) for k in range(9)
    ]

    log = logged(tmp_path, rows, settings() + f"[usbl]\nlever_arm_m = {list(lever_m)}\nsd_m = 1.0\n")

    expected = np.array([7.0, 3.0]) + flat[:2]  # where the filters, which know the heading alone, expect the fix
    np.testing.assert_allclose(log.tables["usbl"][["east_m", "north_m"]], np.tile(expected, (9, 1)), atol=1e-6)


@pytest.mark.parametrize("most", [5000, 200])
def test_some_attitudes_turn_velocities_level(tmp_path: Path, most: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(role_records, "MAX_ATTITUDES", most)

    log = logged(tmp_path, dive(0.3, swing_deg=15.0), settings())

    up_mps = log.tables["dvl"]["up_mps"].iloc[:-5]  # nothing is known beyond the last attitude, 1 s before the end
    assert np.sqrt(np.mean((up_mps - 0.3) ** 2)) == pytest.approx(0.01, abs=0.002)  # the noise of the DVL


def test_attitudes_are_moved_to_log_time_with_their_headings(tmp_path: Path) -> None:
    dives = (dive(0.3, swing_deg=15.0, imu_late_ns=late) for late in (0, 7200 * SECOND))
    right, moved = (logged(tmp_path, rows, settings()) for rows in dives)

    assert moved.start_ns == right.start_ns
    np.testing.assert_array_equal(moved.tables["dvl"]["up_mps"], right.tables["dvl"]["up_mps"])


def test_records_without_orientation_have_no_attitude(tmp_path: Path) -> None:
    """Every third quaternion is that of an upright vehicle."""
    upright = {f"orientation.{axis}": float(axis == "w") for axis in "xyzw"}
    unknown = upright | {"orientation_covariance": np.full(9, -1.0)}
    rows = [
        (t, topic, kind, {**values, **unknown}) if topic == "/imu" and (t - T0) // (SECOND // 5) % 3 == 2 else row
        for row in dive(0.3)
        for t, topic, kind, values in [row]
    ]

    table = logged(tmp_path, rows, settings()).tables["dvl"]

    np.testing.assert_allclose(table["up_mps"][:-1], 0.3, atol=0.06)  # after the last attitude nothing is known
