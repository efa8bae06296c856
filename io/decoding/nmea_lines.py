"""NMEA 0183 sentences in lines of text: where they begin and end, their checksums, and the times in and before them.

A line may hold several, and may begin with the time at which it was logged.
"""

import re
from collections.abc import Collection, Sequence
from functools import reduce
from typing import NamedTuple

from usbldr.io.decoding.nmea_kinds import SENTENCE_KINDS, UNKNOWN, VARIANTS
from usbldr.io.decoding.nmea_times import NO_TIME, date_ns, prefixed_clock_ns, prefixed_ns, time_of_day_ns
from usbldr.io.reader import Nanoseconds

SENTENCE = re.compile(r"[$!]([A-Z][A-Z0-9]{3,}),([^$*\r\n]*)(?:\*([0-9A-Fa-f]{2}))?")
TIME = r"(?:\d{9,}(?:\.\d*)?|[\d/T ,.-]*\d:\d\d:\d\d(?:[.,]\d*)?Z?)"  # s, ms, us, ns since 1970, or of the day
WORD_LINE = re.compile(
    rf"(?:(?<![\w.,:+-])|(?<=\d:)|^\W{{0,2}}{TIME}[,;]\s*(?=[A-Z]{{4,}},))"
    r"([A-Za-z]\w*),([^$*\r\n]*)(?:\*([0-9A-Fa-f]{2}))?\s*$"
)
"""A line that begins with a word in place of an address, perhaps behind a time and a count of its bytes, as instruments
send it: "USBLLONG,1600000000.5,2,", "+++AT:95:USBLLONG,"."""
NUMBER = re.compile(r"(?:^|,)\s*[+-]?\d*\.?\d+(?:[eE][+-]?\d+)?\s*(?:,|$)")
LOST = "\0" * 8  # zeros as of a lost sector of a disk; binary data between the sentences have fewer
CHECKSUM = re.compile(r"\*.?[0-9A-Fa-f]")  # more of them than sentences: the beginning of one was lost
SUBTYPE = re.compile(r"[A-Z_]{2,}")
"""First field of a vendor's sentence that is its type: $PIXSE,ATITUD."""
CRC8_POLYNOMIAL = 0x07  # fixed: of Water Linked's serial protocol


class FoundSentence(NamedTuple):
    """One sentence."""

    name: str
    kind: str  # its name without its talker; empty: a word that is no sentence, although one ends in it
    content: str
    checked: bool
    line: int
    logged: int  # NO_TIME if unknown
    clock: int  # time of day with which its line begins, NO_TIME without one
    time_of_day: int
    midnight: int
    has_fix: bool | None  # whether a receiver has a fix, and so the time; None: not stated

    @property
    def talker(self) -> str:
        """Who sent it: GP of GPGGA."""
        return self.name.removesuffix(self.kind)


