"""Stored results: which change of the code makes them stale."""

import shutil
from pathlib import Path

import pytest

import usbldr.filters
from usbldr.filters.kernel import KERNEL
from usbldr_cli.runs.code_digest import code_digest, digest_of


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """A package of filters: two files of Python and a kernel with its type stub."""
    (tmp_path / "kernel").mkdir()
    for file in ("cpf.py", "kernel/__init__.py", "kernel/_kernel.abi3.so", "kernel/_kernel.pyi"):
        (tmp_path / file).write_text(file)
    return tmp_path


@pytest.mark.parametrize("file", ["cpf.py", "kernel/__init__.py", "kernel/_kernel.abi3.so"])
def test_every_file_that_makes_results_counts(package: Path, file: str) -> None:
    before = digest_of(package, compiled=True)
    (package / file).write_text("changed")
    assert digest_of(package, compiled=True) != before


@pytest.mark.parametrize(("file", "compiled"), [("kernel/_kernel.pyi", True), ("kernel/_kernel.abi3.so", False)])
def test_a_type_stub_and_a_kernel_that_does_not_run_count_for_nothing(package: Path, file: str, compiled: bool) -> None:
    before = digest_of(package, compiled=compiled)
    (package / file).write_text("changed")
    assert digest_of(package, compiled=compiled) == before


def test_results_of_numpy_and_of_the_kernel_are_kept_apart(package: Path) -> None:
    assert digest_of(package, compiled=True) != digest_of(package, compiled=False)


def test_the_installed_kernel_is_among_the_files(tmp_path: Path) -> None:
    if KERNEL.advance is None:
        pytest.skip(f"no compiled kernel: {KERNEL.reason}")
    copy = shutil.copytree(Path(usbldr.filters.__file__).parent, tmp_path / "filters")
    assert digest_of(copy, compiled=True) == code_digest()
    (kernel,) = copy.glob("kernel/_kernel*.so")
    kernel.write_bytes(kernel.read_bytes() + b"0")
    assert digest_of(copy, compiled=True) != code_digest()
