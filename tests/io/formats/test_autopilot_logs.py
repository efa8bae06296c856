"""Telemetry logs and onboard logs of autopilots, against pymavlink's own readers."""

import random
import struct
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pymavlink import DFReader, mavutil
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from recordings import SECOND, T0
from usbldr.filters.errors import LogError, UsageError, UsbldrError
from usbldr.io.formats.dataflash_log import DataflashLog
from usbldr.io.formats.detect import open_log
from usbldr.io.formats.tlog_log import TelemetryLog
from usbldr.io.opening import Request
from usbldr.io.read import read_log

COUNT = 60


def packets(version_1: bool = False) -> list[bytes]:
    """Return packets as a ground station stores them, each after its time."""
    sender = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    dvl = mavlink.MAVLink(None, srcSystem=255, srcComponent=0)
    found: list[bytes] = []
    for k in range(COUNT):
        moved = [0.2 + k / 100, -0.1, 0.01]
        messages = [
            (dvl, mavlink.MAVLink_vision_position_delta_message(k, 200_000, [0, 0, 0.1], moved, 90)),
            (sender, mavlink.MAVLink_attitude_message(1000 * k, 0.01, 0.02, k / 20, 0, 0, 0)),
            (sender, mavlink.MAVLink_gps_raw_int_message(k, 3, 476176249 + k, -1223610207, 0, 1, 1, 0, 0, 9)),
            (sender, mavlink.MAVLink_scaled_pressure2_message(k, 1500.5 + k, 0, 0)),
            (sender, mavlink.MAVLink_statustext_message(6, b"dive" + b"!" * (k % 3))),
        ]
        for owner, message in messages:
            time_us = T0 // 1000 + k * 1_000_000
            packed = bytes(message.pack(owner, force_mavlink1=version_1 and message.get_msgId() < 256))
            found.append(struct.pack(">Q", time_us) + packed)
    return found


def write_tlog(file: Path, version_1: bool = False) -> Path:
    file.write_bytes(b"".join(packets(version_1)))
    return file


def value_of(message: Any, path: str) -> Any:
    name, _, element = path.removeprefix("message.").partition(".")
    value = getattr(message, name)
    return value[int(element)] if element else value


@pytest.mark.parametrize("version_1", [False, True])
def test_a_telemetry_log_has_the_values_of_pymavlink(tmp_path: Path, version_1: bool) -> None:
    file = write_tlog(tmp_path / "dive.tlog", version_1)
    log = open_log(file)
    oracle: dict[str, list[Any]] = {}
    connection: Any = mavutil.mavlink_connection(str(file), dialect="ardupilotmega")
    while (message := connection.recv_match()) is not None:
        sender = f"{message.get_srcSystem()}/{message.get_srcComponent()}"
        oracle.setdefault(f"mavlink/{sender}/{message.get_type()}", []).append(message)

    assert {topic.name: topic.count for topic in log.topics()} == {name: len(found) for name, found in oracle.items()}
    for topic in log.topics():
        paths = [path for path in topic.fields if path not in topic.arrays]
        paths += [f"{path}.{k}" for path in topic.arrays for k in range(3)]
        records = log.read({topic.name: paths})[topic.name]
        for path in paths:
            assert records.columns[path].tolist() == [value_of(message, path) for message in oracle[topic.name]]
        times = [message._timestamp for message in oracle[topic.name]]
        np.testing.assert_allclose(records.received_ns / 1e9, times, rtol=0, atol=1e-6)
    assert log.findings() == ()


def test_a_telemetry_log_is_a_dive(tmp_path: Path) -> None:
    log = read_log(write_tlog(tmp_path / "dive.tlog"))

    assert log.format == "MAVLink telemetry log"
    assert log.start_ns == T0
    np.testing.assert_allclose(log.tables["dvl"]["forward_mps"], (0.2 + np.arange(COUNT) / 100) * 5, rtol=1e-6)
    np.testing.assert_allclose(log.tables["compass"]["heading_deg"], np.degrees(np.arange(COUNT) / 20), atol=1e-4)
    assert len(log.tables["gps"]) == COUNT
    np.testing.assert_allclose(
        log.tables["depth"]["depth_m"], (150050 + 100 * np.arange(COUNT) - 101325) / (1025 * 9.80665), atol=1e-3
    )


def test_without_pymavlink_the_sentence_names_the_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = write_tlog(tmp_path / "dive.tlog")
    monkeypatch.setitem(sys.modules, "pymavlink.dialects.v20.ardupilotmega", None)

    with pytest.raises(UsageError) as fault:
        open_log(file)
    assert str(fault.value) == f"{file}: telemetry logs need pymavlink: pip install 'usbldr[mavlink]'"


def test_a_packet_with_a_flipped_bit_is_lost_and_reported(tmp_path: Path) -> None:
    file, rng = tmp_path / "dive.tlog", random.Random(5)
    parts = packets()
    for _ in range(60):
        spoilt = rng.randrange(5, len(parts))
        bent = bytearray(parts[spoilt])
        bent[rng.randrange(8, len(bent))] ^= 1 << rng.randrange(8)
        file.write_bytes(b"".join([*parts[:spoilt], bytes(bent), *parts[spoilt + 1 :]]))
        log = open_log(file)
        assert sum(topic.count for topic in log.topics() if not topic.problem) == len(parts) - 1
        (finding,) = log.findings()
        assert finding.lost_data or finding.code == "UNDECODED"


