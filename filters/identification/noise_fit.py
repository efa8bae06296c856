"""Noise estimated from the log itself, without truth, by maximum a posteriori.

The predictive likelihood, the sum of log p(reading | all readings before), compares parameters without the true track:
too large a noise predicts too widely, too small a one is over-confident. Times a log-normal prior about what was
stated, it is maximised by Newton's method (newton.py): the noise of the DVL from its own records, that of the fixes
from their residuals to dead reckoning (usbl_likelihood.py). No random numbers are used.

The sigma of the DVL and the random walk of the velocity never fall below the stated ones: differences of records show
only the white part of an error, and a walk learnt while cruising would refuse a manoeuvre.
"""

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from usbldr.filters.estimators.gaussian_bank import GaussianBank, Projection
from usbldr.filters.estimators.mode_updates import collapse
from usbldr.filters.identification.newton import maximise
from usbldr.filters.identification.usbl_likelihood import Member, fix_likelihoods
from usbldr.filters.models.noise import TO_SD, BankNoise, Gaussian
from usbldr.filters.models.parameters import UNKNOWN_START, Parameters, ProcessNoise
from usbldr.filters.types import Indices, Timeline, Vector

SEGMENT_RECORDS = 300  # consecutive, a minute at 5 Hz
MAX_SEGMENTS = 60  # spread over the log: an hour at 5 Hz is used whole


class TunableParameter(NamedTuple):
    """One number of Parameters."""

    name: str  # with its unit
    path: tuple[str, ...]  # to the number
    prior_factor: float = 3.0  # one sigma of the log-normal prior
    lower_bound: float = 0.0  # and finite, or below 1 if it is a share
    share: bool = False
    starts: tuple[float, ...] = (1.0,)  # factors on the stated number from which the search may start

    def value(self, parameters: Parameters) -> float | None:
        """Return the number; None if these assumptions do not use it, or it is 0 and so off."""
        owner: Any = parameters
        for name in self.path:
            owner = getattr(owner, name, None)
        return float(owner) if owner is not None and owner > self.lower_bound else None

    def to_unbounded(self, value: float) -> float:
        """Return the unbounded number of the search."""
        return math.log(value / (1 - value)) if self.share else math.log(value - self.lower_bound)

    def from_unbounded(self, z: float) -> float:
        """Return the number from that of the search."""
        return 1 / (1 + math.exp(-z)) if self.share else self.lower_bound + math.exp(z)


DVL = (
    TunableParameter("dvl_sd_scale", ("dvl_sd_scale",)),
    TunableParameter("velocity_walk_mps", ("process", "velocity_mps")),
)
USBL = (
    TunableParameter("usbl_sd_scale", ("usbl_sd_scale",), starts=(0.25, 1.0, 4.0)),
    TunableParameter("usbl_outlier_share", ("usbl", "share"), share=True, starts=(1.0, 6.0)),
    TunableParameter("usbl_outlier_sd_m", ("usbl", "sd"), starts=(1.0, 5.0)),
    TunableParameter("usbl_outlier_variance_ratio", ("usbl", "variance_ratio"), lower_bound=1.0),
    TunableParameter("usbl_dof", ("usbl", "dof"), lower_bound=2.0),
    # heads differ by an order of magnitude, and one that was calibrated has no such error
    TunableParameter("usbl_bias_sd_m", ("errors", "usbl_bias_m"), prior_factor=10.0, starts=(0.3, 2.0)),
    TunableParameter("usbl_bias_time_s", ("errors", "usbl_bias_s"), prior_factor=2.0),
    TunableParameter("position_walk_m", ("process", "position_m"), prior_factor=10.0, starts=(1.0, 10.0, 100.0)),
)

CORRELATED = ("usbl_bias_sd_m", "usbl_bias_time_s")
WAVES_S = 4.0  # [s] correlation time: ships roll with periods of 5 to 15 s, and a quarter of that is the lag of 0
IMPOSSIBLE = -1e12  # fixed: log likelihood below all others, of which differences exist
LEAST_HEADINGS = 100  # whose median is known to 15 %
GROWING = ("position_walk_m",)  # a random walk learnt while dead reckoning is good would refuse its faults


def estimate_dvl_noise(timeline: Timeline, given: Parameters) -> Parameters:
    """Return the parameters that explain the DVL's own records best; they grow or stay."""
    return _grown(given, _search(lambda members: dvl_likelihoods(timeline, members), given, DVL, given).parameters, DVL)


