import dataclasses
import math
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from checkout import ROOT
from usbldr.filters.errors import LogError, UsageError
from usbldr.filters.evaluation.consistency import SensorUpdates, consistency, consistency_text, nees, truth_covariances
from usbldr.filters.evaluation.error_report import METRICS, Window
from usbldr.filters.evaluation.evaluation import evaluate
from usbldr.filters.evaluation.metrics import AxisErrors, declared, distance_travelled_m
from usbldr.filters.evaluation.summary_sentence import summary_sentence
from usbldr.filters.types import Trajectory, Truth, Update


def truth_of(time_s, position_m, sd_m=math.nan, max_gap_s=30.0):
    time_s = np.asarray(time_s, dtype=float)
    return Truth(time_s, np.asarray(position_m, float), np.full(len(time_s), sd_m), "simulated", "/truth", max_gap_s)


def track_of(time_s, position_m, cov_m2=None, name="ckf", **more):
    return Trajectory(name, ("x", "y"), np.asarray(time_s, float), np.asarray(position_m, float), cov_m2, **more)


def line(time_s):
    """Half a metre a second east, two north."""
    return np.column_stack([0.5 * np.asarray(time_s), 2.0 * np.asarray(time_s)])


def shifted(time_s, east_m, north_m):
    return line(time_s) + np.column_stack(np.broadcast_arrays(east_m, north_m, time_s)[:2])


SECONDS = np.arange(0.0, 101.0)


def test_a_constant_offset_is_bias_mean_rmse_median_and_p95_at_once() -> None:
    m = evaluate(track_of(SECONDS, shifted(SECONDS, -3.0, 4.0)), truth_of(SECONDS, line(SECONDS))).flat()

    assert m["bias_east_m"] == pytest.approx(-3.0)
    assert m["bias_north_m"] == pytest.approx(4.0)
    for name in ("mean_abs", "rmse", "median_abs", "p95_abs", "max_abs"):
        assert m[f"{name}_east_m"] == pytest.approx(3.0)
        assert m[f"{name}_north_m"] == pytest.approx(4.0)
    for name in ("mean", "rmse", "median", "p95", "max", "final"):
        assert m[f"{name}_horizontal_m"] == pytest.approx(5.0)
    assert m["std_horizontal_m"] == pytest.approx(0.0, abs=1e-9)


def test_known_errors_have_the_statistics_that_one_can_count_on_fingers() -> None:
    track = track_of([0, 1, 2, 3], np.column_stack([[3.0, -1.0, 2.0, 0.0], np.zeros(4)]))
    found = evaluate(track, truth_of([0, 3], np.zeros((2, 2))))

    east = found.east
    assert (east.bias_m, east.mean_abs_m, east.median_abs_m) == pytest.approx((1.0, 1.5, 1.5))
    assert (east.rmse_m, east.max_abs_m) == (pytest.approx(math.sqrt(14 / 4)), 3.0)
    assert found.horizontal.final_m == 0.0
    assert found.horizontal.rmse_m == pytest.approx(math.hypot(east.rmse_m, found.north.rmse_m))


def test_only_the_times_asked_for_are_scored() -> None:
    fast = np.arange(0, 501) / 5
    off = line(fast)
    off[np.arange(501) % 5 != 0] += 100.0  # between the seconds

    report = evaluate(track_of(fast, off), truth_of(SECONDS, line(SECONDS)), times_s=SECONDS)

    assert report.horizontal.max_m == pytest.approx(0.0, abs=1e-9)
    assert report.matching.matched == report.matching.candidates == 101


