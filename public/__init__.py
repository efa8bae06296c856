"""Replay logs of underwater vehicles through navigation filters, and compute the errors against the truth.

Every name of ``__all__`` is described in docs/api.md, with types, units and frames. Importing this package is fast:
each name is imported when it is first used.
"""

from usbldr import filters, io

__version__ = "0.3.0"
__all__ = ["__version__", *filters.__all__, *io.__all__]  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> object:
    for package in (filters, io):
        if name in package.__all__:
            return getattr(package, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
