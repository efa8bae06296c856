"""Logs of autopilots, against pymavlink's own readers; and MAVLink messages as BlueOS records them, in JSON."""

import gc
import math
import struct
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pymavlink import DFReader, mavutil
from pymavlink.generator.mavcrc import x25crc

from autopilot_recordings import COUNT, onboard, packets, row, write_bin, write_tlog
from blueos_recordings import Row, delta, write_blueos
from logs import refusal
from recordings import SECOND, T0, saved
from usbldr.filters.errors import LogError, UsageError
from usbldr.io.decoding.collected import read_whole
from usbldr.io.formats.detect import open_reader
from usbldr.io.reading.opening import Request
from usbldr.io.reading.read import read_log


def value_of(message: Any, path: str) -> Any:
    name, _, element = path.removeprefix("message.").partition(".")
    value = getattr(message, name)
    return value[int(element)] if element else value


@pytest.mark.parametrize("version_1", [False, True])
def test_a_telemetry_log_has_the_values_of_pymavlink_and_is_a_dive(tmp_path: Path, version_1: bool) -> None:
    file = write_tlog(tmp_path / "dive.tlog", version_1)
    log = open_reader(file)
    oracle: dict[str, list[Any]] = {}
    connection: Any = mavutil.mavlink_connection(str(file), dialect="ardupilotmega")
    while (message := connection.recv_match()) is not None:
        sender = f"{message.get_srcSystem()}/{message.get_srcComponent()}"
        oracle.setdefault(f"mavlink/{sender}/{message.get_type()}", []).append(message)
    connection.close()

    assert {topic.name: topic.count for topic in log.topics()} == {name: len(found) for name, found in oracle.items()}
    for topic in log.topics():
        paths = [path for path in topic.fields if path not in topic.arrays]
        paths += [f"{path}.{k}" for path in topic.arrays for k in range(3)]
        records = read_whole(log, {topic.name: paths})[topic.name]
        for path in paths:
            assert records.columns[path].tolist() == [value_of(message, path) for message in oracle[topic.name]]
        times = [message._timestamp for message in oracle[topic.name]]
        np.testing.assert_allclose(records.received_ns / 1e9, times, rtol=0, atol=1e-6)
    assert log.findings() == ()

    log = read_log(file)

    assert log.format == "MAVLink telemetry log"
    assert log.start_ns == T0
    np.testing.assert_allclose(log.tables["dvl"]["forward_mps"], (0.2 + np.arange(COUNT) / 100) * 5, rtol=1e-6)
    np.testing.assert_allclose(log.tables["compass"]["heading_deg"], np.degrees(np.arange(COUNT) / 20), atol=1e-4)
    assert len(log.tables["gps"]) == COUNT
    depth_m = (150050 + 100 * np.arange(COUNT) - 101325) / (1025 * 9.80665)
    np.testing.assert_allclose(log.tables["depth"]["depth_m"], depth_m, atol=1e-3)


@pytest.mark.parametrize(
    ("write", "module", "logs"),
    [(write_tlog, "dialects.v20.ardupilotmega", "telemetry logs"), (write_bin, "DFReader", "onboard logs")],
)
def test_without_pymavlink_the_sentence_names_the_extra(tmp_path, write, module, logs, monkeypatch):
    file = write(tmp_path / "dive")
    monkeypatch.setitem(sys.modules, f"pymavlink.{module}", None)

    with pytest.raises(UsageError, match=rf"dive: {logs} need pymavlink: pip install 'usbldr\[mavlink\]'$"):
        open_reader(file)


