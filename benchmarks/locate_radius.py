"""How often the true position lies within `radius95_m` of `usbldr locate`, on simulated dives (docs/locate.md).

$ python benchmarks/locate_radius.py paper-drawn --calibrate scale --seeds 40
$ python benchmarks/locate_radius.py turns --seeds 20
"""

import argparse

import numpy as np

import usbldr
from usbldr.io.reports.locate import radius

TIMES = 1000  # random times of each dive


def held(scenario: str, seed: int, calibrate: tuple[str, ...]) -> tuple[float, float]:
    """Return the share of random times whose true position lies within the radius, and the NEES."""
    log = usbldr.open_log(scenario, seed=seed)
    assert log.truth is not None
    line, settings = usbldr.timeline(log), usbldr.RunSettings(smooth=True, calibrate=calibrate)
    track = usbldr.replay(log, line, "adf", settings)
    assert track.position_cov_m2 is not None
    time_s = np.random.default_rng(seed).uniform(track.time_s[0], track.time_s[-1], TIMES)
    true = np.column_stack([np.interp(time_s, log.truth.time_s, one) for one in log.truth.position_m.T])
    off_m = np.column_stack([np.interp(time_s, track.time_s, one) for one in track.position_m.T]) - true
    cov_m2 = track.position_cov_m2[np.searchsorted(track.time_s, time_s)]
    nees = np.einsum("ni,nij,nj->n", off_m, np.linalg.inv(cov_m2), off_m)
    return float(np.mean(np.hypot(*off_m.T) <= radius(cov_m2))), float(np.mean(nees))


def main() -> None:
    """Print mean share and mean NEES of the dives, and the standard error of the share."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenario")
    parser.add_argument("--calibrate", default="auto", help="as of usbldr replay")
    parser.add_argument("--seeds", type=int, default=40, help="dives")
    options = parser.parse_args()
    calibrate = tuple(options.calibrate.split(","))
    dives = np.array([held(options.scenario, seed, calibrate) for seed in range(options.seeds)])
    error = dives[:, 0].std(ddof=1) / len(dives) ** 0.5
    print(f"inside {dives[:, 0].mean():.3f} ± {error:.3f}, NEES {dives[:, 1].mean():.2f}")


if __name__ == "__main__":
    main()
