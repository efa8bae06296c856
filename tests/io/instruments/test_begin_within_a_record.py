"""Captures that begin within a record, and files with an older or a shorter beginning: known by what follows."""

import json
import tempfile
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from damage import count
from damaged_formats import FORMATS
from dvl_recordings import COUNT, velocity
from usbldr.io.formats.detect import open_log
from usbldr.io.reading.read import read_log

CAPTURES = [".tlog", "PD0", "PD4", "PD5", "PD6", "JSON lines", ".lsf"]  # records that need no beginning of their file


@pytest.mark.parametrize("form", CAPTURES)
@settings(max_examples=8)
@given(data=st.data())
def test_a_capture_that_begins_within_a_record_is_read_from_the_next_one(form: str, data: st.DataObject) -> None:
    with tempfile.TemporaryDirectory() as name:
        file = FORMATS[form].write(Path(name))
        whole, log = file.read_bytes(), open_log(file)
        once, kind, total = count(log, form), log.format, sum(topic.count for topic in log.topics())
        lost = data.draw(st.integers(1, len(whole) // 2))
        file.write_bytes(whole[lost:])
        log = open_log(file)

        expected = total * (len(whole) - lost) / len(whole) - 10  # [records] their sizes differ
        assert log.format == kind
        assert all(a <= b for a, b in zip(count(log, form), once, strict=True))
        assert sum(topic.count for topic in log.topics()) >= expected


def test_reports_of_the_first_version_of_json_are_timed_one_after_the_other(tmp_path: Path) -> None:
    left_out = ("type", "time_of_validity", "time_of_transmission", "covariance")
    reports = ({k: v for k, v in velocity(k).items() if k not in left_out} for k in range(COUNT))
    lines = [json.dumps({**report, "time": 200.0, "format": "json_v1"}) for report in reports]
    (tmp_path / "dvl.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")

    log = read_log(tmp_path / "dvl.txt")

    assert log.format == "JSON lines"
    assert log.provenance["dvl"].used == COUNT - 1  # one is invalid
    assert log.tables["dvl"]["received_s"].diff().dropna().round(9).isin([0.2, 0.4]).all()
    assert [finding.code for finding in log.findings if finding.code == "NO-DATE"] == ["NO-DATE"]
