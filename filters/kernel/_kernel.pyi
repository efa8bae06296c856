from numpy import float64
from numpy.typing import NDArray

VARIANTS: list[tuple[str, int]]
SIZES: tuple[int, int, int]

def advance(
    variant: int,
    settings: bytes,
    past: int,
    count: int,
    steps: bytes,
    readings: bytes,
    state: NDArray[float64],
    estimates: NDArray[float64],
    records: NDArray[float64],
    /,
) -> int: ...
