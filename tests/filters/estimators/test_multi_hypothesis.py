"""Multiple-hypothesis filters on simulated dives: an outage that ends in a cluster of outliers or in a real drift."""

import functools
import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest

from timelines import five_hz
from uncalibrated import dive_without_calibration
from usbldr.filters.estimators.cpf import CubatureParticleFilter
from usbldr.filters.estimators.hypotheses import Ambiguity, Hypothesis, MultiHypothesisBelief, reacquisition_texts
from usbldr.filters.estimators.kalman import KalmanFilter
from usbldr.filters.estimators.mode_updates import moment_matched
from usbldr.filters.estimators.multi_hypothesis import MultiHypothesisFilter
from usbldr.filters.estimators.protocol import Estimate, Estimates
from usbldr.filters.evaluation.consistency import nees
from usbldr.filters.models.motion import VehicleMotion
from usbldr.filters.models.noise import Contamination, Gaussian, Mixture, NoiseFamily
from usbldr.filters.models.parameters import Parameters, ProcessNoise
from usbldr.filters.models.sigma_points import cubature, linearised
from usbldr.filters.models.states import StateLayout
from usbldr.filters.replay.methods import METHODS, FilterSettings
from usbldr.filters.replay.prior import prior
from usbldr.filters.replay.run import by_validity, run
from usbldr.filters.replay.steps import StepSource, steps
from usbldr.filters.types import Outage, Reacquisition, Timeline
from usbldr.io.reading.epochs import timeline
from usbldr.io.scenarios.shipped import find_scenario
from weaving import Faults, weaving_dive

RATE_HZ = 5
OUTAGE = (60, 210)  # seconds without a fix
END_S = 270
SPEED_MPS = 1.0
UNCERTAIN = ProcessNoise(position_m=0.25)  # 3 m after the outage
CERTAIN = ProcessNoise()
GENERIC = Contamination(0.05, 10.0)


DRIFT = np.array([0.6, 0.8])  # direction of outliers and of drift


class FilterRun(NamedTuple):
    """The estimates of a filter at each of K epochs, and their errors."""

    mean: np.ndarray  # (K, n)
    cov: np.ndarray  # (K, n, n)
    error_m: np.ndarray  # (K,) horizontal
    nees: np.ndarray  # (K,)
    reacquisitions: tuple[Reacquisition, ...]
    outcomes: dict[int, str]  # of each fix

    def after(self, seconds: float) -> slice:
        """The epochs from this long after the outage."""
        return slice(int((OUTAGE[1] + seconds) * RATE_HZ), None)


def dive(
    seed: int, outliers: int = 0, off_m: float = 0.0, drift_m: float = 0.0, every: int = 1
) -> tuple[Timeline, np.ndarray]:
    """Return a dive to the north at 1 m/s with a fix each second, and its true positions.

    The outage ends with ``outliers`` fixes, all off by the same vector; or the vehicle drifted in it by ``drift_m``,
    which the DVL did not measure.
    """
    rng = np.random.default_rng(seed)
    t = np.arange(END_S * RATE_HZ + 1) / RATE_HZ
    K = len(t)
    truth = np.column_stack([np.zeros(K), SPEED_MPS * t])
    truth[t >= OUTAGE[1]] += drift_m * DRIFT
    fix_s = np.array([s for s in range(0, END_S + 1, every) if not OUTAGE[0] <= s < OUTAGE[1]], dtype=float)
    fix_m = truth[(fix_s * RATE_HZ).astype(int)] + 0.5 * rng.normal(size=(len(fix_s), 2))
    fix_m[np.flatnonzero(fix_s >= OUTAGE[1])[:outliers]] += off_m * DRIFT
    velocity = np.column_stack([np.zeros(K), np.full(K, SPEED_MPS)]) + 0.02 * rng.normal(size=(K, 2))
    yaw = math.radians(0.3) * rng.normal(size=K)
    return five_hz(velocity, yaw, fix_s, fix_m, yaw_sd_rad=math.radians(0.3), fix_sd_m=0.5), truth


