"""Reading four navigation topics: usbldr against `mcap` with its ROS 2 decoder and against rosbags, as paired ratios.

Two logs with DVL, Imu, USBL and GPS. "camera": two minutes, 21 sensor messages per second beside 5 frames per second of
500 kB that do not compress, 300 MB. "dense": ten minutes, 111 sensor messages per second and nothing else.

Each reading is a process of its own, which imports first and is then measured: CPU seconds, and by how much the reading
raised the peak memory. The readers take turns; the ratio is the median of the ratios of the rounds, so that it also
holds on a machine that does other work. mcap's and rosbags' readers make each message an object and are content, and
mcap's does not compare checksums; usbldr's lists the topics, too, compares the checksum of each chunk that it reads,
and ends in NumPy columns in the order of time.

Tables and logs of autopilots are read as a whole, against pandas, pyarrow and pymavlink.

$ pip install mcap-ros2-support && python benchmarks/speed/reading.py --write docs/broken_files.md
"""

import argparse
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from functools import partial
from importlib.metadata import version
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple

STAMP = ["header.stamp", "header.frame_id"]
SENSORS = {  # type, and what is read beside the stamp
    "/dvl": ("marine_acoustic_msgs/msg/Dvl", [*(f"velocity.{axis}" for axis in "xyz"), "velocity_covar.0"]),
    "/imu": ("sensor_msgs/msg/Imu", [*(f"orientation.{axis}" for axis in "xyzw"), "orientation_covariance.8"]),
    "/usbl": (
        "geometry_msgs/msg/PoseWithCovarianceStamped",
        [*(f"pose.pose.position.{axis}" for axis in "xyz"), "pose.covariance.0"],
    ),
    "/gps": ("sensor_msgs/msg/NavSatFix", ["latitude", "longitude", "status.status", "position_covariance.0"]),
}
TYPES = {topic: name for topic, (name, _) in SENSORS.items()} | {"/camera": "sensor_msgs/msg/CompressedImage"}
LOGS = {  # seconds, and messages per second of each topic
    "camera": (120, {"/dvl": 5, "/imu": 10, "/usbl": 1, "/gps": 5, "/camera": 5}),
    "dense": (600, {"/dvl": 5, "/imu": 100, "/usbl": 1, "/gps": 5}),
}
FRAME_BYTES, CHUNK_BYTES = 500_000, 768 << 10  # the size of chunks is the default of rosbag2
KINDS = (
    "MCAP uncompressed",
    "MCAP zstd",
    "MCAP lz4",
    "MCAP unchunked",
    "rosbag2 (SQLite)",
    "bag uncompressed",
    "bag lz4",
)


MARKERS = ("<!-- reading.py: begin -->", "<!-- reading.py: end -->")
OTHER_MARKERS = ("<!-- reading.py of others: begin -->", "<!-- reading.py of others: end -->")


