"""A run of a method over a Timeline: drive its filter, keep the estimates, tell what happened.

The driver (with steps.py) alone knows grids, fixes and their times of validity; a filter only sees Steps.
"""

import bisect
import itertools
import math
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from usbldr.filters.errors import LogError, UsageError
from usbldr.filters.estimators.compiled import compiled
from usbldr.filters.estimators.hypotheses import reacquisition_texts
from usbldr.filters.estimators.kalman import KalmanFilter
from usbldr.filters.estimators.mode_updates import moment_matched
from usbldr.filters.estimators.multi_hypothesis import MultiHypothesisFilter
from usbldr.filters.estimators.protocol import Estimates, Filter, Prior, run_span
from usbldr.filters.estimators.rts_smoother import smooth
from usbldr.filters.evaluation.consistency import whiteness, whiteness_warning
from usbldr.filters.evaluation.noise_change import noise_warnings
from usbldr.filters.models.calibration import layout_for
from usbldr.filters.models.motion import VehicleMotion
from usbldr.filters.models.parameters import FalseStart, Parameters
from usbldr.filters.models.sigma_points import linearised
from usbldr.filters.models.states import StateLayout
from usbldr.filters.replay.dead_reckoning import Anchor, corrected, freed, open_covariance_m2, shift_covariance_m2
from usbldr.filters.replay.methods import FilterSettings, Method, method_named, methods_that
from usbldr.filters.replay.outage_recovery import outage_recoveries, recovery_warning
from usbldr.filters.replay.position_fixes import RivalFixes, false_run_covariance_m2, rival_fixes
from usbldr.filters.replay.prior import prior
from usbldr.filters.replay.running_filter import MAX_FIX_DELAY_S, RunningFilter
from usbldr.filters.replay.steps import StepSource, sensor_kinds, vehicle_motion
from usbldr.filters.types import Array, OutageRecovery, Reacquisition, Timeline, Trajectory, Update, Vector
from usbldr.filters.updates import UpdateTable, UpdateTableBuilder

MAX_OUTLIER_FRACTION = 0.6  # of the fixes: half of them may have a scalar in the second mode of eq. (23)
SINGULAR_TEXT = (
    "a covariance grew beyond what numbers can hold apart: start, sigmas and fixes are too far from each other to be "
    "of one dive; check [start] and the sigmas of the configuration"
)
MIN_ESS_RATIO = 0.05  # of N: below it on average the particles no longer tell the posterior
SPAN = 1000  # [epochs] that a filter is given at once: enough that the call itself costs nothing


class Stretch(NamedTuple):
    """The estimates of neighbouring epochs when they are reached, and updates that no late fix repeats any more."""

    first: int  # epoch
    estimates: Estimates
    settled: Iterable[Update]


class Estimated(NamedTuple):
    """The estimates of T epochs in n states."""

    mean: Array  # (T, n)
    cov: Array  # (T, n, n)
    ess: Vector  # (T,)
    acceptance: Vector  # (T,)
    updates: UpdateTable
    reacquisitions: tuple[Reacquisition, ...]
    recoveries: tuple[OutageRecovery, ...]
    late: int  # fixes that came too late to be used


def run(
    name: str,
    timeline: Timeline,
    parameters: Parameters,
    settings: FilterSettings = FilterSettings(),
    progress: Callable[[int, int], None] = lambda done, total: None,
    anchor: Anchor | None = None,
) -> Trajectory:
    """Run a method of METHODS over the timeline and return its track; a filter's has an estimate at every epoch.

    ``anchor`` is where dead reckoning starts; a filter has its own start. Raises UsageError for an unknown method and
    for settings that do not fit it, LogError if nothing gives the start or a covariance becomes singular.
    """
    method = method_named(name)
    if method.make_track is not None:
        return method.make_track(timeline, anchor)
    try:
        track = _run(method, timeline, parameters, settings, progress)
    except np.linalg.LinAlgError as err:
        raise LogError(f"{name}: {SINGULAR_TEXT}") from err
    texts = (*filter(None, [whiteness_warning(whiteness(track))]), *noise_warnings(track, parameters.false_fixes))
    return replace(track, warnings=(*track.warnings, *(f"{name}: {text}" for text in texts)))


