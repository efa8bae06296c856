"""The guard against clusters of false fixes: simulated dives with a silence, what comes after it, and what is true."""

import functools
import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest

from timelines import five_hz
from usbldr.filters.estimators.cpf import CubatureParticleFilter
from usbldr.filters.estimators.multi_hypothesis import MultiHypothesisFilter
from usbldr.filters.evaluation.consistency import nees
from usbldr.filters.models.motion import VehicleMotion
from usbldr.filters.models.noise import Contamination, Gaussian, Mixture, NoiseFamily
from usbldr.filters.models.parameters import Assumptions, ProcessNoise
from usbldr.filters.models.sigma_points import cubature
from usbldr.filters.models.states import StateLayout
from usbldr.filters.replay.late_fixes import by_validity
from usbldr.filters.replay.methods import METHODS, FilterSettings
from usbldr.filters.replay.prior import prior
from usbldr.filters.replay.run import run
from usbldr.filters.replay.steps import StepSource
from usbldr.filters.types import Reacquisition, Timeline
from usbldr.io.scenarios.library import find_scenario
from usbldr.io.scenarios.simulated_log import simulated_log
from usbldr.io.timeline import timeline

RATE_HZ = 5
SILENT = (60, 210)  # seconds without a fix
END_S = 270
SPEED_MPS = 1.0
UNSURE = ProcessNoise(position_m=0.25)  # 3 m after the silence
SURE = ProcessNoise()
GENERIC = Contamination(0.05, 10.0)


DRIFT = np.array([0.6, 0.8])  # direction of what is false or unseen


class Told(NamedTuple):
    """What a filter told of a dive, at each epoch."""

    mean: np.ndarray  # (K, n)
    cov: np.ndarray  # (K, n, n)
    error_m: np.ndarray  # (K,) horizontal
    nees: np.ndarray  # (K,)
    reacquisitions: tuple[Reacquisition, ...]
    fates: dict[int, str]  # of each fix

    def after(self, seconds: float) -> slice:
        """From so long after the silence on."""
        return slice(int((SILENT[1] + seconds) * RATE_HZ), None)


def dive(
    seed: int, false: int = 0, off_m: float = 0.0, drift_m: float = 0.0, every: int = 1
) -> tuple[Timeline, np.ndarray]:
    """Return a dive to the north at 1 m/s with a fix each second, and where the vehicle really was.

    So many false fixes, all off by the same vector, end the silence; or the vehicle was carried off in it by what no
    DVL saw.
    """
    rng = np.random.default_rng(seed)
    t = np.arange(END_S * RATE_HZ + 1) / RATE_HZ
    K = len(t)
    truth = np.column_stack([np.zeros(K), SPEED_MPS * t])
    truth[t >= SILENT[1]] += drift_m * DRIFT
    fix_s = np.array([s for s in range(0, END_S + 1, every) if not SILENT[0] <= s < SILENT[1]], dtype=float)
    fix_m = truth[(fix_s * RATE_HZ).astype(int)] + 0.5 * rng.normal(size=(len(fix_s), 2))
    fix_m[np.flatnonzero(fix_s >= SILENT[1])[:false]] += off_m * DRIFT
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
) -> Told:
    """Run a filter over the dive, by itself or guarded."""
    assumed = Assumptions(process=process, usbl=usbl)
    motion = VehicleMotion(StateLayout(), process)
    build = METHODS[name].build
    assert build is not None
    estimator = build(motion, FilterSettings(particles=20, gate=gate))
    estimator = MultiHypothesisFilter(estimator, motion) if guarded else estimator
    known = list(
        by_validity(
            estimator, estimator.start(prior(line, assumed, StateLayout())), StepSource(line, assumed, StateLayout()), 0
        )
    )
    mean, cov = np.array([one.estimate.mean for one in known]), np.array([one.estimate.cov for one in known])
    error = mean[:, 4:6] - truth
    fates = {u.row: u.outcome for one in known for u in one.estimate.updates if u.sensor == "usbl"}
    normalised = nees(error, cov[:, 4:6, 4:6])
    return Told(mean, cov, np.hypot(*error.T), normalised, known[-1].estimate.reacquisitions, fates)


@pytest.mark.parametrize("off_m", [20.0, 50.0, 200.0])
@pytest.mark.parametrize("count", [3, 10, 20])
def test_no_cluster_at_the_end_of_a_silence_captures_the_track(count: int, off_m: float) -> None:
    line, truth = dive(1, count, off_m)

    told = replayed("adf", line, truth, UNSURE)

    assert told.error_m[told.after(count + 3)].max() < 3
    assert told.nees[told.after(0)].mean() < 4
    (one,) = told.reacquisitions
    assert not one.accepted
    assert one.since_s == SILENT[1]
    assert one.outage_s == SILENT[1] - SILENT[0] + 1
    assert SILENT[1] < one.resolved_s <= SILENT[1] + count + 2


