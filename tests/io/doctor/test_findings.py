"""Codes are stable and documented one by one."""

import re

from checkout import ROOT
from usbldr.filters.replay import position_fixes
from usbldr.io.findings import FINDING_LEVELS, Finding

DOCUMENT = (ROOT / "docs" / "findings.md").read_text(encoding="utf-8")
ROWS = re.findall(r"^\| (`[A-Z`, -]+`) \| (\w+)(?:, or \w+)? \|", DOCUMENT, re.MULTILINE)
DOCUMENTED = {code: level for codes, level in ROWS for code in re.findall(r"[A-Z-]+", codes)}


def codes_in_the_sources() -> set[str]:
    sources = "\n".join(file.read_text(encoding="utf-8") for file in (ROOT / "io").rglob("*.py"))
    literal = re.findall(r'[Ff]inding\(\s*"([A-Z]+(?:-[A-Z]+)*)"', sources)
    tabled = re.findall(r'^\s+\(?"([A-Z]+-[A-Z-]+)"[:,]', sources, re.MULTILINE)
    return {*literal, *tabled, *FINDING_LEVELS}


def test_every_code_that_the_sources_use_is_documented() -> None:
    assert codes_in_the_sources() - set(DOCUMENTED) == set()


def test_no_code_is_documented_that_does_not_exist() -> None:
    made_from_a_sensor = {f"{sensor}-INVALID" for sensor in ("DVL", "COMPASS", "USBL", "GPS", "DEPTH")}
    made_from_a_sensor |= {f"{sensor}-CLOCK" for sensor in ("DVL", "COMPASS")}
    chosen_by_a_condition = {"HEADING-BIAS", "DVL-MOUNT", "HEADING-CHECKED", "LOST-LOCK", "OUTAGE"}
    chosen_by_a_condition |= {"LEVER-OR-LATENCY", "RIVAL-EXPLANATIONS"}
    elsewhere = made_from_a_sensor | chosen_by_a_condition | {position_fixes.RIVALS}
    assert set(DOCUMENTED) - codes_in_the_sources() - elsewhere == set()


def test_levels_are_as_documented() -> None:
    by_what_was_lost = {"TRUNCATED", "DAMAGED", "CHECKSUM", "MISSING-PART", "UNDECODED", "NOT-READ", "NMEA-CHECKSUM"}
    by_what_was_lost |= {"TOPIC-UNREAD", "TOPIC-TYPES"}
    for code in DOCUMENTED.keys() - by_what_was_lost:
        assert FINDING_LEVELS.get(code, "warning") == DOCUMENTED[code], code


def test_a_finding_has_the_level_of_its_code_and_is_an_error_if_data_were_lost() -> None:
    assert Finding("TRUNCATED", "the file ends early", lost_data=True).level == "error"
    assert Finding("TRUNCATED", "the index is missing").level == "warning"
    assert Finding("REPEATED", "/dvl: 3 of 9 records are repeated", "/dvl").level == "info"
