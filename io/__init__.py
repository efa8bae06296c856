"""Logs in, results out: readers, conventions, geodesy, the timeline, and the files of a run.

Here every convention of a log is turned into the one of usbldr (see usbldr.filters): east, north, up metres; starboard,
forward, up velocities in m/s; heading in degrees clockwise from true north; time in seconds since the log's start.
Integer nanoseconds and foreign frames never get past a reader.
"""

from usbldr.filters.lazy_exports import lazy_exports

__all__, __getattr__ = lazy_exports(__name__, __file__)  # pyright: ignore[reportUnsupportedDunderAll]
