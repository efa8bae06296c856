"""Every kind of GPS message and of depth message, by a record that its own driver could have written."""

import math
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from rosbags.rosbag2 import StoragePlugin

from autopilot_recordings import DEFINITIONS, write_packets, write_rows
from blueos_recordings import write_blueos
from dvl_recordings import ensemble
from imc_recordings import imcpy, sent, write_messages
from logs import MAP, codes, logged, only
from recordings import (
    HEADER,
    HEADING,
    ODOMETRY,
    POSE,
    POSE_COVARIANCE,
    SECOND,
    T0,
    Row,
    define,
    fields,
    fix,
    record,
    saved,
    saved_lines,
    sentence,
    write_bag,
    write_mcap,
    write_rosbag2,
)
from table_recordings import as_csv, as_hdf5, as_mat, as_mat_7_3, as_netcdf, as_parquet, as_records
from usbldr.io.provenance import Convention
from usbldr.io.reading.read import Request, read_log

TYPES = {
    "ds_sensor_msgs/msg/UbloxNav": HEADER
    + fields("float64 latitude longitude", "float32 accuracy_horz", "string fixtype"),
    "old_geographic_msgs/msg/GeoPointStamped": HEADER + "geographic_msgs/GeoPoint geo_point\n",
    "geographic_msgs/msg/GeoPoseStamped": HEADER + "geographic_msgs/GeoPose pose\n",
    "riptide_msgs/msg/Depth": HEADER + fields("float32 depth variance"),
    "uuv_sensor_msgs/msg/Depth": HEADER + fields("float64 depth depth_variance"),
    "ds_sensor_msgs/msg/DepthPressure": HEADER + fields("float64 pressure depth"),
}
define(
    TYPES,
    shipped="gps_msgs mavros_msgs nmea_msgs cola2_msgs foxglove_msgs smarc_msgs geographic_msgs holoocean_interfaces",
)

row = partial(record, "/gps")


def place(path: str, lat_deg: float, lon_deg: float) -> Mapping[str, float]:
    return {f"{path}latitude": lat_deg, f"{path}longitude": lon_deg}


BERMUDA, NOWHERE = place("", 32.25, -64.75), place("", 0.0, 0.0)
NO_FIX, AT_ZERO = "without fix (by its quality)", "at latitude and longitude 0"
GGA = {"lat": 3215.0, "lon": 6445.0, "lat_dir": "N", "lon_dir": "W", "gps_qual": 1}
FIXES: dict[str, tuple[Mapping[str, Any], Mapping[str, Any], str]] = {  # in Bermuda; what makes it none, and why
    "gps_msgs/msg/GPSFix": ({**BERMUDA, "status.status": 18}, {"status.status": -1}, "without fix (status below 0)"),
    "sensor_msgs/msg/NavSatFix": (BERMUDA, {"position_covariance": np.full(9, -1.0)}, "of negative variance"),
    "mavros_msgs/msg/GPSRAW": ({"lat": 322500000, "lon": -647500000, "fix_type": 3}, {"fix_type": 1}, NO_FIX),
    "nmea_msgs/msg/Gpgga": (GGA, {"gps_qual": 0}, NO_FIX),
    "nmea_msgs/msg/Gpgga ": (GGA | {"lat": 32.25, "lon": 64.75}, {"gps_qual": 0}, NO_FIX),  # decimal degrees
    "cola2_msgs/msg/GPSData": ({**BERMUDA, "fix_quality": 1}, {"fix_quality": 0}, NO_FIX),
    "ds_sensor_msgs/msg/UbloxNav": ({**BERMUDA, "fixtype": "3D"}, {"fixtype": "NO_FIX"}, NO_FIX),
    "foxglove_msgs/msg/LocationFix": (BERMUDA, NOWHERE, AT_ZERO),
    "smarc_msgs/msg/LatLonStamped": (BERMUDA, NOWHERE, AT_ZERO),
} | {
    kind: (place(path, 32.25, -64.75), place(path, 0.0, 0.0), AT_ZERO)
    for kind, path in {
        "geographic_msgs/msg/GeoPointStamped": "position.",
        "old_geographic_msgs/msg/GeoPointStamped": "geo_point.",
        "geographic_msgs/msg/GeoPoseStamped": "pose.position.",
    }.items()
}


