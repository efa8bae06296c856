"""Every way of making a track, by its name on the command line: what it is, how it is made, and what it can do.

Who wants to know whether a method draws particles, takes a gate or can be smoothed asks this table.
"""

import functools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from usbldr.filters import plugins
from usbldr.filters.errors import LogError, UsageError, did_you_mean
from usbldr.filters.estimators import adaptive, cpf, kalman, mode_updates, pf, pf_wekf
from usbldr.filters.estimators.protocol import Filter
from usbldr.filters.models.calibration import STATES
from usbldr.filters.models.motion import MotionModel
from usbldr.filters.models.sigma_points import MomentTransform, cubature, linearised, unscented
from usbldr.filters.replay import dead_reckoning
from usbldr.filters.replay.dead_reckoning import Anchor
from usbldr.filters.types import Timeline, Trajectory, track_label


@dataclass(frozen=True, slots=True)
class FilterSettings:
    """The settings of a filter."""

    particles: int = 100  # the N of the paper
    gate: float | None = None  # probability that a good measurement passes; None: no gate
    seed: int = 0
    smooth: bool = False  # estimate each epoch from the whole dive, not from what came before it
    order: str = "validity"  # of late fixes, see run.FIX_ORDERS
    guard: bool | None = None  # multiple hypotheses against clusters of false fixes; None: the method's default


FilterFactory = Callable[[MotionModel, FilterSettings], Filter[Any]]
TrackMaker = Callable[[Timeline, Anchor | None], Trajectory]


@dataclass(frozen=True, slots=True)
class Method:
    """One row of METHODS: a filter has ``build``, a track without a filter has ``make_track``."""

    name: str
    description: str  # one line for help texts
    build: FilterFactory | None = None
    make_track: TrackMaker | None = None
    smoother_transform: MomentTransform | None = None  # by which a smoother goes back; None: too far from a Gaussian
    draws: bool = False  # it has particles, and its track depends on the seed
    takes_gate: bool = False
    matched_noise: bool = False  # without a gate its measurements have the covariance of the whole mixture
    multiple_hypotheses: bool = False  # a MultiHypothesisFilter may run around it
    multiple_hypotheses_by_default: bool = False
    estimates: frozenset[str] = frozenset(STATES)  # the keys of calibration.STATES that it can estimate
    sensors: tuple[str, ...] = ("dvl", "compass")  # without which there is no track
    anchored: bool = False  # it starts at an Anchor
    scored_at_fixes: bool = False  # errors are taken at the fixes' own times, not on the slow grid
    colour: str = "#44aa99"  # in every picture

    @property
    def is_filter(self) -> bool:
        """Whether it has a belief: a start, states, measurements."""
        return self.build is not None


def _kalman(name: str, description: str, rule: MomentTransform, colour: str) -> Method:
    """Return a Kalman filter that matches its noise to the mixture, or gates its measurements."""

    def build(motion: MotionModel, settings: FilterSettings) -> Filter[Any]:
        mode_update = mode_updates.moment_matched if settings.gate is None else mode_updates.Gate(settings.gate)
        return kalman.KalmanFilter(motion, rule, mode_update)

    return Method(
        name,
        description,
        build,
        smoother_transform=rule,
        takes_gate=True,
        matched_noise=True,
        multiple_hypotheses=True,
        colour=colour,
    )


def _adaptive(rule: MomentTransform, factor: adaptive.InflationFactor) -> FilterFactory:
    return lambda motion, settings: kalman.KalmanFilter(motion, rule, mode_updates.moment_matched, factor)


def _particles(name: str, description: str, rule: MomentTransform, colour: str) -> Method:
    """Return a particle filter over the modes of the noise."""
    return Method(
        name,
        description,
        lambda motion, settings: cpf.CubatureParticleFilter(motion, rule, settings.particles),
        smoother_transform=rule,
        draws=True,
        multiple_hypotheses=True,
        multiple_hypotheses_by_default=True,
        colour=colour,
    )


def _dead_reckoning(timeline: Timeline, anchor: Anchor | None) -> Trajectory:
    if anchor is None:
        raise LogError(
            "dead reckoning has nothing to start from: give --dr-from first-gps or LAT,LON, or state [start]"
        )
    return dead_reckoning.dr(timeline, anchor.position_m, anchor.time_s)


