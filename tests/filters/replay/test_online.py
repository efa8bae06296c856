"""The filter in a loop of one's own, against replay of the same records; what of late fixes is known when."""

import math
from dataclasses import replace

import numpy as np
import pytest

from logs import refusal
from timelines import HZ, five_hz
from usbldr.filters.errors import UsageError
from usbldr.filters.models.noise import Gaussian
from usbldr.filters.models.parameters import Parameters, ProcessNoise, Start
from usbldr.filters.replay.methods import METHODS, FilterSettings
from usbldr.filters.replay.online import OnlineFilter
from usbldr.filters.replay.run import run
from usbldr.filters.types import Timeline, Update
from usbldr.io.reading.epochs import timeline
from usbldr.io.scenarios.shipped import find_scenario
from usbldr.io.scenarios.simulated_log import simulated_log

FILTERS = [name for name, method in METHODS.items() if method.is_filter]
STARTED = Parameters(start=Start(0.0, 0.0, 2.0), calibrate=("scale",), dvl_lever_m=(0.3, 1.0, 0.0))
SETTINGS = FilterSettings(particles=20, seed=3)
COV_M2 = np.eye(2)


def one_record_per_epoch(seconds: int = 40) -> Timeline:
    """Turn slowly at 1 m/s. An epoch has a heading (in whole degrees), a velocity or a fix; the first has nothing."""
    K, rng = seconds * HZ, np.random.default_rng(5)
    kind, epochs_s = np.arange(K) % 3, np.arange(K) / HZ
    yaw = -np.array([math.radians(degree) for degree in np.round(0.2 * epochs_s + rng.normal(size=K))])
    mps = np.array([0.1, 1.0]) + 0.02 * rng.normal(size=(K, 2))
    fixes = kind == 2
    fix_m = np.column_stack([0 * epochs_s, epochs_s])[fixes] + rng.normal(size=(fixes.sum(), 2))
    yaw_count, dvl_count = (((kind == which) & (epochs_s > 0)).astype(np.intp) for which in (0, 1))
    sd_rad = math.radians(1.0)
    return five_hz(mps, yaw, epochs_s[fixes], fix_m, yaw_sd_rad=sd_rad, yaw_count=yaw_count, dvl_count=dvl_count)


def started(method: str, line: Timeline, parameters: Parameters, settings: FilterSettings = SETTINGS) -> OnlineFilter:
    online = OnlineFilter(method, parameters, settings)
    assert online.heading(0.0, degrees(-line.dr_yaw_rad[0]), degrees(line.yaw_sd_rad[0])) is None
    assert online.velocity(0.0, line.dr_mps[0, 0], line.dr_mps[0, 1], line.dvl_sd_mps[0]) is None
    return online


def taken(online: OnlineFilter, line: Timeline, k: int) -> list[Update | None]:
    """Give the filter what an epoch has, with the sigma of the mean of its records."""
    t = float(line.time_s[k])
    done: list[Update | None] = []
    if n := line.yaw_count[k]:
        done.append(online.heading(t, degrees(-line.yaw_rad[k]), degrees(line.yaw_sd_rad[k]) / math.sqrt(n)))
    if n := line.dvl_count[k]:
        done.append(online.velocity(t, line.dvl_mps[k, 0], line.dvl_mps[k, 1], line.dvl_sd_mps[k] / math.sqrt(n)))
    for f in np.flatnonzero(np.searchsorted(line.time_s, line.fix_received_s) == k):
        done.append(online.fix(float(line.fix_time_s[f]), line.fix_m[f, 0], line.fix_m[f, 1], line.fix_cov_m2[f]))
    return done


def degrees(angle_rad: float) -> float:
    return round(math.degrees(angle_rad), 12)  # whole degrees pass without loss


