"""One sqlite3 file of a rosbag2 recording (.db3), with or without message definitions inside.

The file is opened read-only and as immutable, so that sqlite3 creates no file beside it; if it has a journal, both are
copied to be merged. A file from before ROS 2 Iron carries no definitions: those of the standard types are known, and
those of some navigation types (known_types.msg).
"""

import sqlite3
from collections.abc import Generator, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from functools import cached_property
from pathlib import Path
from shutil import copy
from tempfile import TemporaryDirectory
from urllib.parse import quote

from usbldr.filters.errors import LogError
from usbldr.io.decoding.decoders import (
    Decoder,
    DecoderSet,
    Stream,
    StreamMessage,
    TopicType,
    decode_blocks,
    decoder_without_definition,
    stream_infos,
    wanted_streams,
)
from usbldr.io.decoding.definitions import SHIPPED, Definitions
from usbldr.io.file_access.decompression import MessageUnpacker
from usbldr.io.file_access.open_file import opened
from usbldr.io.findings import Finding
from usbldr.io.limits import CHUNK_BYTES, limit
from usbldr.io.reader import Records, TopicInfo, name_of

WAL = b"\x37\x7f\x06"  # how sqlite3's journals begin
AS_CSV = 'export the tables of another database as CSV (sqlite3 -header -csv FILE "SELECT * FROM TABLE" > dvl.csv)'
VIEWS = "SELECT 1 FROM sqlite_master WHERE name IN ('messages', 'topics') AND type != 'table'"


