"""What the best set of sensor errors means for a run: its parameters, the evidence for each error, and rivals."""

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache
from operator import attrgetter
from typing import NamedTuple

import numpy as np

from usbldr.filters.identification.identification import (
    DR_WALK_NAME,
    HEADING_OR_DEVIATION,
    LEVER_OR_LATENCY,
    STRONG_ODDS,
    ErrorEstimate,
    Explanation,
    Identification,
    NoiseChange,
    OpenPair,
    SensorErrorEvidence,
)
from usbldr.filters.identification.linearisation import (
    ARM,
    COMPASS_CLOCK,
    DVL_CLOCK,
    HEAD,
    HEAD_ERRORS,
    KEYS,
    LEVER,
    PASS_STATES,
    RANGE,
    REPORTED,
    linearised,
    prior_sds,
)
from usbldr.filters.identification.usbl_likelihood import MAX_FIXES, FixLikelihoods, Member
from usbldr.filters.models.calibration import SENSOR_ERRORS, STATES
from usbldr.filters.models.noise import Contamination
from usbldr.filters.models.parameters import Parameters
from usbldr.filters.types import Timeline, Vector

LOG_PRIOR_ODDS = -math.log(STRONG_ODDS)  # of an error that exists against one that does not
FAR_SD = {
    "scale": 0.2,
    "heading": math.pi / 2,
    "deviation": math.radians(10.0),
    "latency": 10.0,
    HEAD: math.radians(30.0),
    RANGE: 0.1,
    ARM: 10.0,
}
"""Prior sigma of an error far outside what is usual, in the unit of its field: velocities in another unit, a
compass mounted any way round or beside iron, stamps of a slow export, a USBL head on a pole that was not surveyed, or
whose lever arm is not stated. Each needs strong evidence once more."""
HEAD_OR_VEHICLE = (HEAD, "heading"), (RANGE, "scale")
FARTHEST = 0.98  # quantile of distances from the head: an outlier is none
AGAIN = 4.0  # [-] on the sigma of a settled error: its fixes come again; only 1/16 of what they say is counted twice
OF_RIVAL = 0.5  # [-] by judgement: share of the cases in which the explanation that is not taken is the right one
PERHAPS = 0.2  # [-] by judgement: share of the logs that have an error, for each sensor error
OPEN = 0.5  # [-] of its prior sigma: an error so uncertain after the log is not distinguished from its rival


class Choice(NamedTuple):
    """The chosen subset among all."""

    member: Member
    row: int  # in the subsets
    named: frozenset[str]  # errors in it for which there is evidence, alone or with those they may be taken for
    subsets: Sequence[frozenset[str]]
    score: Vector  # (N,) of each subset
    found: FixLikelihoods
    far: frozenset[str]  # keys of the errors whose prior is that of FAR_SD

    @property
    def bias_for_deviation(self) -> bool:
        """Return whether a heading bias is taken in place of a deviation that is somewhat likelier."""
        scores, present = dict(zip(self.subsets, self.score.tolist(), strict=True)), self.member.present
        return "heading" in present and scores.get(present ^ HEADING_OR_DEVIATION, -math.inf) > scores[present]


@cache
def subsets_of(keys: tuple[str, ...]) -> tuple[frozenset[str], ...]:
    """Return all subsets of some keys, smaller ones first, that have at most one explanation of the same clocks.

    A log shows the differences of three clocks: of compass, DVL and fixes. Two of them say all, and one may.
    """
    every = (frozenset(some) for n in range(len(keys) + 1) for some in itertools.combinations(sorted(keys), n))
    return tuple(some for some in every if COMPASS_CLOCK not in some or not some & {DVL_CLOCK, "latency"})


