"""A session in Python gives the numbers and the files of the command line, to the last bit."""

import dataclasses
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import usbldr
from checkout import SAMPLES
from commands import output_of, report_of
from logs import with_table
from recordings import saved
from usbldr.io.reports.locate import read_smoothed_run
from usbldr.io.reports.run import ScoredTrack
from usbldr.io.scenarios.shipped import find_scenario
from usbldr.io.scenarios.simulated_log import write_scenario


def numbers(metrics: Mapping[str, float | None]) -> dict[str, float]:
    """Return the metrics that apply."""
    return {name: value for name, value in metrics.items() if value is not None}


def reported(tmp_path: Path, log: Path, *options: str) -> dict[str, float]:
    folder = tmp_path / "run"
    output_of("replay", log, *options, "-o", folder)
    return numbers(report_of(folder)["metrics"])


@pytest.mark.parametrize(("name", "method"), [("paper.mcap", "cpf"), ("lawnmower.mcap", "adf")])
def test_six_lines_give_the_numbers_of_the_command(tmp_path: Path, name: str, method: str) -> None:
    log = usbldr.open_log(SAMPLES / name)
    timeline = usbldr.timeline(log)
    report = usbldr.evaluate(log, timeline, usbldr.replay(log, timeline, method))

    assert numbers(report.flat()) == reported(tmp_path, SAMPLES / name, "--filter", method)


@pytest.mark.long
def test_settings_stand_for_the_options_of_the_command(tmp_path: Path) -> None:
    settings = usbldr.RunSettings(
        calibrate=("scale",),
        noise={"usbl": usbldr.StudentT(4.0)},
        aid=((0.0, 60.0),),
        order="arrival",
        window=usbldr.Window(100.0, 500.0),
        align="first",
    )
    options = "--calibrate scale --noise usbl=student-t:4 --aid gps@0:60 --order arrival --start 100 --end 500"

    log = usbldr.open_log(SAMPLES / "paper.mcap")
    timeline = usbldr.timeline(log)
    report = usbldr.evaluate(log, timeline, usbldr.replay(log, timeline, "adf", settings), settings)

    printed = reported(tmp_path, SAMPLES / "paper.mcap", "--filter", "adf", *options.split(), "--align", "first")
    assert numbers(report.flat()) == printed


def test_dead_reckoning_starts_where_the_settings_say() -> None:
    log = usbldr.open_log(SAMPLES / "paper.mcap")
    timeline = usbldr.timeline(log)
    place = (log.origin.lat_deg, log.origin.lon_deg)

    track = usbldr.replay(log, timeline, "dr", usbldr.RunSettings(dr_from=place))

    assert track.position_m[0] == pytest.approx([0.0, 0.0], abs=1e-6)


def test_a_log_without_truth_can_be_replayed_but_not_scored() -> None:
    log = usbldr.open_log(SAMPLES / "lawnmower.mcap", usbldr.Request(truth="none"))
    timeline = usbldr.timeline(log)

    scored = usbldr.score(log, timeline, "dr")

    assert scored.report is None
    with pytest.raises(usbldr.LogError, match="no truth to measure errors against"):
        usbldr.evaluate(log, timeline, scored.trajectory)


@pytest.mark.parametrize(
    ("method", "settings", "sentence"),
    [
        ("adf", usbldr.RunSettings(noise={"sonar": usbldr.Gaussian()}),
         r"noise of sonar: no such sensor \(sensors: dvl, "),
        ("dr", usbldr.RunSettings(smooth=True), "--smooth needs a filter, and dr is not one"),
        ("dr", usbldr.RunSettings(dr_from="home"), "--dr-from home is neither LAT,LON in degrees nor one of start"),
        ("dr", usbldr.RunSettings(dr_from=(91.0, 0.0)), "is not a position"),
    ],
)  # fmt: skip
def test_settings_that_do_not_fit_are_refused_in_python_as_in_the_shell(method: str, settings, sentence: str) -> None:
    log = usbldr.open_log(SAMPLES / "lawnmower_turn_db3")

    with pytest.raises(usbldr.UsageError, match=sentence):
        usbldr.replay(log, usbldr.timeline(log), method, settings)


def test_a_scenario_without_configuration_is_as_a_recording_that_nobody_configured(tmp_path: Path) -> None:
    request = usbldr.Request(configuration="none")
    write_scenario(dataclasses.replace(find_scenario("turns"), duration_s=20.0), 0, tmp_path / "dive.mcap")
    recorded = usbldr.open_log(tmp_path / "dive.mcap", request)

    assert usbldr.open_log("turns", request).parameters == recorded.parameters
    assert usbldr.open_log("turns").parameters != recorded.parameters


def test_a_run_takes_the_dvls_records_earlier_by_the_clock_of_its_parameters() -> None:
    log = usbldr.open_log(SAMPLES / "lawnmower_turn_db3")
    known = dataclasses.replace(log.parameters, calibrate=())
    dvl = log.tables["dvl"].assign(time_s=log.tables["dvl"]["time_s"] + 2.0)
    late = with_table(log, "dvl", dvl)
    settled = dataclasses.replace(known, settled={"dvl_clock": 2.0})
    right, found, wrong = (
        usbldr.replay(one, usbldr.timeline(one), "adf", identification=usbldr.Identification(parameters)).position_m
        for one, parameters in ((log, known), (late, settled), (late, known))
    )

    middle = slice(50, len(right) - 50)
    assert np.abs(found[middle] - right[middle]).max() < 0.01
    assert np.abs(wrong[middle] - right[middle]).max() > 0.1


def test_a_simulated_log_is_checked_as_a_recorded_one_is(tmp_path: Path) -> None:
    text = 'schema = 1\nlike = "square"\nabout = "spikes"\n[dvl]\noutlier_share = 0.02\noutlier_mps = [3.0, 4.0]\n'

    log = usbldr.open_log(saved(tmp_path / "spikes.toml", text))

    assert "SPIKES" in [finding.code for finding in log.findings]
    assert log.tables["dvl"]["forward_mps"].abs().max() < 2.0


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
