"""Which topic is which sensor: by option, by configuration, else recognised by message type and topic name."""

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

from usbldr.filters.errors import LogError, UsageError, UsbldrError, did_you_mean, listed
from usbldr.io.findings import Finding
from usbldr.io.messages.configured import ConfiguredColumns, configured_layout, topic_with_columns
from usbldr.io.messages.layouts import MessageLayout
from usbldr.io.messages.registry import LAYOUTS, message_layout_of
from usbldr.io.messages.topic_names import NO_SENSOR, SECOND_CHOICE, names_ship, suggested_sensors, without_numbers
from usbldr.io.reader import TopicInfo

SENSORS = ("dvl", "compass", "usbl")
ROLES = (*SENSORS, "gps", "depth")


@dataclass(frozen=True, slots=True)
class TopicChoice:
    """A topic chosen for a role."""

    topic: TopicInfo
    layout: MessageLayout
    chosen_by: str  # "option", "configuration", "type and name"
    lower_ranked: tuple[TopicInfo, ...] = ()  # other possible topics, whose types rank lower
    continued: tuple["TopicChoice", ...] = ()  # the same topic in other types, whose messages are read with these

    @property
    def count(self) -> int:
        """Return the number of messages, of all types that are read."""
        return self.topic.count + sum(one.topic.count for one in self.continued)


class Candidates(NamedTuple):
    """The topics that could be a role."""

    best: list[TopicInfo]  # if there are several, the user has to choose
    lower_ranked: list[TopicInfo]  # those whose types rank lower
    of_ship: list[TopicInfo]  # those that are a ship's by name


@dataclass(frozen=True, slots=True)
class Roles:
    """The roles of a log, the errors of those that could not be filled, and what is to be said of the topics."""

    chosen: Mapping[str, TopicChoice]
    unresolved: Mapping[str, UsbldrError]
    findings: tuple[Finding, ...]  # topics that rank behind those chosen, those of a ship, and unreadable ones


def choose_roles(
    log: Path,
    topics: Sequence[TopicInfo],
    options: Mapping[str, str],
    configured: Mapping[str, str],
    columns: Sequence[ConfiguredColumns] = (),
) -> Roles:
    """Fill the roles; ``options`` and ``configured`` map roles to topics, or to "none" to leave a role empty.

    Raises UsageError for ``columns`` that do not fit their topic.
    """
    by_columns = {stated.sensor: stated for stated in columns}
    chosen: dict[str, TopicChoice] = {}
    errors: dict[str, UsbldrError] = {}
    left_to_ship: list[Finding] = []
    unread: dict[str, Finding] = {}
    for role in ROLES:
        name = options.get(role) or configured.get(role)
        stated = by_columns.get(role)
        if stated is not None and name is None:
            name = stated.topic or topic_with_columns(stated, [(t.name, t.fields, t.arrays) for t in topics], log)
        if name is not None and name != "none":
            try:
                by = "option" if role in options else "configuration"
                chosen[role] = topic_named(log, topics, role, name, by, stated)
            except LogError as err:
                errors[role] = err
            except UsageError as err:
                if stated is not None:
                    raise
                errors[role] = err
    for role in ROLES:
        if role not in options and role not in configured and role not in by_columns:
            taken = {choice.topic.name for choice in chosen.values()}
            found, lower_ranked, ships = candidates(role, topics, taken)
            left_to_ship += [_left_to_ship(role, ships)] if ships else []
            if len(found) > 1:
                errors[role] = UsageError(_choice_text(role, found), path=log)
            elif found:
                layout = message_layout_of(role, found[0])
                assert layout is not None, "a candidate has a layout"
                choice = TopicChoice(found[0], layout, "type and name", tuple(lower_ranked))
                chosen[role] = _with_other_types(role, choice, topics)
            elif unreadable := [topic for topic in topics if topic.type == f"usbldr/{role}" and topic.problem]:
                advice = "" if role in SENSORS else f"; --{role} none leaves it out"
                errors[role] = _unreadable(log, role, unreadable[0], advice)
            elif unusable := [topic for topic in topics if topic.count and _unusable(role, topic)]:
                errors[role] = _refused(log, role, unusable[0])
            elif missed := [one for one in topics if (one.problem or not one.count) and _named_for(role, one)]:
                unread[role] = _unread(role, missed[0])
    filled = {role: chosen[role] for role in ROLES if role in chosen}
    changed = [found for choice in filled.values() for found in _changed(choice, topics)]
    preferred = [_preferred(role, choice) for role, choice in filled.items() if choice.lower_ranked]
    left = {role for role in ROLES if "none" in (options.get(role), configured.get(role))}
    unnamed = [role for role, choice in filled.items() if choice.chosen_by == "type and name"]
    used = {role: choice.topic.name for role, choice in filled.items()}
    tables = unread_tables(topics, used, unnamed, left | errors.keys() | unread.keys())
    return Roles(filled, errors, (*preferred, *left_to_ship, *changed, *unread.values(), *tables))


