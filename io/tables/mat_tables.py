"""Tables in MATLAB's .mat files: the vectors of a structure, or those that are in none.

Source: MAT-File Format, The MathWorks. Files of version 7.3 are HDF5.
"""

import pickle
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np

from usbldr.io.file_access.container_ends import HDF5, MAT_HDF5_AT, MAT_HEAD_BYTES, MAT_VERSIONS
from usbldr.io.file_access.decompression import deflated
from usbldr.io.file_access.open_file import opened
from usbldr.io.file_access.optional_library import library, reading
from usbldr.io.limits import UnpackingBudget
from usbldr.io.reader import Column
from usbldr.io.tables.array_tables import Array, Table, array_log, tables_of
from usbldr.io.tables.date_times import SHOWN_ROWS
from usbldr.io.tables.hdf5_tables import hdf5_log, refuse_objects, unread
from usbldr.io.tables.table_log import TableLog

NAME = "MATLAB"
OPAQUE = ("s0", "s1", "s2", "arr")  # fixed by SciPy: the fields of an object of versions 5 to 7, as of a datetime
TAG_BYTES, COMPRESSED = 8, 15  # fixed by the format
MATRIX = 14  # fixed: the type of an element that may hold others
MATRICES = 4000  # [matrices] that SciPy reads even if each is in the one before; its stack ends at some 15,000


def looks_like_mat(head: bytes) -> bool:
    """Return whether a file is one of MATLAB's."""
    return head[MAT_HEAD_BYTES - 4 : MAT_HEAD_BYTES] in MAT_VERSIONS or head[MAT_HDF5_AT:].startswith(HDF5)


def mat_log(file: Path) -> TableLog:
    """Return the log of a file; raise LogError if it cannot be read, UsageError without SciPy (or h5py)."""
    with opened(file) as content:
        head = content.read(MAT_HDF5_AT + len(HDF5))
    if head[MAT_HDF5_AT:].startswith(HDF5):
        return hdf5_log(file, NAME)
    scipy = library("scipy.io", "MATLAB files", "mat", file)
    matrices = _checked(file, MAT_VERSIONS[head[MAT_HEAD_BYTES - 4 : MAT_HEAD_BYTES]])
    with reading(file, NAME):
        variables = scipy.loadmat(file, simplify_cells=True) if matrices < MATRICES else _loaded_apart(file)
    tables = list(_tables(file, file.stem, {k: v for k, v in variables.items() if not k.startswith("__")}))
    if not tables:
        refuse_objects(file, unread(objects_of(variables)))
    return array_log(file, NAME, tables)


def _checked(file: Path, order: Any) -> int:
    """Return how many matrices a file may hold, those in others included; raise LogError if it is too large, or cut."""
    budget, found = UnpackingBudget(file, file.stat().st_size), 0
    with opened(file) as content, reading(file, NAME):
        content.seek(MAT_HEAD_BYTES)
        while tag := content.read(TAG_BYTES):
            kind, length = (int.from_bytes(part, order) for part in (tag[:4], tag[4:]))
            data = content.read(length)
            if len(tag) < TAG_BYTES or len(data) < length:
                raise EOFError("it ends within a variable")
            pieces = deflated(data, budget) if kind == COMPRESSED else [data]
            found += sum(piece.count(MATRIX.to_bytes(4, order)) for piece in pieces)
    return found


def _loaded_apart(file: Path) -> Mapping[str, Any]:
    """Return the variables of a file, read in a process of its own: it ends if they are nested too deeply for SciPy."""
    command = "import pickle, sys, scipy.io; f = scipy.io.loadmat(sys.argv[1], simplify_cells=True)"
    command += "; pickle.dump(f, sys.stdout.buffer)"
    safe = "-P"  # a module in the current folder is not imported
    done = subprocess.run([sys.executable, safe, "-c", command, str(file)], capture_output=True, check=False)
    if done.returncode:
        raise ValueError("its cells are nested too deeply, or damaged")
    return pickle.loads(done.stdout)


def _of_elements(value: Any) -> Any:
    """Return an array of structures, "dvl(i).time", as one structure of arrays; any other value as it is.

    A field that is empty in an element is NaN there. One whose elements have other shapes is none.
    """
    elements: Sequence[Any] = cast("list[Any]", value) if isinstance(value, list) else ()
    if not elements or not all(isinstance(one, dict) for one in elements):
        return cast("Any", value)
    fields = {
        name: [np.nan if np.shape(field := one.get(name, ())) == (0,) else field for one in elements]
        for name in elements[0]
    }
    return {name: field for name, field in fields.items() if len({*map(np.shape, field)}) == 1}


def _tables(file: Path, name: str, variables: Mapping[str, Any]) -> Iterator[Table]:
    arrays: list[Array] = []
    texts = set[str]()
    for label, given in variables.items():
        value = _of_elements(given)
        if isinstance(value, dict):
            yield from _tables(
                file, label if name == file.stem else f"{name}/{label}", cast("Mapping[str, Any]", value)
            )
            continue
        values: Column = np.asarray(value)
        text = values.size > 1 and all(isinstance(one, str) for one in np.ravel(values).tolist()[:SHOWN_ROWS])
        texts |= {label} if text else set()
        if values.dtype.kind in "biuf" or text:
            arrays.append((label, values.shape or (1,), np.atleast_1d(values).__getitem__))
    for table in tables_of(file, name, arrays, texts):
        yield replace(table, unread=unread(objects_of(variables)))


def objects_of(variables: Mapping[str, Any]) -> dict[str, str]:
    """Return name -> class of the objects among variables that SciPy read; itself it names only those of structures."""
    found: dict[str, str] = {}
    for label, value in variables.items():
        if getattr(getattr(value, "dtype", None), "names", None) == OPAQUE:
            name, _, kind, _ = value.flat[0]
            found[name.decode(errors="replace") or label] = kind.decode(errors="replace")
    return found