METHODS: dict[str, Method] = {
    method.name: method
    for method in (
        _kalman("ekf", "extended Kalman filter: one Gaussian, first derivatives, matched noise", linearised, "#d55e00"),
        _kalman("ckf", "cubature Kalman filter: one Gaussian, cubature points, matched noise", cubature, "#882255"),
        _kalman("ukf", "unscented Kalman filter: one Gaussian, unscented points, matched noise", unscented, "#cc79a7"),
        Method(
            "adf",
            "assumed density filter: one Gaussian, noise mixture collapsed after each measurement",
            lambda motion, settings: kalman.KalmanFilter(motion, cubature, mode_updates.collapse),
            smoother_transform=cubature,
            multiple_hypotheses=True,
            multiple_hypotheses_by_default=True,
            colour="#009e73",
        ),
        Method(
            "afukf",
            "fading-memory ukf: covariance inflated while fixes disagree",
            _adaptive(unscented, adaptive.FadingFactor()),
            smoother_transform=unscented,
            matched_noise=True,
            colour="#aa4499",
        ),
        Method(
            "aekf",
            "ekf that matches its predicted covariance to its innovations",
            _adaptive(linearised, adaptive.CovarianceMatching()),
            smoother_transform=linearised,
            matched_noise=True,
            colour="#661100",
        ),
        _particles(
            "cpf",
            "cubature particle filter: particles over noise modes, each a cubature Kalman filter",
            cubature,
            "#0072b2",
        ),
        _particles("upf", "unscented particle filter: cpf with unscented points", unscented, "#56b4e9"),
        Method(
            "pf",
            "bootstrap particle filter",
            lambda motion, settings: pf.BootstrapParticleFilter(motion, settings.particles, start_seed=settings.seed),
            draws=True,
            estimates=frozenset(STATES) - {"heading", "deviation"},  # a sampled yaw fixes every error of the compass
            colour="#332288",
        ),
        Method(
            "pf-wekf",
            "ekf; fixes weighted by agreement with recent fixes propagated by DR",
            lambda motion, settings: pf_wekf.TwoStageFilter(motion, settings.particles),
            smoother_transform=linearised,
            draws=True,
            colour="#117733",
        ),
        Method(
            "nudge",
            "DR corrected by a shift to the fixes, without a filter",
            make_track=lambda timeline, anchor: dead_reckoning.nudge(timeline),
            estimates=frozenset(),
            sensors=("dvl", "compass", "usbl"),
            colour="#999933",
        ),
        Method(
            "dr",
            "dead reckoning by DVL and compass",
            make_track=_dead_reckoning,
            estimates=frozenset(),
            anchored=True,
            colour="#7f7f7f",
        ),
        Method(
            "usbl",
            "the raw fixes",
            make_track=lambda timeline, anchor: dead_reckoning.usbl(timeline),
            estimates=frozenset(),
            sensors=("usbl",),
            scored_at_fixes=True,
            colour="#e69f00",
        ),
    )
}
"""A new filter is one row here, and one file; other packages add rows by entry points, users by --plugin."""


def add_method(part: plugins.Plugin) -> str:
    """Add the filter of another package; return why it cannot be, "" if it was added."""
    method = part.value
    if not isinstance(method, Method):
        return f"it is no usbldr.Method, but of type {type(method).__name__}"
    if METHODS.setdefault(method.name, method) is not method:  # built-in filters come first
        return f"there is a filter {method.name!r} already; give it another name"
    return ""


def add_named(text: str) -> None:
    """Add the filter that --plugin names; raise UsageError if it cannot be."""
    if fault := add_method(plugins.named(text)):
        raise UsageError(f"--plugin {text}: {fault}")


@functools.cache
def add_installed() -> None:
    """Add the filters of installed packages; not while this module is imported, which they import themselves."""
    for part in plugins.offered(plugins.METHODS):
        if fault := add_method(part):
            plugins.refuse(part, fault)


for _text in plugins.asked_for():
    add_named(_text)


def method_named(name: str) -> Method:
    """Return a method of METHODS or of an installed package; raises UsageError for a name that is not there."""
    if name not in METHODS:
        add_installed()
    if name not in METHODS:
        raise UsageError(f"there is no filter {name!r}{did_you_mean(name, METHODS)} (filters: {', '.join(METHODS)})")
    return METHODS[name]


def methods_that(able: Callable[[Method], object]) -> str:
    """Return the names of the methods for which something holds, as "ekf, ckf"."""
    return ", ".join(method.name for method in METHODS.values() if able(method))


def track_name(name: str, smooth: bool) -> str:
    """Return what to call the track of a method that was asked to smooth."""
    return track_label(name, smooth and METHODS[name].smoother_transform is not None)
