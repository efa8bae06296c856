"""Of a damaged file of tables the parts are read that the library can read, and the others are reported."""

from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest
from pyarrow import parquet

from damaged_formats import ROWS, hdf5, parquet_file
from table_recordings import dive
from usbldr.io.formats.detect import open_log

GOOD = [k for k in range(ROWS) if k // 50 != 3]  # the rows outside the damaged part


def altered(file: Path, at: int) -> Path:
    data = bytearray(file.read_bytes())
    data[at] ^= 1
    file.write_bytes(data)
    return file


def damaged_parquet(folder: Path, column: str) -> Path:
    file = parquet_file(folder, checksums=True)
    group = parquet.ParquetFile(file).metadata.row_group(3)
    (one,) = (group.column(k) for k in range(3) if group.column(k).path_in_schema == column)
    return altered(file, one.dictionary_page_offset + one.total_compressed_size // 2)


def damaged_hdf5(folder: Path, column: str) -> Path:
    file = hdf5(folder, ROWS // 10, compression="gzip")
    with h5py.File(file) as content:
        chunk = content[f"gps/{column}"].id.get_chunk_info(3)  # type: ignore[union-attr]
    return altered(file, chunk.byte_offset + chunk.size // 2)


@pytest.mark.parametrize(("write", "part"), [(damaged_parquet, "groups of rows"), (damaged_hdf5, "chunks")])
@pytest.mark.parametrize("column", ["time_ns", "lat_deg"])
def test_what_is_whole_of_a_damaged_column_is_read(
    tmp_path: Path, write: Callable[[Path, str], Path], part: str, column: str
) -> None:
    log, whole = open_log(write(tmp_path, column)), dive(ROWS)["gps"]
    records = log.read({"/gps": ["lat_deg", "lon_deg"]})["/gps"]
    lat, lon = np.array(whole["lat_deg"]), np.array(whole["lon_deg"])

    if column == "time_ns":
        np.testing.assert_array_equal(records.received_ns, whole["time_ns"][GOOD])
        np.testing.assert_array_equal(records.columns["lat_deg"], lat[GOOD])
    else:
        np.testing.assert_array_equal(records.received_ns, whole["time_ns"])
        np.testing.assert_array_equal(records.columns["lat_deg"][GOOD], lat[GOOD])
        assert np.isnan(records.columns["lat_deg"]).sum() == ROWS - len(GOOD)
        np.testing.assert_array_equal(records.columns["lon_deg"], lon)
    first, *_ = (finding for finding in log.findings() if finding.lost_data)
    assert first.text == f"/gps: 1 of 10 {part} of the column {column} cannot be read; left out"
