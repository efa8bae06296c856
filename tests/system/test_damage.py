"""Files of all formats, cut at any byte or with flipped bits, counted: nothing is lost or wrong without a word.

`make fuzz` takes 1000 cuts and 1000 flips of each format and writes the table of docs/broken_files.md.
"""

import re
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from checkout import ROOT
from damage import DAMAGES, MARKERS, broken_promises, counted
from damaged_formats import COUNT, FORMATS, dive


@pytest.mark.parametrize("kind", DAMAGES)
@pytest.mark.parametrize("form", FORMATS)
def test_no_damage_goes_unsaid(tmp_path: Path, form: str, kind: str) -> None:
    assert broken_promises(form, kind, counted(form, kind, 25, tmp_path)) == []


def test_what_goes_unsaid_breaks_a_promise() -> None:
    found = Counter({"tracebacks": 1, "silently short": 2, "silently wrong": 3})

    assert broken_promises("CSV", "flips", found) == ["CSV, flips: 1 tracebacks"]
    assert len(broken_promises("CSV", "cuts", found)) == len(broken_promises("PD0", "flips", found)) == 3


def test_the_page_counts_every_format() -> None:
    text = (ROOT / "docs" / "broken_files.md").read_text(encoding="utf-8")
    table = text.partition(MARKERS[0])[2].partition(MARKERS[1])[0]

    assert re.findall(r"^\| ([^|]+) \|[^|]*\| \d", table, re.MULTILINE) == list(FORMATS)


def test_the_numbers_of_the_dive_all_differ() -> None:
    values = [row[3].get("twist.linear.x", row[3].get("point.x", row[3].get("orientation.z"))) for row in dive()]

    assert len(np.unique([round(float(value or 0.0), 12) for value in values])) > COUNT * 2
