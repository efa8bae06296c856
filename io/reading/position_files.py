"""Files of positions, a truth or a track: recordings with one topic of them, and tables, TUM too, by their columns."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import pandas as pd

from usbldr.filters.errors import LogError, UsageError
from usbldr.io.axes import named_ned
from usbldr.io.conventions.clock_parts import on_one_clock
from usbldr.io.conventions.grids import off_grid
from usbldr.io.conventions.positions import gps
from usbldr.io.conventions.timestamps import sorted_by_time
from usbldr.io.decoding.collected import read_whole
from usbldr.io.file_access.open_file import HEAD_BYTES, begin_of, head_lines
from usbldr.io.findings import Finding
from usbldr.io.formats.compressed_log import plain_file, plain_name
from usbldr.io.geodesy import Origin
from usbldr.io.messages.configured import QUATERNION, TIME_UNITS_NS, ConfiguredColumns, plain
from usbldr.io.messages.field_names import named_column
from usbldr.io.messages.layouts import raw_records, wanted_paths
from usbldr.io.messages.registry import message_layout_of
from usbldr.io.messages.roles import TopicChoice, topic_named
from usbldr.io.provenance import ChosenBy, Convention, Provenance
from usbldr.io.reader import Reader, TopicInfo, name_of
from usbldr.io.reading.opening import Request, open_configured
from usbldr.io.settings.sensor_sections import GpsSection, TruthSection
from usbldr.io.tables.csv_log import csv_log
from usbldr.io.tables.csv_sheets import side_columns
from usbldr.io.tables.csv_text import read_texts
from usbldr.io.tables.time_columns import dated_columns, keys_since_1970

MORE = ("sd_m", "sd_east_m", "sd_north_m", "cov_en_m2", "heading_deg", *QUATERNION)
"""Columns beside the position, by usbldr's own names."""
PLACES: Mapping[tuple[str, str], str | None] = {
    ("east_m", "north_m"): "ENU",
    ("lat_deg", "lon_deg"): "latlon",
    ("tx", "ty"): None,
    ("x_m", "y_m"): None,
    ("x", "y"): None,
}
"""Two columns that hold a position, as field_names calls them, and their frame; None: east and north, unless stated."""
OF_LATLON = {"x": "lat_deg", "y": "lon_deg"}


class Positions(NamedTuple):
    """Positions on the plane, and how they were read."""

    table: pd.DataFrame  # in order of time_ns: east_m, north_m, sd_m and what else positions.gps knows
    provenance: Provenance
    findings: Sequence[Finding]
    by_default: bool  # whether only the default chose between ENU and NED
    on_log_plane: bool = False  # a track of usbldr: its times and positions are of the log's own timeline and plane


def is_recording(place: Path) -> bool:
    """Tell whether a place is a recording of messages: MCAP, a bag, a rosbag2 folder or file."""
    if place.is_dir():
        return (place / "metadata.yaml").is_file()
    return plain_name(place).endswith((".mcap", ".bag", ".db3")) and place.is_file()


def find_truth_file(name: str, log: Path, from_option: bool) -> Path | None:
    """Return the file of positions, or the recording: of an option from here, else from the folder of the log."""
    places = [Path(name)] if from_option else []
    places.append(log.resolve().parent / name)
    return next((place for place in places if place.is_file() or is_recording(place)), None)


def read_positions(
    file: Path, asked: tuple[str, str], request: Request, section: TruthSection, start_ns: int, origin: Origin | None
) -> Positions:
    """Return the positions of a file, without the rows that the section skips.

    ``asked``: as what, and who chose it. Raises LogError if they cannot be read, or have no place on the plane;
    UsageError if their columns are unnamed; SettingError if a setting does not fit.
    """
    what, chosen_by = asked
    if is_recording(file):
        reader = open_configured(file, Request(configuration="none", msg_path=request.msg_path)).reader
        topics = reader.topics()
        choice = topic_named(file, topics, "truth", only_positions(file, topics, what), chosen_by)
        read = positions_of(reader, choice, section, origin)
        how = replace(read.provenance, topic=file.name)
        return read._replace(table=read.table.iloc[section.skip_rows :], provenance=how)
    with plain_file(file) as (text, lost):
        read = _of_table(text, file.name, chosen_by, section, start_ns, origin)
        return read._replace(findings=[*lost, *read.findings])


