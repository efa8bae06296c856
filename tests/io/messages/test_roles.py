"""Which topic is used for which sensor, and the errors if that is ambiguous."""

from collections.abc import Callable, Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from recordings import SECOND, T0, TWIST_COVARIANCE, Row, execute, twist, write_bag, write_mcap, write_rosbag2, yaw
from usbldr.filters.errors import LogError, UsageError
from usbldr.io.messages.roles import Roles, choose_roles, find_topic
from usbldr.io.reader import TopicInfo
from usbldr.io.reading.opening import Request
from usbldr.io.reading.read import read_log

TWIST = ("header.stamp", "header.frame_id", "twist.linear.x", "twist.linear.y", "twist.linear.z")
POINT = ("header.stamp", "header.frame_id", "point.x", "point.y", "point.z")
IMU = ("header.stamp", "orientation.x", "orientation.y", "orientation.z", "orientation.w", "orientation_covariance")
FIX = ("header.stamp", "latitude", "longitude", "position_covariance")


def topic(name: str, kind: str, fields: tuple[str, ...], count: int = 10, problem: str = "") -> TopicInfo:
    arrays = frozenset(field for field in fields if "covar" in field)
    return TopicInfo(name, kind, "cdr", count, 0, 9_000_000_000, fields, problem, arrays)


DVL = topic("/dvl/twist", "geometry_msgs/msg/TwistStamped", TWIST)
IMU_DATA = topic("/imu/data", "sensor_msgs/msg/Imu", IMU)
USBL = topic("/usbl/point", "geometry_msgs/msg/PointStamped", POINT)
GPS = topic("/gps/fix", "sensor_msgs/msg/NavSatFix", FIX)
LOG = Path("dive.mcap")


def taken(roles: Roles) -> dict[str, str]:
    return {role: choice.topic.name for role, choice in roles.chosen.items()}


HDG = topic("/mavros/global_position/compass_hdg", "std_msgs/msg/Float64", ("data",))
MAVROS_IMU = topic("/mavros/imu/data", IMU_DATA.type, IMU)
RAW, NAMELESS = topic("/imu/data_raw", IMU_DATA.type, IMU), topic("/sensor_7", IMU_DATA.type, IMU)
A, B = topic("/a", DVL.type, TWIST), topic("/b", DVL.type, TWIST)
SHIP_GPS, SHIP_USBL = topic("/ship/gps", GPS.type, GPS.fields), topic("/ship/usbl", USBL.type, POINT)
SENTENCE = ("x", "y", "target", "fix_status")
OFFSET, BOW = (topic(f"/{kind}", f"nmea/{kind}", SENTENCE) for kind in ("PEVOSSB_E", "PTSAX"))
DEGREES = topic("/PTSAG", "nmea/PTSAG", ("lat_deg", "lon_deg", "target", "fix_status"))
OF_BOAT = (("dvl", DVL), ("imu", IMU_DATA), ("gps", GPS))
BOAT = [topic(f"/boat/{name}", like.type, like.fields) for name, like in OF_BOAT]
COMPUTED = ("/odometry/filtered", "/ekf/usbl", "/usbl/ground_truth", "/cmd_vel", "/twist", "/sim/dvl/usbl")


