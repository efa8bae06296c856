"""A file of every format to be damaged, and what the checksums and counts of the format itself show."""

import gzip
import random
from collections.abc import Callable, Iterable, Mapping
from functools import cache, partial
from io import BytesIO
from itertools import accumulate
from pathlib import Path
from typing import Any, Literal, NamedTuple

import h5py
import numpy as np
import pandas as pd
import pyarrow as pa
import zstandard
from mcap.writer import CompressionType
from pyarrow import parquet
from rosbags.rosbag2 import StoragePlugin

import autopilot_recordings as autopilots
import dvl_recordings as dvls
import moos_recordings as moos
import table_recordings as tables
from blueos_recordings import delta, write_blueos
from pd45_recordings import write_pd45
from recordings import SECOND, T0, Row, point, sentence, twist, write_bag, write_csv, write_mcap, write_rosbag2, yaw

COUNT = 60  # [messages] of each topic
ROWS = 500  # of each table: more than its description
Wanted = Mapping[str, list[str]]
ROS: Wanted = {
    "/dvl": ["header.stamp", "twist.linear.x"],
    "/imu": ["header.stamp", "orientation.z"],
    "/usbl": ["header.stamp", "point.x"],
}
CSV: Wanted = {"/usbl": ["header.stamp", "east_m", "north_m"]}
TABLES: Wanted = {
    "/dvl": ["header.stamp", "forward_mps", "starboard_mps"],
    "/compass": ["header.stamp", "heading_deg"],
    "/gps": ["header.stamp", "lat_deg", "lon_deg"],
}
NMEA: Wanted = {"/HEHDT": ["heading_deg"], "/GPGGA": ["lat_deg", "lon_deg"]}
TLOG: Wanted = {
    "mavlink/255/0/VISION_POSITION_DELTA": ["message.time_usec", "message.position_delta.0"],
    "mavlink/1/1/ATTITUDE": ["message.time_boot_ms", "message.yaw"],
    "mavlink/1/1/GPS_RAW_INT": ["message.time_usec", "message.lat"],
}
BIN: Wanted = {"VISO": ["TimeUS", "PosDX"], "ATT": ["TimeUS", "Yaw"], "GPS[0]": ["TimeUS", "Lat"]}
PD0: Wanted = {"/bottom_track": ["x", "y", "z"], "/heading": ["heading_deg"], "/gga": ["latitude", "longitude"]}
PD5: Wanted = {"/bottom_track": ["y", "z"], "/heading": ["heading_deg"], "/depth": ["depth_m"]}
PD6: Wanted = {"/BI": ["x", "y", "z", "status"], "/SA": ["heading_deg"], "/TS": ["depth_m"]}
REPORTS: Wanted = {"/velocity": ["vx", "vy", "velocity_valid"]}
MOOS: Wanted = {"/iDVL": ["DVL_VEL_X", "DVL_VEL_Y"], "/iCompass": ["COMPASS_HEADING"], "/gGPS": ["GPS_LATITUDE"]}
IMC: Wanted = {"imc/30/DVL/GroundVelocity": ["x", "y"], "imc/30/6/EulerAngles": ["psi"], "imc/30/7/Depth": ["value"]}
BLUEOS: Wanted = {
    "mavlink/255/0/VISION_POSITION_DELTA": ["message.position_delta.0"],
    "mavlink/1/1/ATTITUDE": ["message.yaw"],
}


class Format(NamedTuple):
    """A format: how to write a file, what to read of it, and what its own checksums and counts show."""

    write: Callable[[Path], Path]
    wanted: Wanted = ROS
    shows: Literal["", "loss", "all"] = ""  # by its own checksums or counts: a loss; all: altered values, too
    times_checked: bool = True  # the checksums hold the times, too
    ends: Callable[[bytes], set[int]] = lambda whole: set()  # lengths at which a cut file is whole to all appearances
    folder: bool = False  # the log is the file's folder


def dive() -> list[Row]:
    """Return messages with numbers that all differ: a wrong value cannot be another's."""
    rows: list[Row] = []
    for k in range(COUNT):
        t = T0 + k * SECOND
        rows += [twist(t, 1 + k / 7, 0.5), yaw(t, 1 + k / 3), point(t, 1 + k / 11, 0.0)]
    return rows


def mcap(folder: Path, compression: CompressionType, chunked: bool = True, data_checksum: bool = False) -> Path:
    return write_mcap(folder / "a.mcap", dive(), compression, chunked, 4096, data_checksum=data_checksum)


def bag(folder: Path, compression: str) -> Path:
    return write_bag(folder / "a.bag", dive(), compression, 4096)


def rosbag2(folder: Path) -> Path:
    return write_rosbag2(folder / "a", dive()) / "a.db3"


def rosbag2_mcap(folder: Path) -> Path:
    return write_rosbag2(folder / "a", dive(), StoragePlugin.MCAP) / "a.mcap"


