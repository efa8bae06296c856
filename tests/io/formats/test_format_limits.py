"""Files of autopilots, Doppler logs, IMC messages and tables that are made to exhaust memory or time are refused.

The files are small: the limits are lowered to a hundredth, as --limits 0.01 does.
"""

import gzip
from collections.abc import Callable
from pathlib import Path
from zipfile import ZIP_DEFLATED, ZipFile

import lz4.frame
import numpy as np
import pytest
import scipy.io
import zstandard

from imc_recordings import definitions
from moos_recordings import HEAD, line
from recordings import SECOND, T0, saved
from speed.format_bombs import (
    ENTITIES,
    FMT,
    MESSAGE,
    PACKET,
    ensemble,
    hdf5_chunk,
    hdf5_gzip,
    hdf5_shape,
    lsf,
    nested_mat,
    parquet_text,
    repeated,
)
from usbldr.filters.errors import LogError
from usbldr.io.formats.detect import open_reader
from usbldr.io.limits import VARIABLE
from usbldr.io.reading.read import read_log

MB = 1 << 20


def packed(head: bytes, part: bytes) -> Callable[[Path], Path]:
    return lambda file: repeated(file, zstandard.compress, head, part, 2 * MB)


def workbook(file: Path) -> Path:
    with ZipFile(file, "w", ZIP_DEFLATED) as archive:
        archive.writestr("xl/workbook.xml", bytes(10**7))
    return file


MANY = "holds too many records for its size"
DAMAGED = "is damaged: too many bytes look like the beginning of a message and are none"
LARGE = "decompresses to more than 2 MB, too much for its size"
BOMBS: dict[str, tuple[Callable[[Path], Path], str]] = {
    "tlog, many packets": (packed(PACKET, PACKET), MANY),
    "BIN, many messages": (packed(FMT, b"\xa3\x95\1" + bytes(8)), MANY),
    "PD0, many ensembles": (packed(ensemble(), ensemble()), MANY),
    "lsf, many messages": (lambda file: lsf(file, 2 * MB), MANY),
    "lsf, many beginnings": (lambda file: lsf(file, 2 * MB, part=MESSAGE[:4] + b"\xff\0" + MESSAGE[:2]), DAMAGED),
    "Parquet, long texts": (lambda file: parquet_text(file, 20 * MB), LARGE),
    "HDF5, a shape": (lambda file: hdf5_shape(file, 200 * MB), LARGE),
    "HDF5, a large chunk": (lambda file: hdf5_chunk(file, 20 * MB), LARGE),
    "HDF5, a chunk that decompresses to more": (lambda file: hdf5_gzip(file, 20 * MB), LARGE),
    "alog, many variables": (lambda file: saved(file, HEAD, *(line(k, f"V{k}", "app", k) for k in range(2001))),
                             "has more than 2000 variables"),
    "a workbook": (workbook, "too much for its size"),
    **{f"{pack.__module__}, frames without end": (lambda file, pack=pack: saved(file, pack(b"") * 1500),
                                                  "holds too many frames for its size")
       for pack in (zstandard.compress, gzip.compress, lz4.frame.compress)},
}  # fmt: skip


@pytest.mark.parametrize("bomb", BOMBS)
def test_what_costs_more_than_its_size_is_refused(tmp_path: Path, bomb: str, monkeypatch: pytest.MonkeyPatch) -> None:
    write, sentence = BOMBS[bomb]
    file = write(tmp_path / "bomb")
    monkeypatch.setenv(VARIABLE, "0.01")

    with pytest.raises(LogError, match=f"{sentence}.*; --limits 10 raises the limits tenfold"):
        open_reader(file).topics()


@pytest.mark.parametrize("name", ["IMC.xml", "IMC.xml.gz"])
def test_definitions_beyond_the_limit_are_refused(tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    text = definitions().replace("<messages>", "<messages>" + " " * 30_000).encode()
    file = lsf(tmp_path / "Data.lsf", 0, gzip.compress(text) if name.endswith(".gz") else text, name)
    assert open_reader(file).topics()
    monkeypatch.setenv(VARIABLE, "0.01")

    with pytest.raises(LogError, match=rf"{name}: is larger than .* too large for definitions; --limits 10"):
        open_reader(file)


def test_definitions_with_entities_are_refused(tmp_path: Path) -> None:
    text = b'<!DOCTYPE m [<!ENTITY a0 "a">' + ENTITIES[:60] + b"]>" + definitions().encode()

    with pytest.raises(LogError, match=r"IMC.xml: holds no definitions of IMC \(it declares a document type\)"):
        open_reader(lsf(tmp_path / "Data.lsf", 0, text))


def test_cells_within_cells_end_in_one_sentence(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="its cells are nested too deeply, or damaged"):
        open_reader(nested_mat(tmp_path / "a.mat", 20_000))


def test_many_cells_beside_each_other_are_read(tmp_path: Path) -> None:
    names = np.array(["a"] * 5000, dtype=object)
    compass = {"time_ns": T0 + SECOND * np.arange(50), "heading_deg": np.arange(50.0)}
    scipy.io.savemat(tmp_path / "a.mat", {"compass": compass, "names": names}, do_compression=True)

    assert read_log(tmp_path / "a.mat").tables["compass"]["heading_deg"].tolist() == list(range(50))
