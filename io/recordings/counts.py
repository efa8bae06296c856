"""The messages that a file says it holds, compared with those that were found: one comparison for all formats."""

from collections.abc import Mapping
from typing import Any

from usbldr.io.findings import Finding


def lost_messages(stated: Mapping[Any, int], found: Mapping[Any, int]) -> int:
    """Return how many messages are missing; those of one channel do not stand for those of another."""
    return sum(max(0, count - found.get(channel, 0)) for channel, count in stated.items())


def count_findings(whose: str, stated: Mapping[Any, int], found: Mapping[Any, int]) -> list[Finding]:
    """Return a finding if the numbers of messages per channel differ from those stated; ``whose``: who states them."""
    missing, surplus = lost_messages(stated, found), lost_messages(found, stated)
    if not missing and not surplus:
        return []
    total, more = sum(stated.values()), f" and {surplus} are not in {whose}" if surplus else ""
    text = f"{missing} of {total} messages in {whose} are missing{more}"
    text = text if missing else f"there are {surplus} messages more than the {total} that {whose} states"
    return [Finding("DAMAGED", text, lost_data=missing > 0)]