@pytest.mark.parametrize("gap_s", [0.0, 10.0])
@pytest.mark.parametrize("method", FILTERS)
def test_with_one_record_per_epoch_the_track_is_that_of_replay_to_the_last_bit(method: str, gap_s: float) -> None:
    """Also in a gap of the DVL, in which the velocity relaxes."""
    line = one_record_per_epoch()
    gap = (line.time_s > 20) & (line.time_s < 20 + gap_s)
    line = replace(line, dvl_count=np.where(gap, 0, line.dvl_count))
    track, online = run(method, line, STARTED, SETTINGS), started(method, line, STARTED)

    means, updates = [[*online.estimate.states.values()]], list[Update | None]()
    for k in range(1, len(line.time_s)):
        done = taken(online, line, k)
        if not done:
            online.predict(float(line.time_s[k]))
        updates += done
        means.append([*online.estimate.states.values()])

    np.testing.assert_array_equal(means, track.mean)
    np.testing.assert_array_equal(online.estimate.cov, track.cov[-1])
    assert len(updates) == line.yaw_count.sum() + line.dvl_count.sum() + len(line.fix_time_s)
    for sensor in ("usbl", "compass"):
        reported = [(u.outcome, u.nis, u.innovation) for u in updates if u is not None and u.sensor == sensor]
        assert reported == [(u.outcome, u.nis, u.innovation) for u in track.updates if u.sensor == sensor]


@pytest.mark.parametrize("method", ["adf", "ekf"])
def test_record_by_record_a_dive_with_late_fixes_is_known_as_well_as_in_replay(method: str) -> None:
    log = simulated_log(replace(find_scenario("lawnmower"), duration_s=200.0), 2)
    line, truth = timeline(log), log.truth
    line = replace(line, fix_received_s=line.fix_time_s + 0.7)
    parameters = replace(log.parameters, calibrate=("scale",))
    track, online = run(method, line, parameters, replace(SETTINGS, order="arrival")), OnlineFilter(method, parameters)

    position_m, updates = np.full((len(line.time_s), 2), np.nan), list[Update]()
    for k, time_s in enumerate(line.time_s.tolist()):
        updates += [update for update in taken(online, line, k) if update is not None]
        if online.started:
            online.predict(time_s)
            position_m[k] = online.estimate.position_m

    later = line.time_s > 20
    true_m = np.column_stack([np.interp(line.time_s, truth.time_s, truth.position_m[:, axis]) for axis in (0, 1)])
    own_m, replayed_m = (float(np.hypot(*(m - true_m)[later].T).mean()) for m in (position_m, track.position_m))
    assert own_m == pytest.approx(replayed_m, rel=0.05)
    for sensor in ("dvl", "compass", "usbl"):
        own, replayed = (
            np.mean([u.nis / u.dof for u in reported if u.sensor == sensor and u.time_s > 20])
            for reported in (updates, track.updates)
        )
        assert own == pytest.approx(replayed, rel=0.1)


@pytest.mark.parametrize(
    ("method", "gate", "outcome"),
    [("ekf", 0.99, "rejected"), ("adf", None, "rejected"), ("ckf", None, "down-weighted")],
)
def test_a_gross_fix_says_what_became_of_it(method: str, gate: float | None, outcome: str) -> None:
    line = one_record_per_epoch()
    online = started(method, line, Parameters(start=Start(0.0, 0.0, 2.0)), FilterSettings(gate=gate))
    for k in range(1, len(line.time_s)):
        taken(online, line, k)
    before, t = online.estimate, float(line.time_s[-1])

    update = online.fix(t, before.position_m[0] + 60.0, before.position_m[1], COV_M2)

    assert (update.sensor, update.outcome, update.dof) == ("usbl", outcome, 2)
    assert update.innovation == pytest.approx((60.0, 0.0), abs=1e-9)
    assert np.hypot(*(online.estimate.position_m - before.position_m)) < 1.0


def test_a_late_measurement_of_any_sensor_is_taken_at_its_own_time() -> None:
    """A filter without chance ends where it would have if all had come in time; time may pass in between."""
    both: list[OnlineFilter] = []
    for late in (False, True):
        online = started("adf", one_record_per_epoch(), Parameters(start=Start(0.0, 0.0, 2.0)))
        calls = [
            lambda online=online: online.velocity(1.0, 0.0, 1.0, 0.02),
            lambda online=online: online.fix(2.0, 1.0, 2.0, COV_M2),
            lambda online=online: online.heading(3.0, 5.0, 1.0),
            lambda online=online: online.velocity(4.0, 0.1, 1.1, 0.02),
            lambda online=online: online.fix(4.5, 0.5, 4.0, COV_M2),
        ]
        order = [2, 4, 1, 3, 0] if late else [0, 1, 2, 3, 4]
        reported = [calls[i]() for i in order]
        assert [one.time_s for one in reported if one is not None] == [[1, 2, 3, 4, 4.5][i] for i in order]
        both.append(online)

    in_time, late = (online.estimate for online in both)
    assert late.states == in_time.states
    assert late.time_s == in_time.time_s == 4.5
    np.testing.assert_array_equal(late.cov, in_time.cov)


