"""What errors of the USBL head cost, beside a ship and beside a head that rests: print the tables of its study.

    python benchmarks/usbl_head/study.py --seeds 100

docs/studies/usbl_head.md has the tables and says what they mean.
"""

import argparse
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from usbl_head.dives import CLEAN, Dive, HeadErrors, dive, drawn_errors, exact_posterior
from usbldr.filters.identification.evidence import Identification, identify
from usbldr.filters.models.parameters import Parameters
from usbldr.filters.replay.run import run
from usbldr.filters.types import Array

INSIDE_95 = 5.991  # squared, in sigmas: 95 % of a chi-square with two degrees of freedom
SHIP_FAULTS = {
    "none": CLEAN,
    "head 2°": HeadErrors(head_rad=np.radians(2.0)),
    "range 2 %": HeadErrors(range_scale=0.02),
    "head 2°, range 2 %, compass 3°": HeadErrors(np.radians(2.0), 0.02, np.radians(3.0)),
    "head 15°": HeadErrors(head_rad=np.radians(15.0)),
    "head 40°, range 7 %, compass 20°": HeadErrors(np.radians(40.0), 0.07, np.radians(20.0)),
    "lever arm 3 m to starboard, 4 m ahead": HeadErrors(arm_starboard_m=3.0, arm_forward_m=4.0),
    "drawn from the priors": None,
}


class Replayed(NamedTuple):
    """A dive that the default filter has replayed: errors in metres, (K, 2) and (2, 2) at the end."""

    error_m: Array
    last_cov_m2: Array
    found: Identification

    @property
    def mean_m(self) -> float:
        return float(np.hypot(*self.error_m.T).mean())

    @property
    def last_m(self) -> float:
        return float(np.hypot(*self.error_m[-1]))

    @property
    def last_inside(self) -> bool:
        return inside(self.error_m[-1], self.last_cov_m2)


def inside(error_m: Array, cov_m2: Array) -> bool:
    """Return whether an error lies within the 95 % region of its covariance."""
    return bool(error_m @ np.linalg.solve(cov_m2, error_m) < INSIDE_95)


def replayed(made: Dive, gps: bool = False) -> Replayed:
    """Return a dive as the defaults replay it, with or without its GPS fixes."""
    aid = ((float(made.line.gps_time_s[0]), float(made.line.gps_time_s[-1])),) if gps else ()
    found = identify(made.line, Parameters(aid=aid))
    track = run("cpf", made.line, found.parameters)
    assert track.position_cov_m2 is not None
    rows = np.searchsorted(made.line.time_s, track.time_s)
    return Replayed(track.position_m - made.position_m[rows], track.position_cov_m2[-1], found)


def within_two_sigmas(errors: HeadErrors, found: Identification) -> tuple[int, int]:
    """Return how many errors that the head has are estimated within two sigmas, and how many are estimated."""
    true = {"usbl_heading_deg": -np.degrees(errors.head_rad), "usbl_range_scale": errors.range_scale}
    true |= {"usbl_arm_starboard_m": errors.arm_starboard_m, "usbl_arm_forward_m": errors.arm_forward_m}
    rows = [abs(each.value - true[name]) < 2 * each.sd for name, each in found.estimates.items() if name in true]
    return sum(rows), len(rows)


def beside_a_ship(seeds: int) -> None:
    """Print a row for each error of a head on a ship that moves."""
    print("| errors, ship moving | mean of the dives, m | largest, m | head's errors within 2 sigmas | named rivals |")
    print("| --- | ---: | ---: | ---: | ---: |")
    for name, stated in SHIP_FAULTS.items():
        means, right, estimated, rivals = [], 0, 0, 0
        for seed in range(seeds):
            errors = drawn_errors(seed) if stated is None else stated
            one = replayed(dive(errors, seed, ship=True))
            means.append(one.mean_m)
            good, all_of = within_two_sigmas(errors, one.found)
            right, estimated, rivals = right + good, estimated + all_of, rivals + bool(one.found.open_pairs)
        print(f"| {name} | {np.mean(means):.2f} | {max(means):.2f} | {right} of {estimated} | {rivals} |", flush=True)


def beside_a_resting_head(seeds: int) -> None:
    """Print a row for dives without GPS and for dives that end with it, beside the exact posterior of each."""
    print("| drawn errors, head at rest | | last position, m | whole dive, m | in 95 % | rivals |")
    print("| --- | --- | ---: | ---: | ---: | ---: |")
    for gps, name in (
        (False, "fixes alone, to 260 m from the head"),
        (True, "30 s of GPS at the end, 30 m from the head"),
    ):
        ours, exact, held, held_by_exact, rivals = [], [], 0, 0, 0
        for seed in range(seeds):
            made = dive(drawn_errors(seed), seed, homewards=gps)
            one, clean = replayed(made, gps), replayed(dive(CLEAN, seed, homewards=gps), gps)
            track_m, cov_m2 = exact_posterior(made.line, gps)
            off_m = track_m - made.position_m
            ours.append((one.last_m, one.mean_m, clean.last_m, clean.mean_m))
            exact.append((float(np.hypot(*off_m[-1])), float(np.hypot(*off_m.T).mean())))
            held, held_by_exact = held + one.last_inside, held_by_exact + inside(off_m[-1], cov_m2)
            rivals += bool(one.found.open_pairs)
        last, mean, clean_last, clean_mean = np.mean(ours, axis=0)
        exact_last, exact_mean = np.mean(exact, axis=0)
        print(f"| {name} | cpf | {last:.2f} | {mean:.2f} | {held} of {seeds} | {rivals} |")
        print(f"| | exact | {exact_last:.2f} | {exact_mean:.2f} | {held_by_exact} of {seeds} | |")
        print(f"| | cpf, without errors | {clean_last:.2f} | {clean_mean:.2f} | | |", flush=True)


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=100, help="dives")
    parser.add_argument("--ship-seeds", type=int, default=16, help="dives beside a ship")
    options = parser.parse_args()
    beside_a_resting_head(options.seeds)
    beside_a_ship(options.ship_seeds)


if __name__ == "__main__":
    main()
