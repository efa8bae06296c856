"""Logs of MOOS (.alog): text lines of a time, a variable, the application that posted it, and its value.

Source: MOOS-IvP's documentation of pLogger and of the alog tools (oceanai.mit.edu/ivpman). A topic is an application,
and its fields are the variables that hold numbers: those that it posts together make a record. The text "X=1.5,Y=2" of
a variable holds the fields VARIABLE.X and VARIABLE.Y.
"""

import re
from array import array
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np

from usbldr.filters.errors import LogError
from usbldr.io.decoding.columns import counted
from usbldr.io.decoding.decoders import LOG_FIELDS, DecoderSet
from usbldr.io.file_access.open_file import cut_line, head_lines, is_damaged, text_lines
from usbldr.io.findings import Finding
from usbldr.io.instruments.records_log import RecordsLog, Topic
from usbldr.io.limits import RAISE, limit
from usbldr.io.reader import MAX_TIME_NS, Records, TopicInfo, name_of

START = re.compile(r"%%\s*LOGSTART\s+([\d.]+)")
TOGETHER_NS = 10_000_000  # [ns] between the first and the last value of a record; sensors report at up to 50 Hz
STEP_NS = 1_000_000_000  # a step back by more is the clock's; one by less is the order of writing
WORDS = {"true": 1.0, "false": 0.0}
PAIR = re.compile(r"(?:^|,)\s*([A-Za-z_]\w*)\s*=\s*([^,]+)", re.ASCII)  # of a text: a name and its value
MARK = re.compile(r"[DS]:")  # of numbers and texts, if the log marks types


@dataclass(slots=True)
class Postings:
    """The numbers that an application posted."""

    times_ns: "array[int]" = field(default_factory=lambda: array("q"))
    variables: "array[int]" = field(default_factory=lambda: array("i"))  # places in names
    values: "array[float]" = field(default_factory=lambda: array("d"))
    names: dict[str, int] = field(default_factory=dict[str, int])
    texts: Counter[str] = field(default_factory=Counter[str])  # variable -> how often it held a text


def looks_like_alog(head: bytes) -> bool:
    """Return whether a file begins with the comments of pLogger."""
    lines = head_lines(head)
    return any(line.startswith("%%") and START.search(line) for line in lines)


def alog_log(path: Path) -> RecordsLog:
    """Return a log of MOOS; a record of all variables is counted by the one that is posted most often."""
    return RecordsLog(path, "MOOS log", _topics)


def _topics(file: Path, findings: list[Finding]) -> Iterator[Topic]:
    def records(topic: str, postings: Postings, paths: Sequence[str]) -> Records:
        for path in paths:
            if count := postings.texts[path]:
                text = f"{topic}: {count} values of {path} are no numbers; left out"
                findings.append(Finding("UNDECODED", text, topic, lost_data=True))
        return _records(postings, paths)

    for source, postings in _postings(file, findings).items():
        topic = f"/{name_of(source)}"
        yield Topic(_info(topic, postings), partial(records, topic, postings))


def _postings(file: Path, findings: list[Finding]) -> Mapping[str, Postings]:
    """Return the numbers by application; append what is lost to the findings."""
    found: dict[str, Postings] = {}
    counter, variables, start_ns, bad, first_bad, cut = DecoderSet(file), 0, 0, 0, 0, 0
    for number, line in enumerate(text_lines(file), start=1):
        if not line.endswith("\n"):
            cut = number
            continue
        if line.startswith("%") or not line.strip():
            start = START.match(line)
            start_ns = _nanoseconds(start[1]) or start_ns if start else start_ns
            continue
        cells = line.split(None, 3)
        time_ns = _nanoseconds(cells[0])
        if len(cells) < 3 or time_ns is None or is_damaged(line):
            bad, first_bad = bad + 1, first_bad or number
            continue
        _, variable, source, value = *cells[:3], cells[3].strip() if len(cells) > 3 else ""
        source = source.partition(":")[0]
        if source not in found:
            counter.add_topic()
            found[source] = Postings()
        time_ns += start_ns if time_ns < start_ns else 0
        variables += _add(found[source], time_ns, variable, value)
        if variables > limit(LOG_FIELDS):
            raise LogError(f"has more than {limit(LOG_FIELDS)} variables; {RAISE}", path=file)
    if bad:
        text = f"{file.name}: {bad} lines have no time, variable and source, the first is line {first_bad}; left out"
        findings.append(Finding("UNDECODED", text, lost_data=True))
    findings += cut_line(file, cut)
    return found


