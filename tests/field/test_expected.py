"""What the collectors of the field logs measured (expected.json), met by what usbldr reads.

Tolerances are the collectors'; where they state none, a number agrees to the last digit that they wrote. No error of a
log that is held back is measured here.
"""

import json
import math
from collections.abc import Mapping
from decimal import Decimal
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from checkout import FIELD_CONFIGURATIONS
from field.logs import FOLDERS
from usbldr.filters.evaluation.alignment import fit_rigid
from usbldr.filters.replay.dead_reckoning import displacement_m, dr
from usbldr.io.decoding.collected import read_whole
from usbldr.io.log import Log
from usbldr.io.reading.epochs import timeline
from usbldr.io.reading.read import Request, read_log
from usbldr.io.recordings.mcap_log import McapLog

UIB_TRUTHS = {"uib_field": '"/slam/graph_vertices"\nskip_rows = 2', "uib_simulation": '"/ground_truth"'}
UIB = '[dvl]\naxes = "FLU"\n[compass]\nconvention = "NED"\n[truth]\nframe = "NED"\ntopic = {}\n'
NO_GPS, NO_USBL = '[gps]\ntopic = "none"\n', '[usbl]\ntopic = "none"\n'
STPERE = NO_USBL + '[compass]\ntopic = "{}"\n'


def expected(folder: Path, name: str) -> Mapping[str, Any]:
    document = json.loads((folder / FOLDERS[name] / "expected.json").read_text(encoding="utf-8"))
    return document["logs"][name] if "logs" in document else document


def read(folder: Path, tmp_path: Path, name: str, toml: str) -> Log:
    (tmp_path / "usbldr.toml").write_text(toml, encoding="utf-8")
    return read_log(folder / FOLDERS[name] / f"{name}.mcap", Request(str(tmp_path / "usbldr.toml")))


def check(ours: Mapping[str, Any], theirs: Mapping[str, Any], **tolerance: float) -> None:
    """Hold every number of ours against theirs."""
    for key, value in ours.items():
        within = tolerance.get(key) or 10.0 ** int(Decimal(str(theirs[key])).as_tuple().exponent)
        assert value == pytest.approx(theirs[key], abs=0 if isinstance(theirs[key], int) else within), key


def path_m(east_north_m: np.ndarray) -> float:
    return float(np.sum(np.hypot(*np.diff(east_north_m, axis=0).T)))


def at(wanted_s: np.ndarray, time_s: np.ndarray, position_m: np.ndarray) -> np.ndarray:
    """Return a track at some times, (n, 2)."""
    return np.column_stack([np.interp(wanted_s, time_s, column) for column in position_m.T])


def minus_truth(log: Log, sensor: str) -> tuple[np.ndarray, np.ndarray]:
    """Return times of fixes and their offsets from the truth, east before north."""
    table, time_s = log.tables[sensor], log.tables[sensor]["time_s"].to_numpy()
    return time_s, table[["east_m", "north_m"]].to_numpy() - at(time_s, log.truth.time_s, log.truth.position_m)


@pytest.mark.parametrize("name", FOLDERS)
def test_every_topic_holds_the_messages_and_stamps_that_they_counted(field_logs: Path, name: str) -> None:
    log, counted = McapLog(field_logs / FOLDERS[name] / f"{name}.mcap"), expected(field_logs, name)["topics"]

    assert {topic.name for topic in log.topics()} == set(counted)
    for topic in log.topics():
        theirs = counted[topic.name]
        fields = ["header.stamp", "header.frame_id"] if "header.stamp" in topic.fields else topic.fields[:1]
        records = read_whole(log, {topic.name: fields})[topic.name]
        received_ns, columns = records.received_ns, records.columns
        assert topic.type == theirs["type"]
        assert (received_ns[0], received_ns[-1]) == (theirs["log_first_ns"], theirs["log_last_ns"])
        gap_s = float(np.max(np.diff(received_ns))) / 1e9
        check({"count": len(received_ns), "longest_gap_s": gap_s}, theirs)
        check({"count": topic.count, "span_s": topic.span_s, "rate_hz": topic.rate_hz}, theirs)
        if "header.stamp" in topic.fields:
            stamps, lag_s = columns["header.stamp"], pd.Series((received_ns - columns["header.stamp"]) / 1e9)
            assert columns["header.frame_id"][0] == theirs["frame_id"]
            check({"repeated_stamps": len(stamps) - len(np.unique(stamps))}, theirs)
            lags_s = {"min": lag_s.min(), "median": lag_s.median(), "max": lag_s.max()}
            check(lags_s, theirs["log_minus_stamp_s"])