@pytest.mark.parametrize(
    ("lat", "lon", "expected"),
    [
        ((-3215.5, -3216.0), (6445.0, 6446.5), [[-(32 + 15.5 / 60), 64.75], [-(32 + 16 / 60), 64 + 46.5 / 60]]),
        ((3215.5, 3265.0), (6445.0, 6446.5), None),  # no 65 minutes
        ((120.5, 121.5), (6445.0, 6446.5), None),  # may be degrees, and latitude and longitude exchanged
    ],
)
def test_angles_that_can_only_be_degrees_and_minutes_are_read_as_such(tmp_path, lat, lon, expected):
    rows = [row("sensor_msgs/msg/NavSatFix", place("", *one), k) for k, one in enumerate(zip(lat, lon, strict=True))]

    log = logged(tmp_path, rows)

    if expected is None:
        assert "2 beyond 90 or 360 degrees" in only(log, "GPS-INVALID")
    else:
        assert log.tables["gps"][["lat_deg", "lon_deg"]].to_numpy() == pytest.approx(np.array(expected), abs=1e-12)
        assert log.convention("gps", "unit") == Convention("unit", "ddmm.mmmm", "values")


@pytest.mark.parametrize("kind", FIXES)
def test_each_kind_of_fix_is_a_latitude_and_a_longitude_unless_it_calls_itself_none(tmp_path: Path, kind: str) -> None:
    good, change, cause = FIXES[kind]
    kind = kind.strip()
    topics = {"gps": "/gps"} if kind == "mavros_msgs/msg/GPSRAW" else {}

    log = logged(tmp_path, [row(kind, good), row(kind, {**good, **change}, 1)], topics=topics)

    assert log.tables["gps"][["lat_deg", "lon_deg"]].to_numpy() == pytest.approx(np.array([[32.25, -64.75]]), abs=1e-9)
    assert only(log, "GPS-INVALID") == f"/gps: 1 of 2 records are invalid and left out (1 {cause})"
    assert log.truth.kind == "gps"


def fixes(**bad: Any) -> Iterator[Row]:
    """Yield messages of ten fixes; those that are called invalid have these values."""
    for k, good in enumerate(GOOD):
        values = {**BERMUDA, "latitude": 32.25 + k * 1e-5, **({} if good else bad)}
        yield row("sensor_msgs/msg/NavSatFix", values, k)


def tables(name: str, good: int | str, bad: int | str) -> Mapping[str, Mapping[str, Any]]:
    """Return a table of fixes with a column of words or numbers."""
    k = np.arange(len(GOOD))
    flags = np.where(GOOD, good, bad)
    flags = flags.astype(object) if flags.dtype.kind == "U" else flags
    return {"gps": {"time_ns": T0 + k * SECOND, "lat_deg": 32.25 + k * 1e-5, "lon_deg": -64.75 - k * 1e-5, name: flags}}


def telemetry(folder: Path) -> Path:
    made = mavlink.MAVLink_gps_raw_int_message
    kinds = [3 if good else 1 for good in GOOD]
    sent_ns = [T0 + k * SECOND for k in range(len(GOOD))]
    fixes = (made(k, kind, 322500000 + k, -647500000, 0, 1, 1, 0, 0, 9) for k, kind in enumerate(kinds))
    return write_packets(folder / "a.tlog", zip(sent_ns, fixes, strict=True))


def onboard(folder: Path) -> Path:
    weeks = [(10**6 * (5 + k), 0, 3 if good else 1, 100_000 + 1000 * k, 2200) for k, good in enumerate(GOOD)]
    rows = ((*week, 9, 80, 322500000 + k, -647500000, 0) for k, week in enumerate(weeks))
    return write_rows(folder / "a.BIN", DEFINITIONS[1], rows)


def vehicle(folder: Path) -> Path:
    flags = [imcpy.GpsFix.ValidityBits(0xFFFF if good else 3) for good in GOOD]
    places = [{"validity": flag, "lat": 0.56 + k * 1e-7, "lon": -1.13} for k, flag in enumerate(flags)]
    return write_messages(folder, (sent("GpsFix", T0 / SECOND + k, 6, **one) for k, one in enumerate(places)))


def ensembles(folder: Path) -> Path:
    parts = (ensemble(k, 1, (250, -1500, 10, 0), quality=2 if good else 0) for k, good in enumerate(GOOD))
    return saved(folder / "a.pd0", *parts)