def _of_table(
    file: Path, name: str, chosen_by: str, section: TruthSection, start_ns: int, origin: Origin | None
) -> Positions:
    """Return the positions of a text file, as those of a log of one table; ``name``: what the user calls it."""
    head, _ = begin_of(file, HEAD_BYTES)
    if not head_lines(head):
        what = "is neither text nor a recording" if head else "the file is empty"
        raise LogError(what, path=file)
    cells = read_texts(file, units_are_row=section.skip_rows > 0)  # the user counts a line of units
    row_count = len(cells.lines)
    if section.skip_rows >= row_count > 0:
        raise LogError(f"no row is left of {row_count} (skip_rows = {section.skip_rows})", path=file)
    if section.skip_rows:
        columns = {name: column[section.skip_rows :] for name, column in cells.columns.items()}
        cells = cells._replace(columns=columns, lines=cells.lines[section.skip_rows :])
    columns, frame, columns_by = _columns(file, dict(csv_log(file, cells=cells).first_row), section)
    stated = ConfiguredColumns("truth", name_of(file.stem.replace("__", "/")), columns)
    log = csv_log(file, cells=cells).with_columns([stated])
    choice = topic_named(file, log.topics(), "truth", str(stated.topic), chosen_by, stated)
    fixed = {**choice.layout.fixed, "frame": frame} if frame else choice.layout.fixed
    choice = replace(choice, layout=replace(choice.layout, fixed=fixed))
    of_log = "time_s" in columns
    read = positions_of(log, choice, section, origin, name, start_ns if of_log else 0)
    named = Convention("columns", ", ".join(f"{key} = {name}" for key, name in columns.items()), columns_by)
    skipped = [Convention("skip_rows", section.skip_rows, "configuration")] if section.skip_rows else []
    chosen = (*read.provenance.conventions, named, *skipped)
    how = replace(read.provenance, type="file", conventions=chosen, messages=row_count)
    return read._replace(provenance=how, findings=[*log.findings(), *read.findings], on_log_plane=of_log)


def _columns(
    file: Path, cells: Mapping[str, str], section: TruthSection
) -> tuple[Mapping[str, str], str | None, ChosenBy]:
    """Return the columns by key, the frame if their names state it, and who chose them; ``cells``: the first ones."""
    more = {name: name for name in MORE if name in cells}
    if section.columns is not None:
        keys = OF_LATLON if section.frame == "latlon" else {}
        stated = {keys.get(str(key), str(key)): plain(name) for key, name in section.columns.items()}
        return more | stated, None, "configuration"
    named = [column for column in map(named_column, cells) if column]
    clocks = dated_columns(cells, [column for column in named if column.rule.key == "time"])
    places = {column.rule.key: column.name for column in reversed(named)} | {name: name for name in cells}
    pair = next((keys for keys in PLACES if places.keys() >= {*keys}), None)
    if not clocks or pair is None:
        example = '{ time_unix_s = "...", x = "...", y = "..." }'
        raise UsageError(
            f"which columns hold time and position (it has {', '.join(cells)})? Call them time_unix_s, lat_deg and "
            f"lon_deg or x and y; of a truth, or state columns = {example} under [truth]",
            path=file,
        )
    clock = clocks[0]
    keys = [clock.name] if clock.name in TIME_UNITS_NS else keys_since_1970(cells[clock.name])
    key = next((key for key in keys if not clock.known or TIME_UNITS_NS[key] == clock.factor), "time_unix_s")
    x, y = OF_LATLON.values() if (PLACES[pair] or section.frame) == "latlon" else OF_LATLON
    columns = {key: clock.name, x: places[pair[0]], y: places[pair[1]], **more}
    return columns | side_columns(columns, cells), PLACES[pair], "column names"


def only_positions(path: Path, topics: Sequence[TopicInfo], option: str) -> str:
    """Return the one topic of positions in a recording; raise UsageError that lists them if there are several."""
    names = [topic.name for topic in topics if topic.count and message_layout_of("truth", topic) is not None]
    if len(names) != 1:
        which = f"several topics of positions ({', '.join(names)})" if names else "no topic of positions"
        raise UsageError(f"{option} {path.name} has {which}: join it by --with {path.name}, and name its topic")
    return names[0]


def positions_of(
    reader: Reader, choice: TopicChoice, section: TruthSection, origin: Origin | None, name: str = "", start_ns: int = 0
) -> Positions:
    """Return the positions of a topic, under another name if it has one; its times count from ``start_ns``."""
    topic, layout = choice.topic, choice.layout
    paths = wanted_paths(topic, layout)
    records = read_whole(reader, {topic.key: list(paths.values())})[topic.key]
    raw = raw_records(reader.path, replace(topic, name=name or topic.name), layout, records, paths)
    raw, of_clock = on_one_clock(raw.later_by(start_ns))
    grid = [Convention("grid", section.grid, "configuration")] if section.grid else []
    raw, section = off_grid(raw, section) if section.grid else (raw, section)
    made = gps(raw, GpsSection(frame=section.frame), origin)
    table, found = sorted_by_time(made.table, raw.topic.name, "truth")
    how = Provenance(raw.topic.name, topic.type, choice.chosen_by, (*made.conventions, *grid), topic.count, len(table))
    by_default = made.conventions[0].chosen_by == "default" and not named_ned(raw.frame_id)
    return Positions(table, how, [*of_clock, *made.findings, *found], by_default)
