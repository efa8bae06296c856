"""Reading four navigation topics beside a camera: usbldr against `mcap` with its ROS 2 decoder and against rosbags.

Ten minutes: 66,600 messages of DVL (5 Hz), Imu (100 Hz), USBL (1 Hz) and GPS (5 Hz), and 6000 camera frames of 50 kB
that do not compress, 300 MB. Each reading is a process of its own, which imports first and is then measured: CPU
seconds, best of some rounds in turn, and by how much the reading raised the peak memory. mcap's and rosbags' readings
make each message an object and are content; usbldr's lists the topics, too, checks the checksum of each chunk, and ends
in NumPy columns in the order of time.

$ pip install mcap-ros2-support && python benchmarks/speed/reading.py
"""

import argparse
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

STAMP = ["header.stamp", "header.frame_id"]
SENSORS = {  # rate, type, and what is read beside the stamp
    "/dvl": (5, "marine_acoustic_msgs/msg/Dvl", [*(f"velocity.{axis}" for axis in "xyz"), "velocity_covar.0"]),
    "/imu": (100, "sensor_msgs/msg/Imu", [*(f"orientation.{axis}" for axis in "xyzw"), "orientation_covariance.8"]),
    "/usbl": (
        1,
        "geometry_msgs/msg/PoseWithCovarianceStamped",
        [*(f"pose.pose.position.{axis}" for axis in "xyz"), "pose.covariance.0"],
    ),
    "/gps": (5, "sensor_msgs/msg/NavSatFix", ["latitude", "longitude", "status.status", "position_covariance.0"]),
}
CHUNK, FRAME, SECONDS = 4 << 20, 50_000, 600
KINDS = ("uncompressed", "zstd", "lz4", "unchunked", "db3")


