"""Order, repeats and zero stamps: what becomes of records that share a moment."""

from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pytest

from logs import codes, logged, logged_nmea
from recordings import SECOND, T0, Row, fix, point, sentence, twist, yaw
from usbldr.filters.errors import LogError


def test_late_fixes_are_sorted_by_stamp_and_keep_their_arrival(tmp_path: Path) -> None:
    rows = [point(T0, 0, 0, delay_s=2.0), point(T0 + SECOND, 1, 0, delay_s=0.1), point(T0 + 3 * SECOND, 3, 0)]

    log = logged(tmp_path, rows)
    table = log.tables["usbl"]

    assert list(table["east_m"]) == [0, 1, 3]
    np.testing.assert_allclose(table["time_s"], [0, 1, 3])
    np.testing.assert_allclose(table["received_s"], [2, 1.1, 3])
    assert codes(log) == {
        "OUT-OF-ORDER": "/usbl: 1 of 3 records are stamped earlier than the previous one "
        "(fixes arrive late; sorted by stamp, arrival kept)"
    }


@pytest.mark.parametrize(
    ("rows", "columns", "code", "said"),
    [
        ([row for k in range(5) for row in [twist(T0 + k, 1.0 + k, 0.0)] * 2], {"forward_mps": [1, 2, 3, 4, 5]},
         "REPEATED", "/dvl: 5 of 10 records repeat another's stamp and values and are left out"),
        ([twist(T0, 1.0, 0.2), twist(T0, 2.0, 0.4), twist(T0 + SECOND, 5.0, 0.0)],
         {"forward_mps": [1.5, 5.0], "starboard_mps": [-0.3, 0.0]}, "SAME-STAMP",
         "/dvl: 1 of 3 records have another's stamp and other values; records of one stamp are averaged"),
        # an invalid record of the DVL spoils no average
        ([twist(T0, 1.0, 0.0), twist(T0, 300.0, 0.0)], {"forward_mps": [1.0], "valid": [True]}, "SAME-STAMP",
         "/dvl: 1 of 2 records have another's stamp and other values; records of one stamp are averaged"),
        # headings are averaged as directions
        ([yaw(T0, 90 - 359), yaw(T0, 90 - 3), yaw(T0 + SECOND, 0)], {"heading_deg": [1.0, 90.0]}, "SAME-STAMP",
         "/imu: 1 of 3 records have another's stamp and other values; records of one stamp are averaged"),
        ([point(T0, 1.0, 0.0), point(T0, 2.0, 0.0), point(T0, 2.0, 0.0)], {"east_m": [1.0, 2.0]}, "SAME-STAMP",
         "/usbl: 1 of 2 records have another's stamp and other values; all are kept"),
    ],
)  # fmt: skip
def test_records_of_one_stamp_are_one_or_averaged_or_as_fixes_all_kept(tmp_path, rows, columns, code, said):
    log = logged(tmp_path, rows)

    ((_, table),) = log.tables.items()
    for name, values in columns.items():
        assert table[name].tolist() == pytest.approx(values)
    assert codes(log).get(code, "") == said


