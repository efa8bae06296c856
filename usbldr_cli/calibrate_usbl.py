"""``usbldr calibrate-usbl``: how the USBL of a ship is installed, from a survey of a transponder or from a dive."""

from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from usbldr.filters.errors import CheckError, UsageError
from usbldr_cli.options.log_options import inputs, log_options, read_request, request_provenance
from usbldr_cli.options.output_files import (
    folder_option,
    json_option,
    refuse_file,
    require_free,
    toml_option,
    write_file,
    write_json,
)
from usbldr_cli.options.verbosity import verbose_option

if TYPE_CHECKING:
    from usbldr.io.reading.opening import Request
    from usbldr.io.reports.run_provenance import RunProvenance
    from usbldr.io.reports.usbl_calibration import Calibration
    from usbldr_cli.figures.drawing import Picture

    Stated = tuple[float | None, float, float | None]  # the transponder's depth and its sigma, that of latencies
    Found = tuple[Calibration, Callable[[], list[Picture]]]  # with its pictures, which import matplotlib

AT_LEAST_0 = click.FloatRange(min=0)
DEPTH = "Depth of the transponder below the surface."
DEPTH_SD = "1-sigma of --transponder-depth."
LATENCY = "1-sigma of the stated latencies: 0.02 if pulses synchronise the clocks.  [default: 1]"


@click.command()
@log_options
@click.option("--transponder-depth", "depth_m", type=AT_LEAST_0, metavar="METRES", help=DEPTH)
@click.option(
    "--transponder-depth-sd",
    "depth_sd_m",
    type=AT_LEAST_0,
    metavar="METRES",
    default=0.5,
    show_default=True,
    help=DEPTH_SD,
)
@click.option("--latency-sd", "latency_sd_s", type=AT_LEAST_0, metavar="SECONDS", help=LATENCY)
@toml_option("--write", "write_to", help="Write a configuration with the installation that was found.")
@folder_option("Folder for figures, page and report.json.  [default: none]")
@json_option("calibration")
@click.option("--plan", is_flag=True, help="LOG is a survey's scenario: print the sigmas that it will reach.")
@click.option("--force", is_flag=True, help="Replace existing files.")
@verbose_option
def calibrate_usbl(
    log: str,
    depth_m: float | None,
    depth_sd_m: float,
    latency_sd_s: float | None,
    write_to: Path | None,
    output: Path | None,
    json_to: str | None,
    plan: bool,
    force: bool,
    **selection: Any,
) -> int:
    """Find how the USBL of a ship is installed, from a survey of a transponder that lies still or from a dive.

    The LOG of a survey holds the fixes along the head's axes, and the ship's position, heading, roll and pitch. The
    result has the roll, pitch and heading of the head, the scale of its ranges, the lever arm from antenna to head, the
    latencies of attitude and position, and the place of the transponder, each with its sigma, and names the errors that
    LOG does not separate. The LOG of a dive has a DVL and a compass in place of the transponder; it gives the heading
    and the scale if the ship moves, and the tilt if the depth is known. Exit code 1 if the verdict is bad or open.

    \b
    $ usbldr calibrate-usbl survey --write usbldr.toml -o calibration
    $ usbldr calibrate-usbl survey-box --plan
    """
    from usbldr.io.reading.usbl_survey import is_dive
    from usbldr.io.reports.usbl_calibration import calibrated_configuration, content, notes, summary, tables
    from usbldr.io.scenarios.survey_scenarios import is_survey
    from usbldr_cli.tables.run_table import aligned

    stated = (depth_m, depth_sd_m, latency_sd_s)
    if plan:
        if given := next((name for name, file in (("--write", write_to), ("--output", output)) if file), None):
            raise UsageError(f"--plan finds no installation: leave {given} out (--json FILE keeps the sigmas)")
        _print_plan(log, stated, json_to)
        return 0
    if not Path(log).is_dir() and is_survey(log):
        raise UsageError(f"{log} is a scenario: write its survey by usbldr simulate {log} -o FOLDER, or state --plan")
    request = read_request(**selection)
    read = inputs(log, request)
    refuse_file("--write", write_to, force, read, output)
    refuse_file("--json", json_to, force, read, output)
    if output is not None:
        require_free(output, read, force)
    made = request_provenance({"log": log, "selection": selection})
    if is_dive(Path(log), request):
        for option, value in (("--transponder-depth", depth_m), ("--latency-sd", latency_sd_s)):
            if value is not None:
                raise UsageError(f"{option} is for a survey; {log} has a DVL, so that it is read as a dive")
        found, pictures = _by_dive(log, request, made)
    else:
        found, pictures = _by_survey(log, request, made, stated)
    if output is not None:
        _write_folder(found, pictures(), output, force)
    if write_to is not None:
        write_file("--write", write_to, calibrated_configuration(found))
    installation, scatter = map(aligned, tables(found))
    _print((found.measured, installation, "\n".join(notes(found)), scatter, summary(found)), content(found), json_to)
    for place in filter(None, (output, write_to)):
        click.echo(f"{place}: written", err=json_to == "-")
    return 0 if found.verdict.result == "good" else CheckError.exit_code


