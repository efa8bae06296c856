"""Message types of Doppler velocity logs, and what makes a record of theirs invalid.

Sources: the .msg files of the ROS packages named, and the drivers that fill them.
"""

import numpy as np

from usbldr.filters.types import Vector
from usbldr.io.messages import Layout, Mask, Raw, own, xyz

FRD = {"axes": "FRD"}
TWIST = xyz("twist.twist.linear")

DVL = (
    Layout(
        "dvl",  # marine_acoustic_msgs/Dvl: x forward, z where the DVL points; a covariance of -1 is only unknown
        xyz("velocity") | {"covariance": "velocity_covar.0", "good_beams": "num_good_beams"},
        {"mode": "velocity_mode", "beams_valid": "beam_velocities_valid"},
        "by type",
        FRD,
    ),
    Layout(
        "dvl",  # Water Linked's and dvl_msgs/DVL, with and without covariance
        xyz("velocity") | {"velocity_valid": "velocity_valid"},
        {
            "covariance": "covariance.0",
            "sd": "fom",
            "validity_us": "time_of_validity",
            "transmission_us": "time_of_transmission",
        },
        "by type",
        FRD,
    ),
    Layout("twistwithcovariancestamped", TWIST, {"own_covariance": "twist.covariance.0"}),
    Layout("odometry", TWIST, {"own_covariance": "twist.covariance.0"}),
    Layout("twiststamped", xyz("twist.linear")),
    Layout(
        "dvl",
        {"x": "starboard_mps", "y": "forward_mps"},
        {"z": "up_mps", "sd": "sd_mps", "velocity_valid": "valid"},
        "by type",
        fixed={"axes": "SFU", "unit": "m/s"},
    ),
    Layout("dvl", own("x", "y"), {"z": "z", "sd": "sd_mps", "velocity_valid": "valid"}, "by type"),
)


def dvl_causes(raw: Raw, speed_mps: Vector, least_beams: int | None) -> dict[str, Mask]:
    """Return by cause which DVL records (n,) are invalid, by what their family of messages says.

    ``speed_mps`` = |v|; ``least_beams`` None: three where any record tells its good beams at all.
    """
    x, y, z = (raw.number(axis) for axis in "xyz")
    causes = {"not a number": ~(np.isfinite(x) & np.isfinite(y))}
    if "velocity_valid" in raw.values:
        causes["flagged invalid"] = raw.number("velocity_valid") == 0
    else:
        causes["exactly zero"] = (x == 0) & (y == 0) & ((z == 0) | np.isnan(z))
    beams = raw.number("good_beams")
    if least_beams is not None or np.any(beams > 0):
        least = 3 if least_beams is None else least_beams
        causes[f"fewer than {least} good beams"] = beams < least
    causes["water track"] = raw.number("mode") == 2
    beams_valid = raw.number("beams_valid")
    if np.any(beams_valid == 1):
        causes["beam velocities flagged invalid"] = beams_valid == 0
    causes["negative covariance"] = raw.number("own_covariance") < 0
    causes["faster than 20 m/s"] = speed_mps > 20.0
    return causes