def scan_lines(
    lines: Sequence[str], received_ns: Nanoseconds | None, form: re.Pattern[str], day_first: bool | None = None
) -> tuple[list[FoundSentence], list[int], int]:
    """Return the sentences, the lines of those with a wrong checksum or cut, and how many lines hold no sentence.

    ``day_first``: whether it is, in dates like 12/31/2025 before sentences.
    """
    found: list[FoundSentence] = []
    wrong: list[int] = []
    without, last = 0, NO_TIME
    addresses = {each[1] for line in lines for each in SENTENCE.finditer(line)} if form is SENTENCE else set[str]()
    for number, line in enumerate(lines):
        begin, count, cut = 0, len(found) + len(wrong), received_ns is None and not line.endswith("\n")
        matches, addressed = _in_line(line, form, addresses)
        for match in matches:
            name, body, checksum = match.groups()
            content = f"{name},{body}"
            prefix = line[begin : match.start(1)]
            logged = prefixed_ns(prefix, day_first) if received_ns is None else int(received_ns[number])
            clock = prefixed_clock_ns(prefix) if logged == NO_TIME else NO_TIME
            if name.startswith("P"):  # a vendor's name is all of it
                kind = name
            elif addressed:  # GPGGA is GGA of GP
                kind = name[2:]
            else:  # "HDG,1600000000.5,40" is no sentence, for it has no talker
                kind = "" if name in SENTENCE_KINDS else name
            if logged == NO_TIME and kind not in SENTENCE_KINDS and not addressed:  # "MODEM,1600000000.5,2"
                logged = prefixed_ns(body.partition(",")[0])
            last = logged if logged != NO_TIME else last
            begin = match.end()
            sentence_time = _sentence_time(kind, body.split(","))
            if sentence_time is None or not (_is_checksum(checksum, content.encode()) if checksum else not cut):
                wrong.append(number)
            else:
                full, *_ = sentence_time
                name = name.removesuffix(kind) + full
                times = last, clock, *sentence_time[1:]
                found.append(FoundSentence(name, full, content, bool(checksum), number, *times))
        torn = received_ns is None and (line.startswith("\0") or LOST in line or (cut and begin == 0))
        torn |= received_ns is None and len(CHECKSUM.findall(line)) > len(found) + len(wrong) - count
        wrong += [number] * torn
        without += begin == 0 and not torn and bool(line.strip())
    return found, wrong, without


def _in_line(line: str, form: re.Pattern[str], addresses: Collection[str]) -> tuple[list[re.Match[str]], bool]:
    """Return the sentences of a line, and whether they have an address; else it begins with a word."""
    if found := list(SENTENCE.finditer(line)):
        return found, True
    words = WORD_LINE.finditer(line) if form is WORD_LINE or addresses else ()
    return [word for word in words if form is WORD_LINE or _is_whole(word, addresses)], False


def _is_whole(word: re.Match[str], addresses: Collection[str]) -> bool:
    """Return whether a word among sentences with an address is not what is left of one.

    With a checksum it has small letters; without one it stands before numbers, and ends no address and no known kind.
    """
    name, body, checksum = word.groups()
    if checksum:
        return not name.isupper()
    left = name.startswith("P") or any(one.endswith(name) for one in (*addresses, *SENTENCE_KINDS))
    return NUMBER.search(body) is not None and not left and name[2:] not in SENTENCE_KINDS


def _is_checksum(digits: str, content: bytes) -> bool:
    """Return whether a checksum is that of NMEA 0183, or CRC-8."""
    stated = int(digits, 16)
    if stated == reduce(int.__xor__, content, 0):
        return True
    crc = 0
    for bit in (byte >> shift & 1 for byte in content for shift in range(7, -1, -1)):
        crc = (crc << 1 & 0xFF) ^ CRC8_POLYNOMIAL * (crc >> 7 ^ bit)
    return stated == crc


def _sentence_time(name: str, fields: Sequence[str]) -> tuple[str, int, int, bool | None] | None:
    """Return the kind's full name, time of day, midnight and fix of a sentence, None if it is cut."""
    try:
        full = name + VARIANTS.get(name, _subtype)(fields)
    except IndexError:
        return None
    kind = SENTENCE_KINDS.get(full, UNKNOWN)
    place, time = kind.time, NO_TIME
    if kind is UNKNOWN and name.startswith("P"):  # a vendor's may have its time, hhmmss.ss, first or behind its type
        place = next((k for k, one in enumerate(fields[:2]) if "." in one and time_of_day_ns(one) != NO_TIME), None)
    if place is not None and place < len(fields):
        time = time_of_day_ns(fields[place].rpartition(" ")[2])
    date = [fields[i].partition(" ")[0] for i in kind.date if i < len(fields)]
    midnight = date_ns(date) if time != NO_TIME and date and len(date) == len(kind.date) else NO_TIME
    return full, time, midnight, kind.has_fix(fields)


def _subtype(fields: Sequence[str]) -> str:
    return f"_{fields[0]}" if SUBTYPE.fullmatch(fields[0]) else ""
