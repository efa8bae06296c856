"""Headings of any kind as degrees clockwise from true north, and every convention chosen.

A heading that counts from magnetic north has the declination added: a stated one, or that of the World Magnetic Model.
An error of the compass that the configuration states is subtracted.
"""

import re
from dataclasses import dataclass, replace

import numpy as np

from usbldr.filters.errors import SettingError, UsageError
from usbldr.filters.types import Mask, Vector
from usbldr.io.axes import named_ned
from usbldr.io.conventions.attitude import YAW, vertical, with_yaw, without_direction
from usbldr.io.conventions.converted import ConvertedTable, chosen_convention, converted_table, corrections, valid_mask
from usbldr.io.conventions.timestamps import times_of
from usbldr.io.findings import Finding
from usbldr.io.geodesy import Origin
from usbldr.io.messages.layouts import RawRecords, blocks
from usbldr.io.provenance import ChosenBy, Convention
from usbldr.io.settings.sensor_sections import CompassSection
from usbldr.io.settings.toml_text import quoted
from usbldr.io.units import DEG_PER_UNIT

PER_RECORD = "as each record says"  # in place of a convention or a unit
BEYOND = "far beyond a whole turn"  # why headings are refused
LARGER_CIRCLES = ("0.1deg", "mil", "0.01deg")  # units of headings that are larger than in degrees
BY_RANGE = "by range"  # in place of a unit: the largest value decides
COMPASS_SD_DEG = 0.3  # if not stated
MAGNETIC, UTM_GRID = 0, 2  # of compass_msgs/Azimuth: reference
DEGREES = 1  # fixed: of its unit; 0: radians
CLOCKWISE = 1  # fixed: of its orientation, from north; 0: counter-clockwise from east
NEWTON_STEPS = 8  # from 30 degrees to far below a compass's resolution
MAGNETIC_NAME = re.compile(r"magnetic|(^|[/_])(mag|hdm)($|[/_])")
VERTICAL = ("vertical_starboard", "vertical_forward", "vertical_up")  # columns of an attitude
MIN_CONSTANT_RECORDS = 100  # fewer may be equal by chance
GON_MARGIN = 20.0  # [deg] half of the difference of circles of 360 and 400
GON_RECORDS = 10  # [records] above 380, at least; fewer may be damage
LARGEST_DEG = 400.0  # of a heading: a whole turn, and a declination that was added to it; 511 is no data in AIS


@dataclass(frozen=True, slots=True)
class KeyTexts:
    """The keys that correct a heading, as messages name them."""

    declination: str = "declination_deg under [compass]"
    radians: str = 'state [compass] unit = "rad"'
    gon: str = 'state [compass] unit = "gon"'


OF_COMPASS = KeyTexts()
OF_HEAD = KeyTexts(
    "heading_declination_deg in head of [usbl]", "name another heading_topic in head of [usbl]", "multiply them by 0.9"
)


def compass(
    raw: RawRecords, section: CompassSection, place: Origin | None, keys: KeyTexts = OF_COMPASS
) -> ConvertedTable:
    """Turn headings to degrees clockwise from true north, 0 to 360; invalid records are left out.

    ``place`` is that of the declination. Raises LogError if all records are invalid, UsageError if a declination is
    requested but its place or time is unknown.
    """
    times = times_of(raw, section.time, section.latency_s, section.clock_step_s, "compass")
    raw = with_yaw(raw)
    heading, causes, chosen, findings = _clockwise(raw, section, keys)
    good, invalid = valid_mask(raw, causes, "compass", "left out")
    added, more_chosen, more = _declination(raw, section, place, int(times.time_ns[np.argmax(good)]), keys)
    chosen, findings = [*chosen, *more_chosen], [*findings, *more, *invalid, *_constant(raw, heading, good)]
    for rows in blocks(len(heading)):
        heading[rows] = heading[rows] - section.bias_deg + added[rows]
    A, B = section.deviation_sin_deg, section.deviation_cos_deg
    if A or B:
        heading = without_deviation(heading, A, B)
    chosen += corrections("deg", bias_deg=section.bias_deg, deviation_sin_deg=A, deviation_cos_deg=B)
    sd, sd_chosen = _sd_deg(raw, section)
    columns = {"heading_deg": np.mod(heading, 360.0, out=heading), "sd_deg": sd}
    made = converted_table(times, columns, [*chosen, sd_chosen], findings).only(good)
    if raw.attitude is None:
        return made
    return replace(made, attitude=_attitude(raw.attitude, section, str(chosen[0].value)))