def test_a_packet_of_another_dialect_is_a_topic_that_cannot_be_read(tmp_path: Path) -> None:
    parts = packets()
    unknown = struct.pack(">Q", T0 // 1000) + b"\xfd\x02\0\0\7\1\1\xff\xff\x7fab\0\0"
    (tmp_path / "a.tlog").write_bytes(b"".join([parts[0], unknown, *parts[1:]]))
    log = open_log(tmp_path / "a.tlog")

    problems = {topic.name: topic.problem for topic in log.topics() if topic.problem}
    assert problems == {"mavlink/1/1/UNKNOWN_8388607": "its message 8388607 is not in the dialect ardupilotmega"}
    (finding,) = log.findings()
    assert finding.text == "1 messages are not in the dialect ardupilotmega, or damaged; not read"


Definition = tuple[int, str, str, str, str]  # number, name, codes, columns, units
DEFINITIONS: Sequence[Definition] = (
    (130, "ATT", "QccffC", "TimeUS,Roll,Pitch,DesYaw,Yaw,ErrYaw", "sddddd"),
    (131, "GPS", "QBBIHBcLLe", "TimeUS,I,Status,GMS,GWk,NSats,HDop,Lat,Lng,Alt", "s#-s-S-DUm"),
    (132, "BARO", "QBff", "TimeUS,I,Alt,Press", "s#mP"),
    (133, "VISO", "Qffffffff", "TimeUS,dt,AngDX,AngDY,AngDZ,PosDX,PosDY,PosDZ,conf", "ssrrrmmm-"),
    (134, "MSG", "QZ", "TimeUS,Message", "s-"),
)
STRUCT: Mapping[str, str] = {
    "Q": "Q",
    "c": "h",
    "C": "H",
    "f": "f",
    "B": "B",
    "I": "I",
    "H": "H",
    "L": "i",
    "e": "i",
} | {
    "Z": "64s",
    "N": "16s",
    "n": "4s",
}


def fmt(number: int, name: str, codes: str, columns: str) -> bytes:
    size = 3 + struct.calcsize("<" + "".join(STRUCT[code] for code in codes))
    return b"\xa3\x95\x80" + struct.pack("<BB4s16s64s", number, size, name.encode(), codes.encode(), columns.encode())


def row(number: int, codes: str, *values: Any) -> bytes:
    return b"\xa3\x95" + bytes([number]) + struct.pack("<" + "".join(STRUCT[code] for code in codes), *values)


def onboard(gps: bool = True) -> list[bytes]:
    """Return the messages of an onboard log."""
    parts = [fmt(128, "FMT", "BBnNZ", "Type,Length,Name,Format,Columns")]
    parts += [fmt(129, "FMTU", "QBNN", "TimeUS,FmtType,UnitIds,MultIds")]
    for number, name, codes, columns, units in DEFINITIONS:
        parts += [fmt(number, name, codes, columns), row(129, "QBNN", 1, number, units.encode(), b"-" * len(units))]
    codes_of = {number: codes for number, _, codes, _, _ in DEFINITIONS}
    for k in range(COUNT):
        t = 5_000_000 + 1_000_000 * k
        parts += [row(130, codes_of[130], t, 12, -34, 1.0, (350 + k) % 360 + 0.25, 7)]
        parts += [row(133, codes_of[133], t + 10, 200_000.0, 0, 0, 0, 0.2 + k / 100, -0.1, 0.01, 90.0 if k != 4 else 0)]
        if gps:
            week = (131, codes_of[131], t + 20, 0, 3 if k > 1 else 1, 100_000 + 1000 * k, 2200)
            parts += [row(*week, 9, 80, 476176249 + k, -1223610207, 1200)]
        parts += [row(132, codes_of[132], t + 30, instance, 0, 101325 + 1e4 * instance) for instance in (0, 1)]
        parts += [row(134, codes_of[134], t + 40, b"ArduSub V4.5")]
    return parts


def write_bin(file: Path, parts: Sequence[bytes] | None = None) -> Path:
    file.write_bytes(b"".join(onboard() if parts is None else parts))
    return file


def test_an_onboard_log_has_the_values_of_pymavlink(tmp_path: Path) -> None:
    file = write_bin(tmp_path / "00000001.BIN")
    log = open_log(file)
    oracle: dict[str, list[Any]] = {}
    reader: Any = DFReader.DFReader_binary(str(file))
    while (message := reader.recv_match(type=["ATT", "GPS", "BARO", "VISO", "MSG"])) is not None:
        name = message.get_type()
        instance = f"[{message.I}]" if name in ("GPS", "BARO") else ""
        oracle.setdefault(name.partition("[")[0] + instance, []).append(message)
    topics = {topic.name: topic for topic in log.topics() if topic.name != "FMTU"}

    assert {name: topic.count for name, topic in topics.items()} == {name: len(found) for name, found in oracle.items()}
    for name, topic in topics.items():
        records = log.read({name: topic.fields})[name]
        for path in topic.fields:
            values = [getattr(message, path) for message in oracle[name]]
            texts = isinstance(values[0], str)
            assert records.columns[path].tolist() == (values if texts else pytest.approx(values, rel=1e-15))
    times = [message._timestamp for message in oracle["ATT"]]
    np.testing.assert_allclose(log.read({"ATT": ["Yaw"]})["ATT"].received_ns / 1e9, times, rtol=0, atol=1e-5)
    assert log.findings() == ()


def test_an_onboard_log_is_a_dive(tmp_path: Path) -> None:
    file = write_bin(tmp_path / "00000001.BIN")
    log = read_log(file)

    topics = {role: provenance.topic for role, provenance in log.provenance.items()}
    assert topics == {"dvl": "VISO", "compass": "ATT", "gps": "GPS[0]", "depth": "BARO[1]"}
    np.testing.assert_allclose(log.tables["dvl"]["forward_mps"], (0.2 + np.arange(COUNT) / 100) * 5, rtol=1e-6)
    assert log.tables["dvl"]["valid"].tolist() == [k != 4 for k in range(COUNT)]
    assert log.tables["compass"]["heading_deg"].tolist() == [(350 + k) % 360 + 0.25 for k in range(COUNT)]
    assert len(log.tables["gps"]) == COUNT - 2
    assert log.tables["depth"]["depth_m"].iloc[0] == pytest.approx(1e4 / (1025 * 9.80665))
    inside = read_log(file, Request(topics={"depth": "BARO[0]"}))
    assert inside.tables["depth"]["depth_m"].iloc[0] == pytest.approx(0.0)


def test_an_onboard_log_without_gps_is_timed_from_power_on(tmp_path: Path) -> None:
    log = open_log(write_bin(tmp_path / "a.BIN", onboard(gps=False)))

    assert log.read({"ATT": ["Yaw"]})["ATT"].received_ns[:2].tolist() == [5 * SECOND, 6 * SECOND]


@pytest.mark.parametrize("rest", [b"\0" * 300, b"\xff" * 300])
def test_the_unused_end_of_a_page_is_no_loss(tmp_path: Path, rest: bytes) -> None:
    assert open_log(write_bin(tmp_path / "a.BIN", [*onboard(), rest])).findings() == ()


def test_a_time_beyond_reason_is_left_out_and_reported(tmp_path: Path) -> None:
    parts = [*onboard(), row(130, "QccffC", 1 << 63, 0, 0, 0, 0, 0)]
    log = open_log(write_bin(tmp_path / "a.BIN", parts))

    assert next(topic.count for topic in log.topics() if topic.name == "ATT") == COUNT
    (finding,) = log.findings()
    assert finding.text == "1 messages have an impossible time; left out"


@pytest.mark.parametrize("write", [write_tlog, write_bin])
@pytest.mark.parametrize("kind", ["cuts", "flips"])
def test_no_damage_of_an_autopilots_log_is_a_traceback_or_a_silent_loss(tmp_path: Path, write: Any, kind: str) -> None:
    file = write(tmp_path / "dive")
    whole, rng = file.read_bytes(), random.Random(kind)
    total = sum(topic.count for topic in open_log(file).topics())
    for _ in range(40):
        if kind == "cuts":
            spoilt = whole[: rng.randrange(len(whole))]
            at_end = spoilt in boundaries(write)
        else:
            bent, at_end = bytearray(whole), False
            for _ in range(rng.choice([1, 1, 5, 50])):
                bent[rng.randrange(len(bent))] ^= 1 << rng.randrange(8)
            spoilt = bytes(bent)
        file.write_bytes(spoilt)
        try:
            log = open_log(file)
            count = sum(topic.count for topic in log.topics())
            said = any(topic.problem for topic in log.topics()) or bool(log.findings())
        except UsbldrError:
            continue
        assert said or at_end or count >= total


def boundaries(write: Any) -> set[bytes]:
    """Return the files that end after a message: whole ones, to all appearances."""
    parts = packets() if write is write_tlog else onboard()
    return {b"".join(parts[:k]) for k in range(len(parts))}


def test_a_file_without_one_message_is_one_sentence(tmp_path: Path) -> None:
    (tmp_path / "a.tlog").write_bytes(packets()[0][:-1])
    with pytest.raises(LogError, match=r"holds no messages \(the file ends within a message"):
        read_log(tmp_path / "a.tlog")
    (tmp_path / "a.BIN").write_bytes(onboard()[0])
    with pytest.raises(LogError, match="holds no messages"):
        read_log(tmp_path / "a.BIN")


def test_the_readers_are_found_by_the_first_bytes(tmp_path: Path) -> None:
    assert isinstance(open_log(write_tlog(tmp_path / "a.csv")), TelemetryLog)
    assert isinstance(open_log(write_bin(tmp_path / "b.csv")), DataflashLog)
