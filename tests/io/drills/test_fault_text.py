"""Faults as text: what is wrong with it is said in one sentence, with an example."""

from pathlib import Path

import pytest

from logs import refusal
from usbldr.filters.errors import UsageError
from usbldr.io.drills.drill import Drill
from usbldr.io.drills.fault_text import Fault, Span, fault_of
from usbldr.io.drills.finding_codes import NAMED_BY, is_named
from usbldr.io.drills.kinds import KINDS
from usbldr.io.drills.suite import STANDARD, read_suite


def test_a_fault_has_a_sensor_an_amount_and_places() -> None:
    text = "compass:-1.5e1deg@0.02@10%:+60,300:400"
    spans = (Span(0.1, 0.0, 0.0, 60.0, end_after_start=True), Span(0.0, 300.0, 0.0, 400.0))
    assert fault_of("spike", text) == Fault("spike", "compass", -15.0, spans, 0.02, False, f"spike {text}")
    assert fault_of("spike", "compass:120@one").one
    assert fault_of("drop", "dvl@20:").spans[0].seconds(100.0)[1] == float("inf")


@pytest.mark.parametrize(
    ("kind", "text", "reported"),
    [
        ("melt", "usbl", "there is no fault 'melt'"),
        ("drop", "sonar@1:2", "write a sensor of compass, dvl, usbl"),
        ("drop", "usbl", "needs a span FROM:TO or a share"),
        ("drop", "usbl:3@1:2", "takes no number"),
        ("drop", "usbl@2:1", "must end after its start"),
        ("drop", "usbl@1:2:3", "is not a span"),
        ("drop", "usbl@1:+5%", "is not a span"),
        ("drop", "usbl@1+5:10", "is not a span"),
        ("drop", "usbl@1.5", "must be above 0 and at most 1"),
        ("drop", "usbl@soon", "neither a share"),
        ("spike", "compass@0.1", "needs a number in deg"),
        ("spike", "compass:3m@0.1", "is not a number in deg"),
        ("spike", "compass:3deg", 'needs a share or "one"'),
        ("lever", "dvl:2m@1:2", "takes no span"),
        ("bias", "compass:3deg@0.1", 'takes no share or "one"'),
        ("zero", "usbl@1:2", "write a sensor of dvl"),
        ("sd", "usbl:0", "must be above 0"),
        ("clock", "dvl:1e999s", "must be finite"),
    ],
)
def test_a_fault_that_cannot_be_read_is_refused_in_one_sentence(kind: str, text: str, reported: str) -> None:
    said = refusal(UsageError, fault_of, kind, text)
    assert reported in said
    assert said.startswith(f"{kind} {text}")
    assert "\n" not in said


def test_the_suite_that_is_shipped_can_be_read_and_has_every_kind_but_those_of_a_user() -> None:
    drills = read_suite(STANDARD)
    used = {fault.kind for drill in drills for fault in drill.faults}
    assert len(drills) > 30
    assert set(KINDS) == used


@pytest.mark.parametrize(
    ("content", "reported"),
    [
        ('[[drill]]\nname = "a"\nfaults = ["melt usbl"]', "drill 'a': melt usbl: there is no fault 'melt'"),
        ('[[drill]]\nname = "a"\nfaults = []', "the drill 'a' has no faults"),
        ('[[drill]]\nname = "undamaged"\nfaults = ["sd usbl:2"]', "two drills are called 'undamaged'"),
        ('[[drill]]\nname = "a"\nfault = []', "did you mean faults?"),
        ('[[drill]]\nfaults = ["sd usbl:2"]', "the key name is missing"),
    ],
)
def test_a_suite_that_cannot_be_read_names_file_and_drill(tmp_path: Path, content: str, reported: str) -> None:
    file = tmp_path / "own.toml"
    file.write_text(content)
    said = refusal(UsageError, read_suite, str(file))
    assert said.startswith(f"{file}: ")
    assert reported in said


def test_a_drill_is_named_if_findings_name_each_of_its_faults() -> None:
    drill = Drill("both", (fault_of("drop", "usbl@1:2"), fault_of("outlier", "usbl:20m@0.1")))
    assert not is_named(drill, {"OUTAGE"})
    assert is_named(drill, {"OUTAGE", "USBL-OUTLIERS", "DVL-SCALE"})
    assert is_named(drill, {"OUTAGE", "USBL-OUTLIERS"}, {"USBL-OUTLIERS"}) is None  # it says so of the log as it is
    assert not is_named(drill, {"USBL-OUTLIERS"}, {"HEADING-CHECKED"})
    assert is_named(Drill("rare", (fault_of("thin", "usbl:0.1Hz"),)), ()) is None
    declared = {(kind, sensor) for kind, one in KINDS.items() for sensor in one.units}
    assert {(kind, sensor) for kind, codes in NAMED_BY.items() for sensor in codes} <= declared
