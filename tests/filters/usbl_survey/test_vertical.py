"""The tilt of a head and the scale of its ranges by the vertical of fixes, against rotations of SciPy."""

import numpy as np
from scipy.spatial.transform import Rotation

from usbldr.filters.usbl_survey.vertical import VerticalFit, vertical_fit


def a_dive(seed, roll_deg=0.8, pitch_deg=-0.6, scale=0.99, deepest_m=80.0, count=400):
    """Fixes of a head that is rolled and pitched, of a vehicle that goes around it and down."""
    rng = np.random.default_rng(seed)
    angle, depth = rng.uniform(0, 2 * np.pi, count), np.linspace(20, deepest_m, count)
    reach = rng.uniform(20, 120, count)
    forward_starboard_down = np.column_stack([reach * np.cos(angle), reach * np.sin(angle), depth])
    seen = (
        Rotation.from_euler("ZYX", [0, pitch_deg, roll_deg], degrees=True).inv().apply(forward_starboard_down) / scale
    )
    drop = seen[:, 2] + 0.3 * rng.standard_t(4, count)
    drop[::40] += 25.0  # false fixes
    return drop, depth, seen[:, [1, 0]]


def fitted(seed: int, deepest_m: float = 80.0) -> VerticalFit:
    found = vertical_fit(*a_dive(seed, deepest_m=deepest_m))
    assert found is not None
    return found


def test_tilt_and_scale_are_found_within_their_sigmas():
    true = np.array([0.8, -0.6, 0.99, 0.0])
    found = [fitted(seed) for seed in range(30)]
    assert all(all(fit.settled) for fit in found)
    z = [(fit.value - true) / fit.sd for fit in found]
    assert 0.75 < np.sqrt(np.mean(np.square(z))) < 1.3
    assert found[-1].sd[0] < 0.05
    assert found[-1].sd[2] < 0.005


def test_a_dive_at_one_depth_does_not_settle_the_scale():
    found = fitted(1, deepest_m=20.0)
    assert found.settled[:2] == [True, True]
    assert found.settled[2] is False


def test_fixes_without_a_vertical_say_nothing():
    drop, depth, along = a_dive(2)
    assert vertical_fit(drop * np.nan, depth, along) is None