def test_without_a_guard_such_clusters_do_capture_it() -> None:
    """Else the tests above would show nothing."""
    for off_m in (20.0, 50.0, 200.0):
        line, truth = dive(1, 20, off_m)
        told = replayed("adf", line, truth, UNSURE, guarded=False)
        assert told.error_m[told.after(23)].mean() > 5


@pytest.mark.parametrize("name", ["ekf", "ckf", "ukf", "cpf", "upf"])
def test_every_filter_can_be_guarded(name: str) -> None:
    line, truth = dive(2, 10, 50.0)

    alone = replayed(name, line, truth, UNSURE, guarded=False)
    told = replayed(name, line, truth, UNSURE)

    assert alone.error_m[alone.after(0)].mean() > 5
    assert told.error_m[told.after(0)].mean() < 3
    assert told.error_m[told.after(13)].max() < 3


def test_a_gate_that_a_cluster_has_opened_is_shut_again() -> None:
    line, truth = dive(3, 15, 50.0)

    alone = replayed("ekf", line, truth, UNSURE, guarded=False, gate=0.99)
    told = replayed("ekf", line, truth, UNSURE, gate=0.99)

    assert alone.error_m[alone.after(11)].max() > 40  # the gate gives in after ten
    assert told.error_m[told.after(0)].max() < 5


@pytest.mark.parametrize(
    ("drift_m", "every", "process", "most_fixes"), [(30.0, 1, UNSURE, 25), (30.0, 10, UNSURE, 4), (10.0, 1, SURE, 45)]
)
def test_a_vehicle_that_was_carried_off_is_believed_to_be_there_after_some_fixes(
    drift_m: float, every: int, process: ProcessNoise, most_fixes: int
) -> None:
    """The way is ten sigmas of the unsure filter and thirty of the sure one."""
    line, truth = dive(4, drift_m=drift_m, every=every)

    told = replayed("adf", line, truth, process)

    assert told.error_m[told.after(most_fixes * every)].max() < 3
    sd_m = np.sqrt(told.cov[told.after(0), 4, 4] + told.cov[told.after(0), 5, 5])
    assert sd_m[: most_fixes * every * RATE_HZ].max() > drift_m / 3  # before it is believed it is counted


def test_a_drift_that_is_expected_is_followed_at_once() -> None:
    line, truth = dive(5, drift_m=10.0)

    told = replayed("adf", line, truth, ProcessNoise(position_m=0.8))

    assert told.error_m[told.after(3)].max() < 3
    assert not told.reacquisitions


def test_the_report_tells_how_far_the_track_jumped_and_when() -> None:
    line, truth = dive(4, drift_m=30.0)

    (one,) = replayed("adf", line, truth, UNSURE).reacquisitions

    assert one.accepted
    assert one.since_s == SILENT[1]
    assert one.refused > 5
    assert one.jump_m == pytest.approx(30.0, abs=3.0)
    assert one.resolved_s == SILENT[1] + one.refused


def test_the_filter_as_it_is_may_be_believed_after_its_fixes_were_refused() -> None:
    """Off by four sigmas after ten seconds: too far to be followed at once, too near for another story than drift."""
    line, truth = dive(1)
    truth[40 * RATE_HZ :] += 4.0 * DRIFT
    line.fix_m[40:] += 4.0 * DRIFT
    late = line.with_fixes((line.fix_time_s < 30) | (line.fix_time_s >= 40))

    told = replayed("ekf", late, truth, UNSURE, usbl=Gaussian())

    (one,) = told.reacquisitions
    assert one.accepted
    assert one.jump_m == pytest.approx(4.0, abs=1.0)
    assert 40 < one.resolved_s == 40 + one.refused < 60
    assert told.error_m[int(one.resolved_s + 1) * RATE_HZ : SILENT[0] * RATE_HZ].max() < 1


@pytest.mark.parametrize("family", [GENERIC, Mixture()], ids=["contamination", "mixture"])
@pytest.mark.parametrize("name", ["adf", "cpf"])
def test_without_a_false_fix_the_guard_changes_nothing(name: str, family: NoiseFamily) -> None:
    line, truth = dive(6)

    alone = replayed(name, line, truth, SURE, guarded=False, usbl=family)
    told = replayed(name, line, truth, SURE, usbl=family)

    np.testing.assert_array_equal(told.mean, alone.mean)
    np.testing.assert_array_equal(told.cov, alone.cov)
    assert not told.reacquisitions


def test_a_false_fix_now_and_then_is_no_news_and_does_no_harm() -> None:
    line, truth = dive(7)
    rng = np.random.default_rng(8)
    struck = np.flatnonzero(rng.random(len(line.fix_time_s)) < 0.1)
    line.fix_m[struck] += 15.0 * rng.normal(size=(len(struck), 2))

    told = replayed("adf", line, truth, SURE)
    alone = replayed("adf", line, truth, SURE, guarded=False)

    assert len(struck) > 5
    assert not told.reacquisitions
    assert told.error_m.mean() < 1.02 * alone.error_m.mean()