def test_what_comes_too_late_is_refused_and_changes_nothing() -> None:
    online = started("adf", one_record_per_epoch(), Parameters(start=Start(0.0, 0.0, 2.0)))
    for time_s in range(1, 31):
        online.predict(float(time_s))
    before = online.estimate.states

    late = "the measurement of 18 s comes too late: adf is at 30 s and goes back to 19 s"
    with pytest.raises(UsageError, match=late):
        online.fix(18.0, 0.0, 0.0, COV_M2)
    assert "predict: 29 s lies before the latest time, 30 s" in refusal(UsageError, online.predict, 29.0)

    assert online.estimate.states == before
    assert online.fix(21.0, 0.0, 0.0, COV_M2) is not None


def test_it_starts_at_the_first_fix_after_a_heading_and_a_velocity() -> None:
    online = OnlineFilter("ekf", Parameters(usbl=Gaussian(), usbl_lever_m=(0.0, 2.0, 0.0)))
    assert online.fix(0.0, 500.0, 0.0, COV_M2) is None
    assert online.heading(0.5, 90.0, 1.0) is None
    assert online.fix(1.0, 500.0, 0.0, COV_M2) is None
    assert online.velocity(1.5, 0.0, 1.0, 0.02) is None
    assert not online.started
    with pytest.raises(UsageError, match="ekf has not started: it needs a heading, a velocity, and then a fix"):
        online.predict(2.0)

    assert online.fix(2.0, 10.0, 20.0, COV_M2) is None

    estimate = online.estimate
    assert estimate.time_s == 2.0
    np.testing.assert_allclose(estimate.position_m, [8.0, 20.0], atol=1e-12)  # the transponder is 2 m ahead
    np.testing.assert_allclose(estimate.position_cov_m2, 9.0 * np.eye(2), atol=1e-12)
    assert estimate.heading_deg == pytest.approx(90.0)
    np.testing.assert_allclose(estimate.velocity_mps, [0.0, 1.0], atol=1e-12)
    online.predict(7.0)
    np.testing.assert_allclose(online.estimate.position_m, [13.0, 20.0], atol=1e-9)


def test_the_start_shares_the_error_and_the_latency_of_its_fix() -> None:
    """x = z - c + latency V: the sum of position and shared error is known to 3 m, whatever the error is."""
    online = OnlineFilter("ekf", Parameters(calibrate=("latency", "usbl-bias"), usbl=Gaussian()))
    online.heading(0.0, 90.0, 1.0)
    online.velocity(0.0, 0.0, 1.5, 0.02)
    online.fix(0.0, 10.0, 20.0, COV_M2)

    errors = Parameters().errors
    shared_m2 = 9.0 + errors.usbl_bias_m**2
    late_m2 = 1.5**2 * errors.latency_s**2
    np.testing.assert_allclose(online.estimate.position_cov_m2, np.diag([shared_m2 + late_m2, shared_m2]), atol=1e-12)


@pytest.mark.parametrize(
    ("method", "parameters", "settings", "text"),
    [
        ("dr", Parameters(), FilterSettings(), "dr is no filter"),
        ("ekf", Parameters(calibrate=("auto",)), FilterSettings(), "need the whole dive"),
        ("ekf", Parameters(), FilterSettings(smooth=True), "need the whole dive"),
        ("adf", Parameters(), FilterSettings(gate=0.99), "takes no gate"),
    ],
)
def test_what_does_not_fit_is_refused(method, parameters, settings, text):
    with pytest.raises(UsageError, match=text):
        OnlineFilter(method, parameters, settings)


def test_values_that_are_no_measurement_are_refused() -> None:
    online = started("ekf", one_record_per_epoch(), Parameters(start=Start(0.0, 0.0, 2.0)))
    for call in (
        lambda: online.heading(math.nan, 0.0, 1.0),
        lambda: online.heading(1.0, 0.0, 0.0),
        lambda: online.velocity(1.0, math.inf, 0.0, 1.0),
        lambda: online.fix(1.0, 0.0, 0.0, [[1.0, 2.0], [2.0, 1.0]]),
        lambda: online.fix(1.0, 0.0, 0.0, [[1.0, math.nan], [math.nan, 1.0]]),
        lambda: online.predict(math.inf),
    ):
        assert "must be finite" in refusal(UsageError, call)
    assert "no symmetric matrix of 2 x 2" in refusal(UsageError, online.fix, 1.0, 0.0, 0.0, [1.0, 1.0])


