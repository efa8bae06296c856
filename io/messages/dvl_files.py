"""What the files of Doppler logs themselves hold: PD0, PD4, PD5, PD6, and the JSON lines of Water Linked's devices.

Sources: the manuals named in the readers (io/formats/pd0_log.py, pd45_log.py, pd6_log.py, json_lines_log.py).
"""

from collections.abc import Mapping

from usbldr.io.messages.layouts import MessageLayout, Recognised, own_columns

COMPASS_DEG = {"convention": "compass", "unit": "deg"}
DOWN = {"unit": "m", "positive": "down"}
LATLON = {"frame": "latlon"}
PLACE = {"lat_deg": "latitude", "lon_deg": "longitude"}
MILLIMETRES = dict.fromkeys("xyz", 0.001)
NO_VELOCITY = dict.fromkeys("xyz", (-32768.0, 32768.0))
EARTH = "holds velocities in earth axes; record instrument or ship coordinates"
REPORT = {"x": "vx", "y": "vy", "z": "vz", "velocity_valid": "velocity_valid"}
REPORT_MORE = {"sd": "fom", "validity_us": "time_of_validity", "transmission_us": "time_of_transmission"}
WATER_LINKED: Mapping[str, Recognised] = {
    "waterlinked_velocity": "by type",
    "waterlinked_velocity_water": "only when named",
}

FILES_DVL = (
    MessageLayout(  # the bottom's motion along starboard, forward, up: every sign is reversed
        "pd0_bottom_track", own_columns("x", "y", "z"), own_columns("coordinates"), "by type", {"axes": "PBD"}
    ),
    MessageLayout(  # the instrument's motion along starboard, forward, up
        "pd45_bottom_track", own_columns("x", "y", "z"), own_columns("coordinates"), "by type", {"axes": "SFU"}
    ),
    MessageLayout(  # a ship's axes, which PD6 defines: to starboard, forward, away from the bottom
        "pd6_bs",
        own_columns("x", "y", "z", "status"),
        recognised="by type",
        defaults={"axes": "SFU"},
        scale=MILLIMETRES,
        no_data_values=NO_VELOCITY,
    ),
    MessageLayout(  # an instrument's axes: forward, starboard, down in Water Linked's
        "pd6_bi",
        own_columns("x", "y", "z", "status"),
        recognised="only when named",
        defaults={"axes": "FRD"},
        scale=MILLIMETRES,
        no_data_values=NO_VELOCITY,
    ),
    MessageLayout("pd6_be", {}, recognised="only when named", unsupported=EARTH),
    *(
        MessageLayout(kind, REPORT, REPORT_MORE, how, {"axes": "FRD"}, stamp="time_of_transmission", stamp_unit_ns=1000)
        for kind, how in WATER_LINKED.items()
    ),
)
FILES_COMPASS = (
    *(
        MessageLayout(kind, {"angle": "heading_deg"}, recognised="by type", defaults=COMPASS_DEG)
        for kind in ("pd0_heading", "pd45_heading", "pd6_sa")
    ),
    MessageLayout(
        "waterlinked_position_local",
        {"angle": "yaw"},
        recognised="only when named",
        unsupported="holds a yaw that counts from where dead reckoning began, not from north",
    ),
)
FILES_GPS = (
    MessageLayout("pd0_gga", PLACE, {"gga_quality": "quality"}, "by type", LATLON),
    MessageLayout("pd0_navigation", PLACE, own_columns("valid"), "by type", LATLON),
)
FILES_DEPTH = tuple(
    MessageLayout(kind, {"depth": "depth_m"}, recognised="by type", defaults=DOWN)
    for kind in ("pd0_depth", "pd45_depth", "pd6_ts")
)
FILES_USBL = (
    MessageLayout(
        "waterlinked_global",
        {"lat_deg": "lat", "lon_deg": "lon"},
        recognised="only when named",  # the locator's, or that of the topside box
        defaults={"kind": "latlon"},
    ),
    MessageLayout(
        "waterlinked_position_local",
        {"x": "x"},
        recognised="only when named",
        unsupported="holds dead reckoning, not fixes",
    ),
    MessageLayout(
        "waterlinked_acoustic",
        {"x": "x"},
        recognised="by type",
        unsupported="is measured along the axes of the topside box; log the global position",
    ),
)
