from numpy import float64, int64
from numpy.typing import NDArray

VARIANTS: list[tuple[str, int]]
CALLS: int
LAYOUT: dict[str, tuple[int, list[tuple[str, str, int, int]]]]
LIMITS: tuple[int, int, int, int, int, int]

def advance(
    variant: int,
    settings: bytes,
    past: int,
    count: int,
    steps: bytes | memoryview,
    readings: bytes | memoryview,
    log_relocation: NDArray[float64] | None,
    outlier_m2: float,
    state: NDArray[float64],
    estimates: NDArray[float64],
    records: NDArray[float64],
    /,
) -> int: ...
def run_pass(
    variant: int,
    settings: bytes,
    mean: NDArray[float64],
    cov: NDArray[float64],
    log_likelihood: NDArray[float64],
    residual: NDArray[float64],
    measurement_matrix: NDArray[float64],
    changes: NDArray[float64],
    group: NDArray[int64],
    probability: NDArray[float64],
    gain: NDArray[float64],
    offset: NDArray[float64],
    cov_m2: NDArray[float64],
    counted: NDArray[float64],
    switching: NDArray[float64],
    /,
) -> None: ...
def run_histories(
    variant: int,
    settings: bytes,
    residual: NDArray[float64],
    measurement_matrix: NDArray[float64],
    changes: NDArray[float64],
    probability: NDArray[float64],
    cov_m2: NDArray[float64],
    mean: NDArray[float64],
    cov: NDArray[float64],
    kinds: NDArray[float64],
    log_weight: NDArray[float64],
    first: NDArray[int64],
    parent: NDArray[int64],
    decision: NDArray[int64],
    gradual: NDArray[int64],
    count: NDArray[int64],
    /,
) -> None: ...
