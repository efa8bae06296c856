"""track.mcap: what a run found, as messages that players show, read back by mcap and by rosbags."""

import errno
import json
import math
import os
import re
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from mcap.reader import make_reader

from checkout import ROOT, SAMPLES
from commands import output_of, report_of
from logs import refusal
from recordings import decoded, saved
from usbldr.filters.errors import LogError, StorageError, UsageError
from usbldr.io.reading.read import read_log

LOG = SAMPLES / "paper.mcap"
CONFIG = SAMPLES / "paper.usbldr.toml"
METRICS = ("mean_horizontal_m", "rmse_east_m", "bias_north_m", "max_horizontal_m", "nees_mean", "inside_1_sigma")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("run") / "adf"
    options = ("--calibrate", "heading", "--plots", "none", "-q")
    output_of("replay", LOG, "-f", "adf", "--mcap", "merge", *options, "-o", out)
    return out


@pytest.fixture(scope="module")
def messages(folder: Path) -> dict[str, list[Any]]:
    """Return by topic the messages as rosbags decodes them by the definitions in the file."""
    found: dict[str, list[Any]] = {}
    for topic, log_ns, message in decoded(folder / "track.mcap"):
        if topic.startswith("/usbldr"):
            assert message.header.stamp.sec * 10**9 + message.header.stamp.nanosec == log_ns
            found.setdefault(topic, []).append(message)
    return found


def judged(log: Path, out: Path, *options: object) -> dict[str, float]:
    topics = ("-e", "/usbldr/estimate", "--truth", "/usbldr/truth")
    reported = output_of("evaluate", log, *topics, "--json", "-o", out, *options)
    return json.loads(reported)["metrics"]


def test_evaluating_the_file_with_or_without_the_log_gives_the_numbers_of_the_run(folder: Path, tmp_path: Path) -> None:
    options = ("--calibrate", "heading", "--plots", "none", "-q", "--mcap", "alone")
    output_of("replay", LOG, "-f", "adf", *options, "-o", tmp_path / "run")
    own = report_of(folder)["metrics"]

    merged = judged(folder / "track.mcap", tmp_path / "merged", "--config", CONFIG)
    alone = judged(tmp_path / "run" / "track.mcap", tmp_path / "alone")

    assert merged["matched"] == own["matched"]
    for name in METRICS:
        assert [merged[name], alone[name]] == pytest.approx([own[name]] * 2, rel=1e-6, abs=1e-6), name


def test_the_copy_holds_every_message_of_the_log_unchanged(folder: Path) -> None:
    def held(file: Path) -> Counter[tuple[str, str, int, int, bytes]]:
        with file.open("rb") as stream:
            return Counter(
                (c.topic, s.name if s else "", m.log_time, m.publish_time, m.data)
                for s, c, m in make_reader(stream).iter_messages()
                if not c.topic.startswith("/usbldr")
            )

    assert held(folder / "track.mcap") == held(LOG)


def test_estimate_and_places_are_those_of_the_table(folder: Path, messages: dict[str, list[Any]]) -> None:
    track = pd.read_csv(folder / "track_5hz.csv")
    odometry, places = messages["/usbldr/estimate"], messages["/usbldr/estimate/place"]

    assert len(odometry) == len(track)
    at = [m.pose.pose.position for m in odometry]
    np.testing.assert_allclose([[p.x, p.y] for p in at], track[["east_m", "north_m"]], atol=1e-4)
    cov = np.array([m.pose.covariance for m in odometry])
    np.testing.assert_allclose(np.sqrt(cov[:, [0, 7]]), track[["sd_east_m", "sd_north_m"]], atol=1e-4)
    yaw = np.array([2 * math.atan2(m.pose.pose.orientation.z, m.pose.pose.orientation.w) for m in odometry])
    heading = np.radians(90 - track["heading_deg"].to_numpy())  # REP 103
    np.testing.assert_allclose(np.cos(yaw - heading), 1, atol=1e-9)
    np.testing.assert_allclose([m.twist.twist.linear.x for m in odometry], track["forward_mps"], atol=1e-5)
    np.testing.assert_allclose([-m.twist.twist.linear.y for m in odometry], track["starboard_mps"], atol=1e-5)
    each_second = track[::5]
    np.testing.assert_allclose([m.latitude for m in places], each_second["lat_deg"], atol=1e-8)
    np.testing.assert_allclose([m.longitude for m in places], each_second["lon_deg"], atol=1e-8)


