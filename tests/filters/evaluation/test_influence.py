"""The fixes that a track hangs on: leaving one out really moves the track by what the table says."""

import csv
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from commands import output_of, report_of, write_short
from usbldr.filters.errors import UsbldrError
from usbldr.filters.evaluation.influence import compare_without, influences, most_influential, without_fix
from usbldr.filters.models.noise import Gaussian
from usbldr.filters.models.parameters import Parameters, ProcessNoise, Start
from usbldr.filters.replay.methods import FilterSettings
from usbldr.filters.replay.run import run
from usbldr.io.scenarios.shipped import find_scenario
from usbldr.io.scenarios.simulated_log import write_scenario
from weaving import Faults, weaving_dive

ASSUMED = Parameters(usbl=Gaussian(), start=Start(2.0, 0.0, 3.0))


@pytest.mark.parametrize("method", ["ekf", "adf", "cpf", "pf-wekf"])
def test_the_most_influential_come_first_and_a_track_without_one_lies_elsewhere_by_its_shift(method: str) -> None:
    line = weaving_dive(Faults(heading_bias_deg=3.0), seconds=80)
    settings = FilterSettings(particles=20)
    whole = run(method, line, ASSUMED, settings)

    reported = most_influential(whole, 7)
    shifts = [fix.shift_m for fix in reported]
    assert shifts == sorted(shifts, reverse=True)
    assert len({fix.row for fix in reported}) == 7
    assert len(influences(whole)) == len(line.fix_m)

    first = reported[0]
    left_out = run(method, without_fix(line, first.row), ASSUMED, settings)

    at = int(np.searchsorted(whole.time_s, first.time_s))
    shift = whole.position_m[at] - left_out.position_m[at]
    assert (first.shift_east_m, first.shift_north_m) == pytest.approx(shift, abs=0.02)
    assert first.shift_m > 0.1


def test_a_refused_fix_moves_nothing() -> None:
    line = weaving_dive(Faults(), seconds=60)
    line.fix_m[30] += 500.0

    refused = influences(run("ekf", line, ASSUMED, FilterSettings(gate=0.99)))[30]

    assert refused.outcome == "rejected"
    assert refused.shift_m == 0
    assert np.hypot(refused.innovation_east_m, refused.innovation_north_m) > 600


def test_an_outlier_among_n_equal_fixes_moves_the_track_by_its_nth_part() -> None:
    """A vehicle that knows its way from fix to fix averages them, whatever their number."""
    line = weaving_dive(Faults(), seconds=80)
    line.fix_m[30] += (40.0, 0.0)
    line = replace(line, fix_cov_m2=100.0 * np.tile(np.eye(2), (79, 1, 1)))
    assumed = Parameters(ProcessNoise(0.0, 1e-3, 0.05, 0.1), usbl=Gaussian(), start=Start(0.0, 0.0, 1000.0))
    whole = run("ekf", line, assumed)
    fix = influences(whole)[30]

    reported = compare_without(fix, whole, run("ekf", without_fix(line, 30), assumed))

    fixes_so_far = np.minimum(np.floor(line.time_s + 1e-9), 79)
    parts_m = 40 / fixes_so_far[line.time_s >= 31]
    assert 31 <= reported.largest_at_s < 32  # the next fix comes then
    assert reported.largest_shift_m == pytest.approx(40 / 31, rel=0.02)
    assert reported.mean_shift_m == pytest.approx(parts_m.sum() / len(line.time_s), rel=0.02)
    assert math.isnan(reported.error_change_m)


def replayed(log: Path, method: str, *options: str) -> tuple[str, Path]:
    folder = log.parent / f"run-{log.name}"
    return output_of("replay", log, "-f", method, "-N", "20", "-o", folder, "--calibrate", "none", *options), folder


def track(folder: Path) -> np.ndarray:
    with (folder / "track_5hz.csv").open() as text:
        return np.array([(float(row["east_m"]), float(row["north_m"])) for row in csv.DictReader(text)])


@pytest.mark.parametrize("method", ["adf", "cpf"])
def test_replay_tells_what_a_log_without_the_record_gives(tmp_path: Path, method: str) -> None:
    scenario = replace(find_scenario("square"), duration_s=60.0)
    for name in ("dive", "shorter"):
        write_scenario(scenario, 3, tmp_path / name)
    _, folder = replayed(tmp_path / "dive", method, "--leave-one-out", "2")
    reported = report_of(folder)["leave_one_out"]
    first = reported[0]
    records = (tmp_path / "shorter" / "usbl.csv").read_text().splitlines(keepends=True)
    del records[1 + first["fix"]["row"]]
    (tmp_path / "shorter" / "usbl.csv").write_text("".join(records))

    _, other = replayed(tmp_path / "shorter", method)

    shift_m = np.hypot(*(track(folder) - track(other)).T)
    assert first["largest_shift_m"] == pytest.approx(shift_m.max(), abs=2e-3)
    assert first["mean_shift_m"] == pytest.approx(shift_m.mean(), abs=1e-3)
    errors_m = [report_of(f)["metrics"]["mean_horizontal_m"] for f in (other, folder)]
    assert first["error_change_m"] == pytest.approx(errors_m[0] - errors_m[1], abs=1e-9)
    assert first["largest_shift_m"] > 0.01
    assert len({one["fix"]["row"] for one in reported}) == 2


def test_terminal_and_report_show_the_largest_effect_first(tmp_path: Path) -> None:
    write_short(tmp_path / "dive", "square", 60.0, 3)

    printed, folder = replayed(tmp_path / "dive", "adf", "--leave-one-out", "5")

    lines = printed.splitlines()
    head = next(k for k, line in enumerate(lines) if line.startswith("without fix"))
    shifts = [float(line.split()[2]) for line in lines[head + 1 : head + 6]]
    assert shifts == sorted(shifts, reverse=True)
    text = (folder / "report.md").read_text()
    assert "## Fixes left out" in text
    assert lines[head + 1].split()[0] in text.split("## Fixes left out")[1].split("| ---: |\n")[1].splitlines()[0]


@pytest.mark.parametrize("method", ["dr", "pf"])
def test_a_method_that_tells_of_no_shift_cannot_leave_one_out(tmp_path: Path, method: str) -> None:
    write_short(tmp_path / "dive", "square", 20.0, 3)

    with pytest.raises(UsbldrError, match=f"{method} does not report the effect of each fix"):
        replayed(tmp_path / "dive", method, "--leave-one-out", "1")
    assert not (tmp_path / "run-dive").exists()
