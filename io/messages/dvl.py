"""Message types of Doppler velocity logs, and what makes their records invalid.

Sources: the .msg files of the ROS packages named, and the drivers that fill them. Water Linked's axes are x forward, y
starboard, z down (docs/dvl/axes.md of waterlinked/docs), and every ROS driver copies them, whatever its frame_id is.
"""

import numpy as np

from usbldr.filters.types import Mask, Vector
from usbldr.io.messages.layouts import MessageLayout, RawRecords, own_columns, xyz
from usbldr.io.units import MPS_PER_UNIT

FRD = {"axes": "FRD"}
TWIST = xyz("twist.twist.linear")
TWIST_COVARIANCE = {"own_covariance": "twist.covariance.0"}
SIMULATED = xyz("velocity") | {"own_covariance": "velocity_covariance.0"}  # uuv_simulator: 0 unknown, -1 invalid
NORTEK_NONE = (-32.768, float(np.float32(-32.768)))  # fixed: of a velocity, in double and in single precision
NORTEK_NO_DATA = dict.fromkeys("xyz", NORTEK_NONE) | {"sd": (10.0,)}
AGES = {"validity_us": "time_of_validity", "transmission_us": "time_of_transmission"}

DVL = (  # a driver's messages rank before twists made from them, those with a validity flag before those without
    MessageLayout(
        "dvl",  # ds_sensor_msgs/Dvl (WHOI): in the coordinates that each record names
        xyz("velocity") | {"covariance": "velocity_covar.0", "coordinates": "coordinate_mode"},
        {"mode": "velocity_mode", "good_beams": "num_good_beams"},
        "by type",
        preference=1,
    ),
    MessageLayout(
        "dvl",  # marine_acoustic_msgs/Dvl: x forward, z where the DVL points; a covariance of -1 means unknown
        xyz("velocity") | {"covariance": "velocity_covar.0", "good_beams": "num_good_beams"},
        {"mode": "velocity_mode", "beams_valid": "beam_velocities_valid", "sound_speed": "sound_speed"},
        "by type",
        FRD,
        preference=1,
    ),
    MessageLayout(
        "dvl",  # Water Linked's and dvl_msgs/DVL, with and without covariance
        xyz("velocity") | {"velocity_valid": "velocity_valid"},
        {"covariance": "covariance.0", "sd": "fom", **AGES},
        "by type",
        FRD,
        preference=0,
    ),
    MessageLayout(
        "transducerreportstamped",  # waterlinked_dvl (ROS 1): the same report, one level down
        {axis: f"report.v{axis}" for axis in "xyz"} | {"velocity_valid": "report.velocity_valid"},
        {"covariance": "report.covariance.0", "sd": "report.fom"}
        | {"validity_ns": "report.time_of_validity", "transmission_ns": "report.time_of_transmission"},
        "by type",
        FRD,
        preference=0,
    ),
    MessageLayout(
        "dvl", SIMULATED, {}, "by type", FRD, packages=("cola2", "stonefish", "smarc"), preference=2
    ),  # bodies are FRD
    MessageLayout(
        "dvl", SIMULATED, {"mode": "velocity_reference"}, "by type", preference=2
    ),  # uuv_sensor(_ros_plugins)_msgs
    MessageLayout("dvl", xyz("velocity") | {"sd": "figureOfMerit"}, {}, "by type"),  # nortek_dvl/Dvl
    MessageLayout(  # Nortek Nucleus (NortekSupport/nucleus_driver: interfaces/BottomTrack; its app sends it on as FRD)
        "bottomtrack",
        {axis: f"velocity_{axis}" for axis in "xyz"}
        | {"velocity_valid": "x_velocity_valid", "y_valid": "y_velocity_valid"},
        {"sd": "fom_x", "sound_speed": "sound_speed"},
        "by type",
        FRD,
        stamp="system_timestamp",
        no_data_values=NORTEK_NO_DATA,
        preference=0,
    ),
    MessageLayout(
        "watertrack",  # Nortek Nucleus
        {"x": "velocity_x"},
        recognised="only when named",
        unsupported='holds velocities through the water; name its fields by columns and state track = "water"',
    ),
    MessageLayout(  # Nortek DVL500 and DVL1000 (GSO-soslab: ds_sensor_msgs, nortek_dvl_ethernet): z where it points
        "nortekdf21",
        {"x": "velX", "y": "velY", "z": "velZ1", "velocity_valid": "status.xVelValid", "y_valid": "status.yVelValid"},
        {"sd": "fomX", "good_beams": "good_beams", "sound_speed": "speed_sound"},
        "by type",
        FRD,
        no_data_values=NORTEK_NO_DATA,
        preference=2,
    ),
    MessageLayout(
        "linkquestdvl",  # cola2_msgs: the bottom's motion past the instrument, so every sign is reversed
        {"x": "velocityInst.0", "y": "velocityInst.1", "z": "velocityInst.2", "velocity_valid": "velocityInstFlag"},
        {},
        "by type",
        {"axes": "BPU"},
    ),
    MessageLayout(
        "teledyneexplorerdvl",  # cola2_msgs: bottom track in instrument axes
        {"x": "bi_x_axis", "y": "bi_y_axis", "z": "bi_z_axis", "status": "bi_status"},
        {},
        "by type",
        FRD,
    ),
    *(  # mavros: what was sent to the autopilot
        MessageLayout(
            kind,
            {},
            recognised="only when named",
            topic=r"vision_speed",
            unsupported="holds velocities in earth axes; record them in instrument axes",
        )
        for kind in ("twiststamped", "twistwithcovariancestamped", "vector3stamped")
    ),
    MessageLayout("twistwithcovariancestamped", TWIST, TWIST_COVARIANCE, preference=3),
    MessageLayout("odometry", TWIST, TWIST_COVARIANCE, frame="child_frame_id", preference=4),
    MessageLayout("twiststamped", xyz("twist.linear"), preference=3),
    MessageLayout(
        "dvl",
        {"x": "starboard_mps", "y": "forward_mps"},
        {"z": "up_mps", "sd_mps": "sd_mps", "velocity_valid": "valid"},
        "by type",
        fixed={"axes": "SFU", "unit": "m/s"},
    ),
    MessageLayout(  # columns whose names state their units
        "dvl",
        {"x": "x_mps", "y": "y_mps"},
        {"z": "z_mps", "sd_mps": "sd_mps"},
        "by type",
        fixed={"unit": "m/s"},
    ),
    MessageLayout("dvl", own_columns("x", "y"), own_columns("z", "sd_mps") | {"velocity_valid": "valid"}, "by type"),
    MessageLayout(
        "bottomtrack",  # nortek_dvl333_msgs
        {"beam": "vel_beam0"},
        unsupported="holds only velocities along the beams; record XYZ velocities",
    ),
    MessageLayout(
        "dvlsensorrange", {"range": "range"}, unsupported="holds ranges, not velocities"
    ),  # holoocean_interfaces
)

