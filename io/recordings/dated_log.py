"""Times of day without a date beside other times of the same dive: moved by whole days to where those are.

The others have dates, or all are without: then they begin in the evening of 1970-01-01, before a midnight.
"""

from collections.abc import Iterator, Mapping, Sequence

from usbldr.filters.errors import listed
from usbldr.io.findings import Finding
from usbldr.io.reader import Reader, Records, TopicInfo, utc
from usbldr.io.recordings.joined import UNDATED, moved_records, moved_topic

DAY_NS = 86_400_000_000_000  # fixed
MAX_NAMES = 20  # of topics in a sentence
NEAR_NS = 3_600_000_000_000  # [ns] an hour, by judgement: sensors of one dive are not so long apart


class DatedLog:
    """A log, some of whose topics are moved by whole days."""

    def __init__(self, whole: Reader, days: Mapping[str, int], units_ns: Mapping[str, int], dated: bool) -> None:
        """Take the log, the days by topic, the units of fields that the user calls times, and if others have dates."""
        self.path, self.format, self._whole, self._units_ns, self._dated = (
            whole.path,
            whole.format,
            whole,
            units_ns,
            dated,
        )
        self._earlier_ns = {topic: -count * DAY_NS for topic, count in days.items()}

    def topics(self) -> tuple[TopicInfo, ...]:
        """List the topics by their dates."""
        return tuple(moved_topic(topic, self._earlier_ns.get(topic.name, 0)) for topic in self._whole.topics())

    def blocks(self, wanted: Mapping[str, Sequence[str]]) -> Iterator[tuple[str, Records]]:
        """Read the topics in blocks by their dates."""
        for topic, records in self._whole.blocks(wanted):
            yield topic, moved_records(records, self._earlier_ns.get(topic, 0), self._units_ns)

    def findings(self) -> tuple[Finding, ...]:
        """Report the dates that are taken from other topics."""
        if not self._dated:
            return self._whole.findings()
        days = {topic: utc(-earlier_ns)[:10] for topic, earlier_ns in self._earlier_ns.items()}
        first = f"the first day is {min(days.values())}, as of the others"
        text = f"{listed(list(days), MAX_NAMES)}: the times have no date; {first}"
        return (Finding("DATE-OF-OTHERS", text), *(one for one in self._whole.findings() if one.code not in UNDATED))


def with_dates(log: Reader, units_ns: Mapping[str, int]) -> Reader:
    """Return the log with times without a date beside the others; as it is if these are far, or fit several days."""
    spans = {one.name: (one.first_ns, one.last_ns or 0) for one in log.topics() if one.first_ns is not None}
    if not any(finding.code in UNDATED for finding in log.findings()):
        return log
    undated = {name: span for name, span in spans.items() if span[0] < 2 * DAY_NS}
    dated = spans.keys() - undated.keys()
    fixed = dated or {name for name, (first, _) in undated.items() if first >= DAY_NS // 2}
    if not fixed:
        return log
    begin, end = min(spans[name][0] for name in fixed), max(spans[name][1] for name in fixed)
    days = {name: _days(*span, begin, end) for name, span in undated.items() if name not in fixed}
    if dated and None in days.values():
        return log  # some would have no date
    days = {name: count for name, count in days.items() if count}
    return DatedLog(log, days, units_ns, bool(dated)) if days else log


def _days(first_ns: int, last_ns: int, begin_ns: int, end_ns: int) -> int | None:
    """Return by how many days a span has to be moved to overlap another, or to be near it; None if that is unknown."""
    first, last = (begin_ns - last_ns) // DAY_NS, (end_ns - first_ns) // DAY_NS + 1
    apart = {k: max(begin_ns - last_ns - k * DAY_NS, first_ns + k * DAY_NS - end_ns) for k in range(first, last + 1)}
    fitting = [k for k, ns in apart.items() if ns <= 0] or [k for k, ns in apart.items() if ns < NEAR_NS]
    return fitting[0] if len(fitting) == 1 else None