def concluded(timeline: Timeline, given: Parameters, stated: Parameters, choice: Choice) -> Identification:
    """Return the choice as parameters of a run: its errors are settled, and states estimate what is left of them.

    Fixes that are early by no more than is usual are not moved: perhaps DVL and compass are late, as a warning says.
    Of a lever arm and a latency that the log does not tell apart, latency is taken: it is the more usual one. What a
    lever arm of the DVL would do to the track is in its sigma, also if the transponder may be misplaced instead.
    """
    parameters, found, shared = choice.member.parameters, choice.found, _shared_by_priors(choice)
    present = choice.member.present - ({LEVER} if shared else frozenset())
    row = choice.subsets.index(present)
    constant = present - {LEVER}
    if found.mean["usbl_latency"][row] < 0:  # not moved, so that the others, found with it, are not settled either
        constant &= {*choice.far, DVL_CLOCK, COMPASS_CLOCK, *HEAD_ERRORS}
    settled = {name: float(found.mean[name][row]) for key in constant for name in KEYS[key]}
    errors = {field: error for field, error in SENSOR_ERRORS.items() if error.key in constant}
    sds = {field: AGAIN * float(max(found.sd[state][row] for state in one.states)) for field, one in errors.items()}
    left = {field: min(getattr(stated.errors, field), sd) for field, sd in sds.items()}
    parameters = replace(parameters, settled=settled, errors=replace(parameters.errors, **left))
    if LEVER in present:
        starboard_m, forward_m = (float(found.mean[name][row]) for name in KEYS[LEVER])
        starboard, forward, up = given.dvl_lever_m
        parameters = replace(parameters, dvl_lever_m=(starboard + starboard_m, forward + forward_m, up))
    of_head = [name for key in HEAD_ERRORS if key in present for name in KEYS[key]]
    sd = {name: float(found.sd[name][row]) for name in of_head}
    column = {name: PASS_STATES.index(name) for name in of_head}
    cov = {(a, b): float(found.cov[column[a], column[b], row]) for a, b in itertools.combinations(of_head, 2)}
    if LEVER in choice.member.present:
        of_lever = choice.subsets.index(choice.member.present - ({"latency"} if shared else frozenset()))
        of_dvl = {name: (found.mean[name][of_lever], found.sd[name][of_lever]) for name in KEYS[LEVER]}
        sd |= {name: math.hypot(math.sqrt(OF_RIVAL) * mean, one_sd) for name, (mean, one_sd) in of_dvl.items()}
    parameters = replace(parameters, settled_sd=sd | _perhaps_sd(choice, settled), settled_cov=cov)
    separate = choice.named - (LEVER_OR_LATENCY if shared else frozenset())
    always = {"usbl-bias", "current"} if given.water_track else {"usbl-bias"}
    covered = {"deviation"} if choice.bias_for_deviation else set[str]()
    kept = tuple(key for key in STATES if key in present | always | covered)
    evidence = tuple(
        SensorErrorEvidence(
            key,
            _log_odds(key, choice),
            key in choice.named,
            _estimates((key,), found, row) if key in separate else (),
            _effect_m(timeline, choice, key) if key in choice.named else 0.0,
        )
        for key in KEYS
        if any(key in subset for subset in choice.subsets)
    )
    parameters = replace(parameters, calibrate=kept)
    pairs = _open_pairs(timeline, choice, parameters.settled_sd)
    return Identification(parameters, evidence, noise_changes(given, parameters), explanations(choice), pairs)


def _perhaps_sd(choice: Choice, taken: Mapping[str, float]) -> dict[str, float]:
    """Return how far errors that displace the whole track may be from what is taken, RMS over all subsets.

    Each subset counts as much as it is likely: on a straight way a log says little against a latency, and in a circle
    a latency is a turned compass. J. Hoeting and others, "Bayesian Model Averaging: A Tutorial", Statistical Science
    14(4), 1999, doi:10.1214/ss/1009212519.
    """
    present, found = choice.member.present, choice.found
    keys = sorted(key for key in LEVER_OR_LATENCY if key not in present or KEYS[key][0] in taken)
    odds = math.log(PERHAPS / (1 - PERHAPS)) - LOG_PRIOR_ODDS
    log_share = choice.score + odds * np.array([len(subset) for subset in choice.subsets])
    share = np.exp(log_share - log_share.max())
    share /= share.sum()
    sd = dict[str, float]()
    for key in keys:
        for name in KEYS[key]:
            own_sd = 0.0 if key in present else found.sd[name]  # else a state covers it
            sd[name] = math.sqrt(share @ ((found.mean[name] - taken.get(name, 0.0)) ** 2 + own_sd**2))
    return sd


