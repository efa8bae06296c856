"""Which message types serve which sensor: a type is one entry in the file of its sensor in types/."""

import tomllib
from collections.abc import Mapping
from dataclasses import replace
from importlib.resources import files
from typing import Any

import msgspec

from usbldr.filters import plugins
from usbldr.io.messages.layouts import MessageLayout
from usbldr.io.reader import TopicInfo


def _document(name: str) -> dict[str, Any]:
    return tomllib.loads((files("usbldr.io.messages") / "types" / f"{name}.toml").read_text(encoding="utf-8"))


def _types(sensor: str) -> tuple[MessageLayout, ...]:
    return msgspec.convert(_document(sensor)["layout"], tuple[MessageLayout, ...])


def _of_plugins(sensor: str) -> tuple[MessageLayout, ...]:
    return tuple(layout for part in plugins.offered(plugins.LAYOUTS) for layout in part.value.get(sensor, ()))


_NAMED_RECEIVERS = tuple(replace(layout, recognised="only when named") for layout in _types("gps"))
LAYOUTS: Mapping[str, tuple[MessageLayout, ...]] = {
    **{sensor: _types(sensor) + _of_plugins(sensor) for sensor in ("dvl", "compass", "usbl", "gps", "depth")},
    "truth": (*_types("truth"), *_NAMED_RECEIVERS, *_of_plugins("truth")),
}
"""The first layout that matches a topic is used; those of other packages come last.

The type of files with usbldr's own columns, or with configured columns, is the sensor.
"""

ROSTOPIC_TYPES = msgspec.convert(_document("rostopic"), dict[str, frozenset[str]])
"""The type of a message by some of its fields in a file of rostopic; the first match is used."""

STAMPS = frozenset(layout.stamp for layouts in LAYOUTS.values() for layout in layouts)
"""All fields that are the time of some type."""

FRAMES = frozenset(layout.frame for layouts in LAYOUTS.values() for layout in layouts)
"""All fields that name the frame of some type."""


def message_layout_of(role: str, topic: TopicInfo) -> MessageLayout | None:
    """Return the layout of the topic as the role, None if it cannot be used."""
    return next((layout for layout in LAYOUTS[role] if layout.fits(topic)), None)
