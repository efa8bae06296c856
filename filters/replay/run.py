"""Every filter by its name, and a run of one over a Timeline: drive it, keep the estimates, tell what happened.

The driver (late_fixes.py, steps.py) alone knows grids, fixes and their times of validity; a filter only sees Steps.
"""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from usbldr.filters.errors import LogError, UsageError
from usbldr.filters.estimators import adaptive, cpf, cpf_gaussian, cpf_literal, kalman, mode_updates, pf, pf_wekf
from usbldr.filters.estimators.multi_hypothesis import Guarded, reacquisition_text
from usbldr.filters.estimators.protocol import Filter
from usbldr.filters.estimators.rts_smoother import smooth
from usbldr.filters.models import sigma_points
from usbldr.filters.models.calibration import STATES, layout_for
from usbldr.filters.models.motion import MotionModel, VehicleMotion
from usbldr.filters.models.parameters import DRIFT, Assumptions
from usbldr.filters.models.states import Layout
from usbldr.filters.replay.late_fixes import MEMORY_S, ORDERS, too_late
from usbldr.filters.replay.outage_recovery import return_warning, returned
from usbldr.filters.replay.prior import prior
from usbldr.filters.replay.steps import Readings
from usbldr.filters.types import Reacquisition, Timeline, Trajectory, Update, Vector


@dataclass(frozen=True, slots=True)
class Settings:
    """The choices of a run that are the user's and not the log's."""

    particles: int = 100
    gate: float | None = None  # probability that a good reading passes; None: no gate
    seed: int = 0
    form: str = "mixture"  # of cpf and upf, see FORMS
    smooth: bool = False  # estimate each epoch from the whole dive, not from what came before it
    order: str = "validity"  # of late fixes, see orders.ORDERS
    guard: bool | None = None  # against clusters of false fixes; None: as the filter is by itself, see WARY


def _kalman(rule: sigma_points.Rule) -> "Build":
    def build(motion: MotionModel, settings: Settings) -> Filter[Any]:
        policy = mode_updates.matched if settings.gate is None else mode_updates.Gate(settings.gate)
        return kalman.KalmanFilter(motion, rule, policy)

    return build


def _adaptive(rule: sigma_points.Rule, factor: adaptive.Factor) -> "Build":
    return lambda motion, settings: kalman.KalmanFilter(motion, rule, mode_updates.matched, factor)


def _particles(rule: sigma_points.Rule) -> "Build":
    return lambda motion, settings: FORMS[settings.form](motion, rule, settings.particles)


FORMS: Mapping[str, Callable[[MotionModel, sigma_points.Rule, int], Filter[Any]]] = {
    "mixture": cpf.CubatureParticleFilter,
    "gaussian": cpf_gaussian.GaussianParticleFilter,
    "literal": cpf_literal.LiteralParticleFilter,
}
"""How the paper's text can be read: particles over noise modes (sound, the default), one Gaussian proposal (sound), by
the letter (collapses; for study)."""

Build = Callable[[MotionModel, Settings], Filter[Any]]

FILTERS: Mapping[str, Build] = {
    "ekf": _kalman(sigma_points.linearised),
    "ckf": _kalman(sigma_points.cubature),
    "ukf": _kalman(sigma_points.unscented),
    "adf": lambda motion, settings: kalman.KalmanFilter(motion, sigma_points.cubature, mode_updates.collapse),
    "afukf": _adaptive(sigma_points.unscented, adaptive.Fading()),
    "aekf": _adaptive(sigma_points.linearised, adaptive.CovarianceMatching()),
    "cpf": _particles(sigma_points.cubature),
    "upf": _particles(sigma_points.unscented),
    "pf": lambda motion, settings: pf.BootstrapParticleFilter(motion, settings.particles, start_seed=settings.seed),
    "pf-wekf": lambda motion, settings: pf_wekf.TwoStageFilter(motion, settings.particles),
}
"""A new filter is one line here."""