def replayed(
    name: str,
    line: Timeline,
    truth: np.ndarray,
    process: ProcessNoise,
    guarded: bool = True,
    usbl: NoiseFamily = GENERIC,
    gate: float | None = None,
) -> FilterRun:
    assumed = Parameters(process=process, usbl=usbl)
    motion = VehicleMotion(StateLayout(), process)
    build = METHODS[name].build
    assert build is not None
    estimator = build(motion, FilterSettings(particles=20, gate=gate))
    estimator = MultiHypothesisFilter(estimator, motion) if guarded else estimator
    source = StepSource(line, assumed, StateLayout())
    stretches = by_validity(estimator, prior(line, assumed, StateLayout()), source, 0)
    found = Estimates.joined([one.estimates for one in stretches])
    mean, cov = found.mean, found.cov
    error = mean[:, 4:6] - truth
    outcomes = {u.row: u.outcome for u in found.updates if u.sensor == "usbl"}
    normalised = nees(error, cov[:, 4:6, 4:6])
    return FilterRun(mean, cov, np.hypot(*error.T), normalised, found.reacquisitions, outcomes)


@pytest.mark.parametrize("off_m", [20.0, 50.0, 200.0])
@pytest.mark.parametrize("count", [3, 10, 20])
def test_no_cluster_at_the_end_of_an_outage_captures_the_track(count: int, off_m: float) -> None:
    line, truth = dive(1, count, off_m)

    result = replayed("adf", line, truth, UNCERTAIN)

    assert result.error_m[result.after(count + 3)].max() < 3
    assert result.nees[result.after(0)].mean() < 4
    (one,) = result.reacquisitions
    assert (one.accepted, one.since_s, one.outage_s) == (False, OUTAGE[1], OUTAGE[1] - OUTAGE[0] + 1)
    assert OUTAGE[1] < one.resolved_s <= OUTAGE[1] + count + 2


def test_a_track_that_followed_a_long_cluster_returns_with_its_end() -> None:
    """Fixes that agree for 40 s are followed; those after them agree with the track before, so both were outliers."""
    line, truth = dive(1, 40, 50.0)

    result = replayed("adf", line, truth, UNCERTAIN)

    assert result.error_m[result.after(20)].max() > 40
    assert result.error_m[result.after(46)].max() < 3


@pytest.mark.parametrize(
    "name", ["ukf", "cpf", *(pytest.param(name, marks=pytest.mark.slow) for name in ("ekf", "ckf", "upf"))]
)
def test_every_filter_can_be_guarded(name: str) -> None:
    line, truth = dive(2, 10, 50.0)

    alone = replayed(name, line, truth, UNCERTAIN, guarded=False)
    result = replayed(name, line, truth, UNCERTAIN)

    assert alone.error_m[alone.after(0)].mean() > 5
    assert result.error_m[result.after(0)].mean() < 3
    assert result.error_m[result.after(13)].max() < 3


def test_a_gate_that_a_cluster_has_opened_rejects_the_cluster_again() -> None:
    line, truth = dive(3, 15, 50.0)

    alone = replayed("ekf", line, truth, UNCERTAIN, guarded=False, gate=0.99)
    result = replayed("ekf", line, truth, UNCERTAIN, gate=0.99)

    assert alone.error_m[alone.after(11)].max() > 40  # the gate opens after ten rejections
    assert result.error_m[result.after(0)].max() < 5


