"""PD4 and PD5 files: values by the book, days, damage."""

from datetime import date
from pathlib import Path

import numpy as np
import pytest

from logs import only, read_as, texts
from pd45_recordings import COUNT, pd45_ensemble, pd45_ensembles, write_pd45
from recordings import SECOND, T0, saved, short_dive, write_mcap
from usbldr.filters.errors import LogError, UsageError
from usbldr.io.decoding.collected import read_whole
from usbldr.io.formats.detect import open_reader
from usbldr.io.reading.opening import Request, open_configured
from usbldr.io.reading.read import read_log

FIRST = 44_740_500_000_000  # [ns] 12:25:40.50


def dated(file: Path, day: str = "2020-09-13") -> Path:
    file.with_name("usbldr.toml").write_text(f'[[file]]\npath = "{file.name}"\ndate = {day}\n', encoding="utf-8")
    return file


@pytest.mark.parametrize(("form", "day"), [(4, "2020-09-13"), (5, "2020-09-13"), (4, "1970-01-01"), (4, "2115-12-31")])
def test_velocities_are_those_of_the_instrument_on_the_stated_day(tmp_path: Path, form: int, day: str) -> None:
    log = read_log(dated(write_pd45(tmp_path / "a.bin", form), day))
    dvl, days = log.tables["dvl"], (date.fromisoformat(day) - date(1970, 1, 1)).days

    assert log.format == f"PD{form}"
    assert log.start_ns == days * 86_400 * SECOND + FIRST
    np.testing.assert_array_equal(dvl["time_s"], np.arange(COUNT) / 2)
    assert dvl["valid"].tolist() == [k != 3 for k in range(COUNT)]
    good = dvl[dvl["valid"]]
    np.testing.assert_allclose(good["starboard_mps"], -0.25)
    np.testing.assert_allclose(good["forward_mps"], 1.5 + np.delete(np.arange(COUNT), 3) / 1000)
    np.testing.assert_allclose(good["up_mps"], 0.01)
    assert "NO-DATE" not in {finding.code for finding in log.findings}


def test_pd5_has_heading_and_depth_unless_its_heading_is_constant_and_pd4_has_neither(tmp_path: Path) -> None:
    log = read_log(write_pd45(tmp_path / "a.pd5", 5))

    np.testing.assert_allclose(log.tables["compass"]["heading_deg"], (355 + np.arange(COUNT) / 2) % 360)
    np.testing.assert_allclose(log.tables["depth"]["depth_m"], 10 + np.arange(COUNT) / 10)
    assert read_log(write_pd45(tmp_path / "a.pd4", 4)).tables.keys() == {"dvl"}

    parts = [pd45_ensemble(5, 100 * k, x=1, y=2, z=3, depth=0, heading=0) for k in range(COUNT)]
    assert [topic.name for topic in open_reader(saved(tmp_path / "a.pd5", b"".join(parts))).topics()] == [
        "/bottom_track"
    ]


def test_without_a_stated_day_it_is_the_first_of_1970_and_a_finding_names_the_key(tmp_path: Path) -> None:
    file = write_pd45(tmp_path / "a.pd4", 4)

    assert read_log(file).start_ns == FIRST
    text = "a.pd4: the times have no date; the first day is taken as 1970-01-01; "
    text += "state path and date of each file under [[file]]"
    assert only(read_log(file), "NO-DATE") == text
    assert texts(read_log(dated(file, "1970-01-01")), "NO-DATE") == []


