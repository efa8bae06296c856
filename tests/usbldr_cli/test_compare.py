"""usbldr compare on a short simulated dive in a file: what it writes, keeps, refuses; fixes of many dives; --bound."""

import csv
import dataclasses
import json
import re
import shutil
from dataclasses import replace
from functools import partial
from importlib.resources import files
from pathlib import Path

import pytest

from checkout import SAMPLES
from commands import interrupt, output_of, report_of, run, spoil, write_short
from logs import refusal
from usbldr.filters.bounds.dive_bounds import position_bound
from usbldr.filters.errors import LogError, UsageError
from usbldr.filters.simulation.simulate import simulate
from usbldr.io.reading.epochs import timeline
from usbldr.io.scenarios.shipped import find_scenario
from usbldr.io.scenarios.simulated_log import simulated_log
from usbldr_cli.options.run_options import RunChoices
from usbldr_cli.runs.executors import LocalProcesses
from usbldr_cli.runs.jobs import relevant_choices, run_jobs
from usbldr_cli.runs.workers import Job

CHOICES = RunChoices(10, None, 0, None, None, "none", "start", 5.0, 1.0)


@pytest.fixture(scope="module")
def dive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_short(tmp_path_factory.mktemp("logs") / "dive", "paper", 30.0, 1)


@pytest.fixture(scope="module")
def compared(dive: Path) -> Path:
    out = dive.parent / "compared"
    output_of("compare", dive, "--filters", "ckf,pf,usbl", "--seeds", 3, "--jobs", 2, "-N", 10, "-o", out)
    return out


content = partial(report_of, name="compare.json")


def test_quiet_prints_the_verdict_of_the_json_file_alone(dive: Path, tmp_path: Path) -> None:
    printed = output_of("compare", dive, "--filters", "ckf,usbl", "--plots", "none", "--quiet", "-o", tmp_path / "out")

    assert printed.strip().splitlines()[-1] == content(tmp_path / "out")["verdict"]
    assert "mean error" not in printed
    names = {path.name for path in (tmp_path / "out").iterdir()}
    assert names == {"compare.csv", "compare.json", "compare.md", "compare_seeds.csv", "units"}  # and no picture


def test_a_sweep_has_the_numbers_of_configurations_that_state_its_values(dive: Path, tmp_path: Path) -> None:
    sweep = ("--set", "usbl.sd_scale=1,4", "--set", "compass.bias_deg=2.5", "--plots", "none")

    output_of("compare", dive, "-f", "ckf", *sweep, "-o", tmp_path / "swept")

    rows = content(tmp_path / "swept")["rows"]
    assert [row["filter"] for row in rows] == ["ckf usbl.sd_scale=1", "ckf usbl.sd_scale=4"]
    stated = (dive / "usbldr.toml").read_text().replace("[usbl]", "[usbl]\nsd_scale = 4.0")
    (tmp_path / "stated.toml").write_text(stated.replace("[compass]", "[compass]\nbias_deg = 2.5"))
    config, out = tmp_path / "stated.toml", tmp_path / "run"
    output_of("replay", dive, "-f", "ckf", "--config", config, "-o", out, "--plots", "none")
    metrics = report_of(tmp_path / "run")["metrics"]
    assert rows[1]["rmse_east_m"] == metrics["rmse_east_m"] != rows[0]["rmse_east_m"]
    assert "2 of 2 runs were finished" in run("compare", dive, "-f", "ckf", *sweep, "-o", tmp_path / "swept").stderr


@pytest.mark.parametrize(
    ("key", "options", "said"),
    [
        ("usbl.sd_m", ["-f", "ckf,usbl"], True),
        ("usbl.sd_m", ["-f", "ckf,usbl", "--calibrate", "none"], False),
        ("usbl.lever_arm_m", ["-f", "usbl"], True),
    ],
)
def test_a_key_whose_values_change_no_number_is_named(tmp_path: Path, key: str, options: list[str], said: bool) -> None:
    dive = tmp_path / "fixes_without_sd"
    shutil.copytree(SAMPLES / "lawnmower_csv", dive)
    fixes = (dive / "usbl.csv").read_text().splitlines()
    (dive / "usbl.csv").write_text("".join(",".join(line.split(",")[:4]) + "\n" for line in fixes))
    values = "[0,0,0],[0,0,1]" if key.endswith("arm_m") else "1,4"

    printed = " ".join(output_of("compare", dive, "--config", "none", *options, "--set", f"{key}={values}").split())

    assert (f"all values of --set {key} give the same errors" in printed) == said


