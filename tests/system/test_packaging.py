"""What setuptools, the type checker and a user's first import find of this checkout."""

import math
import os
import re
import shutil
import subprocess
import sys
import tomllib
from email import message_from_string
from pathlib import Path
from typing import TypeAlias

import pytest

import usbldr
import usbldr.filters
import usbldr.io
from commands import output_of
from needed_kernel import require_kernel
from usbldr.filters import kernel
from usbldr_cli.options.blas_threads import ONE_THREAD

ROOT = Path(__file__).resolve().parents[2]
SETUPTOOLS = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["setuptools"]
Field: TypeAlias = tuple[str, str, int, int]  # name, type, offset, count
FOLDERS = {"public": "usbldr", "filters": "usbldr.filters", "io": "usbldr.io", "usbldr_cli": "usbldr_cli"}


def python(*arguments: str, cwd: Path = ROOT, **environment: str) -> str:
    """Run Python inside the checkout, where a folder must not hide a package; return what it prints."""
    command, around = [sys.executable, *arguments], os.environ | environment
    return subprocess.run(command, cwd=cwd, env=around, capture_output=True, text=True, check=True).stdout.strip()


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
    version = python("-c", "import usbldr, usbldr.io.reading.read; print(usbldr.__version__)")
    assert python("-m", "usbldr", "--version") == f"usbldr, version {version}"


def test_the_version_tells_what_the_filters_run_on() -> None:
    reported = python("-m", "usbldr", "--version", "-v", USBLDR_KERNEL="numpy").splitlines()
    assert reported == [f"usbldr, version {usbldr.__version__}", "filters: NumPy; USBLDR_KERNEL=numpy"]
    assert output_of("-v", "--version").splitlines()[1].startswith("filters: ")


def test_importing_the_package_loads_nothing_heavy() -> None:
    call = "import sys, usbldr; print(*sorted({name.split('.')[0] for name in sys.modules}))"
    loaded = python("-c", call).split()
    assert "usbldr" in loaded
    assert not {"numpy", "pandas", "click", "matplotlib", "msgspec"} & set(loaded)


def test_every_public_name_is_there_and_there_once() -> None:
    for package in (usbldr, usbldr.filters, usbldr.io):
        assert len(package.__all__) == len(set(package.__all__))
        for name in package.__all__:
            assert getattr(package, name) is not None


