"""The mathematics of usbldr: models, noise, filters, evaluation and simulation. NumPy only.

Conventions of the whole package:

* navigation frame: local east, north, up in metres;
* body frame: u to starboard, v forward, z up;
* yaw psi: radians, counter-clockwise about up, 0 when the bow points north, so V_E = u cos psi - v sin psi and
  V_N = u sin psi + v cos psi; a compass heading is -psi;
* time: float seconds since the log's start; angles: radians; standard deviations: one sigma, per axis;
* banks of Gaussians carry the particle index last: means (n, N), covariances (n, n, N).
"""

from typing import TYPE_CHECKING

from usbldr.filters.lazy_exports import lazy_exports

if TYPE_CHECKING:
    from usbldr.filters.bounds.dive_bounds import PositionBound
    from usbldr.filters.errors import CheckError, LogError, UsageError, UsbldrError
    from usbldr.filters.evaluation.error_report import ErrorReport, Window
    from usbldr.filters.identification.identification import Identification
    from usbldr.filters.models.noise import Contamination, Gaussian, Mixture, NoiseFamily, StudentT
    from usbldr.filters.models.parameters import Parameters, ProcessNoise, SensorErrors, Start
    from usbldr.filters.replay.methods import METHODS, FilterSettings, Method
    from usbldr.filters.replay.online import OnlineEstimate, OnlineFilter
    from usbldr.filters.types import Outage, OutageRecovery, Reacquisition, Timeline, Trajectory, Truth, Update

__all__ = [
    "METHODS",
    "CheckError",
    "Contamination",
    "ErrorReport",
    "FilterSettings",
    "Gaussian",
    "Identification",
    "LogError",
    "Method",
    "Mixture",
    "NoiseFamily",
    "OnlineEstimate",
    "OnlineFilter",
    "Outage",
    "OutageRecovery",
    "Parameters",
    "PositionBound",
    "ProcessNoise",
    "Reacquisition",
    "SensorErrors",
    "Start",
    "StudentT",
    "Timeline",
    "Trajectory",
    "Truth",
    "Update",
    "UsageError",
    "UsbldrError",
    "Window",
]
_HOMES = {
    "bounds.dive_bounds": ("PositionBound",),
    "errors": ("CheckError", "LogError", "UsageError", "UsbldrError"),
    "evaluation.error_report": ("ErrorReport", "Window"),
    "identification.identification": ("Identification",),
    "models.noise": ("Contamination", "Gaussian", "Mixture", "NoiseFamily", "StudentT"),
    "models.parameters": ("Parameters", "ProcessNoise", "SensorErrors", "Start"),
    "replay.methods": ("METHODS", "FilterSettings", "Method"),
    "replay.online": ("OnlineEstimate", "OnlineFilter"),
    "types": ("Outage", "OutageRecovery", "Reacquisition", "Timeline", "Trajectory", "Truth", "Update"),
}
__getattr__ = lazy_exports(__name__, _HOMES)
