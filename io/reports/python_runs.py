"""Tables and run directories for programs in Python: what the command line writes, from values."""

from pathlib import Path

import pandas as pd

from usbldr.filters.evaluation.error_report import ErrorReport
from usbldr.filters.identification.identification import Identification
from usbldr.filters.types import Timeline, Trajectory
from usbldr.io.log import Log
from usbldr.io.reports.report_json import errors_table, fixes_table, write_json, write_tables
from usbldr.io.reports.run import Run, ScoredTrack
from usbldr.io.reports.run_directory import run_directory
from usbldr.io.reports.run_page import write_markdown
from usbldr.io.reports.tracks import track_table


def to_frame(value: Trajectory | ErrorReport, log: Log | None = None, timeline: Timeline | None = None) -> pd.DataFrame:
    """Return the table of a track or of its errors, with the columns of the files of a run directory.

    A track of a ``log`` has latitudes, if its map is known; with the ``timeline`` of its run the table is that of the
    fixes and what became of them.
    """
    if isinstance(value, ErrorReport):
        return errors_table(value)
    if timeline is not None:
        return fixes_table(timeline, value)
    return track_table(value, None if log is None or log.map_unknown else log.origin)


def write_run(
    folder: Path | str,
    log: Log,
    timeline: Timeline,
    scored: ScoredTrack,
    references: tuple[ScoredTrack, ...] = (),
    identification: Identification | None = None,
    force: bool = False,
) -> Path:
    """Write the run directory of a scored track without its figures, as ``usbldr replay --plots none`` does.

    Raises UsageError for a folder that holds something else, or another run without ``force``.
    """
    found = Identification(log.parameters) if identification is None else identification
    run, target = Run(log, timeline, found, scored, references), Path(folder)
    with run_directory(target, force) as new:
        write_tables(new, run)
        write_markdown(new, run, [])
        write_json(new, run)
    return target
