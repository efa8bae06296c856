"""A folder of somebody else's logs may hold Python files, too: no command executes them."""

import importlib.metadata
import os
import re
import signal
import subprocess
import sys
from collections.abc import Generator, Sequence
from pathlib import Path

import numpy as np
import pytest
import scipy.io

from checkout import ROOT
from commands import free_port
from usbldr_cli.main import COMMANDS

USBLDR = Path(sys.executable).with_name("usbldr")
LOG = ROOT / "sample_logs" / "lawnmower_turn_db3"
OWN_STARTS = {"sitecustomize", "usercustomize", "usbldr", "usbldr_cli"}
IMPORTED = sorted({*sys.stdlib_module_names, *importlib.metadata.packages_distributions(), *OWN_STARTS})
PLUGIN = """\
import usbldr

ONLY = usbldr.Method("only", "as adf", build=usbldr.METHODS["adf"].build, estimates=frozenset())
"""
ROW = '[[row]]\nname = "{0}"\nlog = "log"\nfilter = "{0}"\n[row.metrics]\nmatched = {{ value = 121, abs = 200 }}\n'
BASELINE = f"schema = 1\n{ROW.format('ekf')}{ROW.format('adf')}"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a log, and a module of every name that could be imported: each leaves a mark."""
    folder = tmp_path_factory.mktemp("foreign")
    for name in IMPORTED:
        (folder / f"{name}.py").write_text(f"open({str(folder / 'executed')!r}, 'a').write('{name} ')\n")
    (folder / "log").symlink_to(LOG)
    (folder / "gate.toml").write_text(BASELINE)
    (folder / "times.csv").write_text("time_s\n5\n9\n")
    velocity = np.full(6000, 14, np.int32)  # looks like 6,000 nested cells, which a process of its own reads
    columns = {"time_ns": np.arange(6000) * 10**9, "starboard_mps": velocity, "forward_mps": velocity}
    scipy.io.savemat(folder / "dvl.mat", columns)
    return folder


COMMAND_LINES = [
    "info log",
    "info dvl.mat",
    "doctor log",
    "init log --output found.toml",
    "replay log --filter cpf --smooth --plots all --mcap alone --parquet --output run",
    "locate run --at times.csv --output places.csv",
    "evaluate log --estimate run/track_5hz.csv --output judged",
    "compare log --filters ekf,adf --jobs 2 --output compared",
    "compare log --filters ekf,only --plugin {plugin} --jobs 2",
    "drill log --filters ekf,adf --scale dvl:1.05 --jobs 2",
    "check gate.toml --jobs 2",
    "baseline log --filters ekf,adf --jobs 2 --output first.toml",
    "simulate lawnmower --output dive.bag",
    "simulate survey-box --output survey",
    "calibrate-usbl survey --output calibrated",
    "export log --output part.mcap --start 0 --end 9",
]


def run(command: Sequence[str | Path], folder: Path, **asked: str) -> subprocess.CompletedProcess[str]:
    """Run a command in the folder, which executes none of its modules."""
    done = subprocess.run(command, cwd=folder, env=os.environ | asked, capture_output=True, text=True, check=False)
    mark = folder / "executed"
    assert not mark.exists(), mark.read_text()
    return done


def test_every_command_is_tried() -> None:
    assert {line.split()[0] for line in COMMAND_LINES} == set(COMMANDS)


@pytest.mark.parametrize("words", COMMAND_LINES)
def test_no_module_of_the_current_folder_is_executed(words: str, folder: Path, tmp_path: Path) -> None:
    (plugin := tmp_path / "mine.py").write_text(PLUGIN, encoding="utf-8")

    done = run([USBLDR, *words.format(plugin=f"{plugin}:ONLY").split()], folder)

    assert done.returncode == (3 if words == "info dvl.mat" else 0), done.stderr  # a DVL alone cannot be replayed


READ_ALL = """
import sys
sys.path.append(sys.argv[1])
from damage import recorded
from damaged_formats import FORMATS
from commands import run
from usbldr.io.doctor import cross_check
cross_check._identified = lambda *_: None  # takes a second, and imports nothing
for form in FORMATS:
    with recorded(form) as (_, path, _, _):
        for command in ("info", "doctor"):
            run(command, path)
"""


def test_no_format_executes_one(folder: Path, tmp_path: Path) -> None:
    """The script lies elsewhere, so that this folder is on the path no more than for the command itself."""
    (tmp_path / "read_all.py").write_text(READ_ALL, encoding="utf-8")

    done = run([sys.executable, tmp_path / "read_all.py", ROOT / "tests" / "support"], folder)

    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completion_executes_none(shell: str, folder: Path) -> None:
    said = ""
    for line in ("usbldr replay log --usbl /", "usbldr replay log --filter e"):  # reads the log; the plugins
        last = line.split()[-1] if shell == "fish" else "4"
        said = run([USBLDR], folder, _USBLDR_COMPLETE=f"{shell}_complete", COMP_WORDS=line, COMP_CWORD=last).stdout

    assert "ekf" in said


@pytest.fixture
def address(folder: Path, tmp_path: Path) -> Generator[str]:
    """A scheduler and two workers, started in that folder as docs/cluster.md says."""
    pytest.importorskip("distributed")
    port = free_port()
    text = (ROOT / "docs" / "cluster.md").read_text(encoding="utf-8")
    lines = re.findall(r"^((?:\w+=\w+ )*)(dask (?:scheduler|worker) .*)$", text, re.MULTILINE)
    started: list[subprocess.Popen[bytes]] = []
    for settings, line in lines:
        words = line.replace("host:8786", f"127.0.0.1:{port}").replace("8786", str(port)).replace("8 ", "2 ").split()
        environment = os.environ | dict(pair.split("=") for pair in settings.split())
        command = [USBLDR.with_name(words[0]), *words[1:], "--no-dashboard"]
        with (tmp_path / "said").open("wb") as said:
            started += [subprocess.Popen(command, cwd=folder, env=environment, stdout=said, stderr=said)]
    yield f"tcp://127.0.0.1:{port}"
    for one in reversed(started):
        one.send_signal(signal.SIGINT)
        one.wait()


def test_workers_of_a_scheduler_execute_none(address: str, folder: Path) -> None:
    done = run([USBLDR, "compare", "log", "--filters", "ekf,adf", "--scheduler", address], folder)

    assert done.returncode == 0, done.stderr