def test_a_run_with_a_stated_key_and_without_some_fixes_is_verified_and_checked_so(dive: Path, tmp_path: Path) -> None:
    options = ["--set", "usbl.sd_scale=4", "--exclude", "usbl@30:60"]
    output_of("replay", dive, "-f", "ckf", *options, "--plots", "none", "-o", tmp_path / "run")
    report = report_of(tmp_path / "run")
    baseline = tmp_path / "baseline.toml"
    value = report["metrics"]["rmse_east_m"]
    baseline.write_text(
        f'schema = 1\n[[row]]\nname = "a"\nlog = "{dive}"\nfilter = "ckf"\nset = ["usbl.sd_scale=4"]\n'
        'exclude = ["usbl@30:60"]\n'
        f"[row.metrics]\nrmse_east_m = {{ value = {value!r}, abs = 1e-9, direction = 'both' }}\n"
    )

    assert {"code": "SET", "text": "usbl.sd_scale=4, by --set"}.items() <= report["findings"][0].items()
    assert "bit-identical" in output_of("replay", "--verify", tmp_path / "run")
    assert run("check", baseline, "--output", "none").return_value == 0
    stated = baseline.read_text()
    for changed in (stated.replace("=4", "=1"), stated.replace('exclude = ["usbl@30:60"]\n', "")):
        baseline.write_text(changed)
        assert run("check", baseline, "--output", "none").return_value == 1


@pytest.mark.parametrize(
    ("stated", "said"),
    [
        ("usbl.sd_scal=1", "--set usbl.sd_scal=1: [usbl] has no key sd_scal; did you mean sd_scale"),
        ("usbl=1", "[usbl]: expected table"),
        ("schema.sd_m=1", "schema is no section"),
        ("usbl.sd_m", "write SECTION.KEY=VALUE"),
        ("usbl.sd_m=1,2", "several values are for usbldr compare"),
        ("compass.convention=EUN", "[compass] convention: EUN is not allowed"),
    ],
)
def test_what_is_wrong_with_a_stated_key_is_said(dive: Path, tmp_path: Path, stated: str, said: str) -> None:
    assert said in refusal(UsageError, output_of, "replay", dive, "-f", "dr", "--set", stated, "-o", tmp_path / "run")


def test_samplers_run_once_a_seed_the_others_once_a_file_and_the_folder_holds_nothing_else(compared: Path) -> None:
    rows = content(compared)["rows"]

    assert [(row["filter"], row["seeds"]) for row in rows] == [("ckf", 1), ("pf", 3), ("usbl", 1)]
    assert rows[1]["mean_horizontal_m_se"] > 0
    assert "mean_horizontal_m_se" not in rows[0]
    assert len(list((compared / "units").glob("*.json"))) == 5
    tables = ["compare.csv", "compare.json", "compare.md", "compare_seeds.csv"]
    others = ["error_cdf.png", "errors.png", "report.html", "track.png", "units"]
    assert sorted(path.name for path in compared.iterdir()) == ["by_filter.png", *tables, *others]
    with (compared / "compare_seeds.csv").open(encoding="utf-8", newline="") as file:
        runs = list(csv.DictReader(file))
    assert [(one["filter"], one["seed"]) for one in runs] == [("ckf", "0"), *(("pf", k) for k in "012"), ("usbl", "0")]
    mean_m = sum(float(one["mean_horizontal_m"]) for one in runs[1:4]) / 3
    assert mean_m == pytest.approx(rows[1]["mean_horizontal_m"])
    assert all(path.suffix in (".json", ".npz") for path in (compared / "units").iterdir())