@pytest.mark.parametrize(
    ("drift_m", "every", "process", "most_fixes"),
    [(30.0, 1, UNCERTAIN, 25), (30.0, 10, UNCERTAIN, 4), (10.0, 1, CERTAIN, 45)],
)
def test_a_track_follows_a_real_drift_soon_and_reports_it(drift_m, every, process, most_fixes):
    """The drift is ten sigmas of the uncertain filter and thirty of the certain one."""
    line, truth = dive(4, drift_m=drift_m, every=every)

    result = replayed("adf", line, truth, process)

    assert result.error_m[result.after(most_fixes * every)].max() < 3
    sd_m = np.sqrt(result.cov[result.after(0), 4, 4] + result.cov[result.after(0), 5, 5])
    before_m = sd_m[: most_fixes * every * RATE_HZ]
    assert before_m.max() > drift_m / 3  # the covariance includes the drift before the track does
    (one,) = result.reacquisitions
    assert one.accepted
    assert one.jump_m == pytest.approx(drift_m, abs=3.0)
    if most_fixes == 25:
        assert (one.since_s, one.resolved_s) == (OUTAGE[1], OUTAGE[1] + one.refused)
        assert one.refused > 5


def test_the_nominal_hypothesis_may_lead_again_after_its_fixes_were_rejected() -> None:
    """Four sigmas off after ten seconds: too far to follow at once, too near for the relocated hypothesis."""
    line, truth = dive(1)
    truth[40 * RATE_HZ :] += 4.0 * DRIFT
    line.fix_m[40:] += 4.0 * DRIFT
    late = line.with_fixes((line.fix_time_s < 30) | (line.fix_time_s >= 40))

    result = replayed("ekf", late, truth, UNCERTAIN, usbl=Gaussian())

    (one,) = result.reacquisitions
    assert one.accepted
    assert one.jump_m == pytest.approx(4.0, abs=1.0)
    assert 40 < one.resolved_s == 40 + one.refused < 60
    assert result.error_m[int(one.resolved_s + 1) * RATE_HZ : OUTAGE[0] * RATE_HZ].max() < 1


@pytest.mark.parametrize("family", [GENERIC, Mixture()], ids=["contamination", "mixture"])
@pytest.mark.parametrize("name", ["adf", "cpf"])
def test_without_outliers_the_hypotheses_change_nothing(name: str, family: NoiseFamily) -> None:
    line, truth = dive(6)

    alone = replayed(name, line, truth, CERTAIN, guarded=False, usbl=family)
    result = replayed(name, line, truth, CERTAIN, usbl=family)

    np.testing.assert_array_equal(result.mean, alone.mean)
    np.testing.assert_array_equal(result.cov, alone.cov)
    assert not result.reacquisitions


def test_single_outliers_are_not_reported_and_do_no_harm() -> None:
    line, truth = dive(7)
    rng = np.random.default_rng(8)
    hit = np.flatnonzero(rng.random(len(line.fix_time_s)) < 0.1)
    line.fix_m[hit] += 15.0 * rng.normal(size=(len(hit), 2))

    result = replayed("adf", line, truth, CERTAIN)
    alone = replayed("adf", line, truth, CERTAIN, guarded=False)

    assert len(hit) > 5
    assert not result.reacquisitions
    assert result.error_m.mean() < 1.02 * alone.error_m.mean()


@pytest.mark.parametrize("name", ["adf", "cpf"])
@pytest.mark.parametrize("later_s", [4, 12])
def test_fixes_after_a_single_outlier_are_used_though_an_outage_is_still_remembered(name: str, later_s: int) -> None:
    line, truth = dive(0)
    outlier = int(np.flatnonzero(line.fix_time_s == OUTAGE[1] + later_s)[0])
    line.fix_m[outlier] += 30.0 * DRIFT

    result = replayed(name, line, truth, UNCERTAIN)

    assert [row for row, outcome in result.outcomes.items() if outcome != "used"] == [outlier]


def test_a_cluster_before_the_outage_does_not_move_a_certain_filter() -> None:
    line, truth = dive(9)
    line.fix_m[30:45] += 30.0 * DRIFT

    result = replayed("adf", line, truth, CERTAIN)

    assert result.error_m[30 * RATE_HZ :].max() < 2


