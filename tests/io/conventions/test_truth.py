"""The reference track: from a file, from a topic, from the GPS, or none; and one that jumps."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from logs import MAP, logged_csv, only, read_as, refusal
from recordings import ODOMETRY, POSE, SECOND, T0, Row, fix, point, saved, short_dive, turned, write_mcap
from usbldr.filters.errors import LogError, UsageError
from usbldr.filters.types import Array, Truth, Vector
from usbldr.io.conventions.sanity import truth_jump_findings
from usbldr.io.log import Log
from usbldr.io.reading.read import Request, read_log

VERTICES = """% timestamp, frame id, x, y, z
1600000000.374442,0,0.1,0.2,9
1600000001.908468,1,1.5,2.5,9
1600000001.500001,2,3.0,4.0,9
1600000001.500001,3,8.0,9.0,9
"""
NED_FILE = """
[truth]
file = "slam/vertices.txt"
kind = "slam"
frame = "NED"
max_gap_s = 12.0
columns = { time_unix_s = "timestamp", x = "x", y = "y" }
"""

FIXES = [fix(T0 + k * SECOND, 45.0 + k * 1e-5, 7.0) for k in range(3)]


def dive(tmp_path: Path, toml: str = "", more: Sequence[Row] = (), request: Request | None = None) -> Log:
    write_mcap(tmp_path / "dive.mcap", [*short_dive(), *more])
    (tmp_path / "slam").mkdir(exist_ok=True)
    (tmp_path / "slam" / "vertices.txt").write_text(VERTICES, encoding="utf-8")
    return read_as(tmp_path / "dive.mcap", toml, request or Request())


def pose(time_ns: int, x: float, y: float, kind: str = POSE) -> Row:
    path = "pose.position" if kind == POSE else "pose.pose.position"
    return time_ns, "/slam", kind, {"header.stamp": time_ns, f"{path}.x": x, f"{path}.y": y}


TUM_LINES = """# timestamp tx ty tz qx qy qz qw
1600000001.500000000 3.0 4.0 0 0 0 0 1
1600000002.500000000 5.0 6.0 0 0 0 0 1
"""
LATLON = MAP + '[truth]\nframe = "latlon"\ncolumns = { time_s = "t", x = "lat", y = "lon" }'
POSES = [pose(T0 + k * SECOND, 10.0 + k, 20.0) for k in range(3)]
AFTER = "timestamp,x,y\ns,m,m\n1600000000.1,1,2\n1600000001.1,3,4\n"  # whose first row need hold no numbers
NORTH_M = 1.1113
OF_TUM = [1.5, 2.5], [[3, 4], [5, 6]]
BY_USUAL_NAMES = [
    f"% timestamp, frame id, x, y, z\n{T0 // SECOND + 1},7,1,2,-3",
    f"stamp_ns,x_m,y_m\n{T0 + SECOND},1,2",
    "time_s,tx,ty\n1,1,2",
    "time,east_m,north_m\n2020-09-13T12:26:41.000Z,1,2",
    f"timestamp,heading,east_m,north_m,x,y\n{T0 // SECOND + 1},9,1,2,99,99",
    f"time_ns  east_m north_m\n{T0 + SECOND}   1 2",
    "UTC time,Easting [m],Northing [m],x,y\n2020-09-13 12:26:41,1,2,99,99",
    "UTC time;Easting [ft];Northing [ft]\n13.09.2020 12:26:41;3,2808;6,5617",
]


@pytest.mark.parametrize(
    ("toml", "more", "option", "text", "time_s", "position_m", "source", "kind"),
    [
        # a file beside the log, sorted, its decimal seconds exact: as floats of today's seconds they are off by 0.1 us
        (NED_FILE, [], None, "", [0.374442, 1.500001, 1.908468], [[0.2, 0.1], [6.5, 5.5], [2.5, 1.5]], "vertices.txt",
         "slam"),
        (NED_FILE + "skip_rows = 1", [], "t.csv", AFTER, [0.1, 1.1], [[2, 1], [4, 3]], "t.csv", "other"),
        (LATLON, [], "t.csv", "t,lat,lon\n1.25,45.00001,7.0\n", [1.25], [[0, NORTH_M]], "t.csv", "other"),
        ("", [], "t.csv", f"time_ns,east_m,north_m,sd_m\n{T0 + SECOND},1,2,0.25\n", [1], [[1, 2]], "t.csv", "other"),
        *(("", [], "t.tum", text, *OF_TUM, "t.tum", "other")
          for text in (TUM_LINES, TUM_LINES.split("\n", 1)[1], TUM_LINES.rstrip("\n"))),
        *(("", [], "t.csv", f"{text}\n", [1], [[1, 2]], "t.csv", "other") for text in BY_USUAL_NAMES),
        # a topic of poses or of odometry; an option beats the configured file, whose frame it keeps
        *(('[truth]\ntopic = "/slam"\nframe = "NED"\nskip_rows = 1\nkind = "slam"',
           [pose(T0 + k * SECOND, 10.0 + k, 20.0, kind) for k in range(3)], None, "", [1, 2], [[20, 11], [20, 12]],
           "/slam", "slam") for kind in (POSE, ODOMETRY)),
        (NED_FILE, POSES[:1], "/slam", "", [0], [[20, 10]], "/slam", "slam"),
        ('[truth]\nkind = "gps"', [*FIXES, *POSES[:1]], "/slam", "", [0], [[10, 20]], "/slam", "slam"),
        ('[truth]\ntopic = "/slam"\nframe = "NED"', [*FIXES, *POSES[:1]], None, "", [0], [[20, 10]], "/slam", "slam"),
        # the GPS by default, or by an option without the frame of the configured file
        ("", FIXES, None, "", [0, 1, 2], [[0, 0], [0, NORTH_M], [0, 2 * NORTH_M]], "/gps/fix", "gps"),
        (NED_FILE, FIXES, "/gps/fix", "", [0, 1, 2], [[0, 0], [0, NORTH_M], [0, 2 * NORTH_M]], "/gps/fix", "gps"),
    ],
)  # fmt: skip
def test_the_truth_is_the_file_or_topic_that_is_named_or_else_the_gps(
    tmp_path, toml, more, option, text, time_s, position_m, source, kind
):
    if text:
        option = str(saved(tmp_path / option, text))

    log = dive(tmp_path, toml, more, Request(truth=option))

    np.testing.assert_array_equal(log.truth.time_s, time_s)
    np.testing.assert_allclose(log.truth.position_m, position_m, atol=1e-3)
    assert (log.truth.source, log.truth.kind) == (source, kind)
    if option:
        assert log.provenance["truth"].chosen_by == "option"
    if text == AFTER:
        assert (log.provenance["truth"].messages, log.provenance["truth"].used) == (3, 2)
    assert "KEY-UNUSED" not in {finding.code for finding in log.findings}


def test_rows_of_one_time_are_averaged_and_the_keys_and_sigmas_of_the_truth_are_kept(tmp_path):
    log = dive(tmp_path, NED_FILE, FIXES)

    assert log.truth.max_gap_s == 12.0
    assert only(log, "SAME-STAMP") == (
        "vertices.txt: 1 of 4 records have another's stamp and other values; records of one stamp are averaged"
    )
    assert len(log.tables["gps"]) == 3
    file = saved(tmp_path / "t.csv", f"time_ns,east_m,north_m,sd_m\n{T0 + SECOND},1,2,0.25\n")
    assert dive(tmp_path, request=Request(truth=str(file))).truth.sd_m[0] == 0.25


BY_COLUMNS = 't.csv: frame = "NED" of the configuration is not used; its columns are ENU'
BY_GPS = "frame of [truth] is not used: the truth is the log's GPS"


@pytest.mark.parametrize(
    ("toml", "more", "said"),
    [
        ('[truth]\nfile = "t.csv"\nframe = "NED"', [], [BY_COLUMNS]),
        ('[truth]\nfile = "t.csv"\nframe = "ENU"', [], []),
        ('[truth]\nframe = "NED"', FIXES, [BY_GPS]),
        ('[gps]\nframe = "latlon"', FIXES, []),
    ],
)
def test_a_frame_that_columns_or_the_gps_rule_out_is_said_to_be_unused(tmp_path, toml, more, said):
    saved(tmp_path / "t.csv", f"time_ns,east_m,north_m\n{T0 + SECOND},1,2\n")

    found = [one.text for one in dive(tmp_path, toml, more).findings if one.code == "KEY-UNUSED" or not more]

    assert [text[: len(start)] for text, start in zip(found, said, strict=True)] == said


@pytest.mark.parametrize(
    ("toml", "text", "option", "fault", "said"),
    [
        ("", "time_ns,lat_deg,lon_deg\n1,45,7\n", "{file}", LogError,
         "{file}: t.csv holds latitudes and longitudes, but the plane has no origin; state origin_lat_deg and "
         "origin_lon_deg under [map]"),
        ("", "epoch,px,py\n1,2,3\n", "{file}", UsageError,
         "{file}: which columns hold time and position (it has epoch, px, py)? Call them time_unix_s, lat_deg and "
         "lon_deg or x and y; of a truth, or state columns = { time_unix_s = \"...\", x = \"...\", y = \"...\" } "
         "under [truth]"),
        (NED_FILE, "stamp,x,y\n1600000000.1,1,2\n", "{file}", UsageError,
         "{file}: /t has no timestamp ([truth] columns time_unix_s); did you mean stamp? (it has stamp, x, y)"),
        (NED_FILE, "timestamp,x,y\nnoon,1,2\n", "{file}", LogError,
         '{file}: /t cannot be read as truth: {file}: line 2: timestamp is "noon", not a number of seconds before '
         "2116"),
        (NED_FILE + "skip_rows = 9", "timestamp,x,y\n1600000000.1,1,2\n", "{file}", LogError,
         "{file}: no row is left of 1 (skip_rows = 9)"),
        ("", "", "slam/gone.txt", LogError,
         "{log}: truth slam/gone.txt is neither a file, here or beside the log, nor a topic"),
        ("", "", "/no/topic", LogError,
         "{log}: truth /no/topic is neither a file, here or beside the log, nor a topic"),
        ('[truth]\nfile = "gone.txt"', "", None, LogError, "{gone}: no such truth file ([truth] file)"),
        ('[truth]\ntopic = "/gps/fix"\nframe = "NED"', "", None, UsageError,
         '{toml}: frame = "NED": /gps/fix holds latitudes and longitudes'),
    ],
)  # fmt: skip
def test_a_truth_that_cannot_be_read_is_one_sentence(tmp_path, toml, text, option, fault, said):
    file = saved(tmp_path / ("slam.tum" if text.startswith("#") else "t.csv"), text)
    names = {"log": "dive.mcap", "toml": "usbldr.toml", "gone": "gone.txt", "file": file.name}
    gps = FIXES if "/gps/fix" in toml else []

    sentence = refusal(fault, dive, tmp_path, toml, gps, Request(truth=option and option.replace("{file}", str(file))))

    for name, place in names.items():
        said = said.replace(f"{{{name}}}", str(tmp_path / place))
    assert sentence == said


@pytest.mark.parametrize(
    ("name", "toml", "text", "said"),
    [
        ("t.csv", NED_FILE, "timestamp,x,y\n1600000000.1,1,2\nnoon,1,2\n",
         '1 of 2 rows are left out: line 3: timestamp is "noon", not a number of seconds before 2116'),
        ("t.csv", NED_FILE + "skip_rows = 1", "timestamp,x,y\ns,m,m\n1.1,2,1\n2.1,east,4\n",
         '1 of 2 rows are left out: line 4: x is "east", not a number'),
        ("slam.tum", "", "# timestamp tx ty tz qx qy qz qw\n1 1.0 2.0 0 0 0 0 1\n2 east 6.0 0 0 0 0 1\n",
         '1 of 2 rows are left out: line 3: tx is "east", not a number'),
    ],
)  # fmt: skip
def test_a_row_of_a_truth_that_is_no_position_is_left_out_and_reported(tmp_path, name, toml, text, said):
    log = dive(tmp_path, toml, request=Request(truth=str(saved(tmp_path / name, text))))

    assert len(log.truth.position_m) == 1
    assert only(log, "UNDECODED") == f"{name}: {said}"


@pytest.mark.parametrize("source", ['topic = "/gps"', 'file = "dive/gps.csv"'])
def test_letters_beside_the_degrees_of_a_truth_say_its_hemisphere(tmp_path: Path, source: str) -> None:
    rows = "".join(f"{1_600_000_000 + k},45,S,7,W\n" for k in range(2))

    log = logged_csv(tmp_path, f"[truth]\n{source}\n", gps=f"Time [s],Latitude [deg],N/S,Longitude [deg],E/W\n{rows}")

    assert (log.origin.lat_deg, log.origin.lon_deg) == (-45.0, -7.0)
    np.testing.assert_allclose(log.truth.position_m, 0.0, atol=1e-6)


def test_poses_that_are_all_turned_alike_state_no_heading(tmp_path: Path) -> None:
    truth = dive(tmp_path, '[truth]\ntopic = "/slam"', [pose(T0 + k * SECOND, k, 0.0, POSE) for k in range(3)]).truth

    assert truth.yaw_rad is None
    assert truth.velocity_mps is None


@pytest.mark.parametrize(("toml", "option"), [("", "none"), ('[truth]\ntopic = "none"', None)])
def test_truth_can_be_switched_off(tmp_path: Path, toml: str, option: str | None) -> None:
    log = dive(tmp_path, toml, FIXES, Request(truth=option))

    assert log.truth is None
    assert "gps" in log.tables


def test_a_truth_of_another_day_is_pointed_out(tmp_path: Path) -> None:
    log = dive(tmp_path, more=[fix(T0 + 86400 * SECOND, 45.0, 7.0)])

    assert only(log, "TRUTH-APART") == (
        "/gps/fix: truth and sensors do not overlap in time: it covers 86400.0 to 86400.0 s, the sensors 0.0 to 10.0 s"
    )


def test_the_accuracy_of_a_gps_message_is_taken_where_it_is_known(tmp_path: Path) -> None:
    covariance = np.diag([0.09, 0.09, 1.0]).ravel()
    rows = [
        (t, topic, kind, {**values, "position_covariance": covariance, "position_covariance_type": known})
        for known, (t, topic, kind, values) in zip((2, 0, 2), FIXES, strict=True)
    ]

    np.testing.assert_allclose(dive(tmp_path, more=rows).truth.sd_m, [0.3, np.nan, 0.3])


def along_a_bend(frame: str, truth: str = "/nav/slam") -> list[Row]:
    """Fixes in ENU, and odometry of the same way 40 m apart, in a frame: east, then north, at 2 m/s and 0.5 to port."""
    rows: list[Row] = []
    for k in range(40):
        ns, east, north = T0 + k * SECOND, min(k, 20.0), max(k - 20.0, 0.0)
        x, y = (north, east + 40) if frame == "NED" else (east + 40, north)
        bow_deg = 90.0 if k < 20 else 0.0
        values = {"header.stamp": ns, "pose.pose.position.x": x, "pose.pose.position.y": y}
        values |= turned("pose.pose.orientation", bow_deg if frame == "NED" else 90.0 - bow_deg)
        values |= {"twist.twist.linear.x": 2.0, "twist.twist.linear.y": -0.5 if frame == "NED" else 0.5}
        rows += [point(ns, east, north), (ns, truth, ODOMETRY, values)]
    return rows


@pytest.mark.parametrize("frame", ["ENU", "NED"])
def test_the_frame_of_a_local_truth_is_checked_against_the_fixes(tmp_path: Path, frame: str) -> None:
    log = read_log(write_mcap(tmp_path / "dive.mcap", along_a_bend(frame)), Request(truth="/nav/slam"))

    np.testing.assert_allclose(log.truth.position_m[[0, 20, 39]], [[40, 0], [60, 0], [60, 19]])
    np.testing.assert_allclose(np.exp(1j * log.truth.yaw_rad[[0, 39]]), [-1j, 1], atol=1e-9)  # bow east, then north
    np.testing.assert_allclose(log.truth.velocity_mps[[0, 39]], [[-0.5, 2.0]] * 2)
    assert log.convention("truth", "frame").value == frame
    assert [f.code for f in log.findings if f.code.startswith("TRUTH")] == ["TRUTH-FRAME"] * (frame == "NED")
    assert log.truth.kind == "slam"


@pytest.mark.parametrize(
    ("name", "kind"),
    [("/nav/slam", "slam"), ("/sim/pose", "simulated"), ("/pose", "other"), ("/ground_truth/pose", "other")],
)
def test_a_stated_frame_of_the_truth_is_not_checked_and_its_kind_follows_from_its_name(tmp_path, name, kind):
    request = Request(truth=name, truth_frame="ENU")
    log = read_log(write_mcap(tmp_path / "dive.mcap", along_a_bend("NED", name)), request)

    np.testing.assert_allclose(log.truth.position_m[0], [0, 40])
    assert log.convention("truth", "frame").chosen_by == "configuration"
    assert log.truth.kind == kind


SECONDS = np.arange(60.0)
STRAIGHT_M = np.column_stack([1.5 * SECONDS, np.zeros(60)])


def said(position_m: Array, time_s: Vector = SECONDS) -> list[str]:
    truth = Truth(time_s, position_m, np.full(len(time_s), np.nan), "slam", "slam.txt")
    return [finding.text for finding in truth_jump_findings(truth)]


def moved(*jumps: tuple[slice | list[int], float]) -> Array:
    position_m = STRAIGHT_M.copy()
    for rows, metres in jumps:
        position_m[rows, 1] += metres
    return position_m


@pytest.mark.parametrize(
    ("position_m", "text"),
    [
        (moved((slice(2), 61.0)), "the truth jumps by 61 m between 1.0 and 2.0 s, as no vehicle moves: "
         "score what follows with --start 2"),
        (moved((slice(50, None), 61.0)), "the truth jumps by 61 m between 49.0 and 50.0 s, as no vehicle "
         "moves: score what comes before with --end 49"),
        (moved((slice(50, None), 9.0)), "the truth jumps by 9 m between 49.0 and 50.0 s, as no vehicle "
         "moves: score what comes before with --end 49"),
        (moved(([20, 45], 61.0), ([40], 100.0)), "3 single truth rows lie off both neighbours, at most by 100 m at "
         "40.0 s, as no vehicle moves: errors near there are the truth's; leave these rows out of it"),
        (moved((slice(20, 50), 200.0), ([10], 100.0)), "the truth jumps 2 times, at most by 200 m between 19.0 and "
         "20.0 s and 1 single truth row lies off both neighbours, at most by 100 m at 10.0 s, as no vehicle "
         "moves: errors near there are the truth's; leave these rows out of it"),
    ],
    ids=["a jump at first", "a jump at last", "a small jump", "outliers", "jumps and an outlier"],
)  # fmt: skip
def test_jumps_and_outliers_are_one_finding_that_says_what_to_do(position_m: Array, text: str) -> None:
    assert said(position_m) == [f"slam.txt: {text}"]


FAST_S, HELD_S = np.arange(0, 60, 0.05), np.arange(0, 60, 0.1)
FAST_M = np.outer(FAST_S, [1.5, 0])
DIVED_S = np.concatenate([SECONDS[:30], SECONDS[30:] + 600])
NO_JUMPS: dict[str, tuple[Array, Vector]] = {
    **{
        f"noise of {scatter_m} m": (FAST_M + np.random.default_rng(1).normal(0, scatter_m, FAST_M.shape), FAST_S)
        for scatter_m in (0.02, 3.0)
    },
    "held, then moved on": (np.column_stack([5 * np.floor(HELD_S), 0 * HELD_S]), HELD_S),
    "a gap": (moved((slice(30, None), 900.0)), DIVED_S),
    "a receiver that is corrected": (moved((slice(30, None), 4.0)), SECONDS),
    **{f"{rows} rows": (STRAIGHT_M[:rows], SECONDS[:rows]) for rows in range(3)},
    "zeros": (np.zeros((60, 2)), SECONDS),
}


@pytest.mark.parametrize("case", NO_JUMPS)
def test_what_a_vehicle_or_a_receiver_may_do_is_no_jump(case: str) -> None:
    assert said(*NO_JUMPS[case]) == []
