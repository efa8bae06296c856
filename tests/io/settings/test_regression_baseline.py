"""The baseline file: its allowed content, the errors, and what an update does not change."""

import datetime
import re
from collections.abc import Mapping
from pathlib import Path

import pytest

from checkout import ROOT
from logs import refusal
from recordings import saved
from usbldr.filters.errors import UsageError
from usbldr.filters.evaluation.error_report import METRICS
from usbldr.io.settings.regression_baseline import (
    Metric,
    RegressionBaseline,
    read_baseline,
    usual_direction,
    with_new_values,
)

GOOD = """\
# what the gate holds
schema = 1  # of this file
tool = "usbldr 0.2.0"
date = 2026-01-31

[[row]]
name = "first"            # by hand
log = "dive.mcap"         # from the lake
log_sha256 = "first digest"
filter = "adf"
dr_from = "first-gps"
[row.metrics]
mean_abs_east_m = { value = 0.25, rel = 0.02, abs = 0.002 }  # error
nees_mean = { abs = 0.5, value = -1e-3, direction = "both" }

[[row]]
name = "second"
log = "paper"
log_sha256 = "second digest"
filter = "cpf"
particles = 50
seeds = 3
[row.metrics.rmse_horizontal_m]
value = 3
rel = 0.1
[row.metrics.coverage]
abs = 0
value = 1.0
"""

TODAY = datetime.date(2026, 2, 1)


def _updated(baseline: RegressionBaseline, *values: Mapping[str, float]) -> str:
    new = [(one, row.log_sha256 or "new") for one, row in zip(values, baseline.rows, strict=True)]
    return with_new_values(baseline, new, "usbldr 0.3.0", TODAY)


def _signed(text: str) -> str:
    return text.replace("0.2.0", "0.3.0").replace("2026-01-31", "2026-02-01")


def test_rows_keep_their_options_apart_from_their_metrics(tmp_path: Path) -> None:
    first, second = read_baseline(saved(tmp_path / "baseline.toml", GOOD)).rows

    assert (first.name, first.log, first.filter, first.seeds) == ("first", "dive.mcap", "adf", 1)
    assert first.options == {"dr_from": "first-gps"}
    assert second.options == {"particles": 50}
    assert second.seeds == 3
    assert list(first.metrics) == ["mean_abs_east_m", "nees_mean"]


def test_the_limit_is_abs_plus_rel_times_the_size_of_the_value() -> None:
    assert Metric(value=-10.0, abs=0.5, rel=0.1).limit == pytest.approx(1.5)
    assert Metric(value=10.0, rel=0.1).limit == pytest.approx(1.0)
    assert Metric(value=10.0, abs=0.25).limit == pytest.approx(0.25)


@pytest.mark.parametrize(
    ("direction", "metrics"),
    [
        ("lower",
         "mean_abs_east_m rmse_horizontal_m final_horizontal_m p95_abs_north_m surfacing_error_m drift_percent"),
        ("lower", "mean_horizontal_m_seed_median diverged_share"),
        ("higher", "coverage"),
        ("both", "bias_east_m nees_mean nis_mean_usbl ess_mean_ratio distance_m fixes_rejected"),
    ],
)  # fmt: skip
def test_errors_are_better_when_lower_and_consistency_has_no_better_side(direction: str, metrics: str) -> None:
    assert {usual_direction(metric) for metric in metrics.split()} == {direction}


def test_the_direction_of_every_metric_and_of_its_statistics_over_seeds_is_the_declared_one() -> None:
    for metric in METRICS:
        assert {usual_direction(f"{metric.name}{end}") for end in ("", "_se", "_seed_median")} == {metric.direction}


CHANGED = _signed(
    GOOD.replace("value = 0.25,", "value = 0.261235,")
    .replace("value = -1e-3,", "value = 2,")
    .replace("value = 3\n", "value = 4.5e-07\n")
    .replace("value = 1.0\n", "value = 0.9\n")
)
PLAIN = GOOD.replace("-1e-3", "-0.001").replace("value = 1.0", "value = 1")


@pytest.mark.parametrize(
    ("before", "values", "after"),
    [
        (GOOD, ({"mean_abs_east_m": 0.2612345678, "nees_mean": 2.0}, {"rmse_horizontal_m": 4.5e-7, "coverage": 0.9}),
         CHANGED),
        # without a change it keeps its date
        (PLAIN, ({"mean_abs_east_m": 0.25, "nees_mean": -1e-3}, {"rmse_horizontal_m": 3.0, "coverage": 1.0}), PLAIN),
        # a value that was not known
        (GOOD.replace("{ value = 0.25, rel", "{ rel"), ({"mean_abs_east_m": 0.25}, {}), _signed(GOOD)),
    ],
)  # fmt: skip
def test_an_update_puts_new_values_in_place_and_leaves_all_else(tmp_path, before, values, after):
    baseline = read_baseline(saved(tmp_path / "baseline.toml", before))

    assert (baseline.rows[0].metrics["mean_abs_east_m"].value is None) == ("{ rel" in before)
    assert _updated(baseline, *values) == after


