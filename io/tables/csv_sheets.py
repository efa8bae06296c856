"""How the columns of a CSV file are interpreted: by usbldr's own names, by rostopic's, or by the configuration.

- Own names: the columns of log.COLUMNS with integer ``time_ns`` (and, if known, ``received_ns``) in place of the times
  in seconds. A file belongs to the sensor that its stem names, else to the only one that its columns match.
- `rostopic echo -p`: ``%time`` and ``field.`` names; they determine the message type. So do the fields of messages in
  other files, such as bagpy's, with the stamp of the header in seconds and nanoseconds.
- Any: ``columns`` of a sensor's section of the configuration name the column of each quantity.
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path
from typing import NamedTuple

import numpy as np

from usbldr.filters.errors import UsageError
from usbldr.io.messages.configured import ARRIVALS, AT_1970, TIME_UNITS_NS, ConfiguredColumns, named_fields, plain
from usbldr.io.messages.field_names import (
    ALONG_EARTH,
    DIRECTION,
    KEYS,
    OF_SHIP,
    RULES,
    SHIP,
    NamedColumn,
    earth_velocities,
    named_column,
    sensors_by_name,
    words_of,
)
from usbldr.io.messages.registry import ROSTOPIC_TYPES
from usbldr.io.messages.topic_names import suggested_sensors
from usbldr.io.settings.toml_text import quoted
from usbldr.io.tables.time_columns import SECOND_NS, TimeColumn, dated_columns, time_column, time_fault
from usbldr.io.tables.time_zones import UNKNOWN_ZONE
from usbldr.io.tables.unnamed_columns import is_number
from usbldr.io.units import spellings, states_degrees, unit_of

PROPOSED = "name them with the key columns of the sensor's section in usbldr.toml; usbldr init writes a draft"
NO_HEADER = f"has no header: its first line holds values, so its columns are 1, 2, ...; {PROPOSED}"
OF_FIXES = "fix_status fix_type quality"  # columns that say whether there was a fix, and how it was made
TEXTS = {"device", "target", "lat_side", "lon_side", "valid", *OF_FIXES.split()}  # keys whose cells may be words
ANGLES: Mapping[str, tuple[float, float]] = {
    "lat_deg": (np.pi / 2, 90.0),
    "lon_deg": (np.pi, 360.0),
    "heading_deg": (4 * np.pi, 400.0),
}
"""Angles that are degrees if their sizes are between these: beyond radians of half a circle, or of two whole ones."""
FULL_CIRCLE = 360.0  # fixed: degrees
OF_MINUTES = re.compile("ddmm", re.IGNORECASE)  # a latitude of degrees and minutes, perhaps seconds
STAMPS = ("header.stamp.sec", "header.stamp.secs")  # with the nanoseconds beside it, which are added to it
CANONICAL = "usbldr/"  # types of files with usbldr's own columns: "usbldr/dvl"


@dataclass(frozen=True, slots=True)
class Sheet:
    """The meaning of each column of a file."""

    type: str
    columns: Mapping[str, str]  # field path -> column
    received: TimeColumn | None = None  # log time; None: the file cannot be read because of problem
    stamp: TimeColumn | None = None  # "header.stamp"; None: records have log time only
    problem: str = ""
    texts: frozenset[str] = frozenset()  # field paths that are texts
    scale: Mapping[str, float] = field(default_factory=dict[str, float])  # field path -> factor to its own unit


class OwnColumns(NamedTuple):
    """The columns besides time_ns of a file with usbldr's own names."""

    choices: tuple[frozenset[str], ...]  # the columns of at least one of these are required
    optional: frozenset[str]


def _kind(choices: Sequence[str], optional: str = "") -> OwnColumns:
    return OwnColumns(tuple(frozenset(c.split()) for c in choices), frozenset(f"{optional} valid".split()))


OWN_COLUMNS: Mapping[str, OwnColumns] = {
    "dvl": _kind(["starboard_mps forward_mps"], "up_mps sd_mps altitude_m"),
    "compass": _kind(["heading_deg"], "sd_deg roll_deg pitch_deg"),
    "usbl": _kind(
        ["east_m north_m", "lat_deg lon_deg", "slant_range_m bearing_deg"],
        f"elevation_deg depth_m sd_m cov_ee_m2 cov_en_m2 cov_nn_m2 target {OF_FIXES}",
    ),
    "gps": _kind(["lat_deg lon_deg", "east_m north_m"], f"sd_m lat_deg lon_deg {OF_FIXES}"),
    "depth": _kind(["depth_m"]),
    "truth": _kind(["east_m north_m", "lat_deg lon_deg"], f"sd_m lat_deg lon_deg {OF_FIXES}"),
}
"""One line per sensor."""
OWN_NAMES = frozenset(name for kind in OWN_COLUMNS.values() for name in kind.optional.union(*kind.choices))


