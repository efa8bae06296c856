"""Kinds of NMEA sentences as message types of sensors; nmea_kinds lists their fields."""

from usbldr.io.messages.layouts import MessageLayout, own_columns

PLACE = own_columns("lat_deg", "lon_deg")
STATUS = {"status": "fix_status"}
QUALITY = {"gga_quality": "quality"}
COMPASS_DEG = {"convention": "compass", "unit": "deg"}

NMEA_PLACES = tuple(
    MessageLayout(kind, PLACE, STATUS | QUALITY, "by type", {"frame": "latlon"})
    for kind in ("gga", "gns", "rmc", "gll")
)
NMEA_SHIPS = tuple(
    MessageLayout(kind, PLACE, STATUS, "only when named", {"frame": "latlon"})
    for kind in ("ptsag_ship", "psonlld_ship")
)
NMEA_HEADINGS = (
    *(MessageLayout(kind, {"angle": "heading_deg"}, {}, "by type", COMPASS_DEG) for kind in ("hdt", "ths")),
    *(
        MessageLayout(kind, {"angle": "magnetic_deg", "is_true": "corrected"}, {}, "by type", COMPASS_DEG)
        for kind in ("hdg", "hdm")
    ),
    MessageLayout(
        "psimsns", {"angle": "heading_deg"}, {}, "only when named", COMPASS_DEG
    ),  # of the USBL head, on the ship
    MessageLayout("ptsah", {}, recognised="only when named", unsupported="has unknown fields; log HDT"),
)
