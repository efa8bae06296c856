"""``usbldr init``: write a commented configuration for a log."""

from pathlib import Path
from typing import Any

import click

from usbldr.filters.errors import LogError
from usbldr_cli.options.log_options import labelled_inputs, log_options, read_request
from usbldr_cli.options.output_files import refuse_file, toml_option, write_file
from usbldr_cli.options.verbosity import verbose_option


@click.command()
@log_options
@toml_option("--output", "-o", help="File to write, NAME.toml.  [default: the configuration file beside LOG]")
@click.option("--force", is_flag=True, help="Replace an existing file.")
@verbose_option
def init(log: str, output: Path | None, force: bool, **selection: Any) -> None:
    """Write a usbldr.toml for LOG, with the source of each line.

    Topics, axes, frames, mounting and delays are those that fit LOG best, estimated without any truth. For a sensor
    without a topic of a known type, it proposes columns of one whose fields have fitting names. Keys of an existing
    configuration are kept. Check the lines marked CHECK. Replay accepts the file as is. Exit code 3 if DVL,
    compass or USBL is still missing: complete the file that is written, or leave the sensor out ("--dvl none").

    \b
    $ usbldr init dive.mcap
    """
    from usbldr.io.doctor.draft import draft
    from usbldr.io.doctor.init_config import initial_configuration
    from usbldr.io.settings.configuration import own_configuration

    path = Path(log)
    if not path.exists():
        raise LogError(f"{log}: no such file or folder")
    target = output or own_configuration(path, path.is_dir())
    request = read_request(**selection)
    read = [one.path for one in labelled_inputs(log, request) if one.role != "configuration"]  # its keys are kept
    refuse_file("--output", target, force, read)
    drafted = draft(path, request)
    text = initial_configuration(drafted, selection["joined"], target)
    write_file("--output", target, text)
    if drafted.fault:
        raise LogError(f"{drafted.fault}; {target} is written: complete the lines marked CHECK", path=path)
    checks = text.count("# CHECK")
    todo = f"; check the {checks} line{'s' if checks > 1 else ''} marked CHECK" if checks else ""
    click.echo(f"{target}: written{todo}")
    if drafted.examination.log and drafted.examination.log.map_unknown:
        click.echo(
            "the origin of the map of the fixes is unknown, so replay takes errors against latitudes after a constant "
            "shift: state origin_lat_deg and origin_lon_deg under [map], or head under [usbl]"
        )
