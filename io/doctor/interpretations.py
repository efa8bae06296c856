"""The eight interpretations of a log's axes, yaw and map, each compared with its USBL fixes.

A DVL may be mirrored, a yaw may count the other way, a map may be NED instead of ENU. Dead reckoning by each of them is
rotated and shifted onto the fixes. The residual distinguishes them, except from the mirror image, in which all three
are reversed; another source decides that. Headings in degrees clockwise, positions in metres, east + i north.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from usbldr.filters.identification.dr_usbl_fit import (
    MIN_FIXES,
    Points,
    RotationFit,
    as_points,
    dead_reckoned,
    fit_rotation,
    jackknife_rotation_sd_rad,
    segment_numbers,
)
from usbldr.filters.models.noise import robust_sd
from usbldr.filters.types import Indices, Timeline, Vector
from usbldr.io.conventions.sanity import MAX_SEPARATION_M
from usbldr.io.doctor.thresholds import THRESHOLDS
from usbldr.io.log import Log
from usbldr.io.messages.field_names import named_column
from usbldr.io.provenance import chosen_by_text

FLIP_CLASSES = tuple((dvl, yaw, False) for dvl in (False, True) for yaw in (False, True))  # Interpretation.flips
OPPOSITE_AXES = str.maketrans("SRPLUD", "PLSRDU")


@dataclass(frozen=True, slots=True)
class Interpretation:
    """One interpretation of a log, and how well it fits."""

    flips: tuple[bool, bool, bool]  # against how the log was read: DVL mirrored, yaw the other way, map mirrored
    axes: str  # [dvl] axes
    convention: str  # [compass] convention
    frame: str  # [usbl] frame, "" if fixes have none
    fit: RotationFit  # of dead reckoning to the fixes, both by this interpretation

    @property
    def offset_deg(self) -> float:
        """Clockwise: add it to [dvl] mount_deg, or subtract it from [compass] bias_deg."""
        return float(np.degrees(-self.fit.rotation_rad))

    @property
    def residual_m(self) -> float:
        """RMS distance of the fixes from rotated and shifted dead reckoning."""
        return self.fit.rms_m

    @property
    def mirror_class(self) -> tuple[bool, bool]:
        """What only this interpretation and its mirror image have in common."""
        dvl, yaw, world = self.flips
        return dvl != world, yaw != world

    @property
    def conventions(self) -> tuple[tuple[str, str, str], ...]:
        """Sensor, key and value of each convention."""
        return ("dvl", "axes", self.axes), ("compass", "convention", self.convention), ("usbl", "frame", self.frame)

    @property
    def description(self) -> str:
        """Name the conventions."""
        frame = f", frame {self.frame}" if self.frame else ""
        return f"axes {self.axes}, convention {self.convention}{frame}"


@dataclass(frozen=True, slots=True)
class HandednessEvidence:
    """A source other than DVL, heading and fixes that distinguishes an interpretation from its mirror image."""

    name: str
    flip_index: int  # of Interpretation.flips
    flipped: bool  # its answer

    def agrees(self, interpretation: Interpretation) -> bool:
        """Tell whether the interpretation agrees with the source."""
        return interpretation.flips[self.flip_index] == self.flipped


@dataclass(frozen=True, slots=True)
class InterpretationResult:
    """How a log was read, how it should be read, and which source decided."""

    as_read: Interpretation
    best: Interpretation
    interpretations: tuple[Interpretation, ...]  # all, best first
    offset_sd_deg: float  # of the best one
    decided_by: HandednessEvidence | None  # None: the mirror image fits equally well
    contradicting: tuple[HandednessEvidence, ...]  # sources that contradict
    plausible: tuple[Interpretation, ...]  # that fit nearly as well as the best and agree with the source
    log_odds: float | None = None  # of the best against the next, each with sensor errors; None: by the residuals

    @property
    def mirror_image(self) -> Interpretation | None:
        """The mirror image of the best one; None if the fixes' frame has none."""
        flips = tuple(not flip for flip in self.best.flips)
        return next((r for r in self.interpretations if r.flips == flips), None)

    @property
    def observable(self) -> bool:
        """False if two that are not mirror images of each other fit almost equally well."""
        return len({r.mirror_class for r in self.plausible}) == 1

    @property
    def heading_sense_known(self) -> bool:
        """Tell whether the yaw's sense is known, and with it the sign of a rotation or delay."""
        return len({r.mirror_class[1] for r in self.plausible}) == 1