def _attitude(raw: RawRecords, section: CompassSection, convention: str) -> ConvertedTable:
    """Return the direction of the vertical along the axes of the vehicle, VERTICAL."""
    enu = convention == "ENU" and "qx" in raw.layout.required  # roll and pitch are the same for every heading
    along = vertical(raw, "ENU" if enu else "NED", section.bias_deg)
    times = times_of(raw, section.time, section.latency_s, section.clock_step_s, "compass")
    return converted_table(times, dict(zip(VERTICAL, along.T, strict=True)), (), ())


def without_deviation(read_deg: Vector, A: float, B: float) -> Vector:
    """Return the headings H, (n,), at which a compass reads H + A sin H + B cos H; degrees, A and B up to 30."""
    heading = read_deg
    for _ in range(NEWTON_STEPS):
        s, c = np.sin(np.radians(heading)), np.cos(np.radians(heading))
        heading = heading - (heading + A * s + B * c - read_deg) / (1 + np.radians(A * c - B * s))
    return heading


def _clockwise(
    raw: RawRecords, section: CompassSection, keys: KeyTexts
) -> tuple[Vector, dict[str, Mask], list[Convention], list[Finding]]:
    """Return headings clockwise from any north, degrees (n,); which are invalid, by cause; conventions."""
    defined = "angle" in raw.values and "convention" in {*raw.layout.defaults, *raw.layout.fixed}
    by_frame = "NED" if named_ned(raw.frame_id) and not defined else None
    convention, by_key, findings = chosen_convention(raw, "convention", section.convention or by_frame, "ENU")
    if by_frame and not section.convention:
        chosen = [Convention("convention", convention, "frame_id", note=raw.frame_id)]
    else:
        chosen = [Convention("convention", convention, "records" if convention == PER_RECORD else by_key.chosen_by)]
    if section.unit is not None and "angle" not in raw.values:
        text = "unit of the configuration is not used; its records are not plain angles"
        findings = [*findings, raw.finding("KEY-UNUSED", text)]
    if "field_x" in raw.values:
        return _magnetometer(raw, convention, chosen, findings)
    if "angle" not in raw.values:
        yaw = raw.values[YAW]
        return (90.0 - yaw if convention == "ENU" else yaw.copy()), without_direction(raw), chosen, findings
    unit, stated, more = chosen_convention(raw, "unit", section.unit, "deg")
    unit_by, unit_note = stated.chosen_by, ""
    angle, findings = raw.number("angle"), [*findings, *more]
    size = np.abs(angle[np.isfinite(angle)])
    within = size[size <= LARGEST_DEG]  # a larger one means no data
    largest = float(np.max(within if len(within) else size, initial=0.0))
    if unit == BY_RANGE:
        unit, unit_by, unit_note = ("deg" if largest > 7.0 else "rad"), "values", f"up to {largest:.3g}"
    in_degrees = raw.number("unit_code") == DEGREES if unit == PER_RECORD else np.full(len(angle), unit == "deg")
    from_east = raw.number("sense_code") != CLOCKWISE if convention == PER_RECORD else convention == "ENU"
    angle = np.where(in_degrees, angle, angle * DEG_PER_UNIT.get(unit, DEG_PER_UNIT["rad"]))
    if unit_by == "default" and largest < 6.3:
        text = f"no value is above 6.3; if they are radians, {keys.radians}"
        findings = [*findings, raw.finding("HEADING-UNIT", text)]
    if unit == "deg" and _like_gon(angle):
        text = f"its headings go round at 400, as gon do, not at 360; {keys.gon}"
        findings = [*findings, raw.finding("HEADING-UNIT", text)]
    causes = {
        "not a number": ~np.isfinite(angle),
        BEYOND: _beyond_a_turn(raw, angle, unit),
        "from the north of a UTM grid": raw.number("north_code") == UTM_GRID,
    }
    chosen.append(Convention("unit", unit, "records" if unit == PER_RECORD else unit_by, note=unit_note))
    return np.where(from_east, 90.0 - angle, angle), causes, chosen, findings


