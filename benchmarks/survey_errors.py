"""Errors of `usbldr calibrate-usbl` on simulated surveys, and their ratio to its sigmas (docs/calibrate_usbl.md).

$ python benchmarks/survey_errors.py survey-box --seeds 200
"""

import argparse

import numpy as np

from usbldr.filters.simulation.simulate import simulate_survey
from usbldr.filters.usbl_survey.calibration import known_of
from usbldr.filters.usbl_survey.verdict import judged
from usbldr.io.scenarios.survey_scenarios import find_survey

STATED = np.array([0.0, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0])  # a perfect installation: scale 1, all else 0


def main() -> None:
    """Print the RMS of each error, and of the error over its own sigma."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("survey")
    parser.add_argument("--seeds", type=int, default=100, help="surveys")
    options = parser.parse_args()
    scenario = find_survey(options.survey)
    found = [judged(simulate_survey(scenario, seed), STATED, known_of(STATED))[1] for seed in range(options.seeds)]
    error = np.array([one.values - scenario.true_values for one in found])
    print(np.sqrt(np.mean(error**2, axis=0)), np.sqrt(np.mean((error / [one.sd for one in found]) ** 2, axis=0)))


if __name__ == "__main__":
    main()
