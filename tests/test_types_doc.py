"""docs/types.md: the type that it adds can be read, and the names that it gives exist."""

import re
from pathlib import Path

import pytest

from dives import T0, define, write_mcap
from usbldr.io import sensor_types
from usbldr.io.messages import Layout
from usbldr.io.read import read_log

ROOT = Path(__file__).resolve().parents[1]
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
    (shown,) = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    layout = eval(shown, {"Layout": Layout})
    monkeypatch.setattr(sensor_types, "LAYOUTS", {**sensor_types.LAYOUTS, "dvl": (layout,)})
    values = {"header.stamp": T0, "speed.forward": 150.0, "speed.port": -20.0, "status": 1, "sigma": 2.0}
    rows = [(T0 + k, "/acme", "acme_msgs/msg/BottomLock", {**values, "status": 1 - k}) for k in range(2)]

    file = write_mcap(tmp_path / "dive.mcap", rows)
    (tmp_path / "usbldr.toml").write_text('[dvl]\nsd_mps = "message"', encoding="utf-8")
    table = read_log(file).tables["dvl"]

    assert (table["starboard_mps"].iloc[0], table["forward_mps"].iloc[0]) == pytest.approx((0.2, 1.5))
    assert table["sd_mps"].iloc[0] == pytest.approx(0.02)


def test_every_type_that_the_page_names_is_known() -> None:
    table = DOC[DOC.index("## What is read") : DOC.index("NMEA sentences are listed")]
    named = {name.rpartition("/")[2].rpartition(".")[2] for name in re.findall(r"`([A-Za-z0-9_./]+)`", table)}
    known = {layout.type for layouts in sensor_types.LAYOUTS.values() for layout in layouts}

    fields_and_packages = {"velocity_valid", "uuv_sensor_msgs", "rel_alt"}
    assert {name.lower() for name in named - fields_and_packages} <= known


def test_every_file_that_the_page_names_is_there() -> None:
    for name in re.findall(r"`((?:io|tests)/[a-z_]+\.py)`", DOC):
        assert (ROOT / name).is_file(), name
