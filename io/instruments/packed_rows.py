"""Messages of one fixed layout, gathered from a binary file as a table: shared by the formats of autopilots."""

import re
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from usbldr.io.reader import Column


def dtypes_of(layout: str) -> list[str]:
    """Return NumPy's types of a little-endian layout of the module struct, one of each value: "<QQ3fB16s"."""
    found: list[str] = []
    for count, code in re.findall(r"(\d*)([a-zA-Z])", layout):
        if code == "s":
            found.append(f"S{count or 1}")
        else:
            found += [f"<{np.dtype(code).str[1:]}" if code not in "bBc" else np.dtype(code).str] * int(count or 1)
    return found


def table_of(payloads: Sequence[bytes], names: Sequence[str], types: Sequence[str]) -> Mapping[str, Column]:
    """Return the columns of payloads of one layout by name; a payload that is too short is filled up with zeros."""
    row = np.dtype({"names": list(names), "formats": list(types)})
    data = b"".join(payload[: row.itemsize].ljust(row.itemsize, b"\0") for payload in payloads)
    table: NDArray[np.void] = np.frombuffer(data, row)
    return {name: _plain(table[name]) for name in names}


def _plain(column: Column) -> Column:
    return np.char.decode(column, "ascii", "replace") if column.dtype.kind == "S" else column.copy()