def test_times_outside_the_truth_and_in_its_gaps_are_left_out_and_counted() -> None:
    truth_s = np.concatenate([np.arange(10.0, 41.0), np.arange(75.0, 91.0)])  # a hole of 35 s

    report = evaluate(track_of(SECONDS, line(SECONDS)), truth_of(truth_s, line(truth_s)))
    bridged = evaluate(track_of(SECONDS, line(SECONDS)), truth_of([0, 30, 60, 90], line([0, 30, 60, 90]))).matching

    counts = report.matching
    assert (counts.candidates, counts.matched, counts.truth_rows) == (101, 47, 47)
    assert counts.outside_truth == 20  # 0 to 9, 91 to 100
    assert counts.in_gap == 34  # 41 to 74; the ends of the hole are truth
    assert report.coverage.share == pytest.approx(47 / 101)
    assert "47 of 101" in report.warnings[0]
    assert (bridged.in_gap, bridged.matched, bridged.truth_rows) == (0, 91, 4)  # gaps just within the limit


def test_the_window_chooses_truth_rows_and_scores_between_those_left() -> None:
    truth_s = np.arange(0.5, 100.0, 2.0)  # 0.5, 2.5, ...

    report = evaluate(track_of(SECONDS, line(SECONDS)), truth_of(truth_s, line(truth_s)), Window(10.5, 20.0))

    assert (report.time_s[0], report.time_s[-1]) == (11.0, 18.0)  # rows 10.5 to 18.5
    assert report.matching.outside_window == 11 + 80  # 0 to 10, 21 to 100
    assert report.matching.outside_truth == 2  # 19, 20: after the last row left
    assert report.warnings == ()  # the user's own choice is no low coverage


def test_first_moves_the_tracks_first_epoch_onto_the_first_truth_row_and_warns_if_that_is_far_apart() -> None:
    t, late_s = SECONDS + 0.5, np.arange(60.0, 100.0)

    report = evaluate(track_of(t, shifted(t, 7.0, -9.0)), truth_of(SECONDS, line(SECONDS)), align="first")
    late = evaluate(track_of(late_s, line(late_s)), truth_of(SECONDS, line(SECONDS)), align="first")

    # the epoch of 0.5 s lies on the truth of 0.0 s, so the whole track is half a second late
    assert report.alignment.shift_m == pytest.approx((-7.0 - 0.25, 9.0 - 1.0))
    assert (report.east.bias_m, report.north.bias_m) == pytest.approx((-0.25, -1.0))
    assert "60.0 s earlier" in late.warnings[0]


def test_rigid_takes_back_a_rotation_and_a_shift_and_turns_the_covariance_with_them() -> None:
    rng = np.random.default_rng(4)
    true = rng.normal(0, 50, (101, 2))
    angle = math.radians(25.0)
    R = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    cov = np.broadcast_to(R.T @ np.diag([9.0, 1.0]) @ R, (101, 2, 2))  # of the track in its own, turned frame

    report = evaluate(track_of(SECONDS, (true - [30, -80]) @ R, cov), truth_of(SECONDS, true), align="rigid")

    assert report.horizontal.max_m == pytest.approx(0.0, abs=1e-9)
    assert report.alignment.rotation_rad == pytest.approx(angle)
    assert report.alignment.shift_m == pytest.approx((30.0, -80.0))
    assert report.cov_m2[0] == pytest.approx(np.diag([9.0, 1.0]))
    assert "-25.000 deg clockwise" in report.alignment.sentence


@pytest.mark.parametrize("stated_m", [None, (0.5, 1.5, 0.0)])
def test_body_finds_what_the_stated_lever_arm_of_the_truth_lacks_and_tells_the_sum(stated_m) -> None:
    track, antenna = turning_track()

    report = evaluate(track, dataclasses.replace(antenna, lever_m=stated_m or antenna.lever_m), align="body")

    assert report.horizontal.max_m == pytest.approx(0.0, abs=1e-9)
    assert report.alignment.lever_m == pytest.approx((0.5, 2.0))
    assert "+0.500 m starboard, +2.000 m forward" in report.alignment.sentence
    with pytest.raises(LogError, match="--align body needs the heading"):
        evaluate(track_of(SECONDS, track.position_m), antenna, align="body")


