"""One run of a method on a log with everything that its report contains: what replay, check and --verify share."""

import ctypes
import math
import sys
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from typing import TYPE_CHECKING, Any, NamedTuple

from usbldr.filters.errors import LogError, UsageError
from usbldr_cli.options.log_options import configured_request, labelled_inputs
from usbldr_cli.options.option import given_command
from usbldr_cli.options.run_options import RunChoices
from usbldr_cli.options.verbosity import progress

if TYPE_CHECKING:
    from usbldr.filters.evaluation.influence import LeaveOneOut
    from usbldr.filters.identification.identification import Identification
    from usbldr.filters.types import Timeline
    from usbldr.io.log import Log
    from usbldr.io.reading.opening import Request
    from usbldr.io.reports.run import Run, ScoredTrack
    from usbldr.io.session import RunSettings


@dataclass(frozen=True, slots=True)
class RunPlan:
    """What is to be run, as given."""

    log: str  # a file, a folder, or else a scenario
    method: str
    choices: RunChoices
    selection: Mapping[str, Any] = field(default_factory=dict[str, Any])  # values of options.selection_options
    leave_one_out: int | None = None  # most influential fixes
    bound: bool = False

    @property
    def content(self) -> dict[str, Any]:
        """The plan as report.json states it."""
        return {
            "log": self.log,
            "filter": self.method,
            "options": asdict(self.choices),
            "selection": dict(self.selection),
            "leave_one_out": self.leave_one_out,
            "bound": self.bound,
        }


class PreparedRun(NamedTuple):
    """A log as the method will see it."""

    log: "Log"
    timeline: "Timeline"
    settings: "RunSettings"
    identification: "Identification"

    def without_headings(self) -> "PreparedRun":
        """Return it without the headings of the log, which only the doctor needs from here on."""
        return self._replace(log=self.log.without_records("compass"))


def prepare_run(plan: RunPlan, log: "Log") -> PreparedRun:
    """Divide a log into epochs, and identify what it settles of noise and sensor errors.

    The findings of the log are completed by what the data say against its conventions. Raises what the method refuses
    of log and options.
    """
    from usbldr.filters.replay.methods import method_named
    from usbldr.io.doctor.cross_check import convention_warnings
    from usbldr.io.reading.epochs import timeline
    from usbldr.io.reading.read import require
    from usbldr.io.session import not_a_filter, resolve

    chosen, choices = method_named(plan.method), plan.choices
    require(log, chosen.sensors)
    if choices.aid is not None and not chosen.is_filter:
        raise UsageError(f"--aid {not_a_filter(plan.method)}")
    dive_timeline, settings = timeline(log, choices.fast_hz, choices.slow_hz), choices.settings(log.start_ns)
    found = resolve(log, dive_timeline, plan.method, settings)
    log = replace(log, findings=(*log.findings, *convention_warnings(log, dive_timeline, found)))
    return PreparedRun(log, dive_timeline, settings, found)


def finish_run(plan: RunPlan, request: "Request", ready: PreparedRun) -> "Run":
    """Compute and score the track, its reference tracks, and what else the user asked for."""
    from usbldr.io.reading.opening import ConfigurationFile
    from usbldr.io.reports.run import Run
    from usbldr.io.reports.run_provenance import RunProvenance, read_files
    from usbldr.io.session import reference_tracks

    log, dive_timeline, settings, found = ready
    _return_memory()
    references = reference_tracks(log, dive_timeline, plan.method, settings, found)
    scored = _score(plan.method, ready)
    _return_memory()
    content = request.configuration.content if isinstance(request.configuration, ConfigurationFile) else None
    made = RunProvenance(given_command(), read_files(labelled_inputs(plan.log, request), log.sha256))
    order, seed = plan.choices.order, plan.choices.seed
    run = Run(log, dive_timeline, found, scored, references, order, seed, plan.content, content, made=made)
    if plan.bound:
        run = _with_bound(plan.log, run)
    return run if plan.leave_one_out is None else _with_left_out(plan.method, run, ready, plan.leave_one_out)


def _return_memory() -> None:
    """Give what was freed back to the system: glibc keeps it, and the arrays of a long dive would not fit into it."""
    if sys.platform == "linux":
        with suppress(AttributeError):  # another C library
            ctypes.CDLL(None).malloc_trim(0)


def run_again(plan: RunPlan) -> "Run":
    """Run a plan from its log on, without a word to the user."""
    from usbldr.io.reading.remote import local_log
    from usbldr.io.session import open_log

    request = configured_request(plan.log, plan.selection)
    with local_log(plan.log, request) as path:
        log = plan.choices.edited(open_log(path, request, plan.choices.seed))
    return finish_run(plan, request, prepare_run(plan, log))


def _score(method: str, ready: PreparedRun, dive_timeline: "Timeline | None" = None) -> "ScoredTrack":
    """Compute and score a track, and show the progress."""
    from usbldr.io.session import score

    used = ready.timeline if dive_timeline is None else dive_timeline
    with progress(f"run {method}", len(used.time_s)) as advance:
        return score(ready.log, used, method, ready.settings, ready.identification, lambda done, _: advance(done))


def _with_bound(scenario: str, run: "Run") -> "Run":
    """Return the run with the bound for the noise of the scenario and the states that the run estimated."""
    from usbldr.io.session import bound

    used = run.identification.parameters
    parameters = replace(run.log.parameters, calibrate=used.calibrate, aid=used.aid)
    return replace(run, bound=bound(scenario, run.timeline, parameters, run.seed))


def _with_left_out(method: str, run: "Run", ready: PreparedRun, count: int) -> "Run":
    from usbldr.filters.evaluation.influence import compare_without, most_influential, without_fix

    dive_timeline, (whole, report) = run.timeline, run.scored
    found: list[LeaveOneOut] = []
    for fix in most_influential(whole, count):
        try:
            other = _score(method, ready, without_fix(dive_timeline, fix.row))
        except LogError as err:
            raise LogError(f"--leave-one-out, without the fix at {fix.time_s:.1f} s: {err}") from err
        change_m = math.nan
        if report is not None and other.report is not None:
            change_m = other.report.horizontal.mean_m - report.horizontal.mean_m
        found.append(compare_without(fix, whole, other.trajectory, change_m))
    return replace(run, without_fixes=tuple(found))
