"""Calibrate the head of a USBL by a dive: heading and ranges by dead reckoning, tilt and ranges by the depth.

What dead reckoning says of the head is that of `identify`, with priors as wide as those of a survey, and beside the
errors of the vehicle's own sensors: a head that rests may leave both open. Each half of the fixes judges the other.
The vertical of the fixes is that against the log's depth.
"""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from usbldr.filters.errors import LogError
from usbldr.filters.identification.evidence import identify
from usbldr.filters.identification.identification import Identification
from usbldr.filters.identification.linearisation import HEAD, KEYS, RANGE, REPORTED
from usbldr.filters.models.calibration import AUTO
from usbldr.filters.models.parameters import Parameters
from usbldr.filters.replay.dead_reckoning import freed
from usbldr.filters.replay.methods import FilterSettings
from usbldr.filters.replay.run import run
from usbldr.filters.types import Array, Mask, Timeline, Trajectory, Vector
from usbldr.filters.updates import UpdateTable
from usbldr.filters.usbl_survey.calibration import PRIOR_SD, halves
from usbldr.filters.usbl_survey.verdict import SETTLED_SHARE, UNCHANGED, Parameter, Verdict, decided, scatter
from usbldr.filters.usbl_survey.vertical import VerticalFit, vertical_fit
from usbldr.filters.windows import columns_at
from usbldr.io.conventions.timestamps import times_of
from usbldr.io.conventions.usbl import along_axes, along_sight
from usbldr.io.doctor.interpretations import recorded_value
from usbldr.io.findings import Finding
from usbldr.io.log import Log
from usbldr.io.messages.layouts import RawRecords
from usbldr.io.reading.epochs import timeline

METHOD = "adf"  # robust against false fixes, and without random numbers
SMOOTHED = FilterSettings(smooth=True)
(HEADING,), (SCALE,) = KEYS[HEAD], KEYS[RANGE]  # fixed: the states
ANGLE_SD_DEG = float(PRIOR_SD[0])  # of heading, roll and pitch before the dive, as in a survey
RANGE_SD = float(PRIOR_SD[3])  # before the dive, as in a survey
DISAGREEMENT = 13.8  # chi-square of two differences, 1 in 1000
LEG_LEVEL = "drive the ship around the vehicle during the dive, or for longer, or survey a transponder that lies still"
LEG_TILT = "record the vertical of the fixes and the vehicle's depth, and dive on all sides of the head"
RIVALS = {"mount_heading_deg": ("heading of the compass",), "scale": ("scale of the DVL",)}
MIRRORED = (
    "fixes lie as far above the head as the vehicle lies below it: check the third of axes, or the sign of their depth"
)
SOUND_MPS = 1500.0  # of usual sea water, to state a scale as a speed


class DiveCalibration(NamedTuple):
    """What a dive says of the head, and the smoothed track that says it."""

    verdict: Verdict
    identification: Identification
    timeline: Timeline
    track: Trajectory
    slant_m: float  # median

    @property
    def sentence(self) -> str:
        """What the dive held."""
        line, verdict = self.timeline, self.verdict
        minutes = (line.fix_time_s[-1] - line.fix_time_s[0]) / 60
        return (
            f"a dive of {minutes:.0f} min: {len(line.fix_time_s)} fixes at {self.slant_m:.0f} m (median), "
            f"{verdict.false_share:.1%} false; the smoothed track of {METHOD} takes the place of a transponder"
        )


def calibrated_by_dive(log: Log) -> DiveCalibration:
    """Find heading, tilt and scale of the head from a dive; raise LogError if the fixes have no head, or are few."""
    line = timeline(log)
    if line.fix_away_m is None:
        raise LogError("the position of the USBL's head is unknown; state head under [usbl]", path=log.path)
    whole = _identified(log, line)
    track = run(METHOD, line, whole.parameters, SMOOTHED)
    fixes = UpdateTable.of(track.updates).of_sensor("usbl")
    good = np.zeros(len(line.fix_time_s), dtype=np.bool_)
    good[fixes.row] = fixes.outcome == "used"
    sides = halves(len(good))
    parts = [line.with_fixes(side) for side in sides]
    found = [_identified(log, part) for part in parts]
    (one, one_sd), (other, other_sd) = map(_head, found)
    disagreement = float(np.sum((one - other) ** 2 / (one_sd**2 + other_sd**2)))
    slant_m = np.hypot(np.hypot(*line.fix_away_m.T), np.nan_to_num(log.depth_below_head_m(line.fix_time_s)))
    off_m = _judged(line, sides, [_with_head_of(whole.parameters, one.parameters) for one in found])
    before, after = (scatter(each, slant_m, good) for each in off_m)
    median_m = float(np.median(slant_m))
    vertical = vertical_of(log)
    parameters = _parameters(log, whole, vertical, median_m, after.drms_m)
    verdict = decided(parameters, before, after, good, disagreement, DISAGREEMENT)
    if vertical is not None and vertical.mirrored:
        verdict = replace(verdict, result="bad", why=MIRRORED)
    return DiveCalibration(verdict, whole, line, track, median_m)


def _identified(log: Log, line: Timeline) -> Identification:
    """Return what the fixes of a timeline say, those of a head that may be mounted otherwise than stated."""
    errors = replace(log.parameters.errors, usbl_heading_rad=math.radians(ANGLE_SD_DEG), usbl_range=RANGE_SD)
    return identify(line, replace(log.parameters, calibrate=(AUTO,), errors=errors))


def _with_head_of(found: Parameters, other: Parameters) -> Parameters:
    """Return what was found with the head of another, for a part of the fixes."""
    head = {name: other.settled[name] for name in (HEADING, SCALE)}
    return replace(found, settled={**found.settled, **head}, false_fixes=())


