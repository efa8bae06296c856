"""Tables in MATLAB's .mat files: the vectors of a structure, or those that are in none.

Source: MAT-File Format, The MathWorks. Files of version 7.3 are HDF5.
"""

import zlib
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np

from usbldr.io.formats.files import opened
from usbldr.io.formats.hdf5_tables import MAGIC, hdf5_tables
from usbldr.io.formats.mat_objects import objects_of, refuse_objects, unread
from usbldr.io.formats.table_log import Array, Table, library, reading, tables_of
from usbldr.io.limits import UnpackingBudget
from usbldr.io.reader import Column

NAME = "MATLAB"
HEAD_BYTES, TAG_BYTES, COMPRESSED = 128, 8, 15  # fixed by the format
USER_BLOCK_BYTES = 512  # fixed: before the HDF5 data of version 7.3
ENDIAN = {b"\x00\x01IM": "little", b"\x01\x00MI": "big"}  # version 1 and the order of bytes, at byte 124
STEP_BYTES = 1 << 20  # [bytes] decompressed at once to count them


def looks_like_mat(head: bytes) -> bool:
    """Return whether a file is one of MATLAB's."""
    return head[124:HEAD_BYTES] in ENDIAN or head[USER_BLOCK_BYTES:].startswith(MAGIC)


def mat_tables(file: Path) -> list[Table]:
    """Return the tables of a file; raise LogError if it cannot be read, UsageError without SciPy (or h5py)."""
    with opened(file) as content:
        head = content.read(USER_BLOCK_BYTES + len(MAGIC))
    if head[USER_BLOCK_BYTES:].startswith(MAGIC):
        return hdf5_tables(file, NAME)
    scipy = library("scipy.io", "MATLAB files", "mat", file)
    _check_size(file, ENDIAN[head[124:HEAD_BYTES]])
    with reading(file, NAME):
        variables = scipy.loadmat(file, simplify_cells=True)
    tables = list(_tables(file, file.stem, {k: v for k, v in variables.items() if not k.startswith("__")}))
    if not tables:
        refuse_objects(file, unread(objects_of(variables)))
    return tables


def _check_size(file: Path, order: Any) -> None:
    """Raise LogError if the variables of a file decompress to too much, or are cut."""
    size = file.stat().st_size
    budget = UnpackingBudget(file, size)
    with opened(file) as content, reading(file, NAME):
        content.seek(HEAD_BYTES)
        while tag := content.read(TAG_BYTES):
            kind, length = (int.from_bytes(part, order) for part in (tag[:4], tag[4:]))
            data = content.read(length)
            if len(tag) < TAG_BYTES or len(data) < length:
                raise EOFError("it ends within a variable")
            unpacker = zlib.decompressobj()
            while kind == COMPRESSED and data and not unpacker.eof:
                budget.take_bytes(len(unpacker.decompress(data, STEP_BYTES)))
                data = unpacker.unconsumed_tail
            if kind == COMPRESSED and not unpacker.eof:
                raise EOFError("it ends within a variable")


def _tables(file: Path, name: str, variables: Mapping[str, Any]) -> Iterator[Table]:
    arrays: list[Array] = []
    for label, value in variables.items():
        if isinstance(value, dict):
            yield from _tables(
                file, label if name == file.stem else f"{name}/{label}", cast("Mapping[str, Any]", value)
            )
            continue
        values: Column = np.asarray(value)
        if values.dtype.kind in "biuf":
            arrays.append((label, values.shape or (1,), np.atleast_1d(values).__getitem__))
    for table in tables_of(file, name, arrays):
        yield replace(table, unread=unread(objects_of(variables)))