def compare_interpretations(
    log: Log, timeline: Timeline, sources: Sequence[HandednessEvidence] = ()
) -> InterpretationResult | None:
    """Fit each interpretation to the fixes; None if too few fixes are near valid dead reckoning.

    Also None if they are latitudes so far from the origin that the plane is distorted.

    ``sources`` are those that the log's tables do not hold, such as gravity, the most reliable first.
    """
    group = segment_numbers(timeline, timeline.fix_time_s)
    if np.sum(group >= 0) < MIN_FIXES or not np.ptp(np.abs(dead_reckoned(timeline, timeline.fix_time_s))) > 0:
        return None
    latlon = recorded_value(log, "usbl", "kind") == "latlon"
    if latlon and np.median(np.abs(as_points(timeline.fix_m))) > MAX_SEPARATION_M:
        return None
    interpretations = [
        _interpretation(log, flips, fit_rotation(reinterpret(log, timeline, flips), group)) for flips in FLIP_CLASSES
    ]
    read = interpretations[0]
    if read.frame in ("ENU", "NED"):  # a map has a mirror image, which fits as well; latitudes have none
        interpretations += [_mirror_image_of(log, timeline, r, group) for r in interpretations]
    least = min(r.residual_m for r in interpretations)
    fits = least <= THRESHOLDS.fitting_sigmas * white_noise_m(timeline)
    ratio = THRESHOLDS.clearly_better_ratio if fits else THRESHOLDS.gross_residual_ratio
    plausible = [r for r in interpretations if r.residual_m * ratio <= least]
    by_fit = min(plausible, key=lambda r: (r.residual_m * (1 - 1e-6 * (r == read)), sum(r.flips)))

    evidence = [
        *_geodetic_evidence(log),
        *_gps_evidence(log, timeline, by_fit, group),
        *sources,
        *_stated_evidence(log),
    ]
    decided_by = None
    for source in evidence:
        agreeing = [r for r in plausible if source.agrees(r)]
        if agreeing and len(agreeing) < len(plausible) and decided_by is None:
            plausible, decided_by = agreeing, source
    named = {one for one in read.conventions if log.convention(*one[:2]).chosen_by == "column names"}
    best = min(plausible, key=lambda r: (r != read, len(named.difference(r.conventions)), r.residual_m, sum(r.flips)))
    reinterpreted = reinterpret(log, timeline, best.flips)
    return InterpretationResult(
        offset_sd_deg=float(np.degrees(jackknife_rotation_sd_rad(reinterpreted, group, best.fit.latency_s))),
        as_read=read,
        best=best,
        interpretations=tuple(sorted(interpretations, key=lambda r: r.residual_m)),
        decided_by=decided_by,
        contradicting=tuple(source for source in evidence if decided_by is not None and not source.agrees(best)),
        plausible=tuple(sorted(plausible, key=lambda r: r.residual_m)),
    )


def white_noise_m(timeline: Timeline) -> float:
    """Return the sigma of the fixes' white noise along an axis, without outliers."""
    steps = np.diff(as_points(timeline.fix_m) - dead_reckoned(timeline, timeline.fix_time_s))  # shorter than the noise
    return robust_sd(np.concatenate([steps.real, steps.imag]))


