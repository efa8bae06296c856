"""``usbldr calibrate-usbl``: its sentences, exit codes and files."""

import json

import pytest

from commands import output_of, run


@pytest.fixture(scope="module")
def survey(tmp_path_factory):
    folder = tmp_path_factory.mktemp("surveys") / "box"
    output_of("simulate", "survey-box", "-o", folder)
    return folder


def test_a_survey_is_calibrated_and_its_configuration_needs_no_more(survey, tmp_path):
    folder, file = tmp_path / "calibration", tmp_path / "found.toml"
    said = output_of("calibrate-usbl", survey, "-o", folder, "--write", file)
    assert "good: the fixes settle every error of the installation" in said
    report = json.loads((folder / "report.json").read_text())
    assert set(report["files"]) | {"report.json"} == {path.name for path in folder.iterdir()}
    assert {one["name"]: one["open"] for one in report["parameters"]}["scale"] is False
    again = run("calibrate-usbl", survey, "--config", file, "--json")
    assert again.return_value == 0
    found = json.loads(again.output)
    assert found["before"]["drms_m"] == pytest.approx(found["after"]["drms_m"], rel=0.02)


def test_a_circle_is_open_and_leaves_its_keys_as_stated(tmp_path):
    run("simulate", "survey-circle", "-o", tmp_path / "circle")
    done = run("calibrate-usbl", tmp_path / "circle", "--write", tmp_path / "found.toml")
    assert done.return_value == 1
    assert "heading of the head: open: cannot be separated from latency of position" in done.output
    written = (tmp_path / "found.toml").read_text()
    assert "heading of the head is left as stated" in written
    assert "mount_deg" not in written


def test_a_configuration_with_an_inline_table_is_completed(survey, tmp_path):
    usbl = '{ frame = "body", head = { topic = "gps", heading_topic = "compass" } }'
    (tmp_path / "inline.toml").write_text(
        f"schema = 1\nusbl = {usbl}\n[map]\norigin_lat_deg = 45.0\norigin_lon_deg = -30.0\n"
    )
    output_of("calibrate-usbl", survey, "--config", tmp_path / "inline.toml", "--write", tmp_path / "found.toml")
    assert "mount_deg" in (tmp_path / "found.toml").read_text()


def test_depths_count_from_the_surface_and_one_that_is_stated_wrong_is_said(survey, tmp_path):
    deep = (survey / "usbldr.toml").read_text().replace('"compass" }', '"compass", depth_m = 5.0 }')
    (tmp_path / "deep.toml").write_text(deep)
    stated = ("calibrate-usbl", survey, "--transponder-depth", 100)
    assert "by --transponder-depth" not in run(*stated).output
    done = run(*stated, "--config", tmp_path / "deep.toml", "--write", tmp_path / "found.toml")
    assert "the transponder lies 105.0 m deep, but 100.0 m by --transponder-depth" in done.output
    assert "A dive needs depth_m" not in (tmp_path / "found.toml").read_text()
    run(*stated, "--write", tmp_path / "shallow.toml")
    assert "A dive needs depth_m" in (tmp_path / "shallow.toml").read_text()


def test_a_plan_needs_a_survey():
    said = output_of("calibrate-usbl", "survey-spin", "--plan")
    assert "transponder depth" in said
    assert "usbldr simulate survey-spin" in str(run("calibrate-usbl", "survey-spin").exception)
    assert "is not a survey" in str(run("calibrate-usbl", "turns", "--plan").exception)


def test_nothing_of_the_user_is_replaced(survey, tmp_path):
    (tmp_path / "mine.toml").write_text("schema = 1\n")
    done = run("calibrate-usbl", survey, "--write", tmp_path / "mine.toml")
    assert "exists already" in str(done.exception)
    assert (tmp_path / "mine.toml").read_text() == "schema = 1\n"


def test_a_survey_is_a_folder(tmp_path):
    assert "folder of CSV files" in str(run("simulate", "survey-box", "-o", tmp_path / "box.mcap").exception)


def test_clocks_that_are_synchronised_can_be_stated():
    """A circle at one speed separates a late position from a heading only if it is known not to be late."""
    plans = [run("calibrate-usbl", "survey-circle", "--plan", *more).output for more in ((), ("--latency-sd", 0.02))]
    assert ["--latency-sd" in plan for plan in plans] == [True, False]