def sheet_of(stem: str, header: Sequence[str]) -> Sheet | None:
    """Return how a file's column names are interpreted, None if they match no sensor and no message."""
    names = plain_names(header)
    if header and header[0].replace(" ", "") == "%time":
        return _of_message(names, TimeColumn(names[0]), TimeColumn("header.stamp") if "header.stamp" in names else None)
    stamp = next((TimeColumn(name, SECOND_NS) for name in names if name in STAMPS), None)
    message = _of_message(names, stamp, stamp) if stamp else None
    return message if message and message.type else _own(stem, names)


def plain_names(header: Sequence[str]) -> list[str]:
    """Return the plain names of a file's columns; rostopic's %time keeps its mark if messages have a time, too."""
    names = [plain(name) for name in header]
    return ["%" + name if i == 0 and names.count(name) > 1 else name for i, name in enumerate(names)]


def _of_message(names: Sequence[str], received: TimeColumn, stamp: TimeColumn | None) -> Sheet:
    """Return the meaning of columns that are the fields of a message: its type is that which has them."""
    columns = {name: name for name in names if name not in (received.column, "header.stamp")}
    for name in list(columns):
        array = re.fullmatch(r"(.*[a-z]_?)(\[?)(\d+)(\]?)", name)
        if array and f"{array[1]}{array[2]}0{array[4]}" in columns:
            columns[f"{array[1].rstrip('_')}.{array[3]}"] = name
    fitting = (kind for kind, paths in ROSTOPIC_TYPES.items() if paths <= columns.keys())
    return Sheet(next(fitting, ""), columns, received, stamp)


def _own(stem: str, header: Sequence[str]) -> Sheet | None:
    sensor = _sensor(stem, set(header))
    if sensor is None:
        return None
    kind = OWN_COLUMNS[sensor]
    known = kind.optional.union(*kind.choices)
    flags = [one for one in map(named_column, header) if one and one.rule.dimension is None]
    columns = {one.rule.key: one.name for one in flags if one.rule.key in known}
    columns |= {name: name for name in header if name in known}
    missing = min((sorted((choice | {"time_ns"}) - set(header)) for choice in kind.choices), key=len)
    if missing:
        if list(header[:1]) == ["1"]:
            return Sheet(CANONICAL + sensor, columns, problem=NO_HEADER)
        unnamed = "has no column whose name states quantity and unit"
        unnamed = f"holds {ALONG_EARTH}" if sensor == "dvl" and earth_velocities(header) else unnamed
        lacks = f"has no column {', '.join(missing)}" if columns or "time_ns" in header else unnamed
        problem = f"{lacks} (its columns: {', '.join(header)}); {PROPOSED}"
        return Sheet(CANONICAL + sensor, columns, problem=problem)
    received = "received_ns" if "received_ns" in header else "time_ns"
    texts = frozenset(TEXTS & columns.keys() if sensor != "dvl" else ())
    return Sheet(CANONICAL + sensor, columns, TimeColumn(received), TimeColumn("time_ns"), texts=texts)


def _sensor(stem: str, header: set[str]) -> str | None:
    """Return the sensor that a file's stem names, else the one whose columns match and, of several, is in its stem."""
    name = stem.lower().split("__")[-1]
    if name in OWN_COLUMNS:
        return name
    fitting = [s for s, kind in OWN_COLUMNS.items() if any(choice | {"time_ns"} <= header for choice in kind.choices)]
    of_ship = ["gps"] if "gps" in fitting and "compass" not in fitting and SHIP.search(words_of(name)) else []
    named = [sensor for sensor in fitting if sensor in name] or of_ship or fitting
    return named[0] if len(named) == 1 else None


