"""Times of day without a date beside other times of the same dive: moved by whole days to where those are.

The others have dates, or all are without: then they begin in the evening of 1970-01-01, before a midnight.
"""

from collections.abc import Mapping

from usbldr.filters.errors import listed
from usbldr.io.findings import Finding
from usbldr.io.reader import Reader, utc
from usbldr.io.recordings.joined import UNDATED, JoinedLog, LogPart

DAY_NS = 86_400_000_000_000  # fixed
MAX_NAMES = 20  # of topics in a sentence
NEAR_NS = 3_600_000_000_000  # [ns] an hour, by judgement: sensors of one dive are not so long apart


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
    later_ns = {name: count * DAY_NS for name, count in days.items() if count}
    if not later_ns:
        return log
    first = f"the first day is {utc(min(later_ns.values()))[:10]}, as of the others"
    text = f"{listed(list(later_ns), MAX_NAMES)}: the times have no date; {first}"
    findings = (Finding("DATE-OF-OTHERS", text),) if dated else ()
    part = LogPart(log, dated=bool(dated), later_ns=later_ns)
    return JoinedLog(log.path, (part,), findings, time_units_ns=units_ns, kind=log.format)


def _days(first_ns: int, last_ns: int, begin_ns: int, end_ns: int) -> int | None:
    """Return by how many days a span has to be moved to overlap another, or to be near it; None if that is unknown."""
    first, last = (begin_ns - last_ns) // DAY_NS, (end_ns - first_ns) // DAY_NS + 1
    apart = {k: max(begin_ns - last_ns - k * DAY_NS, first_ns + k * DAY_NS - end_ns) for k in range(first, last + 1)}
    fitting = [k for k, ns in apart.items() if ns <= 0] or [k for k, ns in apart.items() if ns < NEAR_NS]
    return fitting[0] if len(fitting) == 1 else None
