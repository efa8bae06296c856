"""The positions of a recording of its own beside a log: of the truth, or of an estimate."""

from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from usbldr.filters.errors import SettingError, UsageError
from usbldr.io.conventions.positions import gps
from usbldr.io.conventions.timestamps import sorted_by_time
from usbldr.io.decoding.collected import read_whole
from usbldr.io.findings import Finding
from usbldr.io.geodesy import Origin
from usbldr.io.messages.layouts import RawRecords, raw_records, wanted_paths
from usbldr.io.messages.registry import message_layout_of
from usbldr.io.messages.roles import TopicChoice, topic_named
from usbldr.io.provenance import Provenance
from usbldr.io.reader import Reader, TopicInfo
from usbldr.io.reading.opening import Request, open_configured
from usbldr.io.settings.sensor_sections import GpsSection, TruthSection


def only_positions(path: Path, topics: Sequence[TopicInfo], option: str) -> str:
    """Return the one topic of positions in a recording; raise UsageError that lists them if there are several."""
    names = [topic.name for topic in topics if topic.count and message_layout_of("truth", topic) is not None]
    if len(names) != 1:
        which = f"several topics of positions ({', '.join(names)})" if names else "no topic of positions"
        raise UsageError(f"{option} {path.name} has {which}: join it by --with {path.name}, and name its topic")
    return names[0]


def raw_positions(reader: Reader, choice: TopicChoice) -> RawRecords:
    """Read the unconverted records of a topic."""
    topic, layout = choice.topic, choice.layout
    paths = wanted_paths(topic, layout)
    records = read_whole(reader, {topic.name: list(paths.values())})[topic.name]
    return raw_records(reader.path, topic, layout, records, paths)


def recorded_truth(
    file: Path, chosen_by: str, section: TruthSection, origin: Origin | None
) -> tuple[pd.DataFrame, Provenance, list[Finding]]:
    """Return the positions of a recording, how they were read, and what was found."""
    reader = open_configured(file, Request(configuration="none")).reader
    topics = reader.topics()
    choice = topic_named(file, topics, "truth", only_positions(file, topics, "truth"), chosen_by)
    try:
        made = gps(raw_positions(reader, choice), GpsSection(frame=section.frame), origin)
    except SettingError as err:
        raise UsageError(f"[truth] {err.text}", path=file) from err
    table, found = sorted_by_time(made.table, file.name, "truth")
    topic = choice.topic
    how = Provenance(file.name, topic.type, chosen_by, made.conventions, topic.count, len(table), made.geodetic)
    return table, how, [*made.findings, *found]