SMOOTHED_BY: Mapping[str, sigma_points.Rule] = {
    "ekf": sigma_points.linearised,
    "ckf": sigma_points.cubature,
    "ukf": sigma_points.unscented,
    "adf": sigma_points.cubature,
    "cpf": sigma_points.cubature,
    "upf": sigma_points.unscented,
    "afukf": sigma_points.unscented,
    "aekf": sigma_points.linearised,
    "pf-wekf": sigma_points.linearised,
}
"""The filters whose belief is near a Gaussian, and the rule that passes it on."""

GATED = ("ekf", "ckf", "ukf")
GUARDED = ("ekf", "ckf", "ukf", "adf", "cpf", "upf")
WARY = ("adf", "cpf", "upf")  # guarded unless told otherwise; the others stay what textbooks call by their name
SAMPLED = ("cpf", "upf", "pf", "pf-wekf")
FORMED = ("cpf", "upf")
MOST_DOUBTED = 0.6  # of the fixes: half of them may have a scalar in the second mode of eq. (23)
SINGULAR = (
    "a covariance grew beyond what numbers can hold apart: start, sigmas and fixes are too far from each other to be "
    "of one dive; check [start] and the sigmas of the configuration"
)
TINY_ESS = 0.05  # of N: below it on average the particles no longer tell the posterior


