"""Kinds of NMEA sentences as message types of sensors; nmea_kinds says what each tells."""

from usbldr.io.messages.layouts import Layout, own

PLACE = own("lat_deg", "lon_deg")
STATUS = {"status": "fix_status"}
COMPASS_DEG = {"convention": "compass", "unit": "deg"}

NMEA_PLACES = tuple(
    Layout(kind, PLACE, STATUS, "by type", {"frame": "latlon"}) for kind in ("gga", "gns", "rmc", "gll")
)
NMEA_SHIPS = tuple(
    Layout(kind, PLACE, STATUS, "only when named", {"frame": "latlon"}) for kind in ("ptsag_ship", "psonlld_ship")
)
NMEA_HEADINGS = (
    *(Layout(kind, {"angle": "heading_deg"}, {}, "by type", COMPASS_DEG) for kind in ("hdt", "ths")),
    *(
        Layout(kind, {"angle": "magnetic_deg", "is_true": "corrected"}, {}, "by type", COMPASS_DEG)
        for kind in ("hdg", "hdm")
    ),
    Layout("psimsns", {"angle": "heading_deg"}, {}, "only when named", COMPASS_DEG),  # of the USBL's head, on the ship
    Layout("ptsah", {}, recognised="only when named", refused="has fields that are not known here; log HDT"),
)
