"""Figures look the same whatever settings of matplotlib lie about."""

import hashlib
import os
import subprocess
import sys
from pathlib import Path

from usbldr_cli.figures.style import in_style, save, titled_figure

DRAWING = """
import sys
from pathlib import Path
from usbldr_cli.figures.style import in_style, save, titled_figure
with in_style():
    figure = titled_figure("title", "detail", 4, 3)
    figure.subplots().plot([0, 1], [0, 1])
    save(figure, Path("figure.png"))
"""


def test_settings_of_matplotlib_in_the_folder_or_of_the_user_change_no_figure(tmp_path: Path) -> None:
    (tmp_path / "matplotlibrc").write_text("axes.facecolor: red\nlines.linewidth: 20\nno such line\n")
    user = tmp_path / "user"
    user.write_text("figure.facecolor: blue\nsavefig.dpi: 10\ntext.usetex: true\n")

    command = [sys.executable, "-P", "-c", DRAWING]
    done = subprocess.run(command, cwd=tmp_path, env={**os.environ, "MATPLOTLIBRC": str(user)}, capture_output=True)

    with in_style():
        figure = titled_figure("title", "detail", 4, 3)
        figure.subplots().plot([0, 1], [0, 1])
        save(figure, tmp_path / "expected.png")
    assert (done.returncode, done.stderr) == (0, b"")
    drawn, expected = (hashlib.sha256((tmp_path / f"{name}.png").read_bytes()) for name in ("figure", "expected"))
    assert drawn.hexdigest() == expected.hexdigest()
