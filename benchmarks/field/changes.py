"""What the field study changes about a run: its records, one feature taken away, one default halved or doubled.

Every change has a name, by which runs, tables and processes know it.
"""

import itertools
import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, fields, replace
from functools import partial
from operator import attrgetter
from types import SimpleNamespace
from typing import Any
from unittest.mock import patch

import numpy as np

from field.logs import cut, stamped_at_arrival, thinned
from usbldr.filters.identification import evidence, noise_fit, usbl_likelihood
from usbldr.filters.models.parameters import UNKNOWN_START, Parameters, Start
from usbldr.filters.replay import prior
from usbldr.filters.replay.dead_reckoning import start_position, start_sensitivity
from usbldr.filters.replay.methods import METHODS
from usbldr.filters.types import Mask, Timeline

HALF, TWICE = "half", "twice"
FACTORS = {HALF: 0.5, TWICE: 2.0}
LEAST_BIAS_M = 1e-6  # [m] the least that a configuration may state
THINNED_S = (10.0, 60.0)
PF = "states of pf"  # which fixes every error of the compass when it samples the yaw
OUTAGES_S = ((600.0, 1200.0), (2000.0, 2600.0))
MODULES = SimpleNamespace(evidence=evidence, noise_fit=noise_fit, usbl_likelihood=usbl_likelihood, prior=prior)


def _same_line(line: Timeline) -> Timeline:
    return line


def _same(parameters: Parameters, line: Timeline) -> Parameters:
    return parameters


@dataclass(frozen=True, slots=True)
class Change:
    """How a run departs from one with the defaults."""

    records: Callable[[Timeline], Timeline] = _same_line
    before: Callable[[Parameters, Timeline], Parameters] = _same  # identification from the log
    after: Callable[[Parameters, Timeline], Parameters] = _same
    options: Mapping[str, Any] = field(default_factory=dict[str, Any])  # of RunChoices
    constants: Mapping[str, Any] = field(default_factory=dict[str, Any])  # by module of MODULES and name


@contextmanager
def constants(values: Mapping[str, Any]) -> Iterator[None]:
    """Give names of MODULES other values for a while."""
    with ExitStack() as stack:
        for name, value in values.items():
            module, own_name = name.split(".")
            stack.enter_context(patch.object(getattr(MODULES, module), own_name, value))
        yield


def _without(key: str) -> Change:
    """Let no explanation of a log contain an error."""
    plausible = evidence._plausible

    def without(members: Any, found: Any) -> Mask:
        return plausible(members, found) & np.array([key not in member.present for member in members])

    return Change(constants={"evidence._plausible": without})


def _plain_start(parameters: Parameters, line: Timeline) -> Parameters:
    """Start at the plain median of the first fixes, wherever the vehicle has gone meanwhile."""
    if parameters.start is not None:
        return parameters
    east_m, north_m = np.median(line.fix_m[:5], axis=0).tolist()
    return replace(parameters, start=Start(east_m, north_m, 3.0))


def _estimable_by_pf(parameters: Parameters, line: Timeline) -> Parameters:
    """Leave out what pf cannot estimate, as the command line does without --calibrate."""
    return replace(parameters, calibrate=tuple(k for k in parameters.calibrate if k in METHODS["pf"].estimates))


def _ablations() -> Iterator[tuple[str, Change]]:
    for key in usbl_likelihood.KEYS:
        yield f"without {key}", _without(key)
    yield (
        "without usbl-bias",
        Change(before=lambda given, _: replace(given, errors=replace(given.errors, usbl_bias_m=LEAST_BIAS_M))),
    )
    stated_dvl = {"evidence.estimate_dvl_noise": lambda line, given: given}
    stated_usbl = {"evidence.estimate_usbl_noise": lambda line, member, given: member.parameters}
    yield "noise not estimated from the log", Change(constants=stated_dvl | stated_usbl)
    yield "DVL noise not estimated", Change(constants=stated_dvl)
    yield "all errors estimated", Change(constants={"evidence._present": lambda _, subsets: (subsets[-1], subsets[-1])})
    yield "without guard", Change(options={"guard": False})
    yield "fixes stamped at arrival", Change(records=stamped_at_arrival)
    yield "start at the median fix", Change(before=_plain_start)


