"""Directions of the x, y and z axes of an instrument: by letters that a user states, or by the name of their frame."""

import re

LETTERS = {"S": (0, 1), "R": (0, 1), "P": (0, -1), "L": (0, -1), "F": (1, 1), "B": (1, -1), "U": (2, 1), "D": (2, -1)}


def axis_signs(axes: str) -> tuple[tuple[int, int], ...]:
    """Return for x, y and z which of (starboard, forward, up) it is, and with which sign.

    ``axes`` has one letter for each: F(orward), B(ackward), S(tarboard) or R(ight), P(ort) or L(eft), U(p), D(own).
    """
    signs = tuple(LETTERS.get(letter, (-1, 0)) for letter in axes.upper())
    if len(signs) != 3 or {axis for axis, _ in signs} != {0, 1, 2}:
        raise ValueError(
            f'axes = "{axes}" is not three perpendicular directions; '
            "give one letter each for x, y and z: F or B, S (R) or P (L), U or D"
        )
    return signs


def _word(word: str) -> re.Pattern[str]:
    """Match a word in a name like world_ned, worldNed or NED; not within another, as in imu_aligned."""
    alone, inside, loud = f"(?<![A-Za-z])(?i:{word})", f"(?<=[a-z]){word.title()}", f"(?<![A-Z]){word.upper()}"
    return re.compile(f"({alone}|{inside}|{loud})(?![a-z])")


NED, ENU, FRD = _word("ned"), _word("enu"), _word("frd")


def named_ned(frame_id: str) -> bool:
    """Return whether a frame's name means north, east, down."""
    return NED.search(frame_id) is not None


def named_enu(frame_id: str) -> bool:
    """Return whether a frame's name means east, north, up."""
    return ENU.search(frame_id) is not None


def named_frd(frame_id: str) -> bool:
    """Return whether a frame's name means forward, starboard, down: a body frame in a north, east, down world."""
    return named_ned(frame_id) or FRD.search(frame_id) is not None