@pytest.mark.parametrize(
    ("step_s", "shared", "times"),
    [(10, 72, "its times have steps of 10 s or more"), (1000, 79, "all its times are the same")],
)
def test_times_of_too_few_digits_are_named_by_their_step(tmp_path: Path, step_s: int, shared: int, times: str) -> None:
    log = logged(tmp_path, [point(T0 + k // step_s * step_s * SECOND, k, 0) for k in range(80)])

    (found,) = (finding for finding in log.findings if finding.code == "COARSE-TIMES")
    assert found.text == (
        f"/usbl: {shared} of 80 records have another's stamp and other values; all are kept; {times}: export them with "
        "more digits"
    )
    assert found.level == "warning"
    assert "SAME-STAMP" not in codes(log)


def of_two(kind: str, apart: float) -> list[Row]:
    """Twenty seconds of two devices at one stamp each second, by turns first; both move by 1 a second."""
    rows: list[Row] = []
    for k in range(20):
        t, pair = T0 + k * SECOND, [0.0, apart][:: 1 - 2 * (k % 2)]
        if kind == "compass":
            rows += [yaw(t, 179.0 + k + more) for more in pair]
        else:
            rows += [fix(t, 60 + (k + more) / 111.4e3, 7, topic=f"/{kind}/fix") for more in pair]
    return rows


@pytest.mark.parametrize("kind", ["gps", "compass"])
def test_two_devices_of_one_name_are_not_averaged(tmp_path: Path, kind: str) -> None:
    with pytest.raises(LogError, match=rf"20 of 40 records .* 40 (m|deg) away.* several devices .* --{kind} none$"):
        logged(tmp_path, of_two(kind, 40.0))
    assert "COARSE-TIMES" in codes(logged(tmp_path, of_two(kind, 2.0)))


@pytest.mark.parametrize("between_ms", [100, 500])
@pytest.mark.parametrize("kind", ["gps", "compass"])
def test_two_devices_of_one_name_that_take_turns_are_named(tmp_path: Path, kind: str, between_ms: int) -> None:
    """The vehicle turns by 1 degree a second, or goes as many metres."""
    pair = [(T0 + k * SECOND, T0 + k * SECOND + between_ms * 10**6) for k in range(30)]

    def rows(apart: float) -> list[Row]:
        values = [(t, (t - T0) / SECOND + apart * j) for both in pair for j, t in enumerate(both)]
        if kind == "compass":
            return [yaw(t, 179.0 + value) for t, value in values]
        return [fix(t, 60 + value / 111.4e3, 7, topic="/gps/fix") for t, value in values]

    with pytest.raises(
        LogError, match=rf"are [34]\d(.\d)? (m|deg) from the next, .* several devices .* --{kind} none$"
    ):
        logged(tmp_path, rows(40.0))
    assert len(logged(tmp_path, rows(2.0)).tables[kind]) == 60


def test_fixes_of_two_transponders_at_one_time_are_named(tmp_path: Path) -> None:
    log = logged(tmp_path, [*of_two("usbl", 40.0)])

    assert "20 of 40 records have another's stamp, 40 m away" in codes(log)["COARSE-TIMES"]
    assert len(log.tables["usbl"]) == 40


@pytest.mark.parametrize(("step_s", "refused"), [(2, False), (60, True)])
def test_a_dvl_with_times_of_whole_minutes_is_refused(tmp_path: Path, step_s: int, refused: bool) -> None:
    rows = [twist(T0 + k // step_s * step_s * SECOND, 1.0 + 0.001 * k, 0.0) for k in range(300)]

    with (
        pytest.raises(LogError, match=r": /dvl: 295 of 300 .* steps of 60 s or more: export")
        if refused
        else nullcontext()
    ):
        logged(tmp_path, rows)


def test_zero_stamps_are_timed_by_log_time_and_counted(tmp_path: Path) -> None:
    time_ns, topic, kind, values = twist(T0 + SECOND, 1.0, 0.0)

    log = logged(tmp_path, [twist(T0, 1.0, 0.0), (time_ns, topic, kind, {**values, "header.stamp": 0})])

    np.testing.assert_allclose(log.tables["dvl"]["time_s"], [0, 1])
    assert codes(log)["ZERO-STAMP"] == "/dvl: 1 of 2 header stamps are zero; those records are timed by log time"


def test_midnight_of_a_log_without_dates_is_a_stamp(tmp_path: Path) -> None:
    lines = [f"GPGGA,00000{k}.00,4500.000,N,00700.000,E,1,10,0.8,1.0,M,48.0,M,," for k in range(3)]

    log = logged_nmea(tmp_path, *map(sentence, lines))

    np.testing.assert_array_equal(log.tables["gps"]["time_s"], [0, 1, 2])
    assert "ZERO-STAMP" not in codes(log)


def test_time_zero_is_the_earliest_stamp_of_the_records_used(tmp_path: Path) -> None:
    rows = [twist(T0, 99.0, 0.0), twist(T0 + 2 * SECOND, 1.0, 0.0), yaw(T0 + 3 * SECOND, 0), yaw(T0 + SECOND, 0)]

    log = logged(tmp_path, rows)

    assert log.start_ns == T0 + SECOND  # the DVL record before is faster than any vehicle
    np.testing.assert_allclose(log.tables["dvl"]["time_s"], [-1, 1])
    np.testing.assert_allclose(log.tables["compass"]["time_s"], [0, 2])