def test_days_follow_each_other_at_midnight(tmp_path: Path) -> None:
    """From ten seconds before midnight on, with gaps of eleven hours past the next midnight."""
    late = [86_400 * 100 - 1000 + 100 * k for k in range(20)]
    hundredths = [h + hours * 360_000 for hours in (0, 11, 22, 33) for h in late]
    (tmp_path / "a.pd4").write_bytes(b"".join([pd45_ensemble(4, h, x=1, y=2, z=3) for h in hundredths]))

    times = read_whole(open_reader(tmp_path / "a.pd4"), {"/bottom_track": ["x"]})["/bottom_track"].received_ns
    np.testing.assert_array_equal(times, np.array(hundredths) * (SECOND // 100))


def test_the_day_holds_beside_other_files_of_the_dive(tmp_path: Path) -> None:
    write_pd45(tmp_path / "a.pd4", 4, first_hundredths=T0 % (86_400 * SECOND) // (SECOND // 100))
    dive = write_mcap(tmp_path / "dive.mcap", [row for row in short_dive() if row[1] != "/dvl"])
    log = read_as(dive, '[[file]]\npath = "a.pd4"\ndate = 2020-09-13\n')

    assert log.format == "MCAP + PD4"
    assert len(log.tables["dvl"]) == COUNT
    assert log.tables["dvl"]["time_s"].iloc[0] + log.start_ns / SECOND == pytest.approx(T0 / SECOND)


def test_a_day_that_is_missing_beside_dated_files_is_named_with_its_key(tmp_path: Path) -> None:
    file = write_pd45(tmp_path / "a.pd4", 4)
    later = [(time + 5 * 3600 * SECOND, topic, kind, fields) for time, topic, kind, fields in short_dive()]
    dive = write_mcap(tmp_path / "dive.mcap", [row for row in later if row[1] != "/dvl"])

    with pytest.raises(LogError, match=r"dvl 1970-.*; of files without dates, state path and date of each"):
        read_log(dive, Request(joined=(str(file),)))


def test_a_day_for_times_that_have_dates_is_refused(tmp_path: Path) -> None:
    log = dated(write_mcap(tmp_path / "dive.mcap", short_dive()))

    with pytest.raises(UsageError, match=r"dive.mcap: its times have dates; leave out date under \[\[file\]\]"):
        open_configured(log, Request())


@pytest.mark.parametrize(
    ("day", "why"),
    [
        ("2020-13-45", "is not valid TOML"),
        ('"yesterday"', r"\[file\[0\]\] date: expected a date, such as 2026-05-01"),
        ("2020-09-13T12:00:00Z", r"\[file\[0\]\] date: expected date, got datetime"),
        ("20200913", r"\[file\[0\]\] date: expected date, got number"),
        ("0001-01-01", "date must lie between 1970 and 2115"),
        ("9999-12-31", "date must lie between 1970 and 2115"),
    ],
)
def test_what_is_no_day_of_a_dive_is_refused_in_one_sentence(tmp_path: Path, day: str, why: str) -> None:
    with pytest.raises(UsageError, match=why) as fault:
        read_log(dated(write_pd45(tmp_path / "a.pd4", 4), day))
    assert "\n" not in str(fault.value)


@pytest.mark.parametrize("block", [1, 87, 88, 1000])
def test_ensembles_across_the_blocks_in_which_a_file_is_looked_through_are_whole(tmp_path, block, monkeypatch):
    parts = [b"\x7d" * 30, *pd45_ensembles(5), b"\x7d\x01\x56\x00" * 20]
    (tmp_path / "a.pd5").write_bytes(b"".join(parts[1:20] + parts[:1] + parts[20:]))
    monkeypatch.setattr("usbldr.io.instruments.ensembles.BLOCK_BYTES", block)
    log = open_reader(tmp_path / "a.pd5")

    assert log.topics()[0].count == COUNT
    assert "110 of 3630 bytes, from byte 1672 on, are damaged or cut" in log.findings()[0].text


def test_an_ensemble_at_no_time_of_day_is_left_out(tmp_path: Path) -> None:
    parts = pd45_ensembles(4)
    parts[7] = pd45_ensemble(4, 0, minute=60)
    log = open_reader(saved(tmp_path / "a.pd4", *parts))

    assert log.topics()[0].count == COUNT - 1
    assert "1 ensembles have no valid time; left out" in [finding.text for finding in log.findings()]


@pytest.mark.parametrize(("coordinates", "what"), [(0b00, "beam"), (0b11, "earth")])
def test_velocities_along_beams_and_in_earth_axes_are_refused(tmp_path: Path, coordinates: int, what: str) -> None:
    parts = [pd45_ensemble(4, 100 * k, x=1, y=2, z=3, **{"system config": coordinates << 6}) for k in range(COUNT)]
    with pytest.raises(LogError, match=rf"40 in {what} coordinates; velocities along beams or in earth axes cannot be"):
        read_log(saved(tmp_path / "a.pd4", *parts))
