"""docs/types.md: the type that it adds can be read, and the names that it gives exist."""

import re
import tomllib
from pathlib import Path

import msgspec
import pytest

from checkout import ROOT
from recordings import T0, define, write_mcap
from usbldr.io.messages import registry
from usbldr.io.messages.layouts import MessageLayout
from usbldr.io.reading.read import read_log

DOC = (ROOT / "docs" / "types.md").read_text(encoding="utf-8")
SPEED = "float64 forward\nfloat64 port\nfloat64 up\n"
define(
    {
        "acme_msgs/msg/Speed": SPEED,
        "acme_msgs/msg/BottomLock": "std_msgs/Header header\nacme_msgs/Speed speed\nint32 status\nfloat64 sigma\n",
    }
)


def test_the_type_that_the_page_adds_is_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = DOC[DOC.index("## A new type") : DOC.index("## A new sentence")]
    (shown,) = re.findall(r"```toml\n(.*?)```", page, re.DOTALL)
    (layout,) = msgspec.convert(tomllib.loads(shown)["layout"], list[MessageLayout])
    monkeypatch.setattr(registry, "LAYOUTS", {**registry.LAYOUTS, "dvl": (layout,)})
    values = {"header.stamp": T0, "speed.forward": 150.0, "speed.port": -20.0, "status": 1, "sigma": 2.0}
    rows = [(T0 + k, "/acme", "acme_msgs/msg/BottomLock", {**values, "status": 1 - k}) for k in range(2)]

    file = write_mcap(tmp_path / "dive.mcap", rows)
    (tmp_path / "usbldr.toml").write_text('[dvl]\nsd_mps = "message"', encoding="utf-8")
    table = read_log(file).tables["dvl"]

    assert (table["starboard_mps"].iloc[0], table["forward_mps"].iloc[0]) == pytest.approx((0.2, 1.5))
    assert table["sd_mps"].iloc[0] == pytest.approx(0.02)


def cells(heading: str, column: int) -> list[str]:
    """Return one column of the tables under a heading of the page."""
    part = DOC[DOC.index(heading) :].split("\n## ")[0]
    rows = [line.strip("| ").split(" | ") for line in part.splitlines() if line.startswith("| ")]
    return [row[column] for row in rows]


def names(cell: str) -> set[str]:
    """Return the types that a cell names, without their packages, in lower case; a name with a suffix is a topic's."""
    words = re.findall(r"`([A-Za-z0-9_./]+)`", cell)
    return {word.rpartition("/")[2].rpartition(".")[2].lower() for word in words}


def test_every_type_that_the_page_names_is_known_and_every_type_that_is_read_stands_there() -> None:
    known = {layout.type for layouts in registry.LAYOUTS.values() for layout in layouts if not layout.unsupported}
    named = set[str]().union(*map(names, cells("## What is read", 0)))

    assert named - {"compass_hdg", "rel_alt"} <= known
    assert known - {*registry.LAYOUTS, "psonlld_ship", "ptsag_ship"} <= named


SENSORS = {"DVL": "dvl", "heading": "compass", "USBL": "usbl", "GPS": "gps", "depth": "depth"}
FOUND = {"by type": "by type", "with a name": "by type and name", "named": "only when named"}


def test_each_type_is_found_the_way_that_the_page_says() -> None:
    role = ""
    for kind, found in zip(cells("## What is read", 0), cells("## What is read", 1), strict=True):
        role = SENSORS.get(kind, role)
        for name in names(kind) - {"compass_hdg"} if found in FOUND else ():
            ways = {layout.recognised for layout in registry.LAYOUTS[role] if layout.type == name}
            assert FOUND[found] in ways, f"{role} {name}"


def test_every_refusal_stands_on_the_page_and_no_other() -> None:
    layouts = [layout for layouts in registry.LAYOUTS.values() for layout in layouts if layout.unsupported]
    starred = {layout.unsupported for layout in layouts if layout.recognised == "only when named"}
    types, sentences = cells("## What is refused", 0)[1:], cells("## What is refused", 1)[1:]  # without the heading

    assert set(sentences) == {layout.unsupported for layout in layouts}
    assert {why for kind, why in zip(types, sentences, strict=True) if kind.endswith("*")} == starred
    for layout in layouts:
        assert layout.type in names(types[sentences.index(layout.unsupported)]), layout.type


def test_every_file_that_the_page_names_is_there() -> None:
    for name in re.findall(r"`((?:io|tests)/[a-z_/]+\.py)`", DOC):
        assert (ROOT / name).is_file(), name