def foreign_sheets(stem: str, header: Sequence[str], first_row: Sequence[str]) -> Mapping[str, Sheet]:
    """Return sensor -> how its columns are interpreted by their names and units; empty if no sensor is there.

    A time may be a date and time instead of a number with a unit, which ``first_row`` shows. Columns besides, by
    usbldr's own names, are the sensor's.
    """
    names = plain_names(header)
    found = dict(sensors_by_name(names, stem.lower()))
    times: Mapping[str, Sequence[NamedColumn]] = found.pop("", {})
    stated = any(column.unit.unit for columns in found.values() for same in columns.values() for column in same)
    cells = dict(zip(names, first_row, strict=False))
    if not stated and not any(map(states_degrees, first_row)):
        others = suggested_sensors(stem) - {"compass"}
        found = {
            sensor: {key: same for key, same in columns.items() if key in ANGLES or not same[0].rule.dimension}
            for sensor, columns in found.items()
            if (_in_degrees(columns, cells) or _in_minutes(columns, cells)) and (sensor != "compass" or not others)
        }
        if not found:
            return {}
    stamps, arrivals = dated_columns(cells, times.get("time", [])), times.get("received", [])
    finer = (one for one in stamps if not UNKNOWN_ZONE.search(one.name) and one.factor <= SECOND_NS)
    stamps = [*finer] or stamps  # UTC beside local time, seconds beside minutes
    beside = _times_beside(stamps, found, names)
    named = {sensor: {key: same[0].name for key, same in columns.items()} for sensor, columns in found.items()}
    sides = {sensor: side_columns(columns, cells) for sensor, columns in named.items()}
    twice = next((f"has two columns {name}; rename one" for name in names if name and names.count(name) > 1), "")
    untimed = {sensor: (not own and twice) or time_fault(own, arrivals, cells) for sensor, own in beside.items()}
    faults = {
        sensor: (_doubled(sensor, {"": own, **found[sensor]}, time_column(own[0], cells)) if own else "")
        or untimed[sensor]
        or _fault(found[sensor], cells, sides[sensor])
        for sensor, own in beside.items()
    }
    refused = {sensor: Sheet(CANONICAL + sensor, {}, problem=why) for sensor, why in faults.items() if why}
    if all(untimed.values()):
        return refused
    clocks = {sensor: [time_column(one, cells) for one in (*arrivals, *own)] for sensor, own in beside.items()}
    taken = {same[0].name for columns in found.values() for same in columns.values()}
    own = {one: sorted(OWN_COLUMNS[one].optional & {*names} - taken) if one in OWN_COLUMNS else [] for one in found}
    return {
        sensor: refused.get(sensor)
        or Sheet(
            CANONICAL + sensor.removeprefix("ship/"),
            named[sensor] | sides[sensor] | {name: name for name in own[sensor]},
            clocks[sensor][0],
            clocks[sensor][-1],
            texts=frozenset(TEXTS & {*named[sensor], *sides[sensor], *own[sensor]}),
            scale={key: same[0].factor for key, same in columns.items()},
        )
        for sensor, columns in found.items()
        if not (sensor in refused and sensor in OF_SHIP.values())
    }


def _times_beside(
    stamps: Sequence[NamedColumn], found: Mapping[str, Mapping[str, Sequence[NamedColumn]]], names: Sequence[str]
) -> Mapping[str, Sequence[NamedColumn]]:
    """Return sensor -> its columns of times: of tables side by side, the last one before its own columns, else all."""
    places = [names.index(one.name) for one in stamps]
    behind = {
        sensor: {
            sum(place < names.index(one.name) for place in places) - 1 for same in columns.values() for one in same
        }
        for sensor, columns in found.items()
    }
    apart = all(len(last) == 1 for last in behind.values()) and {k for (k, *_) in behind.values()} == {
        *range(len(stamps))
    }
    return {sensor: [stamps[min(last)]] if apart else stamps for sensor, last in behind.items()}


def side_columns(columns: Mapping[str, str], cells: Mapping[str, str]) -> dict[str, str]:
    """Return the columns of N or S and of E or W for those of a latitude and a longitude; empty if there are not both.

    ``cells``: those of the first row by column. Of several, it is the one beside, else the first one behind.
    """
    if not columns.keys() >= {"lat_deg", "lon_deg"} or not cells:
        return {}
    found: dict[str, str] = {}
    names = list(cells)
    for key, of, letters in (("lat_side", "lat_deg", ("N", "S")), ("lon_side", "lon_deg", ("E", "W"))):
        place = names.index(columns[of])
        fitting = [k for k, cell in enumerate(cells.values()) if cell.strip().upper() in letters]
        if fitting:
            found[key] = names[min(fitting, key=lambda k: (abs(k - place) != 1, k < place, abs(k - place)))]
    return found if len(found) == 2 else {}


def open_angle(name: str) -> str:
    """Return the angle of ANGLES that a column is named for without a unit, empty if none."""
    column = named_column(name, (DIRECTION, *RULES))
    return column.rule.key if column and not column.unit.unit and column.rule.key in ANGLES else ""


def first_informative(name: str, cells: Iterable[str]) -> str:
    """Return the first filled cell of a column; of an angle without a unit, the first one that shows it."""
    key = open_angle(name)
    filled = (cell for cell in cells if cell and not (key and cell.lower() == "nan"))
    first = next(filled, "")
    return next((cell for cell in chain([first], filled) if _is_degrees(key, cell)), first) if key else first


def _is_degrees(key: str, cell: str) -> bool:
    least, most = ANGLES[key]
    return is_number(cell) and least < abs(float(cell)) <= most


