"""Further files of a run: track.fnv for MB-System, and the tables as Parquet."""

import csv
import math
from datetime import UTC, datetime
from importlib.util import find_spec
from pathlib import Path

import pandas as pd
import pyarrow.parquet
import pytest

from checkout import SAMPLES
from commands import output_of, report_of, run
from logs import refusal
from recordings import saved
from usbldr.filters.errors import UsageError

LOG = SAMPLES / "lawnmower_turn_db3"
# one line as mblist prints it, without a head: year month day hour minute second, tab, seconds since 1970, ...
LINE = "2026 01 01 00 01 {k:02d}.000000\t{t}.000000\t-29.99999\t45.00001\t90.000\t3.600\t12.0000\t0.000\t0.000\t0.0000"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("fnv") / "run"
    output_of("replay", LOG, "-f", "ekf", "--fnv", "--plots", "none", "-q", "-o", out)
    return out


def test_every_column_is_that_of_the_format(folder: Path) -> None:
    head, *lines = (folder / "track.fnv").read_text(encoding="utf-8").splitlines()
    track = pd.read_csv(folder / "track_5hz.csv")[::5].reset_index(drop=True)
    start_ns = report_of(folder)["time_base"]["start_ns"]

    assert head.startswith("#")
    assert len(lines) == len(track)
    for line, row in zip(lines, track.to_dict("records"), strict=True):
        date, *numbers = line.split("\t")
        year, month, day, hour, minute = map(int, date.split()[:5])
        moment = datetime(year, month, day, hour, minute, tzinfo=UTC).timestamp() + float(date.split()[5])
        epoch_s, lon, lat, heading, kmph, draft, roll, pitch, heave, *swath = map(float, numbers)
        assert moment == pytest.approx(epoch_s, abs=2e-6) == start_ns / 1e9 + row["time_s"]
        assert (lat, lon) == pytest.approx((row["lat_deg"], row["lon_deg"]), abs=2e-9)
        assert heading == pytest.approx(row["heading_deg"], abs=1e-3)
        speed_mps = (row["starboard_mps"] ** 2 + row["forward_mps"] ** 2) ** 0.5
        assert kmph == pytest.approx(3.6 * speed_mps, abs=1e-3)
        assert (draft, roll, pitch, heave) == (0, 0, 0, 0)
        assert swath == [lon, lat, lon, lat]


def test_lines_of_mblist_are_read_as_a_truth(tmp_path: Path) -> None:
    start = int(datetime(2026, 1, 1, 0, 1, tzinfo=UTC).timestamp())
    lines = [LINE.format(k=k, t=start + k) + "\t-29.99999\t45.00001" * 2 for k in range(60)]
    options = ("-f", "dr", "--truth", saved(tmp_path / "ship.fnv", "\n".join(lines) + "\n"), "--plots", "none", "-q")
    output_of("replay", LOG, *options, "-o", tmp_path / "run")

    report = report_of(tmp_path / "run")
    assert report["truth"]["rows"] == 60
    assert report["metrics"]["matched"] == 60


def test_without_an_origin_a_sentence_says_what_is_missing(tmp_path: Path) -> None:
    times = [10**18 + k * 10**9 for k in range(3)]
    fixes = pd.DataFrame({"time_ns": times, "east_m": 0.0, "north_m": [0.0, 1.0, 2.0]})
    fixes.to_csv(tmp_path / "usbl.csv", index=False)

    done = run("replay", tmp_path, "-f", "usbl", "--fnv", "--plots", "none", "-o", tmp_path.parent / "run")

    assert done.exception is not None
    assert "[map]" in str(done.exception)
    assert not (tmp_path.parent / "run").exists()


def test_every_table_has_the_values_of_its_csv_file(tmp_path: Path) -> None:
    out = tmp_path / "run"
    output_of("replay", LOG, "-f", "ekf", "--parquet", "--plots", "none", "-q", "-o", out)
    tables = sorted(out.glob("*.csv"))
    assert {table.stem for table in tables} == {"errors_1hz", "fixes", "pose_5hz", "track_5hz"}
    for table in tables:
        with table.open(encoding="utf-8", newline="") as text:
            written = list(csv.DictReader(text))
        read = pyarrow.parquet.read_table(table.with_suffix(".parquet"))
        assert read.column_names == list(written[0])
        assert read.num_rows == len(written)
        for name in read.column_names:
            for value, cell in zip(read[name].to_pylist(), (row[name] for row in written), strict=True):
                assert _same(value, cell), (table.name, name, value, cell)
    assert {f"{table.stem}.parquet" for table in tables} <= set(report_of(out)["files"])


def _same(value: object, cell: str) -> bool:
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return cell == ""
    return str(value) == cell if isinstance(value, bool | str) else float(cell) == value


def test_without_pyarrow_the_option_names_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    finder = "usbldr_cli.run_output.find_spec"
    monkeypatch.setattr(finder, lambda name: None if name == "pyarrow" else find_spec(name))
    said = refusal(UsageError, output_of, "replay", LOG, "-f", "ekf", "--parquet", "-o", tmp_path / "run")
    assert "pip install 'usbldr[parquet]'" in said
    assert not (tmp_path / "run").exists()
