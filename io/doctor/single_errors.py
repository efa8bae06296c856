"""One error of a log that explains what axes, sense of heading and mounting would only explain together.

The eight interpretations, with any rotation, also fit a log whose headings have the wrong sign, whose velocities are
exchanged, or whose latitudes and longitudes are; but they take two or three of them. An error that alone makes dead
reckoning fit the fixes, hardly rotated, is the likelier cause.
"""

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from usbldr.filters.errors import listed
from usbldr.filters.identification.dr_usbl_fit import as_points, fit_rotation, segment_numbers
from usbldr.filters.types import Timeline
from usbldr.io.doctor.interpretations import InterpretationResult, recorded_value, reinterpret
from usbldr.io.doctor.thresholds import THRESHOLDS
from usbldr.io.findings import Finding
from usbldr.io.geodesy import Origin, to_geodetic, to_plane
from usbldr.io.log import Log

AS_READ = (False, False, False)
MAX_TURN_DEG = 20.0  # a declination and a mount that nobody stated; the errors turn a track by multiples of 90
NOT_BY_KEYS = "correct them in the log"


class SingleError(NamedTuple):
    """An error, and the timeline without it."""

    code: str
    role: str
    what: str
    advice: str
    line: Timeline


def single_errors(log: Log, timeline: Timeline, result: InterpretationResult) -> tuple[list[SingleError], float]:
    """Return the errors that alone explain the fixes clearly better, and the RMS that is left, in metres.

    None if an interpretation explains as much by one change. Several fit alike if the vehicle hardly drifts sideways.
    """
    read, best = result.as_read, result.best
    group = segment_numbers(timeline, timeline.fix_time_s)
    largest_rad = np.radians(MAX_TURN_DEG)
    changes = sum(best.flips) + (abs(best.offset_deg) > MAX_TURN_DEG)
    better = THRESHOLDS.clearly_better_ratio
    most_m = min(better * read.residual_m, best.residual_m * (better if changes < 2 else 1 / better))
    found = [(fit_rotation(reinterpret(log, one.line, AS_READ), group), one) for one in _candidates(log, timeline)]
    fitting = [(fit.rms_m, one) for fit, one in found if fit.rms_m <= most_m and abs(fit.rotation_rad) < largest_rad]
    if not fitting:
        return [], best.residual_m
    least_m = min(rms_m for rms_m, _ in fitting)
    alike = [(rms_m, one) for rms_m, one in fitting if rms_m * better <= least_m]
    return [one for _, one in sorted(alike, key=lambda pair: pair[0])], least_m


def single_error_findings(
    log: Log, result: InterpretationResult, errors: list[SingleError], rms_m: float
) -> list[Finding]:
    """Report the errors of `single_errors`, one of which the log has."""
    rivals = [f"{log.topic_of(one.role)}, {one.what}" for one in errors[1:]]
    or_else = f"; or else: of {listed(rivals, len(rivals))}" if rivals else ""
    first, read_m = errors[0], result.as_read.residual_m
    text = (
        f"{first.what}: with this corrected, dead reckoning fits the fixes within "
        f"{rms_m:.2f} m RMS, as read and rotated within {read_m:.2f} m; {first.advice}{or_else}"
    )
    return [log.finding(first.code, first.role, text, None, read_m, "m")]


def _candidates(log: Log, timeline: Timeline) -> Iterator[SingleError]:
    sense, axes = recorded_value(log, "compass", "convention"), recorded_value(log, "dvl", "axes")
    if sense:
        other = "NED" if sense == "ENU" else "ENU"
        key = f'state convention = "{other}" and bias_deg = {log.settings.compass.bias_deg + 90:g} under [compass]'
        advice = NOT_BY_KEYS if log.convention("compass", "convention").chosen_by == "column names" else key
        turned = replace(timeline, dr_yaw_rad=-timeline.dr_yaw_rad)
        yield SingleError("HEADING-CONVENTION", "compass", "its headings have the wrong sign", advice, turned)
    if axes and not log.settings.dvl.mount_deg:
        sign = -1.0 if axes[1] in "LP" or axes[0] in "LP" else 1.0
        key = f'state axes = "{axes[1]}{axes[0]}{axes[2:]}" under [dvl]'
        advice = "exchange their columns" if log.convention("dvl", "axes").chosen_by == "column names" else key
        exchanged = replace(timeline, dr_mps=sign * timeline.dr_mps[:, ::-1])
        yield SingleError("DVL-AXES", "dvl", "its first two velocities are exchanged", advice, exchanged)
    velocity = as_points(timeline.dr_mps)
    for east_north in (turn * one for turn in (1, 1j, -1, -1j) for one in (velocity, velocity.conj())):  # of any axes
        components = np.column_stack([east_north.real, east_north.imag])
        what = "its velocities are along east and north, not along axes of the vehicle or instrument"
        along = replace(timeline, dr_mps=components, dr_yaw_rad=np.zeros(len(timeline.time_s)))
        yield SingleError("DVL-EARTH", "dvl", what, "record them in instrument axes", along)
    if recorded_value(log, "usbl", "kind") == "latlon" and log.origin is not None:
        lat_deg, lon_deg = to_geodetic(log.origin, *timeline.fix_m.T)
        for what, lat, lon in (
            ("its longitudes have the wrong sign", lat_deg, -lon_deg),
            ("its latitudes have the wrong sign", -lat_deg, lon_deg),
            ("latitude and longitude are exchanged", np.clip(lon_deg, -90, 90), lat_deg),
        ):
            there = Origin(float(np.median(lat)), float(np.median(lon)), log.origin.kind)
            moved = replace(timeline, fix_m=np.column_stack(to_plane(there, lat, lon)))
            yield SingleError("MAP-FRAME", "usbl", what, NOT_BY_KEYS, moved)
