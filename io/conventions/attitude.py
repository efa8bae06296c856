"""Attitudes of a compass as what is used of them: yaw, and the vertical in the axes of the vehicle."""

from dataclasses import replace

import numpy as np

from usbldr.filters.types import Array, Mask
from usbldr.io.messages.layouts import RawRecords, blocks
from usbldr.io.reader import Column

QUATERNION = ("qx", "qy", "qz", "qw")
ROLL_PITCH = ("roll_deg", "pitch_deg")  # in place of a quaternion, beside an angle
YAW, NO_DIRECTION = "yaw_deg", "no_direction"  # quantities that replace a quaternion
VERTICAL_PARTS = ("vertical_y", "vertical_x", "vertical_z")  # along -y, x, z of the body, times the quaternion's square
MIN_LENGTH = 0.5  # [-] of a quaternion: a shorter one states no direction


def with_yaw(raw: RawRecords) -> RawRecords:
    """Return records with YAW and NO_DIRECTION in place of quaternions; others are returned as they are.

    Yaw is that about the z axis of the quaternion's frame, degrees.
    """
    if not raw.values.keys() >= set(QUATERNION):
        return raw
    x, y, z, w = (raw.number(name) for name in QUATERNION)
    values: dict[str, Column] = {name: column for name, column in raw.values.items() if name not in QUATERNION}
    values[YAW] = np.degrees(np.arctan2(2.0 * (w * z + x * y), w * w + x * x - y * y - z * z))
    values[NO_DIRECTION] = np.sqrt(x * x + y * y + z * z + w * w) < MIN_LENGTH
    return replace(raw, values=values)


def without_direction(raw: RawRecords) -> dict[str, Mask]:
    """Return which records with YAW (n,) state no direction, by cause."""
    return {
        "not a number": ~np.isfinite(raw.values[YAW]),
        "without orientation (covariance -1)": raw.number("own_covariance") == -1,
        "zero quaternion": raw.values[NO_DIRECTION],
    }


def attitudes(raw: RawRecords) -> RawRecords | None:
    """Return the records that state a quaternion, or roll and pitch, with VERTICAL_PARTS in its place; else None.

    Roll is positive if starboard is down, pitch if the bow is up.
    """
    if raw.values.keys() >= set(ROLL_PITCH):
        stated, (roll, pitch) = ROLL_PITCH, (np.radians(raw.number(name)) for name in ROLL_PITCH)
        parts = (-np.sin(roll) * np.cos(pitch), -np.sin(pitch), np.cos(roll) * np.cos(pitch))
        known = np.isfinite(roll + pitch)
    elif raw.values.keys() >= set(QUATERNION):
        stated, (x, y, z, w) = QUATERNION, (raw.number(name) for name in QUATERNION)
        parts = (-2 * (y * z + w * x), 2 * (x * z - w * y), w * w + z * z - x * x - y * y)
        known = ~np.any(list(without_direction(with_yaw(raw)).values()), axis=0)
    else:
        return None
    values = {name: column for name, column in raw.values.items() if name not in stated}
    return replace(raw, values=values | dict(zip(VERTICAL_PARTS, parts, strict=True))).part(known)


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


def along_level_axes(velocity: Array, vertical: Array) -> Array:
    """Return velocities along starboard, forward, up of a vehicle (n, 3) along the level axes of its heading.

    ``vertical`` (n, 3) is the direction of the vertical along starboard, forward, up. Level forward is the horizontal
    part of the bow, level up the vertical.
    """
    up = vertical / np.linalg.norm(vertical, axis=1, keepdims=True)
    bow = np.array([0.0, 1.0, 0.0]) - up[:, 1:2] * up
    bow = bow / np.linalg.norm(bow, axis=1, keepdims=True)
    return np.einsum("nij,nj->ni", np.stack([np.cross(bow, up), bow, up], axis=1), velocity)


def roll_and_pitch_deg(vertical: Array) -> Array:
    """Return roll (positive: starboard down) and pitch (positive: bow up), (n, 2), by the vertical (n, 3).

    ``vertical`` is its direction along starboard, forward, up.
    """
    starboard, forward, up = vertical.T
    roll, pitch = np.arctan2(-starboard, up), np.arcsin(np.clip(forward, -1, 1))
    return np.degrees(np.column_stack([roll, pitch]))
