import dataclasses
import re
from pathlib import Path

import numpy as np
import pytest

from usbldr.filters.errors import UsageError
from usbldr.filters.evaluation.error_report import Window
from usbldr.io.reports.page import markdown
from usbldr.io.reports.report_text import window_text
from usbldr.io.reports.run_provenance import RunProvenance
from usbldr_cli.runs.job_store import JobResult, ScoringContext, Trace, store_result
from usbldr_cli.runs.seed_table import (
    ComparisonRow,
    best_method_sentence,
    difference,
    overall,
    require_comparable,
    row_content,
    row_metrics,
)
from usbldr_cli.tables.compare_table import latex, notes, page, render
from usbldr_cli.tables.run_table import WIDTH

JUDGED = ScoringContext("dive.mcap", "MCAP", "0" * 64, "", "gps", "/gps", None, None, "none")


def outcome(east_m: float, **more: float) -> JobResult:
    metrics = {"mean_abs_east_m": east_m, "mean_abs_north_m": 1.0, "mean_horizontal_m": 2 * east_m}
    return JobResult({**metrics, "p95_horizontal_m": 4 * east_m, "coverage": 1.0, **more}, scored_against=JUDGED)


def row(name: str, *east_m: float, sampled: bool = True, dives: bool = True) -> ComparisonRow:
    return ComparisonRow("dive", name, name, tuple(range(len(east_m))), tuple(map(outcome, east_m)), sampled, dives)


FAILED = JobResult(fault="dive: no dvl data", exit_code=3)


def test_a_row_averages_its_seeds_and_a_metric_the_runs_that_have_it() -> None:
    mixed = dataclasses.replace(row("cpf", 1.0, 1.0), outcomes=(outcome(1.0, surfacing_error_m=8.0), outcome(1.0)))
    reported = row_metrics(row("cpf", 1.0, 2.0, 6.0))

    assert reported["mean_abs_east_m"] == 3.0
    assert reported["mean_abs_east_m_se"] == pytest.approx((14 / 2 / 3) ** 0.5)  # squares about the mean: 4 + 1 + 9
    assert reported["mean_abs_east_m_seed_median"] == 2.0
    assert reported["diverged_share"] == pytest.approx(1 / 3)  # 2, 4 and 12 m
    assert reported["nees_mean"] is None
    assert "diverged_share" not in row_metrics(row("ckf", 1.0, 2.0, sampled=False))
    assert row_metrics(mixed)["surfacing_error_m"] == 8.0


def test_a_warning_of_many_runs_is_said_once_for_a_filter() -> None:
    said = [f"cpf: correlated ({sigma} sigma) at {sigma}.5 s" for sigma in (41, 38, 45)]
    warned = tuple(dataclasses.replace(outcome(1.0), warnings=(text, "cpf: no start")) for text in said)

    assert notes([dataclasses.replace(row("cpf", 1.0, 1.0, 1.0), label="cpf usbl.sd_m=1", outcomes=warned)]) == [
        ("warning", "cpf usbl.sd_m=1: correlated (41 sigma) at 41.5 s (3 of 3 runs, numbers of the first)"),
        ("warning", "cpf usbl.sd_m=1: no start (3 of 3 runs)"),
    ]


def test_differences_are_taken_over_the_seeds_that_both_have_and_one_run_without_chance_stands_for_every_seed() -> None:
    cpf = row("cpf", 1.0, 2.0, 3.0)
    failed = dataclasses.replace(cpf, label="pf", outcomes=(outcome(2.0), FAILED, outcome(3.5)))
    ckf, ekf = (row(name, east_m, sampled=False, dives=False) for name, east_m in (("ckf", 4.0), ("ekf", 4.5)))

    by_seeds = difference(failed, cpf, "mean_abs_east_m")
    on_a_file = difference(row("cpf", 1.0, 2.0, 3.0, dives=False), ckf, "mean_abs_east_m")

    assert (by_seeds.mean, by_seeds.se) == (0.75, pytest.approx(0.25))  # 1 and 0.5
    assert (on_a_file.mean, on_a_file.significant) == (-2.0, False)  # t = 2 / 0.577 = 3.46 of 4.303
    assert on_a_file.se == pytest.approx(3**-0.5)
    assert difference(ekf, ckf, "mean_abs_east_m") == (0.5, None, None, None)


