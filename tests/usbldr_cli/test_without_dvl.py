"""A log of USBL fixes without a DVL, or without a compass: its raw fixes can be judged."""

import json
from pathlib import Path

import pytest

from commands import findings, output_of, run
from curved import curved_dive
from logs import MAP
from recordings import write_mcap
from usbldr.filters.errors import LogError

ADVICE = "--filter usbl judges the raw fixes"


@pytest.fixture(params=["/dvl", "/imu"])
def log(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """A dive without one of the two topics."""
    return write_mcap(tmp_path / "dive.mcap", [row for row in curved_dive(gps=True) if row[1] != request.param])


def test_the_raw_fixes_have_the_errors_of_the_whole_log(log: Path, tmp_path: Path) -> None:
    whole = write_mcap(tmp_path / "whole.mcap", curved_dive(gps=True))
    errors: list[float] = []
    for one in (log, whole):
        (tmp_path / f"{one.stem}.usbldr.toml").write_text(MAP, encoding="utf-8")
        reported = json.loads(output_of("replay", one, "-f", "usbl", "--json", "-o", tmp_path / one.stem))
        errors.append(reported["metrics"]["mean_horizontal_m"])

    assert errors[0] == pytest.approx(errors[1], abs=1e-9)


def test_what_needs_the_sensor_says_so_and_what_still_works(log: Path) -> None:
    fault = run("replay", log, "-f", "adf").exception

    assert isinstance(fault, LogError)
    assert ADVICE in str(fault)
    assert ADVICE in run("info", log).stdout
    found = findings(log)
    assert ADVICE in found["SENSOR-MISSING"]["text"]
    assert found["SENSOR-MISSING"]["level"] == "error"


def test_init_asks_for_the_sensor_in_a_file_with_which_the_fixes_are_judged(log: Path, tmp_path: Path) -> None:
    fault = run("init", log).exception
    missing = next(role for role in ("dvl", "compass") if f"no topic is known to be {role};" in str(fault))

    text = (tmp_path / "dive.usbldr.toml").read_text(encoding="utf-8")
    assert isinstance(fault, LogError)
    assert text.count('topic = "none"') == 1  # the depth
    assert "without it, only --filter usbl works" in text
    assert "usbl: mean horizontal error" in output_of("replay", log, "-f", "usbl", "-q", "-o", tmp_path / "run")
    output_of("init", log, f"--{missing}", "none", "--force")
