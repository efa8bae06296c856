"""How a filter recovers if its gate refuses good measurements: it widens what the sensor measures of the motion.

A diverged filter refuses every fix, and a manoeuvre looks like an error of the DVL. The refused measurements then say
that the vehicle did not move as predicted, so independent noise widens the position (fixes) or the velocity (DVL).
They say nothing about constant errors of a sensor or about the heading, whose sigmas stay as they are; a refused
compass needs no recovery, as the turn rate's own noise widens the heading within seconds.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from usbldr.filters.estimators.gaussian_bank import GaussianBank
from usbldr.filters.models.states import StateLayout
from usbldr.filters.types import Vector

VARIANCE_FACTOR = 4.0  # of one widening: the sigma doubles; 2 follows manoeuvres half as fast, 10 also follows spikes
MAX_REJECTIONS = 10  # [fixes in a row] half as many nearly double the error in the scenario multipath


@dataclass(frozen=True, slots=True)
class Recovery:
    """What the refused measurements of an axis widen, and when."""

    rows: tuple[int, ...]  # states that the axis measures
    max_rejections: int  # refused in a row before the states are widened
    until_passed: bool  # widen until the measurement passes; otherwise once per refused measurement


RECOVERIES: Mapping[str, Recovery] = {
    "starboard": Recovery(StateLayout().rows("u"), 0, until_passed=False),
    "forward": Recovery(StateLayout().rows("v"), 0, until_passed=False),
    "position": Recovery(StateLayout().rows("x", "y"), MAX_REJECTIONS, until_passed=True),
    "east": Recovery(StateLayout().rows("x"), MAX_REJECTIONS, until_passed=True),
    "north": Recovery(StateLayout().rows("y"), MAX_REJECTIONS, until_passed=True),
}
"""By axis of a measurement. Outliers of fixes often agree with each other, so the position waits, and then follows at
once. Spikes of a DVL do not: the sigma of the velocity doubles with every refusal, so a manoeuvre passes within a
second, and a spike only if it repeats."""


def widened(bank: GaussianBank, rows: tuple[int, ...]) -> tuple[GaussianBank, Vector]:
    """Return a bank of one with independent noise in these rows, and the variances that it added, (n,)."""
    added = np.zeros(len(bank.mean))
    added[list(rows)] = (VARIANCE_FACTOR - 1) * bank.cov[rows, rows, 0]
    return bank._replace(cov=bank.cov + np.diag(added)[:, :, None]), added