def test_a_described_row_names_what_it_is_compared_with() -> None:
    first, second = row("ckf", 1.0, 2.0, 3.0), row("cpf", 0.9, 1.9, 2.9)

    reported = row_content(second, first)

    assert (reported["log"], reported["filter"], reported["seeds"]) == ("dive", "cpf", 3)
    assert reported["difference_to"] == "ckf"
    assert reported["mean_abs_east_m_difference"] == pytest.approx(-0.1)
    assert reported["mean_abs_east_m_difference_significant"] is True
    assert "difference_to" not in row_content(first, first)


def test_the_verdict_ranks_and_says_what_chance_explains() -> None:
    rows = [row("dr", 4.0, 5.0, 6.0, sampled=False), row("cpf", 1.0, 2.0, 3.0), row("adf", 1.1, 1.9, 3.1)]

    assert best_method_sentence(rows) == (
        "dive: lowest mean horizontal error: cpf, 4.00 m over 3 dives; difference to adf not significant; 60 % below dr"
    )


def test_the_verdict_on_one_real_log_says_what_chance_explains(tmp_path: Path) -> None:
    """Errors of 600 epochs in pairs: 0 ± 1 % is chance, 20 % is none; without a trace nothing is judged."""
    rng = np.random.default_rng(5)
    common_m = np.abs(rng.normal(2.0, 0.5, 600))

    def run(name: str, more: float) -> ComparisonRow:
        size_m = common_m * (1 + more) * (1 + 0.2 * rng.normal(size=600))
        at_m = np.column_stack([size_m, np.zeros(600)])
        trace = Trace(np.arange(600.0), at_m, np.zeros((600, 2)))
        result = JobResult({"mean_horizontal_m": float(np.abs(size_m).mean())}, scored_against=JUDGED)
        return ComparisonRow("dive", name, name, (0,), (store_result(tmp_path, name, result, trace),))

    rows = [run("adf", 0.0), run("ekf", 0.0), run("ukf", 0.2)]
    assert re.search("difference to (adf|ekf) not significant; 1[67] % below ukf$", best_method_sentence(rows))
    lost = [dataclasses.replace(one, outcomes=(dataclasses.replace(one.outcomes[0], trace=None),)) for one in rows]
    assert "significant" not in best_method_sentence(lost)


@pytest.mark.parametrize(("share", "judged"), [(1.0, True), (0.5, False)])
def test_raw_fixes_between_the_epochs_of_a_filter_are_judged_unless_of_another_part(tmp_path, share, judged):
    """Errors that are independent: the variances of both means add up. In the second half, the filter is lost."""
    rng, end = np.random.default_rng(8), int(900 * share)
    sigma_m = {"adf": 0.2, "usbl": 0.5}

    def run(name: str, time_s: np.ndarray, mean_m: np.ndarray) -> ComparisonRow:
        size_m = mean_m + sigma_m[name] * rng.uniform(-1, 1, len(time_s)) * 3**0.5
        trace = Trace(time_s, np.column_stack([size_m, 0 * size_m]), np.zeros((len(time_s), 2)))
        result = JobResult({"mean_horizontal_m": float(size_m.mean())}, scored_against=JUDGED)
        return ComparisonRow("dive", name, name, (0,), (store_result(tmp_path, name, result, trace),))

    filtered = run("adf", np.arange(900.0), np.where(np.arange(900) < end, 1.0, 9.0))
    raw = run("usbl", np.arange(end) + 0.37, np.full(end, 2.0))
    found = difference(raw, filtered)

    assert found is not None
    (mine,), (theirs,) = (one.values("mean_horizontal_m").values() for one in (raw, filtered))
    assert (found.mean, found.significant) == (mine - theirs, True if judged else None)
    if judged:
        assert found.se == pytest.approx(((0.2**2 + 0.5**2) / 900) ** 0.5, rel=0.2)


def test_a_single_method_a_pair_of_runs_and_diverged_runs_are_not_ranked() -> None:
    few = [row("cpf", 1.0, 2.0), row("ekf", 1.8, 2.1)]

    assert best_method_sentence(few[:1]) == "dive: mean horizontal error of cpf 3.00 m over 2 dives"
    assert best_method_sentence(few).endswith("cpf, 3.00 m over 2 dives; too few runs to judge ekf")
    for lost, better, sampled in (("pf", "cpf", True), ("ekf", "adf", False)):
        rows = [row(lost, 0.1, 9.0, 9.1, sampled=sampled), row(better, 2.0, 2.1, 2.2, sampled=sampled)]
        assert best_method_sentence(rows).endswith(f"{better}, 4.20 m over 3 dives; {lost} diverged")
        assert difference(*rows).significant is None  # type: ignore[union-attr]
        assert not render(rows).splitlines()[6].endswith("*")