def foreign(payload: bytes) -> bytes:
    """Return a packet of another dialect, whose definition has the byte 77."""
    head = bytes([0xFD, len(payload), 0, 0, 7, 1, 1]) + b"\xff\xff\x7f"
    checksum = x25crc(head[1:] + payload + bytes([77])).crc
    return struct.pack(">Q", T0 // 1000) + head + payload + struct.pack("<H", checksum)


def test_a_packet_of_another_dialect_is_a_topic_that_cannot_be_read(tmp_path: Path) -> None:
    parts = packets()
    log = open_reader(saved(tmp_path / "a.tlog", b"".join([parts[0], foreign(b"ab"), *parts[1:]])))

    problems = {topic.name: topic.problem for topic in log.topics() if topic.problem}
    assert problems == {"mavlink/1/1/UNKNOWN_8388607": "its message 8388607 is not in the dialect ardupilotmega"}
    (finding,) = log.findings()
    assert finding.text == (
        f"1 messages, from byte {len(parts[0])} on, are not in the dialect ardupilotmega, or damaged; not read"
    )


def test_an_onboard_log_has_the_values_of_pymavlink_and_is_a_dive(tmp_path: Path) -> None:
    file = write_bin(tmp_path / "00000001.BIN")
    log = open_reader(file)
    oracle: dict[str, list[Any]] = {}
    reader: Any = DFReader.DFReader_binary(str(file))
    while (message := reader.recv_match(type=["ATT", "GPS", "BARO", "VISO", "MSG"])) is not None:
        name = message.get_type()
        instance = f"[{message.I}]" if name in ("GPS", "BARO") else ""
        oracle.setdefault(name.partition("[")[0] + instance, []).append(message)
    reader.close()
    topics = {topic.name: topic for topic in log.topics() if topic.name != "FMTU"}

    assert {name: topic.count for name, topic in topics.items()} == {name: len(found) for name, found in oracle.items()}
    for name, topic in topics.items():
        records = read_whole(log, {name: topic.fields})[name]
        for path in topic.fields:
            values = [getattr(message, path) for message in oracle[name]]
            texts = isinstance(values[0], str)
            assert records.columns[path].tolist() == (values if texts else pytest.approx(values, rel=1e-15))
    times = [message._timestamp for message in oracle["ATT"]]
    np.testing.assert_allclose(read_whole(log, {"ATT": ["Yaw"]})["ATT"].received_ns / 1e9, times, rtol=0, atol=1e-5)
    assert log.findings() == ()

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
    log = open_reader(write_bin(tmp_path / "a.BIN", onboard(gps=False)))

    assert read_whole(log, {"ATT": ["Yaw"]})["ATT"].received_ns[:2].tolist() == [5 * SECOND, 6 * SECOND]


@pytest.mark.parametrize("rest", [b"\0" * 300, b"\xff" * 300])
def test_the_unused_end_of_a_page_is_no_loss(tmp_path: Path, rest: bytes) -> None:
    assert open_reader(write_bin(tmp_path / "a.BIN", [*onboard(), rest])).findings() == ()


def test_a_time_beyond_reason_is_left_out_and_reported(tmp_path: Path) -> None:
    log = open_reader(write_bin(tmp_path / "a.BIN", [*onboard(), row(130, "QccffC", 1 << 63, 0, 0, 0, 0, 0)]))

    assert next(topic.count for topic in log.topics() if topic.name == "ATT") == COUNT
    (finding,) = log.findings()
    assert finding.text == "1 messages have an impossible time; left out"


def test_a_file_without_one_message_is_one_sentence(tmp_path: Path) -> None:
    with pytest.raises(LogError, match=r"holds no messages \(63 of 63 bytes, from byte 0 on, are damaged or cut"):
        read_log(saved(tmp_path / "a.tlog", packets()[0][:-1]))
    assert "holds no messages" in refusal(LogError, read_log, saved(tmp_path / "a.BIN", onboard()[0]))


@pytest.mark.filterwarnings("error")  # of a file that is left open
def test_a_damaged_layout_is_one_sentence_and_the_file_is_closed(tmp_path: Path) -> None:
    file = write_bin(tmp_path / "a.BIN", [b"".join(onboard()).replace(b"QccffC", b"Qcc?fC")])

    with pytest.raises(LogError, match=r"cannot be read as an onboard log: damaged \(Unsupported format char"):
        open_reader(file).topics()
    gc.collect()


def dive() -> list[Row]:
    rows: list[Row] = []
    for k in range(20):
        t = T0 + k * SECOND
        yaw = math.radians((350 + 2 * k + 180) % 360 - 180)
        rows += [delta(t, 1 + k / 10, -0.5, 0.0 if k == 3 else 90.0)]
        rows += [(t, "ATTITUDE", {"time_boot_ms": 1000 * k, "roll": 0.0, "pitch": 0.0, "yaw": yaw})]
        fix = "NO_FIX" if k == 5 else "3D_FIX"
        place = {"lat": 476176249 + k, "lon": -1223610207, "h_acc": 1500 if k else 0}
        rows += [(t, "GPS_RAW_INT", {"fix_type": {"type": f"GPS_FIX_TYPE_{fix}"}, **place})]
        hdg = 65535 if k == 2 else 100 * k
        rows += [(t, "GLOBAL_POSITION_INT", {"lat": 476176249, "lon": -1223610207, "hdg": hdg})]
        rows += [(t, "SCALED_PRESSURE", {"press_abs": 1013.25}), (t, "SCALED_PRESSURE2", {"press_abs": 2018.456})]
        rows += [(t, "VFR_HUD", {"alt": -10.0, "heading": 3 * k}), (t, "HEARTBEAT", {"base_mode": {"bits": 81}})]
        rows += [(t, "AHRS2", {"yaw": 0.5}), (t, "GPS_INPUT", {"fix_type": {"type": "GPS_FIX_TYPE_3D_FIX"}, **place})]
    return rows


@pytest.mark.parametrize("name", ["", "mavlink"])
def test_a_recording_of_blueos_is_read_by_its_types(tmp_path: Path, name: str) -> None:
    log = read_log(write_blueos(tmp_path / "dive.mcap", dive(), name))

    topics = {role: provenance.topic for role, provenance in log.provenance.items()}
    assert topics == {
        "dvl": "mavlink/255/0/VISION_POSITION_DELTA",
        "compass": "mavlink/1/1/ATTITUDE",
        "gps": "mavlink/1/1/GPS_RAW_INT",
        "depth": "mavlink/1/1/SCALED_PRESSURE2",
    }
    dvl, gps = log.tables["dvl"], log.tables["gps"]
    np.testing.assert_allclose(dvl["forward_mps"], 1 + np.arange(20) / 10, rtol=1e-12)
    np.testing.assert_allclose(dvl["starboard_mps"], -0.5, rtol=1e-12)
    np.testing.assert_allclose(dvl["up_mps"], -0.05, rtol=1e-12)
    assert dvl["valid"].tolist() == [k != 3 for k in range(20)]
    np.testing.assert_allclose(log.tables["compass"]["heading_deg"], (350 + 2 * np.arange(20)) % 360, atol=1e-9)
    np.testing.assert_allclose(log.tables["depth"]["depth_m"], (201845.6 - 101325) / (1025 * 9.80665), rtol=1e-12)
    assert len(gps) == 19
    assert gps["sd_m"].tolist()[1:] == pytest.approx([1.5] * 18)
    assert (log.origin.lat_deg, log.origin.lon_deg) == pytest.approx((47.6176249, -122.3610207), abs=1e-12)


def test_estimates_of_the_autopilot_are_used_if_named(tmp_path: Path) -> None:
    file = write_blueos(tmp_path / "dive.mcap", dive())
    prefix = "mavlink/1/1/"

    named = {"compass": f"{prefix}GLOBAL_POSITION_INT", "usbl": f"{prefix}GPS_INPUT", "depth": f"{prefix}VFR_HUD"}
    log = read_log(file, Request(topics=named))
    assert log.tables["compass"]["heading_deg"].tolist() == [k for k in range(20) if k != 2]
    assert log.tables["depth"]["depth_m"].tolist() == [10.0] * 20
    assert len(log.tables["usbl"]) == 20
    for topic, heading_deg in (("AHRS2", math.degrees(0.5)), ("VFR_HUD", 3.0)):
        log = read_log(file, Request(topics={"compass": prefix + topic}))
        assert log.tables["compass"]["heading_deg"].iloc[1] == pytest.approx(heading_deg)


def test_distances_over_no_interval_are_invalid(tmp_path: Path) -> None:
    rows = [delta(T0 + k * SECOND, 1.0, 0.0) for k in range(3)]
    rows[1][2]["time_delta_usec"] = 0  # type: ignore[index]
    log = read_log(write_blueos(tmp_path / "dive.mcap", rows))

    assert log.tables["dvl"]["valid"].tolist() == [True, False, True]


def test_velocities_in_earth_axes_are_refused(tmp_path: Path) -> None:
    rows: list[Row] = [(T0, "VISION_SPEED_ESTIMATE", {"x": 1.0, "y": 0.0, "z": 0.0})]
    file = write_blueos(tmp_path / "dive.mcap", rows)

    with pytest.raises(UsageError, match="it holds velocities in earth axes; let the DVL send VISION_POSITION_DELTA"):
        read_log(file)
    assert [topic.name for topic in open_reader(file).topics()] == ["mavlink/255/0/VISION_SPEED_ESTIMATE"]
    assert "no topic /x" in refusal(LogError, read_log, file, Request(topics={"dvl": "/x"}))
