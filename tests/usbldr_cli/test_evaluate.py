"""usbldr evaluate: our own track has our own numbers; what a vehicle computed is judged like a filter.

The first log of a new user: a map of unknown origin is no error of a filter; without a DVL the fixes are judged.
"""

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from commands import findings, output_of, report_of, run
from curved import M_PER_DEG, changed, curved_dive, written
from logs import MAP, read_as, refusal
from recordings import (
    FIX,
    ODOMETRY,
    POSE_COVARIANCE,
    SECOND,
    T0,
    Row,
    fix,
    saved,
    turned,
    write_bag,
    write_mcap,
    write_rosbag2,
)
from usbldr.filters.errors import LogError, UsageError

NED = "odom_ned"


@pytest.fixture(scope="module")
def own(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The paper's dive, and the run directory of a filter beside it."""
    folder = tmp_path_factory.mktemp("own")
    output_of("simulate", "paper", "-o", folder / "paper.mcap")
    output_of("replay", folder / "paper.mcap", "-f", "adf", "--fnv", "-q", "-o", folder / "adf")
    return folder


def judged(log: Path, name: object, *options: object) -> dict[str, Any]:
    return json.loads(output_of("evaluate", log, "--estimate", name, "--json", "-o", log.parent / "out", *options))


def test_our_own_track_has_our_own_numbers(own: Path) -> None:
    found, filtered = judged(own / "paper.mcap", own / "adf" / "track_5hz.csv"), report_of(own / "adf")
    of_fnv = judged(own / "paper.mcap", own / "adf" / "track.fnv", "--force")["metrics"]

    for name in ("mean_horizontal_m", "rmse_east_m", "bias_north_m", "max_horizontal_m", "matched", "shift_m"):
        assert found["metrics"][name] == pytest.approx(filtered["metrics"][name], abs=1e-4), name  # as written: 0.1 mm
        assert of_fnv[name] == pytest.approx(filtered["metrics"][name], abs=1e-3), name
    for name in ("nees_mean", "nees_low", "inside_1_sigma"):
        assert found["metrics"][name] == pytest.approx(filtered["metrics"][name], rel=5e-3), name
    assert found["relative_errors"] == [
        {key: pytest.approx(value, abs=2e-3) for key, value in one.items()} for one in filtered["relative_errors"]
    ]


def test_our_own_tum_file_is_read_and_stands_in_the_table_of_compare(own: Path) -> None:
    output_of("evaluate", own / "paper.mcap", "-e", own / "adf" / "track.tum", "-q", "-o", own / "tum")

    table = output_of("compare", own / "adf", own / "tum", "--json")

    rows = {row["filter"]: row["mean_horizontal_m"] for row in json.loads(table)["rows"]}
    assert rows["track.tum"] == pytest.approx(rows["adf"], abs=1e-5)
    assert {path.name for path in (own / "tum").iterdir()} >= {"track_estimate.csv", "report.md", "report.json"}


def test_a_track_whose_east_and_north_are_exchanged_is_read_by_the_truth(own: Path) -> None:
    east_first = [line.split() for line in (own / "adf" / "track.tum").read_text(encoding="utf-8").splitlines()]
    rows = [f"{time},{north},{east}" for time, east, north, *_ in east_first if not time.startswith("#")]
    (own / "ned.csv").write_text("\n".join(["timestamp,x,y", *rows, ""]), encoding="utf-8")

    done = run("evaluate", own / "paper.mcap", "-e", own / "ned.csv", "-q", "--plots", "none", "-o", own / "ned")
    wrong = judged(own / "paper.mcap", own / "ned.csv", "--frame", "ENU", "--plots", "none", "--force")

    assert "read as NED" in done.stderr
    assert "[ESTIMATE-FRAME]" in done.stderr
    metrics, filtered = report_of(own / "ned")["metrics"], report_of(own / "adf")["metrics"]
    assert metrics["mean_horizontal_m"] == pytest.approx(filtered["mean_horizontal_m"], abs=1e-4)
    assert wrong["metrics"]["mean_horizontal_m"] > 100


def test_a_row_of_a_track_that_is_no_position_is_left_out_and_reported(own: Path) -> None:
    header, first, *rows = (own / "adf" / "track_5hz.csv").read_text(encoding="utf-8").splitlines()
    (own / "bad.csv").write_text("\n".join([header, "later" + first, *rows, ""]), encoding="utf-8")

    done = run("evaluate", own / "paper.mcap", "-e", own / "bad.csv", "-q", "--plots", "none", "-o", own / "bad")

    assert 'line 2: time_s is "later' in done.stderr
    assert "[UNDECODED]" in done.stderr
    assert done.return_value == 3
    left = report_of(own / "bad")["metrics"]["mean_horizontal_m"]
    assert left == pytest.approx(report_of(own / "adf")["metrics"]["mean_horizontal_m"], abs=1e-3)


@pytest.mark.parametrize("name", ["track_5hz.csv", "track.tum"])
@settings(max_examples=4)
@given(data=st.data())
def test_a_track_whose_clock_goes_back_is_refused(own: Path, name: str, data: st.DataObject) -> None:
    """Sorted, two stretches of one time would be mixed."""
    header, *rows = (own / "adf" / name).read_text(encoding="utf-8").splitlines(keepends=True)
    place = data.draw(st.integers(20, len(rows)))
    first = data.draw(st.integers(0, place - 20))
    other = saved(own / f"back-{name}", header, *rows[:place], *rows[first:])

    said = refusal(UsageError, output_of, "evaluate", own / "paper.mcap", "-e", other, "-o", own / "back")

    assert re.search(
        r"the clock goes back by \d+\.\d+ s after .*, at record \d+; write the records from there on", said
    )


@pytest.mark.parametrize(
    "begin", ["# made by a driver\n", "#\n\n# frame: map\n", "0.7 0 0 0 1\n", ".25 2 0.5 0 0 0 1\n"]
)
def test_a_tum_file_may_begin_with_any_comment_or_within_a_row(own: Path, begin: str) -> None:
    other = saved(own / "begun.tum", begin, (own / "adf" / "track.tum").read_text(encoding="utf-8"))

    done = run("evaluate", own / "paper.mcap", "-e", other, "-q", "--plots", "none", "--force", "-o", own / "begun")

    assert done.exception is None
    assert (done.return_value == 3) == ("#" not in begin) == ("UNDECODED" in done.stderr)
    left = report_of(own / "begun")["metrics"]["mean_horizontal_m"]
    assert left == pytest.approx(report_of(own / "adf")["metrics"]["mean_horizontal_m"], abs=1e-3)


@pytest.mark.parametrize(
    ("content", "why"), [(b"", "the file is empty"), (bytes(range(256)) * 9, "neither text nor a recording")]
)
def test_a_file_that_holds_no_track_is_named(own: Path, content: bytes, why: str) -> None:
    other = saved(own / "other.csv", content)

    assert why in refusal(LogError, output_of, "evaluate", own / "paper.mcap", "-e", other, "-o", own / "other")


def onboard(kind: str, frame: str, sd_m: float = 0.5) -> list[Row]:
    """Two minutes east at 1 m/s by GPS, and an estimate with white errors of 0.5 m, a sigma and a heading of east."""
    rng, rows = np.random.default_rng(2), list[Row]()
    for k in range(120):
        ns, e, n = T0 + k * SECOND, *(np.array([k, 0.0]) + rng.normal(0, 0.5, 2))
        rows.append(fix(ns, 45.0, 7.0 + k / (M_PER_DEG * 0.70910)))
        covariance = np.zeros(36)
        covariance[[0, 7]] = sd_m**2
        x, y = (n, e) if frame == NED else (e, n)
        values = {"pose.pose.position.x": x, "pose.pose.position.y": y, "pose.covariance": covariance}
        values |= turned("pose.pose.orientation", 90.0 if frame == NED else 0.1 * (k % 2))
        rows.append((ns, "/nav", kind, {"header.stamp": ns, "header.frame_id": frame} | values))
    return rows


@pytest.mark.parametrize("kind", [ODOMETRY, POSE_COVARIANCE])
@pytest.mark.parametrize("frame", ["odom", NED])
def test_a_topic_of_a_log_without_dvl_is_judged_with_its_covariance(tmp_path: Path, kind: str, frame: str) -> None:
    log = written(tmp_path, onboard(kind, frame), MAP)

    found = judged(log, "/nav")

    assert found["method"] == "/nav"
    assert found["metrics"]["rmse_east_m"] == pytest.approx(0.5, abs=0.1)
    assert found["metrics"]["rmse_north_m"] == pytest.approx(0.5, abs=0.1)
    assert found["consistency"] == "consistent"


def test_a_covariance_too_small_is_told_and_so_is_an_unknown_place(tmp_path: Path) -> None:
    log = write_mcap(tmp_path / "dive.mcap", onboard(ODOMETRY, "odom", 0.1))

    found = judged(log, "/nav")

    assert found["alignment"]["name"] == "shift"
    assert found["consistency"].startswith("sigmas too small by a factor of")
    assert any("its covariance is too small" in text for text in found["warnings"])


def test_latitudes_of_a_solution_need_no_map(tmp_path: Path) -> None:
    rows = [fix(T0 + k * SECOND, 45.0, 7.0 + k * 1e-5) for k in range(60)]
    rows += [fix(T0 + k * SECOND, 45.0 + 3.0 / M_PER_DEG, 7.0 + k * 1e-5, topic="/ekf/position") for k in range(60)]

    found = judged(write_mcap(tmp_path / "dive.mcap", rows), "/ekf/position", "--gps", "/gps/fix")

    assert found["alignment"]["name"] == "none"
    assert found["metrics"]["bias_north_m"] == pytest.approx(3.0, abs=0.01)
    assert FIX in found["sensors"]["gps"]["type"]


def test_what_cannot_be_judged_is_one_sentence(own: Path) -> None:
    faults = {
        "/gps/fix": (UsageError, "is the truth itself"),
        "/nowhere": (LogError, "neither a file, here or beside the log, nor a topic"),
        "/dvl/data": (UsageError, "cannot be used as truth"),
    }
    for name, (kind, text) in faults.items():
        assert text in refusal(kind, output_of, "evaluate", own / "paper.mcap", "-e", name, "-o", own / "fault"), name
    assert not (own / "fault").exists()


@pytest.mark.parametrize("write", [write_mcap, write_bag, write_rosbag2])
def test_a_track_or_a_truth_in_a_recording_of_its_own_is_its_only_topic_of_positions(tmp_path, write) -> None:
    rows = onboard(ODOMETRY, "odom")
    log = written(tmp_path, rows, MAP)
    ending = {write_mcap: ".mcap", write_bag: ".bag", write_rosbag2: ""}[write]
    nav, gps = tmp_path / f"nav{ending}", tmp_path / f"gps{ending}"
    for file, topic in ((nav, "/nav"), (gps, "/gps/fix")):
        write(file, [row for row in rows if row[1] == topic])

    alone, inside = judged(log, nav), judged(log, "/nav", "--force")
    by_file = judged(log, "/nav", "--truth", gps, "--gps", "none", "--force")

    for one in (alone, by_file):
        assert one["metrics"]["rmse_east_m"] == pytest.approx(inside["metrics"]["rmse_east_m"], abs=1e-6)
    assert by_file["truth"]["source"] == gps.name
    assert "truth" in [file["role"] for file in by_file["provenance"]["inputs"]]
    with pytest.raises(UsageError, match=r"has several topics of positions \(/gps/fix, /nav\)|\(/nav, /gps/fix\)"):
        judged(log, write_mcap(tmp_path / "both.mcap", rows), "--force")
    with pytest.raises(UsageError, match=r"truth both.mcap has several topics of positions"):
        judged(log, "/nav", "--truth", tmp_path / "both.mcap", "--force")
    said = f"/nav is a track: usbldr evaluate LOG --estimate {nav.name} judges it"
    assert said in str(run("replay", nav).exception)
    assert said in run("info", nav).stdout
    assert said in str(run("init", nav, "-o", tmp_path / "draft.toml").exception)


def shifted(rows: list[Row], east_m: float, north_m: float) -> list[Row]:
    """Return the rows with the fixes counted from another point of the map."""
    x, y = (lambda values: values["point.x"] - east_m), (lambda values: values["point.y"] - north_m)
    return changed(rows, "/usbl", point__x=x, point__y=y)


def replayed(folder: Path, name: str, rows: list[Row], toml: str = "", *options: str) -> dict[str, Any]:
    log = write_mcap(folder / f"{name}.mcap", rows)
    (folder / f"{name}.usbldr.toml").write_text(toml, encoding="utf-8")
    run("replay", log, "--filter", "adf", "--output", folder / name, *options)
    return report_of(folder / name)


def test_an_unknown_origin_moves_no_number_of_the_report(tmp_path: Path) -> None:
    rows = curved_dive(gps=True)
    here = replayed(tmp_path, "here", rows)
    far = replayed(tmp_path, "far", shifted(rows, 192.0, -5000.0))

    assert far["alignment"]["name"] == here["alignment"]["name"] == "shift"
    for name in ("mean_horizontal_m", "rmse_horizontal_m", "nees_mean", "max_horizontal_m"):
        assert far["metrics"][name] == pytest.approx(here["metrics"][name], abs=1e-5), name
    assert "constant shift removed" in far["verdict"]
    assert far["verdict"] == here["verdict"]
    page = (tmp_path / "far" / "report.md").read_text(encoding="utf-8")
    assert "state origin_lat_deg and origin_lon_deg under [map]" in page


def test_with_a_stated_origin_the_shift_counts_and_a_wrong_one_is_named(tmp_path: Path) -> None:
    right = replayed(tmp_path, "right", curved_dive(gps=True), MAP)
    wrong = replayed(tmp_path, "wrong", shifted(curved_dive(gps=True), 30.0, 40.0), MAP)

    assert right["alignment"]["name"] == wrong["alignment"]["name"] == "none"
    assert wrong["metrics"]["shift_m"] == pytest.approx(50.0, abs=0.5)
    assert wrong["metrics"]["unshifted_mean_m"] == pytest.approx(right["metrics"]["unshifted_mean_m"], abs=1e-3)
    assert any("a constant shift (30." in text and "the origin under [map]" in text for text in wrong["warnings"])


def test_a_track_on_an_unknown_map_has_no_latitudes_but_lies_on_the_truth_in_the_map_files(tmp_path: Path) -> None:
    replayed(tmp_path, "far", shifted(curved_dive(gps=True), 3000.0, 0.0))

    header, first = (tmp_path / "far" / "track_5hz.csv").read_text().splitlines()[:2]
    cells = dict(zip(header.split(","), first.split(","), strict=True))
    shapes = json.loads((tmp_path / "far" / "track.geojson").read_text())["features"]
    lines = {one["properties"]["role"]: one["geometry"]["coordinates"] for one in shapes}
    ends = np.array([lines["estimate"][0], lines["truth"][0][0]])

    assert cells["lat_deg"] == cells["lon_deg"] == ""
    assert np.ptp(ends, axis=0) == pytest.approx([0, 0], abs=2e-4)  # 20 m, of 3000; the track begins 10 s earlier


def test_gps_does_not_aid_on_a_map_that_it_has_no_place_on(tmp_path: Path) -> None:
    log = write_mcap(tmp_path / "dive.mcap", curved_dive(gps=True))

    said = refusal(UsageError, output_of, "replay", log, "--filter", "adf", "--aid", "gps@0:20")

    assert "state origin_lat_deg and origin_lon_deg under [map]" in said


def test_a_local_truth_beside_latitudes_has_an_unknown_place(tmp_path: Path) -> None:
    saved(tmp_path / "truth.csv", "time_ns,east_m,north_m\n1600000000000000000,0,0\n1600000009000000000,0,0\n")
    stated, latlon = '[truth]\nfile = "truth.csv"\n', "[usbl]\nhead = { lat_deg = 45.0, lon_deg = 7.0 }\n"
    log = write_mcap(tmp_path / "dive.mcap", curved_dive())

    unknown = [read_as(log, toml + stated).truth.place_unknown for toml in ("", latlon, MAP + latlon)]

    assert unknown == [False, True, False]


ADVICE = "--filter usbl judges the raw fixes"


@pytest.fixture(params=["/dvl", "/imu"])
def log(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """A dive without one of the two topics."""
    return write_mcap(tmp_path / "dive.mcap", [row for row in curved_dive(gps=True) if row[1] != request.param])


def test_the_raw_fixes_have_the_errors_of_the_whole_log(log: Path, tmp_path: Path) -> None:
    whole = write_mcap(tmp_path / "whole.mcap", curved_dive(gps=True))
    errors: list[float] = []
    for one in (log, whole):
        (tmp_path / f"{one.stem}.usbldr.toml").write_text(MAP, encoding="utf-8")
        reported = json.loads(output_of("replay", one, "-f", "usbl", "--json", "-o", tmp_path / one.stem))
        errors.append(reported["metrics"]["mean_horizontal_m"])

    assert errors[0] == pytest.approx(errors[1], abs=1e-9)


def test_what_needs_the_sensor_says_so_and_what_still_works(log: Path) -> None:
    assert ADVICE in refusal(LogError, output_of, "replay", log, "-f", "adf")
    assert ADVICE in run("info", log).stdout
    found = findings(log)
    assert ADVICE in found["SENSOR-MISSING"]["text"]
    assert found["SENSOR-MISSING"]["level"] == "error"


def test_init_asks_for_the_sensor_in_a_file_with_which_the_fixes_are_judged(log: Path, tmp_path: Path) -> None:
    said = refusal(LogError, output_of, "init", log)
    missing = next(role for role in ("dvl", "compass") if f"no topic is known to be {role};" in said)

    text = (tmp_path / "dive.usbldr.toml").read_text(encoding="utf-8")
    assert text.count('topic = "none"') == 1  # the depth
    assert "without it, only --filter usbl works" in text
    assert "usbl: mean horizontal error" in output_of("replay", log, "-f", "usbl", "-q", "-o", tmp_path / "run")
    output_of("init", log, f"--{missing}", "none", "--force")
