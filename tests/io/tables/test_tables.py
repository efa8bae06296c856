"""Tables in Parquet, HDF5 and MATLAB files: written by their own libraries, read as the CSV files that they equal."""

import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import h5py
import numpy as np
import pandas as pd
import pyarrow as pa
import pytest
import scipy.io
from pyarrow import parquet

from logs import lost, read_as
from recordings import SECOND, T0, saved
from table_recordings import COUNT, WRITERS, Tables, as_csv, dive
from usbldr.filters.errors import LogError, UsageError
from usbldr.io.decoding.collected import read_whole
from usbldr.io.formats.detect import open_reader
from usbldr.io.limits import VARIABLE
from usbldr.io.messages.configured import AT_1970, TIME_UNITS_NS
from usbldr.io.reading.opening import Request
from usbldr.io.reading.read import read_log
from usbldr.io.tables.hdf5_tables import hdf5_tables


@pytest.mark.parametrize("form", WRITERS)
def test_a_log_of_tables_is_the_log_of_the_csv_files_that_it_equals(tmp_path: Path, form: str) -> None:
    tables = dive()
    log, csv = read_log(WRITERS[form](tmp_path, tables)), read_log(as_csv(tmp_path, tables))

    assert log.format == form.removesuffix(" records").removesuffix(" 7.3")
    assert log.start_ns == csv.start_ns
    assert log.tables.keys() == csv.tables.keys() == {"dvl", "compass", "gps"}
    for sensor, table in csv.tables.items():
        pd.testing.assert_frame_equal(log.tables[sensor], table, check_exact=True)


@pytest.mark.parametrize(
    ("columns", "expected"),
    [
        (
            {"sensor": ["compass", "depth"] * 3, "heading_deg": [5.5, np.nan] * 3, "depth_m": [np.nan, 1.5] * 3},
            {"heading_deg": [5.5] * 3, "depth_m": [1.5] * 3},
        ),
        (
            {"Lat Deg": [45] * 6, "Lat Min": np.arange(6) * 1.5, "Lon Deg": [7] * 6, "Lon Min": [30] * 6},
            {"lat_deg": 45 + np.arange(6) * 1.5 / 60, "lon_deg": [7.5] * 6},
        ),
    ],
)
def test_sensors_in_turn_and_parts_of_angles_are_read_in_arrays_as_in_csv(tmp_path, columns, expected) -> None:
    table = pd.DataFrame({"time_ns": T0 + np.arange(6) * SECOND, **columns})
    table.to_parquet(tmp_path / "gps.parquet")
    table.to_csv(tmp_path / "gps.csv", index=False)

    for ending in ("csv", "parquet"):
        log = open_reader(tmp_path / f"gps.{ending}")
        wanted = {one.key: [path for path in one.fields if path in expected] for one in log.topics()}
        found = {path: column for one in read_whole(log, wanted).values() for path, column in one.columns.items()}
        assert found == {path: pytest.approx(column) for path, column in expected.items()}


