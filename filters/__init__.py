"""The mathematics of usbldr: models, noise, filters, evaluation and simulation. NumPy only.

Conventions of the whole package:

* navigation frame: local east, north, up in metres;
* body frame: u to starboard, v forward, z up;
* yaw psi: radians, counter-clockwise about up, 0 when the bow points north, so V_E = u cos psi - v sin psi and
  V_N = u sin psi + v cos psi; a compass heading is -psi;
* time: float seconds since the log's start; angles: radians; standard deviations: one sigma, per axis;
* banks of Gaussians carry the particle index last: means (n, N), covariances (n, n, N).
"""

from usbldr.filters.lazy_exports import lazy_exports

__all__, __getattr__ = lazy_exports(__name__, __file__)  # pyright: ignore[reportUnsupportedDunderAll]
