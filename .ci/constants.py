"""docs/constants.md from the code: every tuned number with its unit, its reason and how much it matters.

    python .ci/constants.py > docs/constants.md

A tuned number is an UPPER_CASE number (or tuple of numbers) of a module, or a numeric default of a frozen dataclass;
0 and infinity switch something off and are left out. Its reason is the comment or docstring beside it. A comment that
begins with "fixed" marks what a standard, a file format or physics fixes, and what is no tuning; a unit in square
brackets at its beginning goes before the one that the name ends in.
"""

import ast
import importlib
import math
import re
from collections.abc import Iterator, Mapping
from itertools import takewhile
from pathlib import Path
from typing import Any, NamedTuple

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = {"filters": "usbldr.filters", "io": "usbldr.io", "usbldr_cli": "usbldr_cli"}
UNITS = {"mps": "m/s", "rad": "rad", "deg": "deg", "radps": "rad/s", "m2": "m²", "pa": "Pa", "sigmas": "sigma"}
STUDIED = {
    "Parameters": "",
    "ProcessNoise": "process",
    "SensorErrors": "errors",
    "Contamination": "usbl",
    "Start": "start",
}
HEAD = """# Constants

Every tuned number of the code, made by `.ci/constants.py` and held to the code by a test. The last column quotes
`benchmarks/field/sensitivity.md`: the largest change of the error on any log of [the field study](studies/field.md) if
the number is halved, and if it is doubled; "-": not measured.

| module | name | value | unit | reason | half / twice |
| --- | --- | --- | --- | --- | --- |
"""


class Constant(NamedTuple):
    """A tuned number, as a row of the page."""

    module: str
    name: str
    value: str
    unit: str
    reason: str


def page() -> str:
    """Return the text of docs/constants.md."""
    effects = measured((ROOT / "benchmarks" / "field" / "sensitivity.md").read_text(encoding="utf-8"))
    rows = (
        (*one, effects.get(one.name) or effects.get(f"{Path(one.module).stem}.{one.name}", "-")) for one in constants()
    )
    return HEAD + "".join("| " + " | ".join(row) + " |\n" for row in rows)


def measured(study: str) -> Mapping[str, str]:
    """Return name -> largest changes, from the study's table of halved and doubled defaults."""
    found: dict[str, str] = {}
    owners = {key: name for name, key in STUDIED.items()}
    for label, cells in re.findall(r"^\| `([\w.]+)` \|(.* / .*)\|$", study, re.MULTILINE):
        pairs = [[0.0 if part.strip() == "·" else float(part) for part in cell.split("/")] for cell in cells.split("|")]
        half, twice = (max(column, key=abs) for column in zip(*pairs, strict=True))
        owner, _, name = label.rpartition(".")
        found[f"{owners.get(owner, owner)}.{name}"] = f"{half:+.1f} % / {twice:+.1f} %"
    return found


def constants() -> Iterator[Constant]:
    """Yield the tuned numbers of all modules, in their order."""
    for folder, package in PACKAGES.items():
        for file in sorted((ROOT / folder).rglob("*.py")):
            path, text = file.relative_to(ROOT), file.read_text(encoding="utf-8")
            module = importlib.import_module(".".join([package, *path.with_suffix("").parts[1:]]))
            for owner, name, node, after in assignments(ast.parse(text)):
                comment = reason(text.splitlines(), node, after)
                value = eval(ast.unparse(node.value), vars(module))  # the checkout's own code, as importing it does
                if tuned(value) and not comment.startswith("fixed"):
                    stated, words = re.match(r"(?:\[([^]]+)\] *)?(.*)", comment, re.DOTALL).groups()
                    unit = stated or unit_of(name, value)
                    source = " ".join((ast.get_source_segment(text, node.value) or "").split())
                    yield Constant(f"`{path}`", f"{owner}{name}", f"`{source}`", unit, words)


def assignments(tree: ast.Module) -> Iterator[tuple[str, str, Any, ast.stmt | None]]:
    """Yield class, name, statement and what follows it, of what may hold a constant."""
    for owner in (tree, *(node for node in tree.body if isinstance(node, ast.ClassDef))):
        prefix = f"{owner.name}." if isinstance(owner, ast.ClassDef) else ""
        if prefix and not any("frozen=True" in ast.unparse(one) for one in owner.decorator_list):
            continue
        for node, after in zip(owner.body, [*owner.body[1:], None], strict=True):
            target = node.targets[0] if isinstance(node, ast.Assign) else getattr(node, "target", None)
            if isinstance(target, ast.Name) and getattr(node, "value", None) and (prefix or target.id.isupper()):
                yield prefix, target.id, node, after


def tuned(value: object) -> bool:
    """Return whether a value is a number or a tuple of them that does more than switch something off."""
    numbers = value if isinstance(value, tuple) and value else (value,)
    return all(type(one) in (int, float) for one in numbers) and any(one and math.isfinite(one) for one in numbers)


def unit_of(name: str, value: Any) -> str:
    """Return the unit that a name ends in; a whole number counts what its last word says, another is a ratio."""
    last = name.lower().split("_")[-1]
    return UNITS.get(last, last if isinstance(value, int) or last in ("m", "s", "ns") else "1")


def reason(lines: list[str], node: ast.stmt, after: ast.stmt | None) -> str:
    """Return the comment behind or in a statement, else the one above it, and the docstring below."""
    first = node.lineno - 1
    comments = [line.partition("# ")[2] for line in lines[first : node.end_lineno]]
    if not any(comments):
        above = takewhile(lambda line: line.startswith("# "), map(str.strip, reversed(lines[:first])))
        comments = [line.removeprefix("# ") for line in reversed(list(above))]
    if isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant):
        comments.append(str(after.value.value))
    return " ".join(" ".join(comments).split())


if __name__ == "__main__":
    print(page(), end="")