def turning_track() -> tuple[Trajectory, Truth]:
    """The truth's antenna is 2 m ahead and 0.5 m to starboard of the tracked point, by hand at each heading."""
    rng = np.random.default_rng(6)
    heading = np.linspace(0.0, 2 * math.pi, 101)  # clockwise from north
    track_m = np.cumsum(rng.normal(0, 1, (101, 2)), axis=0)
    ahead = np.column_stack([np.sin(heading), np.cos(heading)])
    starboard = np.column_stack([np.cos(heading), -np.sin(heading)])
    mean = np.column_stack([-heading, track_m])
    track = Trajectory("ckf", ("psi", "x", "y"), SECONDS, mean, None)
    return track, truth_of(SECONDS, track_m + 2.0 * ahead + 0.5 * starboard)


@pytest.mark.parametrize(("align", "turned_deg"), [("none", 0), ("first", 0), ("rigid", 0), ("rigid", 30)])
def test_a_stated_lever_arm_of_the_truth_leaves_no_error(align: str, turned_deg: float) -> None:
    """The track's whole world may be turned, its headings too."""
    track, antenna = turning_track()
    angle = math.radians(turned_deg)
    turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    track = dataclasses.replace(track, mean=np.column_stack([track.mean[:, 0] - angle, track.position_m @ turn]))

    report = evaluate(track, dataclasses.replace(antenna, lever_m=(0.5, 2.0, -1.0)), align=align)

    assert report.horizontal.max_m == pytest.approx(0.0, abs=1e-9)
    assert report.alignment.rotation_rad == pytest.approx(angle)
    assert report.alignment.shift_m == pytest.approx((0.0, 0.0), abs=1e-9)
    assert "the point of the truth (+0.500 m starboard, +2.000 m forward)" in report.alignment.sentence
    np.testing.assert_allclose(report.alignment.points(track.position_m, track.state("psi")), antenna.position_m)


def test_raw_fixes_cannot_be_moved_to_the_point_of_the_truth_and_that_is_told() -> None:
    track, antenna = turning_track()
    raw = track_of(SECONDS, track.position_m, name="usbl")

    report = evaluate(raw, dataclasses.replace(antenna, lever_m=(0.5, 2.0, 0.0)))

    assert report.horizontal.mean_m == pytest.approx(math.hypot(0.5, 2.0))
    assert "lever arm of the truth" in report.warnings[-1]


@pytest.mark.parametrize(
    ("truth_s", "speed", "how", "fault", "said"),
    [
        (SECONDS, 0.0, {"align": "se3"}, UsageError, "none, shift, first, rigid"),
        (SECONDS, 0.0, {"align": "rigid"}, LogError, "all at one place"),
        (SECONDS + 500, 1.0, {}, LogError, r"0\.0 to 100\.0 s.*/truth \(500\.0 to 600\.0 s"),
        (SECONDS, 1.0, {"window": Window(300, 400)}, LogError, r"no truth row between 300 and 400 s.*0\.0 to 100\.0 s"),
    ],
)
def test_an_unknown_or_impossible_alignment_and_a_track_that_never_meets_the_truth_are_sentences(
    truth_s, speed, how, fault, said
) -> None:
    with pytest.raises(fault, match=said):
        evaluate(track_of(SECONDS, speed * line(SECONDS)), truth_of(truth_s, speed * line(SECONDS)), **how)


def test_an_epoch_without_a_position_is_left_out_and_said_and_one_that_a_track_lacks_lowers_its_coverage() -> None:
    broken, truth = line(SECONDS), truth_of(SECONDS, line(SECONDS))
    broken[90:] = np.nan

    report = evaluate(track_of(SECONDS, broken), truth)
    shorter = evaluate(track_of(SECONDS[:51], line(SECONDS[:51])), truth, times_s=SECONDS)

    assert report.matching.undefined == 11
    assert report.horizontal.max_m == pytest.approx(0.0, abs=1e-9)
    assert "no position at 11 epochs" in report.warnings[0]
    assert shorter.coverage.share == pytest.approx(51 / 101)