def text(file: Path, bodies: Iterable[str], address: str = "$") -> Path:
    """Write lines with checksums, each behind the time at which it was logged."""
    lines = (f"{T0 // SECOND + k}.25 {address}{sentence(body)[1:]}\r\n" for k, body in enumerate(bodies))
    file.write_bytes("".join(lines).encode())
    return file


def nmea(folder: Path) -> Path:
    """Write headings and fixes, in turn."""
    clocks = (f"12{26 + k // 30:02d}{k % 30 * 2:02d}.00" for k in range(COUNT))
    fixes = [f"GPGGA,{at},4500.{k:03d},N,00700.{k:03d},E,1,10,0.8,1.0,M,48.0,M,," for k, at in enumerate(clocks)]
    return text(folder / "a.nmea", (body for k, fix in enumerate(fixes) for body in (f"HEHDT,{k}.5,T", fix)))


def serial_lines(folder: Path) -> Path:
    """Write lines of Water Linked's serial protocol, which begin with a word."""
    bodies = (
        f"wrz,{1 + k / 64},0.25,-0.01,y,1.30,1.855,1e-07;0;1.4;0;1.2;0;0.2;0;1e+09,,,123.00,1" for k in range(COUNT)
    )
    return text(folder / "a.log", bodies, "")


def blueos(folder: Path) -> Path:
    attitudes = ((T0 + k * SECOND, "ATTITUDE", {"yaw": k / 20}) for k in range(COUNT))
    return write_blueos(
        folder / "a.mcap", [row for one in attitudes for row in (one, delta(one[0], 1 + one[2]["yaw"] / 7, 0.5))]
    )


def csv(folder: Path) -> Path:
    rng = random.Random(7)
    rows = (f"{T0 + k * SECOND},{rng.gauss(0, 100):.10f},{rng.gauss(0, 100):.10f}\n" for k in range(COUNT))
    return write_csv(folder / "a", usbl="time_ns,east_m,north_m\n" + "".join(rows)) / "usbl.csv"


def lsf(folder: Path) -> Path:
    from imc_recordings import write_lsf  # skips a test without imcpy

    return write_lsf(folder)


