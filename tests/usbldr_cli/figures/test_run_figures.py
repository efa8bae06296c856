import dataclasses
import os
import re
import struct
import subprocess
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from scored_runs import run_of, scored
from uncalibrated import dive_without_calibration
from usbldr.filters.evaluation.error_report import Window
from usbldr.filters.identification.identification import Identification
from usbldr.filters.models.calibration import assumed_sd, estimated_errors
from usbldr.filters.models.parameters import SensorErrors
from usbldr.filters.replay import dead_reckoning
from usbldr.filters.replay.methods import FilterSettings
from usbldr.filters.replay.run import run as run_filter
from usbldr.filters.types import Outage, Timeline, Trajectory
from usbldr.io.conventions.sanity import truth_jump_findings
from usbldr.io.log import Log
from usbldr.io.reading.epochs import timeline
from usbldr.io.reports.run import Run, ScoredTrack
from usbldr.io.reports.tracks import track_table
from usbldr.io.scenarios.shipped import find_scenario
from usbldr_cli.figures.consistency import consistency_figure
from usbldr_cli.figures.distance import distance_figure
from usbldr_cli.figures.drawing import draw as draw_all
from usbldr_cli.figures.health import MOST_BANDS, calibration_figure, innovation_figure, particle_figure, thinned
from usbldr_cli.figures.overlay import coincident_text
from usbldr_cli.figures.plane import sigma_ellipses
from usbldr_cli.figures.run_figures import cdf_figure, error_figure, run_pictures
from usbldr_cli.figures.style import broken_at_gaps, in_style, save
from usbldr_cli.figures.track import track_figure
from usbldr_cli.runs.job_store import Trace
from usbldr_cli.runs.seed_table import ComparisonRow

PAPER = find_scenario("paper")

LOG = dive_without_calibration(dataclasses.replace(PAPER, duration_s=120.0), seed=1)
TIMELINE = timeline(LOG)
CPF = run_filter("cpf", TIMELINE, LOG.parameters)
EKF = run_filter("ekf", TIMELINE, LOG.parameters, FilterSettings(gate=0.9))
USBL = dead_reckoning.usbl(TIMELINE)


def a_run(trajectory: Trajectory, align: str = "none", log: Log = LOG, grid: Timeline = TIMELINE) -> Run:
    return run_of(log, grid, trajectory, align=align)


RUN = a_run(CPF)


@cache
def a_curved_run(method: str, align: str = "none") -> Run:
    """Return a run on a track with a turn, which is drawn with east and north."""
    log = dive_without_calibration(dataclasses.replace(find_scenario("turns"), duration_s=150.0), seed=1)
    settings = FilterSettings(gate=0.9) if method == "ekf" else FilterSettings()
    return a_run(run_filter(method, timeline(log), log.parameters, settings), align, log, timeline(log))


def figure_of(draw: Callable[[Run], Any], run: Run) -> Any:
    with in_style():
        figure = draw(run)
    assert figure is not None
    return figure


def line_of(axes, label: str) -> Any:
    """Return the line whose label begins so."""
    return next(line for line in axes.get_lines() if str(line.get_label()).startswith(label))


def labels(figure) -> list[str]:
    return [text.get_text() for text in figure.legends[0].get_texts()]


JUDGED = ["track", "errors", "consistency", "error_cdf", "error_distance", "innovations", "fixes"]


@pytest.mark.long
def test_the_pictures_of_a_particle_filter_are_files(tmp_path: Path) -> None:
    files = [one.file for one in draw_all(tmp_path, run_pictures(RUN))]

    assert files == [f"{name}.png" for name in (*JUDGED, "ess")]
    assert sorted(files) == sorted(path.name for path in tmp_path.iterdir())
    for file in files:
        width, height = struct.unpack(">II", (tmp_path / file).read_bytes()[16:24])
        assert width > 1000
        assert height > 400


def applying(run: Run) -> list[str]:
    """Return the names of the pictures that apply to a run."""
    with in_style():
        return [picture.name for picture in run_pictures(run) if picture.describe() is not None]