def test_nees_of_errors_drawn_from_the_covariance_is_two_and_inside_its_bounds() -> None:
    rng = np.random.default_rng(0)
    t = np.arange(20_000.0)
    P = np.array([[4.0, 1.5], [1.5, 1.0]])
    errors = rng.multivariate_normal([0, 0], P, len(t))

    report = evaluate(track_of(t, errors, np.broadcast_to(P, (len(t), 2, 2))), truth_of(t, np.zeros((len(t), 2))))

    assert report.nees.mean == pytest.approx(2.0, abs=0.06)  # 3 sigma of the mean of 20,000
    assert report.nees.low < 2.0 < report.nees.high
    assert report.nees.high - report.nees.low == pytest.approx(2 * 1.96 * 2 / math.sqrt(len(t)), rel=0.05)
    assert report.sigma_shares == pytest.approx([0.6827, 0.9545, 0.9973], abs=0.005)
    assert consistency_text(report.nees) == "consistent"


def test_nees_counts_the_truths_own_sigma() -> None:
    cov = np.broadcast_to(np.diag([3.0, 8.0]), (101, 2, 2))

    known = evaluate(track_of(SECONDS, shifted(SECONDS, 2.0, 3.0), cov), truth_of(SECONDS, line(SECONDS), sd_m=1.0))
    unknown = evaluate(track_of(SECONDS, shifted(SECONDS, 2.0, 3.0), cov), truth_of(SECONDS, line(SECONDS)))

    assert known.flat()["nees_mean"] == pytest.approx(4 / 4 + 9 / 9)
    assert unknown.flat()["nees_mean"] == pytest.approx(4 / 3 + 9 / 8)
    assert known.sd_m[0] == pytest.approx([2.0, 3.0])


def test_a_covariance_of_zero_makes_nees_huge_but_raises_nothing() -> None:
    report = evaluate(track_of(SECONDS, line(SECONDS) + 1, np.zeros((101, 2, 2))), truth_of(SECONDS, line(SECONDS)))

    assert report.nees.mean > 1e10
    assert consistency_text(report.nees).startswith("sigmas too small")


@pytest.mark.parametrize(("factor", "said"), [(2.6, "small by 2.6"), (289.2, "small by 289"), (0.25, "large by 4.0")])
def test_the_verdict_on_consistency_is_the_factor_of_the_sigmas(factor: float, said: str) -> None:
    rng = np.random.default_rng(2)
    t = np.arange(50_000.0)
    errors = factor * rng.normal(size=(len(t), 2))

    report = evaluate(track_of(t, errors, np.broadcast_to(np.eye(2), (len(t), 2, 2))), truth_of(t, 0 * errors))

    sentence = f"sigmas too {said.replace('by', 'by a factor of')}"
    assert consistency_text(report.nees) == sentence
    too_large = ", but they contain the shift that was taken off" if factor < 1 else ""
    assert consistency_text(report.nees, shift_removed=True) == sentence + too_large


@pytest.mark.long
def test_bounds_hold_for_correlated_errors_as_often_as_they_say() -> None:
    rng = np.random.default_rng(6)
    a, M, runs, kept = 0.9, 1000, 200, 0
    shocks = math.sqrt(1 - a**2) * rng.normal(size=(runs, M, 2))
    errors = np.zeros((runs, M, 2))
    errors[:, 0] = rng.normal(size=(runs, 2))
    for k in range(1, M):
        errors[:, k] = a * errors[:, k - 1] + shocks[:, k]

    for run in errors:
        found = consistency(run, np.broadcast_to(np.eye(2), (M, 2, 2)))
        assert found
        kept += consistency_text(found[0]) == "consistent"

    assert kept / runs == pytest.approx(0.95, abs=0.05)  # bounds for M independent errors keep about 0.5