def write(folder: Path, kind: str, seconds: int) -> Path:
    """Write the log with mcap's own writer, or rosbags' for db3."""
    import numpy as np
    from mcap.writer import CompressionType
    from mcap.writer import Writer as McapWriter
    from rosbags.rosbag2 import Writer as BagWriter

    from usbldr.io.decoding.definitions import known_types

    store = known_types(2)
    rng = np.random.default_rng(0)
    rows = [(k * 10**9 // rate, topic) for topic, (rate, *_) in SENSORS.items() for k in range(rate * seconds)]
    rows = sorted(rows + [(k * 10**8 + 3 * 10**6, "/camera") for k in range(10 * seconds)])
    types = {topic: name for topic, (_, name, _) in SENSORS.items()} | {"/camera": "sensor_msgs/msg/CompressedImage"}

    def payload(time_ns: int, topic: str) -> bytes:
        return bytes(store.serialize_cdr(message(store, types[topic], time_ns, rng), types[topic]))

    if kind == "db3":
        with BagWriter(folder / "db3", version=9) as bag:
            connections = {topic: bag.add_connection(topic, name, typestore=store) for topic, name in types.items()}
            for time_ns, topic in rows:
                bag.write(connections[topic], time_ns, payload(time_ns, topic))
        return next((folder / "db3").glob("*.db3"))
    compression = {"zstd": CompressionType.ZSTD, "lz4": CompressionType.LZ4}.get(kind, CompressionType.NONE)
    file = folder / f"{kind}.mcap"
    with file.open("wb") as stream:
        writer = McapWriter(stream, chunk_size=CHUNK, compression=compression, use_chunking=kind != "unchunked")
        writer.start(profile="ros2")
        channels: dict[str, int] = {}
        for topic, name in types.items():
            text = store.generate_msgdef(name, ros_version=2)[0].encode()
            channels[topic] = writer.register_channel(topic, "cdr", writer.register_schema(name, "ros2msg", text))
        for time_ns, topic in rows:
            writer.add_message(channels[topic], time_ns, payload(time_ns, topic), time_ns)
        writer.finish()
    return file


def message(store: Any, name: str, time_ns: int, rng: Any) -> Any:
    """Return a message with its stamp, and numbers by chance in every place."""
    from rosbags.interfaces import Nodetype

    types = store.types
    if name == "std_msgs/msg/Header":
        return types[name](types["builtin_interfaces/msg/Time"](*divmod(time_ns, 10**9)), "link")
    if name == "sensor_msgs/msg/CompressedImage":
        header = message(store, "std_msgs/msg/Header", time_ns, rng)
        return types[name](header, "jpeg", rng.integers(0, 256, FRAME, "u1"))
    values: list[Any] = []
    for _, (node, what) in store.fielddefs[name][1]:
        if node is Nodetype.NAME:
            values.append(message(store, what, time_ns, rng))
        elif node is Nodetype.BASE:
            values.append(float(rng.random()) if what[0].startswith("float") else 1)
        elif what[0][0] is Nodetype.NAME:
            values.append([message(store, what[0][1], time_ns, rng) for _ in range(what[1])])
        else:
            values.append(rng.random(what[1]).astype(what[0][1][0]))
    return types[name](*values)


def by_usbldr(file: Path) -> Callable[[], int]:
    from usbldr.io.formats.detect import open_log

    open_log(file).topics()  # the imports

    def read() -> int:
        log = open_log(file)
        found = {topic.name for topic in log.topics()}
        records = log.read({topic: STAMP + paths for topic, (*_, paths) in SENSORS.items() if topic in found})
        assert not log.findings()
        return sum(len(one.received_ns) for one in records.values())

    return read


def by_mcap(file: Path) -> Callable[[], int]:
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory

    def read() -> int:
        with file.open("rb") as stream:
            reader = make_reader(stream, decoder_factories=[DecoderFactory()])
            return sum(1 for _ in reader.iter_decoded_messages(topics=list(SENSORS)))

    return read


def by_rosbags(file: Path) -> Callable[[], int]:
    from rosbags.highlevel import AnyReader

    def read() -> int:
        with AnyReader([file]) as reader:
            wanted = [connection for connection in reader.connections if connection.topic in SENSORS]
            return sum(1 for c, _, data in reader.messages(wanted) if reader.deserialize(data, c.msgtype))

    return read


READINGS = {"usbldr": by_usbldr, "mcap": by_mcap, "rosbags": by_rosbags}


def timed(name: str, file: Path) -> None:
    """Print what a reading costs: CPU seconds, megabytes, messages."""
    read = READINGS[name](file)
    before, began = peak_mb(), time.process_time()
    count = read()
    print(time.process_time() - began, peak_mb() - before, count)


def peak_mb() -> float:
    """Return the most memory that this process has held (Linux; getrusage would count the parent's, too)."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return int(next(line for line in lines if line.startswith("VmHWM:")).split()[1]) / 1024


def measured(name: str, file: Path) -> tuple[float, float, int]:
    command = [sys.executable, __file__, "--timed", name, str(file)]
    seconds, memory, count = subprocess.run(command, check=True, capture_output=True, text=True).stdout.split()
    return float(seconds), float(memory), int(count)


def main() -> None:
    options = argparse.ArgumentParser(description="Print the table.")
    options.add_argument("--seconds", type=int, default=SECONDS, help="length of the log")
    options.add_argument("--rounds", type=int, default=3, help="readings of each, in turn")
    options.add_argument("--kinds", nargs="+", default=KINDS, choices=KINDS)
    options.add_argument("--timed", nargs=2, help=argparse.SUPPRESS)
    arguments = options.parse_args()
    if arguments.timed:
        timed(arguments.timed[0], Path(arguments.timed[1]))
        return
    print("CPU seconds (memory in MB)           usbldr          mcap       rosbags   mcap/usbldr  rosbags/usbldr")
    with tempfile.TemporaryDirectory() as folder:
        for kind in arguments.kinds:
            file = write(Path(folder), kind, arguments.seconds)
            names = [name for name in READINGS if kind != "db3" or name != "mcap"]
            runs = [{name: measured(name, file) for name in names} for _ in range(arguments.rounds)]
            best = {name: min(run[name] for run in runs) for name in names}
            assert len({count for _, _, count in best.values()}) == 1, "all read the same messages"
            cells = [f"{best[n][0]:.2f} ({best[n][1]:.0f})" if n in best else "" for n in READINGS]
            ratios = [f"{best[n][0] / best['usbldr'][0]:.1f}" if n in best else "" for n in ("mcap", "rosbags")]
            size = f"{kind}, {file.stat().st_size / 1e6:.0f} MB"
            print(f"{size:28}{cells[0]:>15}{cells[1]:>14}{cells[2]:>14}{ratios[0]:>14}{ratios[1]:>16}", flush=True)
            file.unlink()


if __name__ == "__main__":
    main()
