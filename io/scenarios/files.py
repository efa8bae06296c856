"""Write a simulated log and its configuration, completely or not at all."""

from pathlib import Path

from usbldr.filters.simulation.scenario import Scenario
from usbldr.io.log import Log
from usbldr.io.scenarios.simulated_log import configuration_text, simulated_log
from usbldr.io.writers.write_log import conventions_of, log_format_of, write_log_atomically, write_records


def write_scenario(
    scenario: Scenario, seed: int, out: Path, force: bool = False, stated: str | None = None
) -> tuple[Log, Path]:
    """Write to ``out``, in the stated format or that of its name; return the log and the configuration's path.

    Raises UsageError as write_log_atomically does.
    """
    form = log_format_of(out, stated)
    log = simulated_log(scenario, seed)
    remarks = {"scenario": scenario.name, "seed": str(seed)}
    configuration = configuration_text(scenario, seed, conventions_of(log, form, exported=False))

    def make(target: Path) -> None:
        write_records(log, target, form, remarks, exported=False)

    return log, write_log_atomically(out, form, configuration, make, force)
