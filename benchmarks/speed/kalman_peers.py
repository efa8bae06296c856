"""filterpy's EKF and Stone Soup's particle filter with a cubature Kalman proposal, on the dive of peers.py."""

from collections.abc import Callable
from datetime import datetime, timedelta
from typing import Any

import numpy as np

POSITION = slice(4, 6)


def jacobian(x: np.ndarray, dt_s: float) -> np.ndarray:
    """Return the derivative (6, 6) of `peers.moved` at a state (6,)."""
    psi, u, v, r = x[:4]
    c, s = np.cos(psi + r * dt_s / 2), np.sin(psi + r * dt_s / 2)
    F = np.eye(6)
    F[0, 3] = dt_s
    for row, turned in ((4, -u * s - v * c), (5, u * c - v * s)):
        F[row, 0], F[row, 3] = turned * dt_s, turned * dt_s**2 / 2
    F[4, 1:3] = c * dt_s, -s * dt_s
    F[5, 1:3] = s * dt_s, c * dt_s
    return F


def filterpy_ekf(work: Any, moved: Callable[[np.ndarray, float], np.ndarray]) -> np.ndarray:
    """Return the positions (T, 2): predict_x and F for each step, then one update with all readings of the step."""
    from filterpy.kalman import ExtendedKalmanFilter

    class Vehicle(ExtendedKalmanFilter):
        def predict_x(self, u: object = 0) -> None:
            self.x = moved(self.x, work.dt_s)

    filters = Vehicle(dim_x=6, dim_z=6)
    filters.x, filters.P, filters.Q = work.mean.copy(), np.diag(work.sd**2), np.diag(work.walk_sd**2)
    variance = np.array([work.matched.get(row, np.nan) for row in range(6)])
    identity = np.eye(6)
    track = np.empty((len(work.z), 2))
    for k, z in enumerate(work.z):
        if k:
            filters.F = jacobian(filters.x, work.dt_s)
            filters.predict()
        read = np.flatnonzero(np.isfinite(z))
        if len(read):
            H = identity[read]
            filters.update(z[read], lambda x, H=H: H, lambda x, H=H: H @ x, R=np.diag(variance[read]))
        track[k] = filters.x[POSITION]
    return track


def stone_soup_ckf(work: Any, moved: Callable[..., np.ndarray], particles: int, steps: int) -> np.ndarray:
    """Return the positions (steps, 2) of ParticlePredictor with KalmanProposal, as its documentation builds it."""
    from stonesoup.models.base import GaussianModel
    from stonesoup.models.measurement.linear import LinearGaussian
    from stonesoup.models.transition.base import TransitionModel
    from stonesoup.predictor.kalman import CubatureKalmanPredictor
    from stonesoup.predictor.particle import ParticlePredictor
    from stonesoup.proposal.simple import KalmanProposal
    from stonesoup.resampler.particle import ESSResampler
    from stonesoup.types.array import StateVector, StateVectors
    from stonesoup.types.detection import Detection
    from stonesoup.types.hypothesis import SingleHypothesis
    from stonesoup.types.state import ParticleState
    from stonesoup.updater.kalman import CubatureKalmanUpdater
    from stonesoup.updater.particle import ParticleUpdater

    Q = np.diag(work.walk_sd**2)

    class Vehicle(TransitionModel, GaussianModel):
        @property
        def ndim_state(self) -> int:
            return 6

        def covar(self, **_: object) -> np.ndarray:
            return Q

        def function(self, state: Any, noise: object = False, **_: object) -> Any:
            x = np.asarray(state.state_vector, dtype=float)
            after = moved(x, work.dt_s)
            return (StateVectors if after.shape[1] > 1 else StateVector)(after)

    def sensor(read: tuple[int, ...]) -> LinearGaussian:
        return LinearGaussian(6, read, np.diag([work.matched[row] for row in read]))

    rng = np.random.default_rng(0)
    np.random.seed(0)  # noqa: NPY002 - the library draws from the global generator
    vehicle, now = Vehicle(), datetime(2026, 1, 1)
    belief = ParticleState(
        StateVectors((work.mean + work.sd * rng.standard_normal((particles, 6))).T),
        weight=np.full(particles, 1 / particles),
        timestamp=now,
    )
    predictor = ParticlePredictor(
        vehicle, proposal=KalmanProposal(CubatureKalmanPredictor(vehicle), CubatureKalmanUpdater(None))
    )
    updater = ParticleUpdater(None, resampler=ESSResampler())
    track = np.empty((steps, 2))
    track[0] = work.mean[POSITION]
    for k in range(1, steps):
        read = tuple(int(row) for row in np.flatnonzero(np.isfinite(work.z[k])))
        now += timedelta(seconds=work.dt_s)
        seen = Detection(StateVector(work.z[k][list(read)]), timestamp=now, measurement_model=sensor(read))
        predicted = predictor.predict(belief, timestamp=now, measurement=seen)
        belief = updater.update(SingleHypothesis(predicted, seen))
        track[k] = np.asarray(belief.mean, dtype=float).ravel()[POSITION]
    return track