def reinterpret(log: Log, timeline: Timeline, flips: tuple[bool, bool, bool]) -> Timeline:
    """Return the timeline of the reference point by another interpretation of the records (fixes up to a shift)."""
    line = flipped(log, timeline, flips)
    dvl, transponder = (np.asarray(arm[:2]) for arm in (log.parameters.dvl_lever_m, log.parameters.usbl_lever_m))
    if dvl.any() and len(line.time_s) > 1:
        rate: Vector = np.gradient(line.dr_yaw_rad, line.time_s)
        line = replace(line, dr_mps=line.dr_mps - rate[:, None] * np.array([-dvl[1], dvl[0]]))
    if transponder.any():
        yaw = np.interp(line.fix_time_s, line.time_s, line.dr_yaw_rad)
        ahead = np.exp(1j * yaw) * complex(*transponder)
        line = replace(line, fix_m=line.fix_m - np.column_stack([ahead.real, ahead.imag]))
    return line


def flipped(log: Log, timeline: Timeline, flips: tuple[bool, bool, bool]) -> Timeline:
    """Return the timeline by another interpretation; DVL and transponder stay where they are."""
    settings = log.settings
    dvl, yaw, world = flips
    u, v = timeline.dr_mps.T
    if dvl:  # the instrument's starboard changes sign, and the mount rotates it as before
        rotation = np.exp(-2j * np.radians(settings.dvl.mount_deg))
        other = -np.conj(u + 1j * v) * rotation
        u, v = other.real, other.imag
    psi = timeline.dr_yaw_rad
    if yaw:  # heading' = 90 - heading, with bias and declination on the same side as before
        added, subtracted = (log.convention("compass", key).value for key in ("declination_deg", "bias_deg"))
        psi = -psi - np.radians(90.0 + 2 * (float(added or 0.0) - float(subtracted or 0.0)))
    line = replace(timeline, dr_mps=np.column_stack([u, v]), dr_yaw_rad=psi)
    if yaw and settings.usbl.beacon and settings.usbl.frame == "body" and line.fix_away_m is not None:
        turned = np.exp(1j * np.interp(line.fix_time_s, line.time_s, psi - timeline.dr_yaw_rad))
        moved = as_points(line.fix_away_m) * (turned - 1)  # the compass has turned these fixes about the beacon
        line = replace(line, fix_m=line.fix_m + np.column_stack([moved.real, moved.imag]))
    return replace(line, fix_m=line.fix_m[:, ::-1], fix_cov_m2=line.fix_cov_m2[:, ::-1, ::-1]) if world else line


def recorded_value(log: Log, role: str, key: str) -> str:
    """Return a convention by which a sensor was read, "" if there is none or each record has its own."""
    found = log.convention(role, key)
    return str(found.value) if found.chosen_by != "records" else ""


def _mirror_image_of(log: Log, timeline: Timeline, interpretation: Interpretation, group: Indices) -> Interpretation:
    dvl, yaw, world = interpretation.flips
    flips = (not dvl, not yaw, not world)
    fit = fit_rotation(reinterpret(log, timeline, flips), group, [interpretation.fit.latency_s])
    return _interpretation(log, flips, fit)


def _interpretation(log: Log, flips: tuple[bool, bool, bool], rotation: RotationFit) -> Interpretation:
    dvl, yaw, world = flips
    axes = recorded_value(log, "dvl", "axes") or "SFU"
    yaw_from = recorded_value(log, "compass", "convention") or "compass"
    kind, frame = recorded_value(log, "usbl", "kind"), recorded_value(log, "usbl", "frame")
    frame = frame or ("" if kind in ("latlon", "range_bearing") else "ENU")
    return Interpretation(
        flips=flips,
        axes=axes.translate(OPPOSITE_AXES) if dvl else axes,
        convention=("NED" if yaw_from == "ENU" else "ENU") if yaw else yaw_from,
        frame=({"ENU": "NED", "NED": "ENU"}.get(frame, "")) if world else frame,
        fit=rotation,
    )


