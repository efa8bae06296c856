"""A dive from log to errors, as functions on values: what the commands ``replay`` and ``compare`` call.

    log = open_log("dive.mcap")
    grid = timeline(log)
    track = replay(log, grid, "cpf")
    report = evaluate(log, grid, track)

``RunSettings`` holds the options of the command line for `replay` and `evaluate`.
"""

import os
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from usbldr.filters.bounds.dive_bounds import PositionBound, position_bound
from usbldr.filters.errors import LogError, UsageError, did_you_mean
from usbldr.filters.evaluation.error_report import ErrorReport, Window
from usbldr.filters.evaluation.evaluation import evaluate as evaluate_track
from usbldr.filters.identification.evidence import identify
from usbldr.filters.identification.identification import Identification
from usbldr.filters.models.calibration import AUTO
from usbldr.filters.models.noise import NoiseFamily
from usbldr.filters.models.parameters import Parameters
from usbldr.filters.models.quantities import SENSOR_UNITS
from usbldr.filters.replay.dead_reckoning import Anchor
from usbldr.filters.replay.methods import METHODS, FilterSettings, method_named, methods_that
from usbldr.filters.replay.position_fixes import require_gps
from usbldr.filters.replay.prior import NO_START_TEXT, find_anchor, starting_fixes
from usbldr.filters.replay.run import run
from usbldr.filters.simulation.simulate import simulate
from usbldr.filters.types import Timeline, Trajectory
from usbldr.filters.windows import TimeWindow
from usbldr.io.conventions.shown_noise import examined
from usbldr.io.doctor.message_evidence import RAW_FIELDS
from usbldr.io.geodesy import to_plane
from usbldr.io.log import Log
from usbldr.io.reading.opening import DEFAULT_REQUEST, Request, open_configured
from usbldr.io.reading.read import read, require
from usbldr.io.reading.remote import is_url
from usbldr.io.reports.estimate_text import evidence_text, noise_changes_text
from usbldr.io.reports.run import ScoredTrack
from usbldr.io.scenarios.shipped import find_scenario, scenario_names
from usbldr.io.scenarios.simulated_log import simulated_log
from usbldr.io.stages import say, stage

UNCONFIGURED = Request(configuration="none")
ANCHORS = ("start", "first-fix", "first-gps", "first-truth")


@dataclass(frozen=True, slots=True)
class RunSettings(FilterSettings):
    """The settings of a run; the defaults are those of the commands."""

    calibrate: tuple[str, ...] | None = None  # keys of calibration.STATES, or ("auto",); None: as configured, else auto
    noise: Mapping[str, NoiseFamily] = field(default_factory=dict[str, NoiseFamily])  # by sensor, over the configured
    aid: tuple[TimeWindow, ...] | None = None  # in which GPS fixes are measurements, seconds; None: as configured
    dr_from: str | tuple[float, float] = "start"  # where ``dr`` starts: one of ANCHORS, or latitude, longitude, degrees
    window: Window = Window()  # truth rows to score against, seconds of the log
    align: str = "auto"  # or one of alignment.ALIGNMENTS: moves the track onto the truth before scoring


def is_simulated(log: str | Path) -> bool:
    """Return whether LOG is a scenario: a file NAME.toml, or a name that is not a file, folder or URL."""
    return not (Path(log).exists() or is_url(log)) or (Path(log).suffix == ".toml" and Path(log).is_file())


def open_log(log: str | Path, request: Request = DEFAULT_REQUEST, seed: int = 0) -> Log:
    """Read a log file or folder, or simulate a scenario by its name or file with a seed.

    The filters assume what the scenario states of its sensors, or the defaults if the request ignores configurations.
    Raises LogError if it cannot be read, UsageError if request, configuration and log do not fit together.
    """
    if not is_simulated(log):
        path = Path(log) if Path(log).name else Path(log).absolute()  # a title shows its name, and "." has none
        return read(open_configured(path, request), request, RAW_FIELDS)
    if not Path(log).exists() and str(log) not in scenario_names():
        names = scenario_names()
        hint = did_you_mean(Path(log).name, [*_beside(Path(log)), *names])
        raise LogError(f"{log}: no such file, folder or scenario{hint} (scenarios: {', '.join(names)})")
    if request not in (DEFAULT_REQUEST, UNCONFIGURED):
        raise UsageError(f"{log}: a scenario takes no --truth, --with, --set or topics, and no --config but none")
    made = examined(simulated_log(find_scenario(str(log)), seed))
    return made if request == DEFAULT_REQUEST else replace(made, parameters=Parameters(calibrate=(AUTO,)))