class Db3Log:
    """A .db3 file."""

    format = "rosbag2 (sqlite3)"

    def __init__(self, path: Path, known: Definitions = SHIPPED) -> None:
        self.path = path
        self._known = known
        self._decoders = DecoderSet(path)
        self._advice = f"sqlite3 {path.name} .recover | sqlite3 NEW.db3 may recover the rest"
        self._unfit: dict[str, Finding] = {}
        self._unpacker: MessageUnpacker | None = None  # of the messages read last

    def topics(self) -> tuple[TopicInfo, ...]:
        """List the topics."""
        return stream_infos(self._streams)

    @contextmanager
    def _open(self) -> Generator[sqlite3.Connection]:
        self._refuse_cut()
        merged = self._merged
        address = f"file:{quote(str(self.path.resolve()))}?mode=ro&immutable=1"
        if merged is not None:
            address = f"file:{quote(str(Path(merged.name) / self.path.name))}"
        try:
            with closing(sqlite3.connect(address, uri=True)) as database:
                database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, min(limit(CHUNK_BYTES), (1 << 31) - 1))
                if database.execute(VIEWS).fetchone():  # a view may have any number of rows
                    raise LogError(
                        "is a sqlite3 file, but not a rosbag2 recording (messages is no table)", path=self.path
                    )
                yield database
        except (sqlite3.Error, TypeError, ValueError, OverflowError) as err:  # damaged cells are of any type
            why = " ".join(str(err).split())
            if "no such" in why:
                text = f"is a sqlite3 file, but not a rosbag2 recording ({why}); {AS_CSV}"
                raise LogError(text, path=self.path) from err
            raise LogError(f"is not a readable rosbag2 recording ({why}); {self._advice}", path=self.path) from err

    @property
    def _journal(self) -> Path | None:
        """Return the journal beside the file: rows that the recorder had not yet written into it."""
        journal = self.path.with_name(self.path.name + "-wal")
        return journal if journal.exists() and journal.stat().st_size else None

    @cached_property
    def _merged(self) -> TemporaryDirectory[str] | None:
        """Return a temporary copy of the file and its journal, in which sqlite3 may merge them."""
        if self._journal is None:
            return None
        with opened(self._journal) as journal:
            if journal.read(len(WAL)) != WAL:
                return None
        folder = TemporaryDirectory(prefix="usbldr-")
        for file in (self.path, self._journal):
            copy(file, folder.name)
        return folder

    def _refuse_cut(self) -> None:
        """Raise LogError if the file is shorter than its header states; sqlite3 would read zeros for the rest."""
        with opened(self.path) as file:
            head = file.read(32)
        size, page, pages = self.path.stat().st_size, int.from_bytes(head[16:18]), int.from_bytes(head[28:32])
        page = 65536 if page == 1 else page
        if size < page * pages:
            cut = f"truncated at byte {size} of {page * pages}"
            raise LogError(f"is not a readable rosbag2 recording ({cut}); {self._advice}", path=self.path)

    @cached_property
    def _listed(self) -> dict[int, tuple[TopicType, str]]:
        """Return the topics by number, each with its type and encoding."""
        with self._open() as database:
            have = {str(row[1]) for row in database.execute("PRAGMA table_info(topics)")}
            encoding = "serialization_format" if "serialization_format" in have else "'cdr'"  # the first rosbag2
            rows = database.execute(f"SELECT id, name, type, {encoding} FROM topics ORDER BY id").fetchall()
            return {
                int(number): ((name_of(str(name)), name_of(str(kind)), 0), str(how or "cdr"))
                for number, name, kind, how in rows
            }

    @cached_property
    def _streams(self) -> dict[TopicType, Stream]:
        streams: dict[TopicType, Stream] = {}
        with self._open() as database:
            definitions = _definitions(database)
            query = "SELECT topic_id, count(*), min(timestamp), max(timestamp) FROM messages GROUP BY topic_id"
            counts = {int(number): (int(n), int(t0), int(t1)) for number, n, t0, t1 in database.execute(query)}
        for number, (key, encoding) in self._listed.items():
            self._decoders.add_topic()
            count, first, last = counts.get(number, (0, None, None))
            decoder = self._decoder(number, key[1], encoding, definitions)
            streams[key] = Stream(*key[:2], encoding, decoder, count, first, last)
        return streams

    def _decoder(
        self, number: int, type_name: str, encoding: str, definitions: Mapping[str, tuple[str, str]]
    ) -> Decoder | str:
        if encoding != "cdr":
            return f"encoding {encoding} is not supported, only cdr"
        if type_name in definitions:
            language, text = definitions[type_name]
            return self._decoders.of(type_name, text.encode(), encoding, language)
        return decoder_without_definition(type_name, self._known, self._samples(number))

    def _samples(self, number: int) -> list[bytes]:
        with self._open() as database:
            rows = database.execute("SELECT data FROM messages WHERE topic_id = ? LIMIT 5", (number,)).fetchall()
        self._unpacker = unpacker = self._unpacker or MessageUnpacker(self.path)
        return [unpacker.unpacked(data) for (data,) in rows]

    def blocks(self, wanted: Mapping[str, Sequence[str]]) -> Iterator[tuple[str, Records]]:
        """Decode the wanted topics block by block."""
        self._unfit = {}
        return decode_blocks(self.path, self._streams, wanted, self._messages(wanted), self._unfit)

    def _messages(self, wanted: Mapping[str, Sequence[str]]) -> Iterator[StreamMessage]:
        """Yield the messages of the wanted topics; the payloads of others are not read."""
        streams = wanted_streams(self._streams, wanted)
        numbers = [number for number, (key, _) in self._listed.items() if key in streams]
        marks = ", ".join("?" * len(numbers))
        query = f"SELECT topic_id, timestamp, data FROM messages WHERE topic_id IN ({marks}) ORDER BY rowid"
        self._unpacker = unpacker = MessageUnpacker(self.path)
        with self._open() as database:
            for number, time_ns, data in database.execute(query, numbers):
                yield self._listed[number][0], int(time_ns), unpacker.unpacked(data)

    def findings(self) -> tuple[Finding, ...]:
        """Report what is missing from the file."""
        oversized = self._unpacker.findings() if self._unpacker else ()
        return (*self._journal_findings(), *oversized, *self._unfit.values())

    def _journal_findings(self) -> list[Finding]:
        journal = f"{self.path.name}-wal"
        if self._merged is not None:
            return [Finding("JOURNAL", f"the file's last rows are in its journal {journal}; they are read, too")]
        if self._journal is not None:
            return [Finding("JOURNAL", f"the journal {journal} cannot be read; its rows are missing", lost_data=True)]
        with opened(self.path) as file:
            journaled = file.read(20)[18:] == b"\2\2"
        text = f"the file was recorded with a journal; if the recorder was killed, rows of {journal} are missing"
        return [Finding("JOURNAL", text)] if journaled else []


def _definitions(database: sqlite3.Connection) -> dict[str, tuple[str, str]]:
    if not database.execute("SELECT 1 FROM sqlite_master WHERE name = 'message_definitions'").fetchone():
        return {}
    rows = database.execute("SELECT topic_type, encoding, encoded_message_definition FROM message_definitions")
    return {str(kind): (str(language), str(text)) for kind, language, text in rows if text}