def test_a_file_by_hand_gets_its_digests_its_tool_and_its_date(tmp_path: Path) -> None:
    baseline = read_baseline(saved(tmp_path / "baseline.toml", re.sub(r"(tool|date|log_sha256) = .*\n", "", GOOD)))
    assert (baseline.tool, baseline.date, baseline.rows[0].log_sha256) == ("", None, "")

    text = _updated(baseline, {}, {})

    assert text == _signed(GOOD).replace("first digest", "new").replace("second digest", "new")
    again = read_baseline(saved(tmp_path / "baseline.toml", text))
    assert (again.tool, again.date, again.rows[1].log_sha256) == ("usbldr 0.3.0", TODAY, "new")


def test_an_update_follows_any_layout(tmp_path: Path) -> None:
    unusual = 'schema = 1\nrow = [{ name = "a", log = "l", filter = "f", metrics = { x = { value = 1, abs = 1 } } }]\n'
    text = _updated(read_baseline(saved(tmp_path / "baseline.toml", unusual)), {"x": 2.0})

    (row,) = read_baseline(saved(tmp_path / "baseline.toml", text)).rows
    assert (row.metrics["x"].value, row.log_sha256) == (2.0, "new")
    assert text.startswith('schema = 1\ntool = "usbldr 0.3.0"\ndate = 2026-02-01\nrow = [{ name = "a", log = "l"')


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ("schema = 1", "schema = 2", "schema: 2 is not allowed (allowed: 1)"),
        ("schema = 1", "schema = 1\nextra = 3", "there is no section extra (allowed: schema, tool, date, row)"),
        ("schema = 1  # of this file", "schema = ", "is not valid TOML (Invalid value (at line 2, column 10))"),
        ('name = "first"', 'name = ""', "row 1: name: expected text of length >= 1"),
        ('name = "second"', 'name = "first"', "two rows are called 'first': give each its own name"),
        ('log = "dive.mcap" ', "#", "row 'first': the key log is missing"),
        ('filter = "adf"', "filter = 3", "row 'first': filter: expected text, got number"),
        ("seeds = 3", "seeds = 0", "row 'second': seeds: expected number >= 1"),
        ("particles = 50", "particles = true", "row 'second': particles: expected"),
        ("rel = 0.1", "rel = -0.1", "row 'second': [metrics] rmse_horizontal_m.rel: expected number >= 0.0"),
        ("rel = 0.1", "real = 0.1", "row 'second': [metrics.rmse_horizontal_m] has no key real; did you mean rel?"),
        ("rel = 0.1\n", "", "row 'second': metrics.rmse_horizontal_m states no tolerance: give abs, rel or both"),
        ("rel = 0.1", "rel = inf", "row 'second': [metrics] rmse_horizontal_m.rel = inf is not a finite number"),
        ('direction = "both"', 'direction = "up"',
         "row 'first': [metrics] nees_mean.direction: up is not allowed (allowed: lower, higher, both)"),
        (GOOD[GOOD.index("[row.metrics.rmse") :], "[row.metrics]\n", "row 'second': metrics is empty"),
        (GOOD[GOOD.index("[[row]]") :], "", "has no [[row]]: such a check would always pass"),
    ],
)  # fmt: skip
def test_a_wrong_file_is_refused_with_row_and_key(tmp_path: Path, old: str, new: str, sentence: str) -> None:
    file = saved(tmp_path / "baseline.toml", GOOD.replace(old, new, 1))

    assert refusal(UsageError, read_baseline, file).startswith(f"{file}: {sentence}")


def test_a_file_that_is_not_there_is_a_sentence(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"none\.toml: cannot be read \(No such file or directory\)"):
        read_baseline(tmp_path / "none.toml")


def test_the_baseline_of_the_page_on_ci_is_one(tmp_path: Path) -> None:
    text = (ROOT / "docs" / "ci.md").read_text()
    (block,) = (block for block in re.findall(r"```toml\n(.*?)```", text, re.DOTALL) if "[[row]]" in block)
    (row,) = read_baseline(saved(tmp_path / "gate.toml", block)).rows

    assert row.options == {"calibrate": "scale,heading"}
    assert {metric.value for metric in row.metrics.values()} == {None}