def _beside(path: Path) -> list[str]:
    """Return the names of what is in the folder of a path; none if it cannot be listed."""
    try:
        return os.listdir(path.parent)
    except OSError:
        return []


@stage("identify noise and sensor errors")
def resolve(log: Log, timeline: Timeline, method: str, settings: RunSettings = RunSettings()) -> Identification:
    """Return the assumptions of a method: as configured, with the settings, and with what is identified from the log.

    Without ``settings.calibrate``, sensor errors that the method cannot estimate are left out. Raises UsageError for
    noise of an unknown sensor, and for a track without a filter that is to be smoothed.
    """
    _require_fitting(method, settings)
    parameters = replace(log.parameters, **settings.noise)
    if settings.aid is not None:
        parameters = replace(parameters, aid=settings.aid)
    if settings.calibrate is not None:
        parameters = replace(parameters, calibrate=settings.calibrate)
    estimable = method_named(method).estimates
    if parameters.calibrate == (AUTO,) and not estimable:
        parameters = replace(parameters, calibrate=())
    found = Identification(parameters)
    if parameters.calibrate == (AUTO,):
        found = identify(timeline, parameters)
        if settings.calibrate is None:
            kept = tuple(key for key in found.parameters.calibrate if key in estimable)
            found = replace(found, parameters=replace(found.parameters, calibrate=kept))
    say(f"sensor errors that {method} estimates: {', '.join(found.parameters.calibrate) or 'none'}")
    if found.evidence:
        say(f"evidence in the log {evidence_text(found.evidence)}")
    if found.noise_changes:
        say(f"noise by the log: {noise_changes_text(found.noise_changes)}")
    return found


def _require_fitting(method: str, settings: RunSettings) -> None:
    if unknown := sorted(set(settings.noise) - set(SENSOR_UNITS)):
        raise UsageError(f"noise of {', '.join(unknown)}: no such sensor (sensors: {', '.join(SENSOR_UNITS)})")
    if settings.smooth and not method_named(method).is_filter:
        raise UsageError(f"--smooth {not_a_filter(method)}")


def not_a_filter(method: str) -> str:
    """Return why an option of filters does not fit a track without one."""
    return f"needs a filter, and {method} is not one (filters: {methods_that(lambda m: m.is_filter)})"