def _run(
    method: Method,
    timeline: Timeline,
    parameters: Parameters,
    settings: FilterSettings,
    progress: Callable[[int, int], None],
) -> Trajectory:
    """Return the track of a filter, with what its covariance leaves open."""
    began = time.perf_counter()
    layout, name = layout_for(parameters.calibrate), method.name
    timeline = freed(corrected(timeline, parameters), parameters.settled)
    found = _estimated(method, timeline, parameters, layout, settings, progress)
    mean, cov, psi = found.mean, found.cov, layout.index("psi")
    for state, value in parameters.settled.items():
        mean[:, layout.existing(state)] += value
    x, y = layout.rows("x", "y")
    open_cov_m2 = open_covariance_m2(timeline, mean[:, x : y + 1], mean[:, psi], parameters)
    open_cov_m2 += shift_covariance_m2(timeline.fix_time_s, parameters.rival_shift or parameters.changes)
    at_fixes = timeline, mean[:, x : y + 1], mean[:, psi], np.array(parameters.usbl_lever_m[:2])
    rivals = rival_fixes(*at_fixes, parameters.usbl_sd_scale)
    open_cov_m2 += (
        rivals.cov_m2 if rivals else false_run_covariance_m2(*at_fixes, np.array(parameters.false_fixes, int))
    )
    cov[:, x : y + 1, x : y + 1] += open_cov_m2
    least_outage_s = min((o.end_s - o.start_s for o in timeline.outages if o.sensor == "usbl"), default=math.inf)
    return Trajectory(
        name,
        layout.names,
        timeline.time_s,
        mean,
        cov,
        found.updates,
        found.ess if method.draws else None,
        settings.particles if method.draws else 1,
        found.acceptance if method.draws else None,
        _warnings(method, settings, parameters.false_starts, found, rivals)
        + tuple(f"{name}: {text}" for text in reacquisition_texts(found.reacquisitions, least_outage_s))
        + tuple(f"{name}: {texts}" for one in found.recoveries if (texts := recovery_warning(one)) is not None),
        time.perf_counter() - began,
        found.reacquisitions,
        found.recoveries,
        settings.smooth,
        method.matched_noise and settings.gate is None,
        open_cov_m2,
    )


def _estimated(
    method: Method,
    timeline: Timeline,
    parameters: Parameters,
    layout: StateLayout,
    settings: FilterSettings,
    progress: Callable[[int, int], None],
) -> Estimated:
    """Return the estimates of all epochs, smoothed if the settings say so."""
    motion = vehicle_motion(timeline, parameters, layout)
    estimator = make_estimator(method, motion, settings, parameters)
    count, n = len(timeline.time_s), len(layout)
    mean, cov, widening = np.empty((count, n)), np.empty((count, n, n)), np.zeros((count, n))
    ess, acceptance, inflation = np.empty((3, count))
    reacquisitions: tuple[Reacquisition, ...] = ()
    updates = UpdateTableBuilder(expected=3 * count + 2 * (len(timeline.fix_time_s) + len(timeline.gps_time_s)))
    source = before = StepSource(timeline, parameters, layout)
    for source, (first, found, settled) in _stretches(estimator, timeline, parameters, layout, settings):
        k = slice(first, first + len(found.mean))
        mean[k], cov[k], ess[k], acceptance[k] = found.mean, found.cov, found.ess, found.acceptance
        inflation[k], reacquisitions = found.inflation, found.reacquisitions
        if found.widening is not None and settings.smooth:
            widening[k] = found.widening
        updates.add(settled)
        # of another attempt also the fixes that the one before had not settled
        since = first if source is before or not first else settled_before(source.time_s, source.time_s[first - 1])
        updates.add(source.left_out(since, mean[since : k.stop], cov[since : k.stop]))
        before = source
        progress(k.stop, count)
    progress(count, count)
    psi = layout.index("psi")
    mean[:, psi] = np.unwrap(mean[:, psi])  # hypotheses of an unknown heading may differ by whole turns
    recoveries = outage_recoveries(timeline, source.parameters, layout, mean, cov)
    if settings.smooth and method.smoother_transform is not None:
        mean, cov = smooth(mean, cov, inflation, widening, timeline.time_s, motion, method.smoother_transform)
    late = discarded_fixes(source) if settings.order == "arrival" else 0
    return Estimated(mean, cov, ess, acceptance, updates.table(), reacquisitions, recoveries, late)


