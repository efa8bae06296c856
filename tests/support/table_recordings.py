"""Tables in CSV, Parquet, HDF5 and MATLAB files, written by their own libraries."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pandas as pd
import pyarrow as pa
import scipy.io
from pyarrow import parquet

from recordings import SECOND, T0, write_csv

COUNT = 50
SINCE = "seconds since 2020-09-13 12:26:40"
Columns = Mapping[str, Any]
Tables = Mapping[str, Columns]


def dive(count: int = COUNT) -> Tables:
    """Return tables with usbldr's own names; no time is a multiple of a microsecond."""
    rng, times = np.random.default_rng(5), T0 + np.arange(count) * SECOND + 123_456_789
    return {
        "dvl": {"time_ns": times, "forward_mps": rng.normal(1, 0.1, count), "starboard_mps": rng.normal(0, 1, count)},
        "compass": {"time_ns": times + 7, "heading_deg": rng.uniform(0, 360, count)},
        "gps": {
            "time_ns": times + 5,
            "lat_deg": 60 + rng.normal(0, 1e-5, count),
            "lon_deg": 10 + rng.normal(0, 1e-5, count),
        },
    }


def as_csv(folder: Path, tables: Tables) -> Path:
    texts = {name: pd.DataFrame(dict(columns)).to_csv(index=False) for name, columns in tables.items()}
    return write_csv(folder / "csv", **texts)


def as_parquet(folder: Path, tables: Tables) -> Path:
    (folder / "parquet").mkdir()
    for name, columns in tables.items():
        parquet.write_table(pa.table(dict(columns)), folder / "parquet" / f"{name}.parquet")
    return folder / "parquet"


def as_hdf5(folder: Path, tables: Tables) -> Path:
    with h5py.File(folder / "dive.h5", "w") as file:
        for name, columns in tables.items():
            for label, values in columns.items():
                file.create_dataset(f"{name}/{label}", data=values, compression="gzip")
    return folder / "dive.h5"


def as_records(folder: Path, tables: Tables) -> Path:
    """Write an array of records for each table, as PyTables does."""
    with h5py.File(folder / "dive.hdf5", "w") as file:
        for name, columns in tables.items():
            file.create_dataset(name, data=pd.DataFrame(dict(columns)).to_records(index=False))
    return folder / "dive.hdf5"


def as_mat(folder: Path, tables: Tables) -> Path:
    scipy.io.savemat(
        folder / "dive.mat", {name: dict(columns) for name, columns in tables.items()}, do_compression=True
    )
    return folder / "dive.mat"


def as_mat_7_3(folder: Path, tables: Tables) -> Path:
    """Write as MATLAB does: HDF5 behind 512 bytes, vectors as matrices of one row."""
    with h5py.File(folder / "dive.mat", "w", userblock_size=512) as file:
        for name, columns in tables.items():
            for label, values in columns.items():
                file.create_dataset(f"{name}/{label}", data=np.atleast_2d(np.asarray(values).T))
    with (folder / "dive.mat").open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")
    return folder / "dive.mat"


def as_netcdf(folder: Path, tables: Tables) -> Path:
    """Write a group of variables for each table, whose times are seconds since a date."""
    with h5py.File(folder / "dive.nc", "w") as file:
        for name, columns in tables.items():
            seconds = (np.asarray(columns["time_ns"]) - T0) / SECOND
            file.create_dataset(f"{name}/time", data=seconds).attrs["units"] = np.bytes_(SINCE)
            for label in columns.keys() - {"time_ns"}:
                file.create_dataset(f"{name}/{label}", data=columns[label])
    return folder / "dive.nc"


WRITERS: Mapping[str, Callable[[Path, Tables], Path]] = {
    "Parquet": as_parquet,
    "HDF5": as_hdf5,
    "HDF5 records": as_records,
    "MATLAB": as_mat,
    "MATLAB 7.3": as_mat_7_3,
}
