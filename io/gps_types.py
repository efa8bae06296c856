"""Message types of satellite receivers, and of other references."""

from usbldr.io.messages import Layout, only_when_named, own
from usbldr.io.place_types import NAVSAT, NAVSAT_MORE, PLACES, own_places

GPS = (
    Layout("navsatfix", NAVSAT, NAVSAT_MORE, "by type", {"frame": "latlon"}),
    *only_when_named(PLACES),
    *own_places("gps"),
    Layout("gps", own("x", "y"), own("sd_m"), "by type"),
)

TRUTH = (
    Layout("navsatfix", NAVSAT, NAVSAT_MORE, "only when named", {"frame": "latlon"}),
    *only_when_named(PLACES),
    *own_places("gps"),
    *own_places("truth"),
)