@pytest.mark.parametrize(
    ("topics", "options", "configured", "expected"),
    [
        ([USBL, GPS, IMU_DATA, DVL], {}, {},
         {"dvl": "/dvl/twist", "compass": "/imu/data", "usbl": "/usbl/point", "gps": "/gps/fix"}),
        # on a boat with its own DVL the word distinguishes nothing
        (BOAT, {}, {}, {"dvl": "/boat/dvl", "compass": "/boat/imu", "gps": "/boat/gps"}),
        # what is computed or nameless is no sensor
        *(([topic(name, DVL.type, TWIST), topic(name, USBL.type, POINT)], {}, {}, {}) for name in COMPUTED),
        # a name that suggests the sensor beats a type alone; raw data come after those with orientation
        ([NAMELESS, IMU_DATA], {}, {}, {"compass": "/imu/data"}),
        ([NAMELESS], {}, {}, {"compass": "/sensor_7"}),
        ([RAW, IMU_DATA], {}, {}, {"compass": "/imu/data"}),
        # latitudes come before offsets, and these before those along the bow
        ([BOW, OFFSET, DEGREES], {}, {}, {"usbl": "/PTSAG"}),
        ([BOW, OFFSET], {}, {}, {"usbl": "/PEVOSSB_E"}),
        # the IMU in the USBL's head is not the compass, and a USBL on the ship is the vehicle's
        ([topic("/usbl/orientation", IMU_DATA.type, IMU)], {}, {}, {}),
        ([DVL, SHIP_USBL], {}, {}, {"dvl": DVL.name, "usbl": "/ship/usbl"}),
        # options beat the configuration, which beats recognition; "none" switches off
        ([DVL, A, B], {}, {"dvl": "/a"}, {"dvl": "/a"}),
        ([DVL, A, B], {"dvl": "/b"}, {"dvl": "/a"}, {"dvl": "/b"}),
        ([GPS, DVL], {"gps": "none"}, {}, {"dvl": "/dvl/twist"}),
        ([GPS, DVL], {}, {"gps": "none"}, {"dvl": "/dvl/twist"}),
        ([GPS], {"gps": "/gps/fix"}, {"gps": "none"}, {"gps": "/gps/fix"}),
        ([DVL, SHIP_GPS], {"gps": "/ship/gps"}, {}, {"dvl": DVL.name, "gps": "/ship/gps"}),
        ([DVL, SHIP_GPS], {}, {"gps": "/ship/gps"}, {"dvl": DVL.name, "gps": "/ship/gps"}),
        # a topic used elsewhere leaves the role to the next, and one without messages is none
        ([HDG, MAVROS_IMU], {"depth": HDG.name}, {}, {"compass": MAVROS_IMU.name, "depth": HDG.name}),
        ([topic("/dvl/twist", DVL.type, TWIST, count=0)], {}, {}, {}),
    ],
)  # fmt: skip
def test_a_sensor_is_the_topic_that_is_named_or_else_the_best_by_type_and_name(topics, options, configured, expected):
    roles = choose_roles(LOG, topics, options, configured)

    assert taken(roles) == expected
    for role, choice in roles.chosen.items():
        by = "configuration" if role in configured else "type and name"
        assert choice.chosen_by == ("option" if role in options else by)
    assert roles.findings == () if options else "ROLE-SHIP" not in {finding.code for finding in roles.findings}


def test_two_candidates_are_an_error_that_lists_them_and_the_option() -> None:
    roles = choose_roles(LOG, [USBL, topic("/seatrac/point", USBL.type, POINT, count=19)], {}, {})

    assert taken(roles) == {}
    fault = roles.unresolved["usbl"]
    assert isinstance(fault, UsageError)
    assert str(fault) == (
        "dive.mcap: 2 topics could be the usbl: "
        "/usbl/point (geometry_msgs/msg/PointStamped, 10 messages, 1.00 Hz); "
        "/seatrac/point (geometry_msgs/msg/PointStamped, 19 messages, 2.00 Hz); "
        "choose one with --usbl TOPIC or with topic under [usbl] in the configuration"
    )


def test_an_ordinary_log_of_mavros_has_its_heading_without_a_choice() -> None:
    raw = topic("/mavros/imu/data_raw", IMU_DATA.type, IMU)

    roles = choose_roles(LOG, [raw, MAVROS_IMU, HDG], {}, {})

    assert taken(roles) == {"compass": "/mavros/global_position/compass_hdg"}
    assert roles.unresolved == {}
    (finding,) = roles.findings
    assert (finding.code, finding.text) == (
        "ROLE-PREFERRED",
        "/mavros/global_position/compass_hdg: used as compass; its type is preferred to that of /mavros/imu/data "
        "(sensor_msgs/msg/Imu, 10 messages); choose another with --compass TOPIC or with topic under [compass]",
    )


def test_an_unranked_heading_is_a_choice_for_the_user() -> None:
    gyro = topic("/gyro", "ds_sensor_msgs/msg/Compass", ("header.stamp", "heading", "is_true_heading"))

    for topics in ([gyro, HDG], [gyro, MAVROS_IMU], [HDG, topic("/b/compass_hdg", HDG.type, HDG.fields)]):
        roles = choose_roles(LOG, topics, {}, {})
        assert taken(roles) == {}
        assert "2 topics could be the compass" in str(roles.unresolved["compass"])
        assert roles.findings == ()