def update(sensor: str, nis: float, dof: int, fate: str) -> Update:
    return Update(sensor, "position", 0, 0.0, (0.0,) * dof, (1.0,) * dof, nis, dof, fate, 1.0)


def test_nis_is_averaged_per_sensor_with_the_rejected() -> None:
    of_usbl = (("usbl", 1.0, 2, "used"), ("usbl", 5.0, 2, "down-weighted"), ("usbl", 99.0, 2, "rejected"))
    updates = (*(update(*one) for one in of_usbl), update("dvl", 0.5, 1, "used"))
    track = track_of(SECONDS, line(SECONDS), updates=updates)

    sensors = evaluate(track, truth_of(SECONDS, line(SECONDS))).sensors

    assert sensors == {"dvl": (0.5, 1.0, 1, 0, 0), "usbl": (35.0, 2.0, 1, 1, 1)}


def test_the_first_truth_sample_after_a_long_gap_tells_the_surfacing_error() -> None:
    truth_s = np.concatenate([np.arange(0.0, 11.0), np.arange(60.5, 100.0)])
    mean = np.column_stack([np.zeros(101), np.full(101, 2.0), shifted(SECONDS, 3.0, 4.0)])
    track = Trajectory("ckf", ("u", "v", "x", "y"), SECONDS, mean, None)

    report = evaluate(track, truth_of(truth_s, line(truth_s)))

    (found,) = report.surfacings
    assert (found.time_s, found.gap_s, found.error_m, found.distance_m) == pytest.approx((60.5, 50.5, 5.0, 101.0))
    assert report.flat()["surfacing_percent"] == pytest.approx(100 * 5 / 101)


def test_drift_of_dead_reckoning_is_per_cent_of_the_way() -> None:
    mean = np.column_stack([np.full(101, 3.0), np.full(101, 4.0), line(SECONDS)])
    mean[:, 2] += 0.05 * SECONDS
    track = Trajectory("dr", ("u", "v", "x", "y"), SECONDS, mean, None, seconds=2.0)

    m = evaluate(track, truth_of(SECONDS, line(SECONDS))).flat()

    assert (m["distance_m"], m["drift_percent"]) == pytest.approx((500.0, 1.0))
    assert distance_travelled_m(track)[50] == pytest.approx(250.0)


def test_ess_is_given_as_a_share_of_the_particles() -> None:
    track = track_of(SECONDS, line(SECONDS), particles=200, ess=np.full(101, 150.0), acceptance=np.full(101, np.nan))

    health = evaluate(track, truth_of(SECONDS, line(SECONDS))).health

    assert health.ess_mean_ratio == pytest.approx(0.75)
    assert health.acceptance_mean is None


def test_no_metric_is_ever_nan() -> None:
    track = track_of([5.0], [[0.0, 0.0]], np.full((1, 2, 2), np.nan), updates=(update("usbl", math.nan, 2, "used"),))

    m = evaluate(dataclasses.replace(track, ess=np.array([np.nan])), truth_of([0, 10], np.zeros((2, 2)))).flat()

    assert all(value is None or math.isfinite(value) for value in m.values())
    assert m["nees_mean"] is None


def with_mean(name: str, metres: float):
    """A track whose error of so many metres changes sides: no constant shift."""
    sides = np.where(np.arange(len(SECONDS)) % 2, metres, -metres)
    return evaluate(track_of(SECONDS, shifted(SECONDS, sides, 0.0), name=name), truth_of(SECONDS, line(SECONDS)))