def _stretches(
    estimator: Filter[Any], timeline: Timeline, parameters: Parameters, layout: StateLayout, settings: FilterSettings
) -> Iterator[tuple[StepSource, Stretch]]:
    """Yield the stretches of a run, each with the steps that it comes from.

    Which fixes are false is known at the end of a log. In the order of arrival, the fixes that follow false first ones
    show where the vehicle is: the filter then begins again without those.
    """
    attempts = [(0, parameters)]
    if settings.order == "arrival":
        known_s = [timeline.time_s[0], *(one.known_s for one in parameters.false_starts)]
        fixes = [0, *(one.fixes for one in parameters.false_starts)]
        epochs = np.searchsorted(timeline.time_s, known_s).tolist()
        attempts = [(k, replace(parameters, false_fixes=tuple(range(n)))) for k, n in zip(epochs, fixes, strict=True)]
    for (begin, known), (end, _) in itertools.pairwise([*attempts, (len(timeline.time_s), parameters)]):
        source, start = StepSource(timeline, known, layout), prior(timeline, known, layout)
        for stretch in FIX_ORDERS[settings.order](estimator, start, source, settings.seed):
            if stretch.first >= end:
                break
            if stretch.first >= begin:
                yield source, stretch


def make_estimator(
    method: Method, motion: VehicleMotion, settings: FilterSettings, parameters: Parameters
) -> Filter[Any]:
    """Return the filter of a method, with its hypotheses if it has them; raise UsageError for what it cannot do."""
    _check_settings(method, settings, parameters.calibrate)
    assert method.build is not None  # it is a filter
    kinds = sensor_kinds(parameters, motion.layout)
    estimator = compiled(method.build(motion, settings), kinds)
    guarded = method.multiple_hypotheses_by_default if settings.guard is None else settings.guard
    if not guarded:
        return estimator
    predictor = compiled(KalmanFilter(motion, linearised, moment_matched), kinds)
    return MultiHypothesisFilter(estimator, motion, predictor=predictor)


def _check_settings(method: Method, settings: FilterSettings, calibrate: Sequence[str]) -> None:
    """Raise UsageError for what this filter cannot do."""
    name = method.name
    if settings.gate is not None and not method.takes_gate:
        gated = methods_that(lambda m: m.takes_gate)
        raise UsageError(f"{name} weighs outliers and takes no gate (filters with a gate: {gated})")
    if settings.smooth and method.smoother_transform is None:
        smoothed = methods_that(lambda m: m.smoother_transform)
        raise UsageError(f"{name} is too far from a Gaussian to be smoothed (smoothed: {smoothed})")
    if settings.smooth and settings.order == "arrival":
        raise UsageError("a smoothed track knows the whole dive: leave --order at validity, or --smooth out")
    if settings.order not in FIX_ORDERS:
        raise UsageError(f"there is no order {settings.order!r} (orders: {', '.join(FIX_ORDERS)})")
    if settings.guard and not method.multiple_hypotheses:
        guarded = methods_that(lambda m: m.multiple_hypotheses)
        raise UsageError(f"{name} takes no guard (guarded: {guarded})")
    unable = [key for key in calibrate if key not in method.estimates]
    if unable:
        able = methods_that(lambda m: m.estimates.issuperset(unable))
        raise UsageError(f"{name} cannot estimate {', '.join(unable)} (filters that can: {able})")


