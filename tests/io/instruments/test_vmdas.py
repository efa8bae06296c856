"""Files of VmDas (.ENR, .ENX, .STA, .LTA): PD0 ensembles that hold positions, and may lack bottom track.

They are written by the tables of its User's Guide, whose bytes count from 1.
"""

import random
from collections.abc import Mapping
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from dvl_recordings import pd0_ensemble
from logs import read_as
from recordings import SECOND, saved
from usbldr.io.decoding.collected import read_whole
from usbldr.io.formats.detect import open_reader
from usbldr.io.reading.read import read_log

COUNT = 40
ZONE_S = -7 * 3600  # the clock of computer and instrument is that of a time zone
NAVIGATION_BYTES = 94  # 78 in the guide, and 16 more that VmDas writes
PLACES: Mapping[str, tuple[int, int]] = {  # of the first and the last byte
    "day": (3, 3), "month": (4, 4), "year": (5, 6), "first": (7, 10), "offset": (11, 14),
    "first latitude": (15, 18), "first longitude": (19, 22), "last": (23, 26),
    "latitude": (27, 30), "longitude": (31, 34), "flags": (47, 48),
}  # fmt: skip


def navigation(**fields: int) -> bytes:
    """Return a block of navigation; other bytes are 0x55."""
    block = bytearray(b"\x00\x20" + b"\x55" * (NAVIGATION_BYTES - 2))
    for name, value in fields.items():
        first, last = PLACES[name]
        block[first - 1 : last] = value.to_bytes(last - first + 1, "little", signed=value < 0)
    return bytes(block)


def fix(utc_s: int, flags: int = 0b110_0110_0011) -> bytes:
    """Return the navigation whose last fix is so many seconds after the midnight of 2020-08-19, at 48.125 N, 123 W.

    An angle of 180 degrees is 2^31.
    """
    day, of_day = divmod(utc_s, 86_400)
    north, west = round(48.125 / 180 * 2**31), -round(123 / 180 * 2**31)
    clock = {"day": 19 + day, "month": 8, "year": 2020, "first": of_day * 10_000 - 5_000, "last": of_day * 10_000}
    place = {"latitude": north + utc_s % 1000, "longitude": west, "flags": flags}
    return navigation(**clock, **place, offset=ZONE_S * 1000)


def leaders(local_s: int, heading_cdeg: int) -> list[bytes]:
    """Return the leaders of an ensemble so many seconds after the midnight of 2020-08-19 of its own clock."""
    hour, minute, second = local_s // 3600, local_s // 60 % 60, local_s % 60
    variable = bytearray(b"\x80" + bytes(64))
    variable[4:11] = bytes([20, 8, 19, hour, minute, second, 25])
    variable[18:20] = heading_cdeg.to_bytes(2, "little")
    return [bytes(59), bytes(variable)]


def write_enx(file: Path, first_utc_s: int = 50_220) -> Path:
    """Write ensembles of each second without bottom track, each a quarter of a second after its last fix."""
    blocks = ((*leaders(first_utc_s + k + ZONE_S, 23_405 + k), fix(first_utc_s + k)) for k in range(COUNT))
    return saved(file, *(pd0_ensemble(*parts) for parts in blocks))


MIDNIGHT = 1_597_795_200 * SECOND  # 2020-08-19
STAMP = "header.stamp"