@pytest.mark.parametrize("key", TIME_UNITS_NS)
@pytest.mark.parametrize("write", [as_csv, WRITERS["HDF5"], WRITERS["MATLAB"]])
def test_the_keys_for_times_are_understood_as_names_of_columns(tmp_path, write, key):
    since_1970 = np.arange(T0, T0 + 400 * SECOND, SECOND // 2)
    times = since_1970 if key == "time_ns" else since_1970 / TIME_UNITS_NS[key] + AT_1970.get(key, 0)
    log = read_log(write(tmp_path, {"compass": {key: times, "heading_deg": np.arange(len(times)) % 360.0}}))

    assert abs(log.start_ns - T0) < 24_000  # of a Julian Date
    np.testing.assert_allclose(log.tables["compass"]["time_s"], np.arange(len(times)) / 2, rtol=0, atol=8e-5)


@pytest.mark.parametrize("write", ["to_parquet", "to_feather"])
def test_timestamps_and_nulls_of_parquet_keep_their_meaning(tmp_path: Path, write: str) -> None:
    """A timestamp is a time whatever its unit; an empty whole number stays exact in the other rows."""
    moments = np.array([T0, T0 + SECOND // 4, np.iinfo(np.int64).min, T0 + SECOND]).astype("datetime64[ns]")
    columns = {"UTC": moments, "Heading (deg)": [1.5, None, 3.5, 4.5], "Depth [cm]": [100, 200, 300, None]}
    file = tmp_path / "nav.table"
    getattr(pd.DataFrame(columns).astype({"Depth [cm]": "Int64"}), write)(file)
    log = read_log(file)

    assert log.start_ns == T0
    np.testing.assert_array_equal(log.tables["compass"]["heading_deg"], [1.5, 4.5])
    np.testing.assert_array_equal(log.tables["compass"]["time_s"], [0.0, 1.0])
    np.testing.assert_array_equal(log.tables["depth"]["depth_m"], [1.0, 2.0])
    assert lost(log) == [
        f'/nav/{sensor}: 1 of 4 rows are left out: row 3: UTC is "", no time before 2116 in its unit'
        for sensor in ("compass", "depth")
    ]


@pytest.mark.parametrize("write", ["to_parquet", "to_feather"])
def test_the_times_of_day_of_parquet_are_of_the_dates_beside_them(tmp_path: Path, write: str) -> None:
    moments = pd.date_range("2020-09-13 23:59:58.5", periods=5, freq="s")
    columns = {"Date": moments.date, "Time": moments.time, "Heading (deg)": np.arange(5.0)}
    getattr(pd.DataFrame(columns), write)(tmp_path / "nav.table")
    log = read_log(tmp_path / "nav.table")

    assert log.start_ns == moments[0].value
    assert log.tables["compass"][["time_s", "heading_deg"]].to_numpy().tolist() == [[k, k] for k in range(5)]


def test_a_damaged_arrow_file_is_named(tmp_path: Path) -> None:
    file = tmp_path / "compass.feather"
    pd.DataFrame({"time_ns": [T0], "heading_deg": [1.0]}).to_feather(file)
    file.write_bytes(file.read_bytes()[:-40])

    with pytest.raises(LogError, match="cannot be read as Arrow: damaged, cut"):
        open_reader(file)


@pytest.mark.parametrize("form", ["Parquet", "HDF5"])
@pytest.mark.parametrize("notation", ["%Y-%m-%dT%H:%M:%S.%fZ", "%d.%m.%Y %H:%M:%S.%f"])
def test_texts_are_read_as_the_cells_of_csv_files(tmp_path: Path, form: str, notation: str) -> None:
    times = pd.to_datetime(T0 + np.arange(COUNT) * SECOND // 2)
    numbers = np.arange(COUNT) / 4
    texts = {"timestamp": [*times.strftime(notation)], "heading_deg": [*map(str, numbers[:-1]), "bad"], "n": numbers}
    log = read_log(WRITERS[form](tmp_path, {"compass": texts}))

    assert log.start_ns == T0
    np.testing.assert_array_equal(log.tables["compass"]["time_s"], np.arange(COUNT - 1) / 2)
    np.testing.assert_array_equal(log.tables["compass"]["heading_deg"], numbers[:-1])


TABLES = {"CSV": as_csv, "Parquet": WRITERS["Parquet"], "HDF5": WRITERS["HDF5"], "MATLAB": WRITERS["MATLAB"]}


@pytest.mark.parametrize("form", TABLES)
def test_times_and_angles_in_texts_are_the_same_in_all_tables(tmp_path: Path, form: str) -> None:
    angles = {"Latitude (deg)": ["45 30.0 S", "45 30.6 S"], "Longitude (deg)": ["E 7.25", "E 7.26"]}
    sides = {"Lat (deg)": [45.5, 45.51], "NS": ["S", "S"], "Lon (deg)": [7.25, 7.26], "EW": ["E", "E"]}
    parts = {"Month": [9, 9], "Day": [13, 13], "Hour": [12, 12], "Minute": [26, 26], "Second": [40.0, 41.5]}
    clocks = ["12:26:40", "12:26:41.5"]
    tables: Tables = {
        "compass": {"Date": ["13.09.2020", "13.09.2020"], "Time": clocks, "Heading (deg)": [1.0, 2.0]},
        "depth": {"Year": [2020, 2020], **parts, "Depth (m)": [3.0, 4.0]},
        "gps": {"Time (UTC+2)": ["2020-09-13 14:26:40", "2020-09-13 14:26:41.5"], **angles},
        "gnss": {"timestamp": [1_600_000_000.0, 1_600_000_001.5], **sides},
    }

    file = TABLES[form](tmp_path, tables)
    log, other = read_log(file, Request(topics={"gps": "/gps"})), read_log(file, Request(topics={"gps": "/gnss"}))

    assert log.start_ns == other.start_ns == 1_600_000_000 * SECOND
    assert [table["time_s"].tolist() for table in log.tables.values()] == [[0.0, 1.5]] * 3
    for one in (log, other):
        np.testing.assert_allclose(one.tables["gps"][["lat_deg", "lon_deg"]], [[-45.5, 7.25], [-45.51, 7.26]])


@pytest.mark.parametrize("form", TABLES)
def test_tables_of_times_of_day_lie_on_both_sides_of_midnight(tmp_path: Path, form: str) -> None:
    compass = {"Time": ["23:59:58.5", "23:59:59.5"], "Heading (deg)": [30.0, 31.0]}
    depth = {"Time": ["00:00:00.25", "00:00:01.25"], "Depth (m)": [3.0, 3.0]}

    log = read_log(TABLES[form](tmp_path, {"compass": compass, "depth": depth}))

    assert log.tables["compass"]["time_s"].tolist() == [0.0, 1.0]
    assert log.tables["depth"]["time_s"].tolist() == [1.75, 2.75]
    assert [one.text.partition(":")[0] for one in log.findings if one.code == "NO-DATE"] == [
        "compass.csv, depth.csv" if form == "CSV" else "compass, depth"
    ]


def test_texts_in_an_array_of_records_are_read(tmp_path: Path) -> None:
    rows = [(b"2020-09-13T12:26:40Z", "1.5"), (b"2020-09-13T12:26:41Z", "2.5")]
    with h5py.File(tmp_path / "dive.h5", "w") as file:
        file["compass"] = np.array(rows, dtype=[("time", "S24"), ("heading_deg", h5py.string_dtype())])

    log = read_log(tmp_path / "dive.h5")

    assert log.start_ns == 1_600_000_000 * SECOND
    assert log.tables["compass"][["time_s", "heading_deg"]].to_numpy().tolist() == [[0.0, 1.5], [1.0, 2.5]]


def test_the_elements_of_lists_in_parquet_are_columns_unless_they_are_texts(tmp_path: Path) -> None:
    columns = {"time_ns": [T0, T0 + SECOND], "velocity": [[1.5, 0.25], [1.75, 0.5]], "beams": [[1.0, 2.0], [3.0]]}
    pd.DataFrame(columns).to_parquet(tmp_path / "dvl.parquet")
    toml = '[dvl]\naxes = "FRD"\ncolumns = { time_ns = "time_ns", x = "velocity.0", y = "velocity.1" }\n'

    dvl = read_as(tmp_path / "dvl.parquet", toml).tables["dvl"]

    assert dvl[["forward_mps", "starboard_mps"]].to_numpy().tolist() == [[1.5, 0.25], [1.75, 0.5]]
    with pytest.raises(LogError, match="the lists of beams differ in length; write their elements as columns"):
        read_as(tmp_path / "dvl.parquet", toml.replace("velocity", "beams"))

    velocity = [["a", "b"], ["a"]]
    pd.DataFrame({"time_ns": [T0, T0 + SECOND], "velocity": velocity}).to_parquet(tmp_path / "dvl.parquet")

    log = open_reader(tmp_path / "dvl.parquet")

    (found,), (topic,) = log.findings(), log.topics()
    assert found.text == "dvl.parquet: velocity is not read: it holds a list in each row; write the elements as columns"
    assert topic.problem.endswith("; beside these: velocity (a list, not read)")


@pytest.mark.parametrize("form", ["list", "dict", "split"])
def test_columns_in_json_are_tables(tmp_path: Path, form: Literal["list", "dict", "split"]) -> None:
    frame = pd.DataFrame({"Time": ["2020-09-13 12:26:40", "2020-09-13 12:26:41.5"], "Heading (deg)": [1.5, None]})
    text = json.dumps({"compass": frame.to_dict(form)})
    file = saved(tmp_path / "dive.json", text.replace("NaN", "null"))

    records = read_whole(open_reader(file), {"/compass": ["heading_deg"]})["/compass"]

    assert records.received_ns.tolist() == [1_600_000_000 * SECOND, 1_600_000_001 * SECOND + SECOND // 2]
    np.testing.assert_array_equal(records.columns["heading_deg"], [1.5, np.nan])


@pytest.mark.parametrize("dated", [False, True])
def test_durations_are_times_unless_dates_stand_beside_them(tmp_path: Path, dated: bool) -> None:
    elapsed = pd.to_timedelta([0.25, 1.5], unit="s")
    columns = {"elapsed": elapsed, "Heading [deg]": [1.0, 2.0]}
    columns |= {"time": pd.Timestamp(T0) + elapsed} if dated else {}
    pd.DataFrame(columns).to_parquet(tmp_path / "compass.parquet")

    log = read_log(tmp_path / "compass.parquet")

    assert log.tables["compass"]["time_s"].tolist() == [0.0, 1.25]
    assert log.start_ns == 250_000_000 + T0 * dated


def test_whole_nanoseconds_beside_an_empty_cell_stay_exact(tmp_path: Path) -> None:
    times = pd.array([T0 + 1, None, T0 + 3], dtype="Int64")
    pd.DataFrame({"time_ns": times, "heading_deg": [1.0, 2.0, 3.0]}).to_parquet(tmp_path / "compass.parquet")

    wanted = {"/compass": ["header.stamp", "heading_deg"]}
    records = read_whole(open_reader(tmp_path / "compass.parquet"), wanted)["/compass"]

    assert records.received_ns.tolist() == records.columns["header.stamp"].tolist() == [T0 + 1, T0 + 3]


def test_members_of_structures_in_parquet_have_dots(tmp_path: Path) -> None:
    rows = [{"stamp_ns": T0 + k, "twist": {"linear": {"x_mps": 1.0 + k, "y_mps": 0.5}}} for k in range(3)]
    parquet.write_table(pa.Table.from_pylist(rows), tmp_path / "dvl.parquet")
    log = read_log(tmp_path / "dvl.parquet")

    np.testing.assert_array_equal(log.tables["dvl"]["forward_mps"], [1.0, 2.0, 3.0])


def test_units_of_netcdf_are_those_of_its_attributes(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "dive.nc", "w") as file:
        time = file.create_dataset("time", data=T0 / SECOND + np.arange(COUNT))
        time.attrs["units"] = "seconds since 1970-01-01 00:00"
        file.create_dataset("heading", data=np.full(COUNT, 0.5)).attrs["units"] = b"rad"
        file.create_dataset("velocity", data=np.tile([1500.0, 250.0], (COUNT, 1))).attrs["units"] = "mm/s"
        file.create_dataset("depth", data=np.arange(5.0)).attrs["units"] = "m"  # of a sound speed profile
        file["serial"] = 5
    log = open_reader(tmp_path / "dive.nc")

    assert [topic.name for topic in log.topics() if not topic.problem] == [f"/dive/{COUNT}_rows"]
    fields = '{ time_unix_s = "time [s]", x = "velocity.0 [mm/s]", y = "velocity.1 [mm/s]" }'
    found = read_as(tmp_path / "dive.nc", f"[dvl]\ncolumns = {fields}\n")
    np.testing.assert_allclose(found.tables["dvl"][["forward_mps", "starboard_mps"]], [[1.5, -0.25]] * COUNT)
    np.testing.assert_allclose(found.tables["compass"]["heading_deg"], np.degrees(0.5))


def write_velocities(file: Path, unit: str) -> Path:
    with h5py.File(file, "w") as content:
        content.create_dataset("time", data=T0 / SECOND + np.arange(COUNT)).attrs["units"] = "s"
        for name in ("vel_forward", "vel_starboard"):
            content.create_dataset(name, data=np.full(COUNT, 150.0)).attrs["units"] = unit
    return file


@pytest.mark.parametrize(
    "unit", ["cm s-1", "cm.s-1", "cm s^-1", "cm s**-1", "cm s⁻¹", "centimetres per second", "cm/sec"]
)
def test_units_of_netcdf_are_spelled_as_in_the_cf_conventions(tmp_path: Path, unit: str) -> None:
    dvl = read_log(write_velocities(tmp_path / "dvl.nc", unit)).tables["dvl"]

    np.testing.assert_allclose(dvl[["forward_mps", "starboard_mps"]], 1.5)


def test_an_unknown_unit_of_an_attribute_is_an_error_unless_the_section_states_one(tmp_path: Path) -> None:
    file = write_velocities(tmp_path / "dvl.nc", "furlong s-1")
    (topic,) = open_reader(file).topics()
    assert "has a column vel_forward [furlong s-1] without a known unit" in topic.problem

    section = '[dvl]\ncolumns = { time_unix_s = "time", x = "vel_forward", y = "vel_starboard" }\n'
    with pytest.raises(UsageError, match=r"x: the unit of vel_forward \[furlong s-1\] is not one of m/s"):
        read_as(file, section)
    np.testing.assert_allclose(read_as(file, f'{section}unit = "cm/s"\n').tables["dvl"]["forward_mps"], 1.5)


def test_packed_values_of_netcdf_are_unpacked(tmp_path: Path) -> None:
    places = np.arange(COUNT) * 1e-5
    with h5py.File(tmp_path / "dive.nc", "w") as file:
        file.create_dataset("time", data=np.arange(COUNT)).attrs["units"] = "seconds since 2020-09-13 12:26:40"
        heading = file.create_dataset("heading", data=(100 * np.arange(COUNT)).astype("i2"))
        heading.attrs.update({"units": "degrees", "scale_factor": 0.01, "add_offset": np.array([180.0])})
        heading.attrs.update({"_FillValue": np.int16(200), "missing_value": np.array([400, 500], dtype="i2")})
        lat = file.create_dataset("gps_latitude", data=(45 + places).astype("f8"))
        lat.attrs.update({"units": "degrees_north", "_FillValue": 45 + 7e-5})
        file.create_dataset("gps_longitude", data=7 + places).attrs["units"] = b"degrees_east"

    log = read_log(tmp_path / "dive.nc")

    kept = [k for k in range(COUNT) if k not in (2, 4, 5)]
    np.testing.assert_allclose(log.tables["compass"]["heading_deg"], 180.0 + np.array(kept))
    np.testing.assert_allclose(log.tables["gps"]["lat_deg"], 45 + np.delete(places, 7), rtol=1e-12)
    np.testing.assert_allclose(log.tables["gps"]["lon_deg"], 7 + np.delete(places, 7), rtol=1e-12)


def test_a_whole_number_without_a_value_leaves_the_others_exact(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "dive.h5", "w") as file:
        file["compass/time_ns"] = np.array([T0 + 1, -1, T0 + 3])
        file["compass/time_ns"].attrs["_FillValue"] = -1
        file["compass/heading_deg"] = np.arange(3.0)

    read = read_whole(open_reader(tmp_path / "dive.h5"), {"/compass": []})["/compass"]
    assert read.received_ns.tolist() == [T0 + 1, T0 + 3]


def test_what_is_in_other_files_or_has_too_many_dimensions_is_named(tmp_path: Path) -> None:
    records = np.zeros((5, 2), dtype=[("time_ns", "i8"), ("forward_mps", "f8"), ("starboard_mps", "f8")])
    layout = h5py.VirtualLayout(shape=(5,), dtype="f8")
    layout[:] = h5py.VirtualSource("other.h5", "a", shape=(5,))
    with h5py.File(tmp_path / "dive.h5", "w") as file:
        for name, values in dive()["compass"].items():
            file[f"compass/{name}"] = values
        file["usbl"] = h5py.ExternalLink("other.h5", "/usbl")
        file["setup/picture"] = h5py.ExternalLink("other.h5", "/picture")
        file["gps/gone"] = h5py.SoftLink("/raw/gps")
        file["dvl"] = records
        file.create_virtual_dataset("depth/depth_m", layout)

    found = open_reader(tmp_path / "dive.h5").findings()

    assert {(one.code, one.text, one.lost_data) for one in found} == {
        ("NOT-READ", f"dive.h5: {path} is not read: {why}", path != "setup/picture")
        for path, why in {
            "usbl": "it is a link into other.h5; copy its contents into this file",
            "setup/picture": "it is a link into other.h5; copy its contents into this file",
            "gps/gone": "it is a link to /raw/gps, which is not there",
            "dvl": "its records have 2 dimensions, not one",
            "depth/depth_m": "its values are in other files; copy them into this one",
        }.items()
    }


@pytest.mark.parametrize("form", ["Parquet", "HDF5"])
def test_targets_of_a_table_are_texts(tmp_path: Path, form: str) -> None:
    fixes = {"t_s": np.arange(4.0), "e": np.arange(4.0), "n": np.arange(4.0), "who": ["a", "b", "a", "b"]}
    columns = '{ time_s = "t_s", x = "e", y = "n", target = "who" }'

    log = read_as(WRITERS[form](tmp_path, {"fixes": fixes}), f'[usbl]\ntarget = "b"\ncolumns = {columns}\n')

    np.testing.assert_array_equal(log.tables["usbl"]["east_m"], [1.0, 3.0])


def test_records_in_a_column_are_a_table_and_names_are_none(tmp_path: Path) -> None:
    columns = dive()["compass"]
    records = np.zeros((COUNT, 1), dtype=[("time_ns", "i8"), ("heading_deg", "f8")])
    for name in ("time_ns", "heading_deg"):
        records[name][:, 0] = columns[name]
    with h5py.File(tmp_path / "dive.h5", "w") as file:
        file["compass"] = records
        file["fixes/e"], file["fixes/names"] = np.arange(4.0), ["e", "n"]
    log = open_reader(tmp_path / "dive.h5")

    found = read_whole(log, {"/compass": ["heading_deg"]})["/compass"]
    np.testing.assert_array_equal(found.columns["heading_deg"], columns["heading_deg"])
    assert [topic.name for topic in log.topics()] == ["/compass", "/fixes"]


@pytest.mark.parametrize("form", ["HDF5", "MATLAB", "MATLAB 7.3"])
def test_a_time_may_stand_in_another_structure(tmp_path: Path, form: str) -> None:
    clock = {"Time": np.arange(COUNT) / 2}
    track = {"Vel": np.tile([0.25, 1.5, 0.1, 9.9], (COUNT, 1)), "Cells": np.zeros(COUNT)}
    columns = '{ time_s = "/system/Time", x = "Vel[0]", y = "Vel.1" }'
    file = WRITERS[form](tmp_path, {"system": clock, "track": track, "setup": {"Pings": np.array([3])}})
    log = read_as(file, f'[dvl]\naxes = "SFU"\ntopic = "track"\ncolumns = {columns}\n')

    np.testing.assert_array_equal(log.tables["dvl"][["starboard_mps", "forward_mps"]], [[0.25, 1.5]] * COUNT)
    np.testing.assert_array_equal(log.tables["dvl"]["time_s"], np.arange(COUNT) / 2)
    assert [topic.name for topic in open_reader(file).topics()] == ["/system", "/track"]


@pytest.mark.parametrize(
    ("form", "module", "extra"),
    [("Parquet", "pyarrow", "parquet"), ("HDF5", "h5py", "hdf5"), ("MATLAB", "scipy.io", "mat")],
)
def test_without_its_library_the_sentence_names_the_extra(tmp_path, form, module, extra, monkeypatch):
    file = WRITERS[form](tmp_path, dive())
    monkeypatch.setitem(sys.modules, module, None)

    with pytest.raises(UsageError, match=rf"{form} files need \w+: pip install 'usbldr\[{extra}\]'"):
        open_reader(file)


def parquet_in_groups(folder: Path, columns: Mapping[str, Any], damaged: str) -> tuple[Path, int]:
    """Write groups of ten rows; return the file, and the last byte of a column's second group."""
    file = folder / "compass.parquet"
    how: dict[str, Any] = {"row_group_size": 10, "write_page_checksum": True, "use_dictionary": False}
    parquet.write_table(pa.table(dict(columns)), file, **how)
    column = parquet.ParquetFile(file).metadata.row_group(1).column(list(columns).index(damaged))
    return file, column.data_page_offset + column.total_compressed_size - 1


def hdf5_in_chunks(folder: Path, columns: Mapping[str, Any], damaged: str) -> tuple[Path, int]:
    """Write chunks of ten rows; return the file, and the last byte of a column's second chunk."""
    file = folder / "dive.h5"
    with h5py.File(file, "w") as content:
        for label, values in columns.items():
            content.create_dataset(f"compass/{label}", data=values, chunks=(10,), fletcher32=True)
        chunk = content[f"compass/{damaged}"].id.get_chunk_info(1)
        return file, chunk.byte_offset + chunk.size - 1


def test_numbers_of_more_than_eight_bytes_are_read(tmp_path: Path) -> None:
    tables = {name: {key: np.asarray(cells) for key, cells in one.items()} for name, one in dive().items()}
    tables["gps"]["lat_deg"] = tables["gps"]["lat_deg"].astype(np.longdouble)

    log = read_log(WRITERS["HDF5"](tmp_path, tables))

    np.testing.assert_array_equal(log.tables["gps"]["lat_deg"], dive()["gps"]["lat_deg"])


@pytest.mark.parametrize("write", [parquet_in_groups, hdf5_in_chunks])
def test_a_damaged_column_is_an_error_if_it_is_used(tmp_path, write):
    compass = {**dive()["compass"], "sd_deg": np.arange(COUNT) / 10}
    file, place = write(tmp_path, compass, "heading_deg")
    bent = bytearray(file.read_bytes())
    bent[place] ^= 1
    file.write_bytes(bent)
    log = open_reader(file)

    found = read_whole(log, {"/compass": ["sd_deg"]})["/compass"].columns["sd_deg"]
    np.testing.assert_array_equal(found, compass["sd_deg"])
    with pytest.raises(LogError, match="damaged, cut or of an unknown kind"):
        read_whole(log, {"/compass": ["heading_deg"]})


@pytest.mark.parametrize(
    ("damage", "sentence"), [("free space of no size", "a text that has no end"), ("a text of 4 GB", "too much for")]
)
def test_damaged_texts_of_hdf5_end_neither_time_nor_memory(tmp_path: Path, damage: str, sentence: str) -> None:
    file = tmp_path / "dive.h5"
    with h5py.File(file, "w") as content:
        content["fixes/t_s"] = np.arange(40.0)
        content["fixes/who"] = ["a transponder"] * 40
        first = content["fixes/who"].id.get_offset()
    bent = bytearray(file.read_bytes())
    reference = np.frombuffer(bytes(bent[first : first + 16]), [("bytes", "<u4"), ("heap", "<u8"), ("text", "<u4")])
    if damage == "a text of 4 GB":
        bent[first : first + 4] = b"\xff" * 4
    else:
        free = int(reference["heap"][0]) + 16 + 40 * (16 + 16)  # behind its head, and 40 texts with theirs
        assert bent[free : free + 2] == bytes(2)
        bent[free + 8 : free + 16] = bytes(8)
    file.write_bytes(bent)

    with pytest.raises(LogError, match=sentence):
        hdf5_tables(file)[0].columns["who"]()


def long_parquet(folder: Path, rows: int) -> Path:
    zeros = pa.array(np.zeros(rows, dtype=np.int64))
    parquet.write_table(pa.table({"time_ns": zeros, "heading_deg": zeros}), folder / "compass.parquet")
    return folder / "compass.parquet"


def long_arrow(folder: Path, rows: int) -> Path:
    zeros = np.zeros(rows, dtype=np.int64)
    pd.DataFrame({"time_ns": zeros, "heading_deg": zeros}).to_feather(folder / "compass.arrow", compression="zstd")
    return folder / "compass.arrow"


def long_mat(folder: Path, rows: int) -> Path:
    """Write a variable that is no column, which must not be decompressed either."""
    compass = {"time_ns": T0 + np.arange(5), "heading_deg": np.zeros(5)}
    pictures = np.zeros((rows // 100, 10, 10))
    scipy.io.savemat(folder / "dive.mat", {"compass": compass, "pictures": pictures}, do_compression=True)
    return folder / "dive.mat"


@pytest.mark.parametrize("write", [long_parquet, long_arrow, long_mat])
def test_tables_far_longer_than_their_file_are_refused(tmp_path, write, monkeypatch):
    file = write(tmp_path, 400_000)
    monkeypatch.setenv(VARIABLE, "0.01")
    monkeypatch.setattr(parquet.ParquetWriter, "write_batch", lambda *_: None)  # that of Arrow is not read as a copy

    with pytest.raises(LogError, match="too much for its size; --limits 10 raises the limits tenfold"):
        read_log(file)


@pytest.mark.parametrize(("column", "cell"), [("heading_deg", "north"), ("time_ns", "12.05.x"), ("Date", "May 5th")])
@pytest.mark.parametrize("write", ["to_csv", "to_parquet"])
def test_the_cell_that_cannot_be_read_is_named(tmp_path: Path, write: str, column: str, cell: str) -> None:
    times = [f"2020-09-13 12:26:4{k}" for k in range(9)] if column == "Date" else [str(T0 + k) for k in range(9)]
    cells = pd.DataFrame({"Date" if column == "Date" else "time_ns": times, "heading_deg": ["1.5"] * 9})
    file = tmp_path / f"compass.{write.removeprefix('to_')}"
    cells.loc[5, column] = cell
    getattr(cells, write)(file, index=False)

    log = read_log(file)

    (text,) = lost(log)
    place = "line 7" if write == "to_csv" else "row 6"
    assert f'1 of 9 rows are left out: {place}: {column} is "{cell}", not a' in text
    assert len(log.tables["compass"]) == 8
    cells[column] = cell
    getattr(cells, write)(file, index=False)
    with pytest.raises(LogError) as stopped:
        read_log(file)
    assert column in stopped.value.text
    assert f'"{cell}"' in stopped.value.text


def test_arrays_of_structures_of_matlab_are_tables(tmp_path: Path) -> None:
    kinds = [(name, object) for name in ("time", "vel", "nav", "note", "beams")]
    rows: list[Any] = [
        (T0 / SECOND + k, [1.5, 0.1 * k], {"hdg": 10.0 + k}, "a", np.zeros(1 + k % 2)) for k in range(COUNT)
    ]
    rows[3] = (rows[3][0], rows[3][1], {"hdg": np.empty((0, 0))}, *rows[3][3:])
    scipy.io.savemat(tmp_path / "dive.mat", {"dvl": np.array(rows, dtype=kinds)})
    log = open_reader(tmp_path / "dive.mat")

    columns = {topic.name: [name for name, _ in topic.first_row] for topic in log.topics()}
    assert columns == {"/dvl": ["time", "vel.0", "vel.1", "note"], "/dvl/nav": ["hdg"]}
    toml = '[dvl]\ntopic = "/dvl"\ncolumns = { time_unix_s = "time", x = "vel.0", y = "vel.1" }\n'
    toml += '[compass]\ncolumns = { time_unix_s = "/dvl/time", heading = "hdg" }\n'
    found = read_as(tmp_path / "dive.mat", toml)
    assert found.tables["dvl"]["forward_mps"].tolist() == [1.5] * COUNT
    assert found.tables["compass"]["heading_deg"].tolist() == [10.0 + k for k in range(COUNT) if k != 3]


def test_arrays_of_structures_of_matlab_7_3_are_tables(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "dvl.h5", "w") as file:
        for name, values in (("time", T0 / SECOND + np.arange(COUNT)), ("heading", np.arange(10.0, 10 + COUNT))):
            cells = [file.create_dataset(f"#refs#/{name}{k}", data=[[value]]) for k, value in enumerate(values)]
            references = file.create_dataset(f"gyro/{name}", (COUNT, 1), dtype=h5py.ref_dtype)
            references[:, 0] = [cell.ref for cell in cells]
        references[1, 0] = h5py.Reference()
        file["gyro/none"] = np.array([h5py.Reference()] * COUNT, dtype=h5py.ref_dtype)
        file["gyro/note"] = np.array([file["gyro"].ref] * COUNT, dtype=h5py.ref_dtype)

    found = read_as(tmp_path / "dvl.h5", '[compass]\ncolumns = { time_unix_s = "time", heading = "heading" }\n')

    assert found.tables["compass"]["heading_deg"].tolist() == [10.0 + k for k in range(COUNT) if k != 1]
