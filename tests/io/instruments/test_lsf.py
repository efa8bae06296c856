"""Logs of IMC messages, written and decoded by imcpy; units and signs are those that IMC.xml states."""

import gzip
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from imc_recordings import COUNT, imcpy, messages, sent, write_lsf, write_messages
from logs import codes, columns
from recordings import SECOND, T0
from textbook import radii_m
from usbldr.filters.errors import LogError, UsageError
from usbldr.io.decoding.collected import read_whole
from usbldr.io.formats.detect import open_reader
from usbldr.io.log import Log
from usbldr.io.reading.read import Request, read_log


def test_the_numbers_of_all_messages_are_those_of_imcpy(tmp_path: Path) -> None:
    log = open_reader(write_lsf(tmp_path))
    oracle: dict[str, list[Any]] = {}
    for data in messages():
        message = imcpy.Packet.deserialize(data)
        oracle.setdefault(type(message).__name__, []).append(message)

    compared = 0
    for topic in log.topics():
        if topic.problem:
            continue
        kind = topic.type.removeprefix("imc/")
        records = read_whole(log, {topic.name: topic.fields})[topic.name]
        for path in topic.fields:
            name, _, flag = path.partition(".")
            values = [getattr(message, name) for message in oracle[kind]]
            expected = [bool(int(v) & {"VEL_X": 1, "VEL_Y": 2, "VEL_Z": 4}[flag]) for v in values] if flag else values
            expected = [v if isinstance(v, str) else float(v) for v in expected]
            assert records.columns[path].tolist() == expected, path
            compared += len(expected)
        np.testing.assert_array_equal(records.received_ns, [round(m.timestamp * 1e6) * 1000 for m in oracle[kind]])
    assert compared == COUNT * (5 + 7 + 1 + 6) + 4
    assert log.findings() == ()


def test_an_lsf_log_is_a_dive(tmp_path: Path) -> None:
    log = read_log(write_lsf(tmp_path))

    assert log.format == "LSF"
    assert log.start_ns == T0 + SECOND // 4
    np.testing.assert_array_equal(log.tables["dvl"]["forward_mps"], 1 + np.arange(COUNT) / 7)
    np.testing.assert_array_equal(log.tables["dvl"]["starboard_mps"], 0.25)
    np.testing.assert_array_equal(log.tables["dvl"]["up_mps"], 0.01)
    np.testing.assert_allclose(log.tables["compass"]["heading_deg"], np.degrees(np.arange(COUNT) / 40), rtol=1e-12)
    np.testing.assert_array_equal(log.tables["depth"]["depth_m"], 2 + np.arange(COUNT) / 8)
    assert len(log.tables["usbl"]) == COUNT
    topics = {topic.name: topic.problem for topic in open_reader(tmp_path / "Data.lsf").topics()}
    assert "imc/30/DVL/GroundVelocity" in topics
    assert topics["imc/30/7/UNKNOWN_263"] == "its message is not in the definitions beside the log"


def test_a_compressed_log_finds_the_definitions_beside_it(tmp_path: Path) -> None:
    file = write_lsf(tmp_path)
    whole = read_log(file).tables["dvl"]
    (tmp_path / "Data.lsf.gz").write_bytes(gzip.compress(file.read_bytes()))
    (tmp_path / "IMC.xml.gz").write_bytes(gzip.compress((tmp_path / "IMC.xml").read_bytes()))
    file.unlink()
    (tmp_path / "IMC.xml").unlink()

    assert read_log(tmp_path / "Data.lsf.gz").tables["dvl"].equals(whole)


@pytest.mark.parametrize("text", [None, b"", b"<messages>", b"no", b'<m><message id="x"/></m>', b"<!DOCTYPE a []>"])
def test_definitions_that_are_missing_or_broken_are_named(tmp_path: Path, text: bytes | None) -> None:
    file = write_lsf(tmp_path)
    (tmp_path / "IMC.xml").unlink()
    if text is not None:
        (tmp_path / "IMC.xml").write_bytes(text)

    with pytest.raises(UsageError if text is None else LogError, match=r"IMC") as fault:
        open_reader(file)
    assert "\n" not in str(fault.value)


@pytest.mark.parametrize("bits", [1, 2, 4, 7])
def test_a_velocity_is_valid_if_its_horizontal_part_is(tmp_path: Path, bits: int) -> None:
    valid = imcpy.GroundVelocity.ValidityBits
    speeds = [{"validity": valid(bits if k == 2 else 7), "x": 1.0 + k, "y": 2.0} for k in range(9)]

    dvl = dive(tmp_path, "GroundVelocity", *speeds).tables["dvl"]

    assert list(dvl["valid"]) == [k != 2 or bits == 7 for k in range(9)]