def test_false_fixes_that_were_found_out_are_told_as_refused() -> None:
    line, truth = dive(1, 10, 50.0)
    told = replayed("adf", line, truth, UNSURE)
    struck = np.flatnonzero(line.fix_time_s >= SILENT[1])

    assert [told.fates[row] for row in struck[1:10].tolist()] == ["rejected"] * 9
    assert {told.fates[row] for row in struck[11:].tolist()} == {"used"}


def test_a_cluster_before_the_silence_does_not_move_a_sure_filter() -> None:
    line, truth = dive(9)
    line.fix_m[30:45] += 30.0 * DRIFT

    told = replayed("adf", line, truth, SURE)

    assert told.error_m[30 * RATE_HZ :].max() < 2


def test_estimates_repeat_when_a_step_is_run_again() -> None:
    line, _ = dive(2, 5, 50.0)
    assumed = Assumptions(process=UNSURE)
    motion = VehicleMotion(StateLayout(), UNSURE)
    guard = MultiHypothesisFilter(CubatureParticleFilter(motion, cubature, 20), motion)
    readings = StepSource(line, assumed, StateLayout())
    belief = guard.start(prior(line, assumed, StateLayout()))
    for k in range(SILENT[1] * RATE_HZ + 8):
        before, step, make_rng = belief, readings.step(k), functools.partial(np.random.default_rng, (0, k))
        belief = guard.step(before, step, make_rng)
        if len(before.hypotheses) > 1:
            again = guard.step(before, step, make_rng)
            np.testing.assert_array_equal(guard.estimate(again).cov, guard.estimate(belief).cov)
    assert len(belief.hypotheses) > 1


def test_a_run_with_the_guard_tells_what_it_decided() -> None:
    line, truth = dive(1, 20, 50.0)
    assumed = Assumptions(process=UNSURE)

    alone, guarded = (run("adf", line, assumed, FilterSettings(guard=on)) for on in (False, True))

    assert not alone.reacquisitions
    assert np.hypot(*(alone.position_m - truth).T)[-1] > 3
    assert np.hypot(*(guarded.position_m - truth).T)[-1] < 3
    assert len(guarded.reacquisitions) == 1
    assert guarded.warnings[-1].startswith(
        "adf: USBL fixes from 210.0 s on after 151 s without any agreed with each other, but not with those before"
    )


def test_a_log_that_ends_while_fixes_are_refused_says_so() -> None:
    line, _ = dive(1, 5, 50.0)
    kept = line.fix_time_s < SILENT[1] + 5  # the false ones are the last
    ended = line.with_fixes(kept)

    track = run("adf", ended, Assumptions(process=UNSURE), FilterSettings(guard=True))

    (one,) = track.reacquisitions
    refused = [update for update in track.updates if update.outcome == "rejected" and update.sensor == "usbl"]
    assert (one.refused, one.accepted) == (5, False)
    assert len({update.row for update in refused}) == 5
    assert all(update.shift is not None and not any(update.shift) for update in refused)


def test_a_log_that_ends_with_a_single_refused_fix_has_no_news() -> None:
    line, _ = dive(1, 5, 50.0)

    track = run(
        "adf", line.with_fixes(line.fix_time_s <= SILENT[1]), Assumptions(process=UNSURE), FilterSettings(guard=True)
    )

    assert [update.outcome for update in track.updates if update.sensor == "usbl"][-2:] == ["used", "rejected"]
    assert not track.reacquisitions


def test_the_guard_knows_at_each_epoch_what_had_arrived() -> None:
    """A late fix rewinds the rivals, too: what is known at the end is what a log without the missing fixes tells."""
    line, _ = dive(1, 10, 50.0)
    late = replace(line, fix_received_s=line.fix_time_s + 2.0)
    known = line.fix_time_s <= END_S - 2.0
    ended = line.with_fixes(known)
    assumed = Assumptions(process=UNSURE)

    online = run("adf", late, assumed, FilterSettings(guard=True, order="arrival"))
    offline = run("adf", ended, assumed, FilterSettings(guard=True))

    np.testing.assert_array_equal(online.mean[-1], offline.mean[-1])
    assert len(online.reacquisitions) == 1
    assert online.reacquisitions == offline.reacquisitions


@pytest.mark.parametrize("seed", [1, 5])
def test_clusters_between_good_fixes_do_not_move_the_track(seed: int) -> None:
    """Echoes for up to 14 s, 4 to 7 m off: nothing can have carried the vehicle there from one second to the next."""
    log = simulated_log(find_scenario("multipath"), seed)
    line = timeline(log)
    assert log.truth is not None
    truth = np.column_stack([np.interp(line.time_s, log.truth.time_s, axis) for axis in log.truth.position_m.T])
    alone, guarded = (
        float(np.hypot(*(run("adf", line, log.assumptions, FilterSettings(guard=on)).position_m - truth).T).max())
        for on in (False, True)
    )

    assert guarded < 1.2 * alone