def test_a_run_has_the_pictures_that_its_filter_and_its_log_have_numbers_for() -> None:
    blind = Run(dataclasses.replace(LOG, truth=None), TIMELINE, Identification(LOG.parameters), ScoredTrack(CPF, None))

    assert applying(a_run(EKF)) == JUDGED  # a single Gaussian has no particles
    assert applying(a_run(USBL)) == ["track", "errors", "error_cdf", "error_distance"]
    assert applying(blind) == ["track", "innovations", "fixes", "ess"]
    assert applying(CALIBRATED) == ["track", "innovations", "fixes", "calibration"]


@pytest.mark.parametrize(
    "draw", [track_figure, error_figure, consistency_figure, cdf_figure, innovation_figure, particle_figure]
)
def test_every_title_states_method_log_truth_order_and_alignment(draw) -> None:
    said = " ".join(text.get_text() for text in figure_of(draw, a_run(CPF, align="first")).texts)

    assert "cpf on paper" in said
    assert "truth: simulated (paper/gps)" in said
    assert "used at their time of validity" in said
    assert "first epoch moved onto the first truth row" in said


def test_a_track_is_drawn_with_a_metre_as_long_east_as_north_and_its_fixes_by_fate() -> None:
    run = a_curved_run("ekf")

    figure = figure_of(track_figure, run)

    assert [axes.get_aspect() for axes in figure.axes] == [1.0, 1.0]
    fates = [label.split(" (")[0] for label in labels(figure)]
    assert {"truth", "ekf", "dr", "USBL fix used", "USBL fix rejected", "start", "end"} <= set(fates)
    counted = sum(int(re.split(r"[(,)]", label)[1]) for label in labels(figure) if "fix" in label)
    assert counted == len(run.timeline.fix_time_s)


def test_both_panels_show_the_aligned_track_and_its_close_up_states_the_time() -> None:
    run = a_curved_run("cpf", align="first")
    aligned_m = run.scored.report.alignment.points(run.scored.trajectory.position_m)

    whole, close = figure_of(track_figure, run).axes

    np.testing.assert_allclose(np.column_stack(line_of(whole, "cpf").get_data()), aligned_m)
    assert set(zip(*line_of(close, "cpf").get_data(), strict=True)) < set(map(tuple, aligned_m))
    assert re.search(r"; \d+ to \d+ s$", close.get_title(loc="left"))


def test_the_truth_is_drawn_inside_the_scored_window_only() -> None:
    report = dataclasses.replace(scored(LOG, TIMELINE, CPF).report, window=Window(20.0, 50.0))  # pyright: ignore

    axes = figure_of(track_figure, dataclasses.replace(RUN, scored=ScoredTrack(CPF, report))).axes[0]

    assert len(line_of(axes, "truth").get_xdata()) == 31


def test_a_straight_track_is_turned_so_that_its_errors_show() -> None:
    whole = figure_of(track_figure, RUN).axes[0]

    drawn_m = np.column_stack(line_of(whole, "cpf").get_data())
    np.testing.assert_allclose(pairwise_m(drawn_m), pairwise_m(CPF.position_m), atol=1e-6)  # turned and moved, no more
    assert np.ptp(drawn_m[:, 1]) < 0.05 * np.ptp(drawn_m[:, 0])
    assert whole.get_aspect() == "auto"
    assert "turned: 040 deg points right" in whole.get_title(loc="left")  # the course of the scenario


def pairwise_m(points_m):
    some = points_m[::50]
    return np.hypot(*(some[:, None] - some[None]).T)


def test_every_raw_fix_is_drawn_at_the_edge_if_it_is_outside_and_counted() -> None:
    raw = RUN.reference_tracks[0].report

    figure = figure_of(error_figure, RUN)

    top = 0.97 * figure.axes[0].get_ylim()[1]
    fixes = line_of(figure.axes[0], "raw USBL fix")
    np.testing.assert_allclose(fixes.get_ydata(), np.clip(raw.error_m[:, 0], -top, top))
    outside = np.sum(np.any(np.abs(raw.error_m) > top, axis=1))
    assert outside > 0
    assert f"raw USBL fix ({outside} of {len(raw.error_m)} drawn at the edge)" in labels(figure)
    assert any(label.startswith("dr") for label in labels(figure))


