"""Which topic is used for which sensor, and the errors if that is ambiguous."""

from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from recordings import SECOND, T0, TWIST_COVARIANCE, Row, twist, write_mcap, yaw
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


def test_the_usual_topics_are_recognised() -> None:
    roles = choose_roles(LOG, [USBL, GPS, IMU_DATA, DVL], {}, {})

    assert taken(roles) == {"dvl": "/dvl/twist", "compass": "/imu/data", "usbl": "/usbl/point", "gps": "/gps/fix"}
    assert {choice.chosen_by for choice in roles.chosen.values()} == {"type and name"}
    assert roles.unresolved == {}


@pytest.mark.parametrize(
    "name", ["/odometry/filtered", "/ekf/usbl", "/usbl/ground_truth", "/cmd_vel", "/twist", "/sim/dvl/usbl"]
)
def test_what_is_computed_or_nameless_is_no_sensor(name: str) -> None:
    topics = [topic(name, DVL.type, TWIST), topic(name, USBL.type, POINT)]

    assert taken(choose_roles(LOG, topics, {}, {})) == {}


def test_two_candidates_are_an_error_that_lists_them_and_the_option() -> None:
    other = topic("/seatrac/point", USBL.type, POINT, count=19)

    roles = choose_roles(LOG, [USBL, other], {}, {})

    assert taken(roles) == {}
    fault = roles.unresolved["usbl"]
    assert isinstance(fault, UsageError)
    assert str(fault) == (
        "dive.mcap: 2 topics could be the usbl: "
        "/usbl/point (geometry_msgs/msg/PointStamped, 10 messages, 1.00 Hz); "
        "/seatrac/point (geometry_msgs/msg/PointStamped, 19 messages, 2.00 Hz); "
        "choose one with --usbl TOPIC or with topic under [usbl] in the configuration"
    )


def test_a_name_that_suggests_the_sensor_beats_a_type_alone() -> None:
    anonymous = topic("/sensor_7", IMU_DATA.type, IMU)

    assert taken(choose_roles(LOG, [anonymous, IMU_DATA], {}, {})) == {"compass": "/imu/data"}
    assert taken(choose_roles(LOG, [anonymous], {}, {})) == {"compass": "/sensor_7"}


def test_raw_imu_data_come_after_those_with_orientation() -> None:
    raw = topic("/imu/data_raw", IMU_DATA.type, IMU)

    assert taken(choose_roles(LOG, [raw, IMU_DATA], {}, {})) == {"compass": "/imu/data"}


HDG = topic("/mavros/global_position/compass_hdg", "std_msgs/msg/Float64", ("data",))
MAVROS_IMU = topic("/mavros/imu/data", IMU_DATA.type, IMU)


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
    (
        topic("/dvl/data", "dvl_msgs/msg/DVL", (*VELOCITY, "velocity_valid")),
        topic("/dvl/report", "waterlinked_dvl/msg/TransducerReportStamped", REPORT),
    ),
    (
        topic("/dvl/marine", "marine_acoustic_msgs/msg/Dvl", (*VELOCITY, "velocity_covar", "num_good_beams")),
        topic("/dvl/whoi", "ds_sensor_msgs/msg/Dvl", (*VELOCITY, "velocity_covar", "coordinate_mode")),
    ),
    (
        topic("/dvl/cola", "cola2_msgs/msg/DVL", (*VELOCITY, "velocity_covariance")),
        topic("/dvl/uuv", "uuv_sensor_msgs/msg/DVL", (*VELOCITY, "velocity_covariance", "velocity_reference")),
    ),
    (
        topic("/dvl/covered", "geometry_msgs/msg/TwistWithCovarianceStamped", TWISTS),
        topic("/dvl/twist", DVL.type, TWIST),
    ),
    (topic("/dvl/local_position", "nav_msgs/msg/Odometry", TWISTS),),
]


@pytest.mark.parametrize("rank", range(4))
def test_messages_of_the_dvl_come_before_what_was_made_of_them(rank: int) -> None:
    behind = [topic for topics in ONE_AFTER_THE_OTHER[rank + 1 :] for topic in topics]

    for first in ONE_AFTER_THE_OTHER[rank]:
        roles = choose_roles(LOG, [*behind[::-1], first], {}, {})
        assert taken(roles) == {"dvl": first.name}
        assert set(roles.chosen["dvl"].lower_ranked) == set(behind)


@pytest.mark.parametrize("rank", range(4))
def test_two_of_one_rank_are_a_choice_whatever_ranks_lower(rank: int) -> None:
    behind = [topic for topics in ONE_AFTER_THE_OTHER[rank + 1 :] for topic in topics]
    one, other = ONE_AFTER_THE_OTHER[rank]

    roles = choose_roles(LOG, [one, *behind, other], {}, {})

    sentence = str(roles.unresolved["dvl"])
    assert sentence.startswith(f"dive.mcap: 2 topics could be the dvl: {one.name} (")
    assert f"; {other.name} (" in sentence


