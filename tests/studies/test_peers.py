"""The comparison with other libraries: that peers solve the same problem, and that the table goes where it belongs."""

from pathlib import Path

import numpy as np
import pytest

from speed import peers_table
from speed.kalman_peers import filterpy_ekf, jacobian
from speed.peers import dive, moved
from usbldr.filters.replay.methods import FilterSettings
from usbldr.filters.replay.run import run


def test_the_ekf_of_filterpy_gives_the_track_of_ours() -> None:
    work = dive(60.0)

    ours = run("ekf", work.line, work.log.parameters, FilterSettings(guard=False)).position_m

    assert np.abs(filterpy_ekf(work, moved) - ours).max() < 1e-6


def test_the_jacobian_is_that_of_the_motion() -> None:
    state, dt_s, step = np.array([0.3, 1.0, 0.2, 0.1, 3.0, 4.0]), 0.2, 1e-6
    columns = [(moved(state + step * d, dt_s) - moved(state - step * d, dt_s)) / (2 * step) for d in np.eye(6)]

    np.testing.assert_allclose(jacobian(state, dt_s), np.stack(columns, axis=1), atol=1e-8)


def test_the_table_replaces_what_stands_between_the_markers(tmp_path: Path) -> None:
    page = tmp_path / "README.md"
    page.write_text(f"before\n{peers_table.BEGIN}\nold\n{peers_table.END}\nafter\n")

    peers_table.write(page, "| new |")
    assert page.read_text() == f"before\n{peers_table.BEGIN}\n\n| new |\n\n{peers_table.END}\nafter\n"

    page.write_text("no markers\n")
    with pytest.raises(SystemExit, match="has no markers"):
        peers_table.write(page, "| new |")
