"""Lines of JSON objects, and those of Water Linked's devices: a DVL's reports over TCP, a UGPS's positions over HTTP.

Sources: docs/dvl/dvl-json-protocol.md of waterlinked/docs, and the API of Underwater GPS. A line may begin with the
time at which it was logged. Else reports of velocities are timed by their transmission; what has no time of its own
takes that of the line before. Any other object is a topic by what it calls its topic, channel, type or sensor, or by
the topic or sensor before it, as mosquitto_sub prints it, or by the sensor that its file is named for. It is timed by a
field that is called a time, in any unit since 1970 or as a date; without any time they are taken as 1 s apart. An
object may fill several lines, and may hold several records with times of their own.
"""

import json
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, cast

import numpy as np

from usbldr.io.decoding.collected import CollectedRecords
from usbldr.io.decoding.columns import counted
from usbldr.io.decoding.decoders import DecoderSet, Stream, decode_blocks, json_decoder
from usbldr.io.decoding.nmea_times import NO_TIME, prefixed_ns
from usbldr.io.file_access.open_file import head_lines, is_damaged, text_lines
from usbldr.io.findings import Finding
from usbldr.io.instruments.records_log import RecordsLog, Topic
from usbldr.io.messages.field_names import named_column
from usbldr.io.messages.topic_names import suggested_sensors
from usbldr.io.reader import Records, name_of

REPORTS = ("velocity", "velocity_water", "position_local")
"""Reports of a DVL by their type."""
WATER_LINKED = (*REPORTS, "global", "acoustic")
FIRST_VERSION = {"time", "vx", "vy", "vz", "velocity_valid"}
"""Keys of a report of velocities of the first version of the format (json_v1), which has no type."""
FIRST_LINES = 20  # [lines] among which a report is looked for
OBJECT_LINES = 200  # [lines] of an object at most
SAMPLES = 20  # [messages] from which the fields are taken
COUNTED = "its reports state only the time since the one before; they begin at 1970-01-01; state date under [[file]]"
SET_LATER = "its clock was set later; until then its reports are timed from 1970-01-01 on, as since power-on"
REMAINS = re.compile(r"[\"}]")  # behind an object: of one that was damaged
LABELS = ("topic", "channel", "type", "sensor", "device", "source", "instrument")
"""Keys of an object whose text names its topic."""
GEOJSON = ("Feature", "FeatureCollection")  # types that name no topic
LABEL_BEFORE = re.compile(r"(?:^|\s)([A-Za-z/][\w/.-]*):?\s*$")
KEY = re.compile(r"\"\s*:")  # before an object: of the one around it, whose beginning was lost
DECODER = json.JSONDecoder()
LATEST_S = 4e9  # [s] the year 2096
EARLIEST_S = 1e9  # [s] the year 2001: an earlier time counts from power-on


def looks_like_json_lines(head: bytes) -> bool:
    """Return whether one of the first lines holds a report or a position of Water Linked's, or most any object.

    Or whether two objects fill several lines each: one may be the settings of something.
    """
    lines = head_lines(head)
    if sum("\n" in text for _, text in _joined(lines[:OBJECT_LINES])) > 1:
        return True
    kinds = [_kind(_first(line)) for line in lines[:FIRST_LINES]]
    return any(kind in WATER_LINKED for kind in kinds) or sum(map(bool, kinds)) > len(kinds) / 2


def json_lines_log(path: Path) -> RecordsLog:
    """Return the log of a text file of such lines; its topics are their kinds."""
    return RecordsLog(path, "JSON lines", _topics)


def _topics(file: Path, findings: list[Finding]) -> Iterator[Topic]:
    counter = DecoderSet(file)
    for kind, lines in _lines(file, findings).items():
        counter.add_topic()
        type_name = f"waterlinked/waterlinked_{kind}" if kind in WATER_LINKED else f"json/{kind.rpartition('/')[2]}"
        decoder = json_decoder(type_name, [text for _, text in lines[:SAMPLES]])
        times = np.array([time_ns for time_ns, _ in lines], dtype=np.int64)
        stream = Stream(f"/{kind}", type_name, "json", decoder, *counted(times))
        yield Topic(stream.info(), partial(_records, file, stream, lines, findings))


def _records(
    file: Path, stream: Stream, lines: Sequence[tuple[int, bytes]], findings: list[Finding], paths: Sequence[str]
) -> Records:
    key, unfit = (stream.topic, stream.type, 0), dict[str, Finding]()
    messages = ((key, time_ns, text) for time_ns, text in lines)
    whole = CollectedRecords(len(lines), paths)
    for _, block in decode_blocks(file, {key: stream}, {stream.topic: paths}, messages, unfit):
        whole.add(block)
    findings += unfit.values()
    return whole.whole()


