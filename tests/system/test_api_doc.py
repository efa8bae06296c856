"""docs/api.md and the notebooks: every public name is described, and every line of code runs."""

import json
import re
from pathlib import Path

import pytest

import usbldr

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "api.md").read_text(encoding="utf-8")
NOTEBOOKS = sorted((ROOT / "docs" / "notebooks").glob("*.ipynb"))


@pytest.mark.parametrize("name", usbldr.__all__)
def test_the_page_describes_every_public_name(name: str) -> None:
    assert re.search(rf"`(usbldr\.)?{name}\b", re.sub(r"```.*?```", "", PAGE, flags=re.DOTALL))


def test_every_block_of_the_page_runs(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.chdir(ROOT)
    blocks = re.findall(r"^```python\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)
    names: dict[str, object] = {}
    for block in blocks:
        exec(block, names)
    assert "adf: " in capsys.readouterr().out


@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda file: file.stem)
def test_every_cell_of_a_notebook_runs_and_none_keeps_its_output(
    notebook: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(ROOT)
    cells = [cell for cell in json.loads(notebook.read_text(encoding="utf-8"))["cells"] if cell["cell_type"] == "code"]
    names: dict[str, object] = {}
    for cell in cells:
        assert cell["outputs"] == []
        exec("".join(cell["source"]), names)
    assert "mean" in capsys.readouterr().out


def test_there_are_notebooks() -> None:
    assert [file.stem for file in NOTEBOOKS] == ["first_log", "own_filter"]
