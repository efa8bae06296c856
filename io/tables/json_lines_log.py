"""Lines of JSON objects, and those of Water Linked's devices: a DVL's reports over TCP, a UGPS's positions over HTTP.

Sources: docs/dvl/dvl-json-protocol.md of waterlinked/docs, and the API of Underwater GPS. A line may begin with the
time at which it was logged. Else reports of velocities are timed by their transmission; what has no time of its own
takes that of the line before. Any other object is a topic by what it calls its topic, channel, type or sensor, or by
the topic or sensor before it, as mosquitto_sub prints it, or by the sensor that its file is named for. It is timed by a
field that is called a time, which is read as a column of times is; without any, objects are taken as 1 s apart. An
object may fill several lines, and may hold several records with times of their own, as a file that is one value does.
"""

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias, cast

import numpy as np

from usbldr.io.decoding.collected import CollectedRecords
from usbldr.io.decoding.columns import counted
from usbldr.io.decoding.decoders import DecoderSet, Stream, decode_blocks, json_decoder
from usbldr.io.decoding.json_messages import time_names
from usbldr.io.decoding.nmea_times import NO_TIME, prefixed_ns
from usbldr.io.file_access.open_file import head_lines, is_damaged
from usbldr.io.findings import Finding
from usbldr.io.instruments.records_log import RecordsLog, Topic
from usbldr.io.limits import UnpackingBudget
from usbldr.io.messages.field_names import RULES, NamedColumn, named_column
from usbldr.io.messages.topic_names import suggested_sensors
from usbldr.io.reader import Nanoseconds, Records, name_of
from usbldr.io.tables.cells import times
from usbldr.io.tables.date_times import foreign_time, orders_of, with_iso_times
from usbldr.io.tables.json_objects import COMMENTS, OBJECT_LINES, first_object, joined, objects_of, whole_value
from usbldr.io.tables.time_columns import ISO, SECOND_NS, TimeColumn, dated_columns, time_column, time_fault
from usbldr.io.tables.topic_sheets import time_findings
from usbldr.io.tables.unnamed_columns import is_number
from usbldr.io.units import named_unit

REPORTS = ("velocity", "velocity_water", "position_local")
"""Reports of a DVL by their type."""
WATER_LINKED = (*REPORTS, "global", "acoustic")
FIRST_VERSION = {"time", "vx", "vy", "vz", "velocity_valid"}
"""Keys of a report of velocities of the first version of the format (json_v1), which has no type."""
OF_UGPS = {"orientation", "cog", "sog", "fix_quality", "numsats", "hdop"}
"""Keys of a position of Underwater GPS, besides latitude and longitude."""
FIRST_LINES = 20  # [lines] among which a report is looked for
LEVELS = 8  # of objects in objects in which records are looked for
SAMPLES = 20  # [messages] from which the fields are taken
COUNTED = "its reports state only the time since the one before; they begin at 1970-01-01; state date under [[file]]"
SET_LATER = "its clock was set later; until then its reports are timed from 1970-01-01 on, as since power-on"
LABELS = ("topic", "channel", "type", "sensor", "device", "source", "instrument")
"""Keys of an object whose text names its topic."""
GEOJSON = ("Feature", "FeatureCollection")  # types that name no topic
LABEL_BEFORE = re.compile(r"(?:^|\s)([A-Za-z/][\w/.-]*):?\s*$")
LATEST_S = 4e9  # [s] the year 2096
EARLIEST_S = 1e9  # [s] the year 2001: an earlier time counts from power-on


def looks_like_json_lines(head: bytes) -> bool:
    """Return whether one of the first lines holds a report or a position of Water Linked's, or most any object.

    Or whether two objects fill several lines each: one may be the settings of something.
    """
    lines = [line for line in head_lines(head) if not line.lstrip().startswith(COMMENTS)]
    if sum("\n" in text for _, text in joined(lines[:OBJECT_LINES])) > 1:
        return True
    kinds = [_kind(first_object(line)) for line in lines[:FIRST_LINES]]
    return any(kind in WATER_LINKED for kind in kinds) or sum(map(bool, kinds)) > len(kinds) / 2


def json_lines_log(path: Path, head: bytes) -> RecordsLog | None:
    """Return the log of a text file of such objects, whose topics are their kinds; None if it holds none.

    Of a file that is one value, the objects within it are records.
    """
    holds = looks_like_json_lines(head)
    if not holds and (whole := whole_value(path)) is not None:
        holds = isinstance(whole, list) or bool(_records_within(whole))
    return RecordsLog(path, "JSON lines", _topics) if holds else None


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


Record: TypeAlias = tuple[str, Mapping[str, str], Mapping[str, Any]]
"""The key that holds it, its fields that are called times, and all of them."""


class _Row(NamedTuple):
    """An object, or a record within one."""

    place: int  # in the file
    time_ns: int  # logged before it, or a report's own; NO_TIME: as its fields say
    cells: Mapping[str, str]  # its fields that are called times
    text: bytes


