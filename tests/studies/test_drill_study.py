"""docs/studies/drills.md: its parts, on rows whose numbers are known."""

import re
from pathlib import Path

import numpy as np

from drills import study, tables
from drills.ways import DEFAULT, OF_PAPERS, WAYS, label, logs
from usbldr.io.drills.drill import Drill
from usbldr.io.drills.fault_text import fault_of
from usbldr.io.drills.suite import read_suite
from usbldr_cli.runs.drill_rows import DrillReport, DrillRow
from usbldr_cli.runs.job_store import JobResult
from usbldr_cli.runs.seed_table import ComparisonRow

OUTAGE = Drill("outage", (fault_of("drop", "usbl@10:20"),))
SCALE = Drill("scale", (fault_of("scale", "dvl:1.05"),))


def runs(name: str, *errors_m: float | None) -> ComparisonRow:
    outcomes = tuple(
        JobResult(fault="it failed") if error is None else JobResult({"mean_horizontal_m": error, "nees_mean": 2.0})
        for error in errors_m
    )
    return ComparisonRow("turns", name, "adf", tuple(range(len(errors_m))), outcomes, dives=True)


def report() -> DrillReport:
    usual = {"adf": runs("adf", 0.1, 0.3), "ekf": runs("ekf", 0.4, 0.4)}
    under = {
        (SCALE, "adf"): runs("adf", 0.2, 0.2),
        (SCALE, "ekf"): runs("ekf", 0.8, 0.8),
        (OUTAGE, "adf"): runs("adf", 2.0, 1.0),
        (OUTAGE, "ekf"): runs("ekf", 0.5, 0.5),
    }
    clean = (JobResult(findings=("HEADING-CHECKED",)),) * 2
    found = {OUTAGE: (JobResult(findings=("HEADING-CHECKED", "OUTAGE")), JobResult(findings=("OUTAGE",))), SCALE: clean}
    rows = tuple(
        DrillRow(drill, row, usual[name], runs("usbl", 3.0, 3.0), found[drill], clean, drill.spans_s(100.0))
        for (drill, name), row in under.items()
    )
    return DrillReport((*usual.values(), runs("usbl", 1.0, 1.0)), rows)


def test_the_worst_drill_is_on_top_with_error_ratio_and_what_was_found() -> None:
    lines = tables.drills_by_filter(report()).splitlines()

    assert lines[0] == "| drill | adf | ekf | raw USBL | named | new findings |"
    assert lines[2] == "| outage | 1.50 (7.50) | 0.50 (1.25) | 3.00 | 100 % | OUTAGE |"
    assert lines[3] == "| scale | 0.20 (1.00) | 0.80 (2.00) | 3.00 | 0 % |  |"
    assert re.search(r"no fault.* \| 0\.20 \| 0\.40 \| 1\.00 \|", lines[4])


def test_the_page_has_every_part_and_the_suite_of_the_papers_can_be_read() -> None:
    log = logs(8)[0]
    page = study.document(8, ["## turns\n\nits part"], report(), log)

    assert "{{" not in page
    assert "its part" in page
    assert "outage" in page
    assert {"afukf", "aekf", "pf-wekf"} <= {way.method for way in OF_PAPERS}
    assert len(read_suite(str(Path(study.__file__).with_name("papers.toml")))) >= 5
    assert label(DEFAULT) in [label(way) for way in WAYS]
    assert len({label(way) for way in (*WAYS, *OF_PAPERS)}) == len({*WAYS, *OF_PAPERS})
    assert np.isclose(log.seeds, 8)