def _lines(file: Path, findings: list[Finding]) -> Mapping[str, list[tuple[int, bytes]]]:
    """Return log time and text of each line by kind; append what is lost to the findings."""
    found: dict[str, list[tuple[int, bytes]]] = {}
    untimed, numbered, bad, first_bad, last, counted = 0, 0, 0, 0, NO_TIME, False
    for count, (number, before, text, value) in enumerate(_objects(text_lines(file)), start=1):
        if value is None or is_damaged(text):
            bad, first_bad = bad + 1, first_bad or number
            continue
        kind = _topic(value, before)
        kind = name_of(file.stem) if kind == "object" and suggested_sensors(file.stem) else kind
        if kind and kind not in WATER_LINKED and (records := list(_records_within(value))):
            for key, time_ns, record in records:
                name = name_of(key) if kind == "object" and suggested_sensors(key) else kind
                found.setdefault(name, []).append((time_ns, json.dumps(record).encode()))
            continue
        logged = prefixed_ns(before)
        last = logged if logged != NO_TIME else _own_time(value, last)
        if kind == "velocity" and logged == NO_TIME and _own_time(value, NO_TIME) == NO_TIME:
            since_ns = _since_last_ns(value)
            counted = counted or (since_ns > 0 and last == NO_TIME)
            last = _since_power_on_ns(value) or max(last, 0) + since_ns
        if kind in WATER_LINKED and last == NO_TIME:
            untimed += 1
        elif kind:
            numbered += last == NO_TIME
            time_ns = count * 1_000_000_000 if last == NO_TIME else last
            found.setdefault(kind, []).append((time_ns, text.encode()))
    if counted:
        set_later = last >= EARLIEST_S * 1e9
        findings.append(Finding("NO-DATE", f"{file.name}: {SET_LATER if set_later else COUNTED}"))
    if bad:
        text = f"{file.name}: {bad} lines are no JSON, the first is line {first_bad}; left out"
        findings.append(Finding("UNDECODED", text, lost_data=True))
    if untimed:
        text = f"{file.name}: {untimed} lines have no time; log them with one before each line"
        findings.append(Finding("UNDECODED", text, lost_data=True))
    if numbered:
        text = f"{file.name}: {numbered} objects have no time that is known; they are taken as 1 s apart"
        findings.append(Finding("NMEA-TIME", text))
    return found


def _records_within(value: Mapping[str, Any]) -> Iterator[tuple[str, int, Mapping[str, Any]]]:
    """Yield the records that an object collects, each with the key and the time that it has, and what all share.

    They are objects in arrays, or the elements of arrays of one length, of which one holds times.
    """
    arrays: dict[str, list[Any]] = {key: inner for key, inner in value.items() if isinstance(inner, list)}
    times = next(((key, found) for key, inner in arrays.items() if (found := _times_of(key, inner))), None)
    if times is not None:
        alike = {key: inner for key, inner in arrays.items() if len(inner) == len(times[1])}
        for k, time_ns in enumerate(times[1]):
            yield times[0], time_ns, {**value, **{key: inner[k] for key, inner in alike.items()}}
        return
    shared = {key: inner for key, inner in value.items() if key not in arrays}
    for key, inner in arrays.items():
        objects = [cast("dict[str, Any]", one) for one in inner if isinstance(one, dict)]
        found = [_own_time(one, NO_TIME) for one in objects]
        if NO_TIME not in found and len(objects) == len(inner):
            yield from ((key, time_ns, {**shared, **one}) for time_ns, one in zip(found, objects, strict=True))


def _times_of(name: str, values: Sequence[Any]) -> list[int]:
    """Return an array of times as nanoseconds, empty if it is none: one of seconds and nanoseconds goes back."""
    column = named_column(name) if len(values) > 1 else None
    if column is None or column.rule.key != "time":
        return []
    found = [prefixed_ns(str(one)) for one in values]
    return found if NO_TIME not in found and found == sorted(found) else []


def _joined(lines: Iterable[str]) -> Iterator[tuple[int, str]]:
    """Yield lines with their numbers; those of an object whose brackets have lines of their own as one.

    Objects within it are indented, so that the next one ends an object that is not closed.
    """
    held: list[str] = []
    number = 0
    for number, line in enumerate(lines, start=1):
        opens = line.strip("[, \t\r\n") == "{"
        if held and (len(held) == OBJECT_LINES or (opens and _indent(line) <= _indent(held[0]))):
            yield from enumerate(held, start=number - len(held))
            held = []
        if not held and not opens:
            yield number, line
            continue
        held.append(line)
        if line.lstrip().startswith("}") and _first(text := "\n".join(map(str.rstrip, held))) is not None:
            yield number - len(held) + 1, text
            held = []
    yield from enumerate(held, start=number - len(held) + 1)


