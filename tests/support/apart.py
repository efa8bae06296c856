"""How far two tracks lie apart, and how much of that the covariance of the first explains."""

import numpy as np

from usbldr.filters.types import Trajectory, Vector


def apart_m(track: Trajectory, clean: Trajectory) -> Vector:
    """Return the distance at each epoch, (K,)."""
    return np.hypot(*(track.position_m - clean.position_m).T)


def mean_nees(track: Trajectory, clean: Trajectory) -> float:
    e = track.position_m - clean.position_m
    assert track.position_cov_m2 is not None
    return float(np.einsum("ka,kab,kb->k", e, np.linalg.inv(track.position_cov_m2), e).mean())