def _beyond_a_turn(raw: RawRecords, angle_deg: Vector, unit: str) -> Mask:
    """Return which angles (n,) are on no circle, as -9999 for no data; raise LogError if most are."""
    beyond = np.abs(angle_deg) > LARGEST_DEG
    if 2 * np.count_nonzero(beyond) > np.count_nonzero(np.isfinite(angle_deg)):
        largest_deg = float(np.max(np.abs(angle_deg[beyond])))
        beside = ", beside columns" * ("unit" in raw.layout.fixed)
        raise raw.fault(
            f"most headings of {raw.topic.name} are {BEYOND}, up to {largest_deg:g} deg if their unit is {unit}; state "
            f"their own under [compass]{beside}, as {' or '.join(map(quoted, LARGER_CIRCLES))}; or they count turns: "
            "convert them to degrees from 0 to 360"
        )
    return beyond


def _like_gon(angle_deg: Vector) -> bool:
    """Return whether headings (n,) jump by a circle of 400, never by one of 360, and some are between the two."""
    known = angle_deg[np.isfinite(angle_deg)]
    rounds = np.abs(np.diff(known))
    rounds = rounds[(rounds > 360.0 - GON_MARGIN) & (rounds <= 400.0)]
    between = np.count_nonzero((known > 360.0 + GON_MARGIN) & (known <= 400.0))
    return bool(rounds.min(initial=np.inf) > 400.0 - GON_MARGIN and len(rounds) and between >= GON_RECORDS)


def _magnetometer(
    raw: RawRecords, convention: str, chosen: list[Convention], findings: list[Finding]
) -> tuple[Vector, dict[str, Mask], list[Convention], list[Finding]]:
    """Return the heading of a level magnetometer: x forward, y to port (ENU) or to starboard (NED)."""
    forward, y = raw.number("field_x"), raw.number("field_y")
    port = y if convention == "ENU" else -y
    text = "headings of a magnetometer, neither levelled nor calibrated against the vehicle's iron"
    causes = {"not a number": ~np.isfinite(forward + port), "no horizontal field": (forward == 0) & (port == 0)}
    found = [*findings, raw.finding("HEADING-MAGNETOMETER", text)]
    return np.degrees(np.arctan2(port, forward)), causes, chosen, found


def _magnetic(raw: RawRecords) -> Mask | None:
    """Return which records (n,) count from magnetic north by their type or fields; None: not stated."""
    if "north_code" in raw.values:
        return raw.number("north_code") == MAGNETIC
    if "is_true" in raw.values:
        return raw.number("is_true") == 0
    return np.ones(len(raw.received_ns), dtype=np.bool_) if "field_x" in raw.values else None


