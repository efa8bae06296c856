"""The layouts of a sensor's messages: which field of a type is which quantity, and the columns by quantity.

A type is known by the last part of its name and by its fields, not by its package: the same layout lives under many
packages. The types are in dvl, compass, usbl, gps and depth.
"""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from usbldr.filters.errors import LogError, UsageError
from usbldr.filters.types import Indices, Mask, Vector
from usbldr.io.findings import Finding
from usbldr.io.reader import MAX_TIME_NS, Column, Nanoseconds, Records, TopicInfo

Recognised: TypeAlias = Literal["by type", "by type and name", "only when named"]

BLOCK_RECORDS = 100_000  # converted at once if intermediate values would need more memory than the records
GOOD = (
    *("y", "yes", "true", "a", "active", "ok", "good", "valid", "lock", "locked", "fix", "rtk fixed", "rtk float"),
    *("accept", "accepted"),
)
NO_FIX = ("no fix", "nofix", "no_fix", "no gps", "no lock", "no_lock", "not locked", "no bottom", "no bottom lock")
BAD = (
    *("n", "no", "false", "v", "void", "bad", "invalid", "fail", "failed", "error", "lost", "unlocked", "none"),
    *("reject", "rejected", *NO_FIX),
)
FLAG_WORDS: Mapping[str, float] = {**dict.fromkeys(GOOD, 1), **dict.fromkeys(BAD, 0)}
SIGMAS = ("covariance", "own_covariance", "sd", "sd_m", "cov_xx", "cov_xy", "cov_yy")
MAY_LACK = {*SIGMAS, "altitude", "qx", "qy", "qz", "qw"}
"""Quantities that some messages of a sensor may lack: NaN says that they are not known."""
SAME_SECOND_NS = 1_000_000_000  # [ns] by judgement: lines without times are logged as near those with a time
COUNTED = 5  # [records] flags of fewer may grow from each to the next, and be flags
MAX_VALUE = 1e12  # in any unit; a larger number means no data, or is another field's bytes


@dataclass(frozen=True, slots=True)
class MessageLayout:
    """The fields of one message type that hold what a sensor measured."""

    type: str  # last part of the type's name, lower case
    required: Mapping[str, str]  # quantity -> field path
    optional: Mapping[str, str] = field(default_factory=dict[str, str])
    recognised: Recognised = "by type and name"
    defaults: Mapping[str, str] = field(default_factory=dict[str, str])  # configuration keys and their defaults
    fixed: Mapping[str, str] = field(default_factory=dict[str, str])  # keys that follow from the names of the fields
    topic: str = ""  # a pattern that the topic's name has to have
    packages: tuple[str, ...] = ()  # prefixes of the packages for whose drivers the defaults hold; (): any
    stamp: str = "header.stamp"  # the field of the time of validity
    stamp_unit_ns: int = 0  # of that field as the configuration states it; 0: it is whole nanoseconds, or no time
    stamp_at_1970: float = 0  # the value of that field at 1970-01-01
    frame: str = "header.frame_id"  # the field that names the frame of the values
    scale: Mapping[str, float] = field(default_factory=dict[str, float])  # to the quantity's own unit, if not 1
    no_data_values: Mapping[str, tuple[float, ...]] = field(default_factory=dict[str, tuple[float, ...]])
    unsupported: str = ""  # why this known type cannot be used: the end of "it ..."
    by_columns: bool = False  # the configuration names its fields
    preference: int | None = None  # rank in its sensor's order of preference, 0 first; None: not compared

    def named_by(self, topic: TopicInfo) -> bool:
        """Return whether a topic has a type, and a topic, of this name."""
        package, _, name = topic.type.replace("/msg/", "/").replace(".", "/").rpartition("/")
        known = name.lower() == self.type and (not self.packages or package.startswith(self.packages))
        return known and re.search(self.topic, topic.name) is not None

    def fits(self, topic: TopicInfo) -> bool:
        """Return whether a topic has this type and these fields."""
        return self.named_by(topic) and self.fits_fields(topic)

    def fits_fields(self, topic: TopicInfo) -> bool:
        """Return whether a topic has the fields that are required."""
        return all(topic.has(path) for path in self.required.values())

    def means(self, topic: TopicInfo, other: "MessageLayout", other_topic: TopicInfo) -> bool:
        """Return whether a topic of this layout holds the same as another one of another layout, in the same way."""
        names = ("type", "required", "optional", "recognised", "topic", "packages", "stamp", "frame", "preference")
        same = replace(self, **{name: getattr(other, name) for name in names}) == other and self.fits_fields(topic)
        own = wanted_paths(topic, self).keys() - {self.stamp, self.frame}
        return same and own ^ (wanted_paths(other_topic, other).keys() - {other.stamp, other.frame}) <= MAY_LACK


