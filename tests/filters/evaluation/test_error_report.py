import re

import numpy as np

from checkout import ROOT
from usbldr.filters.evaluation.consistency import SensorUpdates
from usbldr.filters.evaluation.error_report import METRICS
from usbldr.filters.evaluation.evaluation import evaluate
from usbldr.filters.evaluation.metrics import declared
from usbldr.filters.types import Trajectory, Truth, Update

SECONDS = np.arange(0.0, 11.0)


def report():
    updates = tuple(
        Update(sensor, "position", row, float(row), (1.0, 2.0), (1.0, 1.0), 5.0, 2, outcome, 1.0)
        for row, (sensor, outcome) in enumerate((("usbl", "used"), ("usbl", "rejected"), ("dvl", "down-weighted")))
    )
    track_m = np.random.default_rng(8).normal(size=(11, 2))
    track = Trajectory("adf", ("x", "y"), SECONDS, track_m, None, updates, seconds=2.0, smoothed=True)
    return evaluate(track, Truth(SECONDS, np.zeros((11, 2)), np.ones(11), "simulated", "/truth"))


def test_flat_has_the_declared_metrics_in_their_order_and_then_those_of_each_sensor() -> None:
    names = list(report().flat())

    assert names[: len(METRICS)] == [metric.name for metric in METRICS]
    stems = ("nis_mean", "nis_expected", "updates_used", "updates_down_weighted", "updates_rejected")
    assert names[len(METRICS) :] == [f"{stem}_{sensor}" for sensor in ("dvl", "usbl") for stem in stems]


def test_each_name_has_the_number_of_its_field_and_a_smoothed_track_keeps_its_method_beside_its_label() -> None:
    found = report()
    flat = found.flat()

    assert (found.method, found.label) == ("adf", "adf smoothed")
    assert flat["p95_abs_east_m"] == np.percentile(np.abs(found.error_m[:, 0]), 95) == found.east.p95_abs_m
    assert flat["rmse_north_m"] == np.sqrt(np.mean(found.error_m[:, 1] ** 2)) == found.north.rmse_m
    assert flat["final_horizontal_m"] == np.hypot(*found.error_m[-1]) == found.horizontal.final_m
    assert (flat["fixes_used"], flat["fixes_rejected"], flat["updates_down_weighted_dvl"]) == (1, 1, 1)
    assert (flat["matched"], flat["coverage"]) == (11, 1)
    assert flat["nees_mean"] is flat["distance_m"] is None


def test_the_page_of_metrics_says_what_is_declared() -> None:
    page, _, _ = (ROOT / "docs" / "metrics.md").read_text(encoding="utf-8").partition("## The rest of report.json")
    every = (*METRICS, *declared(SensorUpdates, "SENSOR").values())
    rows = [f"| `{m.name}` | {m.unit} | {m.direction.replace('both', '')} | {m.meaning} |" for m in every]

    assert re.findall(r"^\| `.*$", page, re.MULTILINE) == rows
