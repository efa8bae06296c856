"""NMEA 0183 sentences as topics: those of a text file, and those that a text topic of another log carries.

Each kind of sentence is a topic of its own: "/GPGGA" of a file, "/nmea/GPGGA" of the topic "/nmea". A line of a file
may begin with the time at which it was logged.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from pathlib import Path

from usbldr.io.decoding.collected import read_whole
from usbldr.io.decoding.nmea_sentences import SENTENCE, WORD_LINE, SentenceSet, find_sentences, undecoded_findings
from usbldr.io.file_access.open_file import head_lines, text_lines
from usbldr.io.findings import Finding
from usbldr.io.reader import Reader, Records, TopicInfo

CARRIERS: Mapping[str, str] = {"sentence": "sentence", "string": "data"}
"""Last part of the type of a topic that may carry sentences, and its field."""
SENTENCE_TOPIC_WORDS = re.compile(
    r"nmea|sentence|serial|usbl|ssbl|modem|acoustic|ranger|hipap|gaps|gps|gnss|heading|gyro|hdt"
)
"""Words in the name of a plain text topic that suggest sentences."""


NUMBER = re.compile(r"(?:^|,)\s*[+-]?\d*\.?\d+(?:[eE][+-]?\d+)?\s*(?:,|$)")


def form_of(head: bytes) -> re.Pattern[str] | None:
    """Return which sentences most of the lines hold that a file begins with; None if they hold none.

    Lines that begin with a word hold a number beside it; a header holds words alone.
    """
    lines = [line for line in head_lines(head) if line.strip()]
    if sum(SENTENCE.search(line) is not None for line in lines) > len(lines) / 2:
        return SENTENCE
    words = ((found := WORD_LINE.search(line)) and NUMBER.search(found[2]) for line in lines)
    return WORD_LINE if next(words, None) and 1 + sum(map(bool, words)) > len(lines) / 2 else None


class NmeaFile:
    """A text file of sentences."""

    format = "NMEA text"

    def __init__(self, path: Path, form: re.Pattern[str] = SENTENCE) -> None:
        """Take the file and the form of its sentences: SENTENCE or WORD_LINE."""
        self.path, self._form = path, form
        self._undecoded: dict[str, int] = {}

    @cached_property
    def _sentences(self) -> SentenceSet:
        return find_sentences(self.path.name, text_lines(self.path), form=self._form)

    @cached_property
    def _topics(self) -> Mapping[str, tuple[str, TopicInfo]]:
        return self._sentences.topics("")

    def topics(self) -> tuple[TopicInfo, ...]:
        """List the kinds of sentences."""
        return tuple(info for _, info in self._topics.values())

    def blocks(self, wanted: Mapping[str, Sequence[str]]) -> Iterator[tuple[str, Records]]:
        """Parse the wanted kinds."""
        for topic, paths in wanted.items():
            records, self._undecoded[topic] = self._sentences.by_name[self._topics[topic][0]].records(paths)
            yield topic, records

    def findings(self) -> tuple[Finding, ...]:
        """Report what was dropped."""
        return (*self._sentences.findings, *undecoded_findings(self._undecoded))


class LogWithSentences:
    """A log in which some text topics carry sentences; each kind of sentence is an additional topic."""

    def __init__(self, carried: Reader, carriers: Mapping[str, str]) -> None:
        self._carried, self._carriers = carried, carriers
        self.path, self.format = carried.path, carried.format
        self._undecoded: dict[str, int] = {}

    @cached_property
    def _sentences(self) -> Mapping[str, SentenceSet]:
        stamped = {t.name for t in self._carried.topics() if t.has("header.stamp")}
        wanted = {topic: [field, *(["header.stamp"] * (topic in stamped))] for topic, field in self._carriers.items()}
        records = read_whole(self._carried, wanted)
        return {
            topic: find_sentences(
                topic, map(str, r.columns[self._carriers[topic]]), r.received_ns, r.columns.get("header.stamp")
            )
            for topic, r in records.items()
        }

    @cached_property
    def _topics(self) -> Mapping[str, tuple[SentenceSet, str, TopicInfo]]:
        found: dict[str, tuple[SentenceSet, str, TopicInfo]] = {}
        for topic, sentences in self._sentences.items():
            found |= {full: (sentences, name, info) for full, (name, info) in sentences.topics(topic).items()}
        return found

    def topics(self) -> tuple[TopicInfo, ...]:
        """List the log's own topics and the kinds of sentences."""
        return (*self._carried.topics(), *(info for _, _, info in self._topics.values()))

    def blocks(self, wanted: Mapping[str, Sequence[str]]) -> Iterator[tuple[str, Records]]:
        """Read the log's own topics block by block, and the wanted sentences of each kind."""
        own = {topic: paths for topic, paths in wanted.items() if topic not in self._topics}
        if own:
            yield from self._carried.blocks(own)
        for topic, paths in wanted.items():
            if topic not in own:
                sentences, name, _ = self._topics[topic]
                records, self._undecoded[topic] = sentences.by_name[name].records(paths)
                yield topic, records

    def findings(self) -> tuple[Finding, ...]:
        """Report what the log lost, and which sentences were dropped."""
        own = [f for s in self._sentences.values() for f in s.findings if s.by_name or f.code != "NMEA-OTHER"]
        return (*self._carried.findings(), *own, *undecoded_findings(self._undecoded))


def with_sentences(log: Reader) -> Reader:
    """Return a log with its sentences as topics; unchanged if no text topic may carry any."""
    carriers: dict[str, str] = {}
    for topic in log.topics():
        last = topic.type.rpartition("/")[2].lower()
        field = CARRIERS.get(last)
        suggested = last == "sentence" or SENTENCE_TOPIC_WORDS.search(topic.name.lower())
        if field and suggested and topic.count and not topic.problem and topic.has(field):
            carriers[topic.name] = field
    return LogWithSentences(log, carriers) if carriers else log