def test_over_several_logs_the_verdict_counts_where_each_was_best() -> None:
    rows = [row("cpf", 1.0), row("ekf", 2.0)]
    rows += [dataclasses.replace(r, log=log) for log in ("b", "c") for r in (row("cpf", 3.0), row("ekf", 2.0))]

    assert overall(rows) == "lowest mean horizontal error: ekf on 2 of 3 logs (b, c); cpf on 1 of 3 logs (dive)"
    fleet = [dataclasses.replace(row("cpf", 1.0), log=f"dive {k}") for k in range(100)]
    assert overall(fleet) == "lowest mean horizontal error: cpf on 100 of 100 logs"


def test_a_failed_row_carries_its_sentence_and_the_others_their_numbers() -> None:
    failed = dataclasses.replace(row("dr", 1.0, 1.0), outcomes=(FAILED, FAILED))

    text = render([row("ckf", 1.0, 2.0), failed])

    assert "dr           2 of 2 runs failed: dive: no dvl data" in text
    assert "ckf 1.500 ± 0.500" in " ".join(text.split())
    assert row_content(failed, failed)["fault"] == "dive: no dvl data"


def test_the_tables_fit_the_terminal_and_mark_what_is_significant() -> None:
    sizes = {"ckf": (1.1, 1.2, 3.3), "cpf": (1.0, 1.25, 3.0), "dr": (91.0, 92.1, 113.0)}
    rows = [row(name, *east_m, sampled=False) for name, east_m in sizes.items()]

    text = render(rows)

    assert max(map(len, text.splitlines())) <= WIDTH
    cpf, dr = (next(line for line in text.splitlines() if line.startswith(name)) for name in ("cpf", "dr"))
    assert not cpf.endswith("*")
    assert dr.endswith("*")
    assert r"\|east\|" in markdown(page(rows, [], RunProvenance()))


def test_a_window_is_told_as_replay_tells_it() -> None:
    reported = dataclasses.replace(outcome(1.0), scored_against=dataclasses.replace(JUDGED, window_end_s=20.0))

    text = render([ComparisonRow("dive", "ekf", "ekf", (0,), (reported,))])

    assert window_text(Window(end_s=20.0)) == "scored from the start to 20 s of the log"
    assert window_text(Window(end_s=20.0)) in " ".join(text.split())
    assert "window" not in render([row("ekf", 1.0)])


def test_runs_against_another_truth_window_or_alignment_are_refused() -> None:
    def against(**other: object) -> ComparisonRow:
        judged = dataclasses.replace(JUDGED, **other)
        return ComparisonRow("dive", "ekf", "ekf", (0,), (dataclasses.replace(outcome(1.0), scored_against=judged),))

    for other, said in (
        ({"truth_source": "/dgps"}, "cpf has truth gps /gps, ekf has gps /dgps"),
        ({"window_start_s": 20.0}, "cpf has window start to end, ekf has 20 s to end"),
        ({"align": "rigid"}, "cpf has alignment none, ekf has rigid"),
    ):
        with pytest.raises(UsageError, match=said):
            require_comparable([row("cpf", 1.0), against(**other)])
    require_comparable([row("cpf", 1.0), dataclasses.replace(against(align="rigid"), log="another")])


def test_a_latex_table_has_a_line_for_each_filter_and_its_names_are_no_commands() -> None:
    named = (dataclasses.replace(one, log="dive\n\\input{x}") for one in (row("ekf", 2.0, 2.0), row("cpf", 1.0, 2.0)))
    ekf, cpf = named

    head, *lines = latex([ekf, dataclasses.replace(cpf, label=r"a_b%&$#{}\input^~")]).splitlines()

    assert head == r"% dive\n\input{x}"
    assert lines[0] == r"\begin{tabular}{lrrrrr}"
    assert r"a\_b\%\&\$\#\{\}\textbackslash{}input\textasciicircum{}\textasciitilde{} & 1.500 $\pm$ 0.500 &" in lines[5]
    assert all(line.count(" & ") == 5 and line.endswith(r" \\") for line in (lines[2], lines[4], lines[5]))
    assert lines[-2:] == [r"\bottomrule", r"\end{tabular}"]
