"""Which topics of a log a layout file defines: their columns, as if the configuration named them."""

from collections.abc import Collection, Mapping, Sequence
from typing import NamedTuple

from usbldr.io.findings import Finding
from usbldr.io.messages.configured import ConfiguredColumns, field_of
from usbldr.io.messages.registry import message_layout_of
from usbldr.io.messages.roles import candidates, find_topic
from usbldr.io.reader import TopicInfo
from usbldr.io.settings.layout_files import LayoutEntry, LayoutFile


class _Use(NamedTuple):
    file: LayoutFile
    entry: LayoutEntry
    topic: TopicInfo


def columns_of_layouts(
    files: Sequence[LayoutFile], topics: Sequence[TopicInfo], named: Mapping[str, str], taken: Collection[str]
) -> tuple[tuple[ConfiguredColumns, ...], tuple[Finding, ...]]:
    """Return the columns of sensors that a layout file defines, and a finding for each.

    ``named``: sensor -> topic by option or configuration; ``taken``: sensors whose columns the configuration states. A
    file of the user comes before the types that usbldr knows, one of usbldr's own after them.
    """
    found: dict[str, _Use] = {}
    for file in files:
        for entry in file.entries:
            sensor, name = entry.sensor, named.get(entry.sensor)
            if sensor in found or sensor in taken or name == "none":
                continue
            among = [topic for topic in (find_topic(topics, name),) if topic] if name else topics
            fitting = [topic for topic in among if topic.count and not topic.problem and _defines(entry, topic)]
            known = name and fitting and message_layout_of(sensor, fitting[0])
            if file.origin == "usbldr" and (known or (not name and candidates(sensor, topics).best)):
                continue
            if fitting:
                found[sensor] = _Use(file, entry, max(fitting, key=lambda topic: topic.count))
    stated: list[ConfiguredColumns] = []
    for use in found.values():
        entry = use.entry
        stated.append(ConfiguredColumns(entry.sensor, use.topic.name, entry.columns, entry.unit, entry.conventions))
    return tuple(stated), tuple(map(_finding, found.values()))


def _defines(entry: LayoutEntry, topic: TopicInfo) -> bool:
    """Return whether an entry is of a topic's type, and the topic has its fields."""
    stated = f"nmea/{entry.sentence.replace(',', '_')}" if entry.sentence else str(entry.type).replace("/msg/", "/")
    kind = topic.type.replace("/msg/", "/").replace(".", "/")
    same = kind.lower() == stated.lower() or (entry.type is not None and kind.lower().endswith(f"/{stated.lower()}"))
    return same and all(field_of(name, topic.fields, topic.arrays) for name in entry.columns.values())


def _finding(use: _Use) -> Finding:
    file = use.file
    text = f"read as {use.entry.sensor} by the layout file {file.path.name} ({file.origin}, sha256 {file.sha256[:16]})"
    return Finding("LAYOUT-FILE", f"{use.topic.name}: {text}", use.topic.name)
