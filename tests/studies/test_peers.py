"""The comparison with other libraries: that peers solve the same problem, and that the table goes where it belongs."""

import numpy as np

from speed.kalman_peers import filterpy_ekf
from speed.peers import dive, moved
from usbldr.filters.replay.methods import FilterSettings
from usbldr.filters.replay.run import run


def test_the_ekf_of_filterpy_gives_the_track_of_ours() -> None:
    work = dive(60.0)

    ours = run("ekf", work.line, work.log.parameters, FilterSettings(guard=False)).position_m

    assert np.abs(filterpy_ekf(work, moved) - ours).max() < 1e-6
