"""Errors of `usbldr calibrate-usbl` on simulated surveys, and their ratio to its sigmas (docs/usbl_installation.md).

$ python benchmarks/survey_errors.py survey-box --seeds 100
"""

import argparse
from collections import Counter

import numpy as np

from usbldr.filters.simulation.simulate import simulate_survey
from usbldr.filters.usbl_survey.calibration import known_of
from usbldr.filters.usbl_survey.geometry import NAMES
from usbldr.filters.usbl_survey.verdict import judged, planned
from usbldr.io.scenarios.survey_scenarios import find_survey

STATED = np.array([0.0, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0])  # a perfect installation: scale 1, all else 0


def main() -> None:
    """Print the RMS of each error, the sigma that a plan gives, and the RMS of the error over its own sigma."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("survey")
    parser.add_argument("--seeds", type=int, default=100, help="surveys")
    options = parser.parse_args()
    scenario, known = find_survey(options.survey), known_of(STATED)
    noise = (scenario.range_sd_m, float(np.radians(scenario.angle_sd_deg)))
    plan = planned(simulate_survey(scenario, 0), scenario.true_values, known, noise)
    found = [judged(simulate_survey(scenario, seed), STATED, known) for seed in range(options.seeds)]
    error = np.array([fit.values for _, fit in found]) - scenario.true_values
    own = np.sqrt(np.mean((error / [fit.sd for _, fit in found]) ** 2, axis=0))
    print(f"{'':20}{'RMS error':>12}{'planned':>12}{'over sigma':>12}  not separated from")
    for name, rms, one, ratio in zip(NAMES, np.sqrt(np.mean(error**2, axis=0)), plan, own, strict=True):
        print(f"{name:20}{rms:12.5f}{one.sd:12.5f}{ratio:12.2f}  {', '.join(one.rivals)}")
    before_m, after_m = np.median([(one.before.cep50_m, one.after.cep50_m) for one, _ in found], axis=0)
    print(dict(Counter(one.result for one, _ in found)), f"CEP50 {before_m:.2f} m before, {after_m:.2f} m after")


if __name__ == "__main__":
    main()
