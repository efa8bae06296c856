"""The options that replay, compare and check share."""

import math
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any

import click

from usbldr.filters.errors import UsageError
from usbldr_cli.options.completion import FILTERS, Suggested, places, sensor_errors
from usbldr_cli.options.option import filter_option, packed_options, scoring_option

if TYPE_CHECKING:
    from usbldr.io.log import Log
    from usbldr.io.session import RunSettings


@dataclass(frozen=True, slots=True)
class RunChoices:
    """The options of a run, as given."""

    particles: int = 100  # the N of the paper
    gate: float | None = None
    seed: int = 0
    start: str | None = None
    end: str | None = None
    align: str = "auto"
    dr_from: str = "start"
    fast_hz: float = 5.0  # [Hz] epochs of the filter
    slow_hz: float = 1.0  # [Hz] scored epochs
    calibrate: str | None = None
    noise: tuple[str, ...] = ()
    smooth: bool = False
    aid: str | None = None
    order: str = "validity"
    guard: bool | None = None
    exclude: tuple[str, ...] = ()

    def settings(self, start_ns: int | None = None) -> "RunSettings":
        """Return the choices in values; the window only with the absolute time of the log's start, ns since 1970.

        Raises UsageError for invalid text.
        """
        from usbldr.filters.evaluation.error_report import Window
        from usbldr.io.session import RunSettings
        from usbldr_cli.options.option_texts import aid_windows, noise_family

        return RunSettings(
            particles=self.particles,
            gate=self.gate,
            seed=self.seed,
            smooth=self.smooth,
            order=self.order,
            guard=self.guard,
            calibrate=None if self.calibrate is None else _keys(self.calibrate),
            noise=dict(noise_family(text) for text in self.noise),
            aid=None if self.aid is None else aid_windows(self.aid),
            dr_from=_place(self.dr_from),
            window=Window() if start_ns is None else Window(*self._window(start_ns)),
            align=self.align,
        )

    def edited(self, log: "Log") -> "Log":
        """Return the log without the records that --exclude names; raise UsageError for invalid text."""
        from usbldr_cli.options.option_texts import excluded_windows

        for sensor, windows in excluded_windows(self.exclude).items():
            log = log.without_windows(sensor, windows)
        return log

    def _window(self, start_ns: int) -> tuple[float, float]:
        start = -math.inf if self.start is None else seconds_of_log("--start", self.start, start_ns)
        end = math.inf if self.end is None else seconds_of_log("--end", self.end, start_ns)
        if not start < end:
            raise UsageError(f"--start {self.start} is not before --end {self.end}")
        return start, end


def _add_plugins(_ctx: click.Context, _option: click.Parameter, given: tuple[str, ...]) -> None:
    """Let this process and those that it starts know the filters of --plugin."""
    if not given:
        return
    from usbldr.filters.plugins import VARIABLE, asked_for
    from usbldr.filters.replay.methods import add_named

    for text in map(_with_whole_path, given):
        add_named(text)
        os.environ[VARIABLE] = "\n".join(dict.fromkeys([*asked_for(), text]))


def _with_whole_path(text: str) -> str:
    place, colon, name = text.rpartition(":")
    return f"{os.path.abspath(place)}{colon}{name}" if place.endswith(".py") else text


