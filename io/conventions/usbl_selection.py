"""Which of a USBL's records are fixes of the vehicle, and of which kind they are; of any sensor's, which device's."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from usbldr.filters.errors import SettingError, UsageError
from usbldr.filters.types import Mask
from usbldr.io.conventions.converted import chosen_convention
from usbldr.io.conventions.positions import place_causes
from usbldr.io.conventions.repeats import copied_fixes
from usbldr.io.conventions.timestamps import least_delay_ns
from usbldr.io.findings import Finding
from usbldr.io.geodesy import Origin
from usbldr.io.messages.layouts import RawRecords
from usbldr.io.messages.roles import ROLES
from usbldr.io.provenance import Convention
from usbldr.io.settings.sensor_sections import UsblSection
from usbldr.io.settings.toml_text import quoted

FULL_FIX = 2  # fixed: of dmac's mUSBLFix: 0 has a range alone, 1 an angle alone
REPLIES_WITH_RANGE = ("MSG_RESPU", "MSG_RESPX")  # SeaTrac's kinds of messages with a range, as HoloOcean uses them
STALE_NS = 9_900 * 1_000_000_000  # fixed: COLA2 stamps so if it has no fix
SPREAD_DEG = 0.1  # a dive stays within 10 km, in degrees
MOST_DEVICES = 8  # more are numbers of something else
OF_EACH = "write those of each to a file of its own"


def records_of_one(
    raw: RawRecords, role: str, stated: str | int | None
) -> tuple[RawRecords, list[Convention], list[Finding]]:
    """Return the fixes of one target of a USBL, or the records of one of the devices that a column of a table names.

    Raises UsageError if there are several and none, or a missing one, is named. A column for devices counts if a few
    of them measured.
    """
    key, record, records = ("target", "fix", "fixes") if role == "usbl" else ("device", "record", "records")
    quantity = key if key in raw.values else "device"
    if quantity not in raw.values:
        text = f"{key} of the configuration is not used; its records name no {key}"
        return raw, [], [] if stated is None else [raw.finding("KEY-UNUSED", text)]
    all_names = _names(raw, quantity)
    names, counts = np.unique(all_names, return_counts=True)
    if quantity == "device" and stated is None:
        numbers = [raw.number(name) for name, one in raw.values.items() if one.dtype.kind != "U" and name != quantity]
        if not 1 < len({*all_names[np.isfinite(numbers).any(axis=0)]} - {""}) <= MOST_DEVICES:
            return raw, [], []
    listed = ", ".join(f"{name or 'no name'} ({n} {records})" for name, n in zip(names, counts, strict=True))
    wanted = str(stated) if stated is not None else str(names[0]) if len(names) == 1 else None
    if wanted is None:
        advice = f"choose one under [{role}]: {key} = {quoted(str(next(filter(None, names))))}"
        text = (
            f"{raw.topic.name} holds {records} of {len(names)} {key}s: {listed}; {advice if role in ROLES else OF_EACH}"
        )
        raise UsageError(text, path=raw.log, topic=raw.topic.name)
    if wanted not in names:
        raise SettingError(f"[{role}] {key}: {raw.topic.name} holds no {record} of {wanted} (its {key}s: {listed})")
    chosen = Convention(key, wanted, "configuration")
    if stated is None:
        chosen = Convention(key, wanted, "data", note="the only one")
    part = raw.part(all_names == wanted)
    if raw.attitude is not None:
        part = replace(part, attitude=raw.attitude.part(_names(raw.attitude, quantity) == wanted))
    return part, [chosen], []


def _names(raw: RawRecords, key: str) -> NDArray[np.str_]:
    """Return the targets or devices as texts, (n,); a number that a format has only as 3.0 is 3."""
    column = raw.values[key]
    whole = column.dtype.kind == "f" and bool(np.all(column == np.trunc(column)))
    return np.asarray(column.astype(np.int64) if whole else column, dtype=np.str_)


def without_repeats(raw: RawRecords, kind: str, section: UsblSection) -> tuple[RawRecords, list[Finding]]:
    """Leave out fixes that repeat the one before: their source is polled more often than it pings.

    Fixes from a head that moves are compared before they are placed on the map, latitudes with all that stands beside
    them; the others' places are judged with the whole log.
    """
    repeated = np.zeros(len(raw.received_ns), dtype=np.bool_)
    if kind == "latlon" and not raw.topic.type.startswith("usbldr/"):
        columns = [column for name, column in raw.values.items() if name != "age_s" and not name.startswith("header.")]
        repeated[1:] = np.all([(c[1:] == c[:-1]) | (c[1:] != c[1:]) & (c[:-1] != c[:-1]) for c in columns], axis=0)
    elif section.beacon is not None or (section.head and (section.head.topic or section.head.heading_topic)):
        names = ("slant_range_m", "bearing_deg") if kind == "range_bearing" else ("x", "y")
        repeated = copied_fixes(np.column_stack([raw.number(name) for name in names]))
    repeated &= np.any([np.isfinite(raw.number(name)) for name in raw.layout.required], axis=0)
    if not repeated.any():
        return raw, []
    text = f"{repeated.sum()} of {len(repeated)} fixes repeat the previous one to the last digit; left out"
    return raw.part(~repeated), [raw.finding("USBL-REPEATED", text)]


def kind_of_fixes(
    raw: RawRecords, section: UsblSection, origin: Origin | None
) -> tuple[str, Convention, list[Finding]]:
    """Return the kind of the fixes and its convention; refuse one that the records cannot have."""
    kind, chosen, findings = chosen_convention(raw, "kind", section.kind, "position")
    have = {"latlon"} if "lat_deg" in raw.layout.required else {"position", "latlon"}
    have = {"range_bearing"} if "slant_range_m" in raw.layout.required else have
    if kind not in have:
        could = " or ".join(sorted(have))
        raise SettingError(f'[usbl] kind = "{kind}": {raw.topic.name} ({raw.topic.type}) can only be {could}')
    stated = (section.frame, section.relative_to, section.head, section.beacon)
    unstated = chosen.chosen_by == "default" and stated == (None,) * 4
    if unstated and raw.layout.type.startswith("pose") and _like_latitudes(raw, origin):
        text = (
            "x and y are read as latitude and longitude, because their values allow it; "
            'if they are metres, state kind = "position" under [usbl]'
        )
        return "latlon", Convention("kind", "latlon", "values"), [raw.finding("USBL-LATLON", text)]
    return kind, chosen, findings


def _like_latitudes(raw: RawRecords, origin: Origin | None) -> bool:
    """Tell whether a pose's x and y are degrees, as COLA2 fills them: near the origin, or hardly changing at all."""
    x, y = raw.number("x"), raw.number("y")
    known = np.isfinite(x) & np.isfinite(y) & ((x != 0) | (y != 0))  # (0, 0) is a position that was never filled in
    x, y = x[known], y[known]
    if len(x) < 3 or max(np.abs(x).max(), np.abs(y).max() / 2) > 90:
        return False
    if origin is not None:
        return bool(np.abs(x - origin.lat_deg).max() < SPREAD_DEG and np.abs(y - origin.lon_deg).max() < SPREAD_DEG)
    return bool(0 < np.ptp(x) < SPREAD_DEG and np.ptp(y) < SPREAD_DEG and np.hypot(x, y).min() > 1)