def test_many_logs_have_a_line_each_and_one_figure(dive: Path, tmp_path: Path) -> None:
    logs = [tmp_path / f"dive{k}" for k in range(9)]
    for log in logs:
        shutil.copytree(dive, log)
    out = tmp_path / "out"

    said = run("compare", *logs, "-f", "usbl,dr", "--seeds", 1, "-j", 1, "-o", out).output.splitlines()

    table = said[[line.startswith("mean horizontal error, m") for line in said].index(True) :]
    mean_m = {row["log"]: f"{row['mean_horizontal_m']:.3f}" for row in content(out)["rows"] if row["filter"] == "usbl"}
    assert [line.split()[:2] for line in table[1:10]] == [[log.name, mean_m[log.name]] for log in logs]
    assert len(said) < 20
    assert {path.name for path in out.glob("*.png")} == {"by_log.png"}
    output_of("compare", *logs, "-f", "usbl", "--seeds", 1, "-j", 1, "-o", out, "--force")


def test_of_a_scenario_each_seed_is_a_dive_and_a_missing_log_is_a_sentence(tmp_path: Path) -> None:
    units = [Job("paper", "usbl", dataclasses.replace(CHOICES, seed=k)) for k in (0, 1, 0)]
    missing = Job(str(tmp_path / "nothing"), "usbl", CHOICES)

    first, second, again, lost = run_jobs([*units, missing], LocalProcesses(1))

    assert first.metrics == again.metrics
    assert first.metrics != second.metrics
    assert lost.exit_code == LogError.exit_code
    assert lost.fault is not None
    assert "nothing: no such file, folder or scenario" in lost.fault


def test_a_method_ignores_options_that_it_has_no_use_for() -> None:
    asked = dataclasses.replace(CHOICES, gate=0.99, particles=500)

    assert relevant_choices("ekf", asked).gate == 0.99
    assert relevant_choices("cpf", asked).gate is None
    assert relevant_choices("ekf", asked) == relevant_choices("ekf", dataclasses.replace(asked, particles=9))


@pytest.mark.long
def test_an_interrupted_comparison_goes_on_where_it_was(dive: Path, tmp_path: Path) -> None:
    out, seeds = tmp_path / "out", 5
    asked = [*("--filters", "cpf", "--seeds", str(seeds), "--jobs", "2", "-N", "150")]

    interrupt("compare", dive, *asked, "-o", out, once=lambda: list(out.glob("units/*.json")))

    assert [path.name for path in out.iterdir()] == ["units"]
    finished = list(out.glob("units/*.json"))
    assert 0 < len(finished) < seeds
    assert not list(out.glob("units/.*"))

    again = run("compare", dive, *asked, "-o", out)
    fresh = json.loads(output_of("compare", dive, *asked, "--json"))

    assert f"{len(finished)} of {seeds} runs were finished already" in again.stderr
    assert content(out)["rows"] == fresh["rows"]


def test_a_changed_log_is_run_anew(tmp_path: Path) -> None:
    dive = write_short(tmp_path / "dive", "paper", 20.0, 1)
    unit = Job(str(dive), "ekf", dataclasses.replace(CHOICES, calibrate="none"))  # else the log corrects the sigma
    store = tmp_path / "units"
    store.mkdir()

    first = run_jobs([unit], LocalProcesses(1), store)[0]
    kept = run_jobs([unit], LocalProcesses(1), store)[0]
    spoil(dive / "usbldr.toml", "sd_m = 1.0", "sd_m = 3.0")
    changed = run_jobs([unit], LocalProcesses(1), store)[0]

    assert (first.reused, kept.reused, changed.reused) == (False, True, False)
    assert kept.metrics == first.metrics
    assert changed.metrics["nis_mean_usbl"] < first.metrics["nis_mean_usbl"] / 4  # a ninth, but for the track's share


def test_another_comparison_is_replaced_only_by_force_and_a_foreign_folder_never(compared: Path, dive: Path) -> None:
    with pytest.raises(UsageError, match="holds another comparison"):
        output_of("compare", dive, "--filters", "usbl", "-o", compared)

    foreign = compared.parent / "foreign"
    foreign.mkdir()
    (foreign / "thesis.tex").write_text("dear")
    with pytest.raises(UsageError, match=r"holds thesis\.tex, which is not of a comparison"):
        output_of("compare", dive, "--filters", "usbl", "-o", foreign, "--force")
    assert [path.name for path in foreign.iterdir()] == ["thesis.tex"]


