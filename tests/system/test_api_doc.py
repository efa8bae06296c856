"""docs/api.md and the notebooks: every public name is described, and every line of code runs."""

import inspect
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


@pytest.mark.parametrize("call", re.findall(r"^\| `(\w+\([^`]*\))` →", PAGE, re.MULTILINE))
def test_a_signature_is_that_of_the_function(call: str) -> None:
    name, arguments = call[:-1].split("(", 1)
    signature = inspect.signature(getattr(usbldr, name))
    stated = [] if arguments == "..." else re.split(r", (?=\w+(?:=|,|$))", arguments)
    names = list(signature.parameters)

    assert [one.split("=")[0] for one in stated] == [one for one in names if one != "progress"][: len(stated)]
    optional = {name for name, one in signature.parameters.items() if one.default is not one.empty}
    assert {one.split("=")[0] for one in stated if "=" in one} <= optional
    assert arguments == "..." or {*names} - {one.split("=")[0] for one in stated} <= optional


@pytest.mark.parametrize(("name", "cell"), re.findall(r"^\| `([A-Z]\w+)` \| (.*) \|$", PAGE, re.MULTILINE))
def test_what_a_type_holds_are_its_attributes(name: str, cell: str) -> None:
    kind = getattr(usbldr, name)
    fields = {*dir(kind), *getattr(kind, "__annotations__", ()), *usbldr.__all__, "None", "auto"}

    assert {*re.findall(r"`([a-z_]\w*)`", cell)} - fields == set()


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
