"""Updates as columns, against the updates themselves."""

import math
import weakref
from dataclasses import replace

import numpy as np
import pytest

from usbldr.filters.types import Update
from usbldr.filters.updates import CHUNK, UpdateTable, UpdateTableBuilder


def part(sensor: str, axis: str, row: int, e: float, outcome: str = "used", shift: tuple[float, ...] | None = None):
    return Update(sensor, axis, row, row / 5, (e,), (1.0,), e**2, 1, outcome, 0.9 - e / 100, shift, (), (0.5,), (e,))


SCALAR = part("dvl", "forward", 3, 0.25, "down-weighted")
JOINT = Update(
    "usbl", "position", 0, 0.7, (30.0, -4.0), (1.0, 2.0), 9.0, 2, "rejected", 0.01, (1.0, 2.0, 3.0), (), (1.0, 1.0)
)
IN_PARTS = Update.combined(
    [
        part("usbl", "east", 1, 1.5, "used", (0.1, 0.2, 0.3)),
        part("usbl", "north", 1, -2.0, "down-weighted", (0.4, 0.5, 0.6)),
    ]
)
UPDATES = (SCALAR, JOINT, part("compass", "yaw", 4, 0.1), IN_PARTS, SCALAR)


def test_a_table_gives_back_every_update() -> None:
    table = UpdateTable.of(UPDATES)

    assert tuple(table) == UPDATES
    assert (table[3], table[-1], table[1:3]) == (IN_PARTS, SCALAR, (JOINT, UPDATES[2]))
    assert table == UPDATES
    assert table != UPDATES[:-1]


def test_a_table_of_many_is_one_of_few_after_another() -> None:
    count = CHUNK // len(UPDATES) * 2 + 3
    builder = UpdateTableBuilder()
    for _ in range(count):
        builder.add(UPDATES)

    table = builder.table()

    assert len(table) == count * len(UPDATES)
    for k in (0, 1, count // 2, count - 1):
        assert table[k * len(UPDATES) : (k + 1) * len(UPDATES)] == UPDATES


def test_columns_are_the_fields_of_the_updates_of_a_sensor() -> None:
    fixes = UpdateTable.of(UPDATES).of_sensor("usbl")

    mine = (JOINT, IN_PARTS)
    assert tuple(fixes) == mine
    assert (fixes.axis.tolist(), fixes.dof.tolist()) == (["position", "position"], [2, 2])
    for name in ("outcome", "row", "time_s", "nis", "nominal_probability"):
        assert getattr(fixes, name).tolist() == [getattr(update, name) for update in mine], name
    assert fixes.vectors("innovation").tolist() == [list(update.innovation) for update in mine]
    for state in range(3):
        assert fixes.shift(state).tolist() == [update.shift[state] for update in mine if update.shift is not None]


def test_what_an_update_lacks_is_nan() -> None:
    table = UpdateTable.of((SCALAR, JOINT))

    assert math.isnan(table.shift(0)[0])
    np.testing.assert_array_equal(table.vectors("scores"), [[0.25, np.nan], [np.nan, np.nan]])
    np.testing.assert_array_equal(table.vectors("innovation"), [[0.25, np.nan], [30.0, -4.0]])


@pytest.mark.parametrize("updates", [(), (SCALAR,)])
def test_a_sensor_without_updates_has_empty_columns(updates: tuple[Update, ...]) -> None:
    fixes = UpdateTable.of(updates).of_sensor("usbl")

    assert len(fixes) == 0
    for column in (fixes.outcome, fixes.nis, fixes.row, fixes.shift(4), fixes.vectors("scores")):
        assert len(column) == 0


def test_a_table_keeps_nothing_of_the_arrays_that_its_columns_were_part_of() -> None:
    one = UpdateTable.of(UPDATES)
    records = np.zeros((len(one.parts.row), 100))
    record = weakref.ref(records)
    builder = UpdateTableBuilder()

    builder.add(UpdateTable(replace(one.parts, nis=records[:, 3]), one.first, one.names, one.shifts))
    del records

    assert record() is None
    assert builder.table().nis.tolist() == [0.0] * len(UPDATES)
