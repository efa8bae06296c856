"""Topics of any type as sensors: the key ``columns`` of a section names the field, or CSV column, of each quantity.

A field is named by its path with dots, an element of an array by its number: "velocity.x", "velocity[0]",
"velocity.0", "beams[2].range". A unit in brackets behind it, "velocity.x [mm/s]", or one that its name ends in,
"vx_mm_s", holds unless the section states ``unit``.
"""

import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from usbldr.filters.errors import UsageError, did_you_mean, listed
from usbldr.io.messages.layouts import MessageLayout
from usbldr.io.messages.registry import LAYOUTS
from usbldr.io.reader import TIME_OF_DAY, TopicInfo, listed_field, shown_field
from usbldr.io.settings.sensor_sections import Configuration
from usbldr.io.units import Dimension, NamedUnit, named_unit, spellings

TIME_UNITS_NS: Mapping[str, int] = {
    "time_ns": 1,
    "time_unix_us": 1_000,
    "time_unix_ms": 1_000_000,
    "time_unix_s": 1_000_000_000,
    "time_s": 1_000_000_000,
    "time_datenum": 86_400_000_000_000,
    "time_excel": 86_400_000_000_000,
    "time_julian": 86_400_000_000_000,
    "time_mjd": 86_400_000_000_000,
    "time_labview": 1_000_000_000,
    "time_ntp": 1_000_000_000,
    "time_filetime": 100,
    "time_ticks": 100,
}
"""Keys for the time of validity and their units; time_s counts from 1970 unless the log states another origin."""
AT_1970: Mapping[str, float] = {
    "time_datenum": 719_529,  # fixed: of MATLAB, from the year 0
    "time_excel": 25_569,  # fixed: of spreadsheets, from 1899-12-30
    "time_julian": 2_440_587.5,  # fixed: Julian Dates, from noon
    "time_mjd": 40_587,  # fixed: modified ones, from midnight
    "time_labview": 2_082_844_800,  # fixed: of LabVIEW, from 1904
    "time_ntp": 2_208_988_800,  # fixed: of the Network Time Protocol, from 1900
    "time_filetime": 116_444_736_000_000_000,  # fixed: of Windows, from 1601
    "time_ticks": 621_355_968_000_000_000,  # fixed: of .NET, from the year 1
}
"""Keys whose times do not count from 1970: the value of 1970-01-01."""
ARRIVALS: Mapping[str, int] = {"received_ns": 1, "received_unix_s": 1_000_000_000}
FLAGS = ("valid", "error", "device", "target", "lat_side", "lon_side")
"""Keys beside the quantities."""
QUANTITIES: Mapping[Dimension, str] = {
    "velocity": "sd_mps",
    "angle": "heading roll_deg pitch_deg sd_deg lat_deg lon_deg bearing_deg elevation_deg",
    "length": "x y z slant_range_m depth_m sd_m",
    "pressure": "pressure",
}
DIMENSIONS: Mapping[str, Dimension] = {key: what for what, keys in QUANTITIES.items() for key in keys.split()}
DVL_DIMENSIONS: Mapping[str, Dimension] = {**DIMENSIONS, "x": "velocity", "y": "velocity", "z": "velocity"}
QUATERNION = ("qx", "qy", "qz", "qw")
OWN_UNITS: Mapping[Dimension, str] = {"velocity": "m/s", "angle": "deg", "length": "m", "pressure": "Pa"}
SHOWN_FIELDS = 40  # [fields] in a sentence that lists them


@dataclass(frozen=True, slots=True)
class ConfiguredColumns:
    """The columns of a sensor as its section states them."""

    sensor: str
    topic: str | None  # None: the only one that has the columns
    columns: Mapping[str, str]  # quantity -> column or field
    unit: str | None = None  # of the section
    defaults: Mapping[str, str] = field(default_factory=dict[str, str])  # conventions of a layout file
    time_format: str = ""  # of a CSV file's dates and times, as of strptime; empty: by their cells