def test_estimates_repeat_when_a_step_is_run_again() -> None:
    line, _ = dive(2, 5, 50.0)
    assumed = Parameters(process=UNCERTAIN)
    motion = VehicleMotion(StateLayout(), UNCERTAIN)
    guard = MultiHypothesisFilter(CubatureParticleFilter(motion, cubature, 20), motion)
    every = steps(line, assumed, StateLayout())
    belief = guard.start(prior(line, assumed, StateLayout()))
    for k in range(OUTAGE[1] * RATE_HZ + 8):
        before, step, make_rng = belief, every[k], functools.partial(np.random.default_rng, (0, k))
        belief = guard.step(before, step, make_rng)
        if len(before.hypotheses) > 1:
            again = guard.step(before, step, make_rng)
            np.testing.assert_array_equal(guard.estimate(again).cov, guard.estimate(belief).cov)
    assert len(belief.hypotheses) > 1


def test_a_gross_outlier_says_nothing_about_the_fixes_before_it() -> None:
    line, _ = dive(2, 2, 50.0)
    line.fix_m[np.flatnonzero(line.fix_time_s == OUTAGE[1] + 2)] = 1e6
    assumed, motion = Parameters(process=UNCERTAIN), VehicleMotion(StateLayout(), UNCERTAIN)
    guard = MultiHypothesisFilter(KalmanFilter(motion, linearised, moment_matched), motion)
    belief = guard.start(prior(line, assumed, StateLayout()))
    log_odds: list[float] = []
    for k, step in enumerate(steps(line, assumed, StateLayout())[: (OUTAGE[1] + 3) * RATE_HZ]):
        belief = guard.step(belief, step, functools.partial(np.random.default_rng, (0, k)))
        weight = {one.kind: math.exp(one.log_weight) for one in belief.hypotheses}
        outliers = weight.get("rejecting", 0.0) + weight.get("resumed", 0.0)
        log_odds.append(math.log(outliers / (1 - outliers)) if 0 < outliers < 1 else math.nan)

    before, after = log_odds[(OUTAGE[1] + 1) * RATE_HZ], log_odds[-1]
    assert math.isfinite(before)
    assert after == pytest.approx(before, abs=0.1)  # but for the widths of their predictions


def test_a_run_warns_of_each_reacquisition() -> None:
    line, truth = dive(1, 20, 50.0)
    line, assumed = replace(line, outages=(Outage("usbl", *map(float, OUTAGE)),)), Parameters(process=UNCERTAIN)

    alone, guarded = (run("adf", line, assumed, FilterSettings(guard=on)) for on in (False, True))

    assert not alone.reacquisitions
    assert np.hypot(*(alone.position_m - truth).T)[-1] > 3
    assert np.hypot(*(guarded.position_m - truth).T)[-1] < 3
    assert len(guarded.reacquisitions) == 1
    said = "adf: USBL fixes from 210.0 s (after an outage of 151 s) contradicted the fixes before"
    assert any(text.startswith(said) for text in guarded.warnings)


def test_a_log_that_ends_while_fixes_are_rejected_reports_them_and_a_single_one_not() -> None:
    line, _ = dive(1, 5, 50.0)  # the outliers are the last
    track, single = (
        run("adf", line.with_fixes(rows), Parameters(process=UNCERTAIN), FilterSettings(guard=True))
        for rows in (line.fix_time_s < OUTAGE[1] + 5, line.fix_time_s <= OUTAGE[1])
    )

    (one,) = track.reacquisitions
    rejected = [update for update in track.updates if update.outcome == "rejected" and update.sensor == "usbl"]
    assert (one.refused, one.accepted) == (5, False)
    assert len({update.row for update in rejected}) == 5
    assert all(update.shift is not None and not any(update.shift) for update in rejected)
    assert [update.outcome for update in single.updates if update.sensor == "usbl"][-2:] == ["used", "rejected"]
    assert not single.reacquisitions


