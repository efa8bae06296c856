"""Which source tells a map from its mirror image: what a type settles, no depth and no name can undo."""

from pathlib import Path
from typing import Any

import pytest

from commands import findings
from curved import curved_dive
from recordings import HEADER, SECOND, T0, Row, define, write_mcap

DEPTH_M = 12.0
TYPES = {
    "seatrac_of_doctor/msg/ModemRec": HEADER
    + "uint8 src_id\nbool includes_position\nint16 position_easting\nint16 position_northing\nint16 position_depth\n",
    "usbllong_of_doctor/msg/AcousticModemUSBLLONG": HEADER + "float32 E\nfloat32 N\nfloat32 D\n",
    "riptide_of_doctor/msg/Depth": HEADER + "float32 depth\n",
}
define(TYPES)
SEATRAC, USBLLONG, DEPTH = TYPES
AT_ORIGIN = "[usbl]\nhead = { lat_deg = 45.0, lon_deg = 7.0 }\n"


def told_by(kind: str, row: Row) -> Row:
    """Return a fix of the dive as another type tells it, with its depth counted down."""
    e, n = row[3]["point.x"], row[3]["point.y"]
    values: dict[str, Any] = {"E": e, "N": n, "D": DEPTH_M}
    if kind == SEATRAC:
        raws = zip(("easting", "northing", "depth"), (e, n, DEPTH_M), strict=True)
        values = {"includes_position": True} | {f"position_{axis}": round(10 * value) for axis, value in raws}
    return row[0], row[1], kind, {"header.stamp": row[3]["header.stamp"], **values}


def deep(rows: list[Row]) -> list[Row]:
    """Add what a depth sensor says."""
    depths = [
        (T0 + k * SECOND, "/depth", DEPTH, {"header.stamp": T0 + k * SECOND, "depth": DEPTH_M}) for k in range(600)
    ]
    return sorted([*rows, *depths], key=lambda row: row[0])


@pytest.mark.parametrize("kind", [SEATRAC, USBLLONG])
def test_a_depth_beside_east_and_north_is_no_proof_of_a_map_with_x_north(tmp_path: Path, kind: str) -> None:
    rows = [told_by(kind, row) if row[1] == "/usbl" else row for row in curved_dive()]
    log = write_mcap(tmp_path / "dive.mcap", deep(rows))
    (tmp_path / "usbldr.toml").write_text(AT_ORIGIN, encoding="utf-8")

    found = findings(log)

    assert {"MAP-FRAME", "CONVENTION-CONTRADICTED", "CONVENTION-UNDECIDED"}.isdisjoint(found)
    assert "excluded by: the fixes are ENU by their type" in found["CONVENTION-CHECKED"]["text"]


def test_a_mirrored_compass_and_dvl_leave_the_map_of_a_modem_as_it_is(tmp_path: Path) -> None:
    rows = [told_by(SEATRAC, row) if row[1] == "/usbl" else row for row in curved_dive(dvl="FRD", imu="NED")]
    log = write_mcap(tmp_path / "dive.mcap", deep(rows))
    (tmp_path / "usbldr.toml").write_text(AT_ORIGIN, encoding="utf-8")

    found = findings(log)

    assert "MAP-FRAME" not in found
    assert {"DVL-AXES", "HEADING-CONVENTION"} <= set(found)


def test_a_type_weighs_more_than_the_gravity_of_a_compass_that_is_mounted_upside_down(tmp_path: Path) -> None:
    rows = [told_by(SEATRAC, row) if row[1] == "/usbl" else row for row in curved_dive(gravity=-9.8)]
    log = write_mcap(tmp_path / "dive.mcap", rows)
    (tmp_path / "usbldr.toml").write_text(AT_ORIGIN, encoding="utf-8")

    found = findings(log)

    assert {"MAP-FRAME", "DVL-AXES", "HEADING-CONVENTION"}.isdisjoint(found)
    assert "excluded by: the fixes are ENU by their type" in found["CONVENTION-CHECKED"]["text"]
    assert "gravity" in found["CONVENTION-CONTRADICTED"]["text"]


@pytest.mark.parametrize(("z", "says"), [(DEPTH_M, "NED"), (-DEPTH_M, "ENU")])
def test_where_no_type_settles_the_frame_the_sign_of_depth_does(tmp_path: Path, z: float, says: str) -> None:
    rows = [(*r[:3], dict(r[3]) | {"point.z": z}) if r[1] == "/usbl" else r for r in curved_dive()]
    log = write_mcap(tmp_path / "dive.mcap", deep(rows))

    found = findings(log)

    assert ("MAP-FRAME" in found) == (says == "NED")
    assert "depth: the fixes have z" in found["MAP-FRAME" if says == "NED" else "CONVENTION-CHECKED"]["text"]


@pytest.mark.parametrize("name", ["usbl_aligned", "combined_map", "menu"])
def test_a_word_within_another_names_no_frame(tmp_path: Path, name: str) -> None:
    rows = [(*r[:3], dict(r[3]) | {"header.frame_id": name}) if r[1] == "/usbl" else r for r in curved_dive()]

    found = findings(write_mcap(tmp_path / "dive.mcap", rows))

    assert "MAP-FRAME" not in found
    assert "CONVENTION-UNDECIDED" in found


@pytest.mark.parametrize("name", ["map_enu", "worldEnu", "ENU"])
def test_a_frame_that_is_called_east_north_up_is_one(tmp_path: Path, name: str) -> None:
    rows = [(*r[:3], dict(r[3]) | {"header.frame_id": name}) if r[1] == "/usbl" else r for r in curved_dive()]

    found = findings(write_mcap(tmp_path / "dive.mcap", rows))

    assert f'excluded by: frame_id "{name}"' in found["CONVENTION-CHECKED"]["text"]