def _lines(file: Path, findings: list[Finding]) -> Mapping[str, list[tuple[int, bytes]]]:
    """Return log time and text of each object by kind; append what is lost to the findings."""
    found: dict[str, list[_Row]] = {}
    budget = UnpackingBudget(file, file.stat().st_size)
    untimed, bad, first_bad, last, place, counted = 0, 0, 0, NO_TIME, 0, False
    for number, before, text, value in objects_of(file):
        if value is None or is_damaged(text):
            bad, first_bad = bad + 1, first_bad or number
            continue
        kind = _topic(value, before)
        kind = name_of(file.stem) if kind == "object" and suggested_sensors(file.stem) else kind
        logged = prefixed_ns(before)
        if kind and kind not in WATER_LINKED:
            last = logged if logged != NO_TIME else last
            own = {} if logged != NO_TIME else _times_in(value)
            for key, cells, record in _records_within(value) or [("", own, value)]:
                place, name = place + 1, name_of(key) if kind == "object" and suggested_sensors(key) else kind
                data = text if record is value else json.dumps(record)
                budget.take_bytes(0 if record is value else len(data))  # what all share is in each
                found.setdefault(name, []).append(_Row(place, logged if not cells else NO_TIME, cells, data.encode()))
            continue
        place, last = place + 1, logged if logged != NO_TIME else _own_time(value, last)
        if kind == "velocity" and logged == NO_TIME and _own_time(value, NO_TIME) == NO_TIME:
            since_ns = _since_last_ns(value)
            counted = counted or (since_ns > 0 and last == NO_TIME)
            last = _since_power_on_ns(value) or max(last, 0) + since_ns
        if kind and last == NO_TIME:
            untimed += 1
        elif kind:
            found.setdefault(kind, []).append(_Row(place, last, {}, text.encode()))
    if counted:
        set_later = last >= EARLIEST_S * 1e9
        findings.append(Finding("NO-DATE", f"{file.name}: {SET_LATER if set_later else COUNTED}"))
    if bad:
        text = f"{file.name}: {bad} lines are no JSON, the first is line {first_bad}; left out"
        findings.append(Finding("UNDECODED", text, lost_data=True))
    if untimed:
        text = f"{file.name}: {untimed} lines have no time; log them with one before each line"
        findings.append(Finding("UNDECODED", text, lost_data=True))
    return _timed(file, found, findings)


def _timed(
    file: Path, found: Mapping[str, list[_Row]], findings: list[Finding]
) -> Mapping[str, list[tuple[int, bytes]]]:
    """Return the objects with their times; those without one have that of the object before, else are 1 s apart."""
    of_kind = {kind: _own_times(file, kind, rows, findings) for kind, rows in found.items()}
    places = np.array([row.place for rows in found.values() for row in rows], dtype=np.int64)
    times = np.concatenate([*of_kind.values(), np.empty(0, np.int64)])
    order = np.argsort(places)
    known = times[order] != NO_TIME
    before = np.maximum.accumulate(np.where(known, np.arange(len(order)), -1))
    times[order] = np.where(before < 0, places[order] * SECOND_NS, times[order][before])
    if numbered := int(np.sum(before < 0)):
        text = f"{file.name}: {numbered} objects have no time that is known; they are taken as 1 s apart"
        findings.append(Finding("NMEA-TIME", text))
    rest = iter(times.tolist())
    return {kind: [(next(rest), row.text) for row in rows] for kind, rows in found.items()}


def _own_times(file: Path, kind: str, rows: Sequence[_Row], findings: list[Finding]) -> Nanoseconds:
    """Return the times of objects (n,), those of their fields as a table's column is read; NO_TIME if there is none."""
    known = np.array([row.time_ns for row in rows], dtype=np.int64)
    names = list(dict.fromkeys(name for row in rows[:SAMPLES] for name in row.cells))
    if not names:
        return known
    cells = {name: [row.cells.get(name, "") for row in rows] for name in names}
    orders = orders_of([cells], {})
    iso = with_iso_times(cells, orders=orders)
    first = {name: next(filter(None, iso[name]), "") for name in names}
    column = dated_columns(first, [NamedColumn(one, RULES[0], named_unit(one)) for one in names])[0]
    unknown = time_fault([column], [], first)
    clock = TimeColumn(column.name, SECOND_NS) if unknown else time_column(column, first)
    found = [*time_findings(file.name, orders, {file.name: first[column.name]})]
    if unknown and is_number(first[column.name]):
        found.append(Finding("NMEA-TIME", f"{file.name}: the unit of {column.name} is not known; taken as seconds"))
    findings += [one for one in found if one not in findings]
    parsed = times(iso[column.name], *clock)
    faults = {row: text for row, text in parsed.faults.items() if iso[column.name][row]}
    if faults:
        text = f"/{kind}: {len(faults)} of {len(rows)} objects have a time that cannot be read: {faults[min(faults)]}"
        findings.append(Finding("UNDECODED", text, f"/{kind}", lost_data=True))
    good = ~np.isin(np.arange(len(rows)), list(parsed.faults))
    return np.where((known == NO_TIME) & good, parsed.values.astype(np.int64), known)


