"""docs/constants.md, held to the code."""

import re
import runpy

import pytest

from checkout import ROOT

PAGE = (ROOT / "docs" / "constants.md").read_text(encoding="utf-8")
ROWS = [[cell.strip() for cell in line.split("|")[1:-1]] for line in PAGE.splitlines() if line.startswith("| `")]


def test_the_page_is_what_the_code_says() -> None:
    made = runpy.run_path(str(ROOT / ".ci" / "constants.py"))["page"]()

    assert made == PAGE, "make it anew: python .ci/constants.py > docs/constants.md"


def test_every_constant_has_a_unit_and_a_reason() -> None:
    assert [row for row in ROWS if not (len(row) == 6 and all(row))] == []


@pytest.mark.parametrize("folder", ["filters", "io", "usbldr_cli"])
def test_no_plain_number_of_a_module_is_left_out_unless_it_is_fixed(folder: str) -> None:
    listed = {(row[0].strip("`"), row[1]) for row in ROWS}
    for file in (ROOT / folder).rglob("*.py"):
        for name, comment in re.findall(r"^([A-Z][A-Z0-9_]{2,}) = [\d.][\d._e-]*(.*)$", file.read_text(), re.MULTILINE):
            there = (file.relative_to(ROOT).as_posix(), name) in listed
            assert there != ("# fixed" in comment), (file, name)