BEAM, EARTH = 0, 3  # of coordinate_mode
BOTTOM, WATER = 1, 2  # of velocity_mode and velocity_reference
MAX_SPEED_MPS = 20.0  # [m/s] no vehicle with a DVL, and no ship above it, goes so fast
USUAL_SPEED_MPS = 1.0  # [m/s] of a vehicle, within a factor three, by which units a factor ten apart are told
TOO_FAST = f"faster than {MAX_SPEED_MPS:g} m/s"
NO_COORDINATES = "; velocities along beams or in earth axes cannot be used: record instrument or ship coordinates"


def dvl_causes(
    raw: RawRecords, speed_mps: Vector, least_beams: int | None, through_water: bool = False
) -> dict[str, Mask]:
    """Return by cause which DVL records (n,) are invalid, according to their message type.

    ``speed_mps`` = |v|; ``least_beams`` None: three if any record states its good beams; ``through_water``: bottom
    track is invalid instead of water track.
    """
    x, y, z = (raw.number(axis) for axis in "xyz")
    causes = {"not a number": ~(np.isfinite(x) & np.isfinite(y))}
    if "velocity_valid" in raw.values:
        causes["flagged invalid"] = (raw.number("velocity_valid") == 0) | (raw.number("y_valid") == 0)
    elif "status" in raw.values:
        causes["without status A"] = np.char.upper(raw.text("status")) != "A"
    else:
        causes["exactly zero"] = (x == 0) & (y == 0) & ((z == 0) | np.isnan(z))
    causes["over no interval"] = ~(raw.number("interval_us") > 0) & ("interval_us" in raw.values)
    causes["with a confidence of 0"] = raw.number("confidence") == 0
    causes["in beam coordinates"] = raw.number("coordinates") == BEAM
    causes["in earth coordinates"] = raw.number("coordinates") == EARTH
    beams = raw.number("good_beams")
    if least_beams is not None or np.any(beams > 0):
        least = 3 if least_beams is None else least_beams
        causes[f"fewer than {least} good beams"] = beams < least
    if through_water:
        causes["bottom track"] = raw.number("mode") == BOTTOM
    else:
        causes["water track"] = raw.number("mode") == WATER
    beams_valid = raw.number("beams_valid")
    if np.any(beams_valid == 1):
        causes["beam velocities flagged invalid"] = beams_valid == 0
    causes["negative covariance"] = raw.number("own_covariance") < 0
    causes[TOO_FAST] = speed_mps > MAX_SPEED_MPS
    return causes


