"""NMEA 0183 sentences found in lines of text: checked, timed and sorted by kind.

nmea_kinds lists the sentences that are understood; nmea_times finds their times of validity.
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from usbldr.io.decoding.nmea_kinds import (
    SENTENCE_KINDS,
    VARIANTS,
    SentenceKind,
    SentenceValues,
    decode_sentences,
    kind_of,
)
from usbldr.io.decoding.nmea_times import (
    NO_TIME,
    date_ns,
    on_nearest_date,
    prefixed_ns,
    time_of_day_ns,
    times_from_sentences,
)
from usbldr.io.findings import Finding
from usbldr.io.reader import Column, Nanoseconds, Records, TopicInfo

SENTENCE = re.compile(r"[$!]([A-Z][A-Z0-9]{3,}),([^$*\r\n]*)(?:\*([0-9A-Fa-f]{2}))?")
PREFERRED = {"RMC": "GGA", "GLL": "GGA", "GNS": "GGA"}
"""Sentences that repeat the position of another, which is used if both are present."""


@dataclass(frozen=True, slots=True)
class Sentences:
    """Sentences of one kind."""

    kind: str  # of SENTENCE_KINDS, or another
    contents: Sequence[str]  # from the name to the checksum, without it
    received_ns: Nanoseconds  # (n,)
    stamp_ns: Nanoseconds | None  # (n,) None if neither they nor their messages hold any

    def info(self, topic: str, alone: bool) -> TopicInfo:
        """Return the topic for the user; without a position unless they are ``alone`` in holding it."""
        known = SENTENCE_KINDS.get(self.kind, SentenceKind())
        stamped = ("header.stamp",) if self.stamp_ns is not None else ()
        return TopicInfo(
            name=topic,
            type=f"nmea/{self.kind}",
            encoding="nmea",
            count=len(self.contents),
            first_ns=int(self.received_ns.min()),
            last_ns=int(self.received_ns.max()),
            fields=(*stamped, *known.columns) if alone else stamped,
        )

    def records(self, paths: Sequence[str]) -> tuple[Records, int]:
        """Return the wanted columns, and how many sentences do not match their kind."""
        known = SENTENCE_KINDS[self.kind]
        rows = decode_sentences(self.kind, self.contents)
        good = np.array([row is not None for row in rows], dtype=np.bool_)
        order = np.flatnonzero(good)
        decoded: list[SentenceValues] = [row for i in map(int, order) if (row := rows[i]) is not None]
        columns: dict[str, Column] = {}
        for path in paths:
            if path == "header.stamp" and self.stamp_ns is not None:
                columns[path] = self.stamp_ns[order]
            else:
                place = known.columns.index(path)
                columns[path] = np.array([row[place] for row in decoded])
        return Records(self.received_ns[order], columns), int(np.sum(~good))


@dataclass(frozen=True, slots=True)
class SentenceSet:
    """All sentences of one source, by name: "GPGGA", "PSIMSSB_C_H"."""

    by_name: Mapping[str, Sentences]
    findings: tuple[Finding, ...]

    def topics(self, prefix: str) -> dict[str, tuple[str, TopicInfo]]:
        """Return by topic the name and the topic's information for the user."""
        found: dict[str, tuple[str, TopicInfo]] = {}
        for name, sentences in self.by_name.items():
            preferred = PREFERRED.get(sentences.kind)
            alone = preferred is None or name.removesuffix(sentences.kind) + preferred not in self.by_name
            found[f"{prefix}/{name}"] = name, sentences.info(f"{prefix}/{name}", alone)
        return found


class _FoundSentence(NamedTuple):
    """One sentence."""

    name: str
    content: str
    checked: bool
    line: int
    logged: int  # NO_TIME if unknown
    time_of_day: int
    midnight: int
    has_fix: bool | None  # whether a receiver has a fix, and so the time; None: not stated


def find_sentences(
    source: str, lines: Iterable[str], received_ns: Nanoseconds | None = None, stamp_ns: Nanoseconds | None = None
) -> SentenceSet:
    """Find the sentences in lines of text, check their checksums and time them.

    ``received_ns`` and ``stamp_ns`` (n,) are those of the lines; without them the beginnings of the lines are used.
    """
    found, wrong, without = _scan_lines(lines, received_ns)
    checked = {row.name for row in found if row.checked}
    rows = [row for row in found if row.checked or row.name not in checked]  # those without checksum are cut
    topic = "" if received_ns is None else source  # a file is none
    findings = _counted(source, topic, rows, wrong + len(found) - len(rows), without)
    if not rows:
        return SentenceSet({}, tuple(findings))
    time, midnight = _receiver_times(rows)
    received, more = _received(source, np.array([row.logged for row in rows]), time, midnight)
    own = np.where(midnight != NO_TIME, midnight + time, on_nearest_date(time, received))
    by_name: dict[str, Sentences] = {}
    for name in dict.fromkeys(row.name for row in rows):
        indices = [i for i, row in enumerate(rows) if row.name == name]
        kind, logged = kind_of(name), received[indices]
        stamps = stamp_ns[[rows[i].line for i in indices]] if stamp_ns is not None else None
        if SENTENCE_KINDS.get(kind, SentenceKind()).time is not None:
            stamps = np.where(time[indices] == NO_TIME, logged if stamps is None else stamps, own[indices])
        by_name[name] = Sentences(kind, [rows[i].content for i in indices], logged, stamps)
    return SentenceSet(by_name, (*findings, *more))


