"""Ensembles of Teledyne RDI's binary formats: a mark, the size, data, and the sum of all bytes as a checksum.

Source: the output data formats of Teledyne's manuals (Pathfinder DVL Guide).
"""

from collections.abc import Iterator, Sequence
from itertools import chain
from mmap import mmap
from pathlib import Path

import numpy as np

from usbldr.io.file_access.open_file import mapped
from usbldr.io.findings import Finding
from usbldr.io.instruments.records_log import damaged_bytes
from usbldr.io.limits import UnpackingBudget

SIZE_AT, LEAST_BYTES, CHECKSUM_BYTES = 2, 6, 2  # fixed by the formats; the size is without the checksum
LONGEST_BYTES = (1 << 16) + CHECKSUM_BYTES  # fixed by the formats: the size has 16 bits
CUT_SHARE = 4  # of its first bytes, one in so many belongs to an ensemble, if cut ones are at both ends
BLOCK_BYTES = 1 << 20  # [bytes] looked through at once


def ensembles(file: Path, marks: Sequence[bytes], findings: list[Finding]) -> Iterator[bytes]:
    """Yield the ensembles of a file without their checksums; ``marks``: how one may begin.

    Appends what is missing to the findings at the end. Raises LogError if a decompressed copy holds too many.
    """
    data, at, lost, first_lost = mapped(file), 0, 0, -1
    budget = UnpackingBudget(file, len(data), text=True)  # as costly as lines
    for start, size in chain(_whole(data, marks), [(len(data), 0)]):
        if start < at:  # within the one before
            continue
        if start > at:
            first_lost, lost = (at if first_lost < 0 else first_lost), lost + start - at
        if size:
            budget.take_record()
            yield data[start : start + size]
        at = start + size + CHECKSUM_BYTES
    findings += damaged_bytes(lost, len(data), first_lost, "ensembles")


def first_ensemble(head: bytes, marks: Sequence[bytes]) -> bytes:
    """Return the first ensemble whose checksum is right in a file's first bytes; empty if they are hardly such."""
    found = list(_whole(head, marks))
    enough = sum(size for _, size in found) * CUT_SHARE >= len(head)
    return head[found[0][0] : found[0][0] + found[0][1]] if found and enough else b""


def _whole(data: mmap | bytes, marks: Sequence[bytes]) -> Iterator[tuple[int, int]]:
    """Yield start and size of every ensemble whose checksum is right, also of those within others.

    All places of a block that may begin one are checked at once: damaged files may consist of them.
    """
    for first in range(0, len(data), BLOCK_BYTES):
        block = np.frombuffer(data[first : first + BLOCK_BYTES + LONGEST_BYTES], np.uint8)
        count = max(0, min(BLOCK_BYTES, len(block) - LEAST_BYTES - 1))  # of the places at which one may begin
        marked = [np.all([block[k : k + count] == byte for k, byte in enumerate(mark)], axis=0) for mark in marks]
        starts = np.flatnonzero(np.any(marked, axis=0))
        block = block.astype(np.int64)
        sums = np.concatenate([[0], np.cumsum(block)])
        size = block[starts + SIZE_AT] + (block[starts + SIZE_AT + 1] << 8)
        inside = (size >= LEAST_BYTES) & (starts + size + CHECKSUM_BYTES <= len(block))
        starts, size = starts[inside], size[inside]
        stated = block[starts + size] + (block[starts + size + 1] << 8)
        right = (sums[starts + size] - sums[starts]) & 0xFFFF == stated
        yield from zip((first + starts[right]).tolist(), size[right].tolist(), strict=True)
