"""Message types of acoustic positioning systems."""

from usbldr.io.messages import Layout, own
from usbldr.io.place_types import NAVSAT, NAVSAT_MORE, OWN_COVARIANCE, PLACES, own_places

USBL = (
    *PLACES,
    Layout("navsatfix", NAVSAT, NAVSAT_MORE, defaults={"kind": "latlon"}),
    *own_places("usbl"),
    Layout(
        "usbl",
        own("slant_range_m", "bearing_deg"),
        own("elevation_deg", "depth_m") | OWN_COVARIANCE,
        "by type",
        fixed={"kind": "range_bearing"},
    ),
    Layout("usbl", own("x", "y"), own("z", "sd_m"), "by type"),
)
