"""Series at other times and angles without turns: numpy's own functions on whole arrays are the oracle."""

import numpy as np
import pytest

from usbldr.io.conventions.time_series import bracketing, unwrap
from usbldr.io.messages import layouts


def test_the_records_beside_the_wanted_times_give_what_all_records_give() -> None:
    rng = np.random.default_rng(5)
    known, values = np.sort(rng.uniform(0, 100, 5000)), rng.normal(size=5000)
    wanted = np.concatenate([rng.uniform(-5, 105, 60), known[[0, 17, -1]]])

    near = bracketing(known, wanted)

    assert len(near) <= 2 * len(wanted)
    np.testing.assert_array_equal(np.interp(wanted, known[near], values[near]), np.interp(wanted, known, values))


@pytest.mark.parametrize("length", [1, 2, 7, 1000, 5000])
@pytest.mark.parametrize("turn", [360.0, 2 * np.pi])
def test_angles_run_on_in_blocks_of_any_length(length: int, turn: float, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(layouts, "BLOCK_RECORDS", length)
    rng = np.random.default_rng(2)
    angle = np.mod(np.cumsum(rng.uniform(-0.7, 0.9, 3000) * turn), turn)
    angle[5:8] = [0.0, turn / 2, 0.0]  # half a turn goes on the way that numpy chooses

    assert len(unwrap(np.empty(0), turn)) == 0
    np.testing.assert_array_equal(unwrap(angle.copy(), turn), np.unwrap(angle, period=turn))
