"""The fixes that a track hangs on: leaving one out really moves the track by what the table says."""

from dataclasses import replace

import numpy as np
import pytest

from usbldr.filters.assumptions import Assumptions, Start
from usbldr.filters.influence import influences, influential, innovation_m
from usbldr.filters.noise import Gaussian
from usbldr.filters.run import Settings, run
from usbldr.filters.types import Timeline, Update
from weaving import Faults, dive

ASSUMED = Assumptions(usbl=Gaussian(), start=Start(2.0, 0.0, 3.0))


def without(line: Timeline, row: int) -> Timeline:
    kept = np.arange(len(line.fix_time_s)) != row
    return replace(
        line,
        fix_time_s=line.fix_time_s[kept],
        fix_received_s=line.fix_received_s[kept],
        fix_m=line.fix_m[kept],
        fix_cov_m2=line.fix_cov_m2[kept],
    )


@pytest.mark.parametrize("method", ["ekf", "adf", "cpf", "pf-wekf"])
def test_without_the_most_influential_fix_the_track_lies_elsewhere_by_its_shift(method: str) -> None:
    line = dive(Faults(heading_bias_deg=3.0), seconds=80)
    settings = Settings(particles=20)
    whole = run(method, line, ASSUMED, settings)

    first = influential(whole, 1)[0]
    left_out = run(method, without(line, first.row), ASSUMED, settings)

    at = int(np.searchsorted(whole.time_s, first.time_s))
    shift = whole.position_m[at] - left_out.position_m[at]
    assert (first.shift_east_m, first.shift_north_m) == pytest.approx(shift, abs=0.02)
    assert first.shift_m > 0.1


def test_the_most_influential_come_first_and_each_fix_once() -> None:
    track = run("adf", dive(Faults(), seconds=60), ASSUMED)

    told = influential(track, 7)

    shifts = [fix.shift_m for fix in told]
    assert shifts == sorted(shifts, reverse=True)
    assert len({fix.row for fix in told}) == 7
    assert len(influences(track)) == 59


def test_a_refused_fix_moves_nothing() -> None:
    line = dive(Faults(), seconds=60)
    line.fix_m[30] += 500.0

    refused = influences(run("ekf", line, ASSUMED, Settings(gate=0.99)))[30]

    assert refused.fate == "rejected"
    assert refused.shift_m == 0
    assert np.hypot(refused.innovation_east_m, refused.innovation_north_m) > 600


def test_two_scalars_and_a_position_are_told_alike() -> None:
    def update(axis: str, *innovation: float) -> Update:
        return Update("usbl", axis, 0, 0.0, innovation, innovation, 1.0, len(innovation), "used", 1.0)

    assert innovation_m([update("north", 2.0), update("east", 1.0)]) == (1.0, 2.0)
    assert innovation_m([update("position", 1.0, 2.0)]) == (1.0, 2.0)