@pytest.fixture(scope="module")
def without_a_compiler(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Build the source distribution, from that a wheel without a compiler, and install the wheel: its folder."""
    work = tmp_path_factory.mktemp("install")
    tracked = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=False).stdout.split()
    if not tracked:
        pytest.skip("not a git checkout, so the files of the project are not known")
    for name in tracked:
        if name.split("/")[0] != ".pyright" and (ROOT / name).is_file():
            (work / "source" / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(ROOT / name, work / "source" / name)
    tools, environment = work / "tools", {**os.environ, "CC": "no-compiler", "PYTHONPATH": str(work / "tools")}
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--no-deps", "--target"]
    subprocess.run([*pip, str(tools), "setuptools>=77"], check=True)

    def build(what: str, source: Path) -> Path:
        call = f"from setuptools import build_meta; build_meta.build_{what}({str(work)!r})"
        subprocess.run([sys.executable, "-c", call], cwd=source, env=environment, check=True, capture_output=True)
        return next(work.glob("*.tar.gz" if what == "sdist" else "*.whl"))

    sdist = build("sdist", work / "source")
    shutil.unpack_archive(sdist, work / "unpacked", filter="data")
    (unpacked,) = (work / "unpacked").iterdir()
    wheel = build("wheel", unpacked)
    subprocess.run([*pip, str(work / "installed"), str(wheel)], check=True)
    return work / "installed"


def test_without_a_compiler_the_install_succeeds_and_numpy_runs(without_a_compiler: Path) -> None:
    call = (
        "from usbldr.filters.kernel import KERNEL; from usbldr.io.session import open_log, score; "
        "from usbldr.io.reading.epochs import timeline; import usbldr; "
        f"log = open_log({str(ROOT / 'sample_logs' / 'lawnmower_turn_db3')!r}); "
        "print(usbldr.__file__, score(log, timeline(log), 'ekf').trajectory.mean[-1, 4], KERNEL.name, KERNEL.reason)"
    )
    said = python("-c", call, cwd=without_a_compiler, PYTHONPATH=str(without_a_compiler))
    place, east_m, kernel, reason = said.split(maxsplit=3)
    assert Path(place).is_relative_to(without_a_compiler)
    assert math.isfinite(float(east_m))
    assert (kernel, reason.strip()) == ("numpy", "the kernel is not there: usbldr was installed without a C compiler")


def test_the_source_distribution_has_every_file_of_the_kernel(without_a_compiler: Path) -> None:
    (unpacked,) = (without_a_compiler.parent / "unpacked").iterdir()
    (kernel,) = SETUPTOOLS["ext-modules"]
    there = {path.name for path in (ROOT / "filters" / "kernel").glob("*.[ch]")}
    assert {Path(name).name for name in (*kernel["sources"], *kernel["depends"])} == there
    assert there == {path.name for path in (unpacked / "filters" / "kernel").glob("*.[ch]")}


def test_the_source_distribution_has_what_make_and_the_tests_need(without_a_compiler: Path) -> None:
    (unpacked,) = (without_a_compiler.parent / "unpacked").iterdir()
    source = without_a_compiler.parent / "source"
    kept = {
        str(file.relative_to(source)) for file in source.rglob("*") if file.is_file() and "egg-info" not in str(file)
    }

    missing = {
        name for name in kept if not (unpacked / name).exists() and not name.startswith("filters/kernel/_kernel")
    }

    assert missing <= {".gitignore", ".pre-commit-config.yaml", ".ctags.d/usbldr.ctags"}  # of a checkout
    targets = re.search(r"^\.PHONY: (.+)$", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)
    for target in targets[1].split():  # every file that a target depends on is there, or can be made
        subprocess.run(["make", "--dry-run", target], cwd=unpacked, check=True, capture_output=True)
    subprocess.run(["make", ".pyright/usbldr"], cwd=unpacked, check=True, capture_output=True)
    links = {link.name: link.resolve() for link in (unpacked / ".pyright" / "usbldr").iterdir()}
    assert links["filters"] == (unpacked / "filters").resolve()
    assert set(links) == {link.name for link in (ROOT / ".pyright" / "usbldr").iterdir()}


def test_the_description_on_pypi_has_no_link_that_leads_nowhere(without_a_compiler: Path) -> None:
    (unpacked,) = (without_a_compiler.parent / "unpacked").iterdir()
    metadata = message_from_string((unpacked / "PKG-INFO").read_text(encoding="utf-8"))
    text = str(metadata.get_payload())

    assert metadata["Description-Content-Type"] == "text/markdown"
    assert re.findall(r"\]\((?!https://)[^)]*\)", text) == []
    assert "docs/tutorial.md goes from a bag to a check in CI" in " ".join(text.split())  # the words of a link stay
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    assert re.findall(r"^#+ .*", text, re.MULTILINE) == re.findall(r"^#+ .*", readme, re.MULTILINE)  # and all of it


def swapped(step: list[Field]) -> list[Field]:
    return [step[1], step[0], *step[2:]]


def moved(step: list[Field]) -> list[Field]:
    name, kind, offset, count = step[0]
    return [(name, kind, offset + 4, count), *step[1:]]


@pytest.mark.parametrize("change", [swapped, moved, lambda step: step[:-1], None])
def test_a_kernel_compiled_from_other_sources_does_not_run(change, monkeypatch):
    require_kernel()
    from usbldr.filters.kernel import _kernel

    size, step = _kernel.LAYOUT["Step"]
    if change is None:
        monkeypatch.setattr(_kernel, "CALLS", _kernel.CALLS - 1)
    else:
        monkeypatch.setitem(_kernel.LAYOUT, "Step", (size, change(step)))
    monkeypatch.delenv("USBLDR_KERNEL", raising=False)

    chosen = kernel._choose()  # pyright: ignore

    assert (chosen.name, chosen.advance) == ("numpy", None)
    assert chosen.reason == "the kernel was compiled from another version: install usbldr again"


IMPORTS_LATE = """
import os, sys
from usbldr_cli.main import main
assert "numpy" not in sys.modules  # which reads the environment when it is imported
sys.argv[1:] = ["--version"]
try:
    main()
finally:
    print([os.environ.get(name) for name in %r])
"""


@pytest.mark.parametrize(("asked", "threads"), [({}, "1 1 1 1"), ({"OMP_NUM_THREADS": "3"}, "3 None None None")])
def test_the_command_uses_one_thread_unless_told_otherwise(asked, threads, monkeypatch):
    for name in ONE_THREAD:
        monkeypatch.delenv(name, raising=False)

    printed = python("-c", IMPORTS_LATE % list(ONE_THREAD), **asked).splitlines()[-1]

    assert printed == str([None if text == "None" else text for text in threads.split()])
