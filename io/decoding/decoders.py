"""What the binary formats share: decoders, and the messages of a topic and type, counted and laid out in columns."""

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, TypeAlias

import numpy as np

from usbldr.filters.errors import LogError
from usbldr.io.decoding.cdr import RosDecoder, ros_decoder
from usbldr.io.decoding.columns import DecodedRows, DefinitionError, Extractor, concatenated, decode_one_by_one
from usbldr.io.decoding.definitions import Definitions
from usbldr.io.decoding.json_messages import JsonDecoder, schema_of
from usbldr.io.findings import Finding
from usbldr.io.limits import RAISE, limit
from usbldr.io.reader import Records, TopicInfo, utc, with_keys

TopicType: TypeAlias = tuple[str, str, int]  # topic, type and definition (see `definition_hash`)
BATCH_MESSAGES = 1 << 14  # [messages] decoded at once: enough for the speed of NumPy
BATCH_BYTES = 1 << 24  # [bytes] the same, of large messages
StreamMessage: TypeAlias = tuple[
    TopicType, int, bytes | memoryview
]  # and log time, ns since 1970; payload, valid until the next
TOPICS = 2000  # [topics] of a log; the largest vehicles have some hundreds
DEFINITION_BYTES = 1 << 20  # [bytes] of all definitions of a log without comments; 500 types have a quarter of it
LOG_FIELDS = 200_000  # [fields] of all types of a log; 500 types have 20,000


class Decoder(Protocol):
    """The messages of one type."""

    @property
    def fields(self) -> tuple[str, ...]:
        """Field paths that can be read, an array of numbers by its bare name."""
        ...

    @property
    def arrays(self) -> frozenset[str]:
        """The fields that are arrays."""
        ...

    def extractor(self, paths: Sequence[str]) -> Extractor:
        """Return a function from a message's bytes to the values at the paths; to None if the bytes do not match."""
        ...


def _protobuf(name: str, definition: bytes) -> Decoder:
    from usbldr.io.decoding.protobuf import ProtobufDecoder  # the library takes a while to load

    return ProtobufDecoder(name, definition)


DECODERS: Mapping[tuple[str, str], Callable[[str, bytes], Decoder]] = {
    ("cdr", "ros2msg"): ros_decoder,
    ("cdr", "ros2idl"): lambda name, definition: ros_decoder(name, definition, language="idl"),
    ("ros1", "ros1msg"): lambda name, definition: ros_decoder(name, definition, "ros1"),
    ("protobuf", "protobuf"): _protobuf,
    ("json", "jsonschema"): JsonDecoder,
}
"""By the encodings of messages and of their definitions: from a type's name and definition to its decoder.

An encoding is one line. Its function raises DefinitionError if the definition is invalid.
"""


@dataclass(slots=True)
class Stream:
    """The messages of one topic and type, as far as they have been counted."""

    topic: str
    type: str  # as the file spells it
    encoding: str
    decoder: Decoder | str  # or the reason why there is none
    count: int = 0
    first_ns: int | None = None
    last_ns: int | None = None

    def add_messages(self, count: int, first_ns: int, last_ns: int) -> None:
        """Count messages."""
        self.count += count
        self.first_ns = first_ns if self.first_ns is None else min(self.first_ns, first_ns)
        self.last_ns = last_ns if self.last_ns is None else max(self.last_ns, last_ns)

    def info(self) -> TopicInfo:
        """Return the topic's information for the user."""
        counted = self.count, self.first_ns, self.last_ns
        if isinstance(self.decoder, str):
            return TopicInfo(self.topic, self.type, self.encoding, *counted, problem=self.decoder)
        fields, arrays = self.decoder.fields, self.decoder.arrays
        return TopicInfo(self.topic, self.type, self.encoding, *counted, fields, arrays=arrays)


def decoder_of(type_name: str, definition: bytes, encoding: str, definition_encoding: str) -> Decoder | str:
    """Return the decoder of a type, or the reason why there is none; encodings are spelt as in MCAP."""
    make = DECODERS.get((encoding, definition_encoding))
    if make is None and not definition:
        return f"its messages ({encoding or 'unknown encoding'}) have no definition"
    if make is None:
        can = ", ".join(message if message == text else f"{message} with {text}" for message, text in DECODERS)
        return f"encoding {encoding} with {definition_encoding} definitions is not supported, only {can}"
    try:
        return make(type_name, definition)
    except DefinitionError as err:
        return f"the definition of its type {type_name} is not valid ({err})"


