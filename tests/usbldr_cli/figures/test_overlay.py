"""Overlays: filters are drawn alike, and those that hide each other are named."""

import numpy as np

from usbldr_cli.figures.overlay import coincident_text
from usbldr_cli.runs.job_store import Trace
from usbldr_cli.runs.seed_table import ComparisonRow

TIME_S = np.arange(200.0)
TRUTH_M = np.column_stack([TIME_S, np.zeros(200)])
ERROR_M = np.column_stack([np.zeros(200), np.sin(TIME_S)])


def drawn(name: str, error_m: np.ndarray) -> tuple[ComparisonRow, Trace]:
    return ComparisonRow("dive", name, name, (0,), ()), Trace(TIME_S, TRUTH_M + error_m, TRUTH_M)


def test_tracks_closer_than_a_line_is_wide_are_said_to_coincide() -> None:
    apart_m = np.where(TIME_S[:, None] < 5, 1.0, 0.0)  # for 2 % of the time
    traces = [
        drawn("ekf", 0.9 * ERROR_M),
        drawn("adf", ERROR_M),
        drawn("cpf", 1.005 * ERROR_M + apart_m),
        drawn("dr", ERROR_M),
    ]

    assert coincident_text(traces) == "; adf, cpf coincide (95 % of the time)"  # dr is no filter
    assert coincident_text(traces[:2]) == ""