def test_the_picture_of_consistency_has_the_errors_as_colours_and_the_nees_of_the_report() -> None:
    run = a_curved_run("ekf")
    report = run.scored.report
    assert report.cov_m2 is not None

    figure = figure_of(consistency_figure, run)

    left, right, bar = figure.axes
    track, ellipses = sorted(left.collections, key=lambda one: one.get_array() is None)
    np.testing.assert_allclose(track.get_array(), report.horizontal_m[1:])
    assert len(ellipses.get_segments()) == 25
    assert bar.get_ylabel() == "horizontal error [m]"
    dots = line_of(right, "NEES of an epoch")
    bottom, top = right.get_ylim()
    inside = (dots.get_ydata() > 1.01 * bottom) & (dots.get_ydata() < 0.99 * top)
    true = np.einsum("ni,nij,nj->n", report.error_m, np.linalg.inv(report.cov_m2), report.error_m)  # the truth is exact
    np.testing.assert_allclose(np.asarray(dots.get_ydata())[inside], true[inside], rtol=1e-6)
    assert f"mean {report.nees.mean:.2f}" in right.get_title(loc="left")
    assert "95 % bounds of the whole run" in right.get_title(loc="left")
    assert {"mean of 10 s", "95 % bounds of 10 s means if the covariance is right"} <= set(labels(figure))


def test_every_corner_of_an_ellipse_is_as_many_sigmas_from_its_centre() -> None:
    center_m = np.array([[3.0, -2.0], [100.0, 5.0]])
    cov_m2 = np.array([[[4.0, 1.5], [1.5, 1.0]], [[0.01, 0.0], [0.0, 9.0]]])

    for outline, middle, cov in zip(sigma_ellipses(center_m, cov_m2, 2.0), center_m, cov_m2, strict=True):
        away = outline - middle
        np.testing.assert_allclose(np.einsum("ni,ij,nj->n", away, np.linalg.inv(cov), away), 4.0)
        assert np.ptp(np.arctan2(*away.T)) > 5.0  # all the way round


def judged(run: Run, row: int, off_m: float) -> Run:
    """Return the run beside its truth with one row off, whose largest error this is."""
    truth = run.log.truth
    assert truth is not None
    moved_m = truth.position_m.copy()
    moved_m[row] += off_m
    log = dataclasses.replace(run.log, truth=dataclasses.replace(truth, position_m=moved_m))
    return dataclasses.replace(run, log=log, scored=scored(log, run.timeline, run.scored.trajectory))


@pytest.mark.parametrize(("form", "head"), [("svg", b"<?xml"), ("pdf", b"%PDF")])
def test_vector_graphics_have_the_same_bytes_each_time(tmp_path: Path, form: str, head: bytes) -> None:
    figures = []
    for name in ("one", "two"):
        with in_style():
            figure = error_figure(a_run(EKF))
            save(figure, tmp_path / f"{name}.{form}")
        figures.append((tmp_path / f"{name}.{form}").read_bytes())

    assert figures[0] == figures[1]
    assert figures[0].startswith(head)


def test_a_wrong_truth_row_neither_shrinks_a_track_nor_is_its_largest_error() -> None:
    run = judged(a_curved_run("ekf"), 1, 5000.0)  # m

    figure, beside = figure_of(track_figure, run), figure_of(consistency_figure, run)

    assert run.scored.report.horizontal_m.max() > 5000
    for axes in (*figure.axes, beside.axes[0]):
        assert np.ptp(axes.get_xlim()) < 300
    assert "1 larger, up to" in figure.axes[1].get_title(loc="left")
    assert "1 outside the axes" in next(text for text in labels(figure) if text.startswith("truth"))


