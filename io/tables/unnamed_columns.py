"""Text files of numbers between blanks whose columns have no names, because their format fixes them."""

from collections.abc import Sequence
from pathlib import Path

TUM: tuple[str, ...] = ("timestamp", "tx", "ty", "tz", "qx", "qy", "qz", "qw")
"""The columns of a TUM file (evo, trajectopy): Unix seconds, position in metres, quaternion."""
FNV: tuple[str, ...] = (
    *("year", "month", "day", "hour", "minute", "second", "timestamp", "longitude", "latitude", "heading_deg"),
    *("speed_kmph", "draft_m", "roll_deg", "pitch_deg", "heave_m"),
    *("port_lon_deg", "port_lat_deg", "starboard_lon_deg", "starboard_lat_deg"),
)
"""The columns of an MB-System fast navigation file, ``mblist -OtMXYHScRPr=X=Y+X+Y``: date, Unix seconds, degrees."""


def unnamed_columns(file: Path, first: Sequence[str]) -> tuple[str, ...] | None:
    """Return the columns of a file by its ending, or by the cells of its first line; None if they have names."""
    if file.suffix.lower() == ".fnv":
        return FNV
    return TUM if list(first) == list(TUM) or (len(first) == len(TUM) and all(map(is_number, first))) else None


def is_number(cell: str) -> bool:
    """Return whether a cell holds a number."""
    try:
        float(cell)
    except ValueError:
        return False
    return True
