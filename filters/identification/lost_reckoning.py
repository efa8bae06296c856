"""Find a span of time in which DVL or compass do not read the vehicle's motion, although their records look possible.

As of a DVL over fish, or of a compass beside iron. From the span on all fixes lie beside dead reckoning, as in a run of
false fixes that lasts to the end of the log or from its beginning. The likeliest span about the edge of such a run is
sought without the DVL and without both sensors; evidence.py compares them. Filters use neither in the span that is
found: its fixes do not show which of the two is wrong.
"""

import math
from collections.abc import Sequence
from functools import cache

import numpy as np

from usbldr.filters.identification.false_runs import false_runs
from usbldr.filters.identification.identification import STRONG_ODDS
from usbldr.filters.identification.usbl_likelihood import MAX_FIXES, Member
from usbldr.filters.models.parameters import SensorChange
from usbldr.filters.replay.dead_reckoning import without_changes
from usbldr.filters.types import Mask, Timeline

REACHES_S = (0.0, 5.0, 10.0, 20.0, 40.0, 80.0, 160.0)  # of the span before and after the edge
FINER = (0.7, 0.8, 0.9, 1.0, 1.15, 1.3, 1.5)  # of a reach: between neighbours of REACHES_S
MOST = 0.25  # [-] of the log, by judgement: dead reckoning that is wrong for longer is not to be trusted at all
MARGIN_S = 5.0  # a span that is too long costs little, one that is too short displaces the rest of the track
BOTH = ("dvl", "compass")
USUAL_KIND = 0  # fixed: row of KINDS
LOST = (("dvl",), BOTH)  # sensors that a span is sought without
Lost = tuple[SensorChange, SensorChange]  # dead reckoning is lost, and there again


def lost_spans(
    timeline: Timeline, member: Member, log_likelihood: float = -math.inf, shifts_s: Sequence[float] = ()
) -> tuple[Lost, ...]:
    """Return the likeliest span of lost sensors about each edge of a run from the first fix or to the last, and shift.

    ``log_likelihood`` is that of the fixes by the best explanation without a span, ``shifts_s`` are times at which they
    seem to shift for good. A span that costs more than it gains is none.
    """
    none = false_runs(timeline, member)
    edges_s = {*_edges_s(timeline, none.false[:MAX_FIXES]), *filter(math.isfinite, shifts_s)}
    least = max(none.log_likelihood, log_likelihood) + cost(timeline)
    kinds = sorted({USUAL_KIND, none.kind})
    spans = (_likeliest(timeline, member, edge_s, lost, least, kinds) for edge_s in sorted(edges_s) for lost in LOST)
    return tuple(span for span in spans if span)


def without_both(changed: Sequence[SensorChange]) -> tuple[SensorChange, ...]:
    """Return changes that leave out both sensors where one is lost."""
    return tuple(one._replace(lost=BOTH) if one.lost else one for one in changed)


def cost(timeline: Timeline) -> float:
    """Return the log odds against a span: strong evidence, all of its possible times, and which sensors are lost."""
    return math.log(STRONG_ODDS * len(timeline.fix_time_s) * len(REACHES_S) ** 2 * len(LOST))


def _edges_s(timeline: Timeline, false: Mask) -> Sequence[float]:
    if not 0 < false.sum() < len(false):
        return []
    steps = np.flatnonzero(np.diff(false)) + 1  # the first fix after each
    return [float(timeline.fix_time_s[row]) for row, there in ((steps[0], false[0]), (steps[-1], false[-1])) if there]


def _likeliest(
    timeline: Timeline, member: Member, edge_s: float, lost: tuple[str, ...], least: float, kinds: Sequence[int]
) -> Lost | None:
    def tried(reach_s: tuple[float, float]) -> Lost:
        begin_s = max(edge_s - reach_s[0], float(timeline.time_s[0]))
        return SensorChange(begin_s, 0.0, 0.0, lost), SensorChange(edge_s + reach_s[1], 0.0, 0.0)

    @cache
    def log_likelihood(reach_s: tuple[float, float]) -> float:
        if not 0 < sum(reach_s) < MOST * float(timeline.time_s[-1]):
            return -math.inf
        return false_runs(without_changes(timeline, tried(reach_s)), member, kinds=kinds).log_likelihood

    before_s = after_s = REACHES_S[1]
    for finer in (False, False, True):
        tried_s = [after_s * part for part in FINER] if finer else REACHES_S
        _, after_s = max(((before_s, one_s) for one_s in tried_s), key=log_likelihood)
        tried_s = [before_s * part for part in FINER] if finer else REACHES_S
        before_s, _ = max(((one_s, after_s) for one_s in tried_s), key=log_likelihood)
        if log_likelihood((before_s, after_s)) < least:
            return None
    return tried((before_s + MARGIN_S, after_s + MARGIN_S))