def test_the_close_up_is_not_of_a_truth_that_is_found_to_jump() -> None:
    run = judged(a_curved_run("ekf"), 50, 40.0)
    truth, report = run.log.truth, run.scored.report
    assert report.time_s[np.argmax(report.horizontal_m)] == pytest.approx(truth.time_s[50])
    (finding,) = truth_jump_findings(truth)

    titles = []
    for findings in ((), (finding,)):
        log = dataclasses.replace(run.log, findings=findings)
        close = figure_of(track_figure, dataclasses.replace(run, log=log)).axes[1]
        titles.append(close.get_title(loc="left"))

    assert f"at {truth.time_s[50]:.0f} s" in titles[0]
    assert f"at {truth.time_s[50]:.0f} s" not in titles[1]
    assert "their truth jumps" in titles[1]


def test_the_axis_of_time_is_broken_where_a_long_time_has_no_truth() -> None:
    truth = LOG.truth
    assert truth is not None
    kept = (truth.time_s < 20) | (truth.time_s > 90)
    parts = {name: getattr(truth, name)[kept] for name in ("time_s", "position_m", "sd_m")}
    log = dataclasses.replace(LOG, truth=dataclasses.replace(truth, **parts))

    figure = figure_of(error_figure, dataclasses.replace(RUN, log=log, scored=scored(log, TIMELINE, CPF)))

    spans = [axes.get_xlim() for axes in figure.axes[:2]]
    assert spans[0] == pytest.approx((0, 19), abs=1.5)
    assert spans[1][0] == pytest.approx(91, abs=1.5)
    assert len(figure.axes) == 4


def test_box_plots_and_distance_are_those_of_the_errors() -> None:
    report = RUN.scored.report

    way, boxes = figure_of(distance_figure, RUN).axes

    straight_m = np.hypot(*(report.truth_m[-1] - report.truth_m[0]))  # the scenario has one course
    assert line_of(way, "cpf").get_xdata()[-1] == pytest.approx(straight_m, rel=0.01)
    heights = [line.get_ydata()[0] for line in boxes.get_lines() if len(line.get_xdata()) == 2]
    assert boxes.get_xticklabels()[0].get_text() == "cpf"
    for percent in (5, 50, 95):
        nearest = np.min(np.abs(np.array(heights) - np.percentile(report.horizontal_m, percent)))
        assert nearest < 0.02 * np.ptp(report.horizontal_m)


def test_a_thinned_band_covers_the_whole_one_and_keeps_its_gaps() -> None:
    t = np.arange(50_001.0)
    bands = np.random.default_rng(0).uniform(0.1, 1.0, (len(t), 2))
    bands[[7, 20_000, 20_001]] = np.nan

    few, thin = thinned(t, bands)

    assert len(few) < 1.01 * MOST_BANDS
    assert few[[0, -1]].tolist() == [t[0], t[-1]]
    assert few[np.isnan(thin[:, 0])].tolist() == [7, 20_000, 20_001]
    held = thin[np.searchsorted(few, t, side="right") - 1]  # of the piece in which each epoch lies
    assert np.all((held >= bands) | (np.isnan(held) & np.isnan(bands)))


def test_outliers_of_the_fixes_do_not_flatten_the_innovations_of_the_others() -> None:
    far = np.arange(0, len(TIMELINE.fix_m), 15)
    fix_m = TIMELINE.fix_m.copy()
    fix_m[far] += 300.0
    with_outliers = run_filter("adf", dataclasses.replace(TIMELINE, fix_m=fix_m), LOG.parameters)

    figure = figure_of(innovation_figure, a_run(with_outliers))

    axes = next(one for one in figure.subfigs[0].axes if one.get_ylabel() == "USBL east [m]")
    assert axes.get_ylim()[1] < 30
    edge = np.concatenate([line.get_ydata() for line in axes.get_lines() if line.get_label() != "used"])
    assert np.count_nonzero(np.isclose(edge, 0.97 * axes.get_ylim()[1])) >= len(far) - 1