def _indent(line: str) -> int:
    return len(line) - len(line.lstrip())


def _objects(lines: Iterable[str]) -> Iterator[tuple[int, str, str, Mapping[str, Any] | None]]:
    """Yield the line's number, what stands before an object, its text and the object; None for what is none.

    A line may hold several objects, as an array on one line does, and a remark behind them.
    """
    for number, line in _joined(lines):
        end, place = 0, line.find("{") if not KEY.search(line.partition("{")[0]) else -1
        if number == 1 and place >= 0 and (cut := _end_of_begun(line)):  # of a record whose beginning was lost
            yield number, "", line[:cut], None
            end, place = cut, line.find("{", cut)
        while place >= 0:
            try:
                value, behind = DECODER.raw_decode(line, place)
            except (ValueError, RecursionError):
                break
            if end and REMAINS.search(line[end:place]):
                yield number, "", line[end:place], None
            yield number, line[end:place], line[place:behind], value
            end, place = behind, line.find("{", behind)
        rest = line[end:].strip("[], \r\n\t")
        if rest and (not end or place >= 0 or is_damaged(rest) or REMAINS.search(rest)):
            yield number, "", rest, None


def _end_of_begun(line: str) -> int:
    """Return the length of a line up to the last bracket that closes an object from before it, 0 if none does."""
    depth = least = end = 0
    for place, character in enumerate(line):
        depth += (character == "{") - (character == "}")
        if depth < least:
            least, end = depth, place + 1
    return end


def _first(line: str) -> Mapping[str, Any] | None:
    """Return the object that ends a line, or with which it begins; None if there is none: else it is within a cell."""
    _, before, text, value = next(_objects([line]), (0, "", "", None))
    return value if line.rstrip().endswith(text) or not before.strip("[ ") else None


def _topic(value: Mapping[str, Any], before: str) -> str:
    """Return what an object is, or the topic that it or what stands before it names, unless it is a DVL's report."""
    kind = _kind(value)
    if kind in REPORTS or not kind:
        return kind
    labels = [label for key in LABELS if isinstance(label := value.get(key), str) and label not in ("", *GEOJSON)]
    found = LABEL_BEFORE.search(before)
    if not labels and found and ("/" in found[1] or suggested_sensors(found[1])):
        labels = [found[1]]
    return name_of(labels[0].strip("/")) if labels and labels[0].strip("/") else kind


def _kind(value: Mapping[str, Any] | None) -> str:
    """Return what an object is: a DVL's report or a UGPS's position, else its type; empty for a response.

    Reports of the first version have no type.
    """
    if value is None or value.get("type") == "response":
        return ""
    if value.get("type") in REPORTS:
        return str(value["type"])
    if "type" not in value and value.keys() >= FIRST_VERSION:
        return "velocity"
    if "lat" in value and "lon" in value:
        return "global"
    if {"x", "y", "z", "position_valid"} <= value.keys():
        return "acoustic"
    kind = value.get("type")
    return name_of(kind) if isinstance(kind, str) and kind not in ("", *GEOJSON) else "object"


def _since_last_ns(value: Mapping[str, Any]) -> int:
    """Return the time since the report before, which a report of velocities states in ms, as nanoseconds."""
    since_ms = value.get("time")
    return round(since_ms * 1e6) if isinstance(since_ms, int | float) and 0 < since_ms < LATEST_S else 0


def _since_power_on_ns(value: Mapping[str, Any]) -> int:
    """Return the time since power-on that a report states before its clock is set, 0 if it does not."""
    sent_us = value.get("time_of_transmission", value.get("time_of_validity"))
    return sent_us * 1000 if isinstance(sent_us, int) and 0 < sent_us <= EARLIEST_S * 1e6 else 0


def _own_time(value: Mapping[str, Any], last: int) -> int:
    """Return the time that a report states in nanoseconds since 1970, else that of the line before."""
    sent_us, seconds = value.get("time_of_transmission", value.get("time_of_validity")), value.get("ts")
    if isinstance(sent_us, int) and EARLIEST_S * 1e6 < sent_us < LATEST_S * 1e6:
        return sent_us * 1000
    if isinstance(seconds, int | float) and EARLIEST_S < seconds < LATEST_S:
        return round(seconds * 1e6) * 1000  # microseconds: a float has no more
    if _kind(value) in REPORTS:
        return last  # their "time" is that since the report before
    within = [cast("dict[str, Any]", inner) for inner in value.values() if isinstance(inner, dict)]
    stated = [pair for one in (value, *within) for pair in one.items()]
    named = (text for name, text in stated if (column := named_column(name)) and column.rule.key == "time")
    return next((time_ns for text in named if (time_ns := prefixed_ns(str(text))) != NO_TIME), last)
