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


@pytest.mark.parametrize("compiled", [True, False])
@pytest.mark.parametrize("file", ["cpf.py", "kernel/__init__.py", "kernel/_kernel.abi3.so", "kernel/_kernel.pyi"])
def test_every_file_that_makes_results_counts_and_no_other(package: Path, file: str, compiled: bool) -> None:
    before, of_the_other = digest_of(package, compiled=compiled), digest_of(package, compiled=not compiled)
    (package / file).write_text("changed")
    counts = file.endswith(".py") or (compiled and file.endswith(".so"))
    assert (digest_of(package, compiled=compiled) != before) == counts
    assert before != of_the_other


def test_the_installed_kernel_is_among_the_files(tmp_path: Path) -> None:
    if KERNEL.advance is None:
        pytest.skip(f"no compiled kernel: {KERNEL.reason}")
    copy = shutil.copytree(Path(usbldr.filters.__file__).parent, tmp_path / "filters")
    assert digest_of(copy, compiled=True) == code_digest()
    (kernel,) = copy.glob("kernel/_kernel*.so")
    kernel.write_bytes(kernel.read_bytes() + b"0")
    assert digest_of(copy, compiled=True) != code_digest()
