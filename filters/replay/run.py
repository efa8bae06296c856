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
from usbldr.filters.estimators.multi_hypothesis import MultiHypothesisFilter, reacquisition_text
from usbldr.filters.estimators.protocol import Filter
from usbldr.filters.estimators.rts_smoother import smooth
from usbldr.filters.models import sigma_points
from usbldr.filters.models.calibration import STATES, layout_for
from usbldr.filters.models.motion import MotionModel, VehicleMotion
from usbldr.filters.models.parameters import DR_WALK_NAME, Assumptions
from usbldr.filters.models.states import StateLayout
from usbldr.filters.replay.late_fixes import FIX_ORDERS, MAX_FIX_DELAY_S, discarded_fixes
from usbldr.filters.replay.outage_recovery import outage_recoveries, recovery_warning
from usbldr.filters.replay.prior import prior
from usbldr.filters.replay.steps import StepSource
from usbldr.filters.types import Reacquisition, Timeline, Trajectory, Update, Vector


@dataclass(frozen=True, slots=True)
class FilterSettings:
    """The choices of a run that are the user's and not the log's."""

    particles: int = 100  # the N of the paper
    gate: float | None = None  # probability that a good reading passes; None: no gate
    seed: int = 0
    form: str = "mixture"  # of cpf and upf, see FORMS
    smooth: bool = False  # estimate each epoch from the whole dive, not from what came before it
    order: str = "validity"  # of late fixes, see orders.ORDERS
    guard: bool | None = None  # against clusters of false fixes; None: as the filter is by itself, see WARY


def _kalman(rule: sigma_points.MomentTransform) -> "FilterFactory":
    def build(motion: MotionModel, settings: FilterSettings) -> Filter[Any]:
        mode_update = mode_updates.moment_matched if settings.gate is None else mode_updates.Gate(settings.gate)
        return kalman.KalmanFilter(motion, rule, mode_update)

    return build


def _adaptive(rule: sigma_points.MomentTransform, factor: adaptive.InflationFactor) -> "FilterFactory":
    return lambda motion, settings: kalman.KalmanFilter(motion, rule, mode_updates.moment_matched, factor)


def _particles(rule: sigma_points.MomentTransform) -> "FilterFactory":
    return lambda motion, settings: CPF_FORMS[settings.form](motion, rule, settings.particles)


CPF_FORMS: Mapping[str, Callable[[MotionModel, sigma_points.MomentTransform, int], Filter[Any]]] = {
    "mixture": cpf.CubatureParticleFilter,
    "gaussian": cpf_gaussian.GaussianParticleFilter,
    "literal": cpf_literal.LiteralParticleFilter,
}
"""How the paper's text can be read: particles over noise modes (sound, the default), one Gaussian proposal (sound), by
the letter (collapses; for study)."""

FilterFactory = Callable[[MotionModel, FilterSettings], Filter[Any]]

FILTERS: Mapping[str, FilterFactory] = {
    "ekf": _kalman(sigma_points.linearised),
    "ckf": _kalman(sigma_points.cubature),
    "ukf": _kalman(sigma_points.unscented),
    "adf": lambda motion, settings: kalman.KalmanFilter(motion, sigma_points.cubature, mode_updates.collapse),
    "afukf": _adaptive(sigma_points.unscented, adaptive.FadingFactor()),
    "aekf": _adaptive(sigma_points.linearised, adaptive.CovarianceMatching()),
    "cpf": _particles(sigma_points.cubature),
    "upf": _particles(sigma_points.unscented),
    "pf": lambda motion, settings: pf.BootstrapParticleFilter(motion, settings.particles, start_seed=settings.seed),
    "pf-wekf": lambda motion, settings: pf_wekf.TwoStageFilter(motion, settings.particles),
}
"""A new filter is one line here."""