@pytest.mark.parametrize("name", UIB_TRUTHS)
@pytest.mark.parametrize("topic", ["modem_delayed_acoustic", "modem_raw"])
def test_fixes_of_turbot_are_as_far_off_as_they_say(field_logs: Path, tmp_path: Path, name: str, topic: str) -> None:
    usbl = f'[usbl]\ntopic = "/{topic}"\nframe = "NED"\n'
    theirs = expected(field_logs, name)["reference"][f"usbl_error_{topic}"]

    log = read(field_logs, tmp_path, name, UIB.format(UIB_TRUTHS[name]) + NO_GPS + usbl)

    time_s, offsets_m = minus_truth(log, "usbl")

    off_m = np.hypot(*offsets_m[(time_s >= log.truth.time_s[0]) & (time_s <= log.truth.time_s[-1])].T)
    check({"n": len(off_m), "more_than_5_m": np.sum(off_m > 5.0)}, theirs)
    ours = {"median_m": np.median(off_m), "mean_m": np.mean(off_m), "max_m": np.max(off_m)}
    check(ours | {"rms_m": math.sqrt(np.mean(off_m**2))}, theirs, **theirs["tolerance"])


@pytest.mark.parametrize("name", UIB_TRUTHS)
def test_velocities_and_truth_of_turbot_are_read_as_they_read_them(field_logs: Path, tmp_path: Path, name: str) -> None:
    theirs = expected(field_logs, name)["reference"]
    log = read(field_logs, tmp_path, name, UIB.format(UIB_TRUTHS[name]) + NO_GPS + NO_USBL)
    first_ns = min(topic.first_ns or 0 for topic in McapLog(log.path).topics() if topic.count)
    begins_s = (log.start_ns - first_ns) / 1e9

    moved_m = path_m(displacement_m(timeline(log)))

    ours = {"unique_stamps": len(log.tables["dvl"]), "path_m": moved_m}
    check(ours, theirs["dvl"], path_m=theirs["dvl"]["path_tolerance_m"])
    check({"first_s": log.truth.time_s[0] + begins_s, "last_s": log.truth.time_s[-1] + begins_s}, theirs["truth"])
    assert path_m(log.truth.position_m) == pytest.approx(theirs["truth"]["path_m"], rel=2e-3)


def test_gps_of_turbot_lies_as_far_from_the_map_before_and_after_the_dive(field_logs: Path, tmp_path: Path) -> None:
    theirs = expected(field_logs, "uib_field")["reference"]
    lat, lon = theirs["map_origin"]["lat_deg"], theirs["map_origin"]["lon_deg"]
    toml = f'[map]\norigin_lat_deg = {lat}\norigin_lon_deg = {lon}\n[gps]\ntopic = "/gps_raw"\n{NO_USBL}'
    log = read(field_logs, tmp_path, "uib_field", UIB.format(UIB_TRUTHS["uib_field"]) + toml)

    time_s, off_m = minus_truth(log, "gps")

    for when, rows in (("start", time_s < time_s[-1] / 2), ("end", time_s > time_s[-1] / 2)):
        stated = theirs[f"gps_minus_truth_{when}"]
        assert rows.sum() == stated["n"]
        median_m = [stated["median_east_m"], stated["median_north_m"]]
        np.testing.assert_allclose(np.median(off_m[rows], axis=0), median_m, rtol=0, atol=stated["tolerance_m"])


@pytest.mark.parametrize(
    ("name", "toml", "reference", "angle"),
    [
        *(
            (name, UIB.format(topic) + NO_GPS + NO_USBL, "fitted", "mount_yaw_deg")
            for name, topic in UIB_TRUTHS.items()
        ),
        ("stpere_marina", STPERE.format("/imu/data"), "mti_fitted", "heading_offset_deg"),
        ("stpere_marina", STPERE.format("/dvl/compass_heading"), "dvl_compass_fitted", "heading_offset_deg"),
    ],
)
def test_dead_reckoning_turned_onto_the_truth_is_theirs(field_logs, tmp_path, name, toml, reference, angle):
    theirs = expected(field_logs, name)["reference"][f"dead_reckoning_{reference}"]
    log = read(field_logs, tmp_path, name, toml)
    line = timeline(log)
    inside = (log.truth.time_s >= line.time_s[0]) & (log.truth.time_s <= line.time_s[-1])
    there_m = log.truth.position_m[inside]
    reckoned_m = at(log.truth.time_s[inside], line.time_s, displacement_m(line))

    fit = fit_rigid(reckoned_m, there_m)

    rms_m = math.sqrt(np.mean(np.sum((fit.points(reckoned_m) - there_m) ** 2, axis=1)))
    check({"rms_m": rms_m, angle: -math.degrees(fit.rotation_rad)}, theirs, **theirs["tolerance"])


