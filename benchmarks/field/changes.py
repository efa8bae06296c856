"""What the field study changes about a run: its records, one feature taken away, one default halved or doubled.

Every change has a name, by which runs, tables and processes know it.
"""

import itertools
import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, fields, replace
from functools import partial
from typing import Any

import numpy as np

from field.logs import cut, stamped_at_arrival, thinned
from usbldr.filters.identification import observability
from usbldr.filters.models.calibration import STATES
from usbldr.filters.models.parameters import UNKNOWN_START, Parameters, Start
from usbldr.filters.replay.dead_reckoning import start_position, start_sensitivity
from usbldr.filters.types import Timeline

HALF, TWICE = "half", "twice"
FACTORS = {HALF: 0.5, TWICE: 2.0}
THINNED_S = (10.0, 60.0)
OUTAGES_S = ((600.0, 1200.0), (2000.0, 2600.0))
COARSE, FINE = (0.0, 0.5, 0.9), (*np.arange(0.0, 0.95, 0.1).round(2).tolist(), 0.95)


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
    observing: Mapping[str, Any] = field(default_factory=dict[str, Any])  # names of observability.py meanwhile
    options: Mapping[str, Any] = field(default_factory=dict[str, Any])  # of RunChoices
    starting: Mapping[str, Any] = field(default_factory=dict[str, Any])  # names of start.py all the while


@contextmanager
def constants(module: Any, values: Mapping[str, Any]) -> Iterator[None]:
    """Give names of a module other values for a while."""
    kept = {name: getattr(module, name) for name in values}
    try:
        for name, value in values.items():
            setattr(module, name, value)
        yield
    finally:
        for name, value in kept.items():
            setattr(module, name, value)


def _without(key: str) -> Change:
    """Take a state away; the error that it stood for is noise again."""

    def after(parameters: Parameters, line: Timeline) -> Parameters:
        kept = tuple(name for name in parameters.calibrate if name != key)
        less = replace(parameters, calibrate=kept)
        return replace(less, usbl_sd_scale=1.0) if key == "usbl-bias" and kept != parameters.calibrate else less

    return Change(after=after)


def _everything(parameters: Parameters, line: Timeline) -> Parameters:
    return replace(parameters, calibrate=observability.CANDIDATE_KEYS)


def _plain_start(parameters: Parameters, line: Timeline) -> Parameters:
    """Start at the plain median of the first fixes, wherever the vehicle has gone meanwhile."""
    if parameters.start is not None:
        return parameters
    east_m, north_m = np.median(line.fix_m[:5], axis=0).tolist()
    return replace(parameters, start=Start(east_m, north_m, 3.0))


def _ablations() -> Iterator[tuple[str, Change]]:
    for key in STATES:
        if key != "misalignment":
            yield f"without {key}", _without(key)
    as_assumed = {
        "BIAS_TIME_FACTORS": (1.0,),
        "OUTLIER_SHARE_FACTORS": (1.0,),
        "DR_WALK_FACTORS": (1.0,),
        "USBL_SD_FACTORS": (),
    }
    yield "noise not estimated from the log", Change(observing=as_assumed)
    yield "DVL noise not estimated", Change(observing={"_with_dvl_noise": lambda line, parameters: parameters})
    yield "without guard", Change(options={"guard": False})
    yield "all states estimated", Change(after=_everything)
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
    if name == "count":
        counted = {
            part.__name__: partial(part, count=round(5 * factor)) for part in (start_position, start_sensitivity)
        }
        return Change(starting=counted)
    if name == "least_sd_m":
        return Change(starting={"start_position": partial(start_position, least_sd_m=3.0 * factor)})
    other = replace(UNKNOWN_START, **{name: factor * getattr(UNKNOWN_START, name)})
    return Change(starting={"UNKNOWN_START": other})


def _sensitivity() -> Iterator[tuple[str, Change]]:
    """Yield every default, halved and doubled; those that are switched off by a 0 are left out."""
    defaults = Parameters()
    for (label, factor), owner in itertools.product(FACTORS.items(), ("process", "errors", "usbl")):
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
        for name in ("MAX_SIGMA_RATIO", "UNTRUSTED_LATENCY_SD_S", "MIN_YAW_RANGE_RAD", "MAX_OUTLIER_SHARE"):
            value = factor * getattr(observability, name)
            yield f"observability.{name} {label}", Change(observing={name: value})
        for name in ("BIAS_TIME_FACTORS", "OUTLIER_SHARE_FACTORS", "DR_WALK_FACTORS", "USBL_SD_FACTORS"):
            value = tuple(m if m == 1 else factor * m for m in getattr(observability, name))
            yield f"observability.{name} {label}", Change(observing={name: value})
        yield (
            f"observability.MIN_LOG_BAYES_FACTOR {label}",
            Change(observing={"MIN_LOG_BAYES_FACTOR": observability.MIN_LOG_BAYES_FACTOR + math.log(factor)}),
        )
    yield f"observability.CORRELATED_VARIANCE_SHARES {HALF}", Change(observing={"CORRELATED_VARIANCE_SHARES": COARSE})
    yield f"observability.CORRELATED_VARIANCE_SHARES {TWICE}", Change(observing={"CORRELATED_VARIANCE_SHARES": FINE})


ABLATIONS: Mapping[str, Change] = dict(_ablations())
SENSITIVITY: Mapping[str, Change] = dict(_sensitivity())
CHANGES: Mapping[str, Change] = {
    "": Change(),
    "tuned": Change(options={"tune": True}),
    **dict(_records()),
    **ABLATIONS,
    **SENSITIVITY,
}
