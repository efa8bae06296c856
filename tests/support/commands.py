"""Commands of usbldr as tests call them, in this process or in one of their own."""

import json
import signal
import socket
import subprocess
import sys
import time
import warnings
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from click import ClickException, Command, Context
from click.testing import CliRunner, Result

from usbldr.filters.errors import UsbldrError
from usbldr.io.scenarios.shipped import find_scenario
from usbldr.io.scenarios.simulated_log import write_scenario
from usbldr_cli.main import cli, one_line

USBLDR = [sys.executable, "-c", "from usbldr_cli.main import main; main()"]


def write_short(file: Path, scenario: str, seconds: float, seed: int = 0) -> Path:
    """Write the beginning of a shipped scenario as a log."""
    write_scenario(replace(find_scenario(scenario), duration_s=seconds), seed, file)
    return file


def command(name: str) -> Command:
    found = cli.get_command(Context(cli), name)
    assert found is not None, name
    return found


def options_of(name: str) -> set[str]:
    """Return all spellings of the options of a command."""
    return {option for param in command(name).params for option in (*param.opts, *param.secondary_opts)}


def run(*arguments: object) -> Result:
    """Run a command; a warning is a failure, and so is a fault that is no sentence."""
    words = [str(argument) for argument in arguments]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        done = CliRunner().invoke(cli, words, standalone_mode=False)
    if not isinstance(done.exception, UsbldrError | None) and not type(done.exception).__module__.startswith("click"):
        raise AssertionError(f"usbldr {' '.join(words)}: {done.exception!r}") from done.exception
    assert "\n" not in str(done.exception or "")
    return done


def finished(*arguments: object) -> subprocess.CompletedProcess[str]:
    """Run a command as `run` does; return its exit code and output as a shell has them."""
    done = run(*arguments)
    code, fault = done.return_value or 0, ""
    if isinstance(done.exception, UsbldrError | ClickException):
        text = one_line(done.exception) if isinstance(done.exception, ClickException) else done.exception
        code, fault = done.exception.exit_code, f"usbldr: {text}\n"
    return subprocess.CompletedProcess([str(one) for one in arguments], code, done.stdout, done.stderr + fault)


def report_of(folder: Path, name: str = "report.json") -> Any:
    """Read the report of a run as a parser does that knows no NaN and no infinity."""

    def refuse(constant: str) -> float:
        raise AssertionError(f"{constant} is not JSON")

    return json.loads((folder / name).read_text(encoding="utf-8"), parse_constant=refuse)


def findings(log: Path, *options: str) -> Mapping[str, Mapping[str, Any]]:
    """Return code -> finding of the doctor."""
    found = json.loads(run("doctor", log, "--json", *options).output)["findings"]
    return {one["code"]: one for one in found}


def drafted(log: Path, *options: object) -> str:
    """Return the configuration that usbldr init drafts for a log."""
    file = (log if log.is_dir() else log.parent) / "drafted.toml"
    run("init", log, "--output", file, *options)
    return file.read_text(encoding="utf-8")


def output_of(*arguments: object) -> str:
    """Return what a command that succeeds prints on stdout; a fault is raised."""
    done = run(*arguments)
    if done.exception is not None:
        raise done.exception
    assert done.return_value in (None, 0), done.output
    return done.stdout


def replayed(log: Path, *options: str) -> str:
    """Return what a replay by dead reckoning, unless options say otherwise, prints on stderr."""
    return run("replay", log, "-f", "dr", "-q", "--force", "-o", log.with_name("run"), *options).stderr


def spoil(file: Path, old: str, new: str) -> None:
    """Put other words into a file that has the old ones, once."""
    text = file.read_text(encoding="utf-8")
    assert old in text
    file.write_text(text.replace(old, new, 1), encoding="utf-8")


def free_port() -> int:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return free.getsockname()[1]


def interrupt(*arguments: object, once: Callable[[], object] = lambda: True, after_s: float = 0.0) -> None:
    """Start a command in a process of its own, press Ctrl-C when it is at work, and check that it says just that."""
    command = [*USBLDR, *map(str, arguments)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        until = time.monotonic() + 60
        while not once():
            assert process.poll() is None
            assert time.monotonic() < until
            time.sleep(0.002)
        time.sleep(after_s)
        assert process.poll() is None

        process.send_signal(signal.SIGINT)
        _, said = process.communicate(timeout=60)

    assert process.returncode == 130, said
    assert said.strip().endswith("usbldr: interrupted")
    assert "Traceback" not in said
