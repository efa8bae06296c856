"""The noise of fixes against noise that was put in, the scatter against its closed form."""

import numpy as np
import pytest

from usbldr.filters.evaluation.fix_statistics import fix_statistics
from usbldr.filters.types import Trajectory

TIME_S = np.arange(0, 300.1, 0.2)


def circling(smoothed=False, cov=None):
    """A vehicle that drives a circle of 60 m counter-clockwise at 1 m/s."""
    psi = TIME_S / 60
    place = 60 * np.column_stack([np.cos(psi), np.sin(psi)])
    mean = np.column_stack([psi, np.zeros(len(psi)), np.ones(len(psi)), place])
    return Trajectory("adf", ("psi", "u", "v", "x", "y"), TIME_S, mean, cov, smoothed=smoothed)


def known(*given):
    found = fix_statistics(*given)
    assert found is not None
    return found


def there(part):
    assert part is not None
    return part


def dive(seed, range_sd_m=0.4, bearing_sd_deg=0.8, count=150, bias_m=0.0):
    rng = np.random.default_rng(seed)
    time_s = np.sort(rng.choice(np.arange(0, 3000), count, replace=False)) / 10
    true = 60 * np.column_stack([np.cos(time_s / 60), np.sin(time_s / 60)])
    away = true - np.array([150.0, 20.0])
    reach, bearing = np.hypot(*away.T), np.arctan2(*away.T)
    reach = reach + rng.normal(0, range_sd_m, count) + bias_m
    bearing = bearing + np.radians(rng.normal(0, bearing_sd_deg, count))
    measured = reach[:, None] * np.column_stack([np.sin(bearing), np.cos(bearing)])
    return time_s, measured + np.array([150.0, 20.0]), measured


def test_white_noise_is_what_was_put_in():
    z, ratios = [], []
    for seed in range(50):
        time_s, place, away = dive(seed, bias_m=3.0)  # an error that lasts is no white noise
        found = known(time_s, place, away, np.ones(len(time_s), dtype=bool), circling())
        for part, sd in ((there(found.range_m), 0.4), (there(found.bearing_deg), 0.8)):
            ratios.append(part.sd / sd)
            z.append((part.sd - sd) / part.sd_of_sd)
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.05)
    assert 0.8 < np.sqrt(np.mean(np.square(z))) < 1.25
    assert np.mean(np.abs(z) < 2.5) > 0.95


def test_false_fixes_leave_the_noise_as_it_is_and_lower_the_share():
    time_s, place, away = dive(1)
    clean = known(time_s, place, away, np.ones(150, dtype=bool), circling())
    place, good = place.copy(), np.arange(150) % 10 != 0
    place[~good] += 40.0
    found = known(time_s, place, away, good, circling())
    assert found.good_share == pytest.approx(0.9)
    assert there(found.range_m).sd == pytest.approx(there(clean.range_m).sd, rel=0.2)
    assert sum(one.fixes for one in found.by_range) == 150
    assert found.longest_gap_s >= clean.longest_gap_s


def test_the_scatter_adds_what_the_track_follows():
    time_s, place, _ = dive(2)
    cov = np.broadcast_to(np.diag([0, 0, 0, 0.5, 0.7]), (len(TIME_S), 5, 5))
    found = there(known(time_s, place, None, np.ones(150, dtype=bool), circling(True, cov)).scatter)
    exact = there(known(time_s, place, None, np.ones(150, dtype=bool), circling(True, cov * 0)).scatter)
    assert found.drms_m**2 == pytest.approx(exact.drms_m**2 + 1.2)
    assert known(time_s, place, None, np.ones(150, dtype=bool), circling()).scatter is None


def test_a_track_without_velocity_has_no_statistics():
    time_s, place, away = dive(3)
    plain = Trajectory("usbl", ("x", "y"), TIME_S, np.zeros((len(TIME_S), 2)), None)
    assert fix_statistics(time_s, place, away, np.ones(150, dtype=bool), plain) is None
