"""DVL and depth in the axes, units and signs of usbldr, and every convention chosen.

An error of a sensor that the configuration states is subtracted here. Angles are degrees clockwise.
"""

import numpy as np

from usbldr.filters.errors import SettingError
from usbldr.filters.frames import rotated
from usbldr.filters.types import Mask, Vector
from usbldr.io.axes import axis_signs, named_frd
from usbldr.io.conventions.converted import ConvertedTable, chosen_convention, converted_table, corrections, valid_mask
from usbldr.io.conventions.spikes import depth_spikes
from usbldr.io.conventions.timestamps import times_of
from usbldr.io.findings import Finding
from usbldr.io.messages.dvl import (
    FAST_SHARE,
    FAST_SHARE_NAMED,
    TOO_FAST,
    dvl_advice,
    dvl_causes,
    in_other_unit,
    inverse_interval,
    usual_unit,
)
from usbldr.io.messages.layouts import RawRecords
from usbldr.io.provenance import ChosenBy, Convention
from usbldr.io.settings.sensor_sections import DepthSection, DvlSection
from usbldr.io.units import MPS_PER_UNIT, PASCALS_PER_UNIT, spellings

WATER_PA_PER_M = 1025.0 * 9.80665  # fixed: sea water
USUAL_SOUND_SPEED_MPS = 1500.0  # fixed: what DVLs assume unless another is set
SURFACE_PA = 101325.0  # fixed: the standard atmosphere
MIN_AIR_PRESSURE_PA = 5e4  # of air, wherever there is water to dive in
AT_SEA_LEVEL_PA = 8.7e4, 1.085e5  # fixed: the least and the greatest that were ever measured
IN_THE_AIR_M = 0.5  # above this for half of the log: the sign is wrong
ESTIMATED = "estimated from the records"  # by the timeline
OWN_COLUMNS_BY_NAME = 'columns = { time_ns = "time_ns", x = "starboard_mps", y = "forward_mps" }, axes = "SFU" and '
MAX_DEPTH_M = 12_000.0  # no sea is deeper


def dvl(raw: RawRecords, section: DvlSection) -> ConvertedTable:
    """Turn velocities to starboard, forward, up in m/s; invalid records stay in the table and are marked.

    Raises LogError if all are invalid, or so many too fast that the unit must be wrong.
    """
    usual = "FRD" if named_frd(raw.frame_id) else "FLU"
    axes, axes_chosen, findings = chosen_convention(raw, "axes", section.axes, usual, by_frame=bool(raw.frame_id))
    unit, unit_chosen, more = chosen_convention(raw, "unit", section.unit, "m/s")
    to_mps, unit_by, chosen = MPS_PER_UNIT[unit], unit_chosen.chosen_by, [axes_chosen, unit_chosen]
    by_sound, sound_chosen = _sound_speed_ratio(raw, section)
    instrument = np.full((3, len(raw.received_ns)), np.nan)  # starboard, forward, up of the instrument
    for name, (axis, sign) in zip("xyz", axis_signs(axes), strict=True):
        instrument[axis] = (
            sign * to_mps * by_sound * inverse_interval(raw) * raw.number(name) / (1.0 + section.scale_error)
        )
    chosen += [*sound_chosen, *corrections(scale_error=section.scale_error)]
    mount_by: ChosenBy = "configuration" if section.mount_deg else "default"
    chosen.append(Convention("mount_deg", section.mount_deg, mount_by, "deg"))
    if section.track == "water":
        chosen.append(Convention("track", section.track, "configuration"))
    starboard, forward = rotated(-np.radians(section.mount_deg), instrument[:2].T).T

    if section.min_good_beams is not None and "good_beams" not in raw.values:
        raise SettingError(f"[dvl] min_good_beams: {raw.topic.name} ({raw.topic.type}) has no such field")
    speed_mps = np.hypot(starboard, forward)
    causes = dvl_causes(raw, speed_mps, section.min_good_beams, section.track == "water")
    free = section.unit is None or unit_by == "column names"
    own = OWN_COLUMNS_BY_NAME if unit_by == "column names" else ""
    other = usual_unit(speed_mps[causes[TOO_FAST]] / to_mps)
    valid, invalid = valid_mask(raw, causes, "dvl", "not used", dvl_advice(causes, other if free else "", own))
    if unit_by in ("default", "column names") and in_other_unit(raw, causes, FAST_SHARE_NAMED if own else FAST_SHARE):
        fast = int(np.sum(causes[TOO_FAST]))
        raise raw.fault(
            f"{fast} of {len(valid)} records of {raw.topic.name} (dvl) are {TOO_FAST}; "
            f'state {own}unit = "{other}" under [dvl] if they are {other}, unit = "m/s" if not'
        )
    sd, sd_chosen = _dvl_sd(raw, section, to_mps)
    columns: dict[str, Vector | Mask] = {
        "starboard_mps": starboard,
        "forward_mps": forward,
        "up_mps": instrument[2],
        "sd_mps": sd,
        "valid": valid,
    }
    if "altitude" in raw.values:
        altitude_m = raw.number("altitude")
        columns["altitude_m"] = np.where(valid & (altitude_m > 0) & (altitude_m < MAX_DEPTH_M), altitude_m, np.nan)
    times = times_of(raw, section.time, section.latency_s, section.clock_step_s, "dvl")
    return converted_table(times, columns, [*chosen, sd_chosen], [*findings, *more, *invalid])


