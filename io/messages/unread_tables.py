"""Tables and files of instruments that are not read, although they are named like a sensor: they hold its records."""

from collections.abc import Collection, Mapping, Sequence

from usbldr.filters.errors import listed
from usbldr.io.findings import Finding
from usbldr.io.messages.topic_names import names_ship, suggested_sensors, without_numbers
from usbldr.io.reader import TopicInfo


def unread_tables(
    topics: Sequence[TopicInfo], used: Mapping[str, str], unnamed: Collection[str], left: Collection[str]
) -> tuple[Finding, ...]:
    """Report the tables that are named like a sensor, and belong to it, but cannot be read; and unused files like one.

    Such a table has no header, or its name is that of the topic ``used`` but for a number, or its columns are those of
    a sensor whose topic the user has not named (``unnamed``). Sensors that are ``left`` out, or missing, do not count.
    A file of sentences or objects is named like a sensor that the log lacks, and holds no topic that is ``used``.
    """
    found: dict[str, Finding] = {}
    for topic in topics:
        for role in sorted(suggested_sensors(topic.name) - {*left}):
            alike = role in used and without_numbers(used[role]) == without_numbers(topic.name)
            alike |= role in unnamed and topic.type == f"usbldr/{role}"
            unread = topic.is_table and topic.problem and topic.name not in used.values()
            unnamed_columns = topic.first_row[:1] and topic.first_row[0][0] == "1"
            if unread and (alike or unnamed_columns):
                found.setdefault(topic.name, _unread(role, topic, used.get(role, "") if unnamed_columns else ""))
    files = {one.file for one in topics if one.name in used.values()}
    for topic in topics:
        of_file = suggested_sensors(topic.file.partition(".")[0]) if topic.type.startswith(("nmea/", "json/")) else ()
        for role in sorted({*of_file} - {*left, *used}):
            if topic.file not in files and not names_ship(topic.file):
                names = listed([one.name for one in topics if one.file == topic.file], 5)
                text = f"{topic.file}: named like the {role}, but of its topics ({names}) usbldr knows none as one; "
                text += f"state topic and columns under [{role}]; --{role} none leaves it out"
                found.setdefault(topic.file, Finding("TOPIC-UNREAD", text, topic.name, lost_data=True))
    return tuple(found.values())


def _unread(role: str, topic: TopicInfo, named: str) -> Finding:
    """Return that a table is not read; ``named``: the sensor's topic if the table has no line of names."""
    why = topic.problem.partition(",")[0] + f"; write that of {named} before it" if named else topic.problem
    text = f"{topic.name}: named like the {role}, and not read: {why}; rename it if it is no part of it"
    return Finding("TOPIC-UNREAD", text, topic.name, lost_data=True)