SECONDS = 30
PAPER = find_scenario("paper")
PAPER_LOG = simulated_log(replace(PAPER, duration_s=float(SECONDS)), 4)
PAPER_LINE = timeline(PAPER_LOG)
ASSUMED = replace(PAPER_LOG.parameters, calibrate=("scale",))


def delayed(by_s: np.ndarray | float) -> Timeline:
    return replace(PAPER_LINE, fix_received_s=PAPER_LINE.fix_time_s + by_s)


def spread_delays() -> np.ndarray:
    """Up to 6 s, so that fixes overtake each other; none on the grid by chance."""
    return np.random.default_rng(1).uniform(0.05, 6.0, len(PAPER_LINE.fix_time_s))


@pytest.mark.parametrize("name", ["adf", "cpf", "pf"])
def test_at_each_epoch_only_what_had_arrived_is_known_and_all_of_it(name: str) -> None:
    """The estimate of an epoch is that of a run, at validity, over the log without the fixes still to come."""
    line = delayed(spread_delays())
    known = run(name, line, ASSUMED, FilterSettings(particles=20, order="arrival"))

    for k in (10, 47, 60, 111, 150):
        arrived = line.fix_received_s <= line.time_s[k]
        alone = run(name, line.with_fixes(arrived), ASSUMED, FilterSettings(particles=20))

        np.testing.assert_array_equal(known.mean[k], alone.mean[k])


@pytest.mark.parametrize("name", ["ekf", "cpf"])
def test_fixes_that_come_at_once_leave_nothing_to_choose(name: str) -> None:
    settings = (FilterSettings(particles=20, order=order) for order in ("validity", "arrival"))
    valid, arrived = (run(name, delayed(0.0), ASSUMED, how) for how in settings)

    np.testing.assert_array_equal(valid.mean, arrived.mean)
    assert valid.updates == arrived.updates


def test_each_fix_is_told_once_however_often_its_step_was_run() -> None:
    track = run("adf", delayed(spread_delays() / 3), ASSUMED, FilterSettings(order="arrival"))

    fixes = [update.row for update in track.updates if update.sensor == "usbl"]
    arrived = [row for row, t in enumerate(PAPER_LINE.fix_time_s + spread_delays() / 3) if t <= PAPER_LINE.time_s[-1]]
    assert fixes == arrived


def test_a_fix_older_than_the_memory_is_not_used_and_that_is_said() -> None:
    late = np.where(PAPER_LINE.fix_time_s == 5.0, 10.4, 0.5)
    line = delayed(late)

    track = run("adf", line, ASSUMED, FilterSettings(order="arrival"))

    rest = run("adf", line.with_fixes(line.fix_time_s != 5.0), ASSUMED, FilterSettings(order="arrival"))
    np.testing.assert_array_equal(track.mean, rest.mean)
    assert [text for text in track.warnings if "2 fixes came more than 10 s late, or after the end" in text]


def test_a_dive_known_late_is_known_worse_and_at_validity_no_worse() -> None:
    """With a fix each second that comes 4 s late the last fix is 4 to 5 s old, and drift adds to it."""
    assumed = Parameters(process=ProcessNoise(position_m=0.3), usbl=PAPER.usbl.noise, start=Start(0.0, 0.0, 1.0))
    at_once, late, valid = (
        run("adf", delayed(delay_s), assumed, FilterSettings(order=order))
        for delay_s, order in ((0.0, "arrival"), (4.0, "arrival"), (4.0, "validity"))
    )
    variances = [float(np.mean(track.position_cov_m2[75:, 0, 0])) for track in (at_once, late, valid)]

    assert variances[1] - variances[0] == pytest.approx(4.0 * 0.3**2, rel=0.1)
    assert variances[2] == variances[0]


def test_a_smoothed_track_has_no_order_of_arrival() -> None:
    with pytest.raises(UsageError, match="a smoothed track knows the whole dive"):
        run("adf", PAPER_LINE, ASSUMED, FilterSettings(smooth=True, order="arrival"))
