"""Logs in, results out: readers, conventions, geodesy, the timeline, and the files of a run.

Here every convention of a log is turned into the one of usbldr (see usbldr.filters): east, north, up metres; starboard,
forward, up velocities in m/s; heading in degrees clockwise from true north; time in seconds since the log's start.
Integer nanoseconds and foreign frames never get past a reader.
"""

from typing import TYPE_CHECKING

from usbldr.filters.lazy_exports import lazy_exports

if TYPE_CHECKING:
    from usbldr.io.findings import Finding
    from usbldr.io.geodesy import Origin
    from usbldr.io.log import Log
    from usbldr.io.messages.layouts import MessageLayout
    from usbldr.io.provenance import Convention, Provenance
    from usbldr.io.reader import Reader, Records, TopicInfo
    from usbldr.io.reading.epochs import timeline
    from usbldr.io.reading.opening import Request
    from usbldr.io.reports.python_runs import to_frame, write_run
    from usbldr.io.reports.run import ScoredTrack
    from usbldr.io.session import RunSettings, bound, evaluate, open_log, reference_tracks, replay, resolve, score

__all__ = [
    "Convention",
    "Finding",
    "Log",
    "MessageLayout",
    "Origin",
    "Provenance",
    "Reader",
    "Records",
    "Request",
    "RunSettings",
    "ScoredTrack",
    "TopicInfo",
    "bound",
    "evaluate",
    "open_log",
    "reference_tracks",
    "replay",
    "resolve",
    "score",
    "timeline",
    "to_frame",
    "write_run",
]
_HOMES = {
    "findings": ("Finding",),
    "geodesy": ("Origin",),
    "log": ("Log",),
    "messages.layouts": ("MessageLayout",),
    "provenance": ("Convention", "Provenance"),
    "reading.epochs": ("timeline",),
    "reading.opening": ("Request",),
    "reader": ("Reader", "Records", "TopicInfo"),
    "reports.python_runs": ("to_frame", "write_run"),
    "reports.run": ("ScoredTrack",),
    "session": ("RunSettings", "bound", "evaluate", "open_log", "reference_tracks", "replay", "resolve", "score"),
}
__getattr__ = lazy_exports(__name__, _HOMES)
