"""Names and rows of the states: the only place that defines indices.

The order is the paper's eq. (2) with psi first, so that only the first column of a Cholesky root changes psi.
"""

from dataclasses import dataclass

from usbldr.filters.types import Array

MOTION_STATES = ("psi", "u", "v", "r", "x", "y")


@dataclass(frozen=True, slots=True)
class StateLayout:
    """Names of the n states: psi (rad), u, v (m/s), r (rad/s), x, y (m), then those of calibration.STATES."""

    names: tuple[str, ...] = MOTION_STATES

    def __len__(self) -> int:
        return len(self.names)

    def index(self, name: str) -> int:
        """Return the row of a state; raise ValueError if the layout lacks it."""
        return self.names.index(name)

    def rows(self, *names: str) -> tuple[int, ...]:
        """Return the rows of several states."""
        return tuple(self.names.index(name) for name in names)

    def existing(self, *names: str) -> tuple[int, ...]:
        """Return the rows of those states that exist."""
        return tuple(self.names.index(name) for name in names if name in self.names)

    def value(self, x: Array, name: str) -> Array | float:
        """Return one state of x, (n, ...), or 0 if the layout has no such state."""
        return x[self.names.index(name)] if name in self.names else 0.0


POSITION = list(StateLayout().rows("x", "y"))  # in every layout
YAW = StateLayout().index("psi")
