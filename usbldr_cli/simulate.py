"""The command ``usbldr simulate``: a dive whose truth is known, as a log that ``replay`` reads."""

from pathlib import Path

import click

from usbldr.filters.errors import UsageError
from usbldr_cli.options.completion import LOG
from usbldr_cli.options.log_options import format_option, inputs, read_request
from usbldr_cli.options.verbosity import verbose_option

WIDTH = 14  # [columns] of a scenario's name in a list


@click.command()
@click.argument("scenario", type=LOG, required=False)
@click.option("-o", "--output", type=click.Path(path_type=Path), help="NAME.mcap, NAME.bag, NAME_db3 or a folder.")
@format_option
@click.option(
    "--seed", type=click.IntRange(min=0), metavar="N", default=0, show_default=True, help="Seed of random numbers."
)
@click.option("--force", is_flag=True, help="Replace existing files.")
@click.option("--list", "list_them", is_flag=True, help="List the scenarios.")
@verbose_option
def simulate(
    scenario: str | None, output: Path | None, form: str | None, seed: int, force: bool, list_them: bool
) -> None:
    """Write SCENARIO as a log with its truth, and its configuration beside it.

    SCENARIO is a name of --list, or a file NAME.toml of your own (docs/scenarios.md).

    The name of OUTPUT chooses the format: NAME.mcap (ROS 2), NAME.bag (ROS 1), NAME_db3 (rosbag2 folder)
    or NAME.db3 (its file alone), else a folder of CSV files. Its configuration (NAME.usbldr.toml, or usbldr.toml in
    the folder) states noise, start and conventions, but no sensor error.

    \b
    $ usbldr simulate paper -o paper.mcap
    """
    from usbldr.io.scenarios.shipped import find_scenario, scenario_names
    from usbldr.io.scenarios.survey_scenarios import find_survey, is_survey, survey_names

    names, surveys = scenario_names(), survey_names()
    if list_them:
        for name in names:
            click.echo(f"{name:<{WIDTH}}  {find_scenario(name).about}")
        for name in surveys:
            click.echo(f"{name:<{WIDTH}}  {find_survey(name).about}")
        return
    if scenario is None:
        raise UsageError(f"name a scenario (scenarios: {', '.join((*names, *surveys))}), or a file NAME.toml")
    if is_survey(scenario):
        _write_survey(scenario, output, form, seed, force)
        return
    chosen = find_scenario(scenario, surveys)
    if output is None:
        raise UsageError("name the output with -o NAME.mcap, or -o FOLDER for CSV files")

    from usbldr.io.reading.inputs import refuse_inputs
    from usbldr.io.scenarios.simulated_log import write_scenario
    from usbldr.io.writers.write_log import configuration_place, log_format_of

    for file in (output, configuration_place(output, log_format_of(output, form))):
        refuse_inputs(file, inputs(scenario, read_request()))
    log, configuration = write_scenario(chosen, seed, output, force, form)
    counts = ", ".join(f"{len(table)} {sensor}" for sensor, table in log.tables.items())
    click.echo(f"{output}: scenario {chosen.name}, seed {seed}, {chosen.duration_s:g} s, records: {counts}")
    click.echo(f"{configuration}: noise, start and conventions")


def _write_survey(scenario: str, output: Path | None, form: str | None, seed: int, force: bool) -> None:
    """Write a survey of a transponder, which calibrate-usbl reads."""
    from usbldr.io.reading.inputs import refuse_inputs
    from usbldr.io.scenarios.survey_scenarios import find_survey, write_survey

    if output is None or form not in (None, "csv") or output.suffix:
        raise UsageError("a survey is written as a folder of CSV files: name it with -o FOLDER")
    refuse_inputs(output, inputs(scenario, read_request()))
    chosen = find_survey(scenario)
    survey, configuration = write_survey(chosen, seed, output, force)
    click.echo(f"{output}: survey {chosen.name}, seed {seed}, {chosen.duration_s:g} s, {len(survey)} fixes")
    click.echo(f"{configuration}: how its files are read")