def receiver(folder: Path, body: str, good: str, bad: str) -> Path:
    places = [f"1226{40 + k}.00,3215.{k:03d},N,06445.0,W" for k in range(len(GOOD))]
    bodies = [body.format(place, good if ok else bad) for place, ok in zip(places, GOOD, strict=True)]
    return saved_lines(folder / "a.nmea", (f"{T0 // SECOND + k} {sentence(one)}" for k, one in enumerate(bodies)))


GOOD = [k % 4 != 1 for k in range(10)]
CALLED_INVALID: dict[str, Callable[[Path], Path]] = {
    "MCAP": lambda d: write_mcap(d / "a.mcap", fixes(**{"status.status": -1})),
    "ROS 1 bag": lambda d: write_bag(d / "a.bag", fixes(**{"status.status": -1})),
    "rosbag2": lambda d: write_rosbag2(d / "a", fixes(position_covariance=np.full(9, -1.0))),
    "rosbag2 MCAP": lambda d: write_rosbag2(d / "a", fixes(latitude=math.nan), StoragePlugin.MCAP),
    "BlueOS": lambda d: write_blueos(d / "a.mcap", [
        (T0 + k * SECOND, "GPS_RAW_INT", {"fix_type": {"type": f"GPS_FIX_TYPE_{'3D' if good else 'NO'}_FIX"},
                                          "lat": 322500000 + k, "lon": -647500000}) for k, good in enumerate(GOOD)]),
    "tlog": telemetry,
    "BIN": onboard,
    "LSF": vehicle,
    "PD0": ensembles,
    "GGA": lambda d: receiver(d, "GPGGA,{},{},10,0.8,1.0,M,48.0,M,,", "4", "0"),
    "GNS": lambda d: receiver(d, "GPGNS,{},{},10,0.8,1.0,48.0,,", "AN", "NN"),
    "CSV": lambda d: as_csv(d, tables("quality", 1, 6)),
    "CSV of words": lambda d: as_csv(d, tables("valid", "A", "V")),
    "CSV of another name": lambda d: as_csv(d, tables("GPS Fix Quality", 4, 0)),
    "CSV of GSA's mode": lambda d: as_csv(d, tables("fix_mode", 2, 1)),
    "Parquet": lambda d: as_parquet(d, tables("fix_status", 0, -1)),
    "Parquet of words": lambda d: as_parquet(d, tables("fix_type", "3D", "no")),
    "HDF5": lambda d: as_hdf5(d, tables("valid", 1, 0)),
    "HDF5 records": lambda d: as_records(d, tables("fix_type", 3, 1)),
    "netCDF": lambda d: as_netcdf(d, tables("gps_quality", 1, 8)),
    "mat": lambda d: as_mat(d, tables("gps_valid", 1, 0)),
    "mat 7.3": lambda d: as_mat_7_3(d, tables("quality", 1, 0)),
}  # fmt: skip


@pytest.mark.parametrize("form", CALLED_INVALID)
def test_a_fix_that_its_log_calls_invalid_is_counted_and_left_out(tmp_path: Path, form: str) -> None:
    log = read_log(CALLED_INVALID[form](tmp_path))

    assert len(log.tables["gps"]) == sum(GOOD)
    assert f"{GOOD.count(False)} of {len(GOOD)} records are invalid and left out" in only(log, "GPS-INVALID")


KNOWN = {"position_covariance": np.diag([0.25, 0.25, 9.0]).ravel(), "position_covariance_type": 2}
SIGMA: list[tuple[str, Mapping[str, Any]]] = [  # 0.5 m for each axis
    ("gps_msgs/msg/GPSFix", {"err_horz": 0.5 * math.sqrt(-2 * math.log(0.05))}),  # Rayleigh's 95 %
    ("gps_msgs/msg/GPSFix", {**KNOWN, "position_covariance_type": 3, "err_horz": 50.0}),
    ("mavros_msgs/msg/GPSRAW", {"h_acc": 500}),
    ("cola2_msgs/msg/GPSData", {"latitude_stdev": 0.5, "longitude_stdev": 0.5}),
    ("ds_sensor_msgs/msg/UbloxNav", {"accuracy_horz": 0.5}),
    ("foxglove_msgs/msg/LocationFix", KNOWN),
]


@pytest.mark.parametrize(("kind", "values"), SIGMA)
def test_each_kind_states_its_accuracy_in_its_own_way_and_a_known_covariance_beats_an_estimate(tmp_path, kind, values):
    log = logged(tmp_path, [row(kind, {**FIXES[kind][0], **values})], topics={"gps": "/gps"})

    assert log.tables["gps"]["sd_m"].iloc[0] == pytest.approx(0.5, rel=1e-4)