def fix_causes(raw: RawRecords, frame: str = "") -> dict[str, Mask]:
    """Return by cause which fixes (n,) are invalid, by their places and by the system's own flags.

    In the frame latlon, x and y are degrees.
    """
    x, y, slant_m = raw.number("x"), raw.number("y"), raw.number("slant_range_m")
    by_range = "slant_range_m" in raw.layout.required
    offset = "relative_to" in raw.layout.defaults
    unknown = ~(np.isfinite(slant_m) & np.isfinite(raw.number("bearing_deg")))
    of_range = {"not a number": unknown, "flagged invalid": raw.flagged_invalid}
    return (of_range if by_range else place_causes(raw, frame)) | {
        "flagged as an outlier by the system itself": raw.number("outlier") == 1,
        "of range or angle alone": (raw.number("fix_kind") < FULL_FIX)
        | (~np.isin(raw.text("reply"), REPLIES_WITH_RANGE) & ("reply" in raw.values)),
        "stamped hours before arrival": _stale(raw),
        "of negative accuracy": raw.number("sd_m") < 0,
        "exactly at the head": ((x == 0) & (y == 0) & offset) | (slant_m <= 0),
    }


def _stale(raw: RawRecords) -> Mask:
    if raw.stamp_ns is None or raw.topic.type.startswith("usbldr/"):
        return np.zeros(len(raw.received_ns), dtype=np.bool_)
    return raw.stamped & (raw.received_ns - raw.stamp_ns - least_delay_ns(raw) > STALE_NS)