@dataclass(frozen=True, slots=True)
class RawRecords:
    """The records of a sensor in the units and frames of its messages, in the order of arrival."""

    log: Path
    topic: TopicInfo
    layout: MessageLayout
    stamp_ns: Nanoseconds | None  # (n,) stamps, 0 if unset (see `stamped`); None: the type has none
    received_ns: Nanoseconds  # (n,) log time
    values: Mapping[str, Column]  # quantity -> (n,)
    frame_id: str
    attitude: "RawRecords | None" = None  # of a compass: some of the records, with their attitude

    def finding(self, code: str, text: str) -> Finding:
        """Return a finding on the topic, whose name the text goes on from."""
        return Finding(code, f"{self.topic.name}: {text}", self.topic.name)

    def fault(self, text: str) -> LogError:
        """Return an error of the topic."""
        return LogError(text, path=self.log, topic=self.topic.name)

    def part(self, rows: slice | Mask | Indices) -> "RawRecords":
        """Return some of the records."""
        stamp_ns = None if self.stamp_ns is None else self.stamp_ns[rows]
        values = {quantity: column[rows] for quantity, column in self.values.items()}
        return replace(self, stamp_ns=stamp_ns, received_ns=self.received_ns[rows], values=values)

    @property
    def stamped(self) -> Mask:
        """Return which records have a stamp, (n,).

        Zero is none, but in a column of times, or where the log's time is zero, too: of a log without dates.
        """
        if self.stamp_ns is None or self.topic.type.startswith("usbldr/"):
            return np.full(len(self.received_ns), self.stamp_ns is not None)
        stamped = self.stamp_ns != 0
        if stamped.any():
            zero = np.flatnonzero(~stamped)
            stamped[zero] = np.abs(self.received_ns[zero]) < SAME_SECOND_NS
        return stamped

    def later_by(self, shift_ns: int) -> "RawRecords":
        """Return the records with their stamps shifted; unset ones stay so."""
        stamp_ns = None if self.stamp_ns is None else np.where(self.stamped, self.stamp_ns + shift_ns, 0)
        attitude = None if self.attitude is None else self.attitude.later_by(shift_ns)
        return replace(self, stamp_ns=stamp_ns, attitude=attitude)

    def number(self, quantity: str) -> Vector:
        """Return a quantity as floats in its own unit, (n,).

        NaN if it is not finite, is beyond MAX_VALUE or means no data, and if the messages have no such field.
        """
        count = len(self.received_ns)
        if quantity not in self.values or self.is_counter(quantity):
            return np.broadcast_to(np.array([np.nan]), count)
        column = self.values[quantity]
        if column.strides == (0,) and count > 1:  # one value for all
            return np.broadcast_to(self.part(slice(1)).number(quantity), count)
        values = numbers_of(column) if column.dtype.kind == "U" else np.asarray(column, dtype=np.float64)
        known = (np.abs(values) <= MAX_VALUE) & ~np.isin(values, self.layout.no_data_values.get(quantity, ()))
        return np.where(known, values * self.layout.scale.get(quantity, 1.0), np.nan)

    def is_counter(self, flag: str) -> bool:
        """Return whether a flag numbers the records, as a column "Fix" may: it says nothing of any."""
        column = self.values.get(flag, np.empty(0)) if flag in ("valid", "velocity_valid") else np.empty(0)
        column = numbers_of(column) if column.dtype.kind == "U" else column
        return len(column) >= COUNTED and bool(np.all(column[1:] > column[:-1]))

    def text(self, quantity: str) -> NDArray[np.str_]:
        """Return a quantity as texts, (n,); empty if the messages have no such field."""
        if quantity not in self.values:
            return np.full(len(self.received_ns), "")
        return np.asarray(self.values[quantity], dtype=np.str_)

    def words(self, quantity: str) -> NDArray[np.str_]:
        """Return the texts of a quantity in small letters, (n,); empty if its field holds numbers."""
        texts = quantity in self.values and self.values[quantity].dtype.kind == "U"
        return np.strings.lower(self.text(quantity)) if texts else np.full(len(self.received_ns), "")

    @property
    def flagged_invalid(self) -> Mask:
        """Which fixes (n,) their own flag calls invalid, or a word of their status, whose numbers are no flags."""
        by_words: Mask = np.any(
            [np.isin(self.words(name), BAD) for name in ("status", "fix_type", "gga_quality")], axis=0
        )
        return (self.number("valid") == 0) | by_words


