"""Replay logs of underwater vehicles through navigation filters, and take the errors against the truth.

The public face of the package: every name of ``__all__`` is described in docs/api.md, with types, units and frames.
Importing this package is cheap, because each name is imported when it is first used.
"""

from usbldr.filters.lazy_exports import lazy_exports

_HOMES: dict[str, str] = {}

__version__ = "0.1.0"
__all__ = list(_HOMES)  # pyright: ignore[reportUnsupportedDunderAll]
__getattr__ = lazy_exports(__name__, _HOMES)
