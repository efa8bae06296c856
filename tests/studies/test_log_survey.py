"""`make logs`: what is taken from the commands' words, on made-up words and on one small log."""

from pathlib import Path

import pytest

from checkout import SAMPLES
from logs import survey_tables as tables
from logs.survey_runs import Said, Surveyed, commands, field_logs, other_files, survey


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder of logs that holds one text, and one broken file among the odd ones."""
    (tmp_path / "logs" / "reader_zoo").mkdir(parents=True)
    (tmp_path / "logs" / "reader_zoo" / "01_words.mcap").write_text("words")
    (tmp_path / "scratch").mkdir()
    return tmp_path / "logs"


def test_a_fault_is_the_last_sentence_that_is_no_finding() -> None:
    err = "usbldr: d.mcap: /dvl: 3 records repeat [REPEATED]\nusbldr: d.mcap: no usbl data\n"

    assert Said("replay", "", 3, "", err).fault == "d.mcap: no usbl data"
    assert Said("replay", "", 0, "adf 1 m", err.splitlines()[0]).fault == ""


def test_a_warning_of_a_good_run_is_no_fault() -> None:
    warned = Said("replay", "", 0, "adf 1 m", "usbldr: adf: 12 of 20 USBL fixes look like outliers\n")

    assert warned.fault == ""
    assert tables.matter(warned, Surveyed("d.mcap")) == "adf 1 m"


@pytest.mark.parametrize(
    ("code", "err", "broke"),
    [(3, "usbldr: no log", False), (1, "", False), (1, "Traceback (most recent call last):", True), (-11, "", True)],
)
def test_a_traceback_or_a_crash_is_a_fault_of_the_program(code: int, err: str, broke: bool) -> None:
    assert Said("info", "", code, "", err).broke is broke


def test_doctors_findings_are_told_by_level_and_code() -> None:
    out = "a.mcap: MCAP\n\nerror   MAP-FRAME: /usbl: NED fits\ninfo    REPEATED: /dvl: 2\ninfo    REPEATED: /gps: 1\n"
    said = Said("doctor", "", 1, out, "")

    assert said.findings[0] == ("error", "MAP-FRAME", "/usbl: NED fits")
    assert tables.codes(said) == "error `MAP-FRAME`; info `REPEATED` ×2"


def test_what_init_leaves_to_the_user_is_told() -> None:
    out = '# CHECK: it may be FRD.\nschema = 1\n[dvl]\ntopic = "/dvl"\n[usbl]\ntopic = "/a"   # CHECK: or /b\n'

    told = tables.written(Said("init", "", 0, out, ""))

    assert told == 'wrote dvl, usbl; to be decided: CHECK: it may be FRD; topic = "/a" # CHECK: or /b'


def test_the_verdict_comes_with_the_codes_that_replay_said() -> None:
    err = "usbldr: d: one [REPEATED]\nusbldr: d: two [MAP-UNKNOWN]\nusbldr: d: three [REPEATED]\n"

    assert tables.verdict(Said("replay", "", 0, "adf 1.10 m\n", err)) == "adf 1.10 m (`REPEATED` `MAP-UNKNOWN`)"
    assert "held back" in tables.verdict(Said("replay", "", 0, "", ""))


def test_a_second_form_of_a_log_shows_only_what_differs() -> None:
    words = "usbldr: %s: 2 topics could be the usbl: /a (x%s/Pose)"
    heard = {
        Surveyed(name, "dive"): (
            Said("replay", "", 2, "", words % (name, kind)),
            Said("replay", "stated", 0, verdict, ""),
        )
        for name, kind, verdict in (("a.mcap", "/msg", "adf 1 m"), ("a.bag", "", "adf 1 m"), ("csv", "", "adf 2 m"))
    }

    page = tables.sections(heard)

    assert page.count("could be the usbl") == 1
    assert "### a.bag\n\nAll is word for word as of a.mcap." in page
    assert "adf 2 m" in page
    assert page.endswith("The rest is word for word as of a.mcap.")


def test_a_missing_finding_is_told_and_an_empty_quote() -> None:
    assert not any(tables.quote(one, {}) for one in tables.WANTED)
    assert tables.findings({}).count("not found") == len(tables.WANTED)


def test_every_log_of_a_vehicle_is_asked_and_judging_ones_are_held_back() -> None:
    logs = {log.name: log for log in field_logs()}

    assert len(logs) == 9
    assert {name for name, log in logs.items() if log.held_back} == {name for name in logs if name.startswith("mhkit")}
    assert logs["uib_field/csv"].configuration == "uib_field"


def test_an_odd_file_is_asked_everything_and_no_path_of_the_machine_is_kept(folder: Path) -> None:
    (odd,) = other_files(folder)

    heard = survey((odd,), folder, folder.parent / "scratch", jobs=1, held_back=False)[odd]

    assert odd.name == "reader_zoo/01_words.mcap"
    assert [(said.command, said.settings, said.code) for said in heard] == [
        ("info", "", 3), ("doctor", "", 3), ("init", "", 3), ("replay", "", 3), ("replay", "another log's", 3),
    ]  # fmt: skip
    assert not any(said.broke for said in heard)
    assert str(folder.parent) not in tables.others({odd: heard})
    assert "unknown format" in tables.others({odd: heard})
    assert tables.others({odd: heard}).count("the same") == 4


@pytest.mark.parametrize("shown", [True, False])
def test_a_verdict_is_kept_only_if_it_may_be_shown(tmp_path: Path, shown: bool) -> None:
    log = Surveyed("lawnmower_turn_db3")

    replays = [said for said in commands(log, SAMPLES, tmp_path, shown) if said.command == "replay"]

    assert replays[0].code == 0
    assert replays[0].out.startswith("adf ") is shown
    assert bool(replays[0].out) is shown