def numbers_of(texts: Column) -> Vector:
    """Return texts (n,) as numbers: yes, OK and A(ctive) are 1, no, bad and V(oid) are 0; NaN for any other word."""
    words, which = np.unique(texts, return_inverse=True)
    return np.array([_number_of(str(word).strip()) for word in words])[which]


def _number_of(word: str) -> float:
    try:
        return float(word)
    except ValueError:
        return FLAG_WORDS.get(word.lower(), np.nan)


def blocks(count: int) -> Iterator[slice]:
    """Yield the rows of so many records, a block after the other."""
    return (slice(first, min(first + BLOCK_RECORDS, count)) for first in range(0, count, BLOCK_RECORDS))


def wanted_paths(topic: TopicInfo, layout: MessageLayout) -> dict[str, str]:
    """Return quantity -> field path for all fields of a layout that the topic has, and its header."""
    optional = ({"device": "device"} if topic.is_table else {}) | dict(layout.optional)
    paths = dict(layout.required) | {q: path for q, path in optional.items() if topic.has(path)}
    return paths | {path: path for path in (layout.stamp, layout.frame) if topic.has(path)}


def raw_records(
    log: Path, topic: TopicInfo, layout: MessageLayout, records: Records, paths: Mapping[str, str]
) -> RawRecords:
    """Name the columns of a topic by quantity; ``paths`` are its fields by quantity (see `wanted_paths`)."""
    frames = records.columns.get(layout.frame, np.array([""]))
    stamps = records.columns.get(layout.stamp)
    if stamps is not None and layout.stamp_unit_ns:
        stamps = _configured_stamps(log, topic, layout, stamps)
    return RawRecords(
        log=log,
        topic=topic,
        layout=layout,
        stamp_ns=stamps if stamps is not None and stamps.dtype.kind in "iu" else None,
        received_ns=records.received_ns,
        values={quantity: records.columns[path] for quantity, path in paths.items()},
        frame_id=str(frames[0]) if len(frames) else "",
    )


def _configured_stamps(log: Path, topic: TopicInfo, layout: MessageLayout, times: Column) -> Nanoseconds:
    """Return times (n,) in the unit that the configuration states as nanoseconds, 0 where a number is missing."""
    what = f"{topic.name}: {layout.stamp} under columns"
    if times.dtype.kind not in "iuf":
        raise UsageError(f"{what} is text, not a time", path=log)
    if layout.stamp_at_1970:
        times = np.where(
            times == 0, 0, (times.astype(np.int64) if times.dtype.kind in "iu" else times) - layout.stamp_at_1970
        )
    known = np.isfinite(times)
    if np.any(np.abs(times[known].astype(np.float64)) * layout.stamp_unit_ns >= MAX_TIME_NS):
        raise UsageError(f"{what} has values beyond 2116 in the unit of its key; is it time_ns?", path=log)
    if times.dtype.kind == "f":
        return np.rint(np.where(known, times, 0.0) * layout.stamp_unit_ns).astype(np.int64)
    return times.astype(np.int64) * layout.stamp_unit_ns