SMOOTHER_TRANSFORMS: Mapping[str, sigma_points.MomentTransform] = {
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
GUARDABLE = ("ekf", "ckf", "ukf", "adf", "cpf", "upf")
GUARDED_BY_DEFAULT = (
    "adf",
    "cpf",
    "upf",
)  # guarded unless told otherwise; the others stay what textbooks call by their name
SAMPLING_FILTERS = ("cpf", "upf", "pf", "pf-wekf")
FILTERS_WITH_FORMS = ("cpf", "upf")
MAX_OUTLIER_FRACTION = 0.6  # of the fixes: half of them may have a scalar in the second mode of eq. (23)
SINGULAR_TEXT = (
    "a covariance grew beyond what numbers can hold apart: start, sigmas and fixes are too far from each other to be "
    "of one dive; check [start] and the sigmas of the configuration"
)
MIN_ESS_RATIO = 0.05  # of N: below it on average the particles no longer tell the posterior


def run(
    name: str,
    timeline: Timeline,
    assumptions: Assumptions,
    settings: FilterSettings = FilterSettings(),
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Trajectory:
    """Run a filter of FILTERS over the timeline and return its estimate at every epoch.

    Raises UsageError for an unknown filter and for settings that do not fit it, LogError where nothing tells the start
    or a covariance becomes singular.
    """
    try:
        return _run(name, timeline, assumptions, settings, progress)
    except np.linalg.LinAlgError as err:
        raise LogError(f"{name}: {SINGULAR_TEXT}") from err


def _run(
    name: str,
    timeline: Timeline,
    assumptions: Assumptions,
    settings: FilterSettings,
    progress: Callable[[int, int], None],
) -> Trajectory:
    layout = layout_for(assumptions.calibrate)
    _check_settings(name, settings, layout)
    motion = VehicleMotion(layout, assumptions.process, assumptions.errors)
    estimator = FILTERS[name](motion, settings)
    guarded = name in GUARDED_BY_DEFAULT and settings.form == "mixture" if settings.guard is None else settings.guard
    if guarded:
        estimator = MultiHypothesisFilter(estimator, motion)
    began = time.perf_counter()
    count = len(timeline.time_s)
    mean, cov = np.empty((count, len(layout))), np.empty((count, len(layout), len(layout)))
    ess, acceptance, inflation = np.empty(count), np.empty(count), np.empty(count)
    by_epoch: dict[int, Sequence[Update]] = {}
    reacquisitions: tuple[Reacquisition, ...] = ()
    belief = estimator.start(prior(timeline, assumptions, layout))
    source = StepSource(timeline, assumptions, layout)
    for k, estimate, updates in FIX_ORDERS[settings.order](estimator, belief, source, settings.seed):
        mean[k], cov[k], ess[k], acceptance[k] = estimate.mean, estimate.cov, estimate.ess, estimate.acceptance
        inflation[k], reacquisitions = estimate.inflation, estimate.reacquisitions
        by_epoch.update(updates)
        if k % 100 == 0:
            progress(k, count)
    progress(count, count)
    recoveries = outage_recoveries(timeline, assumptions, layout, mean, cov)
    if settings.smooth:
        mean, cov = smooth(mean, cov, inflation, timeline.time_s, motion, SMOOTHER_TRANSFORMS[name])
    done = tuple(update for k in sorted(by_epoch) for update in by_epoch[k])
    late = discarded_fixes(source) if settings.order == "arrival" else 0
    sampled = name in SAMPLING_FILTERS
    particles = settings.particles if sampled else 1
    return Trajectory(
        track_name(name, settings),
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
        + tuple(f"{name}: {texts}" for one in recoveries if (texts := recovery_warning(one)) is not None),
        time.perf_counter() - began,
        reacquisitions,
        recoveries,
    )


def _check_settings(name: str, settings: FilterSettings, layout: StateLayout) -> None:
    """Raise UsageError for an unknown filter, and for what this one cannot do."""
    if name not in FILTERS:
        raise UsageError(f"there is no filter {name!r} (filters: {', '.join(FILTERS)})")
    if settings.gate is not None and name not in GATED:
        raise UsageError(f"{name} weighs outliers and takes no gate (filters with a gate: {', '.join(GATED)})")
    if settings.form not in CPF_FORMS or (settings.form != "mixture" and name not in FILTERS_WITH_FORMS):
        raise UsageError(
            f"{name} has no form {settings.form!r} (forms of {', '.join(FILTERS_WITH_FORMS)}: {', '.join(CPF_FORMS)})"
        )
    if settings.smooth and (name not in SMOOTHER_TRANSFORMS or settings.form == "literal"):
        raise UsageError(
            f"{name} is too far from a Gaussian to be smoothed (smoothed: {', '.join(SMOOTHER_TRANSFORMS)})"
        )
    if settings.smooth and settings.order == "arrival":
        raise UsageError("a smoothed track knows the whole dive: leave --order at validity, or --smooth out")
    if settings.order not in FIX_ORDERS:
        raise UsageError(f"there is no order {settings.order!r} (orders: {', '.join(FIX_ORDERS)})")
    if settings.guard and (name not in GUARDABLE or settings.form == "literal"):
        raise UsageError(f"{name} takes no guard (guarded: {', '.join(GUARDABLE)}, and no literal form)")
    if settings.form == "gaussian" and settings.particles <= len(layout):
        raise UsageError(
            f"the gaussian form of {name} makes a covariance of its particles: for {len(layout)} states it takes more "
            f"than {len(layout)} of them (--particles)"
        )
    if settings.form == "literal" and len(layout) > len(StateLayout()):
        raise UsageError("the literal form loses every constant state: leave --calibrate at none, or take another form")
    if name == "pf" and layout.existing(*STATES["heading"], *STATES["deviation"]):
        raise UsageError("pf samples the yaw, which fixes every error of the compass: calibrate those with cpf or adf")


def track_name(name: str, settings: FilterSettings) -> str:
    """Return what to call a filter's track."""
    return f"{name} smoothed" if settings.smooth and name in SMOOTHER_TRANSFORMS else name


def _warnings(
    name: str, settings: FilterSettings, assumptions: Assumptions, ess: Vector, updates: Sequence[Update], late: int
) -> tuple[str, ...]:
    texts: list[str] = []
    if any(number.name == DR_WALK_NAME for number in assumptions.noise_changes):
        texts.append(
            f"{name}: the fixes contradict dead reckoning, so that it may walk {assumptions.process.position_m:g} m in "
            "a second and the track follows them: check the DVL's bottom lock, its axes and mounting, and the compass"
        )
    if late:
        texts.append(
            f"{name}: {late} fixes came more than {MAX_FIX_DELAY_S:g} s late, or after the end, and were not used"
        )
    outcomes = [update.outcome for update in updates if update.sensor == "usbl"]
    outliers = len(outcomes) - outcomes.count("used")
    if outliers > MAX_OUTLIER_FRACTION * len(outcomes):
        texts.append(
            f"{name}: {outliers} of {len(outcomes)} USBL fixes look like outliers, which they hardly all are: "
            "check frame, map origin, DVL axes and mounting, heading convention and clocks (usbldr info says what was "
            "taken)"
        )
    if settings.form == "literal":
        texts.append(f"{name}: its literal form is for study only: it loses its particles in dead reckoning")
    ratio = float(ess.mean()) / settings.particles
    if name in SAMPLING_FILTERS and ratio < MIN_ESS_RATIO:
        advice = "use more particles or check the noise model"
        texts.append(f"{name}: on average {ratio:.1%} of the particles count: {advice}")
    return tuple(texts)
