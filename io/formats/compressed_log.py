"""Logs in compressed files (dive.mcap.zst, dive/dvl.csv.gz): decompressed once into temporary copies, which are read.

The copies last as long as the reader. Errors and findings name the files that the user has.
"""

from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import replace
from io import BufferedWriter
from itertools import chain
from pathlib import Path
from shutil import rmtree
from tempfile import TemporaryDirectory, mkdtemp
from typing import Any, TypeAlias
from weakref import finalize

from usbldr.filters.errors import LogError, UsbldrError
from usbldr.io.file_access.decompression import DamagedFileError, compression_of, unpacked_file
from usbldr.io.file_access.open_file import begin_of, opened
from usbldr.io.findings import Finding
from usbldr.io.limits import UnpackingBudget, note_copy
from usbldr.io.reader import NamedColumns, Reader, Records, TopicInfo

ENDINGS = (".zst", ".zstd", ".gz", ".bz2", ".xz", ".lz4")
HEAD_BYTES = 4096  # [bytes] looked at to recognise a text: texts have no zeros
Copies: TypeAlias = tuple[Mapping[Path, Path], Sequence[Finding]]
"""Copies and the files that they are made of; what is missing from them."""


class CopiedLog:
    """A log that is read from temporary copies: of compressed files, or of the parts of a file."""

    def __init__(
        self, path: Path, copied_as: str, copy: Callable[[Path], Copies], reader_of: Callable[[Sequence[Path]], Reader]
    ) -> None:
        """Write copies into a temporary folder by ``copy``, and open them by ``reader_of``.

        ``copied_as``: what the name of the format is followed by. Raises what these raise.
        """
        self.path, self._copied_as = path, copied_as
        folder = mkdtemp(prefix="usbldr-")
        finalize(self, rmtree, folder, ignore_errors=True)
        self._originals, self._damage = copy(Path(folder))
        with self._naming():
            self._contents = reader_of(list(self._originals))

    def _naming(self) -> AbstractContextManager[None]:
        return _naming(self._originals, self._damage)

    @property
    def format(self) -> str:
        """What a user calls it: "MCAP, zstd"."""
        return self._contents.format + self._copied_as

    def topics(self) -> tuple[TopicInfo, ...]:
        """List the topics."""
        with self._naming():
            topics = self._contents.topics()
        return tuple(replace(topic, problem=_named(topic.problem, self._originals)) for topic in topics)

    def blocks(self, wanted: Mapping[str, Sequence[str]]) -> Iterator[tuple[str, Records]]:
        """Read the fields of the topics, block by block."""
        with self._naming():
            yield from self._contents.blocks(wanted)

    def findings(self) -> tuple[Finding, ...]:
        """Report what was lost in the files, and in their contents."""
        with self._naming():
            return (*self._damage, *self._contents.findings())

    def with_columns(self, configured: Sequence[Any]) -> Reader:
        """Return this log with the columns of its tables that the configuration states."""
        if isinstance(self._contents, NamedColumns):
            self._contents = self._contents.with_columns(configured)
        return self


@contextmanager
def _naming(originals: Mapping[Path, Path], damage: Sequence[Finding]) -> Generator[None]:
    """Name the user's files in errors about their copies, and their damage."""
    try:
        yield
    except UsbldrError as fault:
        path = fault.path and originals.get(Path(fault.path), fault.path)
        lost = "".join(f" ({finding.text})" for finding in damage)
        raise type(fault)(_named(fault.text, originals) + lost, path=path, topic=fault.topic) from fault


def _named(text: str, originals: Mapping[Path, Path]) -> str:
    for copy, original in originals.items():
        text = text.replace(str(copy), str(original))
    return text


def compressed_log(path: Path, files: Mapping[Path, str], reader_of: Callable[[Sequence[Path]], Reader]) -> CopiedLog:
    """Return a compressed log, or a folder with compressed files (path -> compression).

    Raises LogError if a file is too large, or if nothing of it can be decompressed.
    """

    kinds = ", ".join(sorted(set(files.values())))
    return CopiedLog(path, f", {kinds}", lambda folder: _copies(path, files, folder), reader_of)


@contextmanager
def plain_file(file: Path) -> Generator[tuple[Path, Sequence[Finding]]]:
    """Yield a file, or a copy of its contents if it is compressed, and what is missing from them; name it in errors."""
    compression = compression_of(begin_of(file, HEAD_BYTES)[0])
    with TemporaryDirectory(prefix="usbldr-") as folder:
        copies, lost = _copies(file, {file: compression}, Path(folder)) if compression else ({file: file}, ())
        with _naming(copies, lost):
            yield next(iter(copies)), lost


def _copies(path: Path, files: Mapping[Path, str], folder: Path) -> Copies:
    copies = [folder / plain_name(file) for file in files]
    whose = {file: "" if file == path else f"{file.name}: " for file in files}
    lost = [_decompressed(file, files[file], to, whose[file]) for to, file in zip(copies, files, strict=True)]
    return dict(zip(copies, files, strict=True)), [finding for finding in lost if finding]


def plain_name(file: Path) -> str:
    """Return the name of a file without the ending of a compression."""
    return file.stem if file.suffix.lower() in ENDINGS else file.name


def _decompressed(path: Path, compression: str, copy: Path, whose: str) -> Finding | None:
    """Write the copy of a file; return what is missing from it, ``whose`` before the text."""
    size = path.stat().st_size
    note_copy(copy, path)
    with opened(path) as file:
        pieces = unpacked_file(file, compression)
        try:
            first = next((piece for piece in pieces if piece), b"")
            if compression_of(first):
                raise LogError("is compressed twice; decompress it once", path=path)
            text = b"\0" not in first[:HEAD_BYTES]
            budget = UnpackingBudget(path, size, text)
            with written(copy, path) as whole:
                for piece in chain([first], pieces):
                    budget.take_bytes(len(piece))
                    budget.take_record(piece.count(b"\n") if text else 0)
                    whole.write(piece)
        except DamagedFileError as err:
            what, where = f"{whose}the {compression} data", f"at byte {err.at} of {size}"
            if not copy.exists():
                why = f" ({err.why})" if err.why else ""
                why = f"is damaged: no {compression} data could be decompressed {where}{why}"
                raise LogError(why, path=path) from err
            if err.why:
                why = f"{what} are damaged {where} ({err.why}): what precedes is read, and values may be altered"
                return Finding("DAMAGED", why, lost_data=True)
            return Finding("TRUNCATED", f"{what} end early, {where}: what precedes is read", lost_data=True)
    return None


@contextmanager
def written(copy: Path, original: Path) -> Generator[BufferedWriter]:
    """Open a copy to be written; raise LogError if the disk is full."""
    try:
        with copy.open("wb") as file:
            yield file
    except OSError as err:
        why = f"cannot be copied into {copy.parent} ({err.strerror or err}); TMPDIR names another folder"
        raise LogError(why, path=original) from err
