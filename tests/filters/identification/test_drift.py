"""How far dead reckoning drifts while a sensor is silent."""

from dataclasses import replace

import numpy as np
import pytest

from usbldr.filters.identification.drift import drift_variances_m2
from usbldr.filters.models.parameters import Parameters, ProcessNoise
from weaving import Faults, weaving_dive

DIVE = weaving_dive(Faults())
SPEED_MPS, FROM_S = 1.2, 150.0


@pytest.mark.parametrize("until_s", [350.0, np.inf], ids=["for a while", "until the end"])
def test_without_headings_the_vehicle_may_have_moved_in_any_direction(until_s: float) -> None:
    t = DIVE.time_s
    silent, end_s = (t > FROM_S) & (t < until_s), min(until_s, t[-1])
    straight_mps, blind = np.tile([0.0, SPEED_MPS], (len(t), 1)), np.where(silent, 0, DIVE.yaw_count)
    line = replace(DIVE, dr_mps=straight_mps, yaw_count=blind, dr_yaw_rad=np.zeros(len(t)))
    assumed = Parameters(process=ProcessNoise(0.0, 0.0, 0.0, 0.02))

    found_m2 = drift_variances_m2(line, np.array([FROM_S, end_s]), [assumed], [True])

    # each axis of a direction that may be any has the variance 1/2
    assert found_m2[1, 0] == pytest.approx((SPEED_MPS * (end_s - FROM_S)) ** 2 / 2, rel=0.02)