def run(
    name: str,
    timeline: Timeline,
    assumptions: Assumptions,
    settings: Settings = Settings(),
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Trajectory:
    """Run a filter of FILTERS over the timeline and return its estimate at every epoch.

    Raises UsageError for an unknown filter and for settings that do not fit it, LogError where nothing tells the start
    or a covariance becomes singular.
    """
    try:
        return _run(name, timeline, assumptions, settings, progress)
    except np.linalg.LinAlgError as err:
        raise LogError(f"{name}: {SINGULAR}") from err


def _run(
    name: str, timeline: Timeline, assumptions: Assumptions, settings: Settings, progress: Callable[[int, int], None]
) -> Trajectory:
    layout = layout_for(assumptions.calibrate)
    _require_a_fit(name, settings, layout)
    motion = VehicleMotion(layout, assumptions.process, assumptions.errors)
    estimator = FILTERS[name](motion, settings)
    wary = name in WARY and settings.form == "mixture" if settings.guard is None else settings.guard
    if wary:
        estimator = Guarded(estimator, motion)
    began = time.perf_counter()
    count = len(timeline.time_s)
    mean, cov = np.empty((count, len(layout))), np.empty((count, len(layout), len(layout)))
    ess, acceptance, inflation = np.empty(count), np.empty(count), np.empty(count)
    by_epoch: dict[int, Sequence[Update]] = {}
    reacquisitions: tuple[Reacquisition, ...] = ()
    belief = estimator.start(prior(timeline, assumptions, layout))
    readings = Readings(timeline, assumptions, layout)
    for k, estimate, updates in ORDERS[settings.order](estimator, belief, readings, settings.seed):
        mean[k], cov[k], ess[k], acceptance[k] = estimate.mean, estimate.cov, estimate.ess, estimate.acceptance
        inflation[k], reacquisitions = estimate.inflation, estimate.reacquisitions
        by_epoch.update(updates)
        if k % 100 == 0:
            progress(k, count)
    progress(count, count)
    returns = returned(timeline, assumptions, layout, mean, cov)
    if settings.smooth:
        mean, cov = smooth(mean, cov, inflation, timeline.time_s, motion, SMOOTHED_BY[name])
    done = tuple(update for k in sorted(by_epoch) for update in by_epoch[k])
    late = too_late(readings) if settings.order == "arrival" else 0
    sampled = name in SAMPLED
    particles = settings.particles if sampled else 1
    return Trajectory(
        called(name, settings),
        layout.names,
        timeline.time_s,
        mean,
        cov,
        done,
        ess if sampled else None,
        particles,
        acceptance if sampled else None,
        _warnings(name, settings, assumptions, ess, done, late)
        + tuple(f"{name}: {reacquisition_text(one)}" for one in reacquisitions)
        + tuple(f"{name}: {said}" for one in returns if (said := return_warning(one)) is not None),
        time.perf_counter() - began,
        reacquisitions,
        returns,
    )


def _require_a_fit(name: str, settings: Settings, layout: Layout) -> None:
    """Raise UsageError for an unknown filter, and for what this one cannot do."""
    if name not in FILTERS:
        raise UsageError(f"there is no filter {name!r} (filters: {', '.join(FILTERS)})")
    if settings.gate is not None and name not in GATED:
        raise UsageError(f"{name} weighs outliers and takes no gate (filters with a gate: {', '.join(GATED)})")
    if settings.form not in FORMS or (settings.form != "mixture" and name not in FORMED):
        raise UsageError(f"{name} has no form {settings.form!r} (forms of {', '.join(FORMED)}: {', '.join(FORMS)})")
    if settings.smooth and (name not in SMOOTHED_BY or settings.form == "literal"):
        raise UsageError(f"{name} is too far from a Gaussian to be smoothed (smoothed: {', '.join(SMOOTHED_BY)})")
    if settings.smooth and settings.order == "arrival":
        raise UsageError("a smoothed track knows the whole dive: leave --order at validity, or --smooth out")
    if settings.order not in ORDERS:
        raise UsageError(f"there is no order {settings.order!r} (orders: {', '.join(ORDERS)})")
    if settings.guard and (name not in GUARDED or settings.form == "literal"):
        raise UsageError(f"{name} takes no guard (guarded: {', '.join(GUARDED)}, and no literal form)")
    if settings.form == "gaussian" and settings.particles <= len(layout):
        raise UsageError(
            f"the gaussian form of {name} makes a covariance of its particles: for {len(layout)} states it takes more "
            f"than {len(layout)} of them (--particles)"
        )
    if settings.form == "literal" and len(layout) > len(Layout()):
        raise UsageError("the literal form loses every constant state: leave --calibrate at none, or take another form")
    if name == "pf" and layout.present(*STATES["heading"], *STATES["deviation"]):
        raise UsageError("pf samples the yaw, which fixes every error of the compass: calibrate those with cpf or adf")


def called(name: str, settings: Settings) -> str:
    """Return what to call a filter's track."""
    return f"{name} smoothed" if settings.smooth and name in SMOOTHED_BY else name


def _warnings(
    name: str, settings: Settings, assumptions: Assumptions, ess: Vector, updates: Sequence[Update], late: int
) -> tuple[str, ...]:
    said: list[str] = []
    if any(number.name == DRIFT for number in assumptions.settled):
        said.append(
            f"{name}: the fixes contradict dead reckoning, so that it may walk {assumptions.process.position_m:g} m in "
            "a second and the track follows them: check the DVL's bottom lock, its axes and mounting, and the compass"
        )
    if late:
        said.append(f"{name}: {late} fixes came more than {MEMORY_S:g} s late, or after the end, and were not used")
    fixes = {update.row for update in updates if update.sensor == "usbl"}
    doubted = {update.row for update in updates if update.sensor == "usbl" and update.fate != "used"}
    if len(doubted) > MOST_DOUBTED * len(fixes):
        said.append(
            f"{name}: {len(doubted)} of {len(fixes)} USBL fixes look like outliers, which they hardly all are: check "
            "frame, map origin, DVL axes and mounting, heading convention and clocks (usbldr info says what was taken)"
        )
    if settings.form == "literal":
        said.append(f"{name}: its literal form is for study only: it loses its particles in dead reckoning")
    ratio = float(ess.mean()) / settings.particles
    if name in SAMPLED and ratio < TINY_ESS:
        advice = "use more particles or check the noise model"
        said.append(f"{name}: on average {ratio:.1%} of the particles count: {advice}")
    return tuple(said)
