"""Ensembles of Teledyne RDI's binary formats: a mark, the size, data, and the sum of all bytes as a checksum.

Source: the output data formats of Teledyne's manuals (Pathfinder DVL Guide).
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from mmap import mmap
from pathlib import Path

import numpy as np

from usbldr.io.findings import Finding
from usbldr.io.formats.files import mapped
from usbldr.io.reader import Column, Nanoseconds, Records, TopicInfo

SIZE_AT, LEAST_BYTES, CHECKSUM_BYTES = 2, 6, 2  # fixed by the formats; the size is without the checksum


def ensembles(file: Path, begin: re.Pattern[bytes], findings: list[Finding]) -> Iterator[bytes]:
    """Yield the ensembles of a file without their checksums; ``begin``: how each begins.

    Appends what is missing to the findings at the end.
    """
    data, at, lost, first_lost = mapped(file), 0, 0, -1
    while at < len(data):
        if size := _size(data, at, begin):
            yield data[at : at + size]
            at += size + CHECKSUM_BYTES
            continue
        following = _next(data, at + 1, begin)
        first_lost, lost = (at if first_lost < 0 else first_lost), lost + following - at
        at = following
    if lost:
        text = f"{lost} of {len(data)} bytes, from byte {first_lost} on, are damaged or cut"
        findings.append(Finding("DAMAGED", f"{text}; their ensembles are missing", lost_data=True))


def _size(data: mmap, at: int, begin: re.Pattern[bytes]) -> int:
    """Return the size of the ensemble at a byte without its checksum, 0 if there is no whole one."""
    size = int.from_bytes(data[at + SIZE_AT : at + SIZE_AT + 2], "little")
    end = at + size
    if not begin.match(data, at) or size < LEAST_BYTES or end + CHECKSUM_BYTES > len(data):
        return 0
    total = int(np.frombuffer(data[at:end], np.uint8).sum(dtype=np.uint32)) & 0xFFFF
    return size if total == int.from_bytes(data[end : end + CHECKSUM_BYTES], "little") else 0


def _next(data: mmap, at: int, begin: re.Pattern[bytes]) -> int:
    """Return the first byte from which an ensemble follows, else the end of the file."""
    while found := begin.search(data, at):
        if _size(data, found.start(), begin):
            return found.start()
        at = found.start() + 1
    return len(data)


def in_order(times: Nanoseconds, columns: Mapping[str, Column]) -> Records:
    """Return records in the order of their times."""
    order = np.argsort(times, kind="stable")
    return Records(times[order], {name: column[order] for name, column in columns.items()})


def topics_of(encoding: str, fields: Mapping[str, Sequence[str]], tables: Mapping[str, Records]) -> list[TopicInfo]:
    """Return the topics of a file; the type of "/depth" is "pd0/pd0_depth" if ``encoding`` is "pd0"."""
    return [
        TopicInfo(
            name,
            f"{encoding}/{encoding}_{name[1:]}",
            encoding,
            len(records.received_ns),
            int(records.received_ns[0]),
            int(records.received_ns[-1]),
            tuple(fields[name]),
        )
        for name, records in tables.items()
    ]