def _records() -> Iterator[tuple[str, Change]]:
    yield "cut", Change(records=lambda line: cut(line, OUTAGES_S))
    for every_s in THINNED_S:
        yield f"one fix in {every_s:g} s", Change(records=lambda line, s=every_s: thinned(line, s))


def _scaled(owner: str, name: str, factor: float) -> Change:
    def before(parameters: Parameters, line: Timeline) -> Parameters:
        part = getattr(parameters, owner)
        if not hasattr(part, name):
            return parameters
        return replace(parameters, **{owner: replace(part, **{name: factor * getattr(part, name)})})

    return Change(before=before)


def _scaled_start(name: str, factor: float) -> Change:
    """Scale what is assumed of a start that is not stated."""
    parts = (start_position, start_sensitivity) if name == "count" else (start_position,)
    values = {"count": round(5 * factor), "least_sd_m": 3.0 * factor}
    if name in values:
        scaled = {part.__name__: partial(part, **{name: values[name]}) for part in parts}
        return Change(
            constants={
                f"{module}.{part}": made for module in ("prior", "usbl_likelihood") for part, made in scaled.items()
            }
        )
    other = replace(UNKNOWN_START, **{name: factor * getattr(UNKNOWN_START, name)})
    return Change(constants={"prior.UNKNOWN_START": other})


def _sensitivity() -> Iterator[tuple[str, Change]]:
    """Yield every default, halved and doubled; those that are switched off by a 0 are left out."""
    defaults = Parameters()
    for (label, factor), owner in itertools.product(FACTORS.items(), ("process", "errors", "usbl", "dvl", "compass")):
        part: Any = getattr(defaults, owner)
        for one in fields(part):
            value = getattr(part, one.name)
            if isinstance(value, float) and value:
                yield f"{owner}.{one.name} {label}", _scaled(owner, one.name, factor)
    for label, factor in FACTORS.items():
        for sensor in ("usbl", "dvl"):
            name = f"{sensor}_sd_scale"
            yield f"{name} {label}", Change(before=lambda a, _, n=name, f=factor: replace(a, **{n: f * getattr(a, n)}))
        yield (
            f"compass_sd {label}",
            Change(records=lambda line, f=factor: replace(line, yaw_sd_rad=f * line.yaw_sd_rad)),
        )
        for name in ("count", "least_sd_m", "sd_yaw_rad", "sd_mps", "sd_radps"):
            yield f"start.{name} {label}", _scaled_start(name, factor)
        for name in (
            "evidence.LATENCY_SD_S",
            "evidence.SCALE_SD",
            "evidence.MAX_PRIOR_SIGMAS",
        ):
            yield f"{name} {label}", Change(constants={name: factor * attrgetter(name)(MODULES)})
        odds = evidence.LOG_PRIOR_ODDS - math.log(factor)
        yield f"evidence.LOG_PRIOR_ODDS {label}", Change(constants={"evidence.LOG_PRIOR_ODDS": odds})
        yield f"noise_fit.prior_factor {label}", Change(constants=_prior_factors(factor))


def _prior_factors(factor: float) -> Mapping[str, Any]:
    """Scale the sigma of every log-normal prior of the noise."""
    return {
        f"noise_fit.{name}": tuple(
            one._replace(prior_factor=one.prior_factor**factor) for one in getattr(noise_fit, name)
        )
        for name in ("DVL", "USBL")
    }


ABLATIONS: Mapping[str, Change] = dict(_ablations())
SENSITIVITY: Mapping[str, Change] = dict(_sensitivity())
CHANGES: Mapping[str, Change] = {
    "": Change(),
    PF: Change(after=_estimable_by_pf),
    **dict(_records()),
    **ABLATIONS,
    **SENSITIVITY,
}