def test_a_gross_error_is_marked_at_the_edge_instead_of_flattening_the_others() -> None:
    mean = CPF.mean.copy()
    mean[300, CPF.names.index("x")] += 500.0

    figure = figure_of(error_figure, a_run(dataclasses.replace(CPF, mean=mean)))

    top = figure.axes[0].get_ylim()[1]
    marks = [line for line in figure.axes[0].get_lines() if line.get_marker() == "^" and len(line.get_xdata())]
    assert top < 5
    assert [list(line.get_xdata()) for line in marks] == [[60.0]]
    assert 0 < marks[0].get_ydata()[0] < top


def test_outages_are_shaded_and_named_once() -> None:
    outages = (Outage("usbl", 10.0, 30.0), Outage("usbl", 50.0, 60.0), Outage("dvl", 80.0, 90.0))
    run = dataclasses.replace(RUN, timeline=dataclasses.replace(TIMELINE, outages=outages))

    figure = figure_of(error_figure, run)

    assert [label for label in labels(figure) if label.startswith("no ")] == ["no usbl", "no dvl"]
    spans = [(patch.get_x(), patch.get_x() + patch.get_width()) for patch in figure.axes[0].patches]
    assert spans == [(10.0, 30.0), (50.0, 60.0), (80.0, 90.0)]


def test_a_line_is_broken_where_epochs_were_left_out() -> None:
    t, values = broken_at_gaps(np.array([0.0, 1.0, 9.0, 10.0]), np.arange(8.0).reshape(4, 2), 3.0)

    assert np.isnan(t).tolist() == [False, False, True, False, False]
    assert np.isnan(values).all(axis=1).tolist() == [False, False, True, False, False]


TIME_S = np.arange(200.0)
TRUTH_M = np.column_stack([TIME_S, np.zeros(200)])
ERROR_M = np.column_stack([np.zeros(200), np.sin(TIME_S)])


def of(name: str, error_m: np.ndarray) -> tuple[ComparisonRow, Trace]:
    return ComparisonRow("dive", name, name, (0,), ()), Trace(TIME_S, TRUTH_M + error_m, TRUTH_M)


def test_tracks_closer_than_a_line_is_wide_are_said_to_coincide() -> None:
    apart_m = np.where(TIME_S[:, None] < 5, 1.0, 0.0)  # for 2 % of the time
    traces = [of("ekf", 0.9 * ERROR_M), of("adf", ERROR_M), of("cpf", 1.005 * ERROR_M + apart_m), of("dr", ERROR_M)]

    assert coincident_text(traces) == "; adf, cpf coincide (95 % of the time)"  # dr is no filter
    assert coincident_text(traces[:2]) == ""


DRAWING = """
import sys
from pathlib import Path
from usbldr_cli.figures.style import in_style, save, titled_figure
with in_style():
    figure = titled_figure("title", "detail", 4, 3)
    figure.subplots().plot([0, 1], [0, 1])
    save(figure, Path("figure.png"))
"""


def test_settings_of_matplotlib_in_the_folder_or_of_the_user_change_no_figure(tmp_path, monkeypatch):
    (tmp_path / "usual").mkdir()
    (tmp_path / "matplotlibrc").write_text("axes.facecolor: red\nlines.linewidth: 20\nno such line\n")
    user = tmp_path / "user"
    user.write_text("figure.facecolor: blue\nsavefig.dpi: 10\ntext.usetex: true\n")

    command = [sys.executable, "-P", "-c", DRAWING]
    done = subprocess.run(command, cwd=tmp_path, env={**os.environ, "MATPLOTLIBRC": str(user)}, capture_output=True)

    monkeypatch.chdir(tmp_path / "usual")
    exec(DRAWING)
    assert (done.returncode, done.stderr) == (0, b"")
    assert (tmp_path / "figure.png").read_bytes() == (tmp_path / "usual" / "figure.png").read_bytes()


ERRORS = dataclasses.replace(LOG.parameters, calibrate=("scale", "heading"), errors=SensorErrors(scale=0.02))
ADF = run_filter("adf", TIMELINE, ERRORS)
CALIBRATED = Run(LOG, TIMELINE, Identification(ERRORS), ScoredTrack(ADF, None))


def test_each_error_has_a_panel_with_its_band_and_what_was_assumed() -> None:
    scale, heading = figure_of(calibration_figure, CALIBRATED).axes

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
