"""The command ``usbldr export``: a log, or a part of it, in another format."""

import math
from pathlib import Path
from typing import Any

import click

from usbldr.filters.errors import LogError, UsageError
from usbldr_cli.options.log_options import format_option, log_options, request_and_inputs
from usbldr_cli.options.run_options import seconds_of_log
from usbldr_cli.options.verbosity import verbose_option


@click.command()
@log_options
@click.option("-o", "--output", type=click.Path(path_type=Path), help="NAME.mcap, NAME.bag, NAME_db3 or a folder.")
@format_option
@click.option("--start", metavar="TIME", help="Leave out everything before: seconds of the log, or ISO 8601.")
@click.option("--end", metavar="TIME", help="Leave out everything after.")
@click.option("--force", is_flag=True, help="Replace existing files.")
@verbose_option
def export(
    output: Path | None, form: str | None, start: str | None, end: str | None, force: bool, **selection: Any
) -> int:
    """Write the sensors and the truth of LOG, as usbldr reads them, with their configuration.

    Replaying the export gives the same track as LOG. The name of OUTPUT chooses the format: NAME.mcap
    (ROS 2), NAME.bag (ROS 1), NAME_db3 (rosbag2 folder) or NAME.db3 (its file alone), else a folder of CSV files.

    \b
    $ usbldr export dive.bag -o part.mcap --start 100 --end 160
    """
    if output is None:
        raise UsageError("name the output with -o NAME.mcap, NAME.bag, NAME_db3, or -o FOLDER for CSV files")
    from usbldr.io.session import open_log
    from usbldr.io.writers.export import cut_log, export
    from usbldr.io.writers.write_log import log_format_of

    log_format_of(output, form)
    request, read = request_and_inputs(**selection)
    log = open_log(selection["log"], request)
    lost = [finding for finding in log.findings if finding.lost_data]
    from_s = -math.inf if start is None else seconds_of_log("--start", start, log.start_ns)
    to_s = math.inf if end is None else seconds_of_log("--end", end, log.start_ns)
    written, configuration = export(cut_log(log, from_s, to_s), output, force, form, read)
    counts = ", ".join(f"{len(table)} {sensor}" for sensor, table in written.tables.items())
    click.echo(f"{output}: records: {counts}")
    click.echo(f"{configuration}: noise, start and conventions")
    for finding in lost:
        click.echo(f"{finding.code}: {finding.text}")
    return LogError.exit_code if lost else 0