def inverse_interval(raw: RawRecords) -> Vector:
    """Return the inverse of the interval in which each distance was travelled, 1/s, (n,); 1 for velocities."""
    if "interval_us" not in raw.values:
        return np.ones(len(raw.received_ns))
    interval_us = raw.number("interval_us")
    return 1e6 / np.where(interval_us > 0, interval_us, np.nan)


def in_millimetres(raw: RawRecords, causes: dict[str, Mask]) -> bool:
    """Return whether too many records for m/s exceed 20 m/s: one in ten of those without another fault.

    One constant velocity does not count; a DVL without bottom lock writes such.
    """
    others = [mask for cause, mask in causes.items() if cause != TOO_FAST]
    known = ~np.any(others, axis=0)
    fast = known & causes[TOO_FAST]
    _, counts = np.unique(np.column_stack([raw.number("x"), raw.number("y")])[fast], axis=0, return_counts=True)
    often = np.sum(fast) >= max(3, 0.1 * np.sum(known))
    return bool(often and counts.max() <= np.sum(fast) / 2)


def usual_unit(speed_mps: Vector) -> str:
    """Return the unit in which too high speeds, (n,), would be those of a vehicle."""
    middle = max(float(np.median(speed_mps)), MAX_SPEED_MPS) if len(speed_mps) else MAX_SPEED_MPS
    return min(MPS_PER_UNIT, key=lambda unit: abs(np.log(middle * MPS_PER_UNIT[unit] / USUAL_SPEED_MPS)))


def dvl_advice(causes: dict[str, Mask], unit: str, columns: str) -> str:
    """Return the advice if no record is valid, as the end of a sentence; empty if there is none.

    ``unit``: the one that would explain too high speeds, empty if it is stated; ``columns``: what to state with it.
    """
    if np.mean(causes.get("water track", 0)) > 0.5:
        return '; to use velocities through the water and to estimate the current, state track = "water" under [dvl]'
    if any(np.any(causes[f"in {where} coordinates"]) for where in ("beam", "earth")):
        return NO_COORDINATES
    fast = np.mean(causes[TOO_FAST]) > 0.5 and unit
    return f'; if they are in {unit}, state {columns}unit = "{unit}" under [dvl]' if fast else ""