def configured_columns(configuration: Configuration, options: Mapping[str, str]) -> tuple[ConfiguredColumns, ...]:
    """Return the columns of each sensor that is not left out; ``options`` (sensor -> topic) come first."""
    stated: list[ConfiguredColumns] = []
    for sensor in LAYOUTS:
        columns = configuration.columns(sensor) if sensor != "truth" else {}
        topic = options.get(sensor) or (configuration.topic(sensor) if columns else None)
        if columns and topic != "none":
            unit = getattr(configuration.section(sensor), "unit", None)
            named = {key: name for key, name in columns.items() if key != "time_format"}
            stated.append(ConfiguredColumns(sensor, topic, named, unit, time_format=columns.get("time_format", "")))
    return tuple(stated)


def time_units_ns(sensors: Iterable[ConfiguredColumns]) -> dict[str, int]:
    """Return the fields that are times by the configuration, and their units."""
    return {
        _path(plain(stated.columns[key])): unit_ns
        for stated in sensors
        for key, unit_ns in TIME_UNITS_NS.items()
        if key in stated.columns
    }


def plain(name: str) -> str:
    """Return a column's name without blanks, a leading "%" and rostopic's "field."."""
    return name.strip().lstrip("% ").removeprefix("field.").strip()


def field_of(name: str, fields: Sequence[str], arrays: Collection[str]) -> str | None:
    """Return the field that a name means: itself, without its unit, or with an index in brackets; None if none.

    Or the only one of that name with a unit.
    """
    if "[" in name and plain(name) in fields:  # a column may be called so: "velocity[0]"
        return plain(name)
    for choice in (plain(name), named_unit(plain(name)).label):
        path = _path(choice)
        if listed_field(path, fields, arrays) is not None:
            return path
    with_unit = [field for field in fields if field != plain(name) == named_unit(field).label]
    return with_unit[0] if len(with_unit) == 1 else None


def _path(name: str) -> str:
    return re.sub(r"\[(\d+)\]", r".\1", name)


def named_fields(
    stated: ConfiguredColumns, topic: str, fields: Sequence[str], arrays: Collection[str], path: Path
) -> dict[str, str]:
    """Return quantity -> field; raise UsageError that lists the fields of the topic if one does not exist."""
    found: dict[str, str] = {}
    shown = [shown_field(field, arrays) for field in fields]
    for key, name in stated.columns.items():
        path_of = field_of(name, fields, arrays)
        if path_of is None:
            hint = did_you_mean(plain(name), shown, 2)
            text = f"{topic} has no {plain(name)} ([{stated.sensor}] columns {key}){hint}"
            raise UsageError(f"{text} (it has {listed(shown, SHOWN_FIELDS) or 'no fields'})", path=path)
        found[key] = path_of
    return found


def topic_with_columns(
    stated: ConfiguredColumns, topics: Iterable[tuple[str, Sequence[str], Collection[str]]], path: Path
) -> str:
    """Return the only topic that has all fields, of names with fields and arrays.

    Raises UsageError if there is none, or several.
    """
    names = stated.columns.values()
    missing = {
        topic: [plain(name) for name in names if not field_of(name, fields, arrays)] for topic, fields, arrays in topics
    }
    fitting = [topic for topic, absent in missing.items() if not absent]
    if len(fitting) > 1:
        raise UsageError(f"[{stated.sensor}] columns match {', '.join(fitting)}; state topic, too", path=path)
    if not fitting:
        columns = ", ".join(sorted(map(plain, names)))
        nearest = min(missing, key=lambda topic: len(missing[topic]), default="")
        lacks = (
            f": {nearest} has no {' and no '.join(missing[nearest])}"
            if len(missing.get(nearest, ())) < len(names)
            else ""
        )
        raise UsageError(f"no topic has the columns {columns} of [{stated.sensor}]{lacks}; state topic, too", path=path)
    return fitting[0]


