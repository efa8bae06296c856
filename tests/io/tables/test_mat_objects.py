"""Objects in MATLAB's files, by the book as far as there is one: they are named, and never taken for numbers."""

from pathlib import Path

import h5py
import numpy as np
import pytest
import scipy.io

from logs import refusal
from recordings import SECOND, T0, saved
from usbldr.filters.errors import LogError
from usbldr.io.formats.detect import open_reader

INT8, UINT32, MATRIX, OPAQUE, UINT32_CLASS = 1, 6, 14, 17, 13  # codes of the MAT-File Format
HEAD = b"MATLAB 5.0 MAT-file".ljust(124) + b"\0\1IM"


def element(kind: int, data: bytes) -> bytes:
    return kind.to_bytes(4, "little") + len(data).to_bytes(4, "little") + data + bytes(-len(data) % 8)


def flags(kind: int) -> bytes:
    return element(UINT32, bytes([kind, 0, 0, 0, 0, 0, 0, 0]))


def opaque(name: str, kind: str) -> bytes:
    """Return an object as MATLAB stores it: its name, where it belongs, its class, and where its contents are."""
    size = element(5, np.array([6, 1], dtype="<i4").tobytes())
    place = element(UINT32, np.array([0xDD000000, 2, 1, 1, 1, 1], dtype="<u4").tobytes())
    reference = element(MATRIX, flags(UINT32_CLASS) + size + element(INT8, b"") + place)
    texts = b"".join(element(INT8, text.encode()) for text in (name, "MCOS", kind))
    return element(MATRIX, flags(OPAQUE) + texts + reference)


def vectors(folder: Path) -> bytes:
    """Return the variables of a file of SciPy's."""
    scipy.io.savemat(folder / "plain.mat", {"heading": np.arange(6.0)})
    return (folder / "plain.mat").read_bytes()[128:]


def write_7_3(file: Path, kind: str, with_vectors: bool) -> Path:
    with h5py.File(file, "w", userblock_size=512) as content:
        time = content.create_dataset("t", data=np.array([0xDD000000, 2, 1, 1, 1, 1], dtype=np.uint32))
        time.attrs.update({"MATLAB_class": np.bytes_(kind), "MATLAB_object_decode": np.int32(3)})
        if with_vectors:
            content["heading"] = np.arange(6.0)
    with file.open("r+b") as content:
        content.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM")
    return file


def write_5(file: Path, kind: str, with_vectors: bool) -> Path:
    file.write_bytes(HEAD + opaque("t", kind) + (vectors(file.parent) if with_vectors else b""))
    return file


@pytest.mark.parametrize("write", [write_5, write_7_3])
def test_an_object_is_named_and_no_column_and_a_file_of_nothing_else_says_so(tmp_path, write):
    (topic,) = open_reader(write(tmp_path / "dive.mat", "datetime", True)).topics()

    assert topic.problem.startswith("its columns match no sensor (heading, t (a datetime: store posixtime)); name them")

    file = write(tmp_path / "dive.mat", "timetable", False)
    assert refusal(LogError, open_reader, file) == f"{file}: holds no vectors of numbers, but t (a timetable, not read)"


def test_columns_beside_an_object_are_read(tmp_path: Path) -> None:
    scipy.io.savemat(tmp_path / "plain.mat", {"time_ns": T0 + np.arange(6) * SECOND, "heading_deg": np.arange(6.0)})
    columns = (tmp_path / "plain.mat").read_bytes()[128:]
    (topic,) = open_reader(saved(tmp_path / "compass.mat", HEAD + opaque("note", "string") + columns)).topics()
    assert (topic.name, topic.count, topic.problem) == ("/compass", 6, "")
