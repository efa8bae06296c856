import dataclasses
import json
import math
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from commands import report_of
from logs import refusal
from recordings import saved
from scored_runs import WHOLE, run_of, scored
from uncalibrated import dive_without_calibration
from usbldr.filters.errors import UsageError
from usbldr.filters.evaluation.error_report import Window
from usbldr.filters.identification.identification import Identification, SensorErrorEvidence
from usbldr.filters.replay import dead_reckoning
from usbldr.filters.replay.run import run as run_filter
from usbldr.filters.types import Outage, Reacquisition, Trajectory, Update
from usbldr.io.findings import Finding
from usbldr.io.reading.epochs import timeline
from usbldr.io.reports.report_json import fixes_table, json_values, write_json, write_tables
from usbldr.io.reports.run import Run, ScoredTrack
from usbldr.io.reports.run_directory import run_directory
from usbldr.io.reports.run_page import write_markdown
from usbldr.io.scenarios.shipped import find_scenario

PAPER = find_scenario("paper")

LOG = dive_without_calibration(dataclasses.replace(PAPER, duration_s=60.0), seed=1)
TIMELINE = timeline(LOG)

USBL = dead_reckoning.usbl(TIMELINE)
CKF = run_filter("ckf", TIMELINE, LOG.parameters)
CONFIGURED = Identification(LOG.parameters)


def a_run(trajectory: Trajectory = CKF, window: Window = WHOLE, align: str = "none") -> Run:
    request = {"log": "paper", "options": {"start": 4.0}}
    return run_of(LOG, TIMELINE, trajectory, window, align, request=request)


def written(tmp_path: Path, run: Run) -> Path:
    with run_directory(tmp_path / "out") as folder:
        write_tables(folder, run)
        write_markdown(folder, run, [("track.png", "Track")])
        write_json(folder, run)
    return tmp_path / "out"


def test_a_run_directory_holds_the_files_of_the_design_and_a_track_with_its_errors(tmp_path: Path) -> None:
    out = written(tmp_path, a_run())

    assert sorted(path.name for path in out.iterdir()) == [
        *("errors_1hz.csv", "fixes.csv", "pose_5hz.csv", "report.json", "report.md", "track.geojson", "track.kml"),
        *("track.tum", "track_5hz.csv", "truth.tum"),
    ]
    assert [path.name for path in tmp_path.iterdir()] == ["out"]

    track = pd.read_csv(out / "track_5hz.csv").iloc[::5].reset_index()
    errors = pd.read_csv(out / "errors_1hz.csv")

    assert (track.east_m - LOG.truth.position_m[:, 0]).to_numpy() == pytest.approx(errors.error_east_m, abs=2e-4)
    assert track.sd_north_m.to_numpy() == pytest.approx(errors.sd_north_m, abs=2e-4)


def test_a_log_without_truth_or_origin_still_gives_its_track(tmp_path: Path) -> None:
    blind = Run(dataclasses.replace(LOG, truth=None, origin=None), TIMELINE, CONFIGURED, ScoredTrack(CKF, None))

    out = written(tmp_path, blind)

    files = ["fixes.csv", "pose_5hz.csv", "report.json", "report.md", "track.tum", "track_5hz.csv"]
    assert sorted(path.name for path in out.iterdir()) == files
    assert np.loadtxt(out / "track.tum")[:, 1:3] == pytest.approx(CKF.position_m, abs=1e-6)
    assert report_of(out)["metrics"] is None
    assert "paper has no truth" in (out / "report.md").read_text()


@pytest.mark.parametrize(
    ("evidence", "hint"),
    [((), "--calibrate auto"), ((SensorErrorEvidence("scale", -3.0, False, ()),), "usbldr doctor")],
)
def test_a_far_over_confident_filter_says_what_to_try(evidence: tuple[SensorErrorEvidence, ...], hint: str) -> None:
    assert CKF.cov is not None
    found = Identification(dataclasses.replace(LOG.parameters, calibrate=()), evidence)

    sure = scored(LOG, TIMELINE, dataclasses.replace(CKF, cov=CKF.cov / 1e4, warnings=()))
    warnings = Run(LOG, TIMELINE, found, sure).warnings

    (warning,) = [text for text in warnings if text.startswith("ckf is far over-confident")]
    assert hint in warning


