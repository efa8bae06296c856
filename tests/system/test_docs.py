"""The pages of the documentation are held to the program: commands, output, names, types, constants and Python."""

import doctest
import inspect
import json
import re
import runpy
import shlex
import shutil
import tomllib
from pathlib import Path
from typing import Any

import msgspec
import pytest
from click.testing import CliRunner
from ruamel.yaml import YAML

import usbldr
from checkout import ROOT
from commands import command, options_of, write_short
from logs import logged
from recordings import HEADER, T0, define
from usbldr.filters.models.calibration import REPORTED_QUANTITIES
from usbldr.filters.replay.methods import METHODS
from usbldr.io.messages import registry
from usbldr.io.messages.layouts import MessageLayout
from usbldr.io.reports.usbl_calibration import HEAD_KEYS, USBL_KEYS
from usbldr_cli.main import COMMANDS, cli

README = (ROOT / "README.md").read_text(encoding="utf-8")
COMMAND = re.compile(r"^\$ usbldr (.*)\n((?:(?!\$ ).*\n)*)", re.MULTILINE)


def commands(text: str) -> list[tuple[str, str]]:
    """Return each `$ usbldr ...` of the console blocks with the output that is shown under it."""
    blocks = re.findall(r"^```console\n(.*?)^```", text, re.MULTILINE | re.DOTALL)
    return [found for block in blocks for found in COMMAND.findall(block)]


