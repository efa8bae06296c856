"""Tables in HDF5 files, also netCDF-4 and MATLAB 7.3: the arrays of a group, or an array of records.

Source of the units: the attribute ``units`` of the CF conventions (cfconventions.org).
"""

import zlib
from contextlib import suppress
from dataclasses import replace
from functools import partial
from math import prod
from pathlib import Path
from typing import Any

from usbldr.io.file_access.decompression import deflated
from usbldr.io.limits import UnpackingBudget
from usbldr.io.reader import Column
from usbldr.io.tables.cf_times import Clock, clock_of
from usbldr.io.tables.mat_objects import DECODE, refuse_objects, unread
from usbldr.io.tables.table_library import library, reading
from usbldr.io.tables.table_log import Array, Table, tables_of
from usbldr.io.units import named_unit

MAGIC = b"\x89HDF\r\n\x1a\n"
NAME = "HDF5"


def hdf5_tables(file: Path, kind: str = NAME) -> list[Table]:
    """Return the tables of a file; raise LogError if it cannot be read, UsageError without h5py."""
    h5py = library("h5py", f"{kind} files", "hdf5", file)
    groups: dict[str, list[Array]] = {}
    dated: dict[str, set[str]] = {}
    objects: dict[str, dict[str, str]] = {}
    tables: list[Table] = []
    budget = UnpackingBudget(file, file.stat().st_size)

    def read(path: str, part: Any, clock: Clock | None = None) -> Column:
        with h5py.File(file, "r") as content:
            _take_chunks(content[path], budget)
            values = content[path][part]
            return clock.dates(values) if clock else values

    def visit(path: str, item: Any) -> None:
        budget.take_record()
        if not isinstance(item, h5py.Dataset) or path.startswith("#") or item.external or item.is_virtual:
            return  # of MATLAB's own, or in other files
        group, _, name = path.rpartition("/")
        group = group or file.stem
        if DECODE in item.attrs:
            objects.setdefault(group, {})[name] = _text(item.attrs.get("MATLAB_class"))
        elif item.dtype.names and item.ndim == 1:
            tables.append(Table(file, path, len(item), {name: partial(read, path, name) for name in item.dtype.names}))
        elif item.dtype.kind in "biuf" and item.shape and b"char" not in item.attrs.get("MATLAB_class", b""):
            unit = _text(item.attrs.get("units"))
            clock = clock_of(unit, _text(item.attrs.get("calendar")) or "standard")
            label = name if clock else _named(name, unit)
            dated.setdefault(group, set()).update([label] if clock else [])
            groups.setdefault(group, []).append((label, item.shape, partial(read, path, clock=clock)))

    with reading(file, kind), h5py.File(file, "r") as content:
        content.visititems(visit)
    for name, arrays in groups.items():
        others = unread(objects.get(name, {}))
        tables += [replace(one, unread=others) for one in tables_of(file, name, arrays, frozenset(dated[name]))]
    if not tables:
        refuse_objects(file, [name for kinds in objects.values() for name in unread(kinds)])
    return tables


def _text(attribute: object) -> str:
    """Return an attribute, empty if it is no text."""
    text = attribute.decode(errors="replace") if isinstance(attribute, bytes) else attribute
    return text if isinstance(text, str) else ""


def _take_chunks(array: Any, budget: UnpackingBudget) -> None:
    """Take the chunks of an array from a budget: one may be larger than the array, and decompress to even more."""
    if array.chunks is None:
        return
    budget.take_bytes(prod(array.chunks) * array.dtype.itemsize)
    for k in range(array.id.get_num_chunks() if array.compression == "gzip" else 0):
        _, packed = array.id.read_direct_chunk(array.id.get_chunk_info(k).chunk_offset)
        with suppress(zlib.error, EOFError):  # what is damaged the library reports
            for _ in deflated(packed, budget):
                pass


def _named(name: str, unit: str) -> str:
    """Return a name with the unit that its attribute states, unless the name states one."""
    if named_unit(name).unit:
        return name
    return f"{name} [{unit}]" if named_unit(f"{name} [{unit}]").dimension else name
