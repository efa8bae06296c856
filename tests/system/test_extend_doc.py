"""docs/extend.md: filters, formats and message types of other packages."""

import json
import math
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from checkout import ROOT

PAGE = (ROOT / "docs" / "extend.md").read_text(encoding="utf-8")
USBLDR = Path(sys.executable).with_name("usbldr")
T0, STEP = 1_750_000_000_000_000_000, 200_000_000  # [ns]


def usbldr(words: str, folder: Path, code: int = 0, packages: Path | None = None) -> str:
    environment = {**os.environ, **({} if packages is None else {"PYTHONPATH": str(packages)})}
    done = subprocess.run([USBLDR, *words.split()], cwd=folder, env=environment, capture_output=True, text=True)
    assert done.returncode == code, done.stderr
    return done.stdout + done.stderr


@pytest.fixture(scope="module")
def packages(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Install the example of the page: the folder to import it from."""
    work = tmp_path_factory.mktemp("plugin")
    shutil.copytree(ROOT / "docs" / "extend_example", work / "source")
    pip = [sys.executable, "-m", "pip", "install", "-q", "--disable-pip-version-check", "--no-deps", "--target"]
    subprocess.run([*pip, str(work / "installed"), str(work / "source")], check=True)
    return work / "installed"


@pytest.fixture
def dive(tmp_path: Path) -> Path:
    """A circle of 1 m/s in the format of the example, without noise."""
    rows = ["ACME 1"]
    for k in range(600):
        turn = k * STEP / 1e9 / 20  # [rad] clockwise from north, radius 20 m
        rows += [f"{T0 + k * STEP} Velocity 1.0 0.0", f"{T0 + k * STEP} Heading {math.degrees(turn) % 360}"]
        if k % 5 == 0:
            rows.append(f"{T0 + k * STEP} UsblFix {20 - 20 * math.cos(turn)} {20 * math.sin(turn)}")
    (tmp_path / "dive.acme").write_text("\n".join(rows) + "\n")
    return tmp_path / "dive.acme"


def test_a_package_adds_a_format_message_types_and_a_filter(dive: Path, packages: Path) -> None:
    usbldr("replay dive.acme --filter position-kf --plots none --output run", dive.parent, packages=packages)

    report = json.loads((dive.parent / "run" / "report.json").read_text())
    assert (report["log"]["format"], report["method"]) == ("ACME log", "position-kf")
    assert re.fullmatch(r"acme-usbldr 1\.0 \(sha256 [0-9a-f]{64}\)", *report["provenance"]["plugins"])
    *_, last = (dive.parent / "run" / "track_5hz.csv").read_text().splitlines()
    time_s, east_m, north_m = map(float, last.split(",")[:3])
    assert (east_m, north_m) == pytest.approx((20 - 20 * math.cos(time_s / 20), 20 * math.sin(time_s / 20)), abs=0.3)
    assert "position-kf  Kalman filter of the position" in usbldr("replay --help", dive.parent, packages=packages)


def test_what_a_reader_of_a_package_lost_is_exit_code_3(dive: Path, packages: Path) -> None:
    dive.write_text(dive.read_text() + "17500 Velocity 1.0\n")

    assert "1 lines are no records of an ACME log" in usbldr("info dive.acme", dive.parent, 3, packages)


def test_a_broken_package_is_one_warning(dive: Path, packages: Path, tmp_path: Path) -> None:
    shutil.copytree(packages, tmp_path / "broken")
    (tmp_path / "broken" / "acme_usbldr" / "filter.py").write_text("import no_such_module\n")

    said = usbldr("info dive.acme", dive.parent, packages=tmp_path / "broken")

    assert said.count("warning") == 1
    assert "warning: plugin position-kf of acme-usbldr 1.0 is not used: acme_usbldr.filter:POSITION_KF: Module" in said


def test_a_filter_of_a_file_is_compared_on_two_processes_and_stored_for_the_same_code(tmp_path: Path) -> None:
    code = re.findall(r"^```python\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)[0]
    (tmp_path / "my_filters.py").write_text(code)
    command = (
        "compare square --filters only-fixes,ekf --plugin my_filters.py:ONLY_FIXES --jobs 2 --seeds 2 --plots none "
        "--output compared --quiet --force"
    )

    def runs() -> int:
        usbldr(command, tmp_path)
        return len(list((tmp_path / "compared" / "units").glob("*.json")))

    assert (runs(), runs()) == (4, 4)
    (tmp_path / "my_filters.py").write_text(code + "\n")
    assert runs() == 8


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("my_filters.py", "--plugin my_filters.py: name a module or file and the filter in it"),
        ("no_such_module:MINE", "--plugin no_such_module:MINE: ModuleNotFoundError"),
        ("my_filters.py:NONE", "my_filters.py:NONE: AttributeError"),
        ("my_filters.py:np", "it is no usbldr.Method, but of type module"),
        ("my_filters.py:EKF", "there is a filter 'ekf' already; give it another name"),
    ],
)
def test_a_plugin_that_cannot_be_used_is_one_sentence(text: str, sentence: str, tmp_path: Path) -> None:
    content = "import numpy as np\nimport usbldr\nEKF = usbldr.Method('ekf', 'not the one')\n"
    (tmp_path / "my_filters.py").write_text(content)

    said = usbldr(f"replay square --plugin {text} --output run", tmp_path, 2)

    assert sentence in said
    assert said.count("\n") == 1


def test_a_module_of_the_current_folder_is_no_plugin(tmp_path: Path) -> None:
    (tmp_path / "my_filters.py").write_text("open('executed', 'w')\n")

    usbldr("replay square --plugin my_filters:MINE --output run", tmp_path, 2)

    assert not (tmp_path / "executed").exists()