def _declination(
    raw: RawRecords, section: CompassSection, place: Origin | None, time_ns: int, keys: KeyTexts
) -> tuple[Vector, list[Convention], list[Finding]]:
    """Return the degrees to add to each record, (n,), their conventions, and findings."""
    magnetic, stated_deg = _magnetic(raw), section.declination_deg
    zero = np.broadcast_to(np.zeros(1), len(raw.received_ns))
    if magnetic is not None and not magnetic.any():
        if not stated_deg:
            return zero, [Convention("north", "true", "records")], []
        text = "of the configuration is not used; its records count from true north"
        unused = raw.finding("KEY-UNUSED", f"{keys.declination.split()[0]} {text}")
        return zero, [Convention("north", "true", "records")], [unused]
    if stated_deg is None and magnetic is None:
        if not MAGNETIC_NAME.search(raw.topic.name.lower()):
            return zero, [], []
        text = f'state {keys.declination}: "auto" or a number, 0 if they are true'
        text = f"read as true headings, but the topic's name suggests magnetic; {text}"
        return zero, [], [raw.finding("HEADING-MAGNETIC", text)]
    if isinstance(stated_deg, float):
        value, chosen_by, model_text = stated_deg, "configuration", ""
    elif place is not None:
        from usbldr.io.conventions.declination import declination  # loads the model

        try:
            (value, model_text), chosen_by = declination(place, time_ns), "model"
        except UsageError as err:
            raise UsageError(f"{raw.topic.name}: {err}", path=raw.log, topic=raw.topic.name) from err
    elif stated_deg == "auto":
        raise SettingError(
            f'{keys.declination} = "auto": no position is known; '
            "state origin_lat_deg and origin_lon_deg under [map], or the declination as a number"
        )
    else:
        text = f"state {keys.declination}, or origin_lat_deg and origin_lon_deg under [map]"
        text = f"headings are magnetic and are not corrected, because no position is known; {text}"
        return zero, [Convention("north", "magnetic", "records")], [raw.finding("HEADING-MAGNETIC", text)]
    partly = [] if magnetic is None or magnetic.all() else [f"to {np.sum(magnetic)} magnetic records"]
    note = ", ".join([model_text, *partly] if model_text else partly)
    chosen = [Convention("declination_deg", value, chosen_by, "deg", note)] if value else []
    added = np.where(np.ones(1, dtype=np.bool_) if magnetic is None else magnetic, value, 0.0)
    return np.broadcast_to(added, len(raw.received_ns)), chosen, []


def _sd_deg(raw: RawRecords, section: CompassSection) -> tuple[Vector, Convention]:
    """Return the 1-sigma of each record, degrees (n,), and who chose it."""
    if isinstance(section.sd_deg, float):
        chosen = Convention("sd_deg", section.sd_deg, "configuration", "deg")
        return np.broadcast_to(np.array([section.sd_deg]), len(raw.received_ns)), chosen
    sd = raw.number("sd_deg")
    if section.sd_deg == "message":
        in_degrees = raw.number("unit_code") == DEGREES
        squares = {
            "variance_deg2": 1.0,
            "variance_rad2": np.degrees(1.0) ** 2,
            "variance": np.where(in_degrees, 1.0, np.degrees(1.0) ** 2),
        }
        for quantity, to_deg2 in squares.items():
            variance = raw.number(quantity) * to_deg2
            sd = np.where(np.isfinite(sd), sd, np.sqrt(np.where(variance > 0, variance, np.nan)))
    known = np.isfinite(sd)
    if not known.any():
        chosen = Convention("sd_deg", COMPASS_SD_DEG, "default", "deg")
        return np.broadcast_to(np.array([COMPASS_SD_DEG]), len(sd)), chosen
    chosen_by: ChosenBy = "configuration" if section.sd_deg else "column names"
    chosen = Convention("sd_deg", float(np.nanmedian(sd)), chosen_by, "deg", "median of the records")
    return np.where(known, sd, COMPASS_SD_DEG), chosen


def _constant(raw: RawRecords, heading: Vector, good: Mask) -> list[Finding]:
    count, first = np.count_nonzero(good), heading[np.argmax(good)]
    if count < MIN_CONSTANT_RECORDS or np.any((heading != first) & good):
        return []
    text = f"all {count} headings are {first % 360.0:.1f} deg; check the sensor"
    return [raw.finding("HEADING-CONSTANT", text)]
