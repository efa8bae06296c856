"""Message types of satellite receivers, and of other references.

Sources: the .msg, .proto and .json files of the packages named. None states whether the antenna is the ship's or the
vehicle's.
"""

from usbldr.io.messages.layouts import MessageLayout, only_when_named, own_columns
from usbldr.io.messages.positions import COVARIANCE, LATLON, NAVSAT, NAVSAT_MORE, PLACES, own_places
from usbldr.io.units import DEG_PER_RAD

IN_RADIANS = {"lat_deg": DEG_PER_RAD, "lon_deg": DEG_PER_RAD}
SBF_NO_DATA = {"lat_deg": (-2e10,), "lon_deg": (-2e10,)}  # fixed: Septentrio's "do not use"

OWN_NAVIGATION = (
    MessageLayout(  # Nortek Nucleus (NortekSupport/nucleus_driver: interfaces/INS)
        "ins", NAVSAT | {"valid": "lat_long_is_valid"}, {}, defaults=LATLON, stamp="system_timestamp"
    ),
    MessageLayout("ins", NAVSAT | {"sd_m": "posUncertainty"}, {}, defaults=LATLON),  # vectornav (ROS 1)
    MessageLayout("sbgekfnav", NAVSAT | {"valid": "status.position_valid"}, {}, defaults=LATLON),  # sbg_driver
    MessageLayout(  # septentrio_gnss_driver
        "insnavgeod",
        NAVSAT | {"error": "error"},
        {"sd_north_m": "latitude_std_dev", "sd_east_m": "longitude_std_dev"},
        defaults=LATLON,
        scale=IN_RADIANS,
        no_data_values=SBF_NO_DATA,
    ),
    MessageLayout(  # vectornav_msgs: mode 0 is not tracking
        "insgroup",
        {"lat_deg": "poslla.x", "lon_deg": "poslla.y", "quality": "insstatus.mode"},
        {"sd_m": "posu"},
        defaults=LATLON,
    ),
    MessageLayout(
        "commongroup",
        {"lat_deg": "position.x", "lon_deg": "position.y", "quality": "insstatus.mode"},
        {},
        defaults=LATLON,
    ),
)
"""Positions of an instrument's own navigation, which may use the fixes."""

GEODETIC = (  # a receiver's own messages rank after the NavSatFix that its driver makes of them
    MessageLayout("navsatfix", NAVSAT, NAVSAT_MORE, "by type", LATLON, preference=0),
    MessageLayout(
        "gpsfix",  # gps_common, gps_msgs: error estimates of 95 %
        NAVSAT | {"error_95_m": "err_horz"},
        NAVSAT_MORE,
        "by type",
        LATLON,
        no_data_values={"error_95_m": (0.0,)},
    ),
    MessageLayout(
        "gpsraw",  # mavros_msgs: 1e-7 degrees and millimetres; the same fixes come as NavSatFix on global_position/raw
        {"lat_deg": "lat", "lon_deg": "lon", "fix_type": "fix_type"},
        {"sd_m": "h_acc"},
        "only when named",
        LATLON,
        scale={"lat_deg": 1e-7, "lon_deg": 1e-7, "sd_m": 1e-3},
        no_data_values={"sd_m": (0.0,)},
    ),
    MessageLayout(
        "gpgga",  # nmea_msgs: degrees, or degrees and minutes (ddmm.mmmm), depending on the driver
        {"lat_deg": "lat", "lon_deg": "lon", "lat_side": "lat_dir", "lon_side": "lon_dir", "gga_quality": "gps_qual"},
        {},
        "by type",
        LATLON,
    ),
    MessageLayout(
        "gpsdata",  # cola2_msgs
        NAVSAT | {"gga_quality": "fix_quality"},
        {"sd_north_m": "latitude_stdev", "sd_east_m": "longitude_stdev"},
        "by type",
        LATLON,
    ),
    MessageLayout(
        "ubloxnav",  # ds_sensor_msgs
        NAVSAT | {"sd_m": "accuracy_horz"},
        {"fix_name": "fixtype"},
        "by type",
        LATLON,
    ),
    MessageLayout(
        "locationfix",  # foxglove, in ROS, protobuf or JSON: no status at all
        NAVSAT,
        COVARIANCE,
        "by type",
        LATLON,
        stamp="timestamp",
        frame="frame_id",
    ),
    MessageLayout(
        "locationfixes",  # foxglove: the first of each
        {"lat_deg": "fixes.0.latitude", "lon_deg": "fixes.0.longitude"},
        {},
        "by type",
        LATLON,
        stamp="fixes.0.timestamp",
        frame="fixes.0.frame_id",
    ),
    MessageLayout("latlonstamped", NAVSAT, {}, "by type", LATLON),  # smarc_msgs
    *(  # ublox_msgs: 1e-7 degrees and millimetres, without header
        MessageLayout(
            kind,
            {"lat_deg": "lat", "lon_deg": "lon", "ubx_fix_type": "fixType", "ubx_flags": "flags"},
            {"sd_m": "hAcc"},
            "by type",
            LATLON,
            scale={"lat_deg": 1e-7, "lon_deg": 1e-7, "sd_m": 1e-3},
            preference=1,
        )
        for kind in ("navpvt", "navpvt7")
    ),
    MessageLayout(  # sbg_driver: type 0 is no solution, status 0 a computed one
        "sbggpspos",
        NAVSAT | {"quality": "status.type", "error": "status.status"},
        {"sd_east_m": "position_accuracy.x", "sd_north_m": "position_accuracy.y"},
        "by type",
        LATLON,
        preference=1,
    ),
    MessageLayout(  # septentrio_gnss_driver: mode 0 is no solution
        "pvtgeodetic",
        NAVSAT | {"quality": "mode", "error": "error"},
        {},
        "by type",
        LATLON,
        scale=IN_RADIANS,
        no_data_values=SBF_NO_DATA,
        preference=1,
    ),
    MessageLayout(  # vectornav_msgs: fix 0 is none, 1 the time alone
        "gpsgroup",
        {"lat_deg": "poslla.x", "lon_deg": "poslla.y", "fix_type": "fix"},
        {"sd_north_m": "posu.x", "sd_east_m": "posu.y"},
        "by type",
        LATLON,
        preference=1,
    ),
    *only_when_named(OWN_NAVIGATION),
    *(
        MessageLayout(kind, {"lat_deg": f"{place}.latitude", "lon_deg": f"{place}.longitude"}, defaults=LATLON)
        for kind, place in (
            ("geopointstamped", "position"),  # geographic_msgs
            ("geopointstamped", "geo_point"),
            ("geoposestamped", "pose.position"),
        )
    ),
)
"""Latitudes and longitudes."""

GPS = (
    *GEODETIC,
    *only_when_named(PLACES),
    *own_places("gps"),
    MessageLayout("gps", own_columns("x", "y"), own_columns("sd_m"), "by type"),
)

TRUTH = (*only_when_named((*GEODETIC, *PLACES)), *own_places("gps"), *own_places("truth"))
