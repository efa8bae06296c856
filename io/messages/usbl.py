"""Message types of acoustic positioning systems.

Sources: the .msg files and drivers of the packages named, the SeaTrac serial interface for its raw integers, and for
sentences the manuals named in nmea_kinds. The north of a modem's own compass may be magnetic: mount_deg in
the configuration corrects it.
"""

import math
from dataclasses import replace

from usbldr.io.decoding.nmea_kinds import ELLIPSE
from usbldr.io.messages.layouts import MessageLayout, own_columns, plane_covariance, xyz
from usbldr.io.messages.positions import NAVSAT, NAVSAT_MORE, OWN_COVARIANCE, PLACES, own_places

LATLON = {"kind": "latlon"}
OF_HEAD = {"kind": "position", "relative_to": "head"}
ENU_OF_HEAD, NED_OF_HEAD = ({**OF_HEAD, "frame": frame} for frame in ("ENU", "NED"))
TARGET = {"target": "target", "status": "fix_status", "sd_m": "sd_m"}
RANGE_BEARING = {"kind": "range_bearing"}
SURER = "log Cartesian coordinates (C) or latitudes and longitudes (R)"
TILTED = "has a frame that is tilted with the instrument; log its head-up, north-up or east-up frame"

BODY_SFD, BODY_FRD = ({**OF_HEAD, "frame": "body", "axes": axes} for axes in ("SFD", "FRD"))

SENTENCES = (
    MessageLayout("psimssb_c_h", own_columns("x", "y"), own_columns("z") | TARGET, "by type", BODY_SFD),
    *(
        MessageLayout(kind, own_columns("x", "y"), own_columns("z") | TARGET, "by type", BODY_FRD)
        for kind in ("ptsax", "pevossb_h")
    ),
    *(
        MessageLayout(kind, own_columns("x", "y"), own_columns("z") | TARGET, "by type", NED_OF_HEAD)
        for kind in ("psimssb_c_n", "pevossb_n")
    ),
    *(
        MessageLayout(kind, own_columns("x", "y"), own_columns("z") | TARGET, "by type", ENU_OF_HEAD)
        for kind in ("psimssb_c_e", "pevossb_e")
    ),
    *(
        MessageLayout(kind, own_columns("lat_deg", "lon_deg"), TARGET, "by type", LATLON)
        for kind in ("psimssb_r", "psimssb_d", "pevossb_g")
    ),
    MessageLayout(
        "rth", own_columns("slant_range_m", "bearing_deg"), own_columns("elevation_deg"), "by type", RANGE_BEARING
    ),
    MessageLayout("tlc", own_columns("lat_deg", "lon_deg"), recognised="by type", defaults=LATLON),
    MessageLayout(
        "ptsag", own_columns("lat_deg", "lon_deg"), own_columns("target") | {"status": "fix_status"}, "by type", LATLON
    ),
    MessageLayout(
        "psonlld",
        own_columns("lat_deg", "lon_deg"),
        own_columns("target", *ELLIPSE) | {"status": "fix_status"},
        "by type",
        LATLON,
    ),
    *(
        MessageLayout(kind, {}, recognised="by type", unsupported=why)
        for kind, why in {
            "psimssb_u": f"holds UTM coordinates without their zone; {SURER}",
            "psimssb_p": f"holds polar coordinates, whose order and units are unknown; {SURER}",
            "psimssb_c_g": f"holds Cartesian coordinates in the unknown orientation G; {SURER}",
            "psimssb_r_e": "holds radians east-up, and it is unknown which one is the latitude; log R with G",
            "psonall": "holds eastings and northings of an unnamed grid; log PSONLLD",
            "ptsay": "holds offsets along unknown axes; log PTSAG or PTSAX",
            "pevossa": "holds only angles, not a fix; log PEVOSSB",
            "pevossb_t": TILTED,
            "pevossb_b": TILTED,
        }.items()
    ),
    # a position of the target, as Water Linked's UGPS sends it: recognised only by the topic's name
    *(
        MessageLayout(
            kind,
            own_columns("lat_deg", "lon_deg"),
            own_columns("target") | {"status": "fix_status", "gga_quality": "quality"},
            "by type and name",
            LATLON,
        )
        for kind in ("gga", "gll", "tll")
    ),
)
"""Kinds of NMEA sentences."""

DEGREES = {"lat_deg": "latitude", "lon_deg": "longitude"}
AGE = {"sent_s": "current_time", "valid_s": "measurement_time"}
ACCURATE = {"sd_m": "accuracy", "target": "remote_address"}