LAT, LON = 0.7184, -0.1519  # [rad] off Porto
START_S = T0 / SECOND


def dive(folder: Path, kind: str, *sequence: dict[str, Any], **topics: str) -> Log:
    """Write messages of one kind, one a second, and read them."""
    file = write_messages(folder, [sent(kind, START_S + k, 5, **fields) for k, fields in enumerate(sequence)])
    return read_log(file, Request(topics=topics))


def fix_of_gps(east_rad: float = 0.0, bits: int = 7, kind: int = 0) -> dict[str, Any]:
    own = imcpy.GpsFix
    place = {"lat": LAT, "lon": LON + east_rad, "hacc": 3.0, "satellites": 9, "cog": 1.0, "sog": 2.0}
    return place | {"validity": own.ValidityBits(bits), "type": own.TypeEnum(kind)}


FIXES = [fix_of_gps(), fix_of_gps(1e-6), fix_of_gps(9.0, bits=3), fix_of_gps(2e-6, bits=4)]
PLACES_DEG = {"gps.lat_deg": [math.degrees(LAT)] * 3, "gps.lon_deg": np.degrees(LON + np.array([0, 1e-6, 2e-6]))}
ANGLES = [{"psi": psi, "psi_magnetic": 3.0, "theta": 0.2, "phi": 0.1} for psi in (0.0, np.pi / 2, -np.pi / 2)]


@pytest.mark.parametrize(
    ("kind", "sequence", "wanted"),
    [
        # a fix is valid if its position is
        ("GpsFix", FIXES, PLACES_DEG | {"gps.time_s": [0.0, 1.0, 3.0]}),
        # clockwise from north
        ("EulerAngles", ANGLES, {"compass.heading_deg": [0, 90, 270]}),
    ],
)
def test_places_and_headings_are_in_radians(tmp_path: Path, kind: str, sequence: Any, wanted: Any) -> None:
    found = columns(dive(tmp_path, kind, *sequence), wanted)

    assert found == {name: pytest.approx(np.asarray(values), rel=0, abs=1e-12) for name, values in wanted.items()}


@pytest.mark.parametrize(("name", "read"), [("STANDALONE", 1), ("DIFFERENTIAL", 1), ("SIMULATION", 1),
                                            ("DEAD_RECKONING", 0), ("MANUAL_INPUT", 0)])  # fmt: skip
def test_a_position_that_was_not_measured_is_no_gps_fix(tmp_path: Path, name: str, read: int) -> None:
    kind = int(getattr(imcpy.GpsFix.TypeEnum, name))

    log = dive(tmp_path, "GpsFix", fix_of_gps(), fix_of_gps(1e-6, kind=kind), fix_of_gps(2e-6))

    assert len(log.tables["gps"]) == 2 + read
    assert ("GPS-INVALID" in codes(log)) != bool(read)


@pytest.mark.parametrize(("kind", "more"), [("UsblFix", {"target": 31}),
                                            ("UsblFixExtended", {"target": "lauv-1", "accuracy": 2.5})])  # fmt: skip
def test_usbl_fixes_are_in_radians(tmp_path: Path, kind: str, more: dict[str, Any]) -> None:
    log = dive(tmp_path, kind, *({"lat": LAT + k * 1e-7, "lon": LON, **more} for k in range(5)))

    table = log.tables["usbl"]
    along_m = np.arange(5) * 1e-7 * radii_m(math.degrees(LAT))[0]
    np.testing.assert_allclose(table["north_m"] - table["north_m"][0], along_m, rtol=0, atol=1e-3)


@pytest.mark.parametrize("kind", ["WaterVelocity", "EstimatedState"])
def test_what_is_no_measurement_over_ground_is_not_used(tmp_path: Path, kind: str) -> None:
    fields = {"validity": imcpy.WaterVelocity.ValidityBits(7)} if kind == "WaterVelocity" else {"lat": LAT, "u": 1.0}

    assert dive(tmp_path, kind, fields, fields).tables == {}


def test_a_bit_that_is_none_is_no_field(tmp_path: Path) -> None:
    file = write_messages(tmp_path, [sent("GpsFix", START_S, 5, **fix_of_gps(bits=5))])

    (topic,) = open_reader(file).topics()

    flags = [path for path in topic.fields if path.startswith("validity.")]
    assert flags == ["validity.VALID_DATE", "validity.VALID_TIME", "validity.VALID_POS"]
    values = read_whole(open_reader(file), {topic.name: flags})[topic.name].columns
    assert [values[flag][0] for flag in flags] == [True, False, True]