def decoder_without_definition(type_name: str, known: Definitions, samples: Sequence[bytes]) -> Decoder | str:
    """Return the decoder of a type that the log does not define, or the reason why there is none.

    Of several known layouts of this type, the one that matches the samples is used.
    """
    absent = f"the file holds no definition of its type {type_name}"
    try:
        decoders = [RosDecoder(type_name, types) for types in known.layouts(type_name)]
    except DefinitionError as err:
        return f"{absent}, and the one that --msg-path names is not valid ({err})"
    if not decoders:
        return f"{absent}; name a folder that holds {type_name}.msg with --msg-path DIR"
    fitting = [decoder for decoder in decoders if decoder.fits(samples)]
    if not fitting:
        tried = f"{len(decoders)} known layouts" if len(decoders) > 1 else "known layout"
        right = f"name a folder that holds the right {type_name}.msg with --msg-path DIR"
        return f"{absent}, and its messages do not match the {tried}; {right}"
    return fitting[0]


def json_decoder(type_name: str, samples: Sequence[bytes]) -> Decoder | str:
    """Return the decoder of JSON messages without a useful schema from some of them, or why there is none."""
    decoder = JsonDecoder(type_name, schema_of(samples))
    return decoder if decoder.fields else "its messages (json) have no known fields: no schema, and none in the first"


def stream_infos(streams: Mapping[TopicType, Stream]) -> tuple[TopicInfo, ...]:
    """Return the topics of a log for the user."""
    return with_keys(stream.info() for stream in streams.values())


def wanted_streams(streams: Mapping[TopicType, Stream], wanted: Mapping[str, Sequence[str]]) -> dict[TopicType, str]:
    """Return the streams to read, with the keys of their topics."""
    keys = {key: topic.key for key, topic in zip(streams, stream_infos(streams), strict=True)}
    return {key: name for key, name in keys.items() if name in wanted}


def decode_blocks(
    log: Path,
    streams: Mapping[TopicType, Stream],
    wanted: Mapping[str, Sequence[str]],
    messages: Iterable[StreamMessage],
    unfit: dict[str, Finding],
) -> Iterator[tuple[str, Records]]:
    """Yield keys of topics and blocks of their records with the wanted fields, in the order of the messages.

    Those of several types of a topic follow each other, too. ``messages`` may hold more than is wanted. Findings for
    topics with messages that do not match their definition are added to ``unfit`` in the end.
    """
    names = wanted_streams(streams, wanted)
    chosen = {key: _Batch(_decoder(log, streams[key]), wanted[name]) for key, name in names.items()}
    last: dict[str, TopicType] = {}  # topic -> its type
    for key, time_ns, data in messages:
        batch = chosen.get(key)
        if batch is None:
            continue
        if last.setdefault(key[0], key) != key:
            yield names[last[key[0]]], chosen[last[key[0]]].decoded()
            last[key[0]] = key
        if batch.add(time_ns, data):
            yield names[key], batch.decoded()
    for key, batch in chosen.items():
        yield names[key], batch.decoded()
        if batch.unfit:
            unfit[names[key]] = _unfit(streams[key], batch)


class _Batch:
    """Some messages of a topic, to be decoded together."""

    def __init__(self, decoder: Decoder, paths: Sequence[str]) -> None:
        self._decoder, self._paths = decoder, tuple(dict.fromkeys(paths))
        self._times, self._payloads, self._size = list[int](), list[bytes](), 0
        self.unfit = list[int]()  # times of messages that do not match their definition
        self.unfit_heads: set[int] = set()  # the second bytes of those
        self.unfit_field = ""  # of the first of them, that cannot be read; empty if none can

    def add(self, time_ns: int, data: bytes | memoryview) -> bool:
        """Add a message with its log time; return whether the batch is full."""
        self._times.append(time_ns)
        self._payloads.append(bytes(data))
        self._size += len(data)
        return self._size > BATCH_BYTES or len(self._times) >= BATCH_MESSAGES

    def decoded(self) -> Records:
        """Return the records of the messages, and begin anew."""
        times, payloads = np.array(self._times, dtype=np.int64), self._payloads
        self._times, self._payloads, self._size = [], [], 0
        read = concatenated(_pieces(self._decoder, payloads, self._paths), self._paths)
        if len(read.rows) < len(times):
            missing = np.delete(np.arange(len(times)), read.rows).tolist()
            if not self.unfit and not isinstance(self._decoder, RosDecoder):
                first, extractor = payloads[missing[0]], self._decoder.extractor
                bad = [path for path in self._paths if extractor([path])(first) is None]
                self.unfit_field = bad[0] if len(bad) < len(self._paths) else ""
            self.unfit += times[missing].tolist()
            self.unfit_heads |= {p[1] for p in map(payloads.__getitem__, missing) if len(p) > 1 and p[0] == 0}
        order = np.argsort(read.rows)
        return Records(times[read.rows[order]], {path: read.columns[path][order] for path in self._paths})