def configured_layout(stated: ConfiguredColumns, topic: TopicInfo, path: Path) -> MessageLayout:
    """Return a topic's layout by the configuration; raise UsageError if the columns do not fit or make no sensor.

    The times of a CSV file are its "header.stamp" already.
    """
    fields = named_fields(stated, topic.name, topic.fields, topic.arrays, path)
    layout = _own_layout(stated, path)
    by_quantity = {**layout.optional, **{key: key for key in FLAGS if key not in layout.optional.values()}}
    names = {quantity: key for quantity, key in {**layout.required, **by_quantity}.items() if key in fields}
    unused = [key for key in fields if key not in (*names.values(), *TIME_UNITS_NS, *ARRIVALS)]
    if unused:
        beside = ", ".join(layout.required.values())
        raise UsageError(f"[{stated.sensor}] columns: {', '.join(unused)} cannot be used beside {beside}", path=path)
    scale, unit = _scale(stated, names, fields, path)
    if topic.is_table and "lat_deg" in fields and "lat_side" not in fields:  # as the table shows them
        beside = {key: key for key in ("lat_side", "lon_side") if key in topic.fields}
        fields, names = {**fields, **beside}, {**names, **beside}
    layout = replace(
        layout,
        required={quantity: fields[key] for quantity, key in layout.required.items()},
        optional={quantity: fields[key] for quantity, key in names.items() if quantity not in layout.required},
        fixed={key: value for key, value in layout.fixed.items() if key != "positive"} | unit,
        defaults={**layout.defaults, **stated.defaults},
        scale=scale,
        by_columns=True,
    )
    return layout if topic.is_table else _timed(stated, layout, fields, topic, path)


def _own_layout(stated: ConfiguredColumns, path: Path) -> MessageLayout:
    """Return the layout of usbldr's own columns whose required ones are stated."""
    own = [layout for layout in LAYOUTS[stated.sensor] if layout.type == stated.sensor]
    own = [layout for layout in own if {*layout.required.values()} <= {*DIMENSIONS, *QUATERNION}]
    fitting = [layout for layout in own if {*layout.required.values()} <= {*stated.columns}]
    if fitting:
        return fitting[0]
    choices = " or ".join(", ".join(layout.required.values()) for layout in own)
    raise UsageError(f"[{stated.sensor}] columns must name {choices}", path=path)


def _scale(
    stated: ConfiguredColumns, names: Mapping[str, str], fields: Mapping[str, str], path: Path
) -> tuple[dict[str, float], dict[str, str]]:
    """Return the factors of quantities whose names state a unit, and the key ``unit`` if those determine it."""
    dimensions = DVL_DIMENSIONS if stated.sensor == "dvl" else DIMENSIONS
    scale: dict[str, float] = {}
    fixed: dict[str, str] = {}
    for quantity, key in names.items():
        stated_unit = named_unit(plain(stated.columns[key]))
        dimension, own = dimensions.get(key), stated_unit if stated_unit.unit else named_unit(fields[key])
        of_section = key in ("x", "y", "z", "sd_mps", "heading", "pressure")
        if dimension is None or not own.unit or (of_section and stated.unit is not None):
            continue
        if own.dimension == dimension:
            scale[quantity] = own.factor
            fixed |= {"unit": OWN_UNITS[dimension]} if stated.sensor in ("dvl", "compass", "depth") else {}
        elif in_brackets(stated.columns[key], own) or (of_section and in_brackets(fields[key], own)):
            name = plain(stated.columns[key]) if stated_unit.unit else fields[key]
            text = f"[{stated.sensor}] columns {key}: the unit of {name} is not one of {spellings(dimension)}"
            raise UsageError(text, path=path)
    return scale, fixed


def in_brackets(name: str, own: NamedUnit) -> bool:
    """Return whether a name states its unit in brackets: then it is a unit, whether it is known or not."""
    return bool(own.unit) and name.rstrip()[-1:] in "])"


def _timed(
    stated: ConfiguredColumns, layout: MessageLayout, fields: Mapping[str, str], topic: TopicInfo, path: Path
) -> MessageLayout:
    """Return a layout of messages with its time: the one that is named, else the header's, else log time."""
    if any(key in fields for key in ARRIVALS):
        text = f"[{stated.sensor}] columns: messages arrive at their log time; leave out {' and '.join(ARRIVALS)}"
        raise UsageError(text, path=path)
    times = [key for key in TIME_UNITS_NS if key in fields]
    if len(times) > 1:
        raise UsageError(f"[{stated.sensor}] columns name {' and '.join(times)}; state one of them", path=path)
    if not times:
        return layout
    (key,) = times
    if key.endswith("_s") and (of_day := fields[key] + TIME_OF_DAY) in topic.fields:
        text = f"[{stated.sensor}] columns {key}: {fields[key]} of {topic.name} is a time of the day, not a count of "
        raise UsageError(f'{text}seconds; state time_ns = "{of_day}" in its place', path=path)
    return replace(layout, stamp=fields[key], stamp_unit_ns=TIME_UNITS_NS[key], stamp_at_1970=AT_1970.get(key, 0))