def test_each_fix_stands_in_the_topic_of_its_outcome(folder: Path, messages: dict[str, list[Any]]) -> None:
    fixes = pd.read_csv(folder / "fixes.csv")

    for outcome, mine in fixes.groupby("outcome"):
        found = messages[f"/usbldr/fixes/{str(outcome).replace('-', '_')}"]
        position = [[m.pose.pose.position.x, m.pose.pose.position.y] for m in found]
        np.testing.assert_allclose(position, mine[["east_m", "north_m"]], atol=1e-4)
    reported = [m.status[0] for m in messages["/usbldr/fixes/outcome"]]
    assert [one.message.split(":")[0] for one in reported] == fixes["outcome"].tolist()
    nis = [float(next(v.value for v in one.values if v.key == "nis")) for one in reported]
    np.testing.assert_allclose(nis, fixes["nis"], rtol=1e-4)


def test_errors_and_sensor_errors_are_those_of_the_report(folder: Path, messages: dict[str, list[Any]]) -> None:
    own = report_of(folder)

    size = [m.vector.z for m in messages["/usbldr/error"]]
    assert np.mean(size) == pytest.approx(own["metrics"]["mean_horizontal_m"])
    last = messages["/usbldr/sensor_errors"][-1].status[0]
    numbers = {value.key: value.value for value in last.values}
    found = next(iter(own["calibration"].values()))
    assert float(numbers["value"]) == pytest.approx(found["value"], rel=1e-4)
    assert float(numbers["sd"]) == pytest.approx(found["sd"], rel=1e-4)


def test_topics_of_an_earlier_run_are_no_sensors(folder: Path) -> None:
    read = read_log(folder / "track.mcap")

    topics = {"/dvl/data", "/imu/data", "/usbl/fix", "/gps/fix"}
    assert {one.topic for role, one in read.provenance.items() if role != "truth"} == topics


@pytest.mark.parametrize(
    ("log", "fault", "said"), [("lawnmower.bag", UsageError, "usbldr export"), ("cut", LogError, "leave merge out")]
)
def test_only_a_whole_mcap_file_is_merged(tmp_path, log, fault, said):
    file = saved(tmp_path / "cut.mcap", LOG.read_bytes()[:150_000]) if log == "cut" else SAMPLES / log

    asked = ("replay", file, "-f", "dr", "--mcap", "merge", "-o", tmp_path / "run")
    assert said in refusal(fault, output_of, *asked)
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("at_fault", "raised", "said"),
    [
        ("mcap.reader.NonSeekingReader.iter_messages", LogError, "the log cannot be copied (Input/output error)"),
        ("mcap.writer.Writer.add_message", StorageError, "cannot be written (Input/output error)"),
    ],
)
def test_a_fault_of_the_disk_is_that_of_the_log_or_that_of_the_copy(tmp_path, monkeypatch, at_fault, raised, said):
    def fail(*_: object, **__: object) -> None:
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    monkeypatch.setattr(at_fault, fail)
    asked = ("replay", LOG, "-f", "usbl", "--plots", "none", "--mcap", "merge", "-o", tmp_path / "run")

    assert said in refusal(raised, output_of, *asked)


def test_the_layout_for_foxglove_shows_topics_of_the_file(messages: dict[str, list[Any]]) -> None:
    layout = (ROOT / "docs" / "players" / "foxglove.json").read_text(encoding="utf-8")

    shown = set(re.findall(r"/usbldr/[a-z_/]+", layout))
    fates = {"/usbldr/fixes/rejected/place", "/usbldr/fixes/rejected"}  # this dive has none
    assert {"/usbldr/estimate", "/usbldr/truth/place", "/usbldr/error"} <= shown
    assert shown - fates <= set(messages)
    found = json.loads(layout)
    assert set(re.findall(r"\w+![a-z]+", json.dumps(found["layout"]))) == set(found["configById"])
