"""The interface of every log format: its topics, and their messages as columns named by field path.

A field path is the name that `rostopic echo -p` gives, with dots throughout: "header.stamp", "twist.twist.linear.x",
"twist.covariance.0", "beams.0.range". A new format is one class with these methods and one line in detect.FORMATS.
"""

import re
import zlib
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Protocol, TypeAlias, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from usbldr.filters.errors import printable, sentence
from usbldr.io.findings import Finding

Nanoseconds: TypeAlias = NDArray[np.int64]  # (n,) since 1970, never through float64
Column: TypeAlias = NDArray[Any]  # (n,) int64, float64, bool or str, as the message has it
MAX_TIME_NS = 1 << 62  # fixed: in 2116, so that differences of times fit 64 bits
TABLES = ("csv", "table")  # encodings
TIME_OF_DAY = " [hhmmss]"  # behind the name of a field of hours, minutes and seconds: its time in nanoseconds
MAX_NAME = 250  # [characters] of a topic or type as users see it


@dataclass(frozen=True, slots=True)
class TopicInfo:
    """One topic of a log."""

    name: str
    type: str  # as the file spells it: "sensor_msgs/msg/Imu"
    encoding: str  # "cdr", "csv"; an unknown one has a problem
    count: int
    first_ns: int | None  # first and last log time; None: no message
    last_ns: int | None
    fields: tuple[str, ...] = ()  # field paths, an array by its bare name, of an array of messages the first's
    problem: str = ""  # why its messages cannot be read; reported only if the topic is wanted
    arrays: frozenset[str] = frozenset()  # "covariance" if it has elements "covariance.0", "beams" of "beams.0.range"
    first_row: tuple[tuple[str, str], ...] = ()  # columns and first cells of a table that others than usbldr named
    is_shared: bool = False  # rows of a table that hold several sensors: of one, a row may have no value
    table: str = ""  # that holds the topic, if it is read by the names of its columns
    unused: tuple[str, ...] = ()  # columns of that table which no sensor uses
    file: str = ""  # the name of the file that holds it, if a log has several
    key: str = ""  # by which it is read: its name, of further types of a topic also a number (see `with_keys`)

    def __post_init__(self) -> None:
        """Keep the problem to one sentence."""
        object.__setattr__(self, "problem", sentence(self.problem))
        object.__setattr__(self, "key", self.key or self.name)

    @property
    def is_table(self) -> bool:
        """Return whether its records are rows of a table, whose columns include their time."""
        return self.encoding in TABLES

    @property
    def span_s(self) -> float:
        """Return the seconds from the first to the last message."""
        return 0.0 if self.first_ns is None or self.last_ns is None else (self.last_ns - self.first_ns) / 1e9

    @property
    def rate_hz(self) -> float:
        """Return messages per second, NaN for fewer than two."""
        return (self.count - 1) / self.span_s if self.span_s > 0 else float("nan")

    @property
    def shown_fields(self) -> tuple[str, ...]:
        """Return the fields as a user names them: arrays by their first elements, "velocity[0]", "beams[0].range"."""
        return tuple(shown_field(field, self.arrays) for field in self.fields)

    def has(self, path: str) -> bool:
        """Return whether messages of this topic have the field."""
        return path in self.fields or listed_field(path, self.fields, self.arrays) is not None


def with_keys(topics: Iterable[TopicInfo]) -> tuple[TopicInfo, ...]:
    """Return the topics of a log, in which a topic may have several types, each with a key of its own."""
    seen, keyed = Counter[str](), list[TopicInfo]()
    for topic in topics:
        seen[topic.name] += 1
        keyed.append(replace(topic, key=f"{topic.name} ({seen[topic.name]})" if seen[topic.name] > 1 else topic.name))
    return tuple(keyed)


def listed_field(path: str, fields: Collection[str], arrays: Collection[str]) -> str | None:
    """Return the field, as a topic lists it, that a path names; None for a whole array, and if there is none.

    It is the path itself, or the array of which this is an element, or the same field of an array's first message.
    """
    if path in fields and path not in arrays:
        return path
    *parts, last = path.split(".")
    listed = ""
    for part in parts:
        listed = f"{listed}.{'0' if part.isdecimal() and listed in arrays else part}".lstrip(".")
    if last.isdecimal() and listed in arrays and listed in fields:
        return listed
    listed = f"{listed}.{last}"
    return listed if listed in fields and listed not in arrays else None


def shown_field(field: str, arrays: Collection[str]) -> str:
    """Return a field as a user names it: an array by its first element."""
    within = re.sub(r"\.0(?=\.)", lambda found: "[0]" if field[: found.start()] in arrays else found[0], field)
    return f"{within}[0]" if field in arrays else within


@dataclass(frozen=True, slots=True)
class Records:
    """The messages of one topic in the order of the file."""

    received_ns: Nanoseconds  # (n,) log time
    columns: Mapping[str, Column]  # field path -> (n,)

    def only(self, paths: Sequence[str]) -> "Records":
        """Return the messages with these columns alone."""
        return Records(self.received_ns, {path: self.columns[path] for path in paths})


class Reader(Protocol):
    """An opened log."""

    @property
    def path(self) -> Path:
        """The file or folder."""
        ...

    @property
    def format(self) -> str:
        """What a user calls it: "MCAP", "CSV folder"."""
        ...

    def topics(self) -> tuple[TopicInfo, ...]:
        """List the topics of the log, without decoding any message."""
        ...

    def blocks(self, wanted: Mapping[str, Sequence[str]]) -> Iterator[tuple[str, Records]]:
        """Read the fields of the topics by their keys, both as `topics` lists them, in one pass over the log.

        Yields keys and blocks of their records in the order of the log, so that only what is made of them needs
        memory; may raise BeginAgainError.
        """
        ...

    def findings(self) -> tuple[Finding, ...]:
        """Report what was lost or unusual in the data read so far."""
        ...


@runtime_checkable
class NamedColumns(Protocol):
    """A log of tables, whose columns the configuration may name."""

    def with_columns(self, configured: Sequence[Any]) -> Reader:
        """Return this log with the columns that the configuration states."""
        ...


class BeginAgainError(Exception):
    """The blocks that a reader has yielded are void; it yields all anew if asked again."""


def name_of(text: str) -> str:
    """Return a topic or type as users see it: without control characters, and shortened if it is endless."""
    text = printable(text)
    if len(text) <= MAX_NAME:
        return text
    return f"{text[:MAX_NAME]}...{zlib.crc32(text.encode(errors='replace')):08x}"  # long names stay different


def utc(time_ns: int) -> str:
    """Return nanoseconds since 1970 as text, to the millisecond: 2016-09-21T16:59:10.501Z."""
    moment = datetime.fromtimestamp(time_ns // 1_000_000_000, UTC)
    return f"{moment:%Y-%m-%dT%H:%M:%S}.{time_ns % 1_000_000_000 // 1_000_000:03d}Z"
