"""Messages of ArduPilot and other autopilots: MAVLink, as BlueOS and ground stations record it, and DataFlash logs.

Sources: common.xml and ardupilotmega.xml of MAVLink, ArduPilot's log structures, and the recorder of BlueOS. An
autopilot's own estimate contains the fixes that it was given: it is used only if it is named. GPS_RAW_INT holds what
the autopilot takes for its GPS: with an acoustic system that sends GPS_INPUT, its fixes.
"""

from dataclasses import replace

from usbldr.io.messages.layouts import MessageLayout, only_when_named

FRD = {"axes": "FRD"}
RADIANS, DEGREES = ({"convention": "compass", "unit": unit} for unit in ("rad", "deg"))
LATLON = {"frame": "latlon"}
PLACE, DEG_E7 = {"lat_deg": "message.lat", "lon_deg": "message.lon"}, {"lat_deg": 1e-7, "lon_deg": 1e-7}
FIX_TYPE = {"fix_type": "message.fix_type", "fix_name": "message.fix_type.type"}  # a number, or BlueOS's name of it
DATAFLASH_PLACE = {"lat_deg": "Lat", "lon_deg": "Lng"}

MAVLINK_DVL = (
    MessageLayout(  # the extension of BlueOS for Water Linked's DVLs sends these: distances along the vehicle's axes
        "vision_position_delta",
        {axis: f"message.position_delta.{k}" for k, axis in enumerate("xyz")}
        | {"interval_us": "message.time_delta_usec"},
        {"confidence": "message.confidence"},
        "by type",
        FRD,
    ),
    MessageLayout(
        "viso",  # the same, as the autopilot logs it
        {axis: f"PosD{axis.upper()}" for axis in "xyz"} | {"interval_us": "dt"},
        {"confidence": "conf"},
        "by type",
        FRD,
    ),
    *(
        MessageLayout(
            kind,
            {},
            recognised="by type",
            unsupported="holds velocities in earth axes; let the DVL send VISION_POSITION_DELTA",
        )
        for kind in ("vision_speed_estimate", "visv")
    ),
)

MAVLINK_COMPASS = (
    MessageLayout("attitude", {"angle": "message.yaw"}, recognised="by type", defaults=RADIANS),
    MessageLayout("att", {"angle": "Yaw"}, recognised="by type", defaults=DEGREES),
    *only_when_named(
        (
            MessageLayout("ahrs2", {"angle": "message.yaw"}, defaults=RADIANS),
            MessageLayout("ahr2", {"angle": "Yaw"}, defaults=DEGREES),
            MessageLayout("vfr_hud", {"angle": "message.heading"}, defaults=DEGREES),
            MessageLayout(
                "global_position_int",
                {"angle": "message.hdg"},
                defaults=DEGREES,
                scale={"angle": 0.01},
                no_data_values={"angle": (65535.0,)},
            ),
        )
    ),
)

RECEIVER = MessageLayout(
    "gps_raw_int",
    PLACE,
    FIX_TYPE | {"sd_m": "message.h_acc"},
    "by type",
    LATLON,
    scale=DEG_E7 | {"sd_m": 1e-3},
    no_data_values={"sd_m": (0.0,)},
)
INPUT = MessageLayout("gps_input", PLACE, FIX_TYPE | {"sd_m": "message.horiz_accuracy"}, defaults=LATLON, scale=DEG_E7)
DATAFLASH_RECEIVER = MessageLayout("gps", DATAFLASH_PLACE, {"fix_type": "Status"}, "by type", LATLON)
MAVLINK_GPS = (
    RECEIVER,
    DATAFLASH_RECEIVER,
    *only_when_named(
        (
            INPUT,
            MessageLayout("gps2_raw", PLACE, FIX_TYPE, defaults=LATLON, scale=DEG_E7),
            MessageLayout("global_position_int", PLACE, defaults=LATLON, scale=DEG_E7),
            MessageLayout("pos", DATAFLASH_PLACE, defaults=LATLON),
        )
    ),
)
MAVLINK_TRUTH = only_when_named(MAVLINK_GPS)
MAVLINK_USBL = tuple(
    replace(layout, recognised="only when named", defaults={"kind": "latlon"})
    for layout in (INPUT, RECEIVER, DATAFLASH_RECEIVER)
)

MAVLINK_DEPTH = (
    MessageLayout(  # ArduSub: the sensor in the water; SCALED_PRESSURE is the one in the housing
        "scaled_pressure2", {"pressure": "message.press_abs"}, recognised="by type", defaults={"unit": "hPa"}
    ),
    MessageLayout(  # ArduSub: likewise the second one
        "baro", {"pressure": "Press"}, recognised="by type", defaults={"unit": "Pa"}, topic=r"\[1\]$", preference=0
    ),
    MessageLayout("baro", {"pressure": "Press"}, recognised="by type", defaults={"unit": "Pa"}, preference=1),
    *only_when_named(
        (
            *(
                MessageLayout(kind, {"pressure": "message.press_abs"}, defaults={"unit": "hPa"})
                for kind in ("scaled_pressure", "scaled_pressure3")
            ),
            MessageLayout("vfr_hud", {"depth": "message.alt"}, defaults={"unit": "m", "positive": "up"}),
        )
    ),
)