def _head(found: Identification) -> tuple[Vector, Vector]:
    """Return heading and scale of the head as states, (2,), and their sigmas, (2,)."""
    value, sd = found.parameters.settled, found.parameters.settled_sd
    return np.array([value[HEADING], value[SCALE]]), np.array([sd[HEADING], sd[SCALE]])


def _judged(line: Timeline, sides: tuple[Mask, Mask], found: list[Parameters]) -> tuple[Array, Array]:
    """Return fixes less the track of their other half: by the head as stated, and by that which it found, (F, 2)."""
    before_m, after_m = np.empty(line.fix_m.shape), np.empty(line.fix_m.shape)
    for side, other, one in zip(sides, sides[::-1], found[::-1], strict=True):
        track = run(METHOD, line.with_fixes(other), one, SMOOTHED)
        as_stated = {name: value for name, value in one.settled.items() if name not in (HEADING, SCALE)}
        for off_m, errors in ((before_m, as_stated), (after_m, one.settled)):
            free = freed(line, errors)
            off_m[side] = (free.fix_m - columns_at(free.fix_time_s, track.time_s, track.position_m))[side]
    return before_m, after_m


def _parameters(
    log: Log, found: Identification, vertical: VerticalFit | None, slant_m: float, noise_m: float
) -> tuple[Parameter, ...]:
    """Return the head's errors as a configuration states them; the tilt is that of the vertical of the fixes."""
    (heading, scale), (heading_sd, scale_sd) = (each.tolist() for each in _head(found))
    usbl, factor = log.settings.usbl, REPORTED[HEADING].factor
    estimates = {
        "mount_roll_deg": (usbl.mount_roll_deg, ANGLE_SD_DEG),
        "mount_pitch_deg": (usbl.mount_pitch_deg, ANGLE_SD_DEG),
        "mount_heading_deg": (usbl.mount_deg - factor * heading, abs(factor) * heading_sd),
        "scale": (usbl.sound_speed_scale / (1 + scale), scale_sd),
    }
    if vertical is not None:
        by_depth = zip(("mount_roll_deg", "mount_pitch_deg", "scale"), vertical.value, vertical.sd, strict=False)
        estimates |= {name: (float(v), float(sd)) for name, v, sd in by_depth if sd < estimates[name][1]}  # the surer
    rows: list[Parameter] = []
    for name, (value, sd) in estimates.items():
        prior_sd, moves_m = (RANGE_SD, slant_m) if name == "scale" else (ANGLE_SD_DEG, math.radians(slant_m))
        if sd > UNCHANGED * prior_sd or sd * moves_m > SETTLED_SHARE * noise_m:
            leg = LEG_LEVEL if name in RIVALS else LEG_TILT
            rows.append(Parameter(name, value, sd, sd * moves_m, True, RIVALS.get(name, ()), leg))
        else:
            rows.append(Parameter(name, value, sd, sd * moves_m, False, (), ""))
    return tuple(rows)


def vertical_of(log: Log) -> VerticalFit | None:
    """Return what the fixes' own vertical says of their head; None if they have none, or the log has no depth."""
    raw = log.raws.get("usbl")
    if raw is None or "depth" not in log.tables:
        return None
    time_s = (times_of(raw, log.settings.usbl.time, log.settings.usbl.latency_s).time_ns - log.start_ns) / 1e9
    along, drop = _measured(log, raw)
    return vertical_fit(drop, log.depth_below_head_m(time_s), along)


def _measured(log: Log, raw: RawRecords) -> tuple[Array, Vector]:
    """Return fixes along starboard and forward, or east and north, (n, 2), and how deep each lies by itself, (n,)."""
    if recorded_value(log, "usbl", "frame") == "body" and "x" in raw.values:
        along, *_ = along_axes(raw, log.settings.usbl)
        return along[:, :2], -along[:, 2]
    slant, bearing = raw.number("slant_range_m"), np.radians(raw.number("bearing_deg"))
    drop = slant * np.sin(np.abs(np.radians(raw.number("elevation_deg"))))
    drop = np.where(np.isfinite(drop), drop, raw.number("depth_m"))
    return along_sight(slant, bearing, drop)[:, :2], drop


def vertical_findings(log: Log) -> list[Finding]:
    """Report tilt of the head and scale of its ranges by the vertical of the fixes, in one line."""
    found = vertical_of(log)
    if found is None:
        return []
    roll, pitch, scale, offset = zip(found.value.tolist(), found.sd.tolist(), strict=True)
    sound = [SOUND_MPS * part for part in scale]
    texts = {
        "roll": "roll {:+.2f} ± {:.2f} deg".format(*roll),
        "pitch": "pitch {:+.2f} ± {:.2f} deg".format(*pitch),
        "scale": "scale {:.4f} ± {:.4f}".format(*scale) + " ({:.0f} ± {:.0f} m/s if 1500 m/s was set)".format(*sound),
        "offset": "offset {:+.2f} ± {:.2f} m".format(*offset),
    }
    left = [name for name, settled in zip(texts, found.settled, strict=True) if not settled]
    known = ", ".join(text for name, text in texts.items() if name not in left)
    open_too = f"; open: {', '.join(left)}" if left and known else ""
    says = MIRRORED if found.mirrored else f"the head has {known or 'nothing is settled'}{open_too}"
    text = f"z of {found.fixes} fixes against the depth: {says}"
    return [log.finding("USBL-VERTICAL", "usbl", f"{text}; noise of z {found.noise_m:.2f} m", None, found.noise_m, "m")]
