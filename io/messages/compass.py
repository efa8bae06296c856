"""Message types of heading sensors.

Sources: the .msg files of the ROS packages named; REP 103 (yaw is counter-clockwise from east, x forward) and REP 145.
An estimate by the vehicle's own navigation is not a sensor and is used only if the user names it.
"""

from usbldr.io.messages.layouts import MessageLayout, only_when_named, own_columns, quaternion

ENU, NED = {"convention": "ENU"}, {"convention": "NED"}
COMPASS_RAD, COMPASS_DEG = ({"convention": "compass", "unit": unit} for unit in ("rad", "deg"))
ENU_DEG = {"convention": "ENU", "unit": "deg"}
PER_RECORD = "as each record says"  # in place of a convention or a unit
BY_RANGE = "by range"  # in place of a unit: the largest value decides
COURSE = "holds the course over ground, not a heading"
NO_DATA = (-9999.0,)  # fixed: ds_sensor_msgs

ESTIMATES = (
    MessageLayout("posestamped", quaternion("pose.orientation"), defaults=ENU),
    MessageLayout("posewithcovariancestamped", quaternion("pose.pose.orientation"), defaults=ENU),
    MessageLayout("odometry", quaternion("pose.pose.orientation"), defaults=ENU),
    MessageLayout("latlonodometry", quaternion("lat_lon_pose.orientation"), defaults=ENU),  # smarc_msgs
    MessageLayout("navsts", {"angle": "orientation.yaw"}, defaults=COMPASS_RAD),  # cola2_msgs, auv_msgs
    MessageLayout("navigationstatus", {"angle": "orientation.z"}, defaults=COMPASS_RAD),  # auv_msgs
)
OWN_NAVIGATION = (
    MessageLayout(
        "ins", {"angle": "heading", "place_valid": "lat_long_is_valid"}, defaults=COMPASS_DEG, stamp="system_timestamp"
    ),  # Nortek Nucleus
    MessageLayout("ins", {"angle": "yaw", "status": "insStatus"}, defaults=COMPASS_DEG),  # vectornav (ROS 1)
    MessageLayout(  # sbg_driver: its driver turns it if use_enu is set
        "sbgekfeuler", {"angle": "angle.z", "valid": "status.heading_valid"}, defaults={"unit": "rad"}
    ),
    MessageLayout("sbgekfquat", quaternion("quaternion") | {"valid": "status.heading_valid"}),
    MessageLayout("insnavgeod", {"angle": "heading", "error": "error"}, defaults=ENU_DEG),  # septentrio_gnss_driver
    MessageLayout("vfrhud", {"angle": "heading"}, defaults=COMPASS_DEG),  # mavros_msgs: whole degrees
)
"""Headings of an instrument's own navigation, which may use the fixes."""
BESIDE_POSITIONS = (
    MessageLayout(
        "locationfix",  # foxglove: absent, or NaN in ROS, if there is none
        {"angle": "heading"},
        {"variance_rad2": "heading_variance"},
        defaults=COMPASS_RAD,
        stamp="timestamp",
        frame="frame_id",
    ),
    MessageLayout(
        "gpsdata", {"angle": "heading"}, defaults=COMPASS_DEG, no_data_values={"angle": (0.0,)}
    ),  # cola2_msgs, by HDT
    MessageLayout(
        "gpsraw",  # mavros_msgs: hundredths of a degree, north is 36000; 0 and 65535: not provided
        {"angle": "yaw"},
        defaults=COMPASS_DEG,
        scale={"angle": 0.01},
        no_data_values={"angle": (0.0, 65535.0)},
    ),
    MessageLayout("gpsfix", {"angle": "track"}, unsupported=COURSE),  # gps_msgs
    *(MessageLayout(kind, {"angle": "heading"}, unsupported=COURSE) for kind in ("navpvt", "navpvt7")),  # ublox_msgs
    MessageLayout(
        "sbgimudata", {"rate": "gyro.z"}, unsupported="holds no orientation; use SbgEkfEuler or SbgEkfQuat"
    ),  # sbg_driver
    MessageLayout(
        "vector3stamped", {"angle": "vector.z"}, defaults={"unit": BY_RANGE}
    ),  # roll, pitch, yaw by the vendor's own convention
    MessageLayout("magneticfield", {"field_x": "magnetic_field.x", "field_y": "magnetic_field.y"}, defaults=ENU),
)