def _times_in(value: Mapping[str, Any]) -> dict[str, str]:
    """Return the times of an object, name -> cell of a table: by names, else of objects within it, else by contents."""
    within = [cast("dict[str, Any]", inner) for inner in value.values() if isinstance(inner, dict)]
    for one in (value, *within):
        if found := {name: cell for name, given in one.items() if _is_time(name) and (cell := _time_cell(given))}:
            return found
    texts = {name: one for inner in (value, *within) for name, one in inner.items() if isinstance(one, str)}
    return {name: text for name, text in texts.items() if text[:1].isdecimal() and _is_date(text)}


def _is_date(text: str) -> bool:
    return ISO.fullmatch(text) is not None or foreign_time(text)


@lru_cache(4096)
def _is_time(name: str) -> bool:
    column = named_column(name)
    return column is not None and column.rule.key == "time"


def _time_cell(given: Any) -> str:
    """Return a number or text, or seconds and nanoseconds, as a cell of a table; empty for anything else."""
    stamp = cast("dict[str, Any]", given if isinstance(given, dict) else {})
    if (names := time_names(stamp)) and all(isinstance(one, int) for one in stamp.values()):
        return f"{stamp[names[0]]}.{stamp[names[1]]:09d}"
    return str(given) if isinstance(given, str | int | float) and not isinstance(given, bool) else ""


def _records_within(value: Mapping[str, Any], level: int = 0) -> list[Record]:
    """Return the records that an object collects, with what all share; empty if it is one itself.

    They are objects in arrays, or the elements of arrays of one length, of which one holds times; also within others.
    """
    inside = [(key, cast("dict[str, Any]", inner)) for key, inner in value.items() if isinstance(inner, dict)]
    by_number = [("", value), *inside]  # as pandas writes rows
    numbered = {key: [*inner.values()] for key, inner in by_number if "0" in inner}
    arrays: dict[str, list[Any]] = {key: one for key, one in {**value, **numbered}.items() if isinstance(one, list)}
    parts = {f"{key}.{name}": one for key, inner in inside for name, one in inner.items()}
    every: dict[str, list[Any]] = arrays | {path: one for path, one in parts.items() if isinstance(one, list)}
    for timed, times_of in every.items():
        alike = {key: inner for key, inner in every.items() if len(inner) == len(times_of)}
        if len(alike) > 1 and _are_times(timed.rpartition(".")[2], times_of):
            rows = [(k, {timed: _time_cell(times_of[k])}) for k in range(len(times_of))]
            return [(timed, cells, _with(value, {key: inner[k] for key, inner in alike.items()})) for k, cells in rows]
    found: list[Record] = []
    shared = {key: inner for key, inner in value.items() if key not in arrays and "" not in arrays}
    for key, inner in arrays.items():
        objects = [cast("dict[str, Any]", one) for one in inner if isinstance(one, dict)]
        cells = [*map(_times_in, objects)]
        if objects and len(objects) == len(inner) and all(cells):
            found += [(key, own, {**shared, **one}) for own, one in zip(cells, objects, strict=True)]
        elif not any(cells) and not _times_in(value):
            inside += [(key, one) for one in objects]
    if not found and level < LEVELS and not _times_in(value):
        deeper = ((key, _records_within(inner, level + 1)) for key, inner in inside)
        found = [(own or key, cells, one) for key, records in deeper for own, cells, one in records]
    return found


def _with(value: Mapping[str, Any], elements: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return an object with other values; "a.b" is that of b within a."""
    made = dict(value)
    for path, one in elements.items():
        outer, _, name = path.partition(".")
        made[outer] = {**made[outer], name: one} if name and outer in value else one
    return made


def _are_times(name: str, values: Sequence[Any]) -> bool:
    """Return whether an array holds times, by its name or as dates: one of seconds and nanoseconds goes back."""
    if len(values) < 2 or not (_is_time(name) or all(isinstance(one, str) for one in values)):
        return False
    cells = [prefixed_ns(one) if isinstance(one, str) else one for one in values]
    return all(isinstance(one, int | float) and one != NO_TIME for one in cells) and cells == sorted(cells)


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
    if {"lat", "lon"} <= value.keys() and len(OF_UGPS & value.keys()) > 2:
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
    """Return the time that a device's report states in nanoseconds since 1970, else that of the line before."""
    sent_us, seconds = value.get("time_of_transmission", value.get("time_of_validity")), value.get("ts")
    if isinstance(sent_us, int) and EARLIEST_S * 1e6 < sent_us < LATEST_S * 1e6:
        return sent_us * 1000
    if isinstance(seconds, int | float) and EARLIEST_S < seconds < LATEST_S:
        return round(seconds * 1e6) * 1000  # microseconds: a float has no more
    if _kind(value) in REPORTS:
        return last  # their "time" is that since the report before
    return next((ns for cell in _times_in(value).values() if (ns := prefixed_ns(cell)) != NO_TIME), last)
