"""What a dense log costs in memory: some columns of the records in use, never messages."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from mcap.writer import CompressionType, Writer
from rosbags.rosbag1 import Writer as BagWriter

from recordings import ROS1, ROS2, T0, message
from usbldr.io.reading.read import read_log

RATE_HZ = 200
MINUTE = 60 * RATE_HZ  # messages
SHORT, LONG = 10 * MINUTE, 22 * MINUTE  # both are longer than a block
BYTES_PER_MESSAGE = 100  # 54 were measured; one Python object of each payload alone would have 360
LEVER_ARM = "[usbl]\nlever_arm_m = [0.3, 0.2, -0.5]\n"  # so that roll and pitch are used
PEAK = r"""
import re, sys
from pathlib import Path
from usbldr.io.reading import role_records
from usbldr.io.reading.read import Request, read_log
from usbldr.io.reading.epochs import timeline
role_records.MAX_ATTITUDES = 20_000
timeline(read_log(Path(sys.argv[1]), Request(sys.argv[2])))
print(int(re.search(r"VmHWM:\s*(\d+) kB", Path("/proc/self/status").read_text())[1]) * 1024)
"""

FREED = os.environ | {"MALLOC_MMAP_THRESHOLD_": "131072"}  # glibc else keeps what is freed, more or less by chance


def attitudes(count: int) -> np.ndarray:
    """Quaternions (count, 4), x to w, of a vehicle that turns, rolls and pitches, with noise."""
    t = np.arange(count) / RATE_HZ
    rng = np.random.default_rng(1)
    roll, pitch, yaw = (
        angle + rng.normal(0, 2e-3, count) for angle in (0.05 * np.sin(t), 0.03 * np.cos(t / 2), t / 50)
    )
    (cr, cp, cy), (sr, sp, sy) = ([f(angle / 2) for angle in (roll, pitch, yaw)] for f in (np.cos, np.sin))
    x, y = sr * cp * cy - cr * sp * sy, cr * sp * cy + sr * cp * sy
    return np.column_stack([x, y, cr * cp * sy - sr * sp * cy, cr * cp * cy + sr * sp * sy])


def imu_messages(count: int, bag: bool) -> tuple[np.ndarray, list[bytes]]:
    """Log times and IMU messages: one is serialized by rosbags, and its stamp and quaternion are exchanged."""
    store = ROS1 if bag else ROS2
    marks = [float(2**40 + k) for k in range(4)]
    fields = {
        "header.stamp": 123456789 * 10**9 + 987654321,
        "header.frame_id": "imu_link",
        "linear_acceleration.z": 9.81,
    }
    fields |= {f"orientation.{axis}": mark for axis, mark in zip("xyzw", marks, strict=True)}
    imu = message("sensor_msgs/msg/Imu", fields, store)
    serialize = store.serialize_ros1 if bag else store.serialize_cdr
    sample = bytes(serialize(imu, "sensor_msgs/msg/Imu"))
    time_ns = T0 + np.arange(count) * (10**9 // RATE_HZ)
    rows = np.tile(np.frombuffer(sample, dtype=np.uint8), (count, 1))
    at = sample.index(np.array([123456789, 987654321], dtype="<u4").tobytes())
    rows[:, at : at + 8] = np.column_stack([time_ns // 10**9, time_ns % 10**9]).astype("<u4").view(np.uint8)
    at = sample.index(np.array(marks, dtype="<f8").tobytes())
    rows[:, at : at + 32] = np.ascontiguousarray(attitudes(count), dtype="<f8").view(np.uint8)
    return time_ns + 1_000_000, [row.tobytes() for row in rows]


def write_dense(file: Path, count: int) -> Path:
    """Write a log of an IMU alone."""
    bag, name = file.suffix == ".bag", "sensor_msgs/msg/Imu"
    times, payloads = imu_messages(count, bag)
    if bag:
        with BagWriter(file) as writer:
            connection = writer.add_connection("/imu/data", name, typestore=ROS1)
            for time_ns, payload in zip(times.tolist(), payloads, strict=True):
                writer.write(connection, time_ns, payload)
        return file
    with file.open("wb") as stream:
        made = Writer(stream, compression=CompressionType.NONE)
        made.start("ros2", "")
        definition, _ = ROS2.generate_msgdef(name, ros_version=2)
        channel = made.register_channel("/imu/data", "cdr", made.register_schema(name, "ros2msg", definition.encode()))
        for time_ns, payload in zip(times.tolist(), payloads, strict=True):
            made.add_message(channel, time_ns, payload, time_ns)
        made.finish()
    return file


@pytest.fixture(scope="module")
def dense_logs(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("dense")
    return [write_dense(folder / f"{count}.mcap", count) for count in (SHORT, LONG)]


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="the peak of a process is read from Linux's /proc")
@pytest.mark.parametrize("settings", ["", LEVER_ARM], ids=["upright", "tilted"])
def test_memory_grows_by_a_few_columns_per_message(tmp_path: Path, dense_logs: list[Path], settings: str) -> None:
    (tmp_path / "usbldr.toml").write_text(settings, encoding="utf-8")
    peaks: list[int] = []
    for file in dense_logs:
        command = [sys.executable, "-c", PEAK, str(file), str(tmp_path / "usbldr.toml")]
        runs = [subprocess.run(command, env=FREED, capture_output=True, text=True, check=True) for _ in range(3)]
        peaks.append(min(int(run.stdout) for run in runs))  # it varies by 3 MB

    assert (peaks[1] - peaks[0]) / (LONG - SHORT) < BYTES_PER_MESSAGE


@pytest.mark.parametrize("ending", ["mcap", "bag"])
def test_blocks_do_not_change_a_value(tmp_path: Path, ending: str) -> None:
    """More messages than a block has: headings are those of the textbook, to the rounding of their formula."""
    count = 3 * MINUTE
    x, y, z, w = attitudes(count).T
    heading = np.mod(90 - np.degrees(np.arctan2(2 * (w * z + x * y), w * w + x * x - y * y - z * z)), 360)

    table = read_log(write_dense(tmp_path / f"dense.{ending}", count)).tables["compass"]

    assert np.array_equal(table["heading_deg"], heading)
    assert np.array_equal(table["time_s"], np.arange(count) * (10**9 // RATE_HZ) / 1e9)