def _by_survey(log: str, request: "Request", made: "RunProvenance", stated: "Stated") -> "Found":
    from usbldr.filters.usbl_survey.calibration import known_of, levelled
    from usbldr.filters.usbl_survey.verdict import judged
    from usbldr.io.reading.usbl_survey import read_usbl_survey
    from usbldr.io.reports.usbl_calibration import of_survey

    read = read_usbl_survey(Path(log), request)
    known = known_of(read.stated, *stated)
    survey = levelled(read.survey, read.stated, known) if read.level and not read.level_stated else read.survey
    verdict, fit = judged(survey, read.stated, known)
    found = of_survey(read, survey, verdict, fit, known, made)

    def pictures() -> "list[Picture]":
        from usbldr_cli.figures.usbl_survey import FittedSurvey, survey_pictures

        return survey_pictures(FittedSurvey(survey, read.stated, fit, found))

    return found, pictures


def _by_dive(log: str, request: "Request", made: "RunProvenance") -> "Found":
    from usbldr.io.doctor.head_calibration import calibrated_by_dive
    from usbldr.io.reports.run import Run, ScoredTrack
    from usbldr.io.reports.usbl_calibration import of_dive
    from usbldr.io.session import open_log

    read = open_log(log, request)
    dive = calibrated_by_dive(read)

    def pictures() -> "list[Picture]":
        from usbldr_cli.figures.drawing import Picture
        from usbldr_cli.figures.fixes import fix_figure

        run = Run(read, dive.timeline, dive.identification, ScoredTrack(dive.track, None))
        return [Picture("fixes", "Fixes minus the track without them", partial(fix_figure, run))]

    return of_dive(read, dive.verdict, dive.slant_m, len(dive.timeline.fix_time_s), dive.sentence, made), pictures


def _write_folder(found: "Calibration", pictures: "list[Picture]", output: Path, force: bool) -> None:
    from usbldr.io.reports.page import markdown
    from usbldr.io.reports.run_directory import REPORT, json_text, run_directory, write_atomically
    from usbldr.io.reports.usbl_calibration import content, page
    from usbldr_cli.pages.html_page import REPORT_HTML, draw_page

    with run_directory(output, force) as folder:
        shown = draw_page(folder, pictures, partial(page, found))
        write_atomically(folder / "report.md", markdown(page(found, shown)).encode())
        files = [REPORT_HTML, "report.md", *(one.name for one in shown)]
        write_atomically(folder / REPORT, json_text(content(found, files)).encode())


def _print(parts: Iterable[str], content: object, json_to: str | None) -> None:
    """Print the parts that are not empty; or the content as JSON, or both if that is a file."""
    if json_to is not None:
        write_json(json_to, content)
    if json_to != "-":
        click.echo("\n\n".join(filter(None, parts)))


def _print_plan(scenario: str, stated: "Stated", json_to: str | None) -> None:
    import numpy as np

    from usbldr.filters.simulation.simulate import simulate_survey
    from usbldr.filters.usbl_survey.calibration import known_of
    from usbldr.filters.usbl_survey.verdict import planned
    from usbldr.io.reports.usbl_calibration import plan_content, plan_table, states
    from usbldr.io.scenarios.survey_scenarios import find_survey
    from usbldr_cli.tables.run_table import aligned

    chosen = find_survey(scenario)
    survey = simulate_survey(chosen, 0)
    noise = (chosen.range_sd_m, float(np.radians(chosen.angle_sd_deg)))
    rows = planned(survey, chosen.true_values, known_of(chosen.true_values, *stated), noise)
    title = f"{chosen.name}: {len(survey)} fixes in {chosen.duration_s / 60:.0f} min, {chosen.about}"
    parts = (title, aligned(plan_table(rows)), "\n".join(states(rows)))
    _print(parts, plan_content(chosen.name, len(survey), rows), json_to)
