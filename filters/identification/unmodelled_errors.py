"""Find errors that no state of a filter has: of the heading over time and twice per turn, of the DVL, of the clocks.

A gyro drifts, a compass is beside soft iron, an axis of a DVL reads too much at any speed, the clock of the USBL runs
faster or slower than that of the vehicle. In the blocks of blocks.py, such an error is a Gaussian process: a trend and
a random walk over time, a sin 2 psi + b cos 2 psi, a constant velocity along each axis, and a trend of the latency. Its
evidence and its posterior mean follow from the covariance of the blocks: C. Rasmussen and C. Williams, "Gaussian
Processes for Machine Learning", MIT Press 2006, sections 2.2 and 5.4.1.
"""

import itertools
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from usbldr.filters.frames import rotated
from usbldr.filters.identification.blocks import Blocks, blocks_about, moved_by_changes, weighed
from usbldr.filters.identification.changes import MAX_NIS, FoundChanges
from usbldr.filters.identification.identification import STRONG_ODDS
from usbldr.filters.identification.linearisation import PASS_STATES, STEPS
from usbldr.filters.models.parameters import Parameters, SensorChange
from usbldr.filters.replay.dead_reckoning import drift_rates, freed, without_changes
from usbldr.filters.types import Array, Indices, Timeline, Vector
from usbldr.filters.windows import columns_at, integrated

TREND_SD_RAD = math.radians(5.0)  # from the first fix to the last, by judgement: a cheap gyro drifts by 10°/h
BIAS_SD_MPS = (
    0.03  # of each axis of a DVL, by judgement: specified are some mm/s; beams that are turned or fouled give more
)
CLOCK_SD_S = 1.0  # of the fixes' clock at the end, by judgement: unsynchronised clocks part by seconds per day
LINEARISATIONS = 2  # about the errors that are found


class Shape(NamedTuple):
    """How the error may move."""

    drifts: bool  # evenly, and as a random walk
    walk: float  # [-] its factor on the stated one
    twice_per_turn: bool
    dvl_bias: bool
    clock: bool  # of the fixes, as it drifts evenly

    @property
    def log_odds(self) -> float:
        """Against it."""
        return math.log(STRONG_ODDS) * (
            self.drifts + (self.walk > 0) + self.twice_per_turn + self.dvl_bias + self.clock
        )


OVER_TIME = (False, 0.0), (True, 0.0), (True, 3.0), (True, 10.0), (True, 30.0)
OTHERS = tuple(itertools.product((False, True), repeat=3))
SHAPES = tuple(Shape(*time, *others) for others in OTHERS for time in OVER_TIME)[1:]
FLEXIBLE = Shape(
    drifts=True, walk=10.0, twice_per_turn=True, dvl_bias=True, clock=True
)  # its evidence chooses point and noise


class _Fit(NamedTuple):
    """Blocks with an error of one shape."""

    shape: Shape
    moved: "_Moved"
    weights: Vector  # (m,) of the shape's functions, posterior means in their prior sigmas
    changes: tuple[SensorChange, ...]  # the same as the heading's error
    nis: float  # per number
    evidence: float  # log
    likelihood: float  # log, of these weights


class _Moved(NamedTuple):
    """How the errors move blocks, about their point, for one radian or m/s: at each block's begin or in all."""

    blocks: Blocks
    by_step: Array  # (2 B, B - 1)
    twice_per_turn: Array  # (2 B, 2)
    dvl_bias: Array  # (2 B, 2)
    clock: Array  # (2 B, 1) from the first fix on to one second at the last


def unmodelled_errors(timeline: Timeline, given: Parameters, blocks: Sequence[Blocks]) -> FoundChanges:
    """Return the likeliest error as changes of the heading; none if the evidence is not strong."""
    if not blocks:
        return FoundChanges()
    every = [_fitted(timeline, given, _moved(timeline, one), FLEXIBLE) for one in blocks]
    moved = max(every, key=lambda fit: fit.evidence).moved
    fits = [_fitted(timeline, given, moved, shape) for shape in SHAPES]
    best = max(fits, key=lambda fit: fit.evidence - fit.shape.log_odds)
    none = max(weighed(one.residual_m, one.cov_m2)[1] for one in blocks)
    if best.evidence - best.shape.log_odds < none or best.nis > MAX_NIS:
        return FoundChanges()
    for _ in range(LINEARISATIONS - 1):
        line = without_changes(timeline, best.changes)
        again = blocks_about(line, given, moved.blocks.about, moved.blocks.share)
        best = _fitted(line, given, _moved(line, again), best.shape, best.weights)
    return FoundChanges(best.changes, best.likelihood - best.evidence + best.shape.log_odds)


