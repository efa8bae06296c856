"""The digest of the code that makes a result: stored results of other code are not reused."""

import functools
import hashlib
from importlib.metadata import version
from pathlib import Path

import usbldr.filters
from usbldr.filters.kernel import KERNEL
from usbldr.filters.plugins import sources


def code_digest() -> str:
    """Return the digest of the installed filters, of plugins, of NumPy's version, and of the kernel if it runs."""
    return _own() + "".join(f" {source}" for source in sources())


@functools.cache
def _own() -> str:
    return digest_of(Path(usbldr.filters.__file__).parent, compiled=KERNEL.advance is not None)


def digest_of(filters: Path, *, compiled: bool) -> str:
    """Return the digest for the package at a path; its compiled kernel counts only if it is used.

    All variants of the kernel give the same numbers, so they do not count.
    """
    digest = hashlib.sha256(f"{version('usbldr')} {version('numpy')}".encode())
    kernel = filters.glob("kernel/_kernel*[!i]") if compiled else ()
    for file in sorted([*filters.rglob("*.py"), *kernel]):
        digest.update(file.read_bytes())
    return digest.hexdigest()