def test_report_json_is_strict_and_names_every_metric(tmp_path: Path) -> None:
    run = a_run(USBL)

    report = report_of(written(tmp_path, run))

    assert list(report["metrics"].items()) == list(run.scored.report.flat().items())
    assert report["metrics"]["nees_mean"] is None  # raw fixes claim no covariance
    assert report["window"] == {"start_s": None, "end_s": None}
    assert set(report["reference_tracks"]) == {"usbl", "dr"}
    assert report["reference_tracks"]["dr"]["metrics"]["drift_percent"] > 0


def test_report_json_tells_where_the_numbers_come_from(tmp_path: Path) -> None:
    reported = dataclasses.replace(LOG, findings=(Finding("OUT-OF-ORDER", "3 fixes came late"),))
    outage = dataclasses.replace(TIMELINE, outages=(Outage("usbl", 10.0, 30.0),))
    run = dataclasses.replace(a_run(window=Window(4.0, 50.0), align="first"), log=reported, timeline=outage, seed=7)

    report = report_of(written(tmp_path, run))

    assert report["schema"] == 4
    assert report["log"]["sha256"] == LOG.sha256
    assert report["tool"]["name"] == "usbldr"
    assert (report["filter"], report["seed"], report["order"]) == ("ckf", 7, "validity")
    assert report["time_base"]["start_ns"] == LOG.start_ns
    assert report["window"] == {"start_s": 4.0, "end_s": 50.0}
    assert report["alignment"]["name"] == "first"
    assert report["truth"]["kind"] == "simulated"
    finding = {"code": "OUT-OF-ORDER", "level": "info", "text": "3 fixes came late", "lost_data": False}
    assert report["findings"] == [{**finding, "topic": "", "time_s": None, "worst": None, "unit": ""}]
    assert report["outages"] == [{"sensor": "usbl", "start_s": 10.0, "end_s": 30.0}]
    usbl = {"family": "Mixture", "share": 0.3, "variance_ratio": 10.0, "per_scalar": True}
    assert report["assumptions"]["usbl"] == usbl
    assert report["files"] == sorted(set(report["files"]) - {"report.json"})
    assert report["verdict"].startswith("ckf: ")


def test_report_json_tells_what_was_made_of_fixes_in_doubt(tmp_path: Path) -> None:
    doubt = Reacquisition(12.0, math.inf, 15.0, refused=3, jump_m=20.5, accepted=True)

    report = report_of(written(tmp_path, a_run(dataclasses.replace(CKF, reacquisitions=(doubt,)))))

    assert report["reacquisitions"] == [
        {"since_s": 12.0, "outage_s": None, "resolved_s": 15.0, "refused": 3, "jump_m": 20.5, "accepted": True}
    ]


def test_a_longer_table_is_written_for_other_rates(tmp_path: Path) -> None:
    slow = timeline(LOG, fast_hz=2.0, slow_hz=0.5)

    out = written(tmp_path, run_of(LOG, slow, run_filter("ckf", slow, LOG.parameters)))

    assert len(pd.read_csv(out / "track_2hz.csv")) == 121
    assert (out / "errors_0.5hz.csv").is_file()


def update(row: int, axis: str, e: float, nis: float, fate: str, nominal: float = 1.0) -> Update:
    return Update("usbl", axis, row, float(row), (e,), (1.0,), nis, 1, fate, nominal)


