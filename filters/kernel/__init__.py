"""The compiled kernel: a bank of Gaussians over a span of steps in one call (span.h).

NumPy stays the reference, and runs instead if the kernel was not compiled, if it was compiled from other sources than
these, or if the environment variable USBLDR_KERNEL is "numpy". Any other value of it names a variant of the kernel.
"""

import os
from collections.abc import Callable
from typing import NamedTuple

SIZES = (248, 120, 600, 56, 2)  # fixed: bytes of Filter, Step, Reading and Pass in layout.h, then CALLS of module.c


class Limits(NamedTuple):
    """What the kernel has room for, from layout.h; nothing without a kernel."""

    lanes: int = 1
    states: int = 0
    modes: int = 0
    columns: int = 0
    depth: int = 0


class Kernel(NamedTuple):
    """What runs, and the functions that run it."""

    name: str  # the variant, or "numpy"
    reason: str  # why NumPy runs; empty for a compiled kernel
    advance: Callable[..., int] | None = None  # see module.c; None: NumPy
    run_pass: Callable[..., int] | None = None
    variant: int = 0
    limits: Limits = Limits()


def _choose() -> Kernel:
    """Return the best variant that this machine runs and the environment allows."""
    wanted = os.environ.get("USBLDR_KERNEL", "")
    if wanted == "numpy":
        return Kernel("numpy", "USBLDR_KERNEL=numpy")
    try:
        from usbldr.filters.kernel import _kernel
    except ImportError:
        return Kernel("numpy", "the kernel is not there: usbldr was installed without a C compiler")
    if _kernel.SIZES != SIZES:
        return Kernel("numpy", "the kernel was compiled from another version: install usbldr again")
    for name, variant in _kernel.VARIANTS:
        if wanted in ("", name):
            return Kernel(name, "", _kernel.advance, _kernel.run_pass, variant, Limits(*_kernel.LIMITS))
    names = ", ".join(name for name, _ in _kernel.VARIANTS)
    return Kernel("numpy", f"USBLDR_KERNEL={wanted} is none of the variants for this machine: {names}, numpy")


KERNEL = _choose()
"""The kernel of this process."""
