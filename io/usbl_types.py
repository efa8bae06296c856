"""Message types of acoustic positioning systems.

Sources: the manuals named in nmea_kinds for sentences.
"""

from usbldr.io.messages import Layout, own
from usbldr.io.nmea_kinds import ELLIPSE
from usbldr.io.place_types import NAVSAT, NAVSAT_MORE, OWN_COVARIANCE, PLACES, own_places

LATLON = {"kind": "latlon"}
ENU_OF_HEAD, NED_OF_HEAD = ({"frame": frame, "relative_to": "head"} for frame in ("ENU", "NED"))
TARGET = {"target": "target", "status": "fix_status", "sd_m": "sd_m"}
SURER = "log Cartesian coordinates (C) or latitudes and longitudes (R)"
TILTED = "has a frame that is tilted with the instrument; log its head-up, north-up or east-up frame"

BODY_SFD, BODY_FRD = ({"frame": "body", "relative_to": "head", "axes": axes} for axes in ("SFD", "FRD"))

SENTENCES = (
    Layout("psimssb_c_h", own("x", "y"), own("z") | TARGET, "by type", BODY_SFD),
    *(Layout(kind, own("x", "y"), own("z") | TARGET, "by type", BODY_FRD) for kind in ("ptsax", "pevossb_h")),
    *(Layout(kind, own("x", "y"), own("z") | TARGET, "by type", NED_OF_HEAD) for kind in ("psimssb_c_n", "pevossb_n")),
    *(Layout(kind, own("x", "y"), own("z") | TARGET, "by type", ENU_OF_HEAD) for kind in ("psimssb_c_e", "pevossb_e")),
    *(
        Layout(kind, own("lat_deg", "lon_deg"), TARGET, "by type", LATLON)
        for kind in ("psimssb_r", "psimssb_d", "pevossb_g")
    ),
    Layout("ptsag", own("lat_deg", "lon_deg"), own("target") | {"status": "fix_status"}, "by type", LATLON),
    Layout("psonlld", own("lat_deg", "lon_deg"), own("target", *ELLIPSE) | {"status": "fix_status"}, "by type", LATLON),
    Layout("psimssb_u", {}, recognised="by type", refused=f"holds UTM coordinates; {SURER}"),
    Layout("psimssb_p", {}, recognised="by type", refused=f"holds polar coordinates; {SURER}"),
    *(Layout(kind, {}, recognised="by type", refused=TILTED) for kind in ("pevossb_t", "pevossb_b")),
    # a position of the target, as Water Linked's UGPS sends it: known by the topic's name alone
    *(
        Layout(kind, own("lat_deg", "lon_deg"), {"status": "fix_status"}, "by type and name", LATLON)
        for kind in ("gga", "gll")
    ),
)
"""Kinds of NMEA sentences."""

USBL = (
    *PLACES,
    Layout("navsatfix", NAVSAT, NAVSAT_MORE, defaults=LATLON),
    *own_places("usbl"),
    Layout(
        "usbl",
        own("slant_range_m", "bearing_deg"),
        own("elevation_deg", "depth_m") | OWN_COVARIANCE,
        "by type",
        fixed={"kind": "range_bearing"},
    ),
    Layout("usbl", own("x", "y"), own("z", "sd_m"), "by type"),
    *SENTENCES,
)
