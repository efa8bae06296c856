"""Quaternions of a compass as what is used of them: yaw, and the vertical in the axes of the vehicle."""

from dataclasses import replace

import numpy as np

from usbldr.filters.types import Array
from usbldr.io.messages.layouts import RawRecords, blocks
from usbldr.io.reader import Column

QUATERNION = ("qx", "qy", "qz", "qw")
YAW, NO_DIRECTION = "yaw_deg", "no_direction"  # quantities that replace a quaternion
VERTICAL_PARTS = ("vertical_y", "vertical_x", "vertical_z")  # along -y, x, z of the body, times the quaternion's square
MIN_LENGTH = 0.5  # [-] of a quaternion: a shorter one states no direction


def with_yaw(raw: RawRecords, tilted: bool) -> RawRecords:
    """Return records with YAW and NO_DIRECTION in place of quaternions, and VERTICAL_PARTS if ``tilted``.

    Yaw is that about the z axis of the quaternion's frame, degrees. Other records are returned as they are.
    """
    if not raw.values.keys() >= set(QUATERNION):
        return raw
    x, y, z, w = (raw.number(name) for name in QUATERNION)
    values: dict[str, Column] = {name: column for name, column in raw.values.items() if name not in QUATERNION}
    values[YAW] = np.degrees(np.arctan2(2.0 * (w * z + x * y), w * w + x * x - y * y - z * z))
    values[NO_DIRECTION] = np.sqrt(x * x + y * y + z * z + w * w) < MIN_LENGTH
    if tilted:
        parts = (-2 * (y * z + w * x), 2 * (x * z - w * y), w * w + z * z - x * x - y * y)
        values |= dict(zip(VERTICAL_PARTS, parts, strict=True))
    return replace(raw, values=values)


def vertical(raw: RawRecords, convention: str, bias_deg: float) -> Array:
    """Return the direction of the vertical along starboard, forward, up of the vehicle, (n, 3), by VERTICAL_PARTS.

    Their body is FLU in an ENU world, FRD in an NED one, and is turned clockwise from the bow by the bias.
    """
    found = np.empty((len(raw.received_ns), 3))
    for rows in blocks(len(found)):
        starboard, forward, up = (raw.values[name][rows] for name in VERTICAL_PARTS)
        forward = forward * (1 if convention == "ENU" else -1)
        c, s = np.cos(np.radians(bias_deg)), np.sin(np.radians(bias_deg))
        turned = np.column_stack([starboard * c + forward * s, forward * c - starboard * s, up])
        length = np.linalg.norm(turned, axis=1, keepdims=True)
        found[rows] = turned / np.where(length > 0, length, np.nan)
    return found
