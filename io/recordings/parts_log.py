"""Tables that follow each other as parts of one topic, as a logger leaves them that begins new files."""

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise

from usbldr.filters.errors import listed
from usbldr.io.findings import Finding
from usbldr.io.messages.topic_names import NO_SENSOR, names_ship, without_numbers
from usbldr.io.reader import Reader, Records, TopicInfo

MOST_OVERLAP = 0.2  # [-] of the shorter part, by judgement: two loggers beside each other overlap by more
LONGEST_PAUSE_S = 600.0  # from one part to the next, by judgement: between two dives it is longer


class PartsLog:
    """A log, some of whose topics are read as one: the first, with the records of those that follow it."""

    def __init__(self, whole: Reader, followers: Mapping[str, Sequence[str]]) -> None:
        """Take the log, and by the first topic the others, in order of time."""
        self.path, self.format, self._whole, self._followers = whole.path, whole.format, whole, followers

    def topics(self) -> tuple[TopicInfo, ...]:
        """List the topics, of parts the first with the count and the end of all."""
        topics = {topic.name: topic for topic in self._whole.topics()}
        for first, names in self._followers.items():
            others = [topics.pop(name) for name in names]
            count = topics[first].count + sum(other.count for other in others)
            topics[first] = replace(topics[first], count=count, last_ns=others[-1].last_ns)
        return tuple(topics.values())

    def blocks(self, wanted: Mapping[str, Sequence[str]]) -> Iterator[tuple[str, Records]]:
        """Read the topics in blocks, of parts one after the other."""
        firsts = {name: first for first in wanted for name in (first, *self._followers.get(first, ()))}
        ends_ns = {topic.name: _span_ns(topic)[1] for topic in self._whole.topics()}
        before = {name: one for first, names in self._followers.items() for one, name in pairwise((first, *names))}
        for topic, records in self._whole.blocks({name: wanted[first] for name, first in firsts.items()}):
            later = records.received_ns > (ends_ns[before[topic]] if topic in before else -1)
            columns = {path: column[later] for path, column in records.columns.items()}
            yield firsts[topic], records if later.all() else Records(records.received_ns[later], columns)

    def findings(self) -> tuple[Finding, ...]:
        """Report which topics are read as one."""
        spans_ns = {topic.name: _span_ns(topic) for topic in self._whole.topics()}
        found = list[Finding]()
        for first, others in self._followers.items():
            text = f"{first}: read as one topic with {listed(others, 5)}: they follow each other"
            if any(spans_ns[one][1] >= spans_ns[other][0] for one, other in pairwise((first, *others))):
                text += "; of times that two of them have, the records of the earlier one are read"
            found.append(Finding("TOPIC-PARTS", text, first))
        return (*found, *self._whole.findings())


def with_parts(log: Reader, chosen: Collection[str]) -> Reader:
    """Return the log with tables that follow each other as one topic: of equal columns, and of names but for numbers.

    Or of any names, if all tables of one sensor follow each other. Topics that the user has ``chosen`` are no followers
    of others.
    """
    names = {name.lstrip("/") for name in chosen}
    topics = log.topics()
    tables = [one for one in topics if one.is_table and one.count and not one.problem and one.first_ns is not None]
    followers: dict[str, Sequence[str]] = {}
    likenesses: tuple[Callable[[TopicInfo], str], ...] = (lambda topic: without_numbers(topic.name), _sensor)
    for likeness_of in likenesses:
        joined = {name for first, others in followers.items() for name in (first, *others)}
        alike: dict[tuple[str, str, tuple[str, ...]], list[TopicInfo]] = {}
        for topic in tables:
            alike.setdefault((likeness_of(topic), topic.type, tuple(sorted(topic.fields))), []).append(topic)
        for group in alike.values():
            first, *others = sorted(group, key=_span_ns)
            free = not joined & {one.name for one in group} and not names & {one.name.lstrip("/") for one in others}
            if others and free and _follow(first, *others):
                followers[first.name] = [other.name for other in others]
    return PartsLog(log, followers) if followers else log


def _sensor(topic: TopicInfo) -> str:
    """Return what tables of one sensor have in common besides their type; the name if the type tells no sensor."""
    if not topic.type.startswith("usbldr/"):
        return topic.name
    return f"{names_ship(topic.name)} {bool(NO_SENSOR.search(topic.name.lower()))}"


def _span_ns(topic: TopicInfo) -> tuple[int, int]:
    return topic.first_ns or 0, topic.last_ns or 0


def _follow(*topics: TopicInfo) -> bool:
    spans_s = [(start / 1e9, end / 1e9) for start, end in map(_span_ns, topics)]
    return all(
        -MOST_OVERLAP * min(one[1] - one[0], other[1] - other[0]) <= other[0] - one[1] <= LONGEST_PAUSE_S
        for one, other in pairwise(spans_s)
    )
