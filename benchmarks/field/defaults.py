"""What each feature and each default is worth on the field logs.

    python benchmarks/field/defaults.py            a feature taken away: metres, the table of docs/studies/field.md
    python benchmarks/field/defaults.py --halved   a default halved and doubled: per cent, sensitivity.md beside it

`adf --calibrate auto`; it changes constants that are no setting, so it is no `usbldr compare --set`.
"""

import argparse
import itertools
import math
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, fields, replace
from functools import cache
from operator import attrgetter
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import patch

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # field is a package

from field.logs import SCENARIO, SCORED_S, dive
from field.moved_truth import moved_onto_fixes
from usbldr.filters.errors import UsbldrError
from usbldr.filters.evaluation.error_report import WHOLE_LOG
from usbldr.filters.evaluation.evaluation import evaluate
from usbldr.filters.identification import evidence, noise_fit, usbl_likelihood
from usbldr.filters.models.parameters import UNKNOWN_START, Parameters, Start
from usbldr.filters.replay import dead_reckoning, prior
from usbldr.filters.replay.dead_reckoning import LEAST_START_SD_M, START_FIXES
from usbldr.filters.types import Mask, Timeline
from usbldr.io.session import RunSettings, replay, resolve

HALF, TWICE = "half", "twice"
FACTORS = {HALF: 0.5, TWICE: 2.0}
LEAST_BIAS_M = 1e-6  # [m] the least that a configuration may state
LOGS = ("uib_field", "uib_simulation", "stpere_marina", SCENARIO)
DIVES = 3  # of the scenario, for a feature taken away
MODULES = SimpleNamespace(
    dead_reckoning=dead_reckoning, evidence=evidence, noise_fit=noise_fit, prior=prior, usbl_likelihood=usbl_likelihood
)


def _same_line(line: Timeline) -> Timeline:
    return line


def _same(parameters: Parameters, line: Timeline) -> Parameters:
    return parameters


@dataclass(frozen=True, slots=True)
class Change:
    """How a run departs from one with the defaults."""

    records: Callable[[Timeline], Timeline] = _same_line
    before: Callable[[Parameters, Timeline], Parameters] = _same  # identification from the log
    settings: Mapping[str, Any] = field(default_factory=dict[str, Any])  # of RunSettings
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


def _stamped_at_arrival(line: Timeline) -> Timeline:
    late = line.with_fixes(np.argsort(line.fix_received_s, kind="stable"))
    return replace(late, fix_time_s=late.fix_received_s)


def _plain_start(parameters: Parameters, line: Timeline) -> Parameters:
    """Start at the plain median of the first fixes, wherever the vehicle has gone meanwhile."""
    if parameters.start is not None:
        return parameters
    east_m, north_m = np.median(line.fix_m[:5], axis=0).tolist()
    return replace(parameters, start=Start(east_m, north_m, 3.0))


def _ablations() -> Iterator[tuple[str, Change]]:
    yield "Gaussian noise", Change(settings={"method": "ckf"})
    yield "a gate instead of mixture noise", Change(settings={"method": "ckf", "gate": 0.99})
    yield "--calibrate none", Change(settings={"calibrate": ()})
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
    yield "without guard", Change(settings={"guard": False})
    yield "fixes stamped at arrival", Change(records=_stamped_at_arrival)
    yield "start at the median fix", Change(before=_plain_start)


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
        modules = ("dead_reckoning", "usbl_likelihood")
        return Change(constants={f"{module}.START_FIXES": round(factor * START_FIXES) for module in modules})
    if name == "least_sd_m":
        return Change(constants={"dead_reckoning.LEAST_START_SD_M": factor * LEAST_START_SD_M})
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
        for name in ("evidence.LATENCY_SD_S", "evidence.SCALE_SD", "evidence.MAX_PRIOR_SIGMAS"):
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


def error(name: str, change: Change, order: str, seed: int = 0) -> tuple[float, float]:
    """Return the mean horizontal error in metres and the NEES of a run on a log, changed."""
    log, line, truth = dive(name, seed)
    if name == "uib_field":
        truth = moved_onto_fixes(truth, line)
    line = change.records(line)
    changed = {"method": "adf", "calibrate": ("auto",), "order": order, "seed": seed, **change.settings}
    method, settings = changed.pop("method"), RunSettings(**changed)
    with constants(change.constants):
        found = resolve(replace(log, parameters=change.before(log.parameters, line)), line, method, settings)
        track = replay(log, line, method, settings, found)
    window = SCORED_S if name == "uib_field" else WHOLE_LOG
    metrics = evaluate(track, truth, window, "none", line.time_s[line.slow]).flat()
    return metrics["mean_horizontal_m"] or math.nan, metrics["nees_mean"] or math.nan


@cache
def usual_error(name: str, order: str, seed: int) -> tuple[float, float]:
    """Return the same of a run with all features and defaults."""
    return error(name, Change(), order, seed)


def cell(name: str, change: Change, halved: bool) -> str:
    """Return what a change does to the error on a log: in per cent, or in metres and with the NEES."""
    order = "validity" if halved or name == SCENARIO else "arrival"
    seeds = range(DIVES if name == SCENARIO and not halved else 1)
    try:
        before = np.array([usual_error(name, order, seed) for seed in seeds])
        after = np.array([error(name, change, order, seed) for seed in seeds])
    except UsbldrError as fault:
        return f"failed: {fault}"
    (usual, _), (metres, nees) = before.mean(axis=0), after.mean(axis=0)
    if np.array_equal(before[:, 0], after[:, 0]):
        return "·"  # the log does not use what was changed
    return f"{100 * (metres / usual - 1):+.1f} %" if halved else f"{metres - usual:+.3f} ({nees:.2f})"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--halved", action="store_true", help="defaults halved and doubled")
    parser.add_argument("--logs", nargs="+", default=LOGS, choices=LOGS)
    chosen = parser.parse_args()
    print(f"| change | {' | '.join(chosen.logs)} |\n|{'---|' * (1 + len(chosen.logs))}")
    for name, change in (SENSITIVITY if chosen.halved else ABLATIONS).items():
        print(f"| {name} | {' | '.join(cell(log, change, chosen.halved) for log in chosen.logs)} |", flush=True)


if __name__ == "__main__":
    main()
