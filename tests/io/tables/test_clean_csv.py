"""The fast path for clean CSV files gives what the cells one by one give, whatever the cells are."""

from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from unittest.mock import patch

import numpy as np
from hypothesis import example, given, settings
from hypothesis import strategies as st

from recordings import T0, saved, write_csv
from usbldr.filters.errors import LogError
from usbldr.io.decoding.collected import read_whole
from usbldr.io.formats.detect import open_reader
from usbldr.io.tables import clean_csv, csv_text
from usbldr.io.tables.cells import numbers, times
from usbldr.io.tables.clean_csv import NumberColumn
from usbldr.io.tables.csv_text import read_texts

numeric = st.floats(-1e12, 1e12).map(repr) | st.integers(-(2**70), 2**70).map(str)
stamps = st.integers(0, 10**9).map(lambda ns: f"{1_474_477_150 + ns // 7}.{ns:09d}")
SPELLED = """\
5 +5 1. .5 1e5 1E 1e 0x1A 1_0 nan nan(ind) -inf Infinity NA true False TRUE --1 1- 007 1.0.0 " "7" # a
9223372036854775808"""
spelled = st.sampled_from(["", " 5", "5 ", "\xa07", "7\0", "\r", "x y", *SPELLED.split()])
kinds = (numeric, stamps, spelled, numeric | spelled)
columns = st.one_of(*(st.lists(cells, min_size=5, max_size=5) for cells in kinds))


def interpreted(file: Path) -> tuple[Any, ...]:
    """Return everything that can be asked of a file's cells."""
    try:
        table = read_texts(file)
    except LogError as err:
        return (str(err),)
    readings = (numbers, times, lambda c, n: times(c, n, 10**9), lambda c, n: times(c, n, 1000, 7))
    parsed = [reading(cells, name) for name, cells in table.columns.items() for reading in readings]
    texts = [list(cells) for cells in table.columns.values()]
    values = [(np.delete(one.values, list(one.faults)).tobytes(), dict(one.faults)) for one in parsed]
    return list(table.lines), dict(table.left_out), table.cut_line, texts, values


@settings(max_examples=60, deadline=None)
@given(
    table=st.lists(columns, min_size=2, max_size=3),
    end=st.sampled_from(["\n", "\n", "\r\n", ""]),
    wide=st.just(0) | st.integers(0, 5),
    narrow=st.just(0) | st.integers(0, 5),
)
@example(table=[["1600000000.123456789"] * 5, ["1"] * 5], end="\n", wide=0, narrow=0)
@example(table=[["1", "2", "3", '"4', "5"], ["1"] * 5], end="\n", wide=0, narrow=0)
@example(table=[["1", "2", "3", "4", "5"], ["1"] * 5], end="\n", wide=1, narrow=2)
@example(table=[["1", "nan", "True", "", "5"], ["1", "", "", "1", "5"]], end="\n", wide=0, narrow=0)
def test_a_cell_means_the_same_on_all_paths(table: Sequence[Sequence[str]], end: str, wide: int, narrow: int) -> None:
    lines = ["time,b,c"[: 2 * len(table) + 2], *map(",".join, zip(*table, strict=True))]
    lines[wide] += ",7" if wide else ""
    lines[narrow] = lines[narrow].rpartition(",")[0] if narrow else lines[0]
    with TemporaryDirectory() as name:
        (file := Path(name) / "a.csv").write_bytes("\n".join(lines).encode() + end.encode())
        fast = interpreted(file)
        with patch.object(csv_text, "clean_columns", lambda *_: None):
            assert fast == interpreted(file)
        with patch.object(clean_csv, "_by_pyarrow", lambda *_: None):
            assert fast == interpreted(file)


def test_a_clean_file_may_have_any_ending(tmp_path: Path) -> None:
    write_csv(tmp_path / "dive", dvl="time_utc,forward_mps,starboard_mps\n2026-01-01T00:00:00Z,2.5,0.1")
    (tmp_path / "dive" / "dvl.csv").rename(tmp_path / "dive" / "dvl.csv.gz")

    log = open_reader(tmp_path / "dive")

    assert read_whole(log, {"/dvl.csv": ["forward_mps"]})["/dvl.csv"].columns["forward_mps"].tolist() == [2.5]


def test_a_clean_file_takes_the_fast_path(tmp_path: Path) -> None:
    rows = (f"{T0 + k},{k / 7},{'ab'[k % 2]}\r\n" for k in range(30_000))
    table = read_texts(saved(tmp_path / "a.csv", "time_ns,x,name\n" + "".join(rows)))

    assert [isinstance(cells, NumberColumn) for cells in table.columns.values()] == [True, True, False]
    assert list(table.columns["x"])[12_345] == str(12_345 / 7)
    assert table.lines[-1] == len(table.lines) + 1 == 30_001
