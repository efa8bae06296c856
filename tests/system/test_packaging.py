"""What setuptools, the type checker and a user's first import find of this checkout."""

import ast
import os
import subprocess
import sys
import tomllib
from pathlib import Path

import usbldr
import usbldr.filters
import usbldr.io
from commands import output_of

ROOT = Path(__file__).resolve().parents[2]
SETUPTOOLS = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["setuptools"]
FOLDERS = {"public": "usbldr", "filters": "usbldr.filters", "io": "usbldr.io", "usbldr_cli": "usbldr_cli"}


def python(*arguments: str) -> str:
    """Run Python inside the checkout, where a folder must not hide a package."""
    done = subprocess.run([sys.executable, *arguments], cwd=ROOT, capture_output=True, text=True, check=True)
    return done.stdout.strip()


def test_the_packages_to_install_are_the_folders_that_hold_python_files() -> None:
    found = set[str]()
    for folder, package in FOLDERS.items():
        for file in (ROOT / folder).rglob("*.py"):
            rooms = file.parent.relative_to(ROOT / folder).parts
            assert (file.parent / "__init__.py").is_file(), file
            found.add(".".join([package, *rooms]))
    assert len(SETUPTOOLS["packages"]) == len(set(SETUPTOOLS["packages"]))
    assert set(SETUPTOOLS["packages"]) == found
    assert SETUPTOOLS["package-dir"] == {package: name for name, package in FOLDERS.items() if name != package}


def test_the_type_checker_sees_every_file_of_the_public_package() -> None:
    links = {link.name: link.resolve() for link in (ROOT / ".pyright" / "usbldr").iterdir()}
    there = {path.name: path for path in (ROOT / "public").iterdir() if path.is_file()}
    assert links == {**there, "filters": ROOT / "filters", "io": ROOT / "io"}
    assert "py.typed" in links


def test_python_started_in_the_checkout_finds_the_package_and_its_command_line() -> None:
    version = python("-c", "import usbldr, usbldr.io.read; print(usbldr.__version__)")
    assert python("-m", "usbldr", "--version") == f"usbldr, version {version}"


def test_the_version_tells_what_the_filters_run_on() -> None:
    environment = {**os.environ, "USBLDR_KERNEL": "numpy"}
    command = [sys.executable, "-m", "usbldr", "--version", "-v"]
    told = subprocess.run(command, capture_output=True, text=True, check=True, env=environment).stdout.splitlines()
    assert told == [f"usbldr, version {usbldr.__version__}", "filters: NumPy; USBLDR_KERNEL=numpy"]
    assert output_of("-v", "--version").splitlines()[1].startswith("filters: ")


def test_importing_the_package_loads_nothing_heavy() -> None:
    call = "import sys, usbldr; print(*sorted({name.split('.')[0] for name in sys.modules}))"
    loaded = python("-c", call).split()
    assert "usbldr" in loaded
    assert not {"numpy", "pandas", "click", "matplotlib", "msgspec"} & set(loaded)


def test_every_public_name_is_there_whether_asked_for_or_seen_by_a_type_checker() -> None:
    for package in (usbldr, usbldr.filters, usbldr.io):
        assert len(package.__all__) == len(set(package.__all__))
        for name in package.__all__:
            assert getattr(package, name) is not None
    for package in (usbldr.filters, usbldr.io):
        body = ast.parse(Path(str(package.__file__)).read_text(encoding="utf-8")).body
        (checked,) = (block for block in body if isinstance(block, ast.If))
        imported = [alias.name for line in checked.body if isinstance(line, ast.ImportFrom) for alias in line.names]
        assert sorted(imported) == sorted(package.__all__)
