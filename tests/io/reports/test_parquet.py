"""The tables as Parquet: the numbers of the CSV files, read by pyarrow and by Python's csv module."""

import csv
import json
import math
from importlib.util import find_spec
from pathlib import Path

import pyarrow.parquet
import pytest

from checkout import SAMPLES
from commands import output_of
from logs import refusal
from usbldr.filters.errors import UsageError

LOG = SAMPLES / "lawnmower_turn_db3"


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
    listed = json.loads((out / "report.json").read_text(encoding="utf-8"))["files"]
    assert {f"{table.stem}.parquet" for table in tables} <= set(listed)


def _same(value: object, cell: str) -> bool:
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return cell == ""
    return str(value) == cell if isinstance(value, bool | str) else float(cell) == value


def test_without_pyarrow_the_option_names_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    finder = "usbldr_cli.options.run_outputs.find_spec"
    monkeypatch.setattr(finder, lambda name: None if name == "pyarrow" else find_spec(name))
    said = refusal(UsageError, output_of, "replay", LOG, "-f", "ekf", "--parquet", "-o", tmp_path / "run")
    assert "pip install 'usbldr[parquet]'" in said
    assert not (tmp_path / "run").exists()
