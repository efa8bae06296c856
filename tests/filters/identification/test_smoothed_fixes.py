"""Fixes that software smoothed: the way is found, and the track is as by the fixes before."""

from dataclasses import replace

import numpy as np
import pytest

from usbldr.filters.identification.evidence import identify
from usbldr.filters.identification.smoothed_fixes import by_kalman, log_density, weighted_mean
from usbldr.filters.models.parameters import NOT_SMOOTHED, Smoothing
from usbldr.filters.replay.dead_reckoning import without_smoothing
from usbldr.filters.types import Array, Timeline
from weaving import ASSUMED, DIVE, Faults, mean_error_m, weaving_dive

AT_TIMES = DIVE.with_fixes(np.array([0, 1, 2, 5, 6, 9, 20, 21, 22]))  # with gaps
MEAN, KALMAN, LAST = Smoothing(0.25), Smoothing(0.3, 0.0531), Smoothing(1 / 6, last=6)


def smoothed(line: Timeline, how: Smoothing) -> Timeline:
    """Return the dive with fixes as the mean of the last ones, or a filter with these constant gains, gives them."""
    if how.last:
        means = [line.fix_m[max(0, n - how.last) : n].mean(axis=0) for n in range(1, len(line.fix_m) + 1)]
        return replace(line, fix_m=np.array(means))
    position, velocity, before_s = line.fix_m[0], np.zeros(2), line.fix_time_s[0]
    out: list[Array] = []
    for time_s, fix_m in zip(line.fix_time_s, line.fix_m, strict=True):
        dt_s = time_s - before_s
        predicted = position + velocity * dt_s
        position = predicted + how.position * (fix_m - predicted)
        velocity = velocity + (how.velocity / dt_s * (fix_m - predicted) if dt_s else 0.0)
        before_s = time_s
        out.append(position)
    return replace(line, fix_m=np.array(out))


@pytest.mark.parametrize("how", [MEAN, KALMAN])
def test_fixes_before_they_were_smoothed_come_back_and_so_does_their_distance_from_the_head(how: Smoothing) -> None:
    head_m = np.array([30.0, -20.0])
    line = smoothed(AT_TIMES, how)

    before = without_smoothing(replace(line, fix_away_m=line.fix_m - head_m), how)

    np.testing.assert_allclose(before.fix_m, AT_TIMES.fix_m, atol=1e-9)
    assert before.fix_away_m is not None
    np.testing.assert_allclose(before.fix_away_m, AT_TIMES.fix_m - head_m, atol=1e-9)


def test_the_last_fixes_before_their_mean_come_back_but_for_a_place_of_every_nth() -> None:
    line = smoothed(DIVE, LAST)

    before = without_smoothing(line, LAST)

    np.testing.assert_allclose(smoothed(before, LAST).fix_m[LAST.last :], line.fix_m[LAST.last :], atol=1e-9)
    off_m = before.fix_m[LAST.last :] - DIVE.fix_m[LAST.last :]
    np.testing.assert_allclose(off_m[LAST.last :], off_m[: -LAST.last], atol=1e-9)  # the same for every n-th
    assert 0 < np.abs(off_m).max() < 0.3
    few = line.with_fixes(np.arange(2 * LAST.last - 1))
    np.testing.assert_array_equal(without_smoothing(few, LAST).fix_m, few.fix_m)


@pytest.mark.parametrize("how", [NOT_SMOOTHED, MEAN, KALMAN])
def test_the_density_is_the_volume_that_smoothing_takes(how: Smoothing) -> None:
    moved_m = np.eye(AT_TIMES.fix_m.size).reshape(-1, *AT_TIMES.fix_m.shape)
    taken = [smoothed(replace(AT_TIMES, fix_m=one), how).fix_m.ravel() for one in moved_m]  # linear: its derivatives
    first = how.position**2  # of the first fix, which is as it is

    assert log_density(AT_TIMES, how) == pytest.approx(-np.linalg.slogdet(np.array(taken))[1] - np.log(first))


@pytest.mark.parametrize("lag", [0.5, 3.0])
def test_the_gains_are_those_of_a_kalman_filter_of_a_vehicle_that_accelerates_at_random(lag: float) -> None:
    """Between fixes it accelerates evenly: the Riccati equation, repeated, for the noise that gives the lag."""
    want, gain = by_kalman(lag), np.ones(2)
    low, high = 1e-6, 1e6  # variance of the acceleration, of that of a fix
    for _ in range(100):
        middle, P = np.sqrt(low * high), np.eye(2)
        F, q = np.array([[1.0, 1.0], [0.0, 1.0]]), np.array([0.5, 1.0])
        for _ in range(300):
            P = F @ P @ F.T + middle * np.outer(q, q)
            gain = P[:, 0] / (P[0, 0] + 1)
            P = P - np.outer(gain, P[0])
        low, high = (middle, high) if gain[0] < want.position else (low, middle)

    assert weighted_mean(lag).position == want.position == pytest.approx(1 / (1 + lag))
    np.testing.assert_allclose(gain, want[:2], rtol=1e-3)


@pytest.mark.parametrize("how", [MEAN, KALMAN, LAST])
@pytest.mark.long
def test_a_track_by_smoothed_fixes_is_that_by_the_fixes_before(how: Smoothing) -> None:
    line = smoothed(DIVE, how)

    found = identify(line, ASSUMED)

    assert found.parameters.smoothing.position == pytest.approx(how.position, abs=0.02)
    assert bool(found.parameters.smoothing.velocity) == bool(how.velocity)
    assert found.parameters.smoothing.last == how.last
    assert mean_error_m(line, found.parameters) < 0.05
    assert mean_error_m(line, replace(found.parameters, smoothing=NOT_SMOOTHED)) > 0.5
    (text,) = (one for one in found.warnings if one.startswith("USBL-SMOOTHED"))
    weight = f"a weight of {found.parameters.smoothing.position:.0%}"
    assert (f"the mean of the last {how.last}" if how.last else weight) in text
    assert ("velocity" in text) == bool(how.velocity)


@pytest.mark.parametrize(
    "line",
    [
        pytest.param(weaving_dive(Faults(usbl_latency_s=2.0), 3), id="late"),
        pytest.param(weaving_dive(Faults(), 4, wander_m=2.0), id="wandering"),
        pytest.param(weaving_dive(Faults(dvl_scale=0.05), 5, weaves=False), id="straight"),
    ],
)
@pytest.mark.long
def test_fixes_that_are_late_or_err_slowly_were_not_smoothed(line: Timeline) -> None:
    assert identify(line, ASSUMED).parameters.smoothing == NOT_SMOOTHED
