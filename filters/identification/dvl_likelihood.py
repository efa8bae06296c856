"""Predictive likelihood of the DVL's records: its noise, and the random walk of the velocity.

Each axis is a random walk plus white noise, as u and v in the motion model without other sensors; calibration states
matter little here. Metres per second, body frame.
"""

from collections.abc import Sequence

import numpy as np

from usbldr.filters.estimators.gaussian_bank import GaussianBank, Projection
from usbldr.filters.estimators.mode_updates import collapse
from usbldr.filters.models.noise import BankNoise
from usbldr.filters.models.parameters import UNKNOWN_START, Parameters
from usbldr.filters.types import Indices, Timeline, Vector

SEGMENT_RECORDS = 300  # consecutive, a minute at 5 Hz
MAX_SEGMENTS = 60  # spread over the log: an hour at 5 Hz is used whole


def dvl_likelihoods(timeline: Timeline, members: Sequence[Parameters]) -> Vector:
    """Return the predictive log likelihood of DVL records, both axes, for each of N members, (N,).

    The log is split into independent segments of equal length, which run in parallel.
    """
    N = len(members)
    rows = _segments(np.flatnonzero(timeline.dvl_count))
    count, length = rows.shape
    if length < 2:
        return np.zeros(N)
    series = 2 * count  # starboard of each stretch, then forward; the bank holds each for all members
    noise = BankNoise([member.dvl for member in members] * series, [m.dvl_sd_scale for m in members] * series)
    walk = np.tile(np.array([member.process.velocity_mps for member in members]) ** 2, series)
    z = np.repeat(timeline.dvl_mps[rows].transpose(1, 2, 0).reshape(length, series), N, axis=1)
    R = np.repeat(np.tile((timeline.dvl_sd_mps[rows] ** 2 / timeline.dvl_count[rows]).T, 2), N, axis=1)
    dt_s = np.repeat(np.tile(np.diff(timeline.time_s[rows], axis=1).T, 2), N, axis=1)
    bank = GaussianBank(z[:1], np.full((1, 1, series * N), UNKNOWN_START.sd_mps**2), np.zeros(series * N))
    total = np.zeros(series * N)
    for k in range(1, length):
        P = bank.cov + walk * dt_s[k - 1]
        projection = Projection(z[k : k + 1] - bank.mean, P, P)
        bank, log_l, *_ = collapse(bank._replace(cov=P), projection, noise.modes(R[k][None, None]))
        total += log_l
    summed: Vector = total.reshape(series, N).sum(axis=0)
    return summed


def _segments(record_rows: Indices) -> Indices:
    """Return the rows of each stretch, (stretches, records): evenly spread, as many as there are, up to the most."""
    length = min(len(record_rows), SEGMENT_RECORDS)
    count = min(len(record_rows) // SEGMENT_RECORDS or 1, MAX_SEGMENTS)
    first = np.linspace(0, len(record_rows) - length, count).astype(np.intp)
    return record_rows[first[:, None] + np.arange(length)]