def _pieces(decoder: Decoder, payloads: Sequence[bytes], paths: Sequence[str]) -> Sequence[DecodedRows]:
    if isinstance(decoder, RosDecoder):
        return decoder.pieces(payloads, paths)
    return [decode_one_by_one(decoder.extractor(paths), payloads, paths)]


FOREIGN_CDR: Mapping[int, str] = {2: "PL_CDR", 3: "PL_CDR", **dict.fromkeys((6, 7, 8, 9, 10, 11), "XCDR2")}
"""Encodings other than plain CDR by the second byte of a message (OMG DDS-XTypes 1.3, 7.6.3.1.2)."""


def _unfit(stream: Stream, batches: _Batch) -> Finding:
    """Report that messages did not match their definition, and whether another encoding is the reason."""
    heads = batches.unfit_heads & FOREIGN_CDR.keys() if stream.encoding == "cdr" else set[int]()
    foreign = sorted({FOREIGN_CDR[head] for head in heads})
    why = f": they are in {' and '.join(foreign)}, not plain CDR" if foreign else ""
    why = f"; the first has no such {batches.unfit_field}" if batches.unfit_field else why
    first = utc(batches.unfit[0])
    text = f"{stream.topic}: {len(batches.unfit)} messages, the first of {first}, do not match"
    return Finding("UNDECODED", f"{text} their definition in the file{why}", stream.topic, lost_data=True)


def _decoder(log: Path, stream: Stream) -> Decoder:
    if isinstance(stream.decoder, str):
        raise LogError(f"{stream.topic} cannot be read: {stream.decoder}", path=log)
    return stream.decoder


class DecoderSet:
    """The decoders of one log by type and definition."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._made: dict[tuple[str, bytes, str, str], Decoder | str] = {}
        self._topics, self._bytes, self._fields = limit(TOPICS), limit(DEFINITION_BYTES), limit(LOG_FIELDS)

    def add_topic(self) -> None:
        """Count a topic; raise LogError beyond the limit."""
        self._topics -= 1
        if self._topics < 0:
            raise LogError(f"has more than {limit(TOPICS)} topics; {RAISE}", path=self._path)

    def of(self, type_name: str, definition: bytes, encoding: str, definition_encoding: str) -> Decoder | str:
        """Return the decoder of a type, or the reason why there is none (see `decoder_of`)."""
        if definition_encoding in ("ros1msg", "ros2msg"):
            definition = without_comments(definition)
        key = (type_name, definition, encoding, definition_encoding)
        if key not in self._made:
            self._made[key] = self._new(type_name, definition, encoding, definition_encoding)
        return self._made[key]

    def _new(self, type_name: str, definition: bytes, encoding: str, definition_encoding: str) -> Decoder | str:
        self._bytes -= len(definition)
        if self._bytes < 0:
            self._bytes += len(definition)
            return f"the definitions in the log have more than {limit(DEFINITION_BYTES) >> 10} kB; {RAISE}"
        decoder = decoder_of(type_name, definition, encoding, definition_encoding)
        if isinstance(decoder, str):
            return decoder
        self._fields -= len(decoder.fields)
        if self._fields < 0:
            self._fields += len(decoder.fields)
            return f"the types in the log have more than {limit(LOG_FIELDS)} fields; {RAISE}"
        return decoder


def definition_hash(definition: bytes, definition_encoding: str) -> int:
    """Return what is the same for equal definitions in ROS's language, whatever their spaces, comments and order.

    Of others 0: their messages hold the numbers or names of the fields.
    """
    if definition_encoding not in ("ros1msg", "ros2msg"):
        return 0
    plain = b" ".join(re.sub(rb"#[^\n]*", b"", definition).split())
    first, *used = re.split(rb" ?={20,} ?", plain)
    return hash((first, frozenset(used)))


def without_comments(definition: bytes) -> bytes:
    """Return a definition in ROS's own language without the lines that define nothing; they are most of many."""
    lines = ((line, line.strip()) for line in definition.split(b"\n"))
    return b"\n".join(line for line, words in lines if words and not words.startswith(b"#"))
