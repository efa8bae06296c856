"""What is exported reads back as it was, in every format, and replays to the same track."""

import tomllib
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from commands import output_of, run
from logs import logged_csv, refusal
from recordings import SECOND, T0, short_dive, twist, write_csv, write_mcap, yaw
from usbldr.filters.errors import LogError, UsageError
from usbldr.io.log import Log
from usbldr.io.reading.read import read_log
from usbldr.io.writers.export import cut_log, export

NAMES = ["out.mcap", "out.bag", "out.db3", "out_db3", "out"]
CONFIGURATION = """
map = { origin_lat_deg = 45.5, origin_lon_deg = 7.25 }
process = { heading_deg = 0.3 }
start = { east_m = 1.0, north_m = 2.0, sd_m = 3.0 }
gps = { lever_arm_m = [0.25, 1.5, 2.0], noise = { kind = "gaussian" } }
dvl = { mount_deg = 10.0, latency_s = 0.125, noise = { kind = "student-t", dof = 3.0, per = "record" } }
compass = { bias_deg = 2.5, latency_s = -0.0625 }
usbl = { lever_arm_m = [0.5, -1.0, 0.25], noise = { kind = "mixture", share = 0.2, variance_ratio = 20.0 } }
[truth]
file = "slam.csv"
kind = "slam"
max_gap_s = 4.5
lever_arm_m = [0.25, -0.5, 1.0]
columns = { time_ns = "t", x = "x", y = "y", sd_m = "sd" }
frame = "NED"
[calibrate]
states = ["scale", "misalignment"]
scale_sd = 0.02
mount_sd_deg = 3.0
heading_sd_deg = 1.0
heading_walk_deg = 0.05
deviation_sd_deg = 0.7
latency_sd_s = 0.1
usbl_bias_sd_m = 2.0
usbl_bias_time_s = 300.0
"""


def every_kind_of_record(folder: Path) -> Path:
    """Times that no float holds, sigmas of their own, nothing measured, standing still, invalid, late fixes."""
    t = T0 + 123_456_789
    (folder / "slam.csv").write_text(f"t,x,y,sd\n{t},1.5,-2.25,0.3\n{t + 10**9 + 1},1.75,-2.5,0.7\n", encoding="utf-8")
    dive = write_csv(
        folder / "dive",
        dvl=f"""time_ns,received_ns,starboard_mps,forward_mps,up_mps,sd_mps,valid
            {t},{t + 3},0.1,1.2,0.01,0.021,True
            {t + 200_000_001},{t + 200_000_001},0,0,0,0.034,True
            {t + 400_000_003},{t + 500_000_000},,,,,False
            {t + 600_000_000},{t + 600_000_000},-0.3,1.1,,,True""",
        compass=f"""time_ns,received_ns,heading_deg,sd_deg
            {t + 7},{t + 9},359.123456789,0.25
            {t + 800_000_000},{t + 800_000_007},0.1,1.75""",
        usbl=f"""time_ns,received_ns,east_m,north_m,cov_ee_m2,cov_en_m2,cov_nn_m2
            {t + 11},{t + 2 * 10**9},10.1,-20.2,2.5,-0.75,1.25
            {t + 700_000_000},{t + 1_900_000_000},11.1,-21.2,0.64,0.0,0.64""",
        gps=f"""time_ns,received_ns,lat_deg,lon_deg,sd_m
            {t + 13},{t + 20},45.5001,7.2501,1.5
            {t + 10**9},{t + 10**9},45.5002,7.2502,""",
        depth=f"time_ns,depth_m\n{t + 17},12.34567\n{t + 10**9},0.0",
    )
    (dive / "usbldr.toml").write_text(CONFIGURATION, encoding="utf-8")
    return dive


def assert_same(back: Log, log: Log) -> None:
    """Stamps to the nanosecond, values to rounding."""
    assert (back.start_ns, back.parameters) == (log.start_ns, log.parameters)
    assert list(back.tables) == list(log.tables)
    for sensor, table in log.tables.items():
        other = back.tables[sensor]
        for name in ("time_s", "received_s"):
            np.testing.assert_array_equal(np.round(other[name] * 1e9), np.round(table[name] * 1e9), sensor)
        pd.testing.assert_frame_equal(other, table, rtol=1e-13, atol=1e-12)
    assert (back.truth is None) == (log.truth is None)
    if log.truth is not None and back.truth is not None:
        reported = [(truth.kind, truth.max_gap_s, truth.lever_m) for truth in (back.truth, log.truth)]
        assert reported[0] == reported[1]
        np.testing.assert_array_equal(back.truth.position_m, log.truth.position_m)
        np.testing.assert_array_equal(back.truth.sd_m, log.truth.sd_m)
        np.testing.assert_allclose(back.truth.time_s, log.truth.time_s, rtol=0, atol=1e-10)


