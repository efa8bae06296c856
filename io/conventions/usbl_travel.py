"""Travel time of sound, for fixes whose stamps are the arrival of the reply at the head.

Of such a fix, the bearing is that of the arrival, and the range is the mean of the ways out and back; the vehicle was
there when it replied, range / sound speed before. See H. Medwin and C. Clay, "Fundamentals of Acoustical
Oceanography", 1998, section 1.2, for the speed.
"""

from dataclasses import dataclass, replace

import numpy as np

from usbldr.filters.errors import SettingError
from usbldr.filters.types import Array, Vector
from usbldr.io.conventions.timestamps import Times
from usbldr.io.messages.layouts import RawRecords
from usbldr.io.provenance import Convention
from usbldr.io.reader import Nanoseconds
from usbldr.io.settings.sensor_sections import UsblSection

SOUND_SPEED_MPS = 1500.0  # fixed: of sea water at 13 °C; what USBL systems assume unless another is set


@dataclass(frozen=True, slots=True)
class FixTimes:
    """When the head and the vehicle were where n fixes say."""

    times: Times  # its time_ns is when the vehicle was there
    at_head_ns: Nanoseconds  # (n,) when the bearing was measured
    asked_ns: Nanoseconds | None = None  # (n,) when the head sent; None: the fix is of one instant
    slant_m: Vector | None = None  # (n,)
    conventions: tuple[Convention, ...] = ()


def fix_times(raw: RawRecords, kind: str, section: UsblSection, times: Times) -> FixTimes:
    """Return the times of fixes by what their stamps are; raise SettingError if a reply has no range."""
    if section.stamped_at != "reply":
        return FixTimes(times, times.time_ns)
    if kind == "latlon" or section.head is None or section.relative_to == "map":
        raise SettingError('[usbl] stamped_at = "reply" needs fixes that count from a head; state head')
    offset = [raw.number("slant_range_m")] if kind == "range_bearing" else [np.nan_to_num(raw.number(c)) for c in "xyz"]
    slant_m = np.nan_to_num(np.sqrt(sum(part**2 for part in offset))) * section.sound_speed_scale
    speed = section.sound_speed_mps or SOUND_SPEED_MPS
    way_ns = np.rint(1e9 * slant_m / speed).astype(np.int64)
    asked_ns = times.time_ns - 2 * way_ns - round(1e9 * section.turnaround_s)
    chosen_by = "default" if section.sound_speed_mps is None else "configuration"
    chosen = (
        Convention("stamped_at", "reply", "configuration", note=f"one way {np.median(way_ns) / 1e9:.3f} s, median"),
        Convention("sound_speed_mps", speed, chosen_by, "m/s"),
        Convention("turnaround_s", section.turnaround_s, "configuration" if section.turnaround_s else "default", "s"),
    )
    return FixTimes(replace(times, time_ns=times.time_ns - way_ns), times.time_ns, asked_ns, slant_m, chosen)


def moved_by_head_m(away_m: Array, slant_m: Vector, gone_m: Array) -> Array:
    """Return by how much positions are too far, (n, 2): the head went ``gone_m`` (n, 2) between question and reply.

    ``away_m`` (n, 2) points from the head, when it received the reply, to the position. The way out was longer by the
    part of ``gone_m`` along the line of sight, and the range is the mean of both ways.
    """
    along = np.divide(away_m, slant_m[:, None], out=np.zeros_like(away_m), where=slant_m[:, None] > 0)
    return along * np.nan_to_num(np.sum(along * gone_m, axis=1, keepdims=True)) / 2