def estimate_compass_noise(timeline: Timeline, given: Parameters) -> Parameters:
    """Return the parameters with the sigma of the compass that its records show; it grows or stays.

    The median ignores manoeuvres; the variance that the motion model expects of the rest is subtracted. A stated noise
    with tails is taken as it is: its median is not its sigma.
    """
    k = np.flatnonzero(timeline.yaw_count)
    if len(k) < LEAST_HEADINGS or not isinstance(given.compass, Gaussian):
        return given
    variance = (given.compass_sd_scale * timeline.yaw_sd_rad[k]) ** 2 / timeline.yaw_count[k]
    ratio = neighbour_ratio(timeline.time_s[k], timeline.yaw_rad[k], variance, given.process)
    scale = math.sqrt(max(float(np.median(ratio)), 1.0))
    return replace(given, compass_sd_scale=given.compass_sd_scale * scale)


def neighbour_ratio(time_s: Vector, yaw_rad: Vector, variance: Vector, process: ProcessNoise) -> Vector:
    """Return by what factor n headings scatter about the lines between their neighbours, squared, (n - 2,).

    Of normal noise with the variances (n,) its median is 1, of the random walks of the motion model 0.
    """
    before_s, after_s = np.diff(time_s)[:-1], np.diff(time_s)[1:]
    share, turned = after_s / (before_s + after_s), np.diff(yaw_rad)
    apart = share * turned[:-1] - (1 - share) * turned[1:]
    noise = variance[1:-1] + share**2 * variance[:-2] + (1 - share) ** 2 * variance[2:]
    both_s = before_s * after_s / (before_s + after_s)
    walked = both_s * (process.yaw_rad**2 + process.turn_rate_radps**2 * before_s * after_s / 3)
    ratio: Vector = ((TO_SD * apart) ** 2 - walked) / noise
    return ratio


def estimate_usbl_noise(timeline: Timeline, member: Member, given: Parameters) -> Parameters:
    """Return the parameters that explain the fixes best, given the sensor errors of the member.

    The prior is about the ``given`` parameters; the search may start at those of the member, too. The random walk of
    dead reckoning grows or stays. Before it grows, what scatters is tried as an error of the fixes that lasts for
    seconds, as the roll of a ship gives it, and as a slow one, which in a short log is as likely: then each has its
    share of the variance.
    """

    def searched(about: Parameters, among: Sequence[TunableParameter], start: Parameters) -> _Found:
        return _search(
            lambda points: fix_likelihoods(timeline, [member._replace(parameters=p) for p in points]).log_likelihood,
            about,
            among,
            start,
        )

    found = searched(given, USBL, member.parameters)
    if found.parameters.process.position_m > given.process.position_m:
        still = [one for one in USBL if one.name not in GROWING]
        waves = replace(given, errors=replace(given.errors, usbl_bias_s=WAVES_S))
        walk = searched(given, [one for one in USBL if one.name not in CORRELATED], given)
        shared = _shared((found, walk, searched(given, still, given)))
        found = max(searched(waves, still, waves), shared, key=lambda one: one.value)
    return _grown(given, found.parameters, [one for one in USBL if one.name in GROWING])


class _Found(NamedTuple):
    """The result of a search."""

    parameters: Parameters
    value: float  # log posterior, but for a constant


def _shared(explanations: Sequence[_Found]) -> _Found:
    """Return the likeliest of some explanations with the mean of their variances, weighted by how likely they are.

    The last one, by a slow error alone, has its correlation time. Whether dead reckoning walks, or fixes share a slow
    error, is open if their likelihoods are alike.
    """
    likeliest = max(explanations, key=lambda one: one.value)
    weight = np.exp([one.value - likeliest.value for one in explanations])
    parts = [(one.parameters.process.position_m, one.parameters.errors.usbl_bias_m) for one in explanations]
    position_m, bias_m = np.sqrt(weight @ np.square(parts) / weight.sum()).tolist()
    known, slow = likeliest.parameters, explanations[-1].parameters
    errors = replace(known.errors, usbl_bias_m=bias_m, usbl_bias_s=slow.errors.usbl_bias_s)
    return _Found(replace(known, process=replace(known.process, position_m=position_m), errors=errors), likeliest.value)


