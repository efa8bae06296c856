"""Noise from the log itself: the assumptions under which its readings were most to be expected, never the truth.

The predictive likelihood, the sum of log p(reading | all readings before), judges assumptions without knowing where the
vehicle was: too large a noise predicts nothing sharply, too small a one is surprised. It is maximised over logarithms,
with a weak log-normal prior around what was assumed before, in two searches (newton.py): first what the DVL tells of
itself (dvl_likelihood.py), then what the fixes tell against dead reckoning (usbl_likelihood.py). A number that the log
hardly knows stays as it was assumed. Nothing is left to chance.

The DVL is never trusted more than is stated: from record to record only the white part of its error shows, and the rest
stays when the records agree with each other.

How much a compass error may wander is not among them: it does to a track what a wandering bias of the fixes does, and
a log cannot tell one from the other. Taking it in put the NEES of a field log from 2 to 9.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from usbldr.filters.identification.dvl_likelihood import dvl_likelihoods
from usbldr.filters.identification.newton import Maximum, maximise
from usbldr.filters.identification.usbl_likelihood import dr_residuals, fix_likelihoods
from usbldr.filters.models.parameters import Assumptions, TunedParameter
from usbldr.filters.types import Timeline, Vector

PRIOR_SD = math.log(3)  # [1] of each logarithm: three times more or less is no surprise
MAX_IDENTIFIED_RATIO = 0.7  # of PRIOR_SD: where the log narrows it no further, it hardly knows the number
LATENCY_ITERATIONS = 3  # until the latency about which fixes are linearised is the one that they tell


class TunableParameter(NamedTuple):
    """One number of Assumptions."""

    name: str  # with its unit at the border
    path: tuple[str, ...]  # to the number
    state: str = ""  # key of calibration.STATES without which it means nothing
    lower_bound: float = 0.0  # and finite, or below 1 if it is a share
    share: bool = False

    def value(self, assumptions: Assumptions) -> float | None:
        """Return the number; None where it has no part in these assumptions, or is switched off by a 0."""
        owner: Any = assumptions
        for name in self.path:
            owner = getattr(owner, name, None)
        used = not self.state or self.state in assumptions.calibrate
        return float(owner) if owner is not None and used and owner > self.lower_bound else None

    def to_unbounded(self, value: float) -> float:
        """Return what the search moves: any real number."""
        return math.log(value / (1 - value)) if self.share else math.log(value - self.lower_bound)

    def from_unbounded(self, z: float) -> float:
        """Return the number again."""
        return 1 / (1 + math.exp(-z)) if self.share else self.lower_bound + math.exp(z)


DVL = (  # the sigma first
    TunableParameter("dvl_sd_scale", ("dvl_sd_scale",)),
    TunableParameter("velocity_walk_mps", ("process", "velocity_mps")),
)
USBL = (
    TunableParameter("usbl_sd_scale", ("usbl_sd_scale",)),
    TunableParameter("usbl_outlier_share", ("usbl", "share"), share=True),
    TunableParameter("usbl_outlier_sd_m", ("usbl", "sd")),
    TunableParameter("usbl_outlier_variance_ratio", ("usbl", "variance_ratio"), lower_bound=1.0),
    TunableParameter("usbl_dof", ("usbl", "dof"), lower_bound=2.0),
    TunableParameter("usbl_bias_sd_m", ("errors", "usbl_bias_m"), "usbl-bias"),
    TunableParameter("usbl_bias_time_s", ("errors", "usbl_bias_s"), "usbl-bias"),
)


class TuningResult(NamedTuple):
    """What was found, and how."""

    assumptions: Assumptions  # their field ``tuned`` tells each number
    evaluations: int  # over the DVL's records or the fixes
    converged: bool


def tune(timeline: Timeline, assumptions: Assumptions) -> TuningResult:
    """Return the assumptions that explain the records of the DVL and the fixes best.

    A log without fixes tells of the DVL alone. Raises LogError where there is nothing to start from.
    """
    dvl_fit = estimate_dvl_noise(timeline, assumptions)
    if not len(timeline.fix_time_s):
        return dvl_fit
    log = dr_residuals(timeline, dvl_fit.assumptions)
    for _ in range(LATENCY_ITERATIONS - 1):
        log = dr_residuals(timeline, dvl_fit.assumptions, fix_likelihoods(log, [dvl_fit.assumptions]).latency_s)
    usbl_fit = _search(lambda members: fix_likelihoods(log, members).log_likelihood, dvl_fit.assumptions, USBL)
    return TuningResult(
        usbl_fit.assumptions, dvl_fit.evaluations + usbl_fit.evaluations, dvl_fit.converged and usbl_fit.converged
    )


def estimate_dvl_noise(timeline: Timeline, given: Assumptions) -> TuningResult:
    """Return the assumptions that explain the DVL's own records best; their sigma may grow but not shrink."""

    def ask(among: Sequence[TunableParameter]) -> TuningResult:
        return _search(lambda members: dvl_likelihoods(timeline, members), given, among)

    dvl_fit = ask(DVL)
    return dvl_fit if dvl_fit.assumptions.dvl_sd_scale >= given.dvl_sd_scale else ask(DVL[1:])


def _search(
    objective: Callable[[Sequence[Assumptions]], Vector], given: Assumptions, among: Sequence[TunableParameter]
) -> TuningResult:
    """Move those parameters that have a part in the assumptions, then once more those that the log knows."""
    before = {p: p.to_unbounded(value) for p in among if (value := p.value(given)) is not None}

    def sought(names: Sequence[TunableParameter], start: Vector) -> Maximum:
        centre = np.array([before[p] for p in names])
        return maximise(
            lambda points: objective([_at(given, names, point) for point in points]), centre, PRIOR_SD, start
        )

    first = sought(list(before), np.array(list(before.values())))
    known = first.sd < MAX_IDENTIFIED_RATIO * PRIOR_SD
    told = [p for p, knows in zip(before, known, strict=True) if knows]
    last = first if known.all() else sought(told, first.point[known])
    made = _at(given, told, last.point)
    sd = dict(zip(before, first.sd.tolist(), strict=True)) | dict(zip(told, last.sd.tolist(), strict=True))
    found = tuple(_tuned(p, given, made, sd[p], p in told) for p in before)
    evaluations = first.batches + (0 if last is first else last.batches)
    return TuningResult(replace(made, tuned=given.tuned + found), evaluations, first.converged and last.converged)


def _at(given: Assumptions, parameters: Sequence[TunableParameter], point: Vector) -> Assumptions:
    """Return the assumptions at a point of the search."""
    made = given
    for parameter, z in zip(parameters, point.tolist(), strict=True):
        made = _with(made, parameter.path, parameter.from_unbounded(z))
    return made


def _with(owner: Any, path: Sequence[str], value: float) -> Any:
    """Return a copy of nested dataclasses with one number replaced."""
    name, *rest = path
    return replace(owner, **{name: _with(getattr(owner, name), rest, value) if rest else value})


def _tuned(parameter: TunableParameter, given: Assumptions, made: Assumptions, sd: float, told: bool) -> TunedParameter:
    before, after = parameter.value(given), parameter.value(made)
    assert before is not None
    assert after is not None  # both had a part when the search began
    middle = parameter.to_unbounded(after)
    low, high = parameter.from_unbounded(middle - sd), parameter.from_unbounded(middle + sd)
    return TunedParameter(parameter.name, before, after, low, high, told)
