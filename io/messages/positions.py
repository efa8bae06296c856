"""Message types of positions, of any sensor: local ones, latitudes and longitudes, usbldr's own columns."""

from usbldr.io.messages.layouts import MessageLayout, own_columns, plane_covariance, xyz

POSE_COVARIANCE = plane_covariance("pose.covariance", 0, 1, 7)
NAVSAT = {"lat_deg": "latitude", "lon_deg": "longitude"}
COVARIANCE = plane_covariance("position_covariance", 0, 1, 4) | {"covariance_type": "position_covariance_type"}
NAVSAT_MORE = COVARIANCE | {"status": "status.status"}
LATLON = {"frame": "latlon"}

ORIENTATION = {f"q{axis}": f"pose.orientation.{axis}" for axis in "xyzw"}
POSE = {key: f"pose.{path}" for key, path in ORIENTATION.items()} | POSE_COVARIANCE
TWIST = {"vx": "twist.twist.linear.x", "vy": "twist.twist.linear.y"}

PLACES = (
    MessageLayout("pointstamped", xyz("point")),
    MessageLayout("posestamped", xyz("pose.position"), ORIENTATION),
    MessageLayout("posewithcovariancestamped", xyz("pose.pose.position"), POSE),
    MessageLayout("odometry", xyz("pose.pose.position"), POSE | TWIST),
    *(
        MessageLayout(kind, xyz(place), stamp="timestamp", frame="frame_id")
        for kind, place in (("poseinframe", "pose.position"), ("point3inframe", "point"))  # foxglove
    ),
)
"""Local positions."""

OWN_ENU, OWN_LATLON = {"kind": "position", "frame": "ENU"}, {"kind": "latlon", "frame": "latlon"}
OWN_COVARIANCE = own_columns("sd_m", "cov_ee_m2", "cov_en_m2", "cov_nn_m2")


def own_places(sensor: str) -> tuple[MessageLayout, MessageLayout]:
    """Return the layouts of usbldr's CSV for positions: east and north come before latitude and longitude."""
    geodetic = own_columns("lat_deg", "lon_deg")
    return (
        MessageLayout(sensor, own_columns("east_m", "north_m"), geodetic | OWN_COVARIANCE, "by type", fixed=OWN_ENU),
        MessageLayout(sensor, geodetic, OWN_COVARIANCE, "by type", fixed=OWN_LATLON),
    )
