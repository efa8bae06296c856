"""Message types of heading sensors.

Sources: the .msg files of the ROS packages named; REP 103 and REP 145.
"""

from usbldr.io.messages import ORIENTATION, Layout, only_when_named, orientation, own

ENU = {"convention": "ENU"}

COMPASS = (
    Layout(
        "imu",
        ORIENTATION,
        {"own_covariance": "orientation_covariance.0", "yaw_variance": "orientation_covariance.8"},
        "by type",
        ENU,
    ),
    Layout("float64", {"angle": "data"}, defaults={"convention": "compass"}),
    Layout("float32", {"angle": "data"}, defaults={"convention": "compass"}),
    *only_when_named(
        (
            Layout("posestamped", orientation("pose"), defaults=ENU),
            Layout("posewithcovariancestamped", orientation("pose.pose"), defaults=ENU),
            Layout("odometry", orientation("pose.pose"), defaults=ENU),
        )
    ),
    Layout(
        "compass",
        {"angle": "heading_deg"},
        own("sd_deg"),
        "by type",
        fixed={"convention": "compass", "unit": "deg"},
    ),
    Layout("compass", {"angle": "heading"}, own("sd_deg"), "by type", {"convention": "compass"}),
)