@pytest.mark.parametrize("name", NAMES)
def test_every_value_and_stamp_comes_back_and_the_same_log_gives_the_same_bytes(tmp_path: Path, name: str) -> None:
    log = read_log(every_kind_of_record(tmp_path))

    (_, configuration), _ = (export(log, tmp_path / folder / name) for folder in ("a", "b"))
    back = read_log(tmp_path / "a" / name)

    assert back.configuration == configuration
    assert_same(back, log)
    assert [finding.code for finding in back.findings if finding.lost_data] == []
    a, b = (
        {str(f.relative_to(tmp_path / top)): f.read_bytes() for f in (tmp_path / top).rglob("*") if f.is_file()}
        for top in ("a", "b")
    )
    assert a
    assert a == b


def test_a_gps_without_a_place_on_earth_stays_on_the_plane(tmp_path: Path) -> None:
    folder = write_csv(
        tmp_path / "dive",
        compass=f"time_ns,heading_deg\n{T0},1\n{T0 + 10**9},2",
        gps=f"time_ns,east_m,north_m,sd_m\n{T0},1.5,2.5,0.5\n{T0 + 10**9},3,4,",
    )
    log = read_log(folder)

    for name in NAMES:
        export(log, tmp_path / "new" / name, force=True)
        assert_same(read_log(tmp_path / "new" / name), log)


@pytest.mark.parametrize(("start_s", "skipped", "kept"), [(0.0, 2, 3), (0.5, 1, 3), (1.5, 0, 3), (3.5, 0, 2)])
def test_gps_rows_that_are_no_truth_are_none_in_the_export(tmp_path, start_s, skipped, kept):
    t = [T0 + k * 10**9 for k in range(6)]
    rows = "\n".join(f"{time},{k},{k % 2},0.5" for k, time in enumerate(t) if k != 3)
    compass = "time_ns,heading_deg\n" + "\n".join(f"{time},1" for time in t)
    gps = f"time_ns,east_m,north_m,sd_m\n{rows}"
    log = cut_log(logged_csv(tmp_path, "[truth]\nskip_rows = 2\n", compass=compass, gps=gps), start_s, 9.0)

    for name in NAMES:
        export(log, tmp_path / "new" / name, force=True)
        back = read_log(tmp_path / "new" / name)
        assert tomllib.loads(back.configuration.read_text())["truth"].get("skip_rows", 0) == skipped
        assert len(log.truth.time_s) == len(back.truth.time_s) == kept
        np.testing.assert_array_equal(back.truth.position_m, log.truth.position_m)


def test_a_stretch_holds_what_was_valid_in_it_and_no_start_where_the_beginning_is_cut_off(tmp_path: Path) -> None:
    log, started = read_log(write_mcap(tmp_path / "dive.mcap", short_dive())), read_log(every_kind_of_record(tmp_path))

    export(cut_log(log, 3.0, 6.0), tmp_path / "stretch.bag")
    back = read_log(tmp_path / "stretch.bag")

    assert {sensor: len(table) for sensor, table in back.tables.items()} == {"dvl": 4, "compass": 4, "usbl": 4}
    assert back.start_ns == T0 + 3 * 10**9
    assert list(back.tables["usbl"]["east_m"]) == [3, 4, 5, 6]
    assert "no record is from --start 50 to --end 60 s" in refusal(LogError, cut_log, log, 50.0, 60.0)
    assert cut_log(started, -1.0, 9.0).parameters.start == started.parameters.start
    assert cut_log(started, 0.1, 9.0).parameters.start is None


@pytest.mark.parametrize(("out", "within"), [("dive.mcap", "new.mcap"), ("dive.bag", "new")])
def test_the_log_and_its_configuration_are_never_written_over_nor_anything_into_its_folder(tmp_path, out, within):
    write_mcap(tmp_path / "dive.mcap", short_dive())
    log = read_log(tmp_path / "dive.mcap")
    before = (tmp_path / "dive.mcap").read_bytes()

    assert "choose another name" in refusal(UsageError, export, log, tmp_path / out, force=True)

    assert [f.name for f in tmp_path.iterdir()] == ["dive.mcap"]
    assert (tmp_path / "dive.mcap").read_bytes() == before
    folder = every_kind_of_record(tmp_path)
    with pytest.raises(UsageError, match=r"is inside the input .*dive"):
        export(read_log(folder), folder / within)