HEAD = ("header.stamp", "header.frame_id")
VELOCITY = (*HEAD, "velocity.x", "velocity.y", "velocity.z")
TWISTS = (*HEAD, *(f"twist.twist.linear.{axis}" for axis in "xyz"), "twist.covariance")
REPORT = ("header.stamp", *(f"report.{name}" for name in ("vx", "vy", "vz", "velocity_valid")))
ONE_AFTER_THE_OTHER = [
    (topic("/dvl/data", "dvl_msgs/msg/DVL", (*VELOCITY, "velocity_valid")),
     topic("/dvl/report", "waterlinked_dvl/msg/TransducerReportStamped", REPORT)),
    (topic("/dvl/marine", "marine_acoustic_msgs/msg/Dvl", (*VELOCITY, "velocity_covar", "num_good_beams")),
     topic("/dvl/whoi", "ds_sensor_msgs/msg/Dvl", (*VELOCITY, "velocity_covar", "coordinate_mode"))),
    (topic("/dvl/cola", "cola2_msgs/msg/DVL", (*VELOCITY, "velocity_covariance")),
     topic("/dvl/uuv", "uuv_sensor_msgs/msg/DVL", (*VELOCITY, "velocity_covariance", "velocity_reference"))),
    (topic("/dvl/covered", "geometry_msgs/msg/TwistWithCovarianceStamped", TWISTS),
     topic("/dvl/twist", DVL.type, TWIST)),
    (topic("/dvl/local_position", "nav_msgs/msg/Odometry", TWISTS),),
]  # fmt: skip


@pytest.mark.parametrize("rank", range(4))
def test_messages_of_the_dvl_come_before_what_was_made_of_them_and_two_of_one_rank_are_a_choice(rank: int) -> None:
    behind = [topic for topics in ONE_AFTER_THE_OTHER[rank + 1 :] for topic in topics]

    for first in ONE_AFTER_THE_OTHER[rank]:
        roles = choose_roles(LOG, [*behind[::-1], first], {}, {})
        assert taken(roles) == {"dvl": first.name}
        assert set(roles.chosen["dvl"].lower_ranked) == set(behind)
    sentence = str(choose_roles(LOG, [*ONE_AFTER_THE_OTHER[rank], *behind], {}, {}).unresolved["dvl"])
    assert sentence.startswith(f"dive.mcap: 2 topics could be the dvl: {ONE_AFTER_THE_OTHER[rank][0].name} (")
    assert f"; {ONE_AFTER_THE_OTHER[rank][1].name} (" in sentence


UNREAD = topic("/gps/fix", GPS.type, (), problem="encoding json is not supported")


@pytest.mark.parametrize(
    ("topics", "options", "fault", "said"),
    [
        ([DVL, USBL], {"dvl": "/dvl/twits"}, LogError, "no topic /dvl/twits for the dvl; did you mean /dvl/twist? "
         "(topics in this log: /dvl/twist, /usbl/point)"),
        ([topic("/dvl/twist", DVL.type, TWIST, count=0)], {"dvl": "/dvl/twist"}, LogError,
         "/dvl/twist, chosen as dvl, has no messages"),
        ([GPS], {"dvl": "/gps/fix"}, UsageError,
         "/gps/fix is of type sensor_msgs/msg/NavSatFix, which cannot be used as dvl (only bottomtrack, dvl, "
         "groundvelocity, linkquestdvl, nortekdf21, odometry, pd0_bottom_track, pd45_bottom_track, pd6_bi, pd6_bs, "
         "teledyneexplorerdvl, transducerreportstamped, twiststamped, twistwithcovariancestamped, "
         "vision_position_delta, viso, waterlinked_velocity, waterlinked_velocity_water, "
         "or any type whose fields are named by columns under [dvl]; usbldr info --fields /gps/fix lists them)"),
        ([UNREAD], {"gps": "/gps/fix"}, LogError,
         "/gps/fix cannot be read as gps: encoding json is not supported"),
    ],
)  # fmt: skip
def test_a_topic_that_is_named_and_cannot_be_used_is_an_error_that_lists_the_others(topics, options, fault, said):
    (found,) = choose_roles(LOG, topics, options, {}).unresolved.values()

    assert isinstance(found, fault)
    assert str(found) == f"dive.mcap: {said}"


def test_an_unreadable_topic_is_a_finding_if_it_is_missing() -> None:
    other = topic("/camera/info", "sensor_msgs/msg/CameraInfo", (), problem="encoding json is not supported")
    without = choose_roles(LOG, [UNREAD, other, DVL], {}, {})

    assert taken(without) == {"dvl": "/dvl/twist"}
    (finding,) = without.findings
    assert (finding.code, finding.level) == ("TOPIC-UNREAD", "error")
    assert finding.text == (
        f"/gps/fix: could be the gps by its type {GPS.type}, but cannot be read: encoding json is not supported; "
        "--gps none leaves it out"
    )
    assert not choose_roles(LOG, [UNREAD, GPS, DVL], {}, {}).findings
    assert not choose_roles(LOG, [UNREAD, DVL], {"gps": "none"}, {}).findings


