"""``usbldr init``: write a commented configuration for a log."""

from pathlib import Path
from typing import Any

import click

from usbldr.filters.errors import LogError, UsageError
from usbldr_cli.options.log_options import inputs, log_options, read_request
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
    without a topic of a known type, it proposes columns of one whose fields have fitting names. Check the lines marked
    CHECK. Replay accepts the file as is.

    \b
    $ usbldr init dive.mcap
    """
    from usbldr.io.doctor.init_config import initial_configuration
    from usbldr.io.doctor.proposed_columns import examine_with_proposals, unread_sensors
    from usbldr.io.settings.configuration import own_configuration

    path = Path(log)
    if not path.exists():
        raise LogError(f"{log}: no such file or folder")
    if selection["config"] not in (None, "none") or selection["set_keys"]:
        raise UsageError("init writes a configuration from the log alone; it takes no --config and no --set")
    target = output or own_configuration(path, path.is_dir())
    selection["config"] = "none"
    request = read_request(**selection)
    refuse_file("--output", target, force, inputs(log, request))
    found, proposals, failed = examine_with_proposals(path, request)
    unread = {role: why for role, why in unread_sensors(path, request).items() if role not in proposals}
    unread |= failed
    text = initial_configuration(found, selection["joined"], proposals, unread)
    write_file("--output", target, text)
    if found.log is None or unread:
        faults = [*unread.values(), *(one.text for one in found.findings if one.code == "UNUSABLE")]
        raise LogError(f"{faults[0]}; {target} is written: complete the lines marked CHECK", path=path)
    checks = text.count("# CHECK")
    todo = f"; check the {checks} line{'s' if checks > 1 else ''} marked CHECK" if checks else ""
    click.echo(f"{target}: written{todo}")
    if found.log.map_unknown:
        click.echo(
            "the origin of the map of the fixes is unknown, so replay takes errors against latitudes after a constant "
            "shift: state origin_lat_deg and origin_lon_deg under [map], or head under [usbl]"
        )