def _geodetic_evidence(log: Log) -> list[HandednessEvidence]:
    what = {"latlon": "latitudes and longitudes", "range_bearing": "bearings clockwise from north"}
    kind = recorded_value(log, "usbl", "kind")
    return [HandednessEvidence(f"the fixes are {what[kind]}", 2, False)] if kind in what else []


def _gps_evidence(log: Log, timeline: Timeline, best: Interpretation, group: Indices) -> list[HandednessEvidence]:
    """Compare the track and its mirror image with GPS up to a shift; only which fits better is used.

    GPS of another place decides nothing: exchanged coordinates are a mirror image themselves. Nor does one whose own
    frame is only the default.
    """
    apart = any(finding.code == "PLACES-APART" for finding in log.findings)
    if apart or log.convention("gps", "frame").chosen_by == "default":
        return []
    reinterpreted = reinterpret(log, timeline, best.flips)
    rotation = best.fit
    stretch = _groups_of_gps(timeline, group)
    used = stretch >= 0
    gps = as_points(timeline.gps_m)[used]
    if len(gps) < 2 or _rms(gps) < THRESHOLDS.min_gps_spread_m:
        return []
    track = (
        np.exp(1j * rotation.rotation_rad) * dead_reckoned(reinterpreted, timeline.gps_time_s[used])
        + rotation.shift_m[stretch[used]]
    )
    apart_m, mirrored_m = _rms(track - gps), _rms(1j * np.conj(track) - gps)
    if min(apart_m, mirrored_m) > THRESHOLDS.gps_mirror_ratio * max(apart_m, mirrored_m):
        return []
    ratio = max(apart_m, mirrored_m) / max(min(apart_m, mirrored_m), 0.1)
    name = f"GPS, which the track fits {ratio:.0f} times better than its mirror image does"
    return [HandednessEvidence(name, 2, best.flips[2] != (mirrored_m < apart_m))]


def _groups_of_gps(timeline: Timeline, group: Indices) -> Indices:
    """Return the stretch of each GPS fix, -1 if that stretch has no USBL fix."""
    times = np.concatenate([timeline.fix_time_s, timeline.gps_time_s])
    both = segment_numbers(timeline, times)
    of_fixes, of_gps = both[: len(group)], both[len(group) :]
    names = {int(b): int(g) for b, g in zip(of_fixes, group, strict=True) if g >= 0}
    return np.array([names.get(int(b), -1) for b in of_gps], dtype=np.intp)


def _stated_evidence(log: Log) -> list[HandednessEvidence]:
    """Return what names, types, a scenario and the configuration state."""
    found: list[HandednessEvidence] = []
    heading, frame = log.convention("compass", "convention"), log.convention("usbl", "frame")
    for role, chosen, part in (("compass", heading, 1), ("usbl", frame, 2)):
        if chosen.chosen_by in ("frame_id", "column names"):
            name = f"{log.provenance[role].topic} is {chosen.value} {chosen_by_text(chosen)}"
            found.append(HandednessEvidence(name, part, False))
    layout = log.raws["compass"].layout if "compass" in log.raws else None
    yaw = layout and layout.by_columns and not any(map(named_column, layout.required.values()))  # of either sense
    if heading.value == "compass" and heading.chosen_by == "type" and not yaw:
        name = f"{log.provenance['compass'].topic} counts clockwise {chosen_by_text(heading)}"
        found.append(HandednessEvidence(name, 1, False))
    if log.format == "simulated":
        found.append(HandednessEvidence("the scenario's own east and north", 2, False))
    settings = log.settings
    for key, value, part in (("frame", settings.usbl.frame, 2), ("convention", settings.compass.convention, 1)):
        if value is not None:
            found.append(HandednessEvidence(f'the configuration states {key} = "{value}"', part, False))
    return found


def _rms(points: Points) -> float:
    spread: Vector = np.abs(points - np.mean(points))
    return float(np.sqrt(np.mean(spread**2)))
