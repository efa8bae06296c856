"""Texts of other programs that are no tables, and what to do about them."""

import re
from collections.abc import Mapping

FOREIGN_TEXTS: Mapping[str, str] = {
    r"(?i)\s*<(!doctype )?(html|head|body|table)": "an HTML page, whatever its name; export the sheet as CSV",
    r"\s*<\?xml": "XML; export its values as CSV, with a line of names",
    r'\s*(\{\s*"|\[\s*[\[{])': "JSON, but not of one object a record; write it so, or as CSV",
    r"(?i)\s*(--.*\bdump\b|(create table|insert into|set \w+ ?=)\b)": "a dump of a database; export its tables as CSV",
    r"header:\r?\n\s+stamp:|(?s:.*)^---\r?\n\w+:": "what ros2 topic echo prints; read the recording that it came from, "
    "or write its values as CSV",
    r"[#%][A-Z0-9]+A,[^\r\n;]*;[^\r\n]*\*[0-9a-fA-F]{8}": "a NovAtel receiver's log; write it as CSV (NovAtel Convert) "
    "or log NMEA sentences",
    r"[\w.-]+(,[\w.-]+=[^,\s]+)* [\w.-]+=[^,\s]+(,[\w.-]+=[^,\s]+)* \d{10,19}\s*$": "InfluxDB's line protocol; "
    "write its points as CSV (influx query --raw)",
    r"\s*\(\d+\.\d+\)\s+\w+\s+[0-9A-Fa-f]+(#|\s+\[\d)": "a log of a CAN bus (candump); decode it by the DBC file "
    "of the bus, and write the values as CSV",
    r"[A-Z_]+\d*: \d{9,10}\.\d+\s": "a log of ACFR's vehicles (RAW.auv); write the lines of each sensor as CSV, "
    "with a line of names",
    r"\S+,F[DE],([0-9A-F]{1,2},)+mavlink_\w+_t,": "telemetry as Mission Planner writes it as text; read the .tlog file "
    "that it was made from",
    r"\d{4}-\d\d-\d\d [\d:.]+: \w+ \{\w+ : ": "what mavlogdump prints; read the .BIN or .tlog file "
    "that it was made from",
    r"\[\d{4}-\d\d-\d\d[T ]\d\d:\d\d:\d\d[^\r\n]*\w=\S": "a log of a program's messages; write their values as CSV, "
    "with a line of names",
}
"""By a pattern of their beginning."""


def foreign_text(head: bytes) -> str:
    """Return what a text is that no reader of records or tables reads, empty if it is none of these."""
    text = head.decode(errors="replace")
    return next((what for begin, what in FOREIGN_TEXTS.items() if re.match(begin, text, re.MULTILINE)), "")
