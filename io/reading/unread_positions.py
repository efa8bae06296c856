"""Complete positions in tables that no sensor uses, of a log that lacks the USBL or the GPS."""

from collections.abc import Collection, Sequence

from usbldr.io.findings import Finding
from usbldr.io.messages.field_names import KEYS, NEEDED, OTHER, SHIP, named_column, words_of
from usbldr.io.messages.topic_names import NO_SENSOR, suggested_sensors
from usbldr.io.reader import TopicInfo
from usbldr.io.settings.toml_text import quoted
from usbldr.io.tables.csv_sheets import open_angle
from usbldr.io.tables.time_columns import time_of


def unread_positions(topics: Sequence[TopicInfo], missing: Collection[str]) -> list[Finding]:
    """Return a finding for each table with such a position, with the line that reads it.

    It is a loss if the USBL is missing, or the GPS that the names suggest. ``missing``: usbl, gps or both.
    """
    found: dict[str, Finding] = {}
    for topic in topics if missing else ():
        table = topic.table or topic.name
        names = topic.unused if topic.table else [name for name, _ in topic.first_row]
        columns = [column for name in names if (column := named_column(name, others=(OTHER,)))]
        by_key = {one.rule.key: one.name for one in reversed(columns) if one.known or open_angle(one.name)}
        pair = next((sorted(keys) for keys in NEEDED["gps"] if keys <= by_key.keys()), None)
        if pair is None or NO_SENSOR.search(table):
            continue
        words = words_of(by_key[pair[0]])
        suggested = suggested_sensors(f"{table} {words}")
        ship = bool(SHIP.search(words) or SHIP.search(table))
        role = min({"usbl", "gps"} & suggested or {"usbl"} & {*missing} or missing)
        key, clock = time_of(topic)
        if role not in missing or clock == "?":
            continue
        line = {key: clock, **{KEYS.get(key, key): by_key[key] for key in pair}}
        stated = ", ".join(f"{key} = {quoted(name)}" for key, name in line.items())
        why = ", because of the name taken for one of the ship" if ship else ""
        text = f"{table}: {by_key[pair[0]]} and {by_key[pair[1]]} are a position that no sensor uses{why}; if it is of "
        text += f"the {role}, state under [{role}]: topic = {quoted(table)}, columns = {{ {stated} }}; --{role} none "
        lost = not ship and (role == "usbl" or role in suggested)
        found.setdefault(table, Finding("TOPIC-UNREAD", f"{text}leaves it out", table, lost_data=lost))
    return list(found.values())
