"""LOG on the command line: a file, a folder or the name of a scenario."""

from pathlib import Path
from typing import Any

import click
from click.testing import CliRunner

from recordings import short_dive, write_mcap
from usbldr.io.log import Log
from usbldr.io.session import open_log
from usbldr_cli.options.log_options import log_options, read_request


def opened(*arguments: str) -> Log:
    """Open a log through a command with nothing but the shared options."""

    @click.command()
    @log_options
    def command(log: str, **where: Any) -> Log:
        return open_log(log, read_request(**where), seed=7)

    done = CliRunner().invoke(command, arguments, standalone_mode=False, catch_exceptions=False)
    return done.return_value


def test_options_reach_the_reader(tmp_path: Path) -> None:
    file = write_mcap(tmp_path / "dive.mcap", short_dive())
    (tmp_path / "my.toml").write_text("[compass]\nsd_deg = 2.0", encoding="utf-8")

    log = opened(str(file), "--config", str(tmp_path / "my.toml"), "--usbl", "none", "--dvl", "/dvl")

    assert set(log.tables) == {"dvl", "compass"}
    assert log.provenance["dvl"].chosen_by == "option"
    assert log.configuration == tmp_path / "my.toml"
    assert set(log.tables["compass"]["sd_deg"]) == {2.0}
    assert opened(str(file)).configuration is None
