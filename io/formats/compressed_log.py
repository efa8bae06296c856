"""A log in a compressed file (dive.mcap.zst, dive.csv.gz): decompressed once into a temporary copy, which is read.

The copy lasts as long as the reader. Errors and findings name the file that the user has.
"""

from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from itertools import chain
from pathlib import Path
from shutil import rmtree
from tempfile import mkdtemp
from typing import Any
from weakref import finalize

from usbldr.filters.errors import LogError, UsbldrError
from usbldr.io.findings import Finding
from usbldr.io.formats.decompression import DamagedFileError, compression_of, unpacked_file
from usbldr.io.formats.files import opened
from usbldr.io.formats.nmea_log import with_sentences
from usbldr.io.limits import UnpackingBudget, note_copy
from usbldr.io.reader import NamedColumns, Reader, Records, TopicInfo

ENDINGS = (".zst", ".zstd", ".gz", ".bz2", ".xz", ".lz4")
HEAD_BYTES = 4096  # [bytes] looked at to recognise a text: texts have no zeros


class CompressedLog:
    """A compressed log, read by the reader of its contents."""

    def __init__(self, path: Path, compression: str, reader_of: Callable[[Path], Reader]) -> None:
        """Decompress the file and open its contents; raise LogError if they are too large, or none can be read."""
        self.path = path
        self._compression = compression
        self._folder = mkdtemp(prefix="usbldr-")
        finalize(self, rmtree, self._folder, ignore_errors=True)
        self._copy = Path(self._folder) / (path.stem if path.suffix.lower() in ENDINGS else path.name)
        self._damage = self._decompress()
        with self._naming():
            self._contents = reader_of(self._copy)

    def _decompress(self) -> Finding | None:
        """Write the copy; return what is missing from it."""
        size = self.path.stat().st_size
        note_copy(self._copy, self.path)
        with opened(self.path) as file:
            pieces = unpacked_file(file, self._compression)
            try:
                first = next((piece for piece in pieces if piece), b"")
                if compression_of(first):
                    raise LogError("is compressed twice; decompress it once", path=self.path)
                self._write(first, pieces, size)
            except DamagedFileError as err:
                where = f"at byte {err.at} of {size}" + f" ({err.why})" * bool(err.why)
                if not self._copy.exists():
                    raise LogError(
                        f"is damaged: no {self._compression} data could be decompressed {where}", path=self.path
                    ) from err
                return self._lost(err, where)
        return None

    def _write(self, first: bytes, pieces: Iterator[bytes], size: int) -> None:
        text = b"\0" not in first[:HEAD_BYTES]
        budget = UnpackingBudget(self.path, size, text)
        try:
            with self._copy.open("wb") as copy:
                for piece in chain([first], pieces):
                    budget.take_bytes(len(piece))
                    budget.take_record(piece.count(b"\n") if text else 0)
                    copy.write(piece)
        except OSError as err:
            why = f"cannot be decompressed into {self._folder} ({err.strerror or err}); TMPDIR names another folder"
            raise LogError(why, path=self.path) from err

    def _lost(self, err: DamagedFileError, where: str) -> Finding:
        if err.why:
            text = f"the {self._compression} data are damaged {where}: what precedes is read, and values may be altered"
            return Finding("DAMAGED", text, lost_data=True)
        return Finding(
            "TRUNCATED", f"the {self._compression} data end early, {where}: what precedes is read", lost_data=True
        )

    @contextmanager
    def _naming(self) -> Generator[None]:
        """Name the compressed file in errors about its copy, and its damage."""
        try:
            yield
        except UsbldrError as fault:
            path = self.path if fault.path is not None and Path(fault.path) == self._copy else fault.path
            damage = f" ({self._damage.text})" if self._damage else ""
            raise type(fault)(self._named(fault.text) + damage, path=path, topic=fault.topic) from fault

    def _named(self, text: str) -> str:
        return text.replace(str(self._copy), str(self.path))

    @property
    def format(self) -> str:
        """What a user calls it: "MCAP, zstd"."""
        return f"{self._contents.format}, {self._compression}"

    def topics(self) -> tuple[TopicInfo, ...]:
        """List the topics."""
        with self._naming():
            return tuple(replace(topic, problem=self._named(topic.problem)) for topic in self._contents.topics())

    def read(self, wanted: Mapping[str, Sequence[str]]) -> Mapping[str, Records]:
        """Read the fields of the topics."""
        with self._naming():
            return self._contents.read(wanted)

    def findings(self) -> tuple[Finding, ...]:
        """Report what was lost in the compressed file, and in its contents."""
        own = (self._damage,) if self._damage else ()
        with self._naming():
            return (*own, *self._contents.findings())

    def with_columns(self, configured: Sequence[Any]) -> Reader:
        """Return this log with the columns of its tables that the configuration states, or with its sentences."""
        if isinstance(self._contents, NamedColumns):
            self._contents = self._contents.with_columns(configured)
            return self
        return with_sentences(self)
