"""The compiled kernel, without which its tests have nothing to test."""

import os
import shutil

import pytest

from usbldr.filters.kernel import KERNEL


def require_kernel() -> None:
    """Skip the tests without a C compiler; fail if there is one, as the kernel is then broken or out of date."""
    if KERNEL.advance is not None:
        return
    compiler = next(filter(shutil.which, (os.environ.get("CC", "cc"), "gcc", "clang")), None)
    if compiler is None or KERNEL.reason.startswith("USBLDR_KERNEL"):
        pytest.skip(f"no compiled kernel: {KERNEL.reason}", allow_module_level=True)
    pytest.fail(f"no compiled kernel, although {compiler} is there: {KERNEL.reason}", pytrace=False)