def test_finished_runs_are_compared_as_they_are_but_not_beside_a_log_or_without_their_report(dive, tmp_path):
    for name in ("ckf", "usbl"):
        output_of("replay", dive, "--filter", name, "-o", tmp_path / name)

    reported = json.loads(output_of("compare", tmp_path / "ckf", tmp_path / "usbl", "--json"))

    for row in reported["rows"]:
        report = report_of(tmp_path / row["filter"])
        assert row["mean_abs_north_m"] == report["metrics"]["mean_abs_north_m"]
    ckf, usbl = (row["mean_horizontal_m"] for row in reported["rows"])
    assert reported["rows"][1]["mean_horizontal_m_difference"] == usbl - ckf

    output_of("compare", tmp_path / "ckf", tmp_path / "usbl", "-o", tmp_path / "out")
    assert (tmp_path / "out" / "errors.png").stat().st_size > 10_000

    assert "cannot be mixed" in refusal(UsageError, output_of, "compare", tmp_path / "usbl", dive)
    (tmp_path / "usbl" / "report.json").write_text("{}")
    with pytest.raises(LogError, match=r"report\.json: is not a complete report of usbldr replay; run replay again"):
        output_of("compare", tmp_path / "usbl")


def test_one_failed_method_leaves_the_others_their_numbers(dive: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"

    found = run("compare", dive, "--filters", "dr,usbl", "--usbl", "none", "-o", out)

    assert found.return_value == LogError.exit_code
    dr, usbl = content(out)["rows"]
    assert (dr["fault"], usbl["seeds"]) == (None, 0)
    assert dr["mean_horizontal_m"] > 0
    assert "no usbl data" in usbl["fault"]
    assert usbl["fault"] in " ".join(found.stdout.split())


def test_if_every_method_fails_each_fault_is_said_once(dive: Path) -> None:
    said = refusal(LogError, output_of, "compare", dive, "-f", "usbl,nudge,dr", "--usbl", "none", "--dvl", "none")

    first, second = said.split("; " + str(dive))
    assert first.startswith(f"{dive}: no usbl data")
    assert second.startswith(": no dvl data")


def test_dives_without_a_truth_are_compared_by_their_fixes(dive: Path, tmp_path: Path) -> None:
    output_of("replay", dive, "--filter", "ekf", "--truth", "none", "-o", tmp_path / "run")

    for log in (dive, tmp_path / "run"):
        options = () if log != dive else ("--truth", "none", "-f", "usbl")
        assert "--fixes" in refusal(LogError, output_of, "compare", log, *options)
    assert "dive" in output_of("compare", "--fixes", tmp_path / "run")


def noise_of(white, slow=0.1):
    return {"white": {"sd": white, "sd_of_sd": 0.02}, "slow": {"sd": slow, "sd_of_sd": 0.05}, "time_constant_s": 60.0}


def a_run(folder, day, white, statistics=True, head=True):
    folder.mkdir()
    axes = {"range_m": noise_of(white), "bearing_deg": noise_of(0.5), "east_m": None, "north_m": None}
    span = {"from_m": 20.0, "to_m": 90.0, "fixes": 300, "good_share": 0.95}
    found = {"fixes": 300, "good_share": 0.95, "by_range": [span] if head else []}
    found |= axes if head else dict.fromkeys(axes)
    found |= {"scatter": {"drms_m": 1.0, "cep95_m": 1.7, "drms_percent": None}}
    report = {"log": {"name": "dive.mcap"}, "time_base": {"start_utc": f"2025-06-{day:02}T10:00:00Z"}, "metrics": None}
    (folder / "report.json").write_text(json.dumps(report | {"fix_statistics": found if statistics else None}))
    return str(folder)


def compared_fixes(*args):
    return run("compare", *args, "--fixes")


def test_the_dive_that_got_worse_is_named_and_rows_are_in_order_of_time(tmp_path):
    runs = [a_run(tmp_path / f"dive-{day}", day, 0.9 if day == 4 else 0.4 + 0.01 * day) for day in (5, 4, 3, 2, 1)]
    done = compared_fixes(*runs)
    assert [line.split()[0] for line in done.output.splitlines()[1:6]] == [f"dive-{day}" for day in range(1, 6)]
    assert done.output.splitlines()[-1] == "dive-4: white noise in range 0.90 m, median of all 0.43 m"
    assert "0.90 ± 0.02*" in done.output


def test_a_dive_without_a_head_says_so_among_others(tmp_path):
    runs = [a_run(tmp_path / f"dive-{day}", day, 0.4, head=day != 2) for day in (1, 2)]
    first, second = compared_fixes(*runs).output.splitlines()[1:3]
    assert ("no head" in first, second.count("no head")) == (False, 4)


def test_two_dives_name_none(tmp_path):
    done = compared_fixes(a_run(tmp_path / "a", 1, 0.4), a_run(tmp_path / "b", 2, 0.9))
    assert "no dive has notably more noise" in done.output


@pytest.mark.parametrize(("statistics", "sentence"), [(False, "no statistics of fixes"), (None, "compares run")])
def test_what_has_no_statistics_is_refused(tmp_path, statistics, sentence):
    other = "paper" if statistics is None else a_run(tmp_path / "b", 2, 0.4, statistics)
    assert sentence in str(compared_fixes(a_run(tmp_path / "a", 1, 0.4), other).exception)


SAMPLE = SAMPLES / "paper.mcap"


@pytest.mark.long
def test_the_bound_is_that_of_the_model_that_the_filters_assume(tmp_path: Path) -> None:
    options = ("--filter", "ekf", "--calibrate", "scale", "--seed", 3, "--bound", "-o", tmp_path / "run")

    said = output_of("replay", "paper", *options)

    paper = find_scenario("paper")
    log = simulated_log(paper, 3)
    want = position_bound(simulate(paper, 3), timeline(log), replace(log.parameters, calibrate=("scale",)))
    bound = report_of(tmp_path / "run")["bound"]
    shown = [line.split()[-3:] for line in said.splitlines() if line.startswith(("bound", "smoother bound"))]
    for k, (name, errors_m) in enumerate((("filter", want.filter_m), ("smoother", want.smoother_m))):
        least = bound[name]
        assert [least["mean_abs_east_m"], least["mean_abs_north_m"]] == pytest.approx(errors_m, rel=1e-12)
        assert shown[k] == [f"{error_m:.3f}" for error_m in (*errors_m, least["rmse_horizontal_m"])]


def test_the_row_of_a_comparison_is_the_mean_of_the_seeds_own_bounds(tmp_path: Path) -> None:
    text = (files("usbldr.io.scenarios") / "paper.toml").read_text(encoding="utf-8")
    dive, out = tmp_path / "short.toml", tmp_path / "compared"
    dive.write_text(re.sub(r"(?m)^duration_s = .*", "duration_s = 20.0", text), encoding="utf-8")
    alone: list[dict[str, float]] = []
    for seed in ("4", "5"):
        run = tmp_path / seed
        output_of("replay", dive, "-f", "ekf", "--seed", seed, "--bound", "-o", run)
        alone.append(report_of(run)["bound"]["filter"])

    output_of("compare", dive, "-f", "dr,ekf,usbl", "--seed", 4, "--seeds", 2, "--bound", "-j", 1, "-o", out)

    reported = content(out)
    row = reported["rows"][-1]
    assert row["filter"] == "bound"
    for name in ("mean_abs_east_m", "mean_abs_north_m", "rmse_horizontal_m"):
        assert row[name] == pytest.approx((alone[0][name] + alone[1][name]) / 2, rel=1e-12)
        assert f",{row[name]!r}," in (out / "compare.csv").read_text(encoding="utf-8").splitlines()[-1]
    line = next(line for line in (out / "compare.md").read_text(encoding="utf-8").splitlines() if "| bound |" in line)
    assert line.count(f"{row['mean_abs_east_m']:.3f} ± ") >= 1
    assert "bound is best" not in reported["verdict"]


@pytest.mark.parametrize("command", ["replay", "compare"])
def test_a_recorded_log_has_no_bound(command: str) -> None:
    said = f"--bound: {SAMPLE} is a recorded log; the bound needs the true states of a scenario"
    assert refusal(UsageError, output_of, command, SAMPLE, "--bound") == said
