"""Tables in HDF5 files, also netCDF-4 and MATLAB 7.3: the arrays of a group, or an array of records.

Source of the attributes ``units``, and ``_FillValue``, ``missing_value``, ``scale_factor`` and ``add_offset`` of packed
values: CF conventions (cfconventions.org). Of the heaps of texts: HDF5 File Format Specification 3.0, section III.E.
"""

import re
import struct
import zlib
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from math import prod
from pathlib import Path
from typing import Any

import numpy as np

from usbldr.filters.errors import LogError
from usbldr.io.file_access.decompression import deflated
from usbldr.io.file_access.open_file import mapped
from usbldr.io.file_access.optional_library import library, reading
from usbldr.io.limits import UnpackingBudget
from usbldr.io.reader import Column
from usbldr.io.tables.array_tables import Array, Table, array_log, tables_of
from usbldr.io.tables.cf_times import Clock, clock_of
from usbldr.io.tables.csv_sheets import OWN_NAMES
from usbldr.io.tables.table_log import TableLog
from usbldr.io.units import named_unit

DECODE = "MATLAB_object_decode"  # fixed by MATLAB: the attribute of an object, as a datetime or a timetable
NAME = "HDF5"
HEAP = re.compile(rb"GCOL\x01\0\0\0(.{8})", re.DOTALL)  # the head of a heap of texts, and its size in bytes
TEXT = struct.Struct("<H6xQ")  # the head of a text: whether it is used, and its size in bytes
REFERENCE = np.dtype([("bytes", "<u4"), ("heap", "<u8"), ("text", "<u4")])  # of an array to a text


def hdf5_log(file: Path, kind: str = NAME) -> TableLog:
    """Return the log of a file; raise as `hdf5_tables` does."""
    return array_log(file, kind, hdf5_tables(file, kind))


def hdf5_tables(file: Path, kind: str = NAME) -> list[Table]:
    """Return the tables of a file; raise LogError if it cannot be read, UsageError without h5py."""
    h5py = library("h5py", f"{kind} files", "hdf5", file)
    with reading(file, kind):
        _check_heaps(file)
    with reading(file, kind), h5py.File(file, "r") as content:
        found = _Contents(file, h5py)
        found.visit("", content)
        content.visititems(found.visit)
    tables = [*found.tables, *(table for name in found.groups for table in found.tables_of(name))]
    if not tables:
        refuse_objects(file, [name for kinds in found.objects.values() for name in unread(kinds)])
        refuse_objects(file, [f"{path} ({why})" for path, why in found.left_out.items()])
    return [replace(one, left_out=found.left_out) for one in tables]