def _grown(given: Parameters, found: Parameters, among: Sequence[TunableParameter]) -> Parameters:
    """Return the found parameters, none of these below the given."""
    both = {one.path: (one.value(given), one.value(found)) for one in among}
    return _with(found, {path: before for path, (before, after) in both.items() if before and after and after < before})


def _search(
    log_likelihood: Callable[[Sequence[Parameters]], Vector],
    given: Parameters,
    among: Sequence[TunableParameter],
    start: Parameters,
) -> "_Found":
    """Return the maximum a posteriori of the parameters that are in use; the prior is about the given ones."""
    used = [parameter for parameter in among if parameter.value(given) is not None]
    centre, sd = _point(given, used), np.log([p.prior_factor for p in used])

    def at_points(points: Sequence[Vector]) -> Vector:
        return np.maximum(log_likelihood([_at(given, used, point) for point in points]), IMPOSSIBLE)

    points = [centre + np.log(factors) for factors in itertools.product(*(p.starts for p in used))]
    points.append(_point(start, used))
    value = at_points(points) - 0.5 * np.sum(((np.array(points) - centre) / sd) ** 2, axis=1)
    best = maximise(at_points, centre, sd, points[int(np.argmax(value))])
    return _Found(_at(given, used, best.point), best.value)


def _point(parameters: Parameters, tunable: Sequence[TunableParameter]) -> Vector:
    """Return the point of the search at these parameters, (d,)."""
    return np.array([p.to_unbounded(value) for p in tunable if (value := p.value(parameters)) is not None])


def _at(given: Parameters, tunable: Sequence[TunableParameter], point: Vector) -> Parameters:
    """Return the parameters at a point of the search."""
    return _with(given, {one.path: one.from_unbounded(z) for one, z in zip(tunable, point.tolist(), strict=True)})


def _with(parameters: Parameters, values: Mapping[tuple[str, ...], float]) -> Parameters:
    """Return the parameters with other numbers at some paths; each part of them is copied once."""
    changed = dict[str, Any]()
    for (field, *rest), value in values.items():
        changed[field] = value if not rest else changed.get(field, {}) | {rest[0]: value}
    parts = {
        field: replace(getattr(parameters, field), **new) for field, new in changed.items() if isinstance(new, dict)
    }
    return replace(parameters, **changed | parts)


def dvl_likelihoods(timeline: Timeline, members: Sequence[Parameters]) -> Vector:
    """Return the predictive log likelihood of DVL records, both axes, for each of N members, (N,).

    Each axis is a random walk plus white noise, as u and v in the motion model without other sensors; calibration
    states matter little here. The log is split into independent segments of equal length, which run in parallel.
    """
    N = len(members)
    rows = _segments(np.flatnonzero(timeline.dvl_count))
    count, length = rows.shape
    if length < 2:
        return np.zeros(N)
    series = 2 * count  # starboard of each stretch, then forward; the bank holds each for all members
    noise = BankNoise([member.dvl for member in members] * series, [m.dvl_sd_scale for m in members] * series)
    walk = np.tile(np.array([member.process.velocity_mps for member in members]) ** 2, series)
    z = np.repeat(timeline.dvl_mps[rows].transpose(1, 2, 0).reshape(length, series), N, axis=1)
    R = np.repeat(np.tile((timeline.dvl_sd_mps[rows] ** 2 / timeline.dvl_count[rows]).T, 2), N, axis=1)
    dt_s = np.repeat(np.tile(np.diff(timeline.time_s[rows], axis=1).T, 2), N, axis=1)
    bank = GaussianBank(z[:1], np.full((1, 1, series * N), UNKNOWN_START.sd_mps**2), np.zeros(series * N))
    total = np.zeros(series * N)
    for k in range(1, length):
        P = bank.cov + walk * dt_s[k - 1]
        projection = Projection(z[k : k + 1] - bank.mean, P, P)
        bank, log_l, *_ = collapse(bank._replace(cov=P), projection, noise.modes(R[k][None, None]))
        total += log_l
    summed: Vector = total.reshape(series, N).sum(axis=0)
    return summed


def _segments(record_rows: Indices) -> Indices:
    """Return the rows of each stretch, (stretches, records): evenly spread, as many as there are, up to the most."""
    length = min(len(record_rows), SEGMENT_RECORDS)
    count = min(len(record_rows) // SEGMENT_RECORDS or 1, MAX_SEGMENTS)
    first = np.linspace(0, len(record_rows) - length, count).astype(np.intp)
    return record_rows[first[:, None] + np.arange(length)]