def align_option(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add --align."""
    return scoring_option(
        "--align",
        type=click.Choice(["auto", "none", "shift", "first", "rigid", "body"]),
        default="auto",
        metavar="HOW",
        help="Align track and truth: none, shift, first, rigid or body; auto: shift if the map origin is unknown.",
    )(command)


run_options = packed_options(
    RunChoices,
    "choices",
    (
        filter_option(
            "--plugin",
            multiple=True,
            is_eager=True,  # before every option that names filters
            expose_value=False,
            callback=_add_plugins,
            metavar="MODULE:NAME",
            help="Filter of your own, a usbldr.Method: my_package:MINE or my_filters.py:MINE; see docs/extend.md.",
            rare=True,
        ),
        filter_option(
            "--particles",
            "-N",
            type=click.IntRange(min=2),
            metavar="N",
            default=100,
            help="Particles ({draws}).",
            used_by="draws",
        ),
        filter_option(
            "--gate",
            type=click.FloatRange(0, 1, min_open=True, max_open=True),
            metavar="P",
            help="Reject measurements outside a gate that passes a share P of inliers ({takes_gate}).  "
            "[default: no gate]",
            rare=True,
        ),
        filter_option(
            "--seed",
            type=click.IntRange(min=0),
            default=0,
            metavar="N",
            help="Seed of random numbers.",
            used_by="draws",
        ),
        scoring_option("--start", metavar="TIME", help="Score from this time on: seconds of the log, or ISO 8601."),
        scoring_option("--end", metavar="TIME", help="Score up to this time.  [default: all of LOG]"),
        align_option,
        scoring_option(
            "--dr-from",
            default="start",
            type=Suggested(places),
            metavar="WHERE",
            help="Start of dead reckoning: start, first-fix, first-gps, first-truth or LAT,LON.",
            rare=True,
        ),
        filter_option(
            "--calibrate",
            type=Suggested(sensor_errors, several=True),
            metavar="LIST",
            help="Sensor errors: auto, none or names.  [default: as configured, else auto]",
            used_by="estimates",
        ),
        filter_option(
            "--noise",
            multiple=True,
            metavar="SENSOR=KIND",
            help="Noise family of a sensor: usbl=student-t:4, dvl=mixture:0.3:10, compass=gaussian, "
            "usbl=contamination:0.05:10:record.",
            rare=True,
            used_by="is_filter",
        ),
        filter_option(
            "--order",
            type=click.Choice(["validity", "arrival"]),
            default="validity",
            help="Use fixes at their time of validity, or when they arrive at the vehicle.",
            rare=True,
            used_by="is_filter",
        ),
        filter_option(
            "--guard/--no-guard",
            default=None,
            help="Keep several hypotheses while fixes contradict the track "
            "(default for {multiple_hypotheses_by_default}).",
            rare=True,
            used_by="multiple_hypotheses",
        ),
        filter_option("--smooth", is_flag=True, help="Estimate each epoch from the whole dive."),
        filter_option(
            "--aid",
            metavar="gps@FROM:TO,...",
            help="Use GPS fixes as measurements in these windows, in seconds of the log, which are not scored.",
            rare=True,
        ),
        filter_option(
            "--exclude",
            multiple=True,
            metavar="SENSOR@FROM:TO,...",
            help="Leave out the records of dvl, compass or usbl in these windows, in seconds of the log.",
            rare=True,
        ),
        filter_option(
            "--fast-hz", type=float, metavar="HZ", default=5.0, help="Epochs of the filter per second.", rare=True
        ),
        scoring_option("--slow-hz", type=float, metavar="HZ", default=1.0, help="Scored epochs per second.", rare=True),
    ),
)
"""Add the options; the command gets them as one RunChoices, ``choices``."""


def _keys(text: str) -> tuple[str, ...]:
    """Return the keys of --calibrate in the order of STATES."""
    from usbldr.filters.models.calibration import AUTO, STATES, layout_for

    keys = [key.strip() for key in text.split(",") if key.strip()]
    if keys == ["none"]:
        return ()
    if keys == [AUTO]:
        return (AUTO,)
    layout_for(keys)
    return tuple(key for key in STATES if key in keys)


def _place(text: str) -> str | tuple[float, float]:
    lat_deg, comma, lon_deg = text.partition(",")
    try:
        return (float(lat_deg), float(lon_deg)) if comma else text
    except ValueError:
        return text


def seconds_of_log(option: str, text: str, start_ns: int) -> float:
    """Return seconds of the log from seconds or ISO time (UTC without a time zone)."""
    try:
        return float(text)
    except ValueError:
        pass
    try:
        moment = datetime.fromisoformat(text)
    except ValueError as err:
        raise UsageError(f"{option} {text} is neither seconds nor ISO time (2026-01-01T12:00:00Z)") from err
    moment = moment if moment.tzinfo else moment.replace(tzinfo=UTC)
    whole_s = int(moment.timestamp() // 1)
    return (whole_s - start_ns // 10**9) + (moment.microsecond * 1000 - start_ns % 10**9) / 1e9


def filters_option(what: str, default: str | None = None) -> Callable[[Any], Any]:
    """Add --filters; ``what`` they are."""
    return filter_option("--filters", "-f", type=FILTERS, metavar="LIST", default=default, help=what)


def seeds_option(default: int) -> Callable[[Any], Any]:
    """Add --seeds."""
    several = click.IntRange(min=1)
    text = "Runs of each method."
    return filter_option("--seeds", type=several, default=default, metavar="N", help=text, used_by="draws")


def filter_list(filters: str, choices: RunChoices) -> list[str]:
    """Return the names in a list of filters; refuse options that none of them takes."""
    from usbldr.filters.replay.methods import METHODS, method_named, methods_that

    choices.settings()  # refuses wrong values
    names = [name.strip() for name in filters.split(",") if name.strip()]
    if not names:
        raise UsageError(f"--filters names no filter (filters: {', '.join(METHODS)})")
    methods = [method_named(name) for name in names]
    refuse_repeats("--filters", names)
    if choices.gate is not None and not any(method.takes_gate for method in methods):
        raise UsageError(f"--gate is for {methods_that(lambda m: m.takes_gate)}, none of which is compared")
    if choices.aid is not None and not any(method.is_filter for method in methods):
        raise UsageError("--aid is for filters, none of which is compared")
    return names


def refuse_repeats(what: str, names: Sequence[str]) -> None:
    """Raise UsageError if an option or argument names something twice."""
    repeated = [name for k, name in enumerate(names) if name in names[:k]]
    if repeated:
        raise UsageError(f"{what} names {repeated[0]} twice")
