"""A TOML text changed line by line, so that all else, with its comments, stays as its author wrote it.

Sections have headers of their own, [name], and their keys stand on lines of their own, as people write them; whoever
changes a text parses it afterwards to see that it says what it should.
"""

import re
from collections.abc import Sequence

HEADER = re.compile(r"\s*\[+\s*([^\]]*?)\s*\]+\s*(#.*)?$")


def with_key(text: str, section: str, key: str, value: str) -> str:
    """Return the text in which a section states the key: in place of its old line, else at its end, else anew."""
    lines = text.splitlines()
    span = _span(lines, section)
    entry = f"{key} = {value}"
    if span is None:
        return "\n".join([*lines, "", f"[{section}]", entry]) + "\n"
    for at in span[1:]:
        if re.match(rf"\s*{re.escape(key)}\s*=", lines[at]):
            return "\n".join([*lines[:at], entry, *lines[at + 1 :]]) + "\n"
    end = max(at for at in span if at == span[0] or lines[at].strip())
    return "\n".join([*lines[: end + 1], entry, *lines[end + 1 :]]) + "\n"


def commented_out(text: str, section: str, why: str) -> str:
    """Return the text with a section turned into comments, under a line that says why."""
    lines = text.splitlines()
    span = _span(lines, section)
    if span is None:
        return text
    silent = [f"# {lines[at]}" if lines[at].strip() else "" for at in span]
    return "\n".join([*lines[: span[0]], f"# {why}", *silent, *lines[span[-1] + 1 :]]) + "\n"


def _span(lines: Sequence[str], section: str) -> range | None:
    """Return the lines of a section, its header first; None where it has none."""
    headers = [(at, match[1]) for at, line in enumerate(lines) if (match := HEADER.match(line))]
    for nth, (at, name) in enumerate(headers):
        if name == section:
            return range(at, headers[nth + 1][0] if nth + 1 < len(headers) else len(lines))
    return None