def test_the_raw_fix_of_mavros_comes_before_its_estimate(tmp_path: Path) -> None:
    names = [f"/mavros/global_position/{name}" for name in ("global", "raw/fix")]

    log = logged(tmp_path, [fix(T0, 32.25, -64.75, topic=name) for name in names])

    assert log.provenance["gps"].topic == names[1]


FLOAT32 = "std_msgs/msg/Float32"


@pytest.mark.parametrize(
    ("topic", "kind", "values", "found"),  # whether it is found without being named
    [
        ("/sensor", "riptide_msgs/msg/Depth", {"depth": 4.0}, True),
        ("/sensor", "uuv_sensor_msgs/msg/Depth", {"depth": 4.0}, True),
        ("/sensor", "ds_sensor_msgs/msg/DepthPressure", {"depth": 4.0, "pressure": 4.03}, True),
        ("/sensor", "holoocean_interfaces/msg/DepthSensor", {"depth": 4.0}, True),
        ("/depth", FLOAT32, {"data": 4.0}, True),
        ("/mavros/global_position/rel_alt", HEADING, {"data": -4.0}, False),
        ("/sensor", POSE, {"pose.position.z": -4.0, "header.frame_id": "map"}, False),
        ("/sensor", POSE, {"pose.position.z": 4.0, "header.frame_id": "map_ned"}, False),
        ("/sensor", POSE_COVARIANCE, {"pose.pose.position.z": -4.0, "header.frame_id": "map"}, False),
        ("/sensor", POSE_COVARIANCE, {"pose.pose.position.z": -4.0}, False),
        ("/sensor", ODOMETRY, {"pose.pose.position.z": 4.0, "header.frame_id": "world_ned"}, False),
    ],
)
def test_a_depth_grows_downwards(tmp_path: Path, topic: str, kind: str, values: Mapping[str, Any], found: bool) -> None:
    rows = [record(topic, kind, values)]

    named = logged(tmp_path, rows, topics={"depth": topic})

    assert named.tables["depth"]["depth_m"].iloc[0] == 4.0
    assert (Convention("positive", "up", "type") in named.provenance["depth"].conventions) == topic.endswith("rel_alt")
    assert ("depth" in logged(tmp_path, rows).tables) == found


def test_depths_above_the_water_are_pointed_out(tmp_path: Path) -> None:
    log = logged(tmp_path, [record("/sensor", "holoocean_interfaces/msg/DepthSensor", {"depth": -4.0})])

    assert only(log, "DEPTH-SIGN") == (
        "/sensor: a median depth of -4.0 m, above the water; "
        'if it counts the other way, state positive = "up" under [depth]'
    )


def test_a_receiver_that_repeats_its_last_fix_is_found_without_a_depth_sensor(tmp_path: Path) -> None:
    """Fifteen seconds at the surface, twenty under it, and then again."""
    surface = [k if k < 15 else 14 if k < 35 else k for k in range(50)]
    rows = [fix(T0 + k * SECOND, 32.25 + 1e-6 * place, -64.75) for k, place in enumerate(surface)]

    assert only(logged(tmp_path, rows), "GPS-REPEATED").startswith(
        "/gps/fix: 20 of 50 fixes repeat the previous one to the last digit for more than 5 s, in 1 stretches, "
        "the longest 20.0 s from 14.0 s on"
    )
    assert "GPS-REPEATED" not in codes(read_log(tmp_path / "dive.mcap", Request(truth="none")))


@pytest.mark.parametrize(
    ("rows", "gps"),
    [
        # a receiver that moves by less than its resolution, and one at rest for five seconds
        ([fix(T0 + k * SECOND, 32.25 + k * 1e-13, -64.75) for k in range(60)], "/gps/fix"),
        ([fix(T0 + k * SECOND, 32.25, -64.75) for k in range(6)], "/gps/fix"),
        ([row(ODOMETRY, {}, k) for k in range(60)], "/gps"),  # local positions
    ],
)
def test_what_stands_still_repeats_no_fix(tmp_path: Path, rows: list[Row], gps: str) -> None:
    log = logged(tmp_path, rows, MAP, {"gps": gps})

    assert log.truth is not None
    assert "GPS-REPEATED" not in codes(log)
