"""Files of several recordings, among other bytes, or without their beginning: all is read, or named as lost data."""

import re
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from damage import attempt, count, recorded
from damaged_formats import FORMATS
from recordings import short_dive, write_bag, write_mcap
from usbldr.io.formats.detect import open_reader

CONTAINERS = [form for form in FORMATS if form.startswith(("MCAP ", "bag", "rosbag2", "Parquet", "HDF5", ".mat"))]
SEARCHED = ("MCAP ", "bag", "rosbag2", "Parquet", "HDF5")  # known by a mark that is found behind other bytes
RESUMED = ("MCAP ", "bag")  # walked from record to record: another is found behind one that is cut
LONGEST = 400  # [bytes] of a record
junk = st.binary(min_size=1, max_size=600).map(
    lambda data: b"\7" + bytes(byte | 128 for byte in data) + b"\7"  # no mark of a format, for all have a letter
)


@pytest.mark.parametrize("form", [form for form in FORMATS if form not in ("Arrow", "workbook")])  # nobody joins these
@settings(max_examples=3)
@given(copies=st.integers(2, 4), zeros=st.sampled_from([0, 0, 7, 5000]))
def test_all_recordings_of_a_file_are_read(form: str, copies: int, zeros: int) -> None:
    with recorded(form) as (file, path, whole, once):
        file.write_bytes(bytes(zeros if form in CONTAINERS else 0).join([whole] * copies))

        at_same_times = form == ".alog"  # values of one time are one record
        for log in (open_reader(path), open_reader(file.parent)):
            assert at_same_times or count(log, form) == [copies * number for number in once]
            assert not any(finding.lost_data for finding in log.findings())


@pytest.mark.parametrize("form", CONTAINERS)
@settings(max_examples=3)
@given(other=junk, before=st.booleans())
def test_bytes_around_a_recording_are_named_and_the_recording_is_read(form: str, other: bytes, before: bool) -> None:
    with recorded(form) as (file, path, whole, once):
        file.write_bytes(other + whole if before and form.startswith(SEARCHED) else whole + other)

        log = open_reader(path)
        assert count(log, form) == once
        assert any(finding.lost_data for finding in log.findings())


@pytest.mark.parametrize("form", FORMATS)
@settings(max_examples=3)
@given(data=st.data())
def test_a_recording_behind_one_that_is_cut_is_read_or_the_loss_is_named(form: str, data: st.DataObject) -> None:
    with recorded(form) as (file, path, whole, once):
        cut = data.draw(st.integers(9, len(whole) - 1))
        file.write_bytes(whole[:cut])
        alone, _ = attempt(path, form)
        file.write_bytes(whole[:cut] + whole)
        found, said = attempt(path, form)

        at_same_times = form == ".alog"
        together = [a + b for a, b in zip(alone, once, strict=True)]
        assert said or at_same_times or all(a >= b for a, b in zip(found, together, strict=True))
        if form.startswith(RESUMED):
            assert all(a >= b for a, b in zip(found, once, strict=True))


CAPTURES = [".tlog", "PD0", "PD4", "PD5", "PD6", "JSON lines", ".lsf", "NMEA", "lines of a DVL"]
"""Formats whose records need no beginning of their file."""


@pytest.mark.parametrize("form", FORMATS)
@settings(max_examples=6)
@given(data=st.data())
def test_a_capture_that_begins_within_a_record_is_read_from_the_next_one(form: str, data: st.DataObject) -> None:
    """Of the other formats all is read, or the loss is said; none is taken for another."""
    with recorded(form) as (file, _, whole, once):
        log = open_reader(file)
        kind, total = log.format, sum(topic.count for topic in log.topics())
        lost = data.draw(st.integers(1, len(whole) // 2))
        file.write_bytes(whole[lost:])
        found, said = attempt(file, form)

        assert all(a <= b for a, b in zip(found, once, strict=True))
        if form in CAPTURES:
            log, expected = open_reader(file), total * (len(whole) - lost) / len(whole) - 10  # [records] of all sizes
            assert log.format == kind
            assert expected <= sum(topic.count for topic in log.topics()) <= total
        else:
            assert said or found == once


def test_an_object_within_a_record_whose_beginning_is_lost_is_no_record() -> None:
    with recorded("JSON lines") as (file, _, whole, _):
        first, _, rest = whole.partition(b"\n")
        counts: list[int] = []
        for begun in (b"", b'{"id": 1}, {"id": 2}], ' + first[1:] + b"\n", b'e}, {"id": 2}], ' + first[1:] + b"\n"):
            file.write_bytes(begun + rest)
            counts.append(sum(topic.count for topic in open_reader(file).topics()))

        assert counts[0] == counts[1] == counts[2]
        assert any(finding.code == "UNDECODED" for finding in open_reader(file).findings())


@pytest.mark.parametrize("form", [".tlog", ".BIN", "PD0", "PD4", "PD5", ".lsf"])
@settings(max_examples=8)
@given(share=st.floats(0.1, 0.9))
def test_the_first_byte_that_is_lost_is_named(form: str, share: float) -> None:
    with recorded(form) as (file, path, whole, _):
        at = round(share * len(whole))
        file.write_bytes(whole[:at] + whole[at + 7 :])
        log = open_reader(path)
        count(log, form)
        places = [int(place) for one in log.findings() for place in re.findall(r"from byte (\d+) on", one.text)]

        assert abs(min(places) - at) <= LONGEST


def test_recordings_of_several_formats_in_one_file_are_read(tmp_path: Path) -> None:
    one, other = write_mcap(tmp_path / "a.mcap", short_dive()), write_bag(tmp_path / "a.bag", short_dive())
    one.write_bytes(one.read_bytes() + other.read_bytes())
    log = open_reader(one)

    assert log.format == "MCAP + ROS 1 bag"
    assert {topic.name: topic.count for topic in log.topics()} == {"/dvl": 22, "/imu": 22, "/usbl": 22}
    assert [finding.code for finding in log.findings()] == ["CONCATENATED"]
