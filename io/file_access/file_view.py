"""The bytes of a file at any place, read in small pieces: a map of the file would count as memory."""

import errno
import os

BLOCK_BYTES = 1 << 20  # [bytes] read at once in search of a mark
CACHED_BYTES = 1 << 16  # [bytes] kept, for records that follow each other
ZEROS = bytes(BLOCK_BYTES)


class FileView:
    """A file to be looked at, by its descriptor, which the caller keeps open."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        self._size = os.fstat(descriptor).st_size
        self._cached, self._cached_at = b"", 0

    def __len__(self) -> int:
        return self._size

    def __getitem__(self, part: slice) -> bytes:
        start, stop, _ = part.indices(self._size)
        if stop - start > CACHED_BYTES // 2:
            return os.pread(self._descriptor, stop - start, start)
        if not self._cached_at <= start <= stop <= self._cached_at + len(self._cached):
            self._cached, self._cached_at = os.pread(self._descriptor, CACHED_BYTES, start), start
        return self._cached[start - self._cached_at : max(0, stop - self._cached_at)]

    def find(self, mark: bytes, start: int, end: int | None = None) -> int:
        """Return the first place of a mark from ``start`` to ``end``, -1 if there is none; it begins with no zero."""
        end = self._size if end is None else min(end, self._size)
        at = self._data_from(start)
        while at < end:
            block = self[at : min(at + BLOCK_BYTES + len(mark) - 1, end)]
            if (place := block.find(mark)) >= 0:
                return at + place
            at = self._data_from(at + BLOCK_BYTES)
        return -1

    def after_zeros(self, at: int) -> int:
        """Return the next byte that is not zero, else the end."""
        at = self._data_from(at)
        while at < self._size:
            if self[at : at + 1] != b"\0":
                return at
            block = self[at : at + BLOCK_BYTES]
            if block != ZEROS[: len(block)]:
                return at + len(block) - len(block.lstrip(b"\0"))
            at = self._data_from(at + len(block))
        return self._size

    def _data_from(self, at: int) -> int:
        """Return the next byte that a sparse file holds, instead of the zeros that are read before it."""
        if at >= self._size or not hasattr(os, "SEEK_DATA"):
            return at
        here = os.lseek(self._descriptor, 0, os.SEEK_CUR)
        try:
            return os.lseek(self._descriptor, at, os.SEEK_DATA)
        except OSError as err:  # no more data, or a file system that knows no holes
            return self._size if err.errno == errno.ENXIO else at
        finally:  # others may read the file by the same descriptor
            os.lseek(self._descriptor, here, os.SEEK_SET)
