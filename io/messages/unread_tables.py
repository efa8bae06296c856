"""Tables that cannot be read, although they belong to a sensor: they hold a part of its records."""

from collections.abc import Collection, Mapping, Sequence

from usbldr.io.findings import Finding
from usbldr.io.messages.topic_names import suggested_sensors, without_numbers
from usbldr.io.reader import TopicInfo


def unread_tables(
    topics: Sequence[TopicInfo], used: Mapping[str, str], unnamed: Collection[str], left: Collection[str]
) -> tuple[Finding, ...]:
    """Report the tables that are named like a sensor, and belong to it, but cannot be read.

    Such a table has no header, or its name is that of the topic ``used`` but for a number, or its columns are those of
    a sensor whose topic the user has not named (``unnamed``). Sensors that are ``left`` out, or missing, do not count.
    """
    found: dict[str, Finding] = {}
    for topic in topics:
        for role in sorted(suggested_sensors(topic.name) - {*left}):
            alike = role in used and without_numbers(used[role]) == without_numbers(topic.name)
            alike |= role in unnamed and topic.type == f"usbldr/{role}"
            unread = topic.is_table and topic.problem and topic.name not in used.values()
            if unread and (alike or (topic.first_row[:1] and topic.first_row[0][0] == "1")):
                found.setdefault(topic.name, _unread(role, topic))
    return tuple(found.values())


def _unread(role: str, topic: TopicInfo) -> Finding:
    text = f"{topic.name}: named like the {role}, and not read: {topic.problem}; rename it if it is no part of it"
    return Finding("TOPIC-UNREAD", text, topic.name, lost_data=True)
