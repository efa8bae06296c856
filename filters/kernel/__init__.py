"""The compiled kernel: a bank of Gaussians over a span of steps in one call (span.h).

NumPy stays the reference, and runs instead if the kernel was not compiled, if it was compiled from other sources than
these, or if the environment variable USBLDR_KERNEL is "numpy". Any other value of it names a variant of the kernel.
"""

import os
import struct
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

CALLS = 8  # fixed: version of the arguments of the functions, as in module.c
FIELDS = {
    "Function": "number kind k nonlinear columns argument row axis angle bilinear uses held padding",
    "NoiseModes": "probability log_probability R nominal",
    "Reading": "g noise z modes fix",
    "Step": "dt_s remaining usual added state seed seeded gap readings padding",
    "Filter": "scale resample_below walk bias_s bias_m2 n N update move_steps bias_row padding",
    "Pass": "far offset_m2 log_negligible n N F G modes bias_row per_scalar padding",
    "Search": "far walk_m2 rate_m2 bias_m2 cell_m n F modes kinds bias_row histories recent_bits gradual",
}
"""The structures of layout.h in the order in which Python writes their fields; types and offsets are the module's."""
TYPES = {"double": "f8", "Covariance": "3f8", "int32_t": "i4", "uint32_t": "u4", "uint64_t": "u8"}
CODES = {"f8": "d", "i4": "i", "u4": "I", "u8": "Q"}  # of the module struct


class Limits(NamedTuple):
    """What the kernel has room for, from layout.h; nothing without a kernel."""

    lanes: int = 1
    states: int = 0
    modes: int = 0
    columns: int = 0
    depth: int = 0
    histories: int = 0


class Kernel(NamedTuple):
    """What runs, and the functions that run it."""

    name: str  # the variant, or "numpy"
    reason: str  # why NumPy runs; empty for a compiled kernel
    advance: Callable[..., int] | None = None  # see module.c; None: NumPy
    run_pass: Callable[..., None] | None = None
    run_histories: Callable[..., None] | None = None
    variant: int = 0
    limits: Limits = Limits()
    structures: Mapping[str, np.dtype[Any]] = MappingProxyType({})

    def structure(self, name: str) -> np.dtype[Any]:
        """Return a structure of layout.h; without a kernel an empty one."""
        return self.structures.get(name, np.dtype([]))

    def packer(self, name: str, skip: int = 0) -> struct.Struct:
        """Return what packs the numbers of a structure without its first fields."""
        fields = [dtype for dtype, *_ in (self.structure(name).fields or {}).values()]
        return struct.Struct("=" + "".join(map(_code, fields[skip:])))


def _code(dtype: np.dtype[Any]) -> str:
    return f"{dtype.itemsize // dtype.base.itemsize}{CODES[dtype.base.str[1:]]}"


def _structures(layout: Mapping[str, tuple[int, list[tuple[str, str, int, int]]]]) -> dict[str, np.dtype[Any]]:
    """Return the structures of the module; none if it has other fields than Python writes, or gaps between them."""
    known: dict[str, np.dtype[Any]] = {}
    for name, (size, fields) in layout.items():
        formats = [(field, known.get(kind, np.dtype(TYPES.get(kind))), count) for field, kind, _, count in fields]
        dtype = known[name] = np.dtype([one[: 2 + (one[2] > 1)] for one in formats])
        offsets = [at for _, at, *_ in (dtype.fields or {}).values()]
        if offsets != [at for _, _, at, _ in fields] or dtype.itemsize != size:
            return {}
    return known if {name: " ".join(dtype.names or ()) for name, dtype in known.items()} == FIELDS else {}


def _choose() -> Kernel:
    """Return the best variant that this machine runs and the environment allows."""
    wanted = os.environ.get("USBLDR_KERNEL", "")
    if wanted == "numpy":
        return Kernel("numpy", "USBLDR_KERNEL=numpy")
    try:
        from usbldr.filters.kernel import _kernel
    except ImportError:
        return Kernel("numpy", "the kernel is not there: usbldr was installed without a C compiler")
    structures = _structures(getattr(_kernel, "LAYOUT", {})) if getattr(_kernel, "CALLS", 0) == CALLS else {}
    if not structures:
        return Kernel("numpy", "the kernel was compiled from another version: install usbldr again")
    for name, variant in _kernel.VARIANTS:
        if wanted in ("", name):
            functions = _kernel.advance, _kernel.run_pass, _kernel.run_histories
            return Kernel(name, "", *functions, variant, Limits(*_kernel.LIMITS), structures)
    names = ", ".join(name for name, _ in _kernel.VARIANTS)
    return Kernel("numpy", f"USBLDR_KERNEL={wanted} is none of the variants for this machine: {names}, numpy")


KERNEL = _choose()
"""The kernel of this process."""