def _sound_speed_ratio(raw: RawRecords, section: DvlSection) -> tuple[Vector, list[Convention]]:
    """Return the true speed of sound over the one that the DVL assumed, (n,), and what was chosen.

    A velocity is a Doppler shift times the assumed speed. Without the true one nothing is corrected.
    """
    recorded = raw.number("sound_speed")
    if section.sound_speed_mps is None:
        return np.ones(len(recorded)), []
    usual = USUAL_SOUND_SPEED_MPS if section.assumed_sound_speed_mps is None else section.assumed_sound_speed_mps
    known = (recorded > 0) & (section.assumed_sound_speed_mps is None)
    assumed = np.where(known, recorded, usual)
    note = f"assumed: {np.median(assumed):.1f} m/s" + (", as recorded" if known.any() else "")
    chosen = Convention("sound_speed_mps", section.sound_speed_mps, "configuration", "m/s", note)
    return section.sound_speed_mps / assumed, [chosen]


def _dvl_sd(raw: RawRecords, section: DvlSection, to_mps: float) -> tuple[Vector, Convention]:
    """Return the 1-sigma of each record, (n,), NaN if unknown, and who chose it."""
    own = "sd_mps" in raw.values
    if isinstance(section.sd_mps, float):
        chosen = Convention("sd_mps", section.sd_mps, "configuration", "m/s")
        return np.full(len(raw.received_ns), section.sd_mps), chosen
    if section.sd_mps is None and not own:
        return np.full(len(raw.received_ns), np.nan), Convention("sd_mps", ESTIMATED, "default")
    chosen_by: ChosenBy = "column names" if own else "configuration"
    covariance = np.fmax(raw.number("covariance"), raw.number("own_covariance"))  # a type has one of them at most
    sd = np.sqrt(np.where(covariance > 0, covariance, np.nan))
    stated = np.fmax(raw.number("sd"), raw.number("sd_mps"))
    sd = to_mps * np.where(np.isfinite(sd), sd, np.where(stated > 0, stated, np.nan))
    if not np.isfinite(sd).any():
        return sd, Convention("sd_mps", ESTIMATED, chosen_by, note="the messages state none")
    return sd, Convention("sd_mps", float(np.nanmedian(sd)), chosen_by, "m/s", "median of the messages")


