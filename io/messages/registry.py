"""Which message types serve which sensor: a type is one line in the file of its sensor."""

from collections.abc import Mapping

from usbldr.io.messages.compass import COMPASS
from usbldr.io.messages.depth import DEPTH
from usbldr.io.messages.dvl import DVL
from usbldr.io.messages.gps import GPS, TRUTH
from usbldr.io.messages.layouts import MessageLayout, only_when_named
from usbldr.io.messages.nmea import NMEA_HEADINGS, NMEA_PLACES, NMEA_SHIPS
from usbldr.io.messages.usbl import USBL
from usbldr.io.reader import TopicInfo

LAYOUTS: Mapping[str, tuple[MessageLayout, ...]] = {
    "dvl": DVL,
    "compass": (*COMPASS, *NMEA_HEADINGS),
    "usbl": USBL,
    "gps": (*GPS, *NMEA_PLACES, *NMEA_SHIPS),
    "depth": DEPTH,
    "truth": (*TRUTH, *only_when_named(NMEA_PLACES)),
}
"""The first that fits a topic is taken.

Files of our own columns, and those whose columns the configuration names, have the sensor for their type.
"""

STAMPS = frozenset(layout.stamp for layouts in LAYOUTS.values() for layout in layouts)
"""All fields in which some type tells its time."""

FRAMES = frozenset(layout.frame for layouts in LAYOUTS.values() for layout in layouts)
"""All fields in which some type names its frame."""


def message_layout_of(role: str, topic: TopicInfo) -> MessageLayout | None:
    """Return how the topic serves the role, None if it can't."""
    return next((layout for layout in LAYOUTS[role] if layout.fits(topic)), None)
