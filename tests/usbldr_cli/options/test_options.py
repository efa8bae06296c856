"""Options of the command line: LOG, --noise and --aid, and the help that groups them."""

import math
from pathlib import Path
from typing import Any

import click
import pytest
from click.testing import CliRunner

from checkout import SAMPLES
from commands import output_of, report_of
from logs import refusal
from recordings import short_dive, write_mcap
from usbldr.filters.errors import UsageError
from usbldr.filters.models.noise import Contamination, Gaussian, Mixture, StudentT
from usbldr.io.log import Log
from usbldr.io.session import open_log
from usbldr_cli.baseline import baseline
from usbldr_cli.check import check
from usbldr_cli.compare import compare
from usbldr_cli.drill import drill
from usbldr_cli.evaluate import evaluate
from usbldr_cli.main import COMMANDS, cli
from usbldr_cli.options.log_options import log_options, read_request
from usbldr_cli.options.option import Option
from usbldr_cli.options.option_texts import aid_windows, noise_family
from usbldr_cli.replay import replay


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


@pytest.mark.parametrize(
    ("text", "means"),
    [
        ("usbl=gaussian", ("usbl", Gaussian())),
        ("dvl=mixture", ("dvl", Mixture())),
        ("dvl=mixture:0.2:16:record", ("dvl", Mixture(0.2, 16.0, per_scalar=False))),
        ("usbl=student-t:6", ("usbl", StudentT(6.0))),
        ("usbl=student-t:scalar", ("usbl", StudentT(per_scalar=True))),
        ("usbl=contamination:0.1:25", ("usbl", Contamination(0.1, 25.0))),
        ("compass=contamination:0.1:20", ("compass", Contamination(0.1, math.radians(20.0)))),
    ],
)
def test_a_kind_with_its_numbers_is_a_family(text: str, means: tuple) -> None:
    assert noise_family(text) == means


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("depth=gaussian", "write SENSOR=KIND with a sensor of dvl, compass, usbl, gps"),
        ("usbl", "write SENSOR=KIND"),
        ("usbl=gaussian:1", "gaussian takes no number"),
        ("usbl=mixture:1.2", "share: expected number <= 0.999999999"),
        ("usbl=mixture:0.1:1", "variance_ratio: expected number > 1.0"),
        ("usbl=student-t:1.9", "dof: expected number >= 2.0"),
        ("usbl=student-t:nan", "dof = nan is not a finite number"),
        ("usbl=mixture:x", "'x' is not a number for share"),
        ("dvl=contamination:0.1", "the key sd_mps is missing"),
        ("usbl=contamination:0.1:1:2", "contamination takes share, sd_m, then optionally scalar or record"),
    ],
)
def test_what_is_no_noise_is_a_sentence(text: str, said: str) -> None:
    with pytest.raises(UsageError, match=said.replace("(", r"\(")):
        noise_family(text)


SAMPLE = SAMPLES / "lawnmower.mcap"


def test_windows_come_in_their_order_of_time() -> None:
    assert aid_windows("gps@500:520,0:60") == ((0.0, 60.0), (500.0, 520.0))


@pytest.mark.parametrize(
    ("text", "reported"),
    [
        ("usbl@0:60", "write gps@FROM:TO"),
        ("gps", "write gps@FROM:TO"),
        ("gps@", "'' is not a window"),
        ("gps@0-60", "'0-60' is not a window"),
        ("gps@60:0", "the window 60:0 must start"),
        ("gps@-5:60", "the window -5:60 must start"),
        ("gps@0:inf", "the window 0:inf must start"),
        ("gps@0:60,50:70", "a window starts at 50 s before another has ended at 60 s"),
    ],
)
def test_what_is_no_window_is_refused_in_one_sentence(text: str, reported: str) -> None:
    said = refusal(UsageError, aid_windows, text)

    assert said.startswith(f"--aid {text}: ")
    assert reported in said


def test_replay_uses_gps_in_the_windows_and_says_so_wherever_it_gives_a_number(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    reported = output_of("replay", str(SAMPLE), "--filter", "ekf", "--aid", "gps@30:60,500:520", "-o", str(folder))
    report = report_of(folder)

    sentence = "GPS fixes used as measurements from 30 to 60, 500 to 520 s of the log"
    assert sentence in " ".join(reported.split())
    assert sentence in (folder / "report.md").read_text(encoding="utf-8")
    assert report["aid"] == [[30.0, 60.0], [500.0, 520.0]]
    assert report["reference_tracks"]["dr"]["aid"] == report["aid"]
    assert report["matching"]["aided"] == 52  # 31 and 21 epochs of 1 Hz
    scored = [float(line.split(",")[0]) for line in (folder / "errors_1hz.csv").read_text().splitlines()[1:]]
    assert not [t for t in scored if 30 <= t <= 60 or 500 <= t <= 520]
    assert report["metrics"]["updates_used_gps"] > 0
    assert math.isfinite(report["metrics"]["nis_mean_gps"])


def test_compare_says_it_too_and_refuses_to_set_it_beside_a_run_without(tmp_path: Path) -> None:
    aided, alone = tmp_path / "aided", tmp_path / "alone"
    reported = output_of("compare", str(SAMPLE), "--filters", "dr,ekf", "--aid", "gps@500:520", "--jobs", "1")
    for folder, more in ((aided, ("--aid", "gps@500:520")), (alone, ())):
        output_of("replay", str(SAMPLE), "--filter", "ekf", "-o", str(folder), *more)

    assert "from 500 to 520 s of the log" in " ".join(reported.split())
    with pytest.raises(UsageError, match=r"has aid 500 to 520 s, .* has none"):
        output_of("compare", str(aided), str(alone))


GROUPED = [replay, compare, drill, evaluate, baseline, check]


def help_text(command: click.Command, option: str) -> str:
    """Return what a terminal of 100 columns shows."""
    done = CliRunner().invoke(command, [option], terminal_width=100)
    assert done.exit_code == 0
    return done.output


@pytest.mark.parametrize("command", [replay, compare], ids=["replay", "compare"])
def test_the_common_options_and_the_filters_fit_one_screen_in_titled_groups(command: click.Command) -> None:
    lines = help_text(command, "--help").splitlines()

    assert len(lines) <= 52
    titles = [line for line in lines if line.endswith(":") and not line.startswith(" ")]
    assert titles == ["Log:", "Filter:", "Scoring:", "Output:", "Filters:"]
    assert f"{command.name} --help-all lists every option." in lines


def test_no_command_has_a_longer_help_than_replay() -> None:
    shown = {name: CliRunner().invoke(cli, [name, "--help"]).output.splitlines() for name in COMMANDS}

    assert {name for name, lines in shown.items() if len(lines) > len(shown["replay"])} == set()
    assert "  ekf, ckf, ukf, " in "\n".join(shown["drill"])
    assert "--stuck FAULT" not in "\n".join(shown["drill"])


@pytest.mark.parametrize("command", GROUPED, ids=[str(command.name) for command in GROUPED])
def test_every_option_is_in_a_group_and_help_all_lists_it(command: click.Command) -> None:
    reported = help_text(command, "--help-all")

    options = [param for param in command.params if isinstance(param, click.Option)]
    assert [option.name for option in options if not isinstance(option, Option)] == ["help_all"]
    for option in options:
        if option.name not in ("help", "help_all"):
            assert f"{option.opts[0]} " in reported or f"{option.opts[0]}\n" in reported, option.name
    assert "--help-all lists" not in reported