MODEMS = (
    MessageLayout(  # dmac and farol_msgs: of the modem's AHRS, ranges of 1500 m/s
        "musblfix",
        xyz("relative_position") | {"fix_kind": "type"},
        plane_covariance("position_covariance", 0, 1, 4) | {"target": "source_id"},
        "by type",
        ENU_OF_HEAD,
    ),
    *(  # USBLLONG: evologics_ros_sync, vehicle_interface, nanoauv_localization_msgs; ROS 1 has capitals
        MessageLayout(kind, {"x": e, "y": n, "z": u}, ACCURATE | AGE, "by type", ENU_OF_HEAD)
        for kind in ("evologicsusbllong", "acousticmodemusbllong")
        for e, n, u in ("enu", "ENU", "END")
    ),
    MessageLayout("evologicsusbllong", xyz("enu"), ACCURATE, "by type", ENU_OF_HEAD),  # mvp_acomm: without header
    MessageLayout("usbldata", xyz("enu"), ACCURATE | AGE, "by type", ENU_OF_HEAD),  # acomms_msgs
    MessageLayout(  # seatrac_interfaces: whole decimetres
        "modemrec",
        {"x": "position_easting", "y": "position_northing", "valid": "includes_position"},
        {"z": "position_depth", "outlier": "position_flt_error", "target": "src_id"},
        "by type",
        ENU_OF_HEAD,
        scale=dict.fromkeys("xyz", 0.1),
    ),
    *(  # seatrac_driver: metres
        MessageLayout(
            kind,
            {"x": f"{fix}.position_easting", "y": f"{fix}.position_northing", "valid": f"{fix}.position_valid"},
            {
                "z": f"{fix}.position_depth",
                "outlier": f"{fix}.position_filter_error",
                "target": f"{fix}.source_id",
            },
            "by type",
            ENU_OF_HEAD,
        )
        for kind in ("transceiverfixstatus", "navigationqueryresponsestatus")
        for fix in ("fix", "acoustic_fix")
    ),
    MessageLayout("beaconinfo", xyz("relative_position"), {"target": "beacon_id"}, "by type", BODY_FRD),  # stonefish
    # holoocean_interfaces: radians, from its bow to port and from the horizon up; its z is not the other's
    MessageLayout(
        "acousticbeaconsensor",
        {"slant_range_m": "range", "bearing_deg": "azimuth", "elevation_deg": "elevation", "reply": "msg_type"},
        {"target": "from_beacon"},
        "by type",
        RANGE_BEARING | {"frame": "body"},
        scale={"bearing_deg": -math.degrees(1.0), "elevation_deg": math.degrees(1.0)},
        stamp="timestamp",
    ),
    MessageLayout(  # vehicle_interface, nanoauv_localization_msgs: the origin of measurement_time is not documented
        "acousticlocalization",
        DEGREES,
        {"target": "sender_address", "sd_m": "accuracy"},
        "by type",
        LATLON,
    ),
    MessageLayout(
        "position", own_columns("depth") | DEGREES | {"age_s": "age"}, {"target": "name"}, "by type", LATLON
    ),  # sonardyne
    *(  # sonardyne's positions/NAME
        MessageLayout("geopointstamped", {q: f"{place}.{path}" for q, path in DEGREES.items()}, defaults=LATLON)
        for place in ("position", "geo_point")
    ),
    *(
        MessageLayout(kind, {}, recognised="by type", unsupported=f"holds only {what}, not a fix")
        for kind, what in (("acousticmodemusblangles", "angles"), ("acousticmodemrange", "ranges"))
    ),
)
"""Messages of their drivers."""

TOPSIDE_BOX = "is measured along the axes of the topside box from its first fix; use /waterlinked/fix"


def _ranked(layout: MessageLayout) -> MessageLayout:
    """Rank layouts that need no head first, then those that need its position, then those that need its heading."""
    kind, frame = (layout.defaults.get(key) for key in ("kind", "frame"))
    if kind not in ("latlon", "position"):
        return layout
    return replace(layout, preference=0 if kind == "latlon" else 2 if frame == "body" else 1)


_UNRANKED = (
    MessageLayout(
        "odometry",  # waterlinked_underwater_gps_ros, as is utm
        xyz("pose.pose.position"),
        recognised="only when named",
        topic=r"waterlinked/odom$",
        unsupported=TOPSIDE_BOX,
    ),
    MessageLayout(
        "point",
        own_columns("x", "y"),
        recognised="only when named",
        topic=r"/utm$",
        unsupported="holds UTM coordinates without their zone; use the topic of latitudes and longitudes",
    ),
    *PLACES,
    MessageLayout("navsatfix", NAVSAT, NAVSAT_MORE, defaults=LATLON),
    *own_places("usbl"),
    MessageLayout(
        "usbl",
        own_columns("slant_range_m", "bearing_deg"),
        own_columns("elevation_deg", "depth_m") | OWN_COVARIANCE,
        "by type",
        fixed={"kind": "range_bearing"},
    ),
    MessageLayout("usbl", own_columns("x", "y"), own_columns("z", "sd_m"), "by type"),
    *MODEMS,
    *SENTENCES,
)

USBL = tuple(_ranked(layout) for layout in _UNRANKED)