def topic_named(
    log: Path,
    topics: Sequence[TopicInfo],
    role: str,
    name: str,
    chosen_by: str,
    stated: ConfiguredColumns | None = None,
) -> TopicChoice:
    """Return the topic of that name as the role, by its type or by the columns that the configuration states for it.

    Raises LogError or UsageError if that is impossible.
    """
    topic = existing_topic(log, topics, name, f" for the {role}")
    same = sorted((topic, *_of_other_type(topic, topics)), key=lambda one: -one.count)
    topic = next((one for one in same if not one.problem and (stated or _usable(role, one))), topic)
    if topic.problem:
        raise _unreadable(log, role, topic)
    if topic.count == 0:
        raise LogError(f"{topic.name}, chosen as {role}, has no messages", path=log)
    layout = configured_layout(stated, topic, log) if stated else message_layout_of(role, topic)
    if layout is None:
        known = ", ".join(sorted({layout.type for layout in LAYOUTS[role] if not layout.unsupported}))
        raise UsageError(
            f"{topic.name} is of type {topic.type}, which cannot be used as {role} (only {known}, or any type whose "
            f"fields are named by columns under [{role}]; usbldr info --fields {topic.name} lists them)",
            path=log,
        )
    if layout.unsupported:
        raise _refused(log, role, topic)
    return _with_other_types(role, TopicChoice(topic, layout, chosen_by), topics)


def existing_topic(log: Path, topics: Sequence[TopicInfo], name: str, purpose: str = "") -> TopicInfo:
    """Return the topic of that name; raise LogError with the nearest names if there is none."""
    topic = find_topic(topics, name)
    if topic is not None:
        return topic
    hint = did_you_mean(name, [topic.name for topic in topics], 3)
    known = listed([topic.name for topic in topics], 20) or "none"
    raise LogError(f"no topic {name}{purpose}{hint} (topics in this log: {known})", path=log)


def find_topic(topics: Iterable[TopicInfo], name: str) -> TopicInfo | None:
    """Return the topic of that name: with or without the first "/"; for CSV files also by its last part alone.

    A topic of a ship is none of the vehicle's: /ship/gps is not the file gps.csv.
    """
    topics = list(topics)
    slashed = "/" + name.lstrip("/")
    last = "/" + slashed.rpartition("/")[2]
    exact = [t for t in topics if t.name in (name, slashed)]
    alone = [t for t in topics if t.is_table and t.name == last and names_ship(last) == names_ship(slashed)]
    return max(exact or alone, key=lambda t: t.count, default=None)


def candidates(role: str, topics: Sequence[TopicInfo], taken: Collection[str] = ()) -> Candidates:
    """Return the topics that could be the role: those whose name suggests it before the others.

    Of these, without the ``taken`` ones, the types that rank first for their sensor. A ship's topics are apart, unless
    the role is the USBL, or the DVL has such a name too.
    """
    vehicle = [topic for topic in topics if not names_ship(topic.name)]
    if role == "usbl" or (_have_dvl(topics) and not _have_dvl(vehicle)):
        vehicle = list(topics)
    best, ranks = _suitable(role, vehicle)
    of_ship, _ = _suitable(role, [topic for topic in topics if topic not in vehicle])
    free = [topic for topic in best if topic.name not in taken]
    first = min((rank for topic in free if (rank := ranks[topic]) is not None), default=None)
    lower_ranked = [topic for topic in free if ranks[topic] not in (first, None)]
    firsts = [topic for topic in free if topic not in lower_ranked]
    firsts = [topic for topic in firsts if topic == find_topic(firsts, topic.name)]  # of several types the largest
    names = {topic.name for topic in firsts}
    return Candidates(firsts, [topic for topic in lower_ranked if topic.name not in names], of_ship)


def _of_other_type(topic: TopicInfo, topics: Iterable[TopicInfo]) -> list[TopicInfo]:
    """Return the messages of other types, or definitions of the type, that a topic has besides."""
    return [one for one in topics if one.name == topic.name and one.key != topic.key and one.count]


def _have_dvl(topics: Iterable[TopicInfo]) -> bool:
    return any("dvl" in suggested_sensors(topic.name) for topic in topics)


def _suitable(role: str, topics: Iterable[TopicInfo]) -> tuple[list[TopicInfo], dict[TopicInfo, int | None]]:
    """Return the topics that type and name suit best for the role, and the ranks of all that suit."""
    ranks: dict[TopicInfo, int | None] = {}
    hinted: list[TopicInfo] = []
    for topic in topics:
        layout = message_layout_of(role, topic)
        if layout is None or layout.unsupported or topic.count == 0 or topic.problem:
            continue
        if _found(role, topic, layout):
            ranks[topic] = layout.preference
            hinted += [topic] if role in suggested_sensors(topic.name) else []
    best = hinted or list(ranks)
    best = [topic for topic in best if not SECOND_CHOICE.search(topic.name)] or best
    return best, ranks


def _found(role: str, topic: TopicInfo, layout: MessageLayout) -> bool:
    """Return whether a topic of this layout is found as the role by its type and name."""
    hints = suggested_sensors(topic.name)
    own = topic.type == f"usbldr/{role}"  # usbldr's own or configured columns: its name adds nothing
    by_type = layout.recognised == "by type" and (role in hints or not hints or own)
    by_name = layout.recognised == "by type and name" and role in hints
    return (by_type or by_name) and not NO_SENSOR.search(topic.name.lower())


