"""Simulated dives for filters alone: with what the scenario states of its noise, and without sensor errors."""

import dataclasses

from usbldr.filters.simulation.scenario import Scenario
from usbldr.io.log import Log
from usbldr.io.scenarios.simulated_log import simulated_log


def dive_without_calibration(scenario: Scenario, seed: int) -> Log:
    log = simulated_log(scenario, seed)
    return dataclasses.replace(log, parameters=dataclasses.replace(log.parameters, calibrate=()))