COMPASS = (
    MessageLayout(
        "imu",
        quaternion("orientation"),
        {"own_covariance": "orientation_covariance.0", "variance_rad2": "orientation_covariance.8"},
        "by type",
        ENU,
        preference=1,
    ),
    MessageLayout(
        "azimuth",  # compass_msgs, compass_interfaces: each record states its unit, its sense and its north
        {"angle": "azimuth", "unit_code": "unit", "sense_code": "orientation", "north_code": "reference"},
        {"variance": "variance"},
        "by type",
        {"convention": PER_RECORD, "unit": PER_RECORD},
    ),
    MessageLayout(
        "compass",  # ds_sensor_msgs
        {"angle": "heading", "is_true": "is_true_heading"},
        {"variance_deg2": "heading_covar"},
        "by type",
        COMPASS_DEG,
        no_data_values={"angle": NO_DATA},
    ),
    MessageLayout(
        "gyro",  # ds_sensor_msgs: "+ turns to left", with a quaternion beside it
        {"angle": "heading", "variance_deg2": "heading_covar", "qw": "orientation.w"},
        {},
        "by type",
        {"convention": "ENU", "unit": "deg"},
        no_data_values={"angle": NO_DATA},
    ),
    MessageLayout("gyro", {"angle": "heading"}, {}, "by type", COMPASS_DEG),  # before 2019: "+ turns to stbd"
    MessageLayout(  # Nortek Nucleus (NortekSupport/nucleus_driver: interfaces/AHRS)
        "ahrs",
        {"angle": "heading", "declination": "declination"},
        {},
        "by type",
        COMPASS_DEG,
        stamp="system_timestamp",
        preference=2,
    ),
    MessageLayout(  # septentrio_gnss_driver: turned by it unless use_ros_axis_orientation is false
        "atteuler",
        {"angle": "heading", "error": "error"},
        {},
        "by type",
        ENU_DEG,
        no_data_values={"angle": (-2e10,)},
        preference=2,
    ),
    MessageLayout(  # vectornav_msgs: clockwise from north, as the instrument sends it
        "commongroup", {"angle": "yawpitchroll.x"}, {}, "by type", COMPASS_DEG, preference=2
    ),
    *only_when_named(OWN_NAVIGATION),
    MessageLayout("ins", {"angle": "heading"}, {}, "by type", COMPASS_DEG),  # ds_sensor_msgs; its quaternion is ENU
    MessageLayout(
        "quaternionstamped", quaternion("quaternion"), defaults=NED
    ),  # nmea_navsat_driver, from HDT as it comes
    MessageLayout(  # mavros: the sense of an autopilot's heading is known
        "float64", {"angle": "data"}, defaults={"convention": "compass"}, topic=r"compass_hdg$", preference=0
    ),
    MessageLayout("float64", {"angle": "data"}, defaults={"convention": "compass"}),
    MessageLayout("float32", {"angle": "data"}, defaults={"convention": "compass"}),
    *only_when_named((*ESTIMATES, *BESIDE_POSITIONS)),
    MessageLayout(
        "compass",
        {"angle": "heading_deg"},
        own_columns("sd_deg"),
        "by type",
        fixed={"convention": "compass", "unit": "deg"},
    ),
    MessageLayout("compass", {"angle": "heading"}, own_columns("sd_deg"), "by type", {"convention": "compass"}),
    MessageLayout("compass", own_columns("qx", "qy", "qz", "qw"), own_columns("sd_deg"), "by type", ENU),
)
