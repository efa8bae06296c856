"""Tables that are parts of one dive: those that follow each other as one topic, and times without a date."""

import re
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from datetime import date
from itertools import pairwise

from usbldr.filters.errors import listed
from usbldr.io.findings import Finding
from usbldr.io.messages.topic_names import NO_SENSOR, names_ship, without_numbers
from usbldr.io.reader import Reader, Records, TopicInfo, utc
from usbldr.io.recordings.joined import UNDATED, JoinedLog, LogPart

MOST_OVERLAP = 0.2  # [-] of the shorter part, by judgement: two loggers beside each other overlap by more
LONGEST_PAUSE_S = 600.0  # from one part to the next, by judgement: between two dives it is longer
DAY_NS = 86_400_000_000_000  # fixed
MAX_NAMES = 20  # of topics in a sentence
LONGEST_NS = 30 * DAY_NS  # a topic that ends later counts from power-on until its clock is set
DATE_IN_NAME = re.compile(r"(?<!\d)(20\d\d)([-_.]?)(\d\d)\2(\d\d)(?=\D|\d{4}(?:\d\d)?(?!\d)|$)")
"""A date, perhaps before a time of day: 20240512, 2024-05-12, 20240512T101500."""
NEAR_NS = 3_600_000_000_000  # [ns] an hour, by judgement: sensors of one dive are not so long apart


class PartsLog:
    """A log, some of whose topics are read as one: the first, with the records of those that follow it.

    A logger leaves such topics if it begins new files.
    """

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


def with_dates(log: Reader, units_ns: Mapping[str, int]) -> Reader:
    """Return the log with times without a date beside the others, else on the date of their file's name.

    It is as it is if neither is known: the others are far, or fit several days. Times of day are moved by whole days.
    The others have dates, or all are without: then they begin in the evening of 1970-01-01, before a midnight.
    """
    if not any(finding.code in UNDATED for finding in log.findings()):
        return log
    topics = [one for one in log.topics() if one.first_ns is not None]
    spans = {one.name: _span_ns(one) for one in topics}
    undated = {name for name, span in spans.items() if span[0] < 2 * DAY_NS}
    stated = {one.name: _day_of(one.name, one.file, log.path.name) for one in topics if one.name in undated}
    stated = {name: day for name, day in stated.items() if day and spans[name][1] < LONGEST_NS}
    in_names = stated if undated == spans.keys() else {}
    spans |= {name: (spans[name][0] + day * DAY_NS, spans[name][1] + day * DAY_NS) for name, day in in_names.items()}
    dated = spans.keys() - (undated - in_names.keys())
    fixed = dated or {name for name in undated if spans[name][0] >= DAY_NS // 2}
    if not fixed:
        return log
    begin, end = min(spans[name][0] for name in fixed), max(spans[name][1] for name in fixed)
    days = {name: _days(*spans[name], begin, end) for name in spans if name in undated - {*fixed}}
    in_names |= {name: stated[name] for name, count in days.items() if count is None and name in stated}
    beside = {name: count for name, count in days.items() if name not in in_names}
    if dated and None in beside.values():
        return log  # some would have no date
    if not any(beside.values()) and not in_names:
        return log
    findings = [
        Finding("DATE-OF-OTHERS", f"{listed(list(found), MAX_NAMES)}: the times have no date; the first day is {day}")
        for found, whose in (({n: k for n, k in beside.items() if k}, "the others"), (in_names, "their file's name"))
        for day in ([f"{utc(min(found.values()) * DAY_NS)[:10]}, as of {whose}"] if found and dated else [])
    ]
    later_ns = {name: count * DAY_NS for name, count in (in_names | beside).items() if count}
    part = LogPart(log, dated=bool(dated), later_ns=later_ns)
    return JoinedLog(log.path, (part,), tuple(findings), time_units_ns=units_ns, kind=log.format)


def _day_of(*names: str) -> int:
    """Return the date in the first of the names that holds one, in days since 1970; 0 if none does."""
    for found in map(DATE_IN_NAME.search, names):
        with suppress(ValueError):
            if found:
                return (date(*map(int, found.group(1, 3, 4))) - date(1970, 1, 1)).days
    return 0


def _days(first_ns: int, last_ns: int, begin_ns: int, end_ns: int) -> int | None:
    """Return by how many days a span has to be moved to overlap another, or to be near it; None if that is unknown."""
    first, last = (begin_ns - last_ns) // DAY_NS, (end_ns - first_ns) // DAY_NS + 1
    apart = {k: max(begin_ns - last_ns - k * DAY_NS, first_ns + k * DAY_NS - end_ns) for k in range(first, last + 1)}
    fitting = [k for k, ns in apart.items() if ns <= 0] or [k for k, ns in apart.items() if ns < NEAR_NS]
    return fitting[0] if len(fitting) == 1 else None
