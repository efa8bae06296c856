"""How well assumptions predict the DVL's records from those before: its noise, and the random walk of the velocity.

Each axis is a random walk seen through white noise, which is what the motion model says of u and v apart from all other
sensors; the calibration states change too little here to matter. Metres per second, body frame.
"""

from collections.abc import Sequence

import numpy as np

from usbldr.filters.assumptions import UNKNOWN_START, Assumptions
from usbldr.filters.bank import Gaussians, Projection
from usbldr.filters.noise import NoiseOfMembers
from usbldr.filters.policies import collapse
from usbldr.filters.types import Timeline, Vector

MOST_RECORDS = 3000  # they tell both numbers to about 2 %


def velocity_likelihoods(timeline: Timeline, members: Sequence[Assumptions]) -> Vector:
    """Return the predictive log likelihood of the first DVL records, both axes, for each of N members, (N,)."""
    N = len(members)
    twice = (*members, *members)  # the bank holds starboard, then forward
    noise = NoiseOfMembers([member.dvl for member in twice], [member.dvl_sd_scale for member in twice])
    walk = np.array([member.process.velocity_mps for member in twice]) ** 2
    heard = np.flatnonzero(timeline.dvl_count)[:MOST_RECORDS]
    R = timeline.dvl_sd_mps[heard] ** 2 / timeline.dvl_count[heard]
    dt_s = np.diff(timeline.time_s[heard], prepend=timeline.time_s[heard[:1]])
    z = np.repeat(timeline.dvl_mps[heard], N, axis=1)  # (records, 2 N)
    bank = Gaussians(z[:1], np.full((1, 1, 2 * N), UNKNOWN_START.sd_mps**2), np.zeros(2 * N))
    total = np.zeros(2 * N)
    for k in range(1, len(heard)):
        P = bank.cov + walk * dt_s[k]
        seen = Projection(z[k : k + 1] - bank.mean, P, P)
        bank, log_l, *_ = collapse(bank._replace(cov=P), seen, noise.modes(R[k : k + 1, None]), 0)
        total += log_l
    return total[:N] + total[N:]