def _named_for(role: str, topic: TopicInfo) -> bool:
    """Return whether a topic would be found as the role if its messages had the fields that its type suggests."""
    return any(layout.named_by(topic) and _found(role, topic, layout) for layout in LAYOUTS[role])


def _preferred(role: str, choice: TopicChoice) -> Finding:
    others = "; ".join(f"{topic.name} ({topic.type}, {topic.count} messages)" for topic in choice.lower_ranked)
    text = f"{choice.topic.name}: used as {role}; its type is preferred to that of {others}; choose another with"
    return Finding("ROLE-PREFERRED", f"{text} --{role} TOPIC or with topic under [{role}]", choice.topic.name)


def _with_other_types(role: str, choice: TopicChoice, topics: Sequence[TopicInfo]) -> TopicChoice:
    """Return a choice with the topic's messages of other types that go on or before its own and mean the same."""
    continued = list[TopicChoice]()
    for topic in _of_other_type(choice.topic, topics):
        layout = choice.layout if choice.layout.by_columns else message_layout_of(role, topic)
        apart = not any(_at_once(topic, one) for one in (choice.topic, *(other.topic for other in continued)))
        if layout is not None and not topic.problem and apart and layout.means(topic, choice.layout, choice.topic):
            continued.append(TopicChoice(topic, layout, choice.chosen_by))
    return replace(choice, continued=tuple(continued))


def _at_once(a: TopicInfo, b: TopicInfo) -> bool:
    """Return whether messages of two types came at the same time, as of two senders."""
    return max(a.first_ns or 0, b.first_ns or 0) < min(a.last_ns or 0, b.last_ns or 0)


def _changed(choice: TopicChoice, topics: Sequence[TopicInfo]) -> Iterator[Finding]:
    read = [choice.topic, *(one.topic for one in choice.continued)]
    left = [other for other in _of_other_type(choice.topic, topics) if other not in read]
    of_read, of_left = (
        " and ".join(f"{one.count} messages of type {one.type}" for one in some) for some in (read, left)
    )
    text = f"{choice.topic.name}: its type changes within the log: {of_read} are read"
    if left or choice.continued:
        text += f", {of_left} are not" if left else ""
        yield Finding("TOPIC-TYPES" if left else "TOPIC-PARTS", text, choice.topic.name, lost_data=bool(left))


def _left_to_ship(role: str, topics: Sequence[TopicInfo]) -> Finding:
    names = " and ".join(topic.name for topic in topics)
    why = f"not used as {role}, because of the name taken for a sensor of the ship"
    text = f"{names}: {why}; a sensor of the vehicle is chosen with --{role} TOPIC or with topic under [{role}]"
    return Finding("ROLE-SHIP", text, topics[0].name)


def _unreadable(log: Path, role: str, topic: TopicInfo, advice: str = "") -> LogError:
    return LogError(f"{topic.name} cannot be read as {role}: {topic.problem}{advice}", path=log)


def _unread(role: str, topic: TopicInfo) -> Finding:
    why = f"cannot be read: {topic.problem}" if topic.count else topic.problem or "has no records"
    text = f"{topic.name}: could be the {role} by its type {topic.type}, but {why}; --{role} none leaves it out"
    return Finding("TOPIC-UNREAD", text, topic.name, lost_data=bool(topic.count) or topic.is_table)


def _usable(role: str, topic: TopicInfo) -> bool:
    layout = message_layout_of(role, topic)
    return layout is not None and not layout.unsupported


def _unusable(role: str, topic: TopicInfo) -> bool:
    """Return whether a topic's type is known for the role but not usable, not counting types used only if named."""
    layout = message_layout_of(role, topic)
    return layout is not None and layout.unsupported != "" and layout.recognised != "only when named"


def _refused(log: Path, role: str, topic: TopicInfo) -> UsageError:
    layout = message_layout_of(role, topic)
    why = f"cannot be used as {role}: it {layout.unsupported if layout else ''}"
    return UsageError(f"{topic.name} ({topic.type}) {why} (--{role} none: replay without {role})", path=log)


def _choice_text(role: str, found: Sequence[TopicInfo]) -> str:
    described = "; ".join(f"{t.name} ({t.type}, {t.count} messages, {t.rate_hz:.2f} Hz)" for t in found)
    choose = f"choose one with --{role} TOPIC or with topic under [{role}] in the configuration"
    return f"{len(found)} topics could be the {role}: {described}; {choose}"


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
                found.setdefault(topic.name, _unread_table(role, topic, used.get(role, "") if unnamed_columns else ""))
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


def _unread_table(role: str, topic: TopicInfo, named: str) -> Finding:
    """Return that a table is not read; ``named``: the sensor's topic if the table has no line of names."""
    why = topic.problem.partition(",")[0] + f"; write that of {named} before it" if named else topic.problem
    text = f"{topic.name}: named like the {role}, and not read: {why}; rename it if it is no part of it"
    return Finding("TOPIC-UNREAD", text, topic.name, lost_data=True)