def depth(raw: RawRecords, section: DepthSection) -> ConvertedTable | Finding:
    """Turn pressures or depths to metres below the surface; return a finding if the unit makes no sense.

    Raises LogError if all are invalid.
    """
    unit, unit_chosen, findings = chosen_convention(raw, "unit", section.unit, "m")
    chosen = [unit_chosen]
    if "pressure" in raw.values:
        if unit == "m":
            raise SettingError(f'[depth] unit = "m": {raw.topic.name} holds pressures ({spellings("pressure")})')
        pressure = raw.number("pressure") * PASCALS_PER_UNIT[unit]
        surface = SURFACE_PA if section.surface_pa is None else section.surface_pa
        surface_by = "default" if section.surface_pa is None else "configuration"
        chosen.append(Convention("surface_pa", surface, surface_by, "Pa"))
        stated = section.unit or raw.layout.fixed.get("unit")
        if section.surface_pa is None and (fault := _no_absolute_pressure(pressure, stated)):
            text = f"{raw.topic.name}: not used as depth: {fault} under [depth]"
            return Finding("DEPTH-UNIT", text, raw.topic.name, unit="" if stated else _unit_by_air(pressure))
        value = (pressure - surface) / WATER_PA_PER_M
        if section.positive is not None:
            raise SettingError(f"[depth] positive: {raw.topic.name} holds pressures, to which it does not apply")
    else:
        if section.surface_pa is not None:
            raise SettingError(f"[depth] surface_pa: {raw.topic.name} holds depths, to which it does not apply")
        height = "height" in raw.values
        usual = "up" if height and not named_frd(raw.frame_id) else "down"
        if unit != "m":
            raise SettingError(f'[depth] unit = "{unit}": {raw.topic.name} holds depths in m')
        by_frame = bool(height and raw.frame_id)
        sign, sign_chosen, more = chosen_convention(raw, "positive", section.positive, usual, by_frame)
        value = raw.number("height" if height else "depth") * (1.0 if sign == "down" else -1.0)
        chosen, findings = [*chosen, sign_chosen], [*findings, *more]
        middle = float(np.median(value[np.isfinite(value)])) if np.isfinite(value).any() else 0.0
        if middle < -IN_THE_AIR_M:
            other = f'positive = "{"up" if sign == "down" else "down"}" under [depth]'
            if "positive" in raw.layout.fixed:  # by the name of the column, so that it must be named anew
                own = 'columns = { time_ns = "time_ns", depth_m = "depth_m" }'
                other = f"{'its columns of time and depth' if raw.topic.first_row else own} and {other}"
            text = f"a median depth of {middle:.1f} m, above the water; if it counts the other way, state {other}"
            findings.append(raw.finding("DEPTH-SIGN", text))
    causes = {"not a number": ~np.isfinite(value), f"beyond {MAX_DEPTH_M / 1000:.0f} km": np.abs(value) > MAX_DEPTH_M}
    near = np.flatnonzero(~np.any([*causes.values()], axis=0))
    spikes = near[depth_spikes((raw.received_ns[near] - raw.received_ns[0]) / 1e9, value[near])]
    causes["far from their neighbours"] = np.isin(np.arange(len(value)), spikes)
    good, invalid = valid_mask(raw, causes, "depth", "left out")
    times = times_of(raw, section.time, section.latency_s)
    return converted_table(times, {"depth_m": value}, chosen, [*findings, *invalid]).only(good)


def _unit_by_air(pressures: Vector) -> str:
    """Return the unit in which the least of pressures (n,) is that of the air, and the greatest within the sea."""
    known = pressures[np.isfinite(pressures)]
    (low, most), least, deepest = AT_SEA_LEVEL_PA, np.min(known, initial=np.inf), np.max(known, initial=0.0)
    sea_pa = MAX_DEPTH_M * WATER_PA_PER_M
    return next((u for u, pa in PASCALS_PER_UNIT.items() if low <= least * pa <= most and deepest * pa < sea_pa), "")


def _no_absolute_pressure(pressure_pa: Vector, unit: str | None) -> str:
    """Return why pressures (n,) cannot be absolute ones in pascals, and what to state; empty if they can."""
    known = pressure_pa[np.isfinite(pressure_pa)]
    if not len(known):
        return ""
    low, median = np.quantile(known, [0.05, 0.5])
    if median < MIN_AIR_PRESSURE_PA and unit is None:
        unit = _unit_by_air(pressure_pa)
        fits = f' = "{unit}", in which the least is that of the air,' if unit else f" ({spellings('pressure')})"
        return f"a median of {median:g} cannot be Pa; state unit{fits}"
    if low < MIN_AIR_PRESSURE_PA:
        return f"{low:g} Pa is below air pressure: gauge pressures need surface_pa = 0"
    return ""