def _scan_lines(lines: Iterable[str], received_ns: Nanoseconds | None) -> tuple[list[_FoundSentence], int, int]:
    """Return the sentences, how many have a wrong checksum or are cut, and how many lines hold no sentence."""
    from pynmeagps import calc_checksum  # pyright: ignore

    found: list[_FoundSentence] = []
    wrong, without, last = 0, 0, NO_TIME
    for number, line in enumerate(lines):
        begin = 0
        for match in SENTENCE.finditer(line):
            name, body, checksum = match.groups()
            content = f"{name},{body}"
            logged = prefixed_ns(line[begin : match.start()]) if received_ns is None else int(received_ns[number])
            last = logged if logged != NO_TIME else last
            begin = match.end()
            sentence_time = _sentence_time(name, body.split(","))
            if sentence_time is None or (checksum and str(calc_checksum(content)) != checksum.upper()):
                wrong += 1
            else:
                full, time, midnight, has_fix = sentence_time
                content = content if kind_of(full) in SENTENCE_KINDS else ""
                found.append(_FoundSentence(full, content, bool(checksum), number, last, time, midnight, has_fix))
        without += begin == 0 and bool(line.strip())
    return found, wrong, without


def _receiver_times(rows: Sequence[_FoundSentence]) -> tuple[Nanoseconds, Nanoseconds]:
    """Return times of day and midnights (n,), NO_TIME while the receiver has no fix: its clock is not set.

    A sentence that does not say has the fix of the last one of its receiver that does, the first ones that of the
    first. If no receiver ever has one, the times of day remain.
    """
    talkers = [row.name[: -len(kind_of(row.name))] for row in rows]
    fixed = {
        talker: row.has_fix
        for talker, row in reversed(list(zip(talkers, rows, strict=True)))
        if row.has_fix is not None
    }
    known = np.empty(len(rows), dtype=np.bool_)
    for i, (talker, row) in enumerate(zip(talkers, rows, strict=True)):
        if row.has_fix is not None:
            fixed[talker] = row.has_fix
        known[i] = not talker or fixed.get(talker, True)
    time, midnight = (np.array([getattr(row, name) for row in rows]) for name in ("time_of_day", "midnight"))
    midnight = np.where(known, midnight, NO_TIME)
    return np.where(known, time, NO_TIME) if np.any(time[known] != NO_TIME) else time, midnight


def _sentence_time(name: str, fields: Sequence[str]) -> tuple[str, int, int, bool | None] | None:
    """Return the kind's full name, time of day, midnight and fix of a sentence, None if it is cut."""
    try:
        full = name + VARIANTS.get(kind_of(name), lambda _: "")(fields)
    except IndexError:
        return None
    kind = SENTENCE_KINDS.get(kind_of(full), SentenceKind())
    time = NO_TIME
    if kind.time is not None and kind.time < len(fields):
        time = time_of_day_ns(fields[kind.time].rpartition(" ")[2])
    date = [fields[i].partition(" ")[0] for i in kind.date if i < len(fields)]
    midnight = date_ns(date) if time != NO_TIME and date and len(date) == len(kind.date) else NO_TIME
    return full, time, midnight, kind.has_fix(fields)


def _received(
    source: str, logged: Nanoseconds, time: Nanoseconds, midnight: Nanoseconds
) -> tuple[Nanoseconds, list[Finding]]:
    """Return the log times (n,): if no line holds any, those from the sentences."""
    known = logged != NO_TIME
    if known.any():
        return np.where(known, logged, logged[known][0]), []
    try:
        received, dated = times_from_sentences(time, midnight)
    except ValueError:
        text = f"{source}: neither its lines nor its sentences contain a time; they are taken as 1 s apart"
        return np.arange(len(logged), dtype=np.int64) * 1_000_000_000, [Finding("NMEA-TIME", text)]
    text = "lines without log time: sentences are timed by the time they contain, the others evenly between"
    findings = [Finding("NMEA-TIME", f"{source}: {text}")]
    if not dated:
        text = f"{source}: no sentence contains a date; the first day is taken as 1970-01-01; state date under [[file]]"
        findings.append(Finding("NMEA-DATE", text))
    return received, findings


def _counted(source: str, topic: str, rows: Sequence[_FoundSentence], wrong: int, without: int) -> list[Finding]:
    total, unchecked = len(rows) + wrong, sum(not row.checked for row in rows)
    findings: list[Finding] = []
    if wrong:
        text = f"{source}: {wrong} of {total} sentences are cut or have a wrong checksum; left out"
        findings.append(Finding("NMEA-CHECKSUM", text, topic))
    if unchecked:
        findings.append(
            Finding("NMEA-UNCHECKED", f"{source}: {unchecked} of {total} sentences have no checksum", topic)
        )
    if without:
        findings.append(Finding("NMEA-OTHER", f"{source}: {without} lines hold no NMEA sentence", topic))
    return findings


def undecoded_findings(undecoded: Mapping[str, int]) -> list[Finding]:
    """Report topics whose sentences do not have the fields of their kind."""
    what = "sentences do not have the fields of their type; left out"
    return [
        Finding("UNDECODED", f"{topic}: {count} {what}", topic, lost_data=True)
        for topic, count in undecoded.items()
        if count
    ]