def _warnings(
    method: Method,
    settings: FilterSettings,
    starts: Sequence[FalseStart],
    found: Estimated,
    rivals: RivalFixes | None,
) -> tuple[str, ...]:
    name, texts = method.name, list[str]()
    if settings.order == "arrival":
        texts += [
            f"{name}: later fixes show from {one.known_s:.0f} s on that the first {one.fixes} were false: it began "
            "again without them"
            for one in starts
        ]
    if found.late:
        texts.append(
            f"{name}: {found.late} fixes came more than {MAX_FIX_DELAY_S:g} s late, or after the end, and were not used"
        )
    outcomes = found.updates.of_sensor("usbl").outcome
    outliers = int(np.count_nonzero(outcomes != "used"))
    if rivals:
        texts.append(f"{name}: {rivals.text}")
    elif outliers > MAX_OUTLIER_FRACTION * len(outcomes):
        texts.append(
            f"{name}: {outliers} of {len(outcomes)} USBL fixes look like outliers, which they hardly all are: "
            "check frame, map origin, DVL axes and mounting, heading convention and clocks (usbldr info says what was "
            "taken)"
        )
    ratio = float(found.ess.mean()) / settings.particles
    if method.draws and ratio < MIN_ESS_RATIO:
        advice = "use more particles or check the noise model"
        texts.append(f"{name}: on average {ratio:.1%} of the particles count: {advice}")
    return tuple(texts)


def by_validity(estimator: Filter[Any], prior: Prior, source: StepSource, seed: int) -> Iterator[Stretch]:
    """Yield the estimates of all epochs, each with all fixes up to it."""
    belief, count = estimator.start(prior), len(source.time_s)
    for first in range(0, count, SPAN):
        steps = source.steps(first, min(first + SPAN, count))
        belief, estimates = run_span(estimator, belief, steps, range(len(steps)), seed)
        yield Stretch(first, estimates, estimates.updates)


def by_arrival(
    estimator: Filter[Any], prior: Prior, source: StepSource, seed: int, memory_s: float = MAX_FIX_DELAY_S
) -> Iterator[Stretch]:
    """Yield the estimate of every epoch with the fixes that had arrived by then, as on the vehicle.

    For a late fix the filter returns to its belief before the time of validity, uses the fix, and runs forward again.
    """
    used, arrived = source.arrivals()
    running = RunningFilter(estimator, prior, seed, memory_s)
    updates: dict[int, Sequence[Update]] = {}  # of the last epochs, which a late fix may run again
    times_s: list[float] = source.time_s.tolist()
    for k, time_s in enumerate(times_s):
        late = [j for j in used[arrived == k].tolist() if time_s - source.time_s[j] <= memory_s + 1e-9]
        first = min([k, *late])
        running.go_back(k - first)
        again = [running.advance(source.every.step(i, time_s)) for i in range(first, k + 1)]
        updates |= {first + i: estimate.updates for i, estimate in enumerate(again)}
        last = k + 1 == len(times_s)
        oldest = k + 1 if last else settled_before(times_s, time_s, memory_s)
        settled = [update for i in range(min(updates), oldest) for update in updates.pop(i)]
        yield Stretch(k, Estimates.of([again[-1]._replace(updates=())]), settled)


def settled_before(times_s: Sequence[float] | Vector, time_s: float, memory_s: float = MAX_FIX_DELAY_S) -> int:
    """Return the first epoch that a late fix may still run again at a time, of epochs at ``times_s``."""
    return bisect.bisect_left(times_s, time_s - memory_s - 1e-6)


def discarded_fixes(source: StepSource) -> int:
    """Return how many fixes arrived too late for `by_arrival`, or after the end."""
    used, arrived = source.arrivals()
    t = source.time_s
    inside = arrived < len(t)
    age_s = t[arrived[inside]] - t[used[inside]]
    return int(np.count_nonzero(~inside) + np.count_nonzero(age_s > MAX_FIX_DELAY_S + 1e-9))


FIX_ORDERS: Mapping[str, Callable[..., Iterator[Stretch]]] = {"validity": by_validity, "arrival": by_arrival}