def test_the_verdict_compares_with_doing_without() -> None:
    usbl, dr = with_mean("usbl", 1.0), with_mean("dr", 2.3)

    def line(name: str, metres: float) -> str:
        return summary_sentence(with_mean(name, metres), [usbl, dr])

    assert line("cpf", 0.69) == "cpf: mean horizontal error 0.69 m, 31 % better than raw USBL, 70 % better than DR"
    assert line("cpf", 1.15) == "cpf: mean horizontal error 1.15 m, 15 % worse than raw USBL, 50 % better than DR"
    worse = "cpf: mean horizontal error 7.00 m, 7.0 times worse than raw USBL, 3.0 times worse than DR"
    assert line("cpf", 7.0) == worse
    assert line("ekf", 1.0) == "ekf: mean horizontal error 1.00 m, equal to raw USBL, 57 % better than DR"
    assert line("usbl", 1.0) == "usbl: mean horizontal error 1.00 m, 57 % better than DR"
    assert summary_sentence(usbl) == "usbl: mean horizontal error 1.00 m"


def test_the_verdict_says_if_few_epochs_have_a_truth() -> None:
    surfaced = truth_of(SECONDS[: len(SECONDS) // 4 + 1], line(SECONDS[: len(SECONDS) // 4 + 1]))
    found = evaluate(track_of(SECONDS, shifted(SECONDS, np.zeros(len(SECONDS)), 1.0), name="dr"), surfaced)
    share = 100 * (len(SECONDS) // 4 + 1) / len(SECONDS)
    assert summary_sentence(found).endswith(f", in the {share:.0f} % of the epochs that have a truth")


def uib_field(field_logs: Path, name: str) -> tuple[Trajectory, Truth, int]:
    """The published fixes and truth read by pandas alone; the log's start is the first truth row."""
    folder = field_logs / "uib_field" / "csv"
    if not folder.is_dir():
        pytest.skip("no uib_field log")
    truth = pd.read_csv(folder / "graph_vertices_455.txt", skipinitialspace=True, comment="%", header=None)
    start_s = float(truth[0][0])
    fixes = pd.read_csv(folder / name, index_col=False, low_memory=False)
    prefix = "field.pose.pose.position."
    fix_m = fixes[[prefix + "y", prefix + "x"]].to_numpy()
    track = track_of(fixes["field.header.stamp"].to_numpy() / 1e9 - start_s, fix_m, name="usbl")
    return track, truth_of(truth[0][2:] - start_s, truth[[3, 2]][2:]), int(start_s * 1e9)


def test_an_independent_evaluator_finds_the_same_errors_on_uib_field(field_logs: Path, tmp_path: Path) -> None:
    tool = field_logs.parent / "tools" / "evaluate_track.py"
    if not tool.is_file():
        pytest.skip("no evaluate_track.py beside the field logs")
    track, truth, start_ns = uib_field(field_logs, "modem_delayed_acoustic.txt")
    table = pd.DataFrame(track.position_m, columns=["east_m", "north_m"])
    table.insert(0, "time_s", track.time_s + start_ns / 1e9)
    table.to_csv(tmp_path / "track.csv", index=False)
    command = [sys.executable, tool, "track.csv", field_logs / "uib_field", "--skip", "0", "--json", "out"]
    subprocess.run(command, check=True, capture_output=True, cwd=tmp_path)
    found = pd.read_json(tmp_path / "out", typ="series")

    by_a = evaluate(track, truth, Window(4.0, 1084.5), "first").flat()
    plain = evaluate(track, truth).flat()
    rigid = evaluate(track, truth, align="rigid")

    names = {"abs_e": "mean_abs_east_m", "abs_n": "mean_abs_north_m", "mean": "mean_horizontal_m"}
    names |= {"rmse": "rmse_horizontal_m", "median": "median_horizontal_m", "p95": "p95_horizontal_m"}
    names |= {"max": "max_horizontal_m", "end": "final_horizontal_m", "n": "matched", "sd": "std_horizontal_m"}
    for theirs, ours in names.items():
        assert by_a[ours] == pytest.approx(found["A"][theirs], abs=2e-4)
        assert plain[ours] == pytest.approx(found["absolute"][theirs], abs=2e-4)
        assert rigid.flat()[ours] == pytest.approx(found["se2"][theirs], abs=2e-4)
    assert math.degrees(rigid.alignment.rotation_rad) == pytest.approx(found["se2"]["rotation_deg"], abs=1e-3)


def test_a_truth_turned_and_scaled_within_its_stated_sigmas_leaves_nees_at_two() -> None:
    rng, tiny = np.random.default_rng(0), np.tile(1e-8 * np.eye(2), (len(SECONDS), 1, 1))
    track, means = track_of(SECONDS, line(SECONDS) + 5.0, tiny), []
    truth = dataclasses.replace(truth_of(SECONDS, line(SECONDS), 1e-4), heading_sd_rad=0.05, scale_sd=0.03)
    for _ in range(300):
        factor = (1 + rng.normal(0, 0.03)) * np.exp(1j * rng.normal(0, 0.05))
        turned = line(SECONDS) @ np.array([[factor.real, factor.imag], [-factor.imag, factor.real]]) + 5.0
        truth = dataclasses.replace(truth, position_m=turned)
        truth_cov_m2 = truth_covariances(truth, turned, truth.sd_m, turned[0])
        means.append(nees(track.position_m - turned, tiny + truth_cov_m2).mean())

    assert np.mean(means) == pytest.approx(2.0, abs=4 * 2 / math.sqrt(300))  # chi-square of 2: sd 2
    assert evaluate(track, truth).nees.mean == pytest.approx(means[-1])


def report_of_ten_seconds():
    updates = tuple(
        Update(sensor, "position", row, float(row), (1.0, 2.0), (1.0, 1.0), 5.0, 2, outcome, 1.0)
        for row, (sensor, outcome) in enumerate((("usbl", "used"), ("usbl", "rejected"), ("dvl", "down-weighted")))
    )
    track_m = np.random.default_rng(8).normal(size=(11, 2))
    track = track_of(SECONDS[:11], track_m, name="adf", updates=updates, seconds=2.0, smoothed=True)
    return evaluate(track, truth_of(SECONDS[:11], np.zeros((11, 2)), sd_m=1.0))


def test_flat_has_the_declared_metrics_in_their_order_then_those_of_each_sensor_and_all_the_numbers_of_their_fields():
    found = report_of_ten_seconds()
    flat = found.flat()

    assert list(flat)[: len(METRICS)] == [metric.name for metric in METRICS]
    stems = ("nis_mean", "nis_expected", "updates_used", "updates_down_weighted", "updates_rejected")
    assert list(flat)[len(METRICS) :] == [f"{stem}_{sensor}" for sensor in ("dvl", "usbl") for stem in stems]
    assert (found.method, found.label) == ("adf", "adf smoothed")
    assert flat["p95_abs_east_m"] == np.percentile(np.abs(found.error_m[:, 0]), 95) == found.east.p95_abs_m
    assert flat["rmse_north_m"] == np.sqrt(np.mean(found.error_m[:, 1] ** 2)) == found.north.rmse_m
    assert flat["final_horizontal_m"] == np.hypot(*found.error_m[-1]) == found.horizontal.final_m
    assert (flat["fixes_used"], flat["fixes_rejected"], flat["updates_down_weighted_dvl"]) == (1, 1, 1)
    assert (flat["matched"], flat["coverage"]) == (11, 1)
    assert flat["nees_mean"] is flat["distance_m"] is None


def test_the_page_of_metrics_says_what_is_declared() -> None:
    page, _, _ = (ROOT / "docs" / "metrics.md").read_text(encoding="utf-8").partition("## The rest of report.json")
    others = [metric for metric in METRICS if not re.search("_(east|north)_m$", metric.name)]
    every = (*declared(AxisErrors, "AXIS").values(), *others, *declared(SensorUpdates, "SENSOR").values())
    rows = [f"| `{m.name}` | {m.direction.replace('both', '')} | {m.meaning} |" for m in every]

    assert re.findall(r"^\| `.*$", page, re.MULTILINE) == rows
