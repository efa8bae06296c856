"""Late fixes: what is known when, against runs over logs that end there."""

from dataclasses import replace

import numpy as np
import pytest

from usbldr.filters.errors import UsageError
from usbldr.filters.models.parameters import Parameters, ProcessNoise, Start
from usbldr.filters.replay.methods import FilterSettings
from usbldr.filters.replay.run import run
from usbldr.filters.types import Timeline
from usbldr.io.reading.epochs import timeline
from usbldr.io.scenarios.shipped import find_scenario
from usbldr.io.scenarios.simulated_log import simulated_log

SECONDS = 30
PAPER = find_scenario("paper")
LOG = simulated_log(replace(PAPER, duration_s=float(SECONDS)), 4)
LINE = timeline(LOG)
ASSUMED = replace(LOG.parameters, calibrate=("scale",))


def delayed(by_s: np.ndarray | float) -> Timeline:
    return replace(LINE, fix_received_s=LINE.fix_time_s + by_s)


def spread_delays() -> np.ndarray:
    """Up to 6 s, so that fixes overtake each other; none on the grid by chance."""
    return np.random.default_rng(1).uniform(0.05, 6.0, len(LINE.fix_time_s))


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
    arrived = [row for row, t in enumerate(LINE.fix_time_s + spread_delays() / 3) if t <= LINE.time_s[-1]]
    assert fixes == arrived


def test_a_fix_older_than_the_memory_is_not_used_and_that_is_said() -> None:
    late = np.where(LINE.fix_time_s == 5.0, 10.4, 0.5)
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
        run("adf", LINE, ASSUMED, FilterSettings(smooth=True, order="arrival"))
