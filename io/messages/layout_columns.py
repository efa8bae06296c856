"""Which topics of a log a layout file defines: their columns, as if the configuration named them."""

from collections.abc import Collection, Mapping, Sequence

from usbldr.io.findings import Finding
from usbldr.io.messages.configured import ConfiguredColumns, field_of
from usbldr.io.messages.registry import message_layout_of
from usbldr.io.messages.roles import candidates, find_topic
from usbldr.io.reader import TopicInfo
from usbldr.io.settings.layout_files import LayoutEntry, LayoutFile


def columns_of_layouts(
    files: Sequence[LayoutFile], topics: Sequence[TopicInfo], named: Mapping[str, str], taken: Collection[str]
) -> tuple[tuple[ConfiguredColumns, ...], tuple[Finding, ...]]:
    """Return the columns of sensors that a layout file defines, and a finding for each.

    ``named``: sensor -> topic by option or configuration; ``taken``: sensors whose columns the configuration states. A
    file of the user comes before the types that usbldr knows, one of usbldr's own after them.
    """
    stated: dict[str, ConfiguredColumns] = {}
    findings: list[Finding] = []
    for file in files:
        for entry in file.entries:
            sensor, name = entry.sensor, named.get(entry.sensor)
            if sensor in stated or sensor in taken or name == "none":
                continue
            among = [topic for topic in (find_topic(topics, name),) if topic] if name else topics
            fitting = [topic for topic in among if topic.count and not topic.problem and _defines(entry, topic)]
            known = name and fitting and message_layout_of(sensor, fitting[0])
            if file.origin == "usbldr" and (known or (not name and candidates(sensor, topics).best)):
                continue
            if fitting:
                topic = max(fitting, key=lambda topic: topic.count).name
                stated[sensor] = ConfiguredColumns(sensor, topic, entry.columns, entry.unit, entry.conventions)
                text = f"by the layout file {file.path.name} ({file.origin}, sha256 {file.sha256[:16]})"
                findings.append(Finding("LAYOUT-FILE", f"{topic}: read as {sensor} {text}", topic))
    return tuple(stated.values()), tuple(findings)


def _defines(entry: LayoutEntry, topic: TopicInfo) -> bool:
    """Return whether an entry is of a topic's type, and the topic has its fields."""
    stated = f"nmea/{entry.sentence.replace(',', '_')}" if entry.sentence else str(entry.type).replace("/msg/", "/")
    kind = topic.type.replace("/msg/", "/").replace(".", "/")
    same = kind.lower() == stated.lower() or (entry.type is not None and kind.lower().endswith(f"/{stated.lower()}"))
    return same and all(field_of(name, topic.fields, topic.arrays) for name in entry.columns.values())