class _Contents:
    """What is in a file, by the paths of its groups."""

    def __init__(self, file: Path, h5py: Any) -> None:
        self._file, self._h5py = file, h5py
        self._budget = UnpackingBudget(file, file.stat().st_size)
        self.tables: list[Table] = []  # arrays of records
        self.numbers: dict[str, list[Array]] = defaultdict(list)
        self.objects: dict[str, dict[str, str]] = defaultdict(dict)  # of MATLAB: name -> class
        self.left_out: dict[str, str] = {}  # path -> why
        self._texts: dict[str, list[Array]] = defaultdict(list)
        self._dated: dict[str, set[str]] = defaultdict(set)  # those of numbers that are times

    def visit(self, path: str, item: Any) -> None:
        """Take an item of the file."""
        self._budget.take_record()
        if path.startswith("#"):
            return  # of MATLAB's own
        if not isinstance(item, self._h5py.Dataset):
            links = {f"{path}/{name}".lstrip("/"): item.get(name, getlink=True) for name in item}
            self.left_out.update({name: why for name, link in links.items() if (why := _astray(link, item))})
        elif item.external or item.is_virtual:
            self.left_out[path] = "its values are in other files; copy them into this one"
        else:
            self._add(path, item)

    def _add(self, path: str, item: Any) -> None:
        h5py, column = self._h5py, item.ndim == 1 or item.shape[1:] == (1,)
        group, _, name = path.rpartition("/")
        group = group or self._file.stem
        if DECODE in item.attrs:
            self.objects[group][name] = _text(item.attrs.get("MATLAB_class"))
        elif h5py.check_ref_dtype(item.dtype) is h5py.Reference and item.size > 1 and max(item.shape) == item.size:
            self._budget.take_record(item.size)  # a field of an array of structures in MATLAB 7.3
            if _number(item.file, item[(0,) * item.ndim]) is not None:
                self.numbers[group].append((name, item.shape, partial(self._read_elements, path)))
        elif item.dtype.names and column:
            columns = {name: partial(self._read, path, name) for name in item.dtype.names}
            words = frozenset(name for name in columns if h5py.check_string_dtype(item.dtype[name]))
            self.tables.append(Table(self._file, path, len(item), columns, texts=words))
        elif item.dtype.names and item.ndim:
            self.left_out[path] = f"its records have {item.ndim} dimensions, not one"
        elif h5py.check_string_dtype(item.dtype) and column:
            self._texts[group].append((name, item.shape, partial(self._read, path)))
        elif item.dtype.kind in "biuf" and item.shape and b"char" not in item.attrs.get("MATLAB_class", b""):
            unit = _text(item.attrs.get("units"))
            clock = clock_of(unit, _text(item.attrs.get("calendar")) or "standard")
            label = name if clock else _named(name, unit)
            self._dated[group].update([label] if clock else [])
            self.numbers[group].append((label, item.shape, partial(self._read, path, clock=clock)))

    def _read(self, path: str, part: Any, clock: Clock | None = None) -> Column:
        with self._h5py.File(self._file, "r") as content:
            item = content[path]
            _take(item, self._budget)
            if item.dtype.kind in "biuf":
                values = _unpacked(item[part], item.attrs)
                return clock.dates(values) if clock else values
            values = np.ravel((item.asstr() if self._h5py.check_string_dtype(item.dtype) else item)[part])
        if values.dtype.kind in "SO":  # h5py leaves the texts of records as bytes
            decoded = (one.decode(errors="replace") if isinstance(one, bytes) else one for one in values.tolist())
            values = np.array(list(decoded), dtype=object)
        return values

    def _read_elements(self, path: str, part: Any) -> Column:
        with self._h5py.File(self._file, "r") as content:
            return np.array([_number(content, one) for one in np.ravel(content[path][part])], dtype=np.float64)

    @property
    def groups(self) -> list[str]:
        """The groups that hold columns."""
        return list(dict.fromkeys([*self.numbers, *self._texts]))

    def tables_of(self, group: str) -> list[Table]:
        """Return the tables of a group: its numbers, and texts of as many rows."""
        sizes = {max(shape) for _, shape, _ in self.numbers[group] or self._texts[group]}
        beside = [one for one in self._texts[group] if one[1][0] in sizes]
        others, texts = unread(self.objects[group]), {*self._dated[group], *(label for label, _, _ in beside)}
        tables = tables_of(self._file, group, [*self.numbers[group], *beside], texts)
        return [replace(one, unread=others) for one in tables]


def _number(content: Any, reference: Any) -> float | None:
    """Return the number that a reference leads to, None if it is an empty field, a text or a structure."""
    item: Any = content[reference] if reference else None
    if getattr(item, "size", 0) != 1 or item.dtype.kind not in "biuf" or b"char" in item.attrs.get("MATLAB_class", b""):
        return None
    return float(np.ravel(item[()])[0])


