"""Every filter by its name, and a run of one over a Timeline: drive it, keep the estimates, tell what happened.

The driver (orders.py, readings.py) alone knows grids, fixes and their times of validity; a filter only sees Steps.
"""

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from usbldr.filters import adaptive, cpf, gaussian_cpf, kalman, literal_cpf, pf, policies, rules, weighted_ekf
from usbldr.filters.aiding import gps_fixes, usbl_fixes
from usbldr.filters.assumptions import DRIFT, UNKNOWN_START, Assumptions
from usbldr.filters.baselines import carried_back, start_from
from usbldr.filters.calibration import layout_for, prior_sd
from usbldr.filters.errors import LogError, UsageError
from usbldr.filters.filter import Filter, Prior
from usbldr.filters.guard import Guarded, reacquisition_text
from usbldr.filters.layout import Layout
from usbldr.filters.motion import MotionModel, VehicleMotion
from usbldr.filters.orders import MEMORY_S, ORDERS, too_late
from usbldr.filters.readings import Readings
from usbldr.filters.returns import return_warning, returned
from usbldr.filters.smoothing import smooth
from usbldr.filters.types import Array, Reacquisition, Timeline, Trajectory, Update, Vector


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


def _kalman(rule: rules.Rule) -> "Build":
    def build(motion: MotionModel, settings: Settings) -> Filter[Any]:
        policy = policies.matched if settings.gate is None else policies.Gate(settings.gate)
        return kalman.KalmanFilter(motion, rule, policy)

    return build


def _adaptive(rule: rules.Rule, factor: adaptive.Factor) -> "Build":
    return lambda motion, settings: kalman.KalmanFilter(motion, rule, policies.matched, factor)


def _particles(rule: rules.Rule) -> "Build":
    return lambda motion, settings: FORMS[settings.form](motion, rule, settings.particles)


FORMS: Mapping[str, Callable[[MotionModel, rules.Rule, int], Filter[Any]]] = {
    "mixture": cpf.CubatureParticleFilter,
    "gaussian": gaussian_cpf.GaussianParticleFilter,
    "literal": literal_cpf.LiteralParticleFilter,
}
"""How the paper's text can be read: particles over noise modes (sound, the default), one Gaussian proposal (sound), by
the letter (collapses; for study)."""

Build = Callable[[MotionModel, Settings], Filter[Any]]

FILTERS: Mapping[str, Build] = {
    "ekf": _kalman(rules.linearised),
    "ckf": _kalman(rules.cubature),
    "ukf": _kalman(rules.unscented),
    "adf": lambda motion, settings: kalman.KalmanFilter(motion, rules.cubature, policies.collapse),
    "afukf": _adaptive(rules.unscented, adaptive.Fading()),
    "aekf": _adaptive(rules.linearised, adaptive.CovarianceMatching()),
    "cpf": _particles(rules.cubature),
    "upf": _particles(rules.unscented),
    "pf": lambda motion, settings: pf.BootstrapParticleFilter(motion, settings.particles, start_seed=settings.seed),
    "pf-wekf": lambda motion, settings: weighted_ekf.TwoStageFilter(motion, settings.particles),
}
"""A new filter is one line here."""

SMOOTHED_BY: Mapping[str, rules.Rule] = {
    "ekf": rules.linearised,
    "ckf": rules.cubature,
    "ukf": rules.unscented,
    "adf": rules.cubature,
    "cpf": rules.cubature,
    "upf": rules.unscented,
    "afukf": rules.unscented,
    "aekf": rules.linearised,
    "pf-wekf": rules.linearised,
}
"""The filters whose belief is near a Gaussian, and the rule that passes it on."""

