"""NMEA 0183 sentences as topics: those of a text file, and those that a text topic of another log carries.

Each kind of sentence is a topic of its own: "/GPGGA" of a file, "/nmea/GPGGA" of the topic "/nmea". A line of a file
may begin with the time at which it was logged.
"""

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cached_property
from pathlib import Path

from usbldr.io.decoding.collected import read_whole
from usbldr.io.decoding.nmea_sentences import SENTENCE, WORD_LINE, SentenceSet, find_sentences
from usbldr.io.file_access.open_file import head_lines, text_lines
from usbldr.io.findings import Finding
from usbldr.io.reader import Reader, Records, TopicInfo

CARRIERS: Mapping[str, str] = {"sentence": "sentence", "string": "data"}
"""Last part of the type of a topic that may carry sentences, and its field."""
SENTENCE_TOPIC_WORDS = re.compile(
    r"nmea|sentence|serial|usbl|ssbl|modem|acoustic|ranger|hipap|gaps|gps|gnss|heading|gyro|hdt"
)
"""Words in the name of a plain text topic that suggest sentences."""


REST = re.compile(r"(?:^|\*)[0-9A-Fa-f]{1,2}\s*$")  # of a line whose beginning was lost
NUMBER = re.compile(r"(?:^|,)\s*[+-]?\d*\.?\d+(?:[eE][+-]?\d+)?\s*(?:,|$)")


def form_of(head: bytes) -> re.Pattern[str] | None:
    """Return which sentences most of the lines hold that a file begins with; None if they hold none.

    Lines that begin with a word hold a number beside it; a header holds words alone. The first may be cut.
    """
    lines = [line for line in head_lines(head) if line.strip()]
    if sum(SENTENCE.search(line) is not None for line in lines) > len(lines) / 2:
        return SENTENCE
    words = [(found := WORD_LINE.search(line)) and NUMBER.search(found[2]) for line in lines]
    begins = words and (words[0] or NUMBER.search(lines[0]) or REST.search(lines[0]))
    return WORD_LINE if begins and sum(map(bool, words)) > len(lines) / 2 else None


class SentenceLog:
    """Kinds of sentences as topics: those of a text file, or those of the text topics of a log, beside its own."""

    def __init__(
        self, path: Path, kind: str, find: Callable[[], Mapping[str, SentenceSet]], carried: Reader | None = None
    ) -> None:
        """Take what finds the sentences by the topic that carries them, "" for a file; ``kind``: of the log."""
        self.path, self.format, self._find, self._carried = path, kind, find, carried
        self._undecoded: dict[str, int] = {}

    @cached_property
    def _sentences(self) -> Mapping[str, SentenceSet]:
        return self._find()

    @cached_property
    def _topics(self) -> Mapping[str, tuple[SentenceSet, str, TopicInfo]]:
        found: dict[str, tuple[SentenceSet, str, TopicInfo]] = {}
        for topic, sentences in self._sentences.items():
            found |= {full: (sentences, name, info) for full, (name, info) in sentences.topics(topic).items()}
        return found

    def topics(self) -> tuple[TopicInfo, ...]:
        """List the log's own topics and the kinds of sentences."""
        own = self._carried.topics() if self._carried else ()
        return (*own, *(info for _, _, info in self._topics.values()))

    def blocks(self, wanted: Mapping[str, Sequence[str]]) -> Iterator[tuple[str, Records]]:
        """Read the log's own topics block by block, and the wanted sentences of each kind."""
        own = {topic: paths for topic, paths in wanted.items() if topic not in self._topics}
        if own and self._carried:
            yield from self._carried.blocks(own)
        for topic, paths in wanted.items():
            if topic not in own:
                sentences, name, _ = self._topics[topic]
                records, self._undecoded[topic] = sentences.by_name[name].records(paths)
                yield topic, records

    def findings(self) -> tuple[Finding, ...]:
        """Report what the log lost, and which sentences were dropped."""
        own = self._carried.findings() if self._carried else ()
        found = [
            finding
            for topic, sentences in self._sentences.items()
            for finding in sentences.findings
            if sentences.by_name or finding.code != "NMEA-OTHER" or not topic
        ]
        text = "{}: {} sentences do not have the fields of their type; left out"
        undecoded = [
            Finding("UNDECODED", text.format(topic, count), topic, lost_data=True)
            for topic, count in self._undecoded.items()
            if count
        ]
        return (*own, *found, *undecoded)


def nmea_file(path: Path, form: re.Pattern[str] = SENTENCE) -> SentenceLog:
    """Return a text file of sentences, whose form is SENTENCE or WORD_LINE."""
    return SentenceLog(path, "NMEA text", lambda: {"": find_sentences(path.name, text_lines(path), form=form)})


def with_sentences(log: Reader) -> Reader:
    """Return a log with its sentences as topics; unchanged if no text topic may carry any."""
    carriers: dict[str, str] = {}
    for topic in log.topics():
        last = topic.type.rpartition("/")[2].lower()
        field = CARRIERS.get(last)
        suggested = last == "sentence" or SENTENCE_TOPIC_WORDS.search(topic.name.lower())
        if field and suggested and topic.count and not topic.problem and topic.has(field):
            carriers[topic.name] = field
    return SentenceLog(log.path, log.format, lambda: _carried(log, carriers), log) if carriers else log


def _carried(log: Reader, carriers: Mapping[str, str]) -> dict[str, SentenceSet]:
    """Return the sentences of some topics, ``carriers`` with their fields."""
    stamped = {topic.name for topic in log.topics() if topic.has("header.stamp")}
    wanted = {topic: [field, *(["header.stamp"] * (topic in stamped))] for topic, field in carriers.items()}
    return {
        topic: find_sentences(topic, map(str, r.columns[carriers[topic]]), r.received_ns, r.columns.get("header.stamp"))
        for topic, r in read_whole(log, wanted).items()
    }