def test_the_first_slash_of_a_topic_may_be_left_out_and_of_a_file_all_but_the_last_part() -> None:
    assert find_topic([DVL], "dvl/twist") == find_topic([DVL], "/dvl/twist") == DVL
    assert find_topic([DVL], "twist") is None
    sheet = TopicInfo("/twist", "usbldr/dvl", "csv", 3, 0, 1)  # a file, which has the last part of a topic
    assert find_topic([sheet], "/dvl/twist") == sheet
    assert find_topic([sheet], "/ship/twist") is None  # another vehicle's


def test_a_ship_s_receiver_and_gyro_are_not_the_vehicle_s() -> None:
    gyro = topic("/vessel/imu", IMU_DATA.type, IMU)

    roles = choose_roles(LOG, [DVL, SHIP_GPS, gyro, IMU_DATA], {}, {})
    camel = choose_roles(LOG, [DVL, topic("/ShipGPS", GPS.type, FIX), IMU_DATA], {}, {})

    assert taken(camel) == taken(roles) == {"dvl": DVL.name, "compass": "/imu/data"}
    of_ship = [("ROLE-SHIP", "/vessel/imu"), ("ROLE-SHIP", "/ship/gps")]
    assert [(finding.code, finding.topic) for finding in roles.findings] == of_ship
    assert roles.findings[1].text == (
        "/ship/gps: not used as gps, because of the name taken for a sensor of the ship; "
        "a sensor of the vehicle is chosen with --gps TOPIC or with topic under [gps]"
    )


STRING, ODOMETRY = "std_msgs/msg/String", "nav_msgs/msg/Odometry"
TWIST_X, TWIST_Y = "twist.twist.linear.x", "twist.twist.linear.y"
OF_OTHER_TYPE: Mapping[str, Callable[[int, float], Row]] = {
    "TwistStamped": lambda t, x: twist(t, x, 0.5),
    "Odometry": lambda t, x: (t, "/dvl", ODOMETRY, {"header.stamp": t, TWIST_X: x, TWIST_Y: 0.5}),
    "String": lambda t, x: (t, "/dvl", STRING, {"data": str(x)}),
}


@given(
    first=st.integers(1, 25), second=st.integers(1, 25), other=st.sampled_from([*OF_OTHER_TYPE]),
    at_once=st.booleans(), write=st.sampled_from([write_mcap, write_bag, write_rosbag2, "joined"]),
)  # fmt: skip
@settings(max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_a_topic_that_changes_its_type_is_read_whole_if_both_types_are_known_and_else_counted(
    first: int, second: int, other: str, at_once: bool, write: Any
) -> None:
    times = [T0 + k * SECOND for k in range(first + second)]
    late = [t + SECOND // 2 for t in times[:first]] if at_once else times[first:]
    before = [OF_OTHER_TYPE[other](t, k / 10) for k, t in enumerate(times[:first])]
    after = [
        (t, "/dvl", TWIST_COVARIANCE, {"header.stamp": t, TWIST_X: -k / 10, TWIST_Y: 0.5}) for k, t in enumerate(late)
    ]
    headings, more = [yaw(t, 0.0) for t in times], ()
    with TemporaryDirectory() as folder:
        if write == "joined":
            more = (str(write_mcap(Path(folder) / "b.mcap", after)),)
            file = write_mcap(Path(folder) / "a.mcap", [*before, *headings])
        else:
            rows = sorted([*before, *after, *headings], key=lambda row: row[0])
            file = write(Path(folder) / "a", rows)
        if write == write_rosbag2:  # the types are listed in another order than their messages
            (part,) = file.glob("*.db3")
            execute(part, "UPDATE topics SET id = -id", "UPDATE messages SET topic_id = -topic_id")
        logs = [read_log(file, Request(joined=more, topics=topics)) for topics in ({}, {"dvl": "/dvl"})]
    for log in logs:
        (said,) = [finding for finding in log.findings if finding.code in ("TOPIC-TYPES", "TOPIC-PARTS")]
        overlap = at_once and first > 1
        whole = other != "String" and not overlap
        read = first + len(late) if whole else len(late) if other == "String" else max(first, len(late))

        assert log.provenance["dvl"].used == log.provenance["dvl"].messages == read
        assert said.lost_data == (not whole)
        assert f"{first} messages of type " in said.text
        assert f"{len(late)} messages of type " in said.text
        assert (" are not" in said.text) == (not whole)
        if whole:
            expected = [*(k / 10 for k in range(first)), *(-k / 10 for k in range(len(late)))]
            assert sorted(log.tables["dvl"]["forward_mps"]) == sorted(expected)