def replay(
    log: Log,
    timeline: Timeline,
    method: str = "cpf",
    settings: RunSettings = RunSettings(),
    identification: Identification | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Trajectory:
    """Run a method of METHODS over a log and return its track.

    ``identification`` is that of `resolve`, which is called without one. ``progress`` is called with the number
    of epochs done and of all. Raises LogError if the log lacks a sensor or a start, UsageError for settings that do not
    fit the method.
    """
    able = method_named(method)
    require(log, able.sensors)
    found = resolve(log, timeline, method, settings) if identification is None else identification
    used = found.parameters
    require_gps(timeline, used.aid, str(log.path))
    if used.aid and log.map_unknown:
        raise UsageError(
            f"{log.path}: GPS cannot aid, because its place on the map of the fixes is unknown; state origin_lat_deg "
            "and origin_lon_deg under [map]"
        )
    if able.is_filter and used.start is None and not len(starting_fixes(timeline, used).time_s):
        alone = "" if "usbl" in log.tables else f"; without fixes this is dead reckoning: {_dr_of(log, timeline)}"
        unread = "".join(f"; {finding.text}" for finding in log.findings if finding.code == "TOPIC-UNREAD")
        raise LogError(f"{log.path}: {NO_START_TEXT}{alone}{unread}")
    anchor = find_start(log, timeline, used, settings.dr_from) if able.anchored else None
    nowhere = able.anchored and anchor is None and settings.dr_from == "start" and not _placed(log)
    if nowhere:
        anchor = Anchor(np.zeros(2), 0.0, "0, 0")
    with stage(f"run {method}"):
        track = run(method, timeline, used, settings, progress, anchor)
    warnings = tuple(f"{method}: {text}" for text in found.warnings) if able.is_filter else ()
    warnings += (f"{method}: no fix, GPS or [start] says where the vehicle was: the track starts at 0, 0",) * nowhere
    return replace(track, warnings=warnings + track.warnings)


def _placed(log: Log) -> bool:
    """Return whether the log says where on the earth it is, so that 0, 0 would be a wrong place."""
    return log.truth is not None or log.settings.map is not None or "gps" in log.tables


def _dr_of(log: Log, timeline: Timeline) -> str:
    """Return the options of dead reckoning without fixes and without a stated start."""
    if len(timeline.gps_time_s):
        return "--filter dr --dr-from first-gps"
    return "--filter dr --dr-from LAT,LON" if _placed(log) else "--filter dr starts at 0, 0"


def find_start(
    log: Log, timeline: Timeline, parameters: Parameters, dr_from: str | tuple[float, float]
) -> Anchor | None:
    """Return where dead reckoning starts, None if the log has no such position.

    Raises UsageError for an invalid place, or for LAT,LON without an origin.
    """
    if isinstance(dr_from, str):
        if dr_from not in ANCHORS:
            raise UsageError(f"--dr-from {dr_from} is neither LAT,LON in degrees nor one of {', '.join(ANCHORS)}")
        return find_anchor(dr_from, timeline, parameters, log.truth)
    lat_deg, lon_deg = dr_from
    if not (abs(lat_deg) <= 90 and abs(lon_deg) <= 360):
        raise UsageError(
            f"--dr-from {lat_deg:g},{lon_deg:g} is not a position: latitude within 90, longitude within 360 degrees"
        )
    if log.origin is None:
        raise UsageError("--dr-from LAT,LON needs an origin: state [map] origin_lat_deg, origin_lon_deg")
    position_m = np.concatenate(to_plane(log.origin, np.array([lat_deg]), np.array([lon_deg])))
    return Anchor(position_m, 0.0, f"{lat_deg:g}, {lon_deg:g}")


@stage("compute errors against the truth")
def evaluate(log: Log, timeline: Timeline, track: Trajectory, settings: RunSettings = RunSettings()) -> ErrorReport:
    """Compute the errors of a track against the log's truth, with `settings`.

    A track with all epochs of the slow grid is scored on it, any other at its own stamps; GPS-aided windows are not
    scored. Raises LogError without a truth, or if no epoch can be compared with it.
    """
    if log.truth is None:
        raise LogError(f"{log.path}: no truth to measure errors against: name one with --truth FILE|TOPIC")
    slow_s = timeline.time_s[timeline.slow]
    fixes = track.method in METHODS and METHODS[track.method].scored_at_fixes
    on_grid = not fixes and np.isin(np.round(slow_s * 1e6), np.round(track.time_s * 1e6)).all()  # to 1 us, as in files
    at_s = slow_s if on_grid else None
    aid = log.parameters.aid if settings.aid is None else settings.aid
    return evaluate_track(track, log.truth, settings.window, settings.align, at_s, aid)


def score(
    log: Log,
    timeline: Timeline,
    method: str = "cpf",
    settings: RunSettings = RunSettings(),
    identification: Identification | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> ScoredTrack:
    """Replay a log and compute the errors of the track, if the log has a truth (see `replay` and `evaluate`).

    Raises LogError, too, if all of the truth is invalid because its coordinates are exchanged.
    """
    if log.truth is None and log.truth_fault:
        raise LogError(f"{log.truth_fault}, so that there is no truth; --truth none runs without one")
    track = replay(log, timeline, method, settings, identification, progress)
    return ScoredTrack(track, None if log.truth is None else evaluate(log, timeline, track, settings))


def reference_tracks(
    log: Log, timeline: Timeline, method: str, settings: RunSettings, identification: Identification
) -> tuple[ScoredTrack, ...]:
    """Return raw fixes and dead reckoning, scored like the track of the method, if the log allows them."""
    anchor = find_start(log, timeline, identification.parameters, settings.dr_from)
    possible = {"usbl": len(timeline.fix_time_s) > 0, "dr": anchor is not None}
    tracks: list[ScoredTrack] = []
    for name, available in possible.items():
        with suppress(LogError):  # a reference track without truth does not fail the run
            tracks += [score(log, timeline, name, settings, identification)] if available and name != method else []
    return tuple(tracks)


def require_scenario(log: str | Path) -> None:
    """Raise UsageError for a recorded log, which has no bound."""
    if not is_simulated(log):
        raise UsageError(f"--bound: {log} is a recorded log; the bound needs the true states of a scenario")


def bound(scenario: str | Path, timeline: Timeline, parameters: Parameters, seed: int = 0) -> PositionBound:
    """Return the posterior Cramer-Rao bound of the position on a scenario's dive: the least sigma of any filter.

    The timeline is that of ``open_log(scenario, seed=seed)``, the assumptions those of the filters. Raises
    UsageError for a recorded log, whose true states are unknown, and for assumptions that have no bound.
    """
    require_scenario(scenario)
    return position_bound(simulate(find_scenario(str(scenario)), seed), timeline, parameters)
