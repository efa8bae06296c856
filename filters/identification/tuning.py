"""Noise estimated from the log itself, without truth, by maximum likelihood.

The predictive likelihood, the sum of log p(reading | all readings before), compares assumptions without the true
track: too large a noise predicts too widely, too small a one is over-confident. It is maximised over logarithms,
with a weak log-normal prior around what was assumed before, in two searches (newton.py): first the noise of the
DVL from its own records (dvl_likelihood.py), then that of the fixes from their residuals to dead reckoning
(usbl_likelihood.py). A number that is hardly observable is unchanged. No random numbers are used.

The sigma of the DVL never falls below the stated one: differences of records show only the white part of its error.

The random walk of the compass error is not among them: its effect on the track equals that of a slowly changing bias of
the fixes. With it the NEES of a field log rose from 2 to 9.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from usbldr.filters.identification.dvl_likelihood import dvl_likelihoods
from usbldr.filters.identification.identification import Identification, TunedParameter
from usbldr.filters.identification.newton import Maximum, maximise
from usbldr.filters.identification.usbl_likelihood import dr_residuals, fix_likelihoods
from usbldr.filters.models.parameters import Parameters
from usbldr.filters.types import Timeline, Vector

PRIOR_SD = math.log(3)  # [1] of each logarithm: a factor of three is one sigma
MAX_IDENTIFIED_RATIO = 0.7  # of PRIOR_SD: above it the number is hardly observable
LATENCY_ITERATIONS = 3  # until the latency of the linearisation is the estimated one


class TunableParameter(NamedTuple):
    """One number of Parameters."""

    name: str  # with its unit
    path: tuple[str, ...]  # to the number
    state: str = ""  # key of calibration.STATES that must be calibrated for it
    lower_bound: float = 0.0  # and finite, or below 1 if it is a share
    share: bool = False

    def value(self, parameters: Parameters) -> float | None:
        """Return the number; None if these assumptions do not use it, or it is 0 and so off."""
        owner: Any = parameters
        for name in self.path:
            owner = getattr(owner, name, None)
        used = not self.state or self.state in parameters.calibrate
        return float(owner) if owner is not None and used and owner > self.lower_bound else None

    def to_unbounded(self, value: float) -> float:
        """Return the unbounded number of the search."""
        return math.log(value / (1 - value)) if self.share else math.log(value - self.lower_bound)

    def from_unbounded(self, z: float) -> float:
        """Return the number from that of the search."""
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


def tune(timeline: Timeline, parameters: Parameters) -> Identification:
    """Return the assumptions that explain the records of the DVL and the fixes best.

    Without fixes only the noise of the DVL is estimated. Raises LogError if nothing gives the start.
    """
    dvl_fit = estimate_dvl_noise(timeline, parameters)
    if not len(timeline.fix_time_s):
        return dvl_fit
    given = dvl_fit.parameters
    log = dr_residuals(timeline, given)
    for _ in range(LATENCY_ITERATIONS - 1):
        log = dr_residuals(timeline, given, fix_likelihoods(log, [given]).latency_s)
    usbl_fit = _search(lambda members: fix_likelihoods(log, members).log_likelihood, given, USBL)
    return replace(usbl_fit, tuned=dvl_fit.tuned + usbl_fit.tuned)


def estimate_dvl_noise(timeline: Timeline, given: Parameters) -> Identification:
    """Return the assumptions that explain the DVL's own records best; their sigma may grow but not shrink."""

    def fit(among: Sequence[TunableParameter]) -> Identification:
        return _search(lambda members: dvl_likelihoods(timeline, members), given, among)

    dvl_fit = fit(DVL)
    return dvl_fit if dvl_fit.parameters.dvl_sd_scale >= given.dvl_sd_scale else fit(DVL[1:])


def _search(
    objective: Callable[[Sequence[Parameters]], Vector], given: Parameters, among: Sequence[TunableParameter]
) -> Identification:
    """Estimate the parameters that the assumptions use, then once more only the observable ones."""
    before = {p: p.to_unbounded(value) for p in among if (value := p.value(given)) is not None}

    def search(names: Sequence[TunableParameter], start: Vector) -> Maximum:
        centre = np.array([before[p] for p in names])
        return maximise(
            lambda points: objective([_at(given, names, point) for point in points]), centre, PRIOR_SD, start
        )

    first = search(list(before), np.array(list(before.values())))
    is_identified = first.sd < MAX_IDENTIFIED_RATIO * PRIOR_SD
    identified = [p for p, yes in zip(before, is_identified, strict=True) if yes]
    last = first if is_identified.all() else search(identified, first.point[is_identified])
    made = _at(given, identified, last.point)
    sd = dict(zip(before, first.sd.tolist(), strict=True)) | dict(zip(identified, last.sd.tolist(), strict=True))
    return Identification(made, tuned=tuple(_tuned(p, given, made, sd[p], p in identified) for p in before))


def _at(given: Parameters, tunable: Sequence[TunableParameter], point: Vector) -> Parameters:
    """Return the assumptions at a point of the search."""
    made = given
    for parameter, z in zip(tunable, point.tolist(), strict=True):
        made = _with(made, parameter.path, parameter.from_unbounded(z))
    return made


def _with(owner: Any, path: Sequence[str], value: float) -> Any:
    """Return a copy of nested dataclasses with one number replaced."""
    name, *rest = path
    return replace(owner, **{name: _with(getattr(owner, name), rest, value) if rest else value})


def _tuned(
    parameter: TunableParameter, given: Parameters, made: Parameters, sd: float, identified: bool
) -> TunedParameter:
    before, after = parameter.value(given), parameter.value(made)
    assert before is not None
    assert after is not None  # both had a part when the search began
    middle = parameter.to_unbounded(after)
    low, high = parameter.from_unbounded(middle - sd), parameter.from_unbounded(middle + sd)
    return TunedParameter(parameter.name, before, after, low, high, identified)