def test_each_epoch_uses_only_the_fixes_that_had_arrived() -> None:
    """A late fix rewinds the hypotheses, too: the end equals that of a log without the fixes that had not arrived."""
    line, _ = dive(1, 10, 50.0)
    late = replace(line, fix_received_s=line.fix_time_s + 2.0)
    known = line.fix_time_s <= END_S - 2.0
    ended = line.with_fixes(known)
    assumed = Parameters(process=UNCERTAIN)

    online = run("adf", late, assumed, FilterSettings(guard=True, order="arrival"))
    offline = run("adf", ended, assumed, FilterSettings(guard=True))

    np.testing.assert_array_equal(online.mean[-1], offline.mean[-1])
    assert len(online.reacquisitions) == 1
    assert online.reacquisitions == offline.reacquisitions


@pytest.mark.parametrize("seed", [1, 5])
def test_clusters_between_good_fixes_do_not_move_the_track(seed: int) -> None:
    """Echoes for up to 14 s, 4 to 7 m off: no vehicle can move so far in a second."""
    log = dive_without_calibration(find_scenario("multipath"), seed)
    line = timeline(log)
    truth = np.column_stack([np.interp(line.time_s, log.truth.time_s, axis) for axis in log.truth.position_m.T])
    tracks = (run("adf", line, log.parameters, FilterSettings(guard=on)) for on in (False, True))
    alone, guarded = (float(np.hypot(*(track.position_m - truth).T).max()) for track in tracks)

    assert guarded < 1.2 * alone


def test_hypotheses_a_whole_turn_apart_have_the_same_heading() -> None:
    motion = VehicleMotion(StateLayout(), CERTAIN)
    guard = MultiHypothesisFilter(KalmanFilter(motion, linearised, moment_matched), motion)
    here = Estimate(np.array([0.3, 0.0, 1.0, 0.0, 5.0, 6.0]), np.eye(6), (), 1.0, math.nan)
    turned = here._replace(mean=here.mean + np.array([2 * math.pi, 0.0, 0.0, 0.0, 0.0, 0.0]))
    both = (Hypothesis("nominal", None, here, math.log(0.6)), Hypothesis("relocated", None, turned, math.log(0.4)))
    belief = MultiHypothesisBelief(both, Ambiguity(0.0, 1.0, 0.0, accepting=("nominal", "relocated")), 0.0)

    np.testing.assert_allclose(guard.estimate(belief).cov, here.cov, atol=1e-12)


def test_a_track_has_no_whole_turns_after_an_unknown_heading() -> None:
    line = weaving_dive(Faults(), seconds=160)
    unknown = replace(line, yaw_count=np.where((line.time_s > 80) & (line.time_s < 120), 0, line.yaw_count))

    track = run("adf", unknown, Parameters(process=ProcessNoise(turn_rate_radps=0.6)))

    assert np.abs(np.diff(track.mean[:, 0])).max() < math.pi


def accepted(since_s: float, jump_m: float, refused: int = 1) -> Reacquisition:
    return Reacquisition(since_s, 1.0, since_s + 5.0, refused, jump_m, accepted=True)


def test_a_few_ambiguities_are_told_one_by_one() -> None:
    rejected = Reacquisition(700.0, 30.0, 704.0, 2, 0.0, accepted=False)

    assert reacquisition_texts([accepted(555.0, 1.7), rejected], 20.0) == (
        "USBL fixes from 555.0 s contradicted the track: accepted at 560.0 s after 1 rejected fix; track moved 1.7 m",
        "USBL fixes from 700.0 s (after an outage of 30 s) contradicted the fixes before and after them: "
        "rejected at 704.0 s (2 fixes)",
    )


def test_of_many_ambiguities_the_largest_are_told_in_the_order_of_the_dive() -> None:
    found = [accepted(100.0 * k, jump_m) for k, jump_m in enumerate((1.0, 9.0, 2.0, 8.0, 7.0, 6.0, 5.0))]

    summary, *texts = reacquisition_texts(found)

    assert "7 times: 7 times accepted, 0 times rejected" in summary
    assert [text.rpartition("moved ")[2] for text in texts] == ["9.0 m", "8.0 m", "7.0 m", "6.0 m", "5.0 m"]