@pytest.mark.parametrize("name", UIB_TRUTHS)
def test_dead_reckoning_from_the_first_row_of_the_truth_is_theirs(field_logs: Path, tmp_path: Path, name: str) -> None:
    theirs = expected(field_logs, name)["reference"]["dead_reckoning_anchored"]
    mounted = UIB.format(UIB_TRUTHS[name]).replace("[dvl]", f"[dvl]\nmount_deg = {theirs['mount_yaw_deg']}")
    log = read(field_logs, tmp_path, name, mounted + NO_GPS + NO_USBL)
    time_s, truth_m = log.truth.time_s, log.truth.position_m

    track = dr(timeline(log), truth_m[0], float(time_s[0]))

    off_m = np.hypot(*(at(time_s, track.time_s, track.position_m) - truth_m).T)
    ours = {"rms_m": math.sqrt(np.mean(off_m**2)), "max_m": off_m.max(), "end_m": off_m[-1]}
    check(ours, theirs, **theirs["tolerance"])


def test_the_marina_is_read_as_they_read_it(field_logs: Path, tmp_path: Path) -> None:
    theirs = expected(field_logs, "stpere_marina")["reference"]
    log = read(field_logs, tmp_path, "stpere_marina", STPERE.format("/imu/data"))
    dvl, gps, depth_m = log.tables["dvl"], log.tables["gps"], log.tables["depth"]["depth_m"]

    check({"origin_lat_deg": log.origin.lat_deg, "origin_lon_deg": log.origin.lon_deg}, theirs)
    check({"good": dvl["valid"].sum(), "all": len(dvl)}, theirs["dvl_bottom_lock"])
    check({"east": np.ptp(gps["east_m"]), "north": np.ptp(gps["north_m"])}, theirs["gps_box_m"])
    check({"min": depth_m.min(), "max": depth_m.max()}, theirs["depth_m"])


@pytest.mark.parametrize("name", ["mhkit_riverpro", "tanana_002", "tanana_003"])
def test_transects_of_rivers_are_read_as_they_read_them(field_logs: Path, tmp_path: Path, name: str) -> None:
    theirs = expected(field_logs, name)["reference"]
    log = read(field_logs, tmp_path, name, NO_USBL)
    dvl, gps_m = log.tables["dvl"], log.tables["gps"][["east_m", "north_m"]].to_numpy()

    check({"origin_lat_deg": log.origin.lat_deg, "origin_lon_deg": log.origin.lon_deg}, theirs)
    check({"ensembles": len(dvl), "bottom_lock_pct": 100 * dvl["valid"].mean()}, theirs)
    check({"longest_loss_s": dvl["time_s"][dvl["valid"]].diff().max(), "gps_path_m_5hz": path_m(gps_m)}, theirs)


CONFIGURATION = FIELD_CONFIGURATIONS / "uib_field.toml"


@cache
def uib(logs: Path, name: str) -> Log:
    return read_log(logs / "uib_field" / name, Request(str(CONFIGURATION)))


@pytest.mark.parametrize("name", ["uib_field.bag", "uib_field_db3", "csv"])
def test_every_format_of_uib_field_gives_the_same_log(field_logs: Path, name: str) -> None:
    reference, log = uib(field_logs, "uib_field.mcap"), uib(field_logs, name)

    assert log.start_ns == reference.start_ns
    assert list(log.tables) == list(reference.tables) == ["dvl", "compass", "usbl"]
    for sensor, table in log.tables.items():
        pd.testing.assert_frame_equal(table, reference.tables[sensor], check_exact=True)
        assert log.provenance[sensor].conventions == reference.provenance[sensor].conventions
    np.testing.assert_array_equal(log.truth.position_m, reference.truth.position_m)
    np.testing.assert_array_equal(log.truth.time_s, reference.truth.time_s)
    assert [finding.text for finding in log.findings] == [finding.text for finding in reference.findings]