def test_a_topic_used_elsewhere_leaves_the_role_to_the_next() -> None:
    roles = choose_roles(LOG, [HDG, MAVROS_IMU], {"depth": HDG.name}, {})

    assert taken(roles) == {"compass": MAVROS_IMU.name, "depth": HDG.name}
    assert roles.findings == ()


def test_latitudes_come_before_offsets_and_these_before_those_along_the_bow() -> None:
    fields = ("x", "y", "target", "fix_status")
    offset, bow = (topic(f"/{kind}", f"nmea/{kind}", fields) for kind in ("PEVOSSB_E", "PTSAX"))
    degrees = topic("/PTSAG", "nmea/PTSAG", ("lat_deg", "lon_deg", "target", "fix_status"))

    assert taken(choose_roles(LOG, [bow, offset, degrees], {}, {})) == {"usbl": "/PTSAG"}
    assert taken(choose_roles(LOG, [bow, offset], {}, {})) == {"usbl": "/PEVOSSB_E"}


def test_the_imu_in_the_usbl_head_is_not_the_compass() -> None:
    assert taken(choose_roles(LOG, [topic("/usbl/orientation", IMU_DATA.type, IMU)], {}, {})) == {}


def test_options_beat_the_configuration_which_beats_recognition() -> None:
    a, b = topic("/a", DVL.type, TWIST), topic("/b", DVL.type, TWIST)

    assert taken(choose_roles(LOG, [DVL, a, b], {}, {"dvl": "/a"})) == {"dvl": "/a"}
    roles = choose_roles(LOG, [DVL, a, b], {"dvl": "/b"}, {"dvl": "/a"})
    assert taken(roles) == {"dvl": "/b"}
    assert roles.chosen["dvl"].chosen_by == "option"


@pytest.mark.parametrize(("options", "configured"), [({"gps": "none"}, {}), ({}, {"gps": "none"})])
def test_none_switches_a_role_off(options: dict[str, str], configured: dict[str, str]) -> None:
    assert taken(choose_roles(LOG, [GPS, DVL], options, configured)) == {"dvl": "/dvl/twist"}


def test_an_option_brings_back_what_the_configuration_switched_off() -> None:
    assert taken(choose_roles(LOG, [GPS], {"gps": "/gps/fix"}, {"gps": "none"})) == {"gps": "/gps/fix"}


def test_an_absent_topic_is_an_error_with_the_nearest_and_all_names() -> None:
    roles = choose_roles(LOG, [DVL, USBL], {"dvl": "/dvl/twits"}, {})

    fault = roles.unresolved["dvl"]
    assert isinstance(fault, LogError)
    assert str(fault) == (
        "dive.mcap: no topic /dvl/twits for the dvl; did you mean /dvl/twist? "
        "(topics in this log: /dvl/twist, /usbl/point)"
    )


def test_a_topic_without_messages_is_an_error() -> None:
    empty = topic("/dvl/twist", DVL.type, TWIST, count=0)

    assert str(choose_roles(LOG, [empty], {"dvl": "/dvl/twist"}, {}).unresolved["dvl"]) == (
        "dive.mcap: /dvl/twist, chosen as dvl, has no messages"
    )
    assert taken(choose_roles(LOG, [empty], {}, {})) == {}


def test_a_topic_of_a_useless_type_is_an_error_that_lists_the_others() -> None:
    fault = choose_roles(LOG, [GPS], {"dvl": "/gps/fix"}, {}).unresolved["dvl"]

    assert isinstance(fault, UsageError)
    assert str(fault) == (
        "dive.mcap: /gps/fix is of type sensor_msgs/msg/NavSatFix, which cannot be used as dvl "
        "(only bottomtrack, dvl, groundvelocity, linkquestdvl, nortekdf21, odometry, pd0_bottom_track, "
        "pd45_bottom_track, pd6_bi, pd6_bs, teledyneexplorerdvl, transducerreportstamped, twiststamped, "
        "twistwithcovariancestamped, vision_position_delta, viso, waterlinked_velocity, waterlinked_velocity_water, "
        "or any type whose fields are named by columns under [dvl]; usbldr info --fields /gps/fix lists them)"
    )


