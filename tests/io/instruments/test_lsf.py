"""Logs of IMC messages, written and decoded by imcpy."""

import gzip
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from imc_recordings import COUNT, definitions, imcpy, messages, sent, write_lsf
from recordings import SECOND, T0
from usbldr.filters.errors import LogError, UsageError
from usbldr.io.decoding.collected import read_whole
from usbldr.io.formats.detect import open_log
from usbldr.io.reading.read import read_log


def test_the_numbers_of_all_messages_are_those_of_imcpy(tmp_path: Path) -> None:
    log = open_log(write_lsf(tmp_path))
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
    topics = {topic.name: topic.problem for topic in open_log(tmp_path / "Data.lsf").topics()}
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
        open_log(file)
    assert "\n" not in str(fault.value)


@pytest.mark.parametrize("bits", [1, 2, 4, 7])
def test_a_velocity_is_valid_if_its_horizontal_part_is(tmp_path: Path, bits: int) -> None:
    valid = imcpy.GroundVelocity.ValidityBits
    (tmp_path / "IMC.xml").write_text(definitions())
    sequence = [
        sent("GroundVelocity", T0 / SECOND + k, 5, validity=valid(bits if k == 2 else 7), x=1.0 + k, y=2.0)
        for k in range(9)
    ]
    (tmp_path / "Data.lsf").write_bytes(b"".join(sequence))

    assert list(read_log(tmp_path / "Data.lsf").tables["dvl"]["valid"]) == [k != 2 or bits == 7 for k in range(9)]
