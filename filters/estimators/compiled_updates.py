"""What became of each reading in the compiled kernel: updates from its records (kernel/records.h), one row a part."""

from collections.abc import Sequence

import numpy as np

from usbldr.filters.estimators.encoded_columns import EncodedSteps
from usbldr.filters.estimators.encoding import FIXES, EncodedStep
from usbldr.filters.models.sensors import Measurement
from usbldr.filters.types import Array, Update
from usbldr.filters.updates import Parts, UpdateTable

RECORD = 9  # fixed: numbers of a record before the shift of each state, as in kernel/layout.h


def update_table(coded: EncodedSteps, parts: slice, records: Array) -> UpdateTable:
    """Return the updates of neighbouring parts from their records, see kernel/records.h."""
    scores, nominal, dof, shift = records[:, 6:8], records[:, 8].copy(), coded.dof[parts], records[:, RECORD:]
    nis = scores[:, 0] ** 2
    nis[dof == 2] += scores[dof == 2, 1] ** 2
    of_fix = coded.readings["fix"][parts] > 0
    columns = Parts(
        coded.sensor[parts],
        coded.axis[parts],
        (nominal < 0.5).astype(np.uint8),  # index into OUTCOMES
        coded.row[parts],
        coded.time_s[parts],
        nis,
        dof,
        nominal,
        records[:, 0:2].copy(),  # not the records themselves
        records[:, 2:4].copy(),
        records[:, 4:6].copy(),
        scores.copy(),
        np.where(of_fix, np.cumsum(of_fix) - 1, -1).astype(np.int32),
    )
    return UpdateTable(columns, np.flatnonzero(coded.is_first[parts]), coded.names, shift[of_fix])


def step_updates(step: EncodedStep, table: Sequence[Sequence[float]]) -> tuple[Update, ...]:
    """Return the updates of a step from the records of its parts."""
    updates: list[Update] = []
    part = 0
    for count in step.counts:
        of_one = [_update(step.parts[part + i], table[part + i]) for i in range(count)]
        updates.append(of_one[0] if count == 1 else Update.combined(of_one))
        part += count
    return tuple(updates)


def _update(part: Measurement, row: Sequence[float]) -> Update:
    """Return the update of a measurement from its record: see kernel/records.h."""
    k = len(part.z)
    scores, nominal = tuple(row[6 : 6 + k]), row[8]
    return Update(
        part.sensor,
        part.axis,
        part.row,
        part.time_s,
        tuple(row[:k]),
        tuple(row[2 : 2 + k]),
        sum([score * score for score in scores]),
        k,
        "used" if nominal >= 0.5 else "down-weighted",
        nominal,
        tuple(row[RECORD:]) if part.sensor in FIXES else None,
        (),
        tuple(row[4 : 4 + k]),
        scores,
    )
