"""Real logs by the configurations that were written for them: what reading says of them (numbers: test_expected)."""

from pathlib import Path

import pytest

from field.logs import HERE
from usbldr.filters.errors import UsageError
from usbldr.io.log import Log
from usbldr.io.reading.read import Request, read_log


def field_log(folder: Path, name: str) -> Log:
    return read_log(folder / name / f"{name}.mcap", Request(configuration=str(HERE / f"{name}.toml")))


def test_fixes_of_stpere_that_come_out_of_order_are_sorted_and_counted(field_logs: Path) -> None:
    log = field_log(field_logs, "stpere_marina")

    assert any(finding.text.startswith("/usbl/fix_synthetic: 144 of 3037") for finding in log.findings)
    assert log.tables["usbl"]["time_s"].is_monotonic_increasing


def test_two_modem_topics_are_no_choice_for_a_program(field_logs: Path) -> None:
    with pytest.raises(UsageError, match=r"/modem_delayed_acoustic .* /modem_raw .*--usbl TOPIC"):
        read_log(field_logs / "uib_field" / "uib_field.mcap", Request(configuration="none"))