def _in_minutes(columns: Mapping[str, Sequence[NamedColumn]], cells: Mapping[str, str]) -> bool:
    """Return whether a place is named ddmm or ddmmss, and its latitude, beyond a full circle, cannot be degrees."""
    names = [columns[key][0].name for key in ("lat_deg", "lon_deg") if key in columns]
    places = [abs(float(cells[name])) for name in names if is_number(cells.get(name, "")) and OF_MINUTES.search(name)]
    return len(places) == 2 and FULL_CIRCLE < places[0] <= 90_00_00 and places[1] <= 180_00_00


def _in_degrees(columns: Mapping[str, Sequence[NamedColumn]], cells: Mapping[str, str]) -> bool:
    """Return whether angles whose names state no unit can, by the cells that show it, be nothing else than degrees.

    Radians are within half a circle, headings within a whole one.
    """
    angles = [(key, cells.get(one.name, "")) for key in ANGLES for one in columns.get(key, ()) if not one.unit.unit]
    within = all(is_number(cell) and abs(float(cell)) <= ANGLES[key][1] for key, cell in angles)
    return within and any(_is_degrees(key, cell) for key, cell in angles)


def _fault(columns: Mapping[str, Sequence[NamedColumn]], cells: Mapping[str, str], sides: Mapping[str, str]) -> str:
    """Return why the columns of a sensor cannot be read, empty if they can; "45° 12.5' N" and sides state a unit."""
    for key, same in columns.items():
        cell, dimension = cells.get(same[0].name, ""), same[0].rule.dimension
        by_cell = dimension == "angle" and states_degrees(cell)
        by_cell |= not same[0].unit.unit and dimension is not None and unit_of(cell).dimension == dimension
        by_value = key in ANGLES and (bool(sides) or _in_degrees(columns, cells) or _in_minutes(columns, cells))
        if not (same[0].known or by_cell or by_value):
            units = spellings(same[0].rule.dimension) if same[0].rule.dimension else ""
            return f"has a column {same[0].name} without a known unit ({units}); write it behind the name"
    return ""


def _doubled(sensor: str, columns: Mapping[str, Sequence[NamedColumn]], clock: TimeColumn) -> str:
    """Return that several columns hold one quantity, and how to choose one; empty if none do."""
    doubled = [same for key, same in columns.items() if len(same) > 1 and key != "target"]  # a number and a name
    if not doubled:
        return ""
    time = next((key for key, unit_ns in TIME_UNITS_NS.items() if (unit_ns, AT_1970.get(key, 0)) == clock[1:]), "")
    keys = {time: clock.column, **{KEYS.get(key, key): same[0].name for key, same in columns.items() if key}}
    line = ", ".join(f"{key} = {quoted(name)}" for key, name in keys.items())
    names = ", ".join(column.name for column in doubled[0])
    if len({column.name for column in doubled[0]}) < len(doubled[0]):
        return f"has columns of one name ({names}); rename them"
    return f"has columns for the same quantity ({names}); choose one under [{sensor}]: columns = {{ {line} }}"


def configured_sheet(sensors: Sequence[ConfiguredColumns], header: Sequence[str], file: Path, topic: str) -> Sheet:
    """Return how the configuration interprets a file: its columns by their own names, and the one time of all sensors.

    Raises UsageError if a column is missing, or if not exactly one time is named.
    """
    names = plain_names(header)
    columns: dict[str, str] = {}
    clocks: dict[tuple[TimeColumn, TimeColumn], str] = {}
    texts: set[str] = set()
    for stated in sensors:
        fields = named_fields(stated, topic, names, (), file)
        times = [key for key in TIME_UNITS_NS if key in fields]
        if len(times) != 1:
            raise UsageError(
                f"[{stated.sensor}] columns must name exactly one of {', '.join(TIME_UNITS_NS)}", path=file
            )
        stamp = TimeColumn(fields[times[0]], TIME_UNITS_NS[times[0]], AT_1970.get(times[0], 0))
        arrivals = [TimeColumn(fields[key], unit_ns) for key, unit_ns in ARRIVALS.items() if key in fields]
        clocks.setdefault((arrivals[0] if arrivals else stamp, stamp), stated.sensor)
        columns |= {name: name for name in fields.values()}
        texts |= {fields[key] for key in TEXTS & fields.keys()}
    if len(clocks) > 1:
        which = " and ".join(f"[{sensor}]" for sensor in clocks.values())
        raise UsageError(f"{which} name different times of one file; name the same", path=file)
    received, stamp = next(iter(clocks))
    kind = CANONICAL + "+".join(stated.sensor for stated in sensors)
    return Sheet(kind, columns, received, stamp, texts=frozenset(texts))