def test_an_input_is_never_replaced_by_the_folder_that_holds_it_nor_written_into(tmp_path: Path) -> None:
    """Of one dive: a recording, a file joined to it, the truth and the configuration, each in a folder of its own."""
    rows = short_dive()
    places = {name: tmp_path / name for name in ("log", "joined", "stated", "truth", "settings")}
    for place in places.values():
        place.mkdir()
    log = write_mcap(places["log"] / "dive.mcap", [row for row in rows if row[1] == "/dvl"])
    joined = write_mcap(places["joined"] / "usbl.mcap", [row for row in rows if row[1] == "/usbl"])
    write_mcap(places["stated"] / "imu.mcap", [row for row in rows if row[1] == "/imu"])
    (places["truth"] / "dvl.csv").write_text(f"time_ns,east_m,north_m\n{T0},0,0\n", encoding="utf-8")
    settings = places["settings"] / "usbldr.toml"
    stated = '# Written by: usbldr export\n[truth]\nfile = "../truth/dvl.csv"\n[[file]]\npath = "../stated/imu.mcap"\n'
    settings.write_text(stated, encoding="utf-8")
    asked = ["export", str(log), "--with", str(joined), "--config", str(settings), "--force", "-o"]
    before = {file: file.read_bytes() for file in tmp_path.rglob("*") if file.is_file()}

    for out in (log, *places.values(), tmp_path):
        said = refusal(UsageError, output_of, *asked, out)
        assert said.startswith(f"{out}: "), out
        assert "is the log" in said or "the input" in said, out

    assert {file: file.read_bytes() for file in tmp_path.rglob("*") if file.is_file()} == before


def test_force_replaces_a_folder_that_says_that_it_was_written_by_us_and_no_other(tmp_path: Path) -> None:
    log = read_log(every_kind_of_record(tmp_path))
    field = write_csv(tmp_path / "field", dvl="time_ns,forward_mps\n1,2")
    (field / "usbldr.toml").write_text("schema = 1\n", encoding="utf-8")
    written = write_csv(tmp_path / "written", notes="remark,by\nfine,me")
    (tmp_path / "empty").mkdir()

    export(log, tmp_path / "again")
    for name in ("again", "empty"):
        export(log, tmp_path / name, force=True)
    assert "field: is not a log written by usbldr" in refusal(UsageError, export, log, field, force=True)
    with pytest.raises(UsageError, match=r"written: holds notes\.csv, which usbldr did not write"):
        export(log, written, force=True)

    assert sorted(f.name for f in field.iterdir()) == ["dvl.csv", "usbldr.toml"]
    assert (field / "dvl.csv").read_text(encoding="utf-8") == "time_ns,forward_mps\n1,2\n"


def test_the_command_writes_and_says_what(tmp_path: Path) -> None:
    log, out = write_mcap(tmp_path / "dive.mcap", short_dive()), tmp_path / "cut"
    asked = ["export", str(log), "-o", str(out), "--format", "rosbag2", "--start", "2", "--end", "2020-09-13T12:26:45Z"]

    done = run(*asked)

    assert done.stdout == f"{out}: records: 4 dvl, 4 compass, 4 usbl\n{out}/usbldr.toml: noise, start and conventions\n"
    assert sorted(f.name for f in out.iterdir()) == ["cut.db3", "metadata.yaml", "usbldr.toml"]
    again = refusal(UsageError, output_of, *asked)
    assert again == f"{out}: exists already; choose another name, or overwrite it with --force"


def test_an_export_of_a_damaged_log_is_written_and_said_to_be_partial(tmp_path: Path) -> None:
    rows = [row for k in range(200) for row in (twist(T0 + k * SECOND, 1.0, 0.0), yaw(T0 + k * SECOND, 0.0))]
    whole = write_mcap(tmp_path / "whole.mcap", rows, chunk_size=512).read_bytes()
    (tmp_path / "cut.mcap").write_bytes(whole[: len(whole) // 2])

    done = run("export", tmp_path / "cut.mcap", "-o", tmp_path / "new.bag")

    assert done.return_value == 3
    assert "TRUNCATED: the file is truncated or damaged" in done.stdout
    assert read_log(tmp_path / "new.bag").tables


def test_the_export_of_a_scenario_may_have_its_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)

    for out in ("paper.mcap", "paper"):
        output_of("export", "paper", "-o", out, "--end", 20)
        assert len(read_log(tmp_path / out).tables["dvl"]) == 101