def _moved(timeline: Timeline, blocks: Blocks) -> _Moved:
    line, psi = freed(timeline, dict(zip(STEPS, blocks.about, strict=True))), timeline.dr_yaw_rad
    rate = drift_rates(line)["heading_bias"]
    axes = [-rotated(line.dr_yaw_rad, axis) for axis in np.eye(2)]
    rates = np.hstack([np.sin(2 * psi)[:, None] * rate, np.cos(2 * psi)[:, None] * rate, *axes])
    at_fixes = columns_at(timeline.fix_time_s, line.time_s, integrated(line.time_s, rates)).reshape(-1, 4, 2)
    rows: Indices = blocks.first[:, None] + np.arange(int(blocks.first[1]))
    constant = at_fixes[rows].mean(axis=1).swapaxes(1, 2).reshape(-1, 4)
    late = blocks.measurement_matrix[rows, :, PASS_STATES.index("usbl_latency")] * _elapsed(blocks.time_s)[rows, None]
    clock = late.mean(axis=1).reshape(-1, 1)
    turned = moved_by_changes(blocks, blocks.first[1:])[:, :, 0]
    return _Moved(blocks, turned, constant[:, :2], constant[:, 2:], clock)


def _elapsed(time_s: Vector) -> Vector:
    """Return the share of the time from the first to the last."""
    share: Vector = (time_s - time_s[0]) / (time_s[-1] - time_s[0])
    return share


def _fitted(timeline: Timeline, given: Parameters, moved: _Moved, shape: Shape, off: Vector | None = None) -> _Fit:
    """Fit the error to the blocks of a timeline; the error with the weights ``off`` is off its headings already."""
    blocks, errors = moved.blocks, given.errors
    t, cov_m2 = blocks.time_s[blocks.first], blocks.cov_m2
    dt_s = np.diff(t)
    trend, walk = dt_s / dt_s.sum() * TREND_SD_RAD, np.sqrt(dt_s) * shape.walk * errors.heading_walk_rad
    steps_rad = np.column_stack([trend, np.diag(walk)]) * shape.drifts
    twice_rad = errors.deviation_rad * shape.twice_per_turn
    bias_mps = BIAS_SD_MPS * shape.dvl_bias
    clock_s = CLOCK_SD_S * shape.clock
    constants = moved.twice_per_turn * twice_rad, moved.dvl_bias * bias_mps, moved.clock * clock_s
    columns = np.hstack([moved.by_step @ steps_rad, *constants])
    z = blocks.residual_m if off is None else blocks.residual_m + columns @ off
    explained, evidence = weighed(z, cov_m2 + columns @ columns.T)
    weights: Vector = columns.T @ explained
    _, likelihood = weighed(z - columns @ weights, cov_m2)
    after = np.append(0.0, np.cumsum(steps_rad @ weights[:-5]))
    between = (after + np.append(0.0, after[:-1])) / 2  # it steps from block to block
    constant = SensorChange(
        0.0,
        0.0,
        0.0,
        twice_per_turn_rad=tuple((twice_rad * weights[-5:-3]).tolist()),
        dvl_bias_mps=tuple((bias_mps * weights[-3:-1]).tolist()),
        gradual=True,
    )
    late_s = clock_s * float(weights[-1]) * _elapsed(blocks.time_s)[blocks.first + int(blocks.first[1]) // 2]
    starts_s = [float(timeline.time_s[0]), *t[1:].tolist()]
    changes = tuple(
        constant._replace(start_s=start_s, heading_bias_rad=turned_rad, fix_late_s=late)
        for start_s, turned_rad, late in zip(starts_s, between.tolist(), late_s.tolist(), strict=True)
    )
    return _Fit(shape, moved, weights, changes, float(z @ explained) / len(z), evidence, likelihood)
