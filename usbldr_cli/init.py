"""``usbldr init``: a commented configuration for a log that has none."""

from pathlib import Path
from typing import Any

import click

from usbldr.filters.errors import LogError, UsageError
from usbldr_cli.options.log_options import inputs, log_options, read_request
from usbldr_cli.options.output_files import refuse_file, write_file


@click.command()
@log_options
@click.option(
    "--output", "-o", metavar="FILE", help="Where to write it.  [default: where LOG's configuration is sought]"
)
@click.option("--force", is_flag=True, help="Replace a file that is there already.")
def init(log: str, output: str | None, force: bool, **selection: Any) -> None:
    """Write a usbldr.toml for LOG with what was found, each line with where it comes from.

    Topics, axes, frames, mounting and delays are those that fit LOG best without any truth; read the lines marked
    CHECK. Replay accepts the file as it is.

    \b
    $ usbldr init dive.mcap
    """
    from usbldr.io.doctor.doctor import examine
    from usbldr.io.doctor.init_config import initial_configuration, map_origin_unknown
    from usbldr.io.settings.configuration import own_configuration

    path = Path(log)
    if not path.exists():
        raise LogError(f"{log}: no such file or folder")
    if selection["config"] not in (None, "none"):
        raise UsageError("init writes a configuration from the log alone; it takes no --config")
    target = Path(output) if output else own_configuration(path, path.is_dir())
    selection["config"] = "none"
    refuse_file("--output", target, force, inputs(log, **selection))
    found = examine(path, read_request(**selection))
    text = initial_configuration(found, selection["joined"])
    write_file("--output", target, text)
    checks = text.count("# CHECK")
    wanted = f"; {checks} line{'s' if checks > 1 else ''} marked CHECK want{'' if checks > 1 else 's'} a decision"
    click.echo(f"{target}: written" + (wanted if checks else ""))
    if map_origin_unknown(found):
        click.echo(
            "where the fixes' map begins is unknown, so errors against latitudes may hold one shift in common: state "
            "origin_lat_deg and origin_lon_deg under [map] if it is known, or head under [usbl]"
        )
