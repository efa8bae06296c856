"""`make logs`: every command is asked, and what is known of a log is held against its words."""

from pathlib import Path

import pytest

from checkout import SAMPLES
from survey.study import CommandOutput, Surveyed, commands, surveyed


@pytest.mark.parametrize(
    ("code", "words", "broke"),
    [(3, "usbldr: no log", False), (1, "", False), (1, "Traceback (most recent call last):", True), (-11, "", True)],
)
def test_a_traceback_or_a_crash_is_a_fault_of_the_program(code: int, words: str, broke: bool) -> None:
    assert CommandOutput("info a.mcap", code, words).broke is broke


def test_a_finding_that_doctor_should_have_come_to_is_missed() -> None:
    command = "doctor stpere_marina/stpere_marina.mcap --config none"
    found = "error   DVL-INVALID: /dvl: 3 records\n"

    assert CommandOutput(command, 1, found).missed == ["DVL-MOUNT"]
    assert CommandOutput(command, 1, f"{found}warning DVL-MOUNT: 20°\n").missed == []
    assert CommandOutput("doctor another.mcap --config none", 0, "").missed == []


def test_every_log_of_a_vehicle_is_asked_and_judging_ones_are_held_back(tmp_path: Path) -> None:
    logs = {log.name: log for log in surveyed(tmp_path)}

    assert len(logs) == 9
    assert {name for name, log in logs.items() if log.held_back} == {name for name in logs if name.startswith("mhkit")}
    assert logs["uib_field/csv"].configuration == "uib_field"


def test_an_odd_file_is_asked_everything_and_no_path_of_the_machine_is_kept(tmp_path: Path) -> None:
    folder, scratch = tmp_path / "logs", tmp_path / "scratch"
    (folder / "reader_zoo").mkdir(parents=True)
    scratch.mkdir()
    (folder / "reader_zoo" / "01_words.mcap").write_text("words")
    odd = surveyed(folder)[-1]

    outputs = list(commands(odd, folder, scratch, replayed=True))

    assert odd.name == "reader_zoo/01_words.mcap"
    verbs = ["info", "doctor", "info", "doctor", "init", "replay", "replay"]
    assert [output.command.split()[0] for output in outputs] == verbs
    assert {output.code for output in outputs} == {3}
    assert not any(output.broke or str(tmp_path) in output.command + output.words for output in outputs)
    assert all("unknown format" in output.words for output in outputs)


@pytest.mark.parametrize("replayed", [True, False])
def test_a_log_is_replayed_only_if_its_errors_may_be_shown(tmp_path: Path, replayed: bool) -> None:
    log = Surveyed("lawnmower_turn_db3", "stpere_marina")

    replays = [output for output in commands(log, SAMPLES, tmp_path, replayed) if output.command.startswith("replay")]

    assert bool(replays) is replayed
    assert not replays or (replays[0].code == 0 and replays[0].words.startswith("adf: "))
