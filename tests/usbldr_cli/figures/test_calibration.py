"""The errors of sensors over time, in the picture and in the track's table."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from usbldr.filters.identification.identification import Identification
from usbldr.filters.models.calibration import assumed_sd, estimated_errors
from usbldr.filters.models.parameters import SensorErrors
from usbldr.filters.replay.run import run as run_filter
from usbldr.io.reading.epochs import timeline
from usbldr.io.reports.run import Run, ScoredTrack
from usbldr.io.reports.tracks import track_table
from usbldr.io.scenarios.shipped import find_scenario
from usbldr.io.scenarios.simulated_log import simulated_log
from usbldr_cli.figures.calibration import calibration_figure
from usbldr_cli.figures.drawing import draw
from usbldr_cli.figures.run_figures import run_pictures
from usbldr_cli.figures.style import in_style

LOG = simulated_log(dataclasses.replace(find_scenario("paper"), duration_s=60.0), seed=1)
TIMELINE = timeline(LOG)
ERRORS = dataclasses.replace(LOG.parameters, calibrate=("scale", "heading"), errors=SensorErrors(scale=0.02))
ADF = run_filter("adf", TIMELINE, ERRORS)
RUN = Run(LOG, TIMELINE, Identification(ERRORS), ScoredTrack(ADF, None))


def test_each_error_has_a_panel_with_its_band_and_what_was_assumed() -> None:
    with in_style():
        figure = calibration_figure(RUN)

    scale, heading = figure.axes
    assert scale.get_title(loc="left").endswith(" % at the end (prior 0 ± 2 %)")
    assert heading.get_title(loc="left").endswith(" deg at the end (prior 0 ± 5 deg)")
    levels = {float(y) for line in scale.lines if line.get_linestyle() == "--" for y in line.get_ydata()}
    assert levels == {-4.0, 4.0}
    value = next(line for line in scale.lines if line.get_label() == "adf")
    ratio = ADF.state("dvl_scale")
    assert ratio is not None
    assert value.get_ydata() == pytest.approx(100 * ratio)
    bottom, top = scale.get_ylim()
    assert bottom < min(value.get_ydata()) <= max(value.get_ydata()) < top


def test_a_run_that_calibrates_nothing_has_no_such_picture(tmp_path: Path) -> None:
    whole = RUN.scored.trajectory
    plain = dataclasses.replace(whole, names=whole.names[:6], mean=whole.mean[:, :6], cov=whole.cov[:, :6, :6])

    bare = dataclasses.replace(RUN, scored=ScoredTrack(plain, None))
    with_errors, without = ([one.file for one in draw(tmp_path, run_pictures(run))] for run in (RUN, bare))

    assert set(with_errors) - set(without) == {"calibration.png"}
    assert (tmp_path / "calibration.png").is_file()


def test_the_tracks_table_has_the_errors_in_degrees_clockwise_with_their_sigmas() -> None:
    table = track_table(ADF, None)

    assert list(table)[-4:] == ["dvl_scale", "sd_dvl_scale", "heading_bias_deg", "sd_heading_bias_deg"]
    bias_rad = ADF.state("heading_bias")
    assert bias_rad is not None
    assert table.heading_bias_deg.to_numpy() == pytest.approx(-np.degrees(bias_rad))
    assert (table.sd_heading_bias_deg > 0).all()


def test_what_was_assumed_is_told_under_the_names_of_what_was_found() -> None:
    assumed = assumed_sd(SensorErrors(heading_rad=np.radians(4.0), latency_s=0.5))

    assert {error.name for error in estimated_errors(ADF)} <= set(assumed)
    assert assumed["heading_bias_deg"] == pytest.approx(4.0)
    assert assumed["usbl_latency_s"] == 0.5
