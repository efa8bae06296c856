"""The doctor on field logs: what their collectors found by hand, found from the log alone."""

from pathlib import Path

import numpy as np
import pytest

from checkout import FIELD_CONFIGURATIONS
from commands import findings, run
from usbldr.filters.errors import UsbldrError
from usbldr.io.decoding.collected import read_whole
from usbldr.io.recordings.mcap_log import McapLog

LOGS = [
    "uib_field/uib_field.mcap",
    "uib_simulation/uib_simulation.mcap",
    "stpere_marina/stpere_marina.mcap",
    "mhkit_riverpro/mhkit_riverpro.mcap",
    "mhkit_tanana/tanana_002.mcap",
    "mhkit_tanana/tanana_003.mcap",
]


@pytest.mark.long
def test_the_faults_of_uib_field_are_found_without_being_told(field_logs: Path) -> None:
    found = findings(field_logs / "uib_field" / "uib_field.mcap", "--config", "none")

    assert "/dvl: 2707 of 5422 records repeat" in found["REPEATED"]["text"]
    assert 'state convention = "NED" under [compass]' in found["HEADING-CONVENTION"]["text"]
    assert 'state frame = "NED" under [usbl]' in found["MAP-FRAME"]["text"]
    assert "excluded by: gravity" in found["MAP-FRAME"]["text"]
    assert "DVL-AXES" not in found
    assert 135.0 <= found["DVL-MOUNT"]["worst"] <= 141.0
    assert found["USBL-DELAYED"]["worst"] == pytest.approx(5.98, abs=0.01)
    assert found["DVL-LEVER"]["worst"] == pytest.approx(0.87, abs=0.1)  # so that fixes are not early by 2.6 s
    assert "USBL-LATENCY" not in found
    assert "13 of 591 fixes" in found["USBL-OUTLIERS"]["text"]
    assert found["USBL-OUTLIERS"]["worst"] == pytest.approx(31.0, abs=1.0)


@pytest.mark.long
def test_the_faults_of_stpere_are_found_without_being_told(field_logs: Path) -> None:
    found = findings(field_logs / "stpere_marina" / "stpere_marina.mcap", "--config", "none")

    assert "84 have the no-bottom-lock value 327.67 m/s" in found["DVL-INVALID"]["text"]
    assert found["DVL-INVALID"]["worst"] == pytest.approx(327.67)
    assert found["DVL-MOUNT"]["worst"] == pytest.approx(-20.0, abs=2.0)
    assert "excluded by: GPS" in found["CONVENTION-CHECKED"]["text"]
    assert {"HEADING-CONVENTION", "MAP-FRAME", "DVL-AXES", "CONVENTION-UNDECIDED"}.isdisjoint(found)
    assert "USBL-LATENCY" not in found  # the synthetic fixes are stamped when they were true


@pytest.mark.long
def test_the_heading_of_stpere_is_biased_by_six_degrees_at_its_nominal_mounting(field_logs: Path) -> None:
    config = str(FIELD_CONFIGURATIONS / "stpere_marina.toml")

    found = findings(field_logs / "stpere_marina" / "stpere_marina.mcap", "--config", config)

    assert found["HEADING-BIAS"]["worst"] == pytest.approx(6.0, abs=2.0)
    assert all(one["level"] != "error" for one in found.values())


@pytest.mark.parametrize("name", ["tanana_002", "tanana_003"])
@pytest.mark.long
def test_the_lost_bottom_lock_of_tanana_is_found(field_logs: Path, name: str) -> None:
    """Without lock the record is NaN; one of the logs ends in its longest loss."""
    log = McapLog(field_logs / "mhkit_tanana" / f"{name}.mcap")
    columns = read_whole(log, {"/adcp/bottom_track": ["header.stamp", "twist.twist.linear.x"]})[
        "/adcp/bottom_track"
    ].columns
    locked_s = columns["header.stamp"][np.isfinite(columns["twist.twist.linear.x"])] / 1e9
    last_s = max(topic.last_ns or 0 for topic in log.topics()) / 1e9

    found = findings(field_logs / "mhkit_tanana" / f"{name}.mcap", "--config", "none")["LOST-LOCK"]

    assert found["worst"] == pytest.approx(np.max(np.diff([*locked_s, last_s])), abs=2.5)  # the end by another sensor
    assert found["worst"] > 70.0


@pytest.mark.parametrize("log", LOGS)
@pytest.mark.long
def test_what_init_writes_for_a_field_log_replays_and_leaves_no_error(field_logs, tmp_path, log):
    config = tmp_path / "found.toml"
    options = ["--config", str(config), "--filter", "dr", "--output", str(tmp_path / "run"), "--truth", "none"]

    wrote = run("init", str(field_logs / log), "--output", str(config))
    replayed = run("replay", str(field_logs / log), *options)

    assert wrote.exception is None, wrote.exception
    assert (replayed.exception, replayed.return_value) == (None, 0)
    assert all(one["level"] != "error" for one in findings(field_logs / log, "--config", str(config)).values())


@pytest.mark.long
def test_no_odd_file_of_others_ends_in_a_traceback(field_logs: Path, tmp_path: Path) -> None:
    """None of them is a dive: each ends in an error finding or in a sentence."""
    files = sorted(file for file in (field_logs / "reader_zoo").iterdir() if file.name[0].isdigit())
    assert len(files) == 29
    for file in files:
        examined = run("doctor", str(file))
        draft = tmp_path / f"{file.stem}.toml"
        wrote = run("init", str(file), "-o", str(draft))

        assert examined.return_value == 1 or isinstance(examined.exception, UsbldrError), file
        assert isinstance(wrote.exception, UsbldrError), file
        assert not draft.exists() or "CHECK" in draft.read_text(encoding="utf-8"), file