def test_positions_have_the_utc_of_the_last_fix_and_headings_the_instruments_clock(tmp_path: Path) -> None:
    log = open_reader(write_enx(tmp_path / "a.ENX"))
    found = read_whole(log, {"/navigation": [STAMP, "latitude", "longitude", "valid"], "/heading": ["heading_deg"]})
    places, heading = found["/navigation"], found["/heading"]

    assert log.format == "PD0"
    assert [topic.name for topic in log.topics()] == ["/heading", "/navigation"]
    assert log.findings() == ()
    seconds = MIDNIGHT + (50_220 + np.arange(COUNT)) * SECOND
    np.testing.assert_array_equal(places.columns[STAMP], seconds)
    np.testing.assert_array_equal(places.received_ns, seconds + ZONE_S * SECOND + SECOND // 4)
    north = np.array([48.125 + (50_220 + k) % 1000 * 180 / 2**31 for k in range(COUNT)])
    np.testing.assert_allclose(places.columns["latitude"], north, rtol=0, atol=1e-7)
    np.testing.assert_allclose(places.columns["longitude"], -123.0, rtol=0, atol=1e-7)
    assert places.columns["valid"].tolist() == [1] * COUNT
    np.testing.assert_array_equal(heading.received_ns, places.received_ns)
    np.testing.assert_allclose(heading.columns["heading_deg"], 234.05 + np.arange(COUNT) / 100)


def test_the_clock_of_a_time_zone_is_brought_to_that_of_the_headings(tmp_path: Path) -> None:
    file = write_enx(tmp_path / "a.ENX")
    log, of_ensembles = read_log(file), read_as(file, '[gps]\ntime = "log"\n')

    np.testing.assert_allclose(log.tables["gps"]["time_s"], log.tables["compass"]["time_s"], atol=0.5)
    assert "CLOCK-SHIFTED" in {finding.code for finding in log.findings}
    np.testing.assert_array_equal(of_ensembles.tables["gps"]["time_s"], of_ensembles.tables["compass"]["time_s"])


def test_fixes_without_a_valid_position_or_time_are_marked(tmp_path: Path) -> None:
    flags = [0b10_0010, 0b10_0000, 0b00_0010, 0]
    parts = [pd0_ensemble(*leaders(k, k), fix(k + 1, flags=flag)) for k, flag in enumerate(flags)]
    parts.append(pd0_ensemble(*leaders(9, 9), navigation(day=0, month=0, year=0)))  # before the first fix
    places = read_whole(open_reader(saved(tmp_path / "a.STA", b"".join(parts))), {"/navigation": ["valid"]})[
        "/navigation"
    ]
    assert places.columns["valid"].tolist() == [1, 0, 0, 0]


def test_a_last_fix_before_the_first_is_of_the_next_day(tmp_path: Path) -> None:
    block = navigation(day=31, month=12, year=2020, first=863_990_000, last=10_000, latitude=1, longitude=1, flags=34)
    (tmp_path / "a.LTA").write_bytes(b"".join([pd0_ensemble(*leaders(k, k), block) for k in range(2)]))

    stamps = read_whole(open_reader(tmp_path / "a.LTA"), {"/navigation": [STAMP]})["/navigation"].columns[STAMP]
    assert set(stamps.tolist()) == {int(np.datetime64("2021-01-01T00:00:01", "ns").astype(np.int64))}


def test_an_ensemble_without_data_is_left_out_and_counted(tmp_path: Path) -> None:
    head = b"\x7f\x7f\6\0\0\0"
    empty = head + sum(head).to_bytes(2, "little")
    log = open_reader(saved(tmp_path / "a.ENX", empty + write_enx(tmp_path / "b.ENX").read_bytes()))

    assert [topic.count for topic in log.topics()] == [COUNT, COUNT]
    assert [finding.text for finding in log.findings()] == ["1 ensembles have no leader or no valid time; left out"]


def test_clocks_are_times_of_the_calendar_and_others_are_left_out(tmp_path: Path) -> None:
    rng = random.Random(4)
    clocks = [[rng.randrange(n) for n in (100, 14, 33, 25, 61, 61, 100)] for _ in range(400)]
    clocks += [[20, 2, 29, 0, 0, 0, 0], [21, 2, 29, 0, 0, 0, 0], [0, 2, 29, 23, 59, 59, 99], [79, 12, 31, 1, 2, 3, 4]]
    expected: list[int] = []
    for year, *clock, hundredths in clocks:
        with suppress(ValueError):
            moment = datetime(year + (2000 if year < 80 else 1900), *clock, tzinfo=UTC)
            expected.append(int(moment.timestamp()) * SECOND + hundredths * SECOND // 100)
    parts: list[bytes] = []
    for k, clock in enumerate(clocks):
        fixed, variable = leaders(0, k)
        parts.append(pd0_ensemble(fixed, variable[:4] + bytes(clock) + variable[11:], fix(k)))
    log = open_reader(saved(tmp_path / "a.ENX", *parts))
    found = read_whole(log, {"/heading": ["heading_deg"], "/navigation": ["latitude"]})

    assert found["/heading"].received_ns.tolist() == expected
    assert found["/navigation"].received_ns.tolist() == expected
    lost = len(clocks) - len(expected)
    said = f"{lost} ensembles have no leader or no valid time; left out"
    assert [finding.text for finding in log.findings()] == [said]
