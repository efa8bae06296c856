"""The covariance of east and north of a USBL fix.

It is that of the sensor or the configuration, plus that of the known end: its own position, and the heading that
rotated the line of sight.
"""

import numpy as np

from usbldr.filters.frames import rotation
from usbldr.filters.types import Array, Vector
from usbldr.io.conventions.positions import message_covariance
from usbldr.io.conventions.usbl_head import UsblReference
from usbldr.io.messages.layouts import RawRecords
from usbldr.io.provenance import ChosenBy, Convention
from usbldr.io.settings.sensor_sections import UsblSection

MIN_USBL_SD_M = 0.15  # floor of a covariance's eigenvalues, squared
DEFAULT_SD_M, DEFAULT_SD_REL = 1.0, 0.02  # 2 % of the slant range, at least 1 m


def sensor_covariance(
    section: UsblSection, stated_m2: Array, line_m: Array, drop_m: Vector, levelled: bool = False
) -> tuple[Array, list[Convention]]:
    """Return the covariance of each fix, (n, 2, 2), and who chose it.

    ``stated_m2`` (n, 2, 2) is that of the messages, NaN if they state none; ``line_m`` (n, 2) the horizontal line of
    sight, NaN without a known end, and ``drop_m`` (n,) its vertical part. If slant ranges were ``levelled`` by a depth,
    h² = r² - z², an error of the range is r / h times as large; below h² = 2 r sigma that derivative says too much.
    """
    count = len(line_m)
    slant = np.sqrt(np.sum(line_m**2, axis=-1) + np.nan_to_num(drop_m) ** 2)
    if section.bearing_sd_deg is not None:
        range_m, rel = section.range_sd_m or 0.0, section.range_sd_rel or 0.0
        along, across = range_m**2 + (rel * slant) ** 2, (np.radians(section.bearing_sd_deg) * slant) ** 2
        if levelled:
            level_m2 = np.sum(line_m**2, axis=-1)
            along *= np.maximum(slant**2 / np.maximum(level_m2, 2 * slant * np.sqrt(along) + 1e-9), 1.0)
        parts = (
            ("range_sd_m", range_m, "m"),
            ("range_sd_rel", 100 * rel, "%"),
            ("bearing_sd_deg", section.bearing_sd_deg, "deg"),
        )
        chosen = [Convention(key, value, "configuration", unit) for key, value, unit in parts]
        return _along_and_across(line_m, along, across), chosen
    if isinstance(section.sd_m, float):
        chosen = [Convention("sd_m", section.sd_m, "configuration", "m")]
        return np.tile(np.eye(2) * section.sd_m**2, (count, 1, 1)), chosen
    known = np.isfinite(stated_m2[:, 0, 0])
    default = np.fmax(DEFAULT_SD_M, DEFAULT_SD_REL * slant)  # fmax: 1 m without a known end
    cov = np.where(known[:, None, None], stated_m2, np.eye(2) * (default**2)[:, None, None])
    guess = [Convention("sd_m", DEFAULT_SD_M, "default", "m")]
    if np.isfinite(line_m).any():
        guess = [
            Convention("sd_rel", 100 * DEFAULT_SD_REL, "default", "%"),
            Convention("min_sd_m", DEFAULT_SD_M, "default", "m"),
        ]
    chosen_by: ChosenBy = "configuration" if section.sd_m == "message" else "default"
    if known.all():
        return cov, [Convention("covariance", "of the messages", chosen_by)]
    if known.any():
        some = Convention("covariance", "of the messages", chosen_by, note=f"{np.sum(known)} of {count} state one")
        return cov, [some, *guess]
    return cov, guess


def stated_covariance(raw: RawRecords, frame: str, axes: Array, turn_deg: Vector) -> Array:
    """Return the covariance of east and north that the messages state, (n, 2, 2), NaN if they state none.

    ``axes`` (2, 2) are starboard and forward of x and y in a body frame; ``turn_deg`` (n,) is how far forward, or the
    frame's north, is turned clockwise from north.
    """
    turn = rotation(-np.radians(turn_deg)) @ axes
    return turn @ message_covariance(raw, frame) @ turn.transpose(0, 2, 1)


def reference_covariance(end: UsblReference, turned_m: Array) -> Array:
    """Return what the known end adds to the covariance of each fix, (n, 2, 2).

    ``turned_m`` (n, 2) is all of the fix that the heading turns. A heading that is wrong by d moves it by d across.
    """
    across = np.column_stack([turned_m[:, 1], -turned_m[:, 0]]) * np.radians(end.carrier_heading.sd_deg)[:, None]
    across = np.where(np.any(turned_m != 0, axis=1)[:, None], across, 0.0)
    return across[:, :, None] * across[:, None, :] + np.eye(2) * (end.sd_m**2)[:, None, None]


def _along_and_across(line_m: Array, along: Vector, across: Vector) -> Array:
    """Return U diag(along, across) U', U turning the first axis to the direction of the line, (n, 2, 2)."""
    bearing = np.arctan2(line_m[:, 0], line_m[:, 1])
    c, s = np.cos(bearing), np.sin(bearing)
    ee, nn = along * s * s + across * c * c, along * c * c + across * s * s
    en = (along - across) * s * c
    return np.stack([ee, en, en, nn], axis=-1).reshape(-1, 2, 2)


def with_variance_floor(R: Array) -> Array:
    """Raise the eigenvalues to MIN_USBL_SD_M squared."""
    safe = np.where(np.isfinite(R), R, np.eye(2))  # of fixes that are left out
    values, U = np.linalg.eigh(safe)
    raised = np.einsum("nij,nj,nkj->nik", U, np.maximum(values, MIN_USBL_SD_M**2), U)
    low = values[:, 0] < MIN_USBL_SD_M**2
    return np.where(low[:, None, None], raised, safe)
