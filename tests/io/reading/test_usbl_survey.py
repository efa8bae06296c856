"""Surveys as files: what is read back, which keys replay takes over, and what is refused."""

import numpy as np
import pandas as pd
import pytest

from logs import refusal
from recordings import sentence
from usbldr.filters.errors import LogError
from usbldr.filters.simulation.simulate import simulate_survey
from usbldr.filters.usbl_survey.geometry import NAMES, placed
from usbldr.io.reading.opening import Request
from usbldr.io.reading.read import read_log
from usbldr.io.reading.usbl_survey import read_usbl_survey
from usbldr.io.scenarios.survey_scenarios import find_survey, write_survey

BOX = find_survey("survey-box")


@pytest.fixture
def folder(tmp_path):
    write_survey(BOX, 7, tmp_path / "survey")
    return tmp_path / "survey"


def configure(folder, usbl, head):
    text = (folder / "usbldr.toml").read_text()
    before = 'head = { topic = "gps", heading_topic = "compass" }'
    assert before in text
    (folder / "usbldr.toml").write_text(text.replace(before, f"head = {{ {head} }}\n{usbl}"))


def test_a_written_survey_is_read_back(folder):
    made, found = simulate_survey(BOX, 7), read_usbl_survey(folder, Request())
    assert found.level
    assert found.survey.range_m == pytest.approx(made.range_m)
    assert found.survey.direction[:, :2] == pytest.approx(made.direction[:, :2], abs=1e-9)
    times_s = found.survey.time_s
    shift_s = made.time_s[0]
    for ours, theirs in (
        (found.survey.ship.positions(times_s, 0.3), made.ship.positions(times_s + shift_s, 0.3)),
        (found.survey.ship.attitudes(times_s)[:, 1:], made.ship.attitudes(times_s + shift_s)[:, 1:]),
    ):
        assert ours == pytest.approx(theirs, abs=2e-3)


def test_fixes_along_three_axes_are_the_same_survey(folder):
    made = read_usbl_survey(folder, Request()).survey
    polar = pd.read_csv(folder / "usbl.csv")
    starboard, forward, up = (made.range_m[:, None] * made.direction).T
    table = pd.DataFrame({"time_ns": polar.time_ns, "fwd": forward, "port": -starboard, "above": up})
    table.to_csv(folder / "usbl.csv", index=False)
    columns = 'columns = { time_ns = "time_ns", x = "fwd", y = "port", z = "above" }\naxes = "FLU"'
    configure(folder, f'topic = "usbl"\n{columns}', 'topic = "gps", heading_topic = "compass"')
    found = read_usbl_survey(folder, Request()).survey
    assert found.range_m == pytest.approx(made.range_m)
    assert found.direction == pytest.approx(made.direction)


def test_telegrams_that_state_head_up_need_no_head(tmp_path):
    """A ship at rest with a transponder 40 m ahead, 30 m to starboard and ever deeper."""
    lines = [
        f"{1_767_225_600 + second} {sentence(telegram)}\n"
        for second in range(9)
        for telegram in (
            f"GPGGA,00000{second}.00,4500.0000,N,03000.0000,W,4,10,1.0,0.0,M,0.0,M,,",
            "HEHDT,90.0,T",
            f"PSIMSSB,00000{second}.00,M44,A,,C,H,M,30.0,40.0,{50 + second},0.1,N,,",
        )
    ]
    (tmp_path / "ship.nmea").write_text("".join(lines))
    found = read_usbl_survey(tmp_path / "ship.nmea", Request())
    assert found.survey.range_m == pytest.approx(np.hypot(50.0, 50.0 + np.arange(9)))
    assert found.survey.direction[0] == pytest.approx(np.array([30, 40, -50]) / np.sqrt(5000))
    assert list(found.stated) == [0, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0]
    assert (found.survey.arm_up_m, found.survey.antenna_up_m) == (0.0, 0.0)


def test_replay_places_fixes_by_the_same_keys_as_the_calibration(folder):
    true = dict(zip(NAMES, BOX.true_values, strict=True))
    names = {"mount_roll_deg": "mount_roll_deg", "mount_pitch_deg": "mount_pitch_deg"}
    names |= {"mount_deg": "mount_heading_deg", "sound_speed_scale": "scale"}
    mount = "".join(f"{key} = {true[name]}\n" for key, name in names.items())
    arm = f"lever_arm_m = [{true['arm_starboard_m']}, {true['arm_forward_m']}, -9.0]"
    late = f"heading_latency_s = {true['attitude_latency_s']}, latency_s = {true['position_latency_s']}"
    configure(folder, mount, f'topic = "gps", heading_topic = "compass", {arm}, {late}')
    stated = read_usbl_survey(folder, Request())
    assert stated.stated[:8] == pytest.approx(BOX.true_values[:8])
    fixes = read_log(folder, Request()).tables["usbl"]
    ours = placed(stated.survey, BOX.true_values)
    away = np.linalg.norm(fixes[["east_m", "north_m"]].to_numpy() - ours[:, :2], axis=1)
    # replay takes the antenna of another record, with its own noise of 0.02 m, and where the speed changes
    assert np.median(away) < 0.05
    assert np.quantile(away, 0.99) < 0.4


def test_the_stamps_of_replies_are_honoured(folder):
    configure(folder, 'stamped_at = "reply"\nturnaround_s = 0.5', 'topic = "gps", heading_topic = "compass"')
    survey = read_usbl_survey(folder, Request()).survey
    assert survey.two_way_s == pytest.approx(2 * survey.range_m / 1500.0 + 0.5, abs=1e-6)


@pytest.mark.parametrize(
    ("file", "sentence"),
    [("gps.csv", "ship's positions"), ("compass.csv", "ship's heading"), ("usbl.csv", "fixes of the USBL")],
)
def test_a_survey_without_a_part_is_named(folder, file, sentence):
    (folder / file).unlink()
    (folder / "usbldr.toml").write_text('schema = 1\n[usbl]\nframe = "body"\nhead = { topic = "gps" }\n')
    said = refusal(LogError, read_usbl_survey, folder, Request())
    assert sentence in said or file.split(".")[0] in said


def test_fixes_that_are_turned_to_north_are_refused(folder):
    table = pd.read_csv(folder / "usbl.csv")
    flat = pd.DataFrame({"time_ns": table.time_ns, "east_m": table.slant_range_m, "north_m": table.slant_range_m})
    flat.to_csv(folder / "usbl.csv", index=False)
    (folder / "usbldr.toml").write_text('schema = 1\n[usbl]\nhead = { topic = "gps", heading_topic = "compass" }\n')
    assert "along the head's own axes" in refusal(LogError, read_usbl_survey, folder, Request())
