"""How often the true position of a sensor lies within `radius95_m` of `usbldr locate`, on simulated dives.

The sensor is 2 m ahead of the vehicle's reference point. docs/locate.md quotes the results.

$ python benchmarks/locate_radius.py paper-drawn --calibrate scale --seeds 40
$ python benchmarks/locate_radius.py turns --seeds 20
"""

import argparse
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

import usbldr
from usbldr.io.reports.locate import located, read_smoothed_run
from usbldr.io.reports.run import ScoredTrack
from usbldr.io.scenarios.shipped import find_scenario
from usbldr.io.scenarios.simulated_log import simulated_log

TIMES = 1000  # random times of each dive
ARM_M = (0.5, 2.0, 0.0)  # of the sensor, starboard, forward, up: of a camera at the bow


def held(scenario: str, seed: int, calibrate: tuple[str, ...]) -> tuple[float, float]:
    """Return the share of random times whose true position lies within the radius, and the NEES."""
    shipped = find_scenario(scenario)
    log = simulated_log(replace(shipped, gps=replace(shipped.gps, lever_m=ARM_M)), seed)  # the truth is the sensor's
    assert log.truth is not None
    line, settings = usbldr.timeline(log), usbldr.RunSettings(smooth=True, calibrate=calibrate)
    track = usbldr.replay(log, line, "adf", settings)
    with TemporaryDirectory() as folder:
        run = read_smoothed_run(usbldr.write_run(Path(folder) / "run", log, line, ScoredTrack(track, None)))
    time_s = np.random.default_rng(seed).uniform(track.time_s[0], track.time_s[-1], TIMES)
    found = located(run, log.start_ns + np.round(time_s * 1e9).astype(np.int64), ARM_M)
    true_m = np.column_stack([np.interp(time_s, log.truth.time_s, one) for one in log.truth.position_m.T])
    off_m = found[["east_m", "north_m"]].to_numpy() - true_m
    cov_m2 = found[["sd_east_m", "cov_en_m2", "cov_en_m2", "sd_north_m"]].to_numpy() ** [2, 1, 1, 2]
    nees = np.einsum("ni,nij,nj->n", off_m, np.linalg.inv(cov_m2.reshape(-1, 2, 2)), off_m)
    return float(np.mean(np.hypot(*off_m.T) <= found["radius95_m"])), float(np.mean(nees))


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