def test_a_fix_taken_by_axis_is_one_row_with_the_worse_outcome() -> None:
    updates = (
        Update.combined([update(0, "east", 1.0, 1.0, "used"), update(0, "north", -2.0, 4.0, "used")]),
        Update.combined([update(1, "east", 0.5, 0.25, "used"), update(1, "north", 9.0, 81.0, "down-weighted", 0.01)]),
        Update("usbl", "position", 2, 2.0, (30.0, 40.0), (1.0, 1.0), 2500.0, 2, "rejected", 0.0),
        Update("dvl", "forward", 0, 0.0, (0.0,), (1.0,), 0.0, 1, "used", 1.0),
    )

    table = fixes_table(TIMELINE, dataclasses.replace(CKF, updates=updates))

    assert list(table) == [
        *("time_s", "received_s", "east_m", "north_m", "innovation_east_m", "innovation_north_m"),
        *("shift_east_m", "shift_north_m"),
        *("nis", "dof", "outcome", "why"),
    ]
    assert list(table.outcome[:4]) == ["used", "down-weighted", "rejected", "not used"]
    assert table.nis[:3].tolist() == [5.0, 81.25, 2500.0]
    assert table.dof[:4].tolist() == [2, 2, 2, 0]
    assert table.innovation_east_m[:3].tolist() == [1.0, 0.5, 30.0]
    assert table.innovation_north_m[:3].tolist() == [-2.0, 9.0, 40.0]
    assert "0.01" in table.why[1]
    assert "NIS 2500.0, expected 2" in table.why[2]


def test_report_md_states_the_verdict_the_truth_the_order_the_alignment_and_shows_the_pictures(tmp_path: Path) -> None:
    page = (written(tmp_path, a_run(align="rigid")) / "report.md").read_text()

    assert page.startswith("# ckf on paper\n\n**ckf: ")
    assert "better than raw USBL" in page
    assert "**truth**: simulated" in page
    assert "61 of 61 epochs (100 % of the run)" in page
    assert "used at their time of validity" in page
    assert "rotation and shift fitted to the truth" in page
    assert "![Track](track.png)" in page


def test_strict_turns_what_json_does_not_know_into_null() -> None:
    value = {"a": math.nan, "b": [np.float64(2.5), -math.inf], "c": np.array([[1, 2]]), "d": np.bool_(True)}

    assert json_values(value) == {"a": None, "b": [2.5, None], "c": [[1, 2]], "d": True}


def leave_a_run(target: Path, text: str = "old", force: bool = False) -> None:
    with run_directory(target, force) as folder:
        (folder / "track.csv").write_text(text)
        (folder / "report.json").write_text(json.dumps({"tool": {"name": "usbldr"}, "files": ["track.csv"]}))


@pytest.mark.parametrize("fault", [KeyboardInterrupt, ZeroDivisionError])
def test_an_interrupted_run_leaves_nothing_behind(tmp_path: Path, fault: type[BaseException]) -> None:
    def interrupted() -> None:
        with run_directory(tmp_path / "deep" / "out") as folder:
            (folder / "half").write_text("half")
            raise fault

    with pytest.raises(fault):
        interrupted()

    assert list(tmp_path.iterdir()) == []


def test_an_old_run_is_replaced_only_by_force_and_by_a_whole_one(tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()  # an empty folder may become a run
    leave_a_run(tmp_path / "out")

    with pytest.raises(KeyboardInterrupt), run_directory(tmp_path / "out", force=True):
        raise KeyboardInterrupt

    assert (tmp_path / "out" / "track.csv").read_text() == "old"
    assert len(list(tmp_path.iterdir())) == 1

    assert "--force" in refusal(UsageError, leave_a_run, tmp_path / "out", "new")
    assert (tmp_path / "out" / "track.csv").read_text() == "old"

    leave_a_run(tmp_path / "out", "new", force=True)
    assert (tmp_path / "out" / "track.csv").read_text() == "new"
    assert len(list(tmp_path.iterdir())) == 1


def test_force_never_deletes_what_no_run_wrote(tmp_path: Path) -> None:
    others = {"thesis/chapter.tex": "years", "out/notes.txt": "mine", "other/report.json": '{"tool": "a", "files": []}'}
    leave_a_run(tmp_path / "out")
    for name, text in others.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        saved(tmp_path / name, text)
    saved(tmp_path / "file", "a file")

    said = {"thesis": "holds chapter.tex", "out": "holds notes.txt", "other": "holds report.json", "file": "is a file"}
    for folder, sentence in said.items():
        with pytest.raises(UsageError, match=sentence):
            leave_a_run(tmp_path / folder, force=True)

    assert {name: (tmp_path / name).read_text() for name in others} == others


def test_a_place_that_cannot_be_written_is_a_sentence(tmp_path: Path) -> None:
    assert "cannot be written" in refusal(UsageError, leave_a_run, saved(tmp_path / "file", "in the way") / "out")