def _open_pairs(timeline: Timeline, choice: Choice, sd: Mapping[str, float]) -> tuple[OpenPair, ...]:
    """Return the errors of the head with evidence that the log does not tell from those of the vehicle."""
    if timeline.fix_away_m is None:
        return ()
    away_m = float(np.quantile(np.hypot(*timeline.fix_away_m.T), FARTHEST))
    known = prior_sds(choice.member.parameters)
    states = [(pair, state) for pair in HEAD_OR_VEHICLE if choice.named.issuperset(pair) for state in KEYS[pair[0]]]
    return tuple(OpenPair(*pair, away_m, away_m * sd[s]) for pair, s in states if sd[s] > OPEN * known[s])


def explanations(choice: Choice) -> tuple[Explanation, ...]:
    """Return the best subset, then those within log 20 of it that have another meaning.

    A subset with an error more or less than a better one says of the others the same: `_log_odds` judges that error.
    Lever arm and latency whose shares follow from their priors are two explanations, each of which is all of it.
    """
    score, subsets, present = choice.score, choice.subsets, choice.member.present
    if _shared_by_priors(choice):
        alone = [subsets.index(present - {key}) for key in LEVER_OR_LATENCY]
        return tuple(_explanation(choice, row) for row in sorted(alone, key=lambda row: -score[row]))
    taken: list[int] = []
    for row in map(int, np.argsort(-score)):
        if score[row] - score.max() < LOG_PRIOR_ODDS:
            break
        if not any(subsets[row] <= subsets[other] or subsets[row] >= subsets[other] for other in taken):
            taken.append(row)
    return tuple(_explanation(choice, row) for row in taken)


def _explanation(choice: Choice, row: int) -> Explanation:
    keys = tuple(key for key in KEYS if key in choice.subsets[row])
    return Explanation(keys, float(choice.score[row] - choice.score.max()), _estimates(keys, choice.found, row))


def _shared_by_priors(choice: Choice) -> bool:
    """Return whether lever arm and latency both exist, and the log shows little but their sum."""
    prior_s, sd_s = prior_sds(choice.member.parameters)["usbl_latency"], choice.found.sd["usbl_latency"][choice.row]
    return choice.member.present >= LEVER_OR_LATENCY and float(sd_s) > OPEN * prior_s


def _estimates(keys: Sequence[str], found: FixLikelihoods, row: int) -> tuple[ErrorEstimate, ...]:
    return tuple(_estimate(name, found, row) for key in keys for name in KEYS[key])


def _effect_m(timeline: Timeline, choice: Choice, key: str) -> float:
    """Return how far an error moves the fixes against dead reckoning, RMS about the mean."""
    log = linearised(timeline, choice.member.parameters.usbl_from_dvl_m, MAX_FIXES, choice.member.about)
    columns = [PASS_STATES.index(name) for name in KEYS[key]]
    moved_m = log.measurement_matrix[:, :, columns] @ [choice.found.mean[name][choice.row] for name in KEYS[key]]
    return math.sqrt(moved_m.var(axis=0).sum())


def _estimate(state: str, found: FixLikelihoods, row: int) -> ErrorEstimate:
    reported = REPORTED[state]
    value, sd = float(found.mean[state][row]), float(found.sd[state][row])
    return ErrorEstimate(reported.name, reported.factor * value, abs(reported.factor) * sd)


def _log_odds(key: str, choice: Choice) -> float:
    """Return the score of the best subset with the error minus that of the best without."""
    exists = np.array([key in subset for subset in choice.subsets])
    return float(choice.score[exists].max() - choice.score[~exists].max())


def noise_changes(given: Parameters, current: Parameters) -> tuple[NoiseChange, ...]:
    """Return the numbers of the noise that differ."""
    numbers = {
        "dvl_sd_scale": attrgetter("dvl_sd_scale"),
        "compass_sd_scale": attrgetter("compass_sd_scale"),
        "velocity_walk_mps": attrgetter("process.velocity_mps"),
        "usbl_sd_scale": attrgetter("usbl_sd_scale"),
        "usbl_bias_sd_m": attrgetter("errors.usbl_bias_m"),
        "usbl_bias_time_s": attrgetter("errors.usbl_bias_s"),
        DR_WALK_NAME: attrgetter("process.position_m"),
    }
    if isinstance(given.usbl, Contamination):
        numbers |= {"usbl_outlier_share": attrgetter("usbl.share"), "usbl_outlier_sd_m": attrgetter("usbl.sd")}
    found = [NoiseChange(name, number(given), number(current)) for name, number in numbers.items()]
    return tuple(one for one in found if one.after != one.before)
