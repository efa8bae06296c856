"""``usbldr evaluate``: judge a track that a vehicle or another program computed."""

from pathlib import Path
from typing import Any

import click

from usbldr.filters.errors import LogError
from usbldr_cli.options.completion import ESTIMATE
from usbldr_cli.options.log_options import labelled_inputs, log_options, request_and_inputs
from usbldr_cli.options.option import GroupedCommand, given_command, log_option, option, scoring_option
from usbldr_cli.options.output_files import folder_option, json_option, name_of, refuse_file, require_free
from usbldr_cli.options.run_options import RunChoices, align_option
from usbldr_cli.options.verbosity import verbose_option
from usbldr_cli.run_output import RunOutputs, print_run, run_outputs, say_findings, write_run

FRAMES = ("ENU", "NED", "latlon")


@click.command(cls=GroupedCommand)
@log_options
@log_option("--estimate", "-e", type=ESTIMATE, metavar="FILE|TOPIC", required=True, help="The track to judge.")
@log_option("--frame", type=click.Choice(FRAMES), help="Frame of the track.  [default: by type and name, else ENU]")
@scoring_option("--start", metavar="TIME", help="Score from this time on: seconds of the log, or ISO 8601.")
@scoring_option("--end", metavar="TIME", help="Score up to this time.")
@align_option
@folder_option("Run directory.  [default: LOG-ESTIMATE]")
@option("--force", is_flag=True, help="Replace an existing run directory.")
@json_option("report")
@run_outputs
@option("--quiet", "-q", is_flag=True, help="Print only the last line.")
@verbose_option
def evaluate(
    log: str,
    estimate: str,
    frame: str | None,
    start: str | None,
    end: str | None,
    align: str,
    output: Path | None,
    force: bool,
    json_to: str | None,
    outputs: RunOutputs,
    quiet: bool,
    **selection: Any,
) -> int:
    """Report the errors of a track in LOG or in a file, like those of a filter.

    A topic of Odometry, Pose or NavSatFix messages, a recording with one such topic, TUM text, usbldr's track CSV, or
    CSV with usbldr's column names. If it has covariances, NEES says whether they are right. Writes a run directory,
    which compare puts beside others.

    \b
    $ usbldr evaluate dive.mcap --estimate /odometry/filtered
    """
    from usbldr.filters.identification.identification import Identification
    from usbldr.io.reading.epochs import timeline
    from usbldr.io.reading.estimate import read_estimate
    from usbldr.io.reading.inputs import InputFile
    from usbldr.io.reading.opening import ConfigurationFile
    from usbldr.io.reports.run import Run, ScoredTrack
    from usbldr.io.reports.run_directory import run_directory
    from usbldr.io.reports.run_provenance import RunProvenance, read_files
    from usbldr.io.session import evaluate as score
    from usbldr.io.session import open_log, reference_tracks

    request, read = request_and_inputs(log=log, **selection)
    read = (*read, Path(estimate)) if Path(estimate).is_file() else read
    target = output or Path(f"{name_of(Path(log))}-{Path(estimate).stem.strip('/').replace('/', '-') or 'estimate'}")
    refuse_file("--json", json_to, force, read, target)
    require_free(target, read, force)
    outputs.require_fitting(Path(log))
    dive = open_log(log, request)
    placed, track = read_estimate(dive, request, estimate, frame)
    say_findings(dive, dive.findings, quiet)
    say_findings(dive, [one for one in placed.findings if one not in dive.findings], quiet=False)  # on the track
    choices = RunChoices(start=start, end=end, align=align)
    settings = choices.settings(dive.start_ns)
    grid = timeline(dive)
    report = score(placed, grid, track, settings)
    found = Identification(dive.parameters)
    references = reference_tracks(dive, grid, track.method, settings, found)
    options = {"estimate": estimate, "frame": frame, "start": start, "end": end, "align": align}
    judged = [InputFile("estimate", Path(estimate))] if Path(estimate).is_file() else []
    made = RunProvenance(given_command(), read_files([*labelled_inputs(log, request), *judged], dive.sha256))
    asked = {"log": log, "options": options, "selection": selection}
    content = request.configuration.content if isinstance(request.configuration, ConfigurationFile) else None
    scored = ScoredTrack(track, report)
    run = Run(placed, grid, found, scored, references, request=asked, configuration=content, made=made)
    with run_directory(target, force) as folder:
        write_run(folder, run, outputs)
    print_run(run, target, json_to, quiet)
    return LogError.exit_code if any(finding.lost_data for finding in placed.findings) else 0
