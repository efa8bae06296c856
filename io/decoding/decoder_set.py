"""The decoders of one log: each definition is read once, and all of them together within limits."""

from pathlib import Path

from usbldr.filters.errors import LogError
from usbldr.io.decoding.decoders import Decoder, decoder_of
from usbldr.io.limits import RAISE, limit

TOPICS = 2000  # [topics] of a log; the largest vehicles have some hundreds
DEFINITION_BYTES = 1 << 20  # [bytes] of all definitions of a log without comments; 500 types have a quarter of it
LOG_FIELDS = 200_000  # [fields] of all types of a log; 500 types have 20,000


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


def without_comments(definition: bytes) -> bytes:
    """Return a definition in ROS's own language without the lines that define nothing; they are most of many."""
    lines = ((line, line.strip()) for line in definition.split(b"\n"))
    return b"\n".join(line for line, words in lines if words and not words.startswith(b"#"))
