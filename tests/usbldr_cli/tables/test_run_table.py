import dataclasses
import re
from functools import partial

from scored_runs import run_of
from uncalibrated import dive_without_calibration
from usbldr.filters.evaluation.error_report import Window
from usbldr.filters.identification.identification import Identification
from usbldr.filters.replay.run import run as run_filter
from usbldr.filters.types import Outage
from usbldr.io.reading.epochs import timeline
from usbldr.io.reports.report_json import json_values, report_content
from usbldr.io.reports.run import Run, ScoredTrack
from usbldr.io.scenarios.shipped import find_scenario
from usbldr_cli.tables.run_table import WIDTH, render

PAPER = find_scenario("paper")

LOG = dive_without_calibration(dataclasses.replace(PAPER, duration_s=60.0), seed=1)
TIMELINE = timeline(LOG)
CPF = run_filter("cpf", TIMELINE, LOG.parameters)
a_run = partial(run_of, LOG, TIMELINE)


def test_no_colour_code_is_written_unless_a_terminal_asks() -> None:
    assert "\x1b" not in render(a_run(CPF))
    assert "\x1b[1m" in render(a_run(CPF), colour=True)


def test_every_number_of_the_table_is_in_report_json() -> None:
    run = a_run(CPF)
    numbers = [float(text) for text in re.findall(r"-?\d+\.\d+", "\n".join(render(run).splitlines()[6:]))]

    found = re.findall(r"-?\d+\.?\d*(?:e-?\d+)?", str(json_values(report_content(run))))
    known = {round(float(text), digits) for text in found for digits in (1, 2, 3)}

    assert len(numbers) > 40
    assert {number for number in numbers if number not in known} == set()


def test_truth_order_alignment_and_share_stand_above_the_numbers_and_the_verdict_below_them() -> None:
    runs = [a_run(CPF, Window(4.0, 50.0), align) for align in ("first", "rigid")]
    head = render(runs[0]).split("error in m")[0]

    for run in runs:
        assert render(run).splitlines()[-1] == run.verdict
        assert max(map(len, render(run).splitlines())) <= WIDTH
    assert "truth        simulated: paper/gps" in head
    assert "47 of 61 epochs (77 % of the run)" in head
    assert "14 outside the window" in " ".join(head.split())
    assert "scored from 4 s to 50 s" in head
    assert "used at their time of validity" in head
    assert "first epoch moved onto the first truth row (shifted" in head


def test_outages_and_warnings_are_told() -> None:
    outages = (Outage("usbl", 10.0, 22.5), Outage("usbl", 30.0, 41.0), Outage("dvl", 5.0, 9.0))
    warned = dataclasses.replace(CPF, warnings=("ESS stays below 5 %",))
    run = dataclasses.replace(a_run(warned), timeline=dataclasses.replace(TIMELINE, outages=outages))

    text = render(run)

    assert "dvl 4.0 s at 5 s; usbl 2, longest 12.5 s at 10 s" in text
    assert "warning      ESS stays below 5 %" in text


def test_a_run_without_truth_has_a_table_without_errors() -> None:
    blind = Run(dataclasses.replace(LOG, truth=None), TIMELINE, Identification(LOG.parameters), ScoredTrack(CPF, None))

    text = render(blind)

    assert "truth        none" in text
    assert "rmse" not in text
    assert text.endswith("cpf: paper has no truth, so there are no errors")
