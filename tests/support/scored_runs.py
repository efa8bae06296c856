"""Runs of a simulated dive beside raw fixes and dead reckoning, all held against its truth."""

from typing import Any

import numpy as np

from usbldr.filters.evaluation.error_report import Window
from usbldr.filters.evaluation.evaluation import evaluate
from usbldr.filters.identification.identification import Identification
from usbldr.filters.replay import dead_reckoning
from usbldr.filters.types import Timeline, Trajectory
from usbldr.io.log import Log
from usbldr.io.reports.run import Run, ScoredTrack

WHOLE = Window()


def scored(log: Log, line: Timeline, track: Trajectory, window: Window = WHOLE, align: str = "none") -> ScoredTrack:
    assert log.truth is not None
    times_s = None if track.method == "usbl" else line.time_s[line.slow]
    return ScoredTrack(track, evaluate(track, log.truth, window, align, times_s))


def run_of(
    log: Log, line: Timeline, track: Trajectory, window: Window = WHOLE, align: str = "none", **more: Any
) -> Run:
    tracks = (track, dead_reckoning.usbl(line), dead_reckoning.dr(line, np.zeros(2)))
    first, *others = (scored(log, line, one, window, align) for one in tracks)
    return Run(log, line, Identification(log.parameters), first, tuple(others), **more)