def written(folder: Path, log: str, kind: str) -> Path:
    """Return a log written with mcap's own writer, or rosbags' for rosbag2 and bags."""
    import numpy as np
    from rosbags.rosbag1 import Writer as Bag1Writer
    from rosbags.rosbag2 import Writer as Bag2Writer

    from usbldr.io.decoding.definitions import known_types

    ros1 = kind.startswith("bag")
    store, rng = known_types(1 if ros1 else 2), np.random.default_rng(0)
    serialize = store.serialize_ros1 if ros1 else store.serialize_cdr
    seconds, rates = LOGS[log]
    rows = sorted((k * 10**9 // rate, topic) for topic, rate in rates.items() for k in range(rate * seconds))
    messages = (
        (topic, ns, bytes(serialize(message(store, TYPES[topic], ns, rng), TYPES[topic]))) for ns, topic in rows
    )
    if kind.startswith("MCAP"):
        file = folder / "log.mcap"
        write_mcap(
            file,
            kind.split()[1],
            {topic: store.generate_msgdef(TYPES[topic], ros_version=2)[0] for topic in rates},
            messages,
        )
        return file
    writer: Any = Bag1Writer(folder / "log.bag") if ros1 else Bag2Writer(folder / "log", version=9)
    if kind == "bag lz4":
        writer.set_compression(writer.CompressionFormat.LZ4)
    with writer:
        connections = {topic: writer.add_connection(topic, TYPES[topic], typestore=store) for topic in rates}
        for topic, ns, data in messages:
            writer.write(connections[topic], ns, data)
    return folder / "log.bag" if ros1 else folder / "log" / "log.db3"


def write_mcap(file: Path, kind: str, definitions: dict[str, str], messages: Iterator[tuple[str, int, bytes]]) -> None:
    from mcap.writer import CompressionType, Writer

    compression = {"zstd": CompressionType.ZSTD, "lz4": CompressionType.LZ4}.get(kind, CompressionType.NONE)
    with file.open("wb") as stream:
        writer = Writer(stream, CHUNK_BYTES, compression, use_chunking=kind != "unchunked")
        writer.start(profile="ros2")
        channels: dict[str, int] = {}
        for topic, text in definitions.items():
            schema = writer.register_schema(TYPES[topic], "ros2msg", text.encode())
            channels[topic] = writer.register_channel(topic, "cdr", schema)
        for topic, ns, data in messages:
            writer.add_message(channels[topic], ns, data, ns)
        writer.finish()


def message(store: Any, name: str, ns: int, rng: Any) -> Any:
    """Return a message with its stamp, numbers by chance in every place, and a frame of the camera."""
    from rosbags.interfaces import Nodetype

    def value(node: Any, what: Any) -> Any:
        if node is Nodetype.NAME:
            return store.types[what](*divmod(ns, 10**9)) if what.endswith("/Time") else message(store, what, ns, rng)
        if node is Nodetype.BASE:
            return "link" if what[0] == "string" else float(rng.random()) if what[0].startswith("float") else 1
        if node is Nodetype.SEQUENCE:
            return rng.integers(0, 256, FRAME_BYTES, "u1")
        (part, of), count = what
        return [value(part, of) for _ in range(count)] if part is Nodetype.NAME else rng.random(count).astype(of[0])

    return store.types[name](*(value(node, what) for _, (node, what) in store.fielddefs[name][1]))


def by_usbldr(file: Path, whole: bool = False) -> Callable[[], int]:
    from usbldr.io.decoding.collected import read_whole
    from usbldr.io.formats.detect import open_reader

    open_reader(file).topics()  # the imports

    def read() -> int:
        log = open_reader(file)
        topics = log.topics()
        wanted = {topic: STAMP + paths for topic, (_, paths) in SENSORS.items()}
        if whole:
            wanted = {topic.name: topic.fields for topic in topics if not topic.problem}
        records = read_whole(log, wanted)
        assert not any(finding.lost_data for finding in log.findings())
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


def by_pandas(folder: Path) -> Callable[[], int]:
    import pandas as pd

    def read() -> int:
        return sum(len(pd.read_csv(file)) for file in folder.glob("*.csv"))

    read()  # as by_usbldr
    return read


def by_pyarrow(folder: Path) -> Callable[[], int]:
    from pyarrow import dataset, parquet  # noqa: F401 - the first is imported by the first reading

    def read() -> int:
        tables = [parquet.read_table(file, use_threads=False) for file in folder.glob("*.parquet")]
        return sum(len(column.to_numpy()) for table in tables for column in table.columns[:1])

    return read


def by_pymavlink(file: Path) -> Callable[[], int]:
    from pymavlink import DFReader, mavutil  # noqa: F401 - the first is imported by the first reading

    def read() -> int:
        log, count = mavutil.mavlink_connection(str(file)), 0
        while log.recv_match(type=["ATTITUDE", "GPS_RAW_INT", "ATT", "POWR"]) is not None:
            count += 1
        return count

    return read


READINGS = {
    "usbldr": by_usbldr,
    "mcap": by_mcap,
    "rosbags": by_rosbags,
    "usbldr, all": partial(by_usbldr, whole=True),
    "pandas": by_pandas,
    "pyarrow": by_pyarrow,
    "pymavlink": by_pymavlink,
}
ROS = ("usbldr", "mcap", "rosbags")
OTHERS = {"CSV": "pandas", "Parquet": "pyarrow", ".tlog": "pymavlink", ".BIN": "pymavlink"}  # kind: its library
ROWS = 60_000  # of each topic in these: ten minutes at 100 Hz


def other_written(folder: Path, kind: str) -> Path:
    """Return a log of two topics, tables or messages of an autopilot."""
    import numpy as np
    import pandas as pd
    from pymavlink.dialects.v20 import ardupilotmega as mavlink

    k, rng = np.arange(ROWS), np.random.default_rng(0)
    time_us = 1_600_000_000_000_000 + k * 10_000
    a, b = rng.random((2, ROWS))
    if kind in ("CSV", "Parquet"):
        tables = {"dvl": {"starboard_mps": a, "forward_mps": b}, "gps": {"lat_deg": a, "lon_deg": b}}
        for name, columns in tables.items():
            table = pd.DataFrame({"time_ns": time_us * 1000, **columns})
            to = table.to_csv if kind == "CSV" else table.to_parquet
            to(folder / f"{name}.{kind.lower()}", index=False)
        return folder
    file, sender = folder / f"log{kind}", mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    with file.open("wb") as stream:
        if kind == ".BIN":
            for number, name, codes, columns in (
                (128, b"FMT", b"BBnNZ", b"Type,Length,Name,Format,Columns"),
                (130, b"ATT", b"Qff", b"TimeUS,Roll,Yaw"),
                (131, b"POWR", b"Qff", b"TimeUS,Vcc,VServo"),
            ):
                layout = struct.pack("<BB4s16s64s", number, 89 if number == 128 else 19, name, codes, columns)
                stream.write(b"\xa3\x95\x80" + layout)
        for at, x, y in zip(time_us.tolist(), a.tolist(), b.tolist(), strict=True):
            if kind == ".BIN":
                body = struct.pack("<Qff", at - 1_600_000_000_000_000, x, y)
                stream.write(b"\xa3\x95\x82" + body + b"\xa3\x95\x83" + body)
                continue
            for message in (
                mavlink.MAVLink_attitude_message(0, x, y, x, 0, 0, 0),
                mavlink.MAVLink_gps_raw_int_message(at, 3, int(x * 1e8), int(y * 1e8), 0, 1, 1, 0, 0, 9),
            ):
                stream.write(struct.pack(">Q", at) + bytes(message.pack(sender)))
    return file


class Cost(NamedTuple):
    """What a reading costs."""

    cpu_s: float
    memory_mb: float
    messages: int


def timed(name: str, file: Path) -> Cost:
    """Read a log in this process."""
    read = READINGS[name](file)
    before, began = peak_mb(), time.process_time()
    messages = read()
    return Cost(time.process_time() - began, peak_mb() - before, messages)


def peak_mb() -> float:
    """Return the most memory that this process has held (Linux; getrusage would count the parent's, too)."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return int(next(line for line in lines if line.startswith("VmHWM:")).split()[1]) / 1024


def measured(name: str, file: Path) -> Cost:
    """Read a log in a process of its own."""
    command = [sys.executable, __file__, "--timed", name, str(file)]
    seconds, memory, messages = subprocess.run(command, check=True, capture_output=True, text=True).stdout.split()
    return Cost(float(seconds), float(memory), int(messages))


def row(log: str, kind: str, file: Path, rounds: int) -> list[str]:
    """Return the cells of a log: least CPU seconds (and memory) of each reader, median ratios with their range."""
    names = [name for name in ROS if kind.startswith("MCAP") or name != "mcap"]
    for name in names:
        measured(name, file)  # the file is in memory from here on
    runs = [{name: measured(name, file) for name in names} for _ in range(rounds)]
    assert len({cost.messages for run in runs for cost in run.values()}) == 1, "all read the same messages"
    cells = [f"{log}, {kind}", f"{file.stat().st_size / 1e6:.0f}"]
    for name in ROS:
        costs = [run[name] for run in runs if name in run]
        cells.append(f"{min(c.cpu_s for c in costs):.2f} ({min(c.memory_mb for c in costs):.0f})" if costs else "")
    for name in ("mcap", "rosbags"):
        ratios = [run[name].cpu_s / run["usbldr"].cpu_s for run in runs if name in run]
        cells.append(f"{median(ratios):.1f} ({min(ratios):.1f} to {max(ratios):.1f})" if ratios else "")
    return cells


def other_row(kind: str, file: Path, rounds: int) -> list[str]:
    """Return the cells of a log that is no recording of ROS: CPU seconds (and memory), the median ratio."""
    names = ("usbldr, all", OTHERS[kind])
    runs = [[measured(name, file) for name in names] for _ in range(rounds + 1)][1:]  # then the file is in memory
    assert all(one.messages == other.messages for one, other in runs), "both read the same"
    size = sum(one.stat().st_size for one in (file.iterdir() if file.is_dir() else [file]))
    best = [
        f"{min(c.cpu_s for c in costs):.2f} ({min(c.memory_mb for c in costs):.0f})"
        for costs in zip(*runs, strict=True)
    ]
    ratios = [other.cpu_s / own.cpu_s for own, other in runs]
    return [
        kind,
        f"{size / 1e6:.0f}",
        *best,
        names[1],
        f"{median(ratios):.1f} ({min(ratios):.1f} to {max(ratios):.1f})",
    ]


def main() -> None:
    options = argparse.ArgumentParser(description="Print the table as Markdown.")
    options.add_argument("--rounds", type=int, default=5, help="readings of each, in turn")
    options.add_argument("--logs", nargs="*", default=list(LOGS), choices=LOGS)
    options.add_argument("--kinds", nargs="+", default=KINDS, choices=KINDS)
    options.add_argument("--others", nargs="*", default=list(OTHERS), choices=OTHERS)
    options.add_argument("--write", type=Path, nargs="*", default=[], help="pages whose markers take the table")
    options.add_argument("--timed", nargs=2, help=argparse.SUPPRESS)
    arguments = options.parse_args()
    if arguments.timed:
        print(*timed(arguments.timed[0], Path(arguments.timed[1])))
        return
    sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # speed is a package
    from speed.peers_table import processor, write

    heads = ["log", "MB", *ROS, "mcap / usbldr", "rosbags / usbldr"]
    lines = [f"| {' | '.join(heads)} |", f"|{'---|' * len(heads)}"]
    print("\n".join(lines))
    for log in arguments.logs:
        for kind in arguments.kinds:
            with tempfile.TemporaryDirectory() as folder:
                cells = row(log, kind, written(Path(folder), log, kind), arguments.rounds)
            lines.append(f"| {' | '.join(cells)} |")
            print(lines[-1], flush=True)
    others = ["| log | MB | usbldr | library | which | library / usbldr |", f"|{'---|' * 6}"]
    print("\n".join(["", *others]))
    for kind in arguments.others:
        with tempfile.TemporaryDirectory() as folder:
            others.append(f"| {' | '.join(other_row(kind, other_written(Path(folder), kind), arguments.rounds))} |")
            print(others[-1], flush=True)
    tables = [
        (arguments.logs, lines, ("mcap", "mcap-ros2-support", "rosbags"), MARKERS),
        (arguments.others, others, ("pandas", "pyarrow", "pymavlink"), OTHER_MARKERS),
    ]
    for wanted, table, libraries, markers in tables:
        if wanted:
            used = ", ".join(f"{name} {version(name)}" for name in ("usbldr", *libraries))
            table += ["", f"{processor()}, {arguments.rounds} rounds; {used}."]
            for page in arguments.write:
                write(page, "\n".join(table), markers)


if __name__ == "__main__":
    main()