GATED = ("ekf", "ckf", "ukf")
GUARDED = ("ekf", "ckf", "ukf", "adf", "cpf", "upf")
WARY = ("adf", "cpf", "upf")  # guarded unless told otherwise; the others stay what textbooks call by their name
SAMPLED = ("cpf", "upf", "pf", "pf-wekf")
FORMED = ("cpf", "upf")
MOST_DOUBTED = 0.6  # of the fixes: half of them may have a scalar in the second mode of eq. (23)
NO_START = (
    "no USBL fix tells where a filter starts: state [start] east_m, north_m, sd_m in the configuration, or let GPS aid "
    "it where the vehicle is at the surface (--aid gps@FROM:TO)"
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

    Raises UsageError for an unknown filter or a gate on one that has none, LogError without anything to start from.
    """
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
    layout = layout_for(assumptions.calibrate)
    if settings.form == "literal" and assumptions.calibrate:
        raise UsageError("the literal form loses every constant state: leave --calibrate at none, or take another form")
    if name == "pf" and {"heading", "deviation"} & set(assumptions.calibrate):
        raise UsageError("pf samples the yaw, which fixes every error of the compass: calibrate those with cpf or adf")
    motion = VehicleMotion(layout, assumptions.process, assumptions.errors)
    estimator = FILTERS[name](motion, settings)
    wary = name in WARY and settings.form == "mixture" if settings.guard is None else settings.guard
    if wary and name in GUARDED and settings.form != "literal":
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


def called(name: str, settings: Settings) -> str:
    """Return what to call a filter's track."""
    return f"{name} smoothed" if settings.smooth and name in SMOOTHED_BY else name


def prior(timeline: Timeline, assumptions: Assumptions, layout: Layout) -> Prior:
    """Return the belief at the first epoch: a stated start, or what the first fixes say.

    Yaw and velocity start at the first compass and DVL records with a wide sigma: those records are measured again. A
    compass that errs tells only the sum of yaw and its errors, so the prior ties them to each other; so it does with
    the position where fixes are carried back by sensors that err.
    """
    carried = np.zeros((2, len(layout)))  # what carrying the fixes back makes of each error of the sensors
    if assumptions.start is not None:
        position = np.array([assumptions.start.east_m, assumptions.start.north_m])
        position_sd_m = assumptions.start.sd_m
    else:
        time_s, fix_m = starting_fixes(timeline, assumptions)
        if not len(time_s):
            raise LogError(NO_START)
        position, position_sd_m = start_from(timeline, time_s, fix_m)
        carried = carried_back(timeline, time_s, layout.names)
        motion = VehicleMotion(layout, assumptions.process, assumptions.errors)
        walked_m2 = float(motion.noise(0.0, max(0.0, float(time_s[0])))[layout.index("x")])
        position_sd_m = math.sqrt(position_sd_m**2 + walked_m2)
    start = assumptions.start or UNKNOWN_START
    yaw_rad = float(timeline.dr_yaw_rad[0])
    known: dict[str, tuple[float, float]] = {
        "psi": (yaw_rad, start.sd_yaw_rad),
        "u": (float(timeline.dr_mps[0, 0]), start.sd_mps),
        "v": (float(timeline.dr_mps[0, 1]), start.sd_mps),
        "r": (0.0, start.sd_radps),
        "x": (float(position[0]), position_sd_m),
        "y": (float(position[1]), position_sd_m),
    }
    known |= {name: (0.0, sd) for name, sd in prior_sd(assumptions.errors).items()}
    mean, sd = np.array([known[name] for name in layout.names]).T
    P = np.diag(sd**2)
    h = {"heading_bias": 1.0, "deviation_sin": math.sin(yaw_rad), "deviation_cos": math.cos(yaw_rad)}
    seen = {layout.index(name): share for name, share in h.items() if name in layout.names}
    if seen:
        psi, rows, share = layout.index("psi"), list(seen), np.array(list(seen.values()))
        P[psi, psi] = float(timeline.yaw_sd_rad[0]) ** 2 + share**2 @ sd[rows] ** 2
        P[psi, rows] = P[rows, psi] = -share * sd[rows] ** 2
    place = list(layout.rows("x", "y"))
    tied = carried @ P
    P[place] += tied
    P[:, place] += tied.T
    P[np.ix_(place, place)] += tied @ carried.T
    return Prior(mean, P)


def starting_fixes(timeline: Timeline, assumptions: Assumptions) -> tuple[Vector, Array]:
    """Return times and places of the fixes that tell where a filter starts: USBL, or GPS that aids before it; or none.

    (F,) and (F, 2).
    """
    usbl, gps = usbl_fixes(timeline, assumptions, Layout()), gps_fixes(timeline, assumptions)
    first = min((usbl, gps), key=lambda fixes: float(fixes.time_s[0]) if len(fixes.time_s) else math.inf)
    return first.time_s, first.position_m


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
