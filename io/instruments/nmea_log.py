"""NMEA 0183 sentences as topics: those of a text file, and those that a text topic of another log carries.

Each kind of sentence is a topic of its own: "/GPGGA" of a file, "/nmea/GPGGA" of the topic "/nmea". A line of a file
may begin with the time at which it was logged.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path

from usbldr.io.decoding.collected import read_whole
from usbldr.io.decoding.nmea_lines import NUMBER, SENTENCE, WORD_LINE
from usbldr.io.decoding.nmea_sentences import Sentences, SentenceSet, find_sentences
from usbldr.io.file_access.open_file import HEAD_BYTES, begin_of, head_lines, parts_within, text_lines
from usbldr.io.findings import Finding
from usbldr.io.instruments.records_log import RecordsLog, Topic
from usbldr.io.reader import Reader, Records

CARRIERS: Mapping[str, str] = {"sentence": "sentence", "string": "data"}
"""Last part of the type of a topic that may carry sentences, and its field."""
SENTENCE_TOPIC_WORDS = re.compile(
    r"nmea|sentence|serial|usbl|ssbl|modem|acoustic|ranger|hipap|gaps|gps|gnss|heading|gyro|hdt"
)
"""Words in the name of a plain text topic that suggest sentences."""


REST = re.compile(r"(?:^|\*)[0-9A-Fa-f]{1,2}\s*$")  # of a line whose beginning was lost


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


def nmea_file(path: Path) -> RecordsLog:
    """Return a text file of sentences."""

    def find(file: Path, findings: list[Finding]) -> Iterator[Topic]:
        parts = (begin_of(file, HEAD_BYTES)[0], *parts_within(file))
        form = next(filter(None, map(form_of, parts)), SENTENCE)
        yield from _topics("", find_sentences(file.name, text_lines(file), form=form), findings)

    return RecordsLog(path, "NMEA text", find)


def _topics(prefix: str, sentences: SentenceSet, findings: list[Finding]) -> Iterator[Topic]:
    """Yield the kinds of sentences of a topic, ``prefix``, or of a file; append what was dropped."""

    def records(topic: str, kind: Sentences, paths: Sequence[str]) -> Records:
        found, undecoded = kind.records(paths)
        if undecoded:
            text = f"{topic}: {undecoded} sentences do not have the fields of their type; left out"
            findings.append(Finding("UNDECODED", text, topic, lost_data=True))
        return found

    findings += [one for one in sentences.findings if sentences.by_name or one.code != "NMEA-OTHER" or not prefix]
    for name, kind in sentences.by_name.items():
        topic = f"{prefix}/{name}"
        yield Topic(kind.info(topic), partial(records, topic, kind))


def carried_sentences(log: Reader) -> RecordsLog | None:
    """Return the kinds of sentences that text topics of a log carry, as a log; None if no topic may carry any."""
    carriers: dict[str, str] = {}
    for topic in log.topics():
        last = topic.type.rpartition("/")[2].lower()
        field = CARRIERS.get(last)
        suggested = last == "sentence" or SENTENCE_TOPIC_WORDS.search(topic.name.lower())
        if field and suggested and topic.count and not topic.problem and topic.has(field):
            carriers[topic.key] = field

    def find(_: Path, findings: list[Finding]) -> Iterator[Topic]:
        for topic, sentences in _carried(log, carriers).items():
            yield from _topics(topic, sentences, findings)

    return RecordsLog(log.path, log.format, find) if carriers else None


def _carried(log: Reader, carriers: Mapping[str, str]) -> dict[str, SentenceSet]:
    """Return the sentences of some topics, ``carriers`` with their fields."""
    stamped = {topic.key for topic in log.topics() if topic.has("header.stamp")}
    wanted = {topic: [field, *(["header.stamp"] * (topic in stamped))] for topic, field in carriers.items()}
    return {
        topic: find_sentences(topic, map(str, r.columns[carriers[topic]]), r.received_ns, r.columns.get("header.stamp"))
        for topic, r in read_whole(log, wanted).items()
    }
