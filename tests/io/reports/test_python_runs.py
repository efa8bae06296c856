"""Tables and run directories from Python are those of the command line."""

from pathlib import Path

import pandas as pd
import pytest

import usbldr
from checkout import SAMPLES
from commands import output_of
from usbldr.io.reports.locate import read_smoothed_run
from usbldr.io.reports.run import ScoredTrack


def test_tables_and_run_directories_are_those_of_the_command_line(tmp_path: Path) -> None:
    sample = SAMPLES / "paper.mcap"
    log = usbldr.open_log(sample)
    timeline = usbldr.timeline(log)
    found = usbldr.resolve(log, timeline, "ekf")
    scored = usbldr.score(log, timeline, "ekf", identification=found)
    output_of("replay", sample, "-f", "ekf", "--plots", "none", "-q", "-o", tmp_path / "there")

    here = usbldr.write_run(tmp_path / "here", log, timeline, scored, identification=found)

    for name in ("track_5hz.csv", "errors_1hz.csv", "fixes.csv", "track.tum"):
        assert (here / name).read_bytes() == (tmp_path / "there" / name).read_bytes(), name
    track = usbldr.to_frame(scored.trajectory, log)
    pd.testing.assert_frame_equal(track, pd.read_csv(here / "track_5hz.csv"), atol=1e-4, check_dtype=False)
    assert scored.report is not None
    assert len(usbldr.to_frame(scored.report)) == scored.report.coverage.matched
    assert len(usbldr.to_frame(scored.trajectory, timeline=timeline)) == len(timeline.fix_time_s)
    assert "ekf" in output_of("compare", here, tmp_path / "there")
    with pytest.raises(usbldr.UsageError):
        usbldr.write_run(here, log, timeline, scored)
    with pytest.raises(usbldr.UsageError, match="is not smoothed"):
        read_smoothed_run(here)
    smoothed = usbldr.replay(log, timeline, "ekf", usbldr.RunSettings(smooth=True), found)
    run = read_smoothed_run(usbldr.write_run(tmp_path / "smoothed", log, timeline, ScoredTrack(smoothed, None)))
    assert run.start_ns == log.start_ns


def test_the_names_of_the_package_are_shown() -> None:
    assert set(usbldr.__all__) == set(dir(usbldr))