def parquet_file(folder: Path, checksums: bool) -> Path:
    file = folder / "gps.parquet"
    table = pa.table(dict(tables.dive(ROWS)["gps"]))
    parquet.write_table(table, file, row_group_size=ROWS // 10, write_page_checksum=checksums)
    return file


def arrow_file(folder: Path) -> Path:
    pd.DataFrame(dict(tables.dive(ROWS)["gps"])).to_feather(folder / "gps.arrow")
    return folder / "gps.arrow"


@cache
def workbook_content() -> bytes:
    """Return a workbook, which says when it was made: made once, its bytes are the same in all examples of a test."""
    content = BytesIO()
    with pd.ExcelWriter(content) as book:
        for name, columns in tables.dive(ROWS).items():
            pd.DataFrame(dict(columns)).astype(str).to_excel(book, sheet_name=name, index=False)
    return content.getvalue()


def workbook(folder: Path) -> Path:
    (folder / "dive.xlsx").write_bytes(workbook_content())
    return folder / "dive.xlsx"


def hdf5(folder: Path, chunks: int | None, **filters: Any) -> Path:
    file = folder / "dive.h5"
    with h5py.File(file, "w", libver="latest" if filters.get("fletcher32") else None) as content:
        for name, columns in tables.dive(ROWS).items():
            for label, values in columns.items():
                size = None if chunks is None else (chunks,)
                content.create_dataset(f"{name}/{label}", data=np.asarray(values), chunks=size, **filters)
    return file


def of_tables(folder: Path, form: str) -> Path:
    return tables.WRITERS[form](folder, tables.dive(ROWS))


def packed(pack: Callable[[bytes], bytes], write: Callable[[Path], Path], folder: Path) -> Path:
    file = write(folder)
    file.write_bytes(pack(file.read_bytes()))
    return file


def zstd(data: bytes) -> bytes:
    """Compress with a checksum, as the program zstd does, and in blocks as small for this file as its are for a log."""
    packer, size = zstandard.ZstdCompressor(write_checksum=True).compressobj(), 2048
    blocks = (packer.compress(data[k : k + size]) + packer.flush(1) for k in range(0, len(data), size))  # 1: a block
    return b"".join(blocks) + packer.flush()


def after(parts: list[bytes]) -> set[int]:
    """Return the lengths of a file that ends behind one of its messages."""
    return set(accumulate(map(len, parts)))


def line_ends(whole: bytes) -> set[int]:
    """Return where lines end; a carriage return is a line end, too."""
    ends = after(whole.splitlines(keepends=True))
    return ends | {end - 1 for end in ends if whole[end - 2 : end] == b"\r\n"}


def object_ends(whole: bytes) -> set[int]:
    """Return where lines of JSON end, each before, within and behind its line end."""
    return {end - back for end in line_ends(whole) for back in range(3)}


def messages_of_imc(_: bytes) -> set[int]:
    from imc_recordings import messages

    return after(messages())


def pd0_ends(whole: bytes) -> set[int]:
    return set(range(0, len(whole), len(whole) // dvls.COUNT))


NO_CHUNKS = partial(mcap, compression=CompressionType.NONE, chunked=False)
FORMATS: Mapping[str, Format] = {
    "MCAP zstd": Format(partial(mcap, compression=CompressionType.ZSTD), shows="all"),
    "MCAP lz4": Format(partial(mcap, compression=CompressionType.LZ4), shows="all"),
    "MCAP in chunks, uncompressed": Format(partial(mcap, compression=CompressionType.NONE), shows="all"),
    "MCAP without chunks, with a checksum": Format(partial(NO_CHUNKS, data_checksum=True), shows="all"),
    "MCAP without chunks": Format(NO_CHUNKS, shows="loss"),
    "MCAP of BlueOS (JSON)": Format(blueos, BLUEOS, shows="all"),
    "bag uncompressed": Format(partial(bag, compression="none"), shows="loss"),
    "bag bz2": Format(partial(bag, compression="bz2"), shows="all"),
    "bag lz4": Format(partial(bag, compression="lz4"), shows="loss"),
    "rosbag2 (SQLite)": Format(rosbag2, folder=True),
    "rosbag2 (MCAP)": Format(rosbag2_mcap, shows="loss", folder=True),
    "CSV": Format(csv, CSV, ends=line_ends),
    ".tlog": Format(
        lambda d: autopilots.write_tlog(d / "a.tlog"),
        TLOG,
        shows="all",
        times_checked=False,
        ends=lambda _: after(autopilots.packets()),
    ),
    ".BIN": Format(lambda d: autopilots.write_bin(d / "a.BIN"), BIN, ends=lambda _: after(autopilots.onboard())),
    "PD0": Format(lambda d: dvls.write_pd0(d / "a.pd0"), PD0, shows="all", ends=pd0_ends),
    "PD4": Format(lambda d: write_pd45(d / "a.pd4", 4), {"/bottom_track": ["y", "z"]}, shows="all", ends=pd0_ends),
    "PD5": Format(lambda d: write_pd45(d / "a.pd5", 5), PD5, shows="all", ends=pd0_ends),
    "PD6": Format(lambda d: dvls.write_pd6(d / "a.pd6"), PD6, ends=line_ends),
    "JSON lines": Format(lambda d: dvls.write_json(d / "a.jsonl"), REPORTS, ends=object_ends),
    ".alog": Format(lambda d: moos.write_alog(d / "a.alog"), MOOS, ends=line_ends),
    ".lsf": Format(lsf, IMC, shows="all", ends=messages_of_imc),
    "NMEA": Format(nmea, NMEA, shows="all", times_checked=False, ends=object_ends),
    "lines of a DVL": Format(serial_lines, {"/wrz": ["1", "2"]}, shows="all", times_checked=False, ends=object_ends),
    "Parquet": Format(partial(parquet_file, checksums=False), {"/gps": TABLES["/gps"]}),
    "Parquet with checksums of pages": Format(partial(parquet_file, checksums=True), {"/gps": TABLES["/gps"]}),
    "Arrow": Format(arrow_file, {"/gps": TABLES["/gps"]}),
    "workbook": Format(workbook, TABLES, shows="all"),
    "HDF5": Format(partial(hdf5, chunks=None), TABLES),
    "HDF5 records": Format(partial(of_tables, form="HDF5 records"), TABLES),
    "HDF5 gzip": Format(partial(hdf5, chunks=ROWS // 10, compression="gzip"), TABLES),
    "HDF5 with checksums": Format(partial(hdf5, chunks=ROWS // 10, fletcher32=True), TABLES, shows="all"),
    "netCDF-4": Format(lambda d: tables.as_netcdf(d, tables.dive(ROWS)), TABLES),
    ".mat 5 to 7, compressed": Format(partial(of_tables, form="MATLAB"), TABLES, shows="all"),
    ".mat 7.3": Format(partial(of_tables, form="MATLAB 7.3"), TABLES),
    "MCAP.zst": Format(partial(packed, zstd, partial(mcap, compression=CompressionType.NONE)), shows="all"),
    "CSV.gz": Format(partial(packed, gzip.compress, csv), CSV, shows="all"),
    "PD0.gz": Format(partial(packed, gzip.compress, lambda d: dvls.write_pd0(d / "a.pd0")), PD0, shows="all"),
    ".db3.zstd (no checksum)": Format(partial(packed, zstandard.compress, rosbag2)),
}
