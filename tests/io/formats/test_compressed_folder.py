"""CSV files that are compressed inside their folder: the folder is the log that it would be with them decompressed."""

import gzip
from pathlib import Path

import pandas as pd
import pytest

from compressions import PACK
from logs import read_as, refusal
from recordings import SECOND, T0, saved, write_csv
from usbldr.filters.errors import LogError, UsageError
from usbldr.io.decoding.collected import read_whole
from usbldr.io.formats.detect import open_reader
from usbldr.io.limits import VARIABLE
from usbldr.io.reading.read import read_log

NAMES = {"gz": "gzip", "zst": "zstd", "bz2": "bzip2", "xz": "xz", "lz4": "lz4"}
COUNT = 60
TIMES = [T0 + k * SECOND for k in range(COUNT)]


def dive(folder: Path) -> Path:
    return write_csv(
        folder,
        dvl="time_ns,forward_mps,starboard_mps\n" + "\n".join(f"{t},{t % 977 / 700},0.5" for t in TIMES),
        nav__compass="time_ns,heading_deg\n" + "\n".join(f"{t},{t % 359}" for t in TIMES),
        gps="time_ns,lat_deg,lon_deg\n" + "\n".join(f"{t},45.0,{t % 89 / 7}" for t in TIMES),
    )


def packed(folder: Path, name: str, ending: str = "gz") -> Path:
    whole = (folder / name).read_bytes()
    (folder / name).unlink()
    return saved(folder / f"{name}.{ending}", PACK[ending](whole))


@pytest.mark.parametrize("ending", NAMES)
@pytest.mark.parametrize("names", [["dvl.csv"], ["dvl.csv", "gps.csv", "nav__compass.csv"]])
def test_a_folder_with_compressed_files_is_the_folder_without(tmp_path: Path, names: list[str], ending: str) -> None:
    plain = read_log(dive(tmp_path / "dive"))
    for name in names:
        packed(tmp_path / "dive", name, ending)
    log = read_log(tmp_path / "dive")

    assert log.format == f"CSV folder, {NAMES[ending]}"
    assert log.tables.keys() == plain.tables.keys() == {"dvl", "compass", "gps"}
    assert {role: p.topic for role, p in log.provenance.items()} == {r: p.topic for r, p in plain.provenance.items()}
    for sensor, table in plain.tables.items():
        pd.testing.assert_frame_equal(log.tables[sensor], table, check_exact=True)
    assert not [finding for finding in log.findings if finding.lost_data]


def test_columns_of_a_compressed_file_are_named_by_the_configuration(tmp_path: Path) -> None:
    folder = write_csv(tmp_path / "dive", ahrs="t,psi\n" + "\n".join(f"{t},{t % 7}" for t in TIMES))
    packed(dive(folder), "nav__compass.csv")
    packed(folder, "ahrs.csv")
    columns = '[compass]\ncolumns = { time_ns = "t", heading = "psi" }\n'

    assert read_as(folder, columns).tables["compass"]["heading_deg"].tolist() == [t % 7 for t in TIMES]
    named = columns.replace("columns", 'topic = "ahrs"\ncolumns').replace("psi", "phi")
    assert refusal(UsageError, read_as, folder, named).startswith(f"{folder / 'ahrs.csv.gz'}: /ahrs has no phi")


def test_a_copy_that_is_compressed_and_compressed_files_that_are_no_csv_are_passed_over(tmp_path: Path) -> None:
    folder = dive(tmp_path / "dive")
    saved(folder / "dvl.csv.gz", gzip.compress(b"time_ns,forward_mps,starboard_mps\n1,2,3\n"))
    saved(folder / "photo.gz", gzip.compress(bytes(range(256))))
    saved(folder / "cut.gz", gzip.compress(b"a,b\n")[:5])
    saved(folder / ".hidden.csv.gz", gzip.compress(b"time_ns,heading_deg\n1,2\n"))

    log = open_reader(folder)

    assert log.format == "CSV folder"
    assert {topic.name: topic.count for topic in log.topics()} == dict.fromkeys(("/dvl", "/gps", "/nav/compass"), COUNT)


def test_what_a_compressed_file_lacks_is_reported_with_its_name_and_an_error_if_it_is_all(tmp_path: Path) -> None:
    file = packed(dive(tmp_path / "dive"), "dvl.csv")
    whole = file.read_bytes()
    file.write_bytes(whole[: len(whole) * 3 // 4])
    log = read_log(tmp_path / "dive")

    assert 0 < len(log.tables["dvl"]) < COUNT
    assert len(log.tables["gps"]) == COUNT
    cut = [finding.text for finding in log.findings if finding.code == "TRUNCATED" and finding.lost_data]
    assert cut[0].startswith("dvl.csv.gz: the gzip data end early, at byte ")
    file.write_bytes(whole[:12])
    with pytest.raises(LogError, match=r"dvl.csv.gz: is damaged: no gzip data could be decompressed"):
        open_reader(tmp_path / "dive")


def test_a_wrong_cell_is_named_with_the_compressed_file(tmp_path: Path) -> None:
    folder = write_csv(tmp_path / "dive", dvl="time_ns,forward_mps,starboard_mps\n1,x,3")
    file = packed(folder, "dvl.csv")

    said = refusal(LogError, read_whole, open_reader(folder), {"/dvl": ["forward_mps"]})
    assert said == f'{file}: line 2: forward_mps is "x", not a number'


def test_a_file_that_decompresses_to_too_much_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = dive(tmp_path / "dive")
    (folder / "big.csv.gz").write_bytes(gzip.compress(b"a,b\n" + b"1,2\n" * 2_000_000))
    monkeypatch.setenv(VARIABLE, "0.01")

    with pytest.raises(LogError, match=r"big.csv.gz: .*--limits 10 raises the limits tenfold"):
        open_reader(folder)