def _check_heaps(file: Path) -> None:
    """Raise ValueError if a text of a heap has an impossible size: libhdf5 2.0 would search the heap for ever."""
    with mapped(file) as data:
        for heap in HEAP.finditer(data):
            place, end = heap.end(), min(heap.start() + int.from_bytes(heap[1], "little"), len(data))
            while place + TEXT.size <= end:
                used, size = TEXT.unpack_from(data, place)
                length = TEXT.size + -(-size // 8) * 8 if used else size  # each begins at a multiple of 8 bytes
                if not TEXT.size <= length <= end - place:
                    raise ValueError("a text that has no end")
                place += length


def _astray(link: Any, group: Any) -> str:
    """Return why a link of a group leads to nothing that is read; empty for others, and for another name of it."""
    if other := getattr(link, "filename", None):
        return f"it is a link into {other}; copy its contents into this file"
    lost = getattr(link, "path", None) and group.get(link.path) is None
    return f"it is a link to {link.path}, which is not there" if lost else ""


def _unpacked(values: Column, attributes: Any) -> Column:
    """Return packed values as measured; masked, if some say that there is none."""
    stated = [np.ravel(attributes[name]) for name in ("_FillValue", "missing_value") if name in attributes]
    marks = [
        mark.astype(values.dtype) if values.dtype.kind == "f" else mark for mark in stated if mark.dtype.kind in "iuf"
    ]
    missing = np.isin(values, np.concatenate(marks)) if marks else np.zeros(1, dtype=np.bool_)
    if "scale_factor" in attributes or "add_offset" in attributes:
        factor, offset = (float(np.ravel(attributes.get(*one))[0]) for one in (("scale_factor", 1), ("add_offset", 0)))
        values = values.astype(np.float64) * factor + offset
    return np.ma.array(values, mask=missing) if missing.any() else values


def _text(attribute: object) -> str:
    """Return an attribute, empty if it is no text."""
    text = attribute.decode(errors="replace") if isinstance(attribute, bytes) else attribute
    return text if isinstance(text, str) else ""


def _take(array: Any, budget: UnpackingBudget) -> None:
    """Take what the library needs to read an array from a budget, as stated or decompressed.

    A chunk may be larger than the array, and decompress to even more. Memory for a text is cleared before it is found.
    """
    texts, packed = array.dtype.kind == "O", array.compression == "gzip"
    parts: Iterator[bytes] = iter(())
    if array.chunks is not None:
        budget.take_bytes(prod(array.chunks) * array.dtype.itemsize)
        places = (array.id.get_chunk_info(k).chunk_offset for k in range(array.id.get_num_chunks()))
        parts = (array.id.read_direct_chunk(place)[1] for place in places if texts or packed)
    elif texts and (begin := array.id.get_offset()):  # else it lies within its description
        parts = iter([mapped(Path(array.file.filename))[begin : begin + array.id.get_storage_size()]])
    for part in parts:
        with suppress(zlib.error, EOFError):  # what is damaged the library reports
            whole = b"".join(piece if texts else b"" for piece in (deflated(part, budget) if packed else [part]))
            budget.take_bytes(int(np.frombuffer(whole, REFERENCE, len(whole) // REFERENCE.itemsize)["bytes"].sum()))


def _named(name: str, unit: str) -> str:
    """Return a name with the unit that its attribute states, known or not, unless the name states one.

    usbldr's own names stay as they are.
    """
    with_unit = f"{name} [{unit}]"
    own = name in OWN_NAMES or named_unit(name).unit or not named_unit(with_unit).unit
    return name if own else with_unit


def unread(objects: Mapping[str, str]) -> tuple[str, ...]:
    """Return what is said of objects (name -> class), whose format is not documented, beside the names of columns."""
    return tuple(
        f"{name} (a {kind}: store posixtime)" if kind == "datetime" else f"{name} (a {kind}, not read)"
        for name, kind in objects.items()
    )


def refuse_objects(file: Path, others: Sequence[str]) -> None:
    """Raise LogError if a file without tables holds objects."""
    if others:
        raise LogError(f"holds no vectors of numbers, but {', '.join(others)}", path=file)
