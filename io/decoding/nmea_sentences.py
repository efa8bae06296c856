"""NMEA 0183 sentences of a source as topics: those of its lines (nmea_lines), timed and sorted by kind.

nmea_kinds lists the sentences that are understood; nmea_times finds their times of validity. The fields of any sentence
are named by their numbers, "1" behind the name, and "VX=0.5" also by its tag.
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from usbldr.io.decoding.date_order import date_orders
from usbldr.io.decoding.nmea_kinds import SENTENCE_KINDS, UNKNOWN, SentenceValues, decode_sentences
from usbldr.io.decoding.nmea_lines import SENTENCE, FoundSentence, scan_lines
from usbldr.io.decoding.nmea_times import (
    DAY,
    NO_TIME,
    SECOND,
    SLASHED,
    on_nearest_date,
    prefixed_ns,
    time_of_day_ns,
    times_from_sentences,
)
from usbldr.io.findings import Finding
from usbldr.io.reader import TIME_OF_DAY, Column, Nanoseconds, Records, TopicInfo

TAGGED = re.compile(r"([A-Za-z]\w*)=(.*)")
SAMPLE = 20  # [sentences] from which the fields of a kind are taken
DATE_END = 40  # [letters] of a line in which the date before a sentence stands
FEW = 20  # [sentences] that may be logged at one time: a short file
SAME_CLOCK_NS = 60 * SECOND  # [ns] between a computer's clock and UTC, by judgement: farther apart is a time zone
MOVE_CLOCK = "correct it by clock_offset_s under [[file]]"
SATELLITES = frozenset(("GP", "GN", "GL", "GA", "GB", "BD", "GQ", "GI"))
"""Talkers by which a receiver says whose satellites it used: fixed by NMEA 0183."""
PREFERRED = {"RMC": "GGA", "GLL": "GGA", "GNS": "GGA"}
"""Sentences that repeat the position of another, which is used if both are present."""


@dataclass(frozen=True, slots=True)
class Sentences:
    """Sentences of one kind."""

    kind: str  # of SENTENCE_KINDS, or another
    contents: Sequence[str]  # from the name to the checksum, without it
    received_ns: Nanoseconds  # (n,)
    stamp_ns: Nanoseconds | None  # (n,) None if neither they nor their messages hold any
    preferred: bool  # whether no other sentence of the source is used for their position

    def info(self, topic: str) -> TopicInfo:
        """Return the topic for the user; without a position if that of another sentence is used."""
        known = SENTENCE_KINDS.get(self.kind, UNKNOWN)
        stamped = ("header.stamp",) if self.stamp_ns is not None else ()
        return TopicInfo(
            name=topic,
            type=f"nmea/{self.kind or 'word'}",
            encoding="nmea",
            count=len(self.contents),
            first_ns=int(self.received_ns.min()),
            last_ns=int(self.received_ns.max()),
            fields=(*stamped, *(known.columns if self.preferred else ()), *self._numbered),
        )

    @property
    def _numbered(self) -> Sequence[str]:
        """The fields by their numbers, and by their tags; those that hold hhmmss.ss also as times of the day."""
        some = self.contents[:: -(-len(self.contents) // SAMPLE)]
        rows = [content.split(",")[1:] for content in some]
        tags = dict.fromkeys(found[1] for row in rows for field in row if (found := TAGGED.fullmatch(field)))
        names = [*map(str, range(1, max(map(len, rows)) + 1)), *tags]
        clocks = [name for name in names if NO_TIME not in (time_of_day_ns(_field(one, name)) for one in some)]
        return (*names, *(name + TIME_OF_DAY for name in clocks))

    def records(self, paths: Sequence[str]) -> tuple[Records, int]:
        """Return the wanted columns, and how many sentences do not match their kind."""
        known = SENTENCE_KINDS.get(self.kind, UNKNOWN)
        rows: Sequence[SentenceValues | None] = [()] * len(self.contents)
        if set(known.columns) & set(paths):
            rows = decode_sentences(self.kind, self.contents)
        order = [i for i, row in enumerate(rows) if row is not None]
        decoded = [row for row in rows if row is not None]
        columns: dict[str, Column] = {}
        for path in paths:
            if path == "header.stamp" and self.stamp_ns is not None:
                columns[path] = self.stamp_ns[order]
            elif path in known.columns:
                place = [*known.columns].index(path)
                columns[path] = np.array([row[place] for row in decoded])
            elif path.endswith(TIME_OF_DAY):
                own = [time_of_day_ns(_field(self.contents[i], path.removesuffix(TIME_OF_DAY))) for i in order]
                times_ns = on_nearest_date(np.array(own, dtype=np.int64), self.received_ns[order])
                columns[path] = np.where(times_ns == NO_TIME, 0, times_ns)  # 0: unset
            else:
                columns[path] = _numbers_or_texts([_field(self.contents[i], path) for i in order])
        return Records(self.received_ns[order], columns), len(rows) - len(order)


class SentenceSet(NamedTuple):
    """All sentences of one source, by name: "GPGGA", "PSIMSSB_C_H"."""

    by_name: Mapping[str, Sentences]
    findings: tuple[Finding, ...]


def _field(content: str, path: str) -> str:
    """Return a field of a sentence by its number or its tag, empty if there is none."""
    fields = content.split(",")
    if not path.isdecimal():
        return next((field[len(path) + 1 :] for field in fields if field.startswith(f"{path}=")), "")
    field = fields[int(path)] if int(path) < len(fields) else ""
    tagged = TAGGED.fullmatch(field)
    return tagged[2] if tagged else field


def _numbers_or_texts(cells: Sequence[str]) -> Column:
    """Return cells as whole numbers, else as numbers (NaN if empty), else as texts."""
    for kind in (np.int64, np.float64):
        with suppress(ValueError, OverflowError):
            return np.array([cell.strip() or ("nan" if kind is np.float64 else "") for cell in cells]).astype(kind)
    return np.array(cells)


def find_sentences(
    source: str,
    lines: Iterable[str],
    received_ns: Nanoseconds | None = None,
    stamp_ns: Nanoseconds | None = None,
    form: re.Pattern[str] = SENTENCE,
) -> SentenceSet:
    """Find the sentences in lines of text, check their checksums and time them; ``form``: SENTENCE or WORD_LINE.

    ``received_ns`` and ``stamp_ns`` (n,) are those of the lines; without them the beginnings of the lines are used.
    """
    lines = list(lines)
    dates = [found[0] for line in lines if (found := SLASHED.search(line, 0, DATE_END))] if received_ns is None else []
    order = date_orders([dates]).get("/")
    found, wrong, without = scan_lines(lines, received_ns, form, order and order.day_first)
    checked = {row.name for row in found if row.checked}
    rows = [row for row in found if row.checked or row.name not in checked]  # those without checksum are cut
    topic = "" if received_ns is None else source  # a file is none
    bare = [row for row in found if not row.checked and row.name in checked]
    findings = _counted(source, topic, rows, wrong, bare, without)
    findings += [order.finding(source, MOVE_CLOCK)] if order and order.example else []
    if not rows:
        return SentenceSet({}, tuple(findings))
    rows, joined = _of_one_receiver(source, topic, rows)
    time, midnight = _receiver_times(rows)
    logged, clock = (np.array([getattr(row, name) for row in rows]) for name in ("logged", "clock"))
    if received_ns is None and len(rows) >= FEW and np.all(logged == logged[0]):
        logged = np.full(len(rows), NO_TIME)  # a number that stays the same is none
    received, more = _received(source, logged, clock, time, midnight, [row.content for row in rows])
    own = np.where(midnight != NO_TIME, midnight + time, on_nearest_date(time, received))
    by_name: dict[str, Sentences] = {}
    names = dict.fromkeys(row.name for row in rows)
    for name in names:
        indices = [i for i, row in enumerate(rows) if row.name == name]
        kind, arrived = rows[indices[0]].kind, received[indices]
        stamps = stamp_ns[[rows[i].line for i in indices]] if stamp_ns is not None else None
        if SENTENCE_KINDS.get(kind, UNKNOWN).time is not None:
            stamps = np.where(time[indices] == NO_TIME, arrived if stamps is None else stamps, own[indices])
        preferred = kind not in PREFERRED or name.removesuffix(kind) + PREFERRED[kind] not in names
        by_name[name] = Sentences(kind, [rows[i].content for i in indices], arrived, stamps, preferred)
    return SentenceSet(by_name, (*findings, *joined, *more))


def _of_one_receiver(
    source: str, topic: str, rows: Sequence[FoundSentence]
) -> tuple[Sequence[FoundSentence], list[Finding]]:
    """Give one talker to a receiver whose talker changes with its satellites: none of its times is stated twice."""
    epochs: dict[str, set[tuple[str, int]]] = {}
    for row in rows:
        if row.talker in SATELLITES and row.time_of_day != NO_TIME:
            epochs.setdefault(row.talker, set()).add((row.kind, row.time_of_day))
    kinds = [kind for stated in epochs.values() for kind in {kind for kind, _ in stated}]
    several = len(kinds) > len(set(kinds))
    if not several or len(set[tuple[str, int]]().union(*epochs.values())) < sum(map(len, epochs.values())):
        return rows, []
    first = next(iter(epochs))
    text = f"{source}: {', '.join(epochs)} are taken for one receiver, which is called {first}: their times all differ"
    renamed = [row._replace(name=first + row.kind) if row.talker in epochs else row for row in rows]
    return renamed, [Finding("NMEA-TALKERS", text, topic)]


def _receiver_times(rows: Sequence[FoundSentence]) -> tuple[Nanoseconds, Nanoseconds]:
    """Return times of day and midnights (n,), NO_TIME while the receiver has no fix: its clock is not set.

    A sentence that does not say has the fix of the last one of its receiver that does, the first ones that of the
    first. If no receiver ever has one, the times of day remain.
    """
    fixed = {row.talker: row.has_fix for row in reversed(rows) if row.has_fix is not None}
    known = np.empty(len(rows), dtype=np.bool_)
    for i, row in enumerate(rows):
        if row.has_fix is not None:
            fixed[row.talker] = row.has_fix
        known[i] = not row.talker or fixed.get(row.talker, True)
    time, midnight = (np.array([getattr(row, name) for row in rows]) for name in ("time_of_day", "midnight"))
    midnight = np.where(known, midnight, NO_TIME)
    return np.where(known, time, NO_TIME) if np.any(time[known] != NO_TIME) else time, midnight


def _received(
    source: str,
    logged: Nanoseconds,
    clock: Nanoseconds,
    time: Nanoseconds,
    midnight: Nanoseconds,
    contents: Sequence[str],
) -> tuple[Nanoseconds, list[Finding]]:
    """Return the log times (n,): if no line holds any, those from the sentences, else from the times of day before.

    These come first if each line has one, and they are those of the sentences' clock. Without a date the first one is
    taken that a sentence begins with as seconds since 1970, as those of PNORBT7 do.
    """
    known = logged != NO_TIME
    if known.any():
        return np.where(known, logged, logged[known][0]), []
    both = (time != NO_TIME) & (clock != NO_TIME)
    of_sentences = bool(np.any(time != NO_TIME))
    if both.any() and np.all(clock != NO_TIME):
        apart_ns = np.median(((clock - time)[both] + DAY // 2) % DAY - DAY // 2)
        of_sentences = bool(abs(apart_ns) > SAME_CLOCK_NS)
    try:
        received, dated = times_from_sentences(time if of_sentences else clock, midnight)
    except ValueError:
        text = f"{source}: neither its lines nor its sentences contain a time; they are taken as 1 s apart"
        return np.arange(len(logged), dtype=np.int64) * 1_000_000_000, [Finding("NMEA-TIME", text)]
    by_sentences = "lines without log time: sentences are timed by the time they contain, the others evenly between"
    text = by_sentences if of_sentences else "lines are timed by the time of day before them"
    findings = [Finding("NMEA-TIME", f"{source}: {text}")]
    stated = ((k, prefixed_ns(content.split(",")[1])) for k, content in enumerate(contents)) if not dated else ()
    if first := next(((k, stated_ns) for k, stated_ns in stated if stated_ns != NO_TIME), None):
        row, stated_ns = first
        received = received + on_nearest_date(received[row : row + 1] % DAY, np.array([stated_ns])) - received[row]
        name = contents[row].partition(",")[0]
        findings.append(Finding("NMEA-DATE", f"{source}: the only date is that of {name}'s seconds since 1970"))
    elif not dated:
        text = f"{source}: no sentence contains a date; the first day is taken as 1970-01-01; state date under [[file]]"
        findings.append(Finding("NMEA-DATE", text))
    return received, findings


def _counted(
    source: str,
    topic: str,
    rows: Sequence[FoundSentence],
    wrong: Sequence[int],
    bare: Sequence[FoundSentence],
    without: int,
) -> list[Finding]:
    total, unchecked = len(rows) + len(wrong) + len(bare), sum(not row.checked for row in rows)
    findings: list[Finding] = []
    if wrong:
        text = f"{source}: {len(wrong)} of {total} sentences are cut or have a wrong checksum"
        text += f", the first in {'message' if topic else 'line'} {min(wrong) + 1}; left out"
        findings.append(Finding("NMEA-CHECKSUM", text, topic, lost_data=True))
    if bare:
        text = f"{source}: {len(bare)} of {total} sentences have no checksum, while others of their name have one"
        text += f" ({bare[0].name} in {'message' if topic else 'line'} {bare[0].line + 1}): they may be cut; left out"
        findings.append(Finding("NMEA-CHECKSUM", text, topic, lost_data=True))
    if unchecked:
        findings.append(
            Finding("NMEA-UNCHECKED", f"{source}: {unchecked} of {total} sentences have no checksum", topic)
        )
    if without:
        findings.append(Finding("NMEA-OTHER", f"{source}: {without} lines hold no NMEA sentence", topic))
    return findings
