"""Which message types serve which sensor: a type is one line in the file of its sensor."""

from collections.abc import Mapping

from usbldr.io.messages.compass import COMPASS
from usbldr.io.messages.depth import DEPTH
from usbldr.io.messages.dvl import DVL
from usbldr.io.messages.dvl_files import FILES_COMPASS, FILES_DEPTH, FILES_DVL, FILES_GPS, FILES_USBL
from usbldr.io.messages.gps import GPS, TRUTH
from usbldr.io.messages.imc import IMC_COMPASS, IMC_DEPTH, IMC_DVL, IMC_GPS, IMC_USBL
from usbldr.io.messages.layouts import MessageLayout, only_when_named
from usbldr.io.messages.mavlink import (
    MAVLINK_COMPASS,
    MAVLINK_DEPTH,
    MAVLINK_DVL,
    MAVLINK_GPS,
    MAVLINK_TRUTH,
    MAVLINK_USBL,
)
from usbldr.io.messages.nmea import NMEA_HEADINGS, NMEA_PLACES, NMEA_SHIPS
from usbldr.io.messages.usbl import USBL
from usbldr.io.reader import TopicInfo

LAYOUTS: Mapping[str, tuple[MessageLayout, ...]] = {
    "dvl": (*DVL, *MAVLINK_DVL, *FILES_DVL, *IMC_DVL),
    "compass": (*COMPASS, *NMEA_HEADINGS, *MAVLINK_COMPASS, *FILES_COMPASS, *IMC_COMPASS),
    "usbl": (*USBL, *MAVLINK_USBL, *FILES_USBL, *IMC_USBL),
    "gps": (*GPS, *NMEA_PLACES, *NMEA_SHIPS, *MAVLINK_GPS, *FILES_GPS, *IMC_GPS),
    "depth": (*DEPTH, *MAVLINK_DEPTH, *FILES_DEPTH, *IMC_DEPTH),
    "truth": (*TRUTH, *only_when_named(NMEA_PLACES), *MAVLINK_TRUTH, *only_when_named((*FILES_GPS, *IMC_GPS))),
}
"""The first layout that matches a topic is used.

The type of files with usbldr's own columns, or with configured columns, is the sensor.
"""

STAMPS = frozenset(layout.stamp for layouts in LAYOUTS.values() for layout in layouts)
"""All fields that are the time of some type."""

FRAMES = frozenset(layout.frame for layouts in LAYOUTS.values() for layout in layouts)
"""All fields that name the frame of some type."""


def message_layout_of(role: str, topic: TopicInfo) -> MessageLayout | None:
    """Return the layout of the topic as the role, None if it cannot be used."""
    return next((layout for layout in LAYOUTS[role] if layout.fits(topic)), None)
