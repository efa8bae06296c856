"""A folder of somebody else's logs may hold Python files, too: no command executes them."""

import importlib.metadata
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import scipy.io

from checkout import ROOT

USBLDR = Path(sys.executable).with_name("usbldr")
LOG = ROOT / "sample_logs" / "lawnmower_turn_db3"
IMPORTED = sorted({*sys.stdlib_module_names, *importlib.metadata.packages_distributions()})
BASELINE = """\
schema = 1
[[row]]
name = "a"
log = "log"
filter = "ekf"
[row.metrics]
matched = { value = 121, abs = 200 }
[[row]]
name = "b"
log = "log"
filter = "adf"
[row.metrics]
matched = { value = 121, abs = 200 }
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a log, and a module of every name that could be imported: each leaves a mark."""
    folder = tmp_path_factory.mktemp("foreign")
    for name in IMPORTED:
        (folder / f"{name}.py").write_text(f"open({str(folder / 'executed')!r}, 'a').write('{name} ')\n")
    (folder / "log").symlink_to(LOG)
    (folder / "gate.toml").write_text(BASELINE)
    velocity = np.full(6000, 14, np.int32)  # looks like 6,000 nested cells, which a process of its own reads
    columns = {"time_ns": np.arange(6000) * 10**9, "starboard_mps": velocity, "forward_mps": velocity}
    scipy.io.savemat(folder / "dvl.mat", columns)
    return folder


@pytest.mark.parametrize(
    "words",
    [
        "info log",
        "info dvl.mat",
        "doctor log",
        "init log --output found.toml",
        "replay log --filter cpf --output run",
        "evaluate log --estimate run/track_5hz.csv --output judged",
        "compare log --filters ekf,adf --jobs 2 --output compared",
        "drill log --filters ekf,adf --scale dvl:1.05 --jobs 2",
        "check gate.toml --jobs 2",
        "simulate lawnmower --output dive.bag",
        "export log --output part.mcap --start 0 --end 9",
    ],
)
def test_no_module_of_the_current_folder_is_executed(words: str, folder: Path) -> None:
    done = subprocess.run([USBLDR, *words.split()], cwd=folder, capture_output=True, text=True, check=False)

    mark = folder / "executed"
    assert (mark.read_text() if mark.exists() else "") == ""
    assert done.returncode == (3 if words == "info dvl.mat" else 0), done.stderr  # a DVL alone cannot be replayed