def _nanoseconds(text: str) -> int | None:
    """Return seconds as nanoseconds, None if the text is no number of a possible time."""
    try:
        whole, _, decimals = text.partition(".")
        sign = -1 if whole.startswith("-") else 1
        time_ns = int(whole) * 1_000_000_000 + sign * int(decimals[:9].ljust(9, "0"))
    except ValueError:
        return None
    return time_ns if abs(time_ns) < MAX_TIME_NS else None


def _add(postings: Postings, time_ns: int, variable: str, value: str) -> int:
    """Add the numbers of a posting; return how many of their variables are new."""
    before = len(postings.names)
    value = value[2:] if MARK.match(value) else value
    whole = _number(value)
    if whole is None:
        postings.texts[variable] += 1
    for name, number in _parts(variable, value) if whole is None else [(variable, whole)]:
        postings.times_ns.append(time_ns)
        postings.variables.append(postings.names.setdefault(name, len(postings.names)))
        postings.values.append(number)
    return len(postings.names) - before


def _number(text: str) -> float | None:
    """Return a number, true as 1 and false as 0; None if the text is another."""
    try:
        return WORDS[text.lower()] if text.lower() in WORDS else float(text)
    except ValueError:
        return None


def _parts(variable: str, text: str) -> Iterator[tuple[str, float]]:
    """Yield the numbers in a text of names and values; of a name that comes twice the first, as MOOS-IvP reads it."""
    first = dict(reversed(PAIR.findall(text)))
    for name in reversed(first):
        number = _number(first[name].strip())
        if number is not None:
            yield f"{variable}.{name}", number


def _info(topic: str, postings: Postings) -> TopicInfo:
    kind = f"moos{topic}"
    counts = np.bincount(np.array(postings.variables, dtype=np.int64), minlength=len(postings.names)).tolist()
    fields = tuple(name for name, place in postings.names.items() if counts[place] > postings.texts[name])
    if not fields:
        return TopicInfo(topic, kind, "moos", 0, None, None, problem="its variables hold no numbers")
    kept = np.isin(np.array(postings.variables), [postings.names[name] for name in fields])
    times = np.array(postings.times_ns)[kept]
    most = int(np.bincount(np.array(postings.variables)[kept]).max())
    return TopicInfo(topic, kind, "moos", most, *counted(times)[1:], fields)


def _records(postings: Postings, paths: Sequence[str]) -> Records:
    """Return the records of some variables: each has the values that were posted together, NaN for the others."""
    places = {postings.names[path]: k for k, path in enumerate(dict.fromkeys(paths))}
    times, variables = np.array(postings.times_ns, dtype=np.int64), np.array(postings.variables)
    kept = np.flatnonzero(np.isin(variables, list(places)))
    again = np.cumsum(np.diff(times[kept], prepend=times[kept][:1]) < -STEP_NS)  # a clock that goes back
    kept = kept[np.lexsort((times[kept], again))]
    values = np.array(postings.values)[kept]
    starts: list[int] = []
    rows: list[int] = []
    present: set[int] = set()
    for time_ns, variable in zip(times[kept].tolist(), variables[kept].tolist(), strict=True):
        if not starts or abs(time_ns - starts[-1]) > TOGETHER_NS or variable in present:
            starts.append(time_ns)
            present = set()
        present.add(variable)
        rows.append(len(starts) - 1)
    table = np.full((len(places), len(starts)), np.nan)
    table[[places[variable] for variable in variables[kept].tolist()], rows] = values
    columns = {path: table[places[postings.names[path]]] for path in paths}
    return Records(np.array(starts, dtype=np.int64), columns)