@pytest.mark.parametrize("page", ["README.md", "docs/tutorial.md", "docs/real_log.md"])
@pytest.mark.long
def test_every_command_of_a_page_prints_what_the_page_shows(page, tmp_path, monkeypatch):
    shutil.copytree(ROOT / "docs" / "real_log", tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    runner = CliRunner()
    if page == "README.md":
        write_short(tmp_path / "dive.mcap", "paper", 300.0)  # the reader's own log
    shown = commands((ROOT / page).read_text(encoding="utf-8"))
    assert len(shown) >= 6
    for line, want in shown:
        done = runner.invoke(cli, line.split())
        assert done.exit_code == 0, f"usbldr {line}\n{done.output}"
        flags = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE
        assert not want or doctest.OutputChecker().check_output(want, done.output, flags), f"{line}\n{done.output}"


def test_the_readme_names_targets_that_the_makefile_has() -> None:
    targets = set(re.findall(r"^([a-z_]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
    named = set(re.findall(r"^make ([a-z_]+)$", README, re.MULTILINE))
    assert {"demo", "test"} <= named <= targets


DOC = (ROOT / "docs" / "types.md").read_text(encoding="utf-8")


def test_every_file_that_the_readme_links_to_and_that_the_page_of_types_names_is_there() -> None:
    for name in (*re.findall(r"\]\(([^)#:]+)\)", README), *re.findall(r"`((?:io|tests)/[a-z_/]+\.py)`", DOC)):
        assert (ROOT / name).is_file(), name


@pytest.mark.parametrize("name", list(COMMANDS))
def test_every_command_explains_itself_and_ends_in_a_line_to_paste(name: str) -> None:
    done = CliRunner().invoke(cli, [name, "--help"])
    assert done.exit_code == 0
    assert re.search(rf"^\s+\$ usbldr {name} .+$", done.output, re.MULTILINE), done.output
    assert "\\b" not in done.output


def test_the_help_lists_every_command_and_the_exit_codes() -> None:
    done = CliRunner().invoke(cli, ["--help"])
    for name in COMMANDS:
        assert re.search(rf"^\s+{name}\s", done.output, re.MULTILINE)
    for code in ("0 good", "1 a check failed", "2 wrong usage", "3 the log is unreadable", "130 interrupted"):
        assert code in done.output


PAGES = {
    name: (ROOT / "docs" / f"{name}.md").read_text(encoding="utf-8")
    for name in ("features", "troubleshooting", "ci", "findings", "configuration")
}


def found(pattern: str, page: str) -> list[Any]:
    return sorted(set(re.findall(pattern, PAGES[page])))


@pytest.mark.parametrize("line", found(r"`usbldr ([^`]+)`", "features"))
def test_every_command_among_the_features_has_its_options(line: str) -> None:
    name, *words = line.split()
    assert {word for word in words if re.fullmatch(r"--?[a-z][a-z-]*", word)} <= options_of(name)


@pytest.mark.parametrize(("page", "where"), [("features", COMMANDS), ("troubleshooting", ["replay"])])
def test_every_option_of_the_features_is_one_of_a_command_and_of_the_symptoms_one_of_replay(page, where):
    known = set[str]().union(*map(options_of, where))
    assert [option for option in found(r"`(--[a-z-]+)", page) if option not in known] == []


def test_every_filter_is_among_the_features() -> None:
    row = next(line for line in PAGES["features"].splitlines() if "`--filter dr`" in line)
    listed = set(re.findall(r"`(?:--filter )?([a-z]+)`", row.split("|")[2]))
    elsewhere = {"aekf", "afukf", "pf-wekf"}
    assert listed == set(METHODS) - elsewhere


def test_every_code_of_the_symptoms_is_one_of_a_finding() -> None:
    codes = set(found(r"`([A-Z]+(?:-[A-Z]+)+|[A-Z]{5,})`", "troubleshooting"))
    assert len(codes) > 15
    assert codes <= set(found(r"`([A-Z-]+)`", "findings"))


FILTERS = {"adf", "cpf"}
REPORTED = {"heading", "calibrated", "recovery", "noise", "whiteness", "evidence", "provenance", "diverged", "compare"}
"""Lines of a report and words of tables."""


@pytest.mark.parametrize("key", found(r"`([a-z]+(?:_[a-z]+)*)(?: = [^`]*)?`", "troubleshooting"))
def test_every_key_of_the_symptoms_is_explained(key: str) -> None:
    assert key in FILTERS | REPORTED or re.search(rf"`{key}\b", PAGES["configuration"])


def test_the_workflows_for_ci_are_yaml_and_keep_what_failed() -> None:
    blocks = re.findall(r"```yaml\n(.*?)```", PAGES["ci"], re.DOTALL)
    github, gitlab = (YAML(typ="safe").load(block) for block in blocks)

    steps = github["jobs"]["gate"]["steps"]
    assert any("GITHUB_STEP_SUMMARY" in step.get("run", "") and step["if"] == "always()" for step in steps)
    (upload,) = [step for step in steps if "upload-artifact" in step.get("uses", "")]
    assert gitlab["gate"]["artifacts"]["reports"]["junit"] == "gate.xml"
    assert upload["with"]["path"] == gitlab["gate"]["artifacts"]["paths"][0]


def test_the_checks_of_a_terminal_and_of_both_services_take_their_options() -> None:
    lines = re.findall(r"(?:^\$|- run:|    -) usbldr (check|baseline) (.*)$", PAGES["ci"], re.MULTILINE)

    assert [name for name, _ in lines] == ["baseline", "check", "check", "check"]
    for name, words in lines:
        assert command(name).make_context(name, shlex.split(words)).params


define({"acme_msgs/msg/Speed": "float64 forward\nfloat64 port\nfloat64 up\n"})
define({"acme_msgs/msg/BottomLock": f"{HEADER}acme_msgs/Speed speed\nint32 status\nfloat64 sigma\n"})


def test_the_type_that_the_page_adds_is_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = DOC[DOC.index("## A new type") : DOC.index("## A new sentence")]
    (shown,) = re.findall(r"```toml\n(.*?)```", page, re.DOTALL)
    (layout,) = msgspec.convert(tomllib.loads(shown)["layout"], list[MessageLayout])
    monkeypatch.setattr(registry, "LAYOUTS", {**registry.LAYOUTS, "dvl": (layout,)})
    values = {"header.stamp": T0, "speed.forward": 150.0, "speed.port": -20.0, "status": 1, "sigma": 2.0}
    rows = [(T0 + k, "/acme", "acme_msgs/msg/BottomLock", {**values, "status": 1 - k}) for k in range(2)]

    table = logged(tmp_path, rows, '[dvl]\nsd_mps = "message"').tables["dvl"]

    assert (table["starboard_mps"].iloc[0], table["forward_mps"].iloc[0]) == pytest.approx((0.2, 1.5))
    assert table["sd_mps"].iloc[0] == pytest.approx(0.02)


def cells(heading: str, column: int) -> list[str]:
    """Return one column of the tables under a heading of the page."""
    part = DOC[DOC.index(heading) :].split("\n## ")[0]
    rows = [line[2:-2].split(" | ") for line in part.splitlines() if line.startswith("| ")]
    return [row[column] for row in rows]


def names(cell: str) -> set[str]:
    """Return the types that a cell names, without their packages, in lower case; a name with a suffix is a topic's."""
    words = re.findall(r"`([A-Za-z0-9_./]+)`", cell)
    return {word.rpartition("/")[2].rpartition(".")[2].lower() for word in words}


def test_every_type_that_the_page_names_is_known_and_every_type_that_is_read_stands_there() -> None:
    known = {layout.type for layouts in registry.LAYOUTS.values() for layout in layouts if not layout.unsupported}
    named = set[str]().union(*map(names, cells("## What is read", 0)))

    assert named - {"compass_hdg", "rel_alt"} <= known
    assert known - {*registry.LAYOUTS, "psonlld_ship", "ptsag_ship"} <= named


SENSORS = {"DVL": "dvl", "heading": "compass", "USBL": "usbl", "GPS": "gps", "depth": "depth"}
FOUND = {"": "by type", "with a name": "by type and name", "named": "only when named"}


def test_each_type_is_found_the_way_that_the_page_says() -> None:
    role = ""
    for kind, found in zip(cells("## What is read", 0), cells("## What is read", 1), strict=True):
        role = SENSORS.get(kind, role)
        for name in names(kind) - {"compass_hdg"} if found in FOUND else ():
            ways = {layout.recognised for layout in registry.LAYOUTS[role] if layout.type == name}
            assert FOUND[found] in ways, f"{role} {name}"


def test_every_refused_type_stands_on_the_page_and_no_other() -> None:
    """A star marks a type that is refused only if it is named."""
    layouts = [layout for layouts in registry.LAYOUTS.values() for layout in layouts if layout.unsupported]
    listed = " ".join(cells("## What is refused", 0))
    starred = set[str]().union(*(names(one) for one in re.findall(r"`[^`]+`(?=\\\*)", listed)))

    assert names(listed) - {"vision_speed", "odom", "utm"} == {layout.type for layout in layouts}
    assert starred == {layout.type for layout in layouts if layout.recognised == "only when named"}


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


@pytest.mark.parametrize(("name", "fields"), re.findall(r"`([A-Z]\w+)\(([a-z_]+(?:, [a-z_]+)*)\)`", PAGE))
def test_a_value_is_made_of_the_fields_that_the_page_names(name: str, fields: str) -> None:
    assert {*fields.split(", ")} <= {*inspect.signature(getattr(usbldr, name)).parameters}


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


@pytest.mark.parametrize("name", ["first_log", "own_filter"])
def test_every_cell_of_a_notebook_runs_and_none_keeps_its_output(name, monkeypatch, capsys):
    (notebook,) = (file for file in NOTEBOOKS if file.stem == name)
    assert len(NOTEBOOKS) == 2
    monkeypatch.chdir(ROOT)
    cells = [cell for cell in json.loads(notebook.read_text(encoding="utf-8"))["cells"] if cell["cell_type"] == "code"]
    names: dict[str, object] = {}
    for cell in cells:
        assert cell["outputs"] == []
        exec("".join(cell["source"]), names)
    assert "mean" in capsys.readouterr().out


CONSTANTS = (ROOT / "docs" / "constants.md").read_text(encoding="utf-8")
ROWS = [[cell.strip() for cell in line.split("|")[1:-1]] for line in CONSTANTS.splitlines() if line.startswith("| `")]


def test_the_page_is_what_the_code_says() -> None:
    made = runpy.run_path(str(ROOT / ".ci" / "constants.py"))["page"]()

    assert made == CONSTANTS, "make it anew: python .ci/constants.py > docs/constants.md"


def test_every_constant_has_a_unit_and_a_reason() -> None:
    assert [row for row in ROWS if not (len(row) == 6 and all(row))] == []


@pytest.mark.parametrize("folder", ["filters", "io", "usbldr_cli"])
def test_no_plain_number_of_a_module_is_left_out_unless_it_is_fixed(folder: str) -> None:
    listed = {(row[0].strip("`"), row[1]) for row in ROWS}
    for file in (ROOT / folder).rglob("*.py"):
        for name, comment in re.findall(r"^([A-Z][A-Z0-9_]{2,}) = [\d.][\d._e-]*(.*)$", file.read_text(), re.MULTILINE):
            there = (file.relative_to(ROOT).as_posix(), name) in listed
            assert there != ("# fixed" in comment), (file, name)


def test_the_page_of_the_calibration_names_the_keys_that_each_command_writes() -> None:
    page = (ROOT / "docs" / "usbl_installation.md").read_text(encoding="utf-8")
    rows = page.split("section: keys that it writes |\n|---|---|\n")[1].split("\n\n")[0].splitlines()
    cells = [row.split("|")[2].strip().split(": ") for row in rows]
    by_section = {
        section: {one.key for one in REPORTED_QUANTITIES.values() if one.section == section}
        for section in ("dvl", "compass", "usbl")
    }
    assert [(where, set(re.findall(r"`(\w+)`", keys))) for where, keys in cells] == [
        ("`[dvl]`", by_section["dvl"] | {"lever_arm_m", "latency_s"}),
        ("`[compass]`", by_section["compass"] | {"latency_s"}),
        ("`[usbl]`", by_section["usbl"]),
        ("`[usbl]`", {*USBL_KEYS.values(), "level"}),
        ("`head` of `[usbl]`", {*HEAD_KEYS.values(), "lever_arm_m"}),
    ]