def test_an_unreadable_topic_is_an_error_if_it_is_named_and_a_finding_if_it_is_missing() -> None:
    json = topic("/gps/fix", GPS.type, (), problem="encoding json is not supported")
    other = topic("/camera/info", "sensor_msgs/msg/CameraInfo", (), problem="encoding json is not supported")
    without = choose_roles(LOG, [json, other, DVL], {}, {})

    assert taken(without) == {"dvl": "/dvl/twist"}
    assert [(finding.code, finding.level, finding.text) for finding in without.findings] == [
        (
            "TOPIC-UNREAD",
            "error",
            f"/gps/fix: could be the gps by its type {GPS.type}, but cannot be read: encoding json is not supported; "
            "--gps none leaves it out",
        )
    ]
    assert not choose_roles(LOG, [json, GPS, DVL], {}, {}).findings
    assert not choose_roles(LOG, [json, DVL], {"gps": "none"}, {}).findings
    assert str(choose_roles(LOG, [json], {"gps": "/gps/fix"}, {}).unresolved["gps"]) == (
        "dive.mcap: /gps/fix cannot be read as gps: encoding json is not supported"
    )


def test_the_first_slash_of_a_topic_may_be_left_out() -> None:
    assert find_topic([DVL], "dvl/twist") == find_topic([DVL], "/dvl/twist") == DVL
    assert find_topic([DVL], "twist") is None


def test_a_csv_file_is_found_by_the_last_part_of_its_topic() -> None:
    sheet = TopicInfo("/twist", "usbldr/dvl", "csv", 3, 0, 1)

    assert find_topic([sheet], "/dvl/twist") == sheet


def test_a_ship_s_receiver_and_gyro_are_not_the_vehicle_s() -> None:
    gps = topic("/ship/gps", GPS.type, GPS.fields)
    gyro = topic("/vessel/imu", IMU_DATA.type, IMU)

    roles = choose_roles(LOG, [DVL, gps, gyro, IMU_DATA], {}, {})

    assert taken(roles) == {"dvl": DVL.name, "compass": "/imu/data"}
    assert [(finding.code, finding.topic) for finding in roles.findings] == [
        ("ROLE-SHIP", "/vessel/imu"),
        ("ROLE-SHIP", "/ship/gps"),
    ]
    assert roles.findings[1].text == (
        "/ship/gps: not used as gps, because of the name taken for a sensor of the ship; "
        "a sensor of the vehicle is chosen with --gps TOPIC or with topic under [gps]"
    )


def test_a_ship_s_receiver_is_used_if_it_is_named() -> None:
    gps = topic("/ship/gps", GPS.type, GPS.fields)

    assert taken(choose_roles(LOG, [DVL, gps], {"gps": "/ship/gps"}, {})) == {"dvl": DVL.name, "gps": "/ship/gps"}
    assert taken(choose_roles(LOG, [DVL, gps], {}, {"gps": "/ship/gps"})) == {"dvl": DVL.name, "gps": "/ship/gps"}


def test_on_a_boat_with_its_own_dvl_the_word_distinguishes_nothing() -> None:
    names = ("/boat/dvl", "/boat/imu", "/boat/gps")
    kinds = (DVL.type, IMU_DATA.type, GPS.type)
    topics = [topic(*one) for one in zip(names, kinds, (DVL.fields, IMU, GPS.fields), strict=True)]

    roles = choose_roles(LOG, topics, {}, {})

    assert taken(roles) == dict(zip(("dvl", "compass", "gps"), names, strict=True))
    assert roles.findings == ()


def test_a_usbl_on_the_ship_is_the_vehicle_s_usbl() -> None:
    usbl = topic("/ship/usbl", "geometry_msgs/msg/PointStamped", ("header.stamp", "point.x", "point.y", "point.z"))

    assert taken(choose_roles(LOG, [DVL, usbl], {}, {})) == {"dvl": DVL.name, "usbl": "/ship/usbl"}


@given(first=st.integers(1, 9), second=st.integers(1, 9), other=st.sampled_from(["TwistStamped", "String"]))
@settings(max_examples=10, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_of_a_topic_whose_type_changes_one_is_read_and_the_other_counted(
    tmp_path: Path, first: int, second: int, other: str
) -> None:
    times = [T0 + k * SECOND for k in range(first + second)]
    covariance = {"twist.twist.linear.x": 1.0, "twist.twist.linear.y": 0.5}
    changed: list[Row] = [(t, "/dvl", TWIST_COVARIANCE, {"header.stamp": t, **covariance}) for t in times[first:]]
    before: list[Row] = [(t, "/dvl", "std_msgs/msg/String", {"data": "x"}) for t in times[:first]]
    before = before if other == "String" else [twist(t, 1.0, 0.5) for t in times[:first]]
    file = write_mcap(tmp_path / "a.mcap", [*before, *changed, *(yaw(t, 0.0) for t in times)])

    for request in (Request(), Request(topics={"dvl": "/dvl"})):
        log = read_log(file, request)
        (said,) = [finding for finding in log.findings if finding.code == "TOPIC-TYPES"]

        read = second if other == "String" else max(first, second)
        assert log.provenance["dvl"].used == read
        assert said.lost_data
        assert f" {read} messages of type " in said.text
        assert f", {first + second - read} messages of type " in said.text
