"""The timeline against what each record's own stamp says."""

import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from numpy.typing import ArrayLike, NDArray

from usbldr.filters.errors import LogError, UsageError
from usbldr.filters.models.parameters import Parameters
from usbldr.filters.types import Outage
from usbldr.io.log import Log
from usbldr.io.messages import layouts
from usbldr.io.reading.epochs import timeline

NAN = float("nan")


def dvl_table(
    time_s: ArrayLike, starboard: ArrayLike = 0.0, forward: ArrayLike = 1.0, **columns: object
) -> pd.DataFrame:
    t = np.asarray(time_s, dtype=float)
    full = {"time_s": t, "received_s": t, "starboard_mps": starboard, "forward_mps": forward}
    return pd.DataFrame(full | {"up_mps": 0.0, "sd_mps": 0.02, "valid": True} | columns)


def compass_table(time_s: ArrayLike, heading_deg: ArrayLike = 0.0, **columns: object) -> pd.DataFrame:
    t = np.asarray(time_s, dtype=float)
    return pd.DataFrame({"time_s": t, "received_s": t, "heading_deg": heading_deg, "sd_deg": 0.1} | columns)


def usbl_table(time_s: ArrayLike, east: ArrayLike = 0.0, north: ArrayLike = 0.0, **columns: object) -> pd.DataFrame:
    t = np.asarray(time_s, dtype=float)
    full = {"time_s": t, "received_s": t, "east_m": east, "north_m": north}
    return pd.DataFrame(full | {"cov_ee_m2": 1.0, "cov_en_m2": 0.25, "cov_nn_m2": 2.0} | columns)


def log(**tables: pd.DataFrame) -> Log:
    return Log(Path("dive.mcap"), "", "MCAP", 10**18, tables, {}, Parameters())


def grid(seconds: float, rate_hz: float = 5.0) -> NDArray[np.float64]:
    return np.arange(round(seconds * rate_hz) + 1) / rate_hz


def test_each_record_is_used_once_in_the_epoch_of_its_own_interval() -> None:
    rng = np.random.default_rng(0)
    for rate_hz in (0.7, 1.5, 5.0, 9.999, 37.0):
        t = np.sort(rng.uniform(0, 100, size=round(100 * rate_hz)))
        line = timeline(log(dvl=dvl_table(t, starboard=t, forward=-t), compass=compass_table(grid(100))))

        assert line.dvl_count.sum() == len(t)
        for k in range(len(line.time_s)):
            own = t[(t >= line.time_s[k] - 0.1) & (t < line.time_s[k] + 0.1)]
            assert line.dvl_count[k] == len(own)
            if len(own):
                np.testing.assert_allclose(line.dvl_mps[k], [own.mean(), -own.mean()])
            else:
                assert np.isnan(line.dvl_mps[k]).all()


def test_a_log_that_is_almost_all_one_gap_is_refused() -> None:
    days_s = 86400.0 * np.array([0.0, 29.0])
    t = np.concatenate([grid(600) + day_s for day_s in days_s])
    with pytest.raises(LogError, match=r"no sensor has a record for 29\.0 days after 2001-09-09T01:56:40"):
        timeline(log(dvl=dvl_table(t), compass=compass_table(t)))

    t = np.append(grid(3 * 3600, 1.0), 2 * 86400.0)  # 45 hours, 15 times the rest
    assert timeline(log(dvl=dvl_table(t), compass=compass_table(t)), 1.0).time_s[-1] == t[-1]


def test_a_record_on_the_border_belongs_to_the_later_epoch() -> None:
    line = timeline(log(dvl=dvl_table([0.0, 0.1, 0.3, 0.5]), compass=compass_table(grid(1))))

    assert line.dvl_count.tolist() == [1, 1, 1, 1, 0, 0]


def test_dead_reckoning_interpolates_across_short_gaps_only() -> None:
    t = np.array([0.0, 2.0, 5.0, 9.0, 10.0])
    line = timeline(log(dvl=dvl_table(t, forward=[1.0, 3.0, 6.0, 0.0, 5.0]), compass=compass_table(grid(10))))

    at = {round(float(s), 1): float(v) for s, v in zip(line.time_s, line.dr_mps[:, 1], strict=True)}
    assert [at[1.0], at[2.0], at[4.0], at[5.0]] == pytest.approx([2.0, 3.0, 5.0, 6.0])  # gaps of 2 s and 3 s: lines
    assert [at[5.2], at[7.0], at[8.0]] == [6.0, 6.0, 6.0]  # 4 s: the last one, which is held for 3 s
    assert at[9.4] == pytest.approx(2.0)
    assert [outage for outage in line.outages if outage.sensor == "dvl"] == [Outage("dvl", 5.0, 9.0)]
    assert line.dvl_count.sum() == 5


def test_before_the_first_record_the_first_is_held_and_after_the_last_the_last_for_three_seconds() -> None:
    line = timeline(log(dvl=dvl_table([4.0, 5.0], forward=[2.0, 3.0]), compass=compass_table(grid(12))))

    assert line.dr_mps[0].tolist() == [0.0, 2.0]
    assert line.dr_mps[40].tolist() == [0.0, 3.0]
    assert [o for o in line.outages if o.sensor == "dvl"] == [Outage("dvl", 0.0, 4.0), Outage("dvl", 5.0, 12.0)]


def test_in_a_long_gap_dead_reckoning_returns_to_the_mean_of_the_records_before_it() -> None:
    t = np.concatenate([grid(99.8), grid(100, 1) + 900])
    forward = np.where(t < 500, np.where(np.arange(len(t)) % 2, 1.3, 0.7), 5.0)
    line = timeline(log(dvl=dvl_table(t, forward=forward), compass=compass_table(grid(1000))))

    inside = line.dr_mps[(line.time_s > 99.8) & (line.time_s < 900), 1]
    assert inside[0] == 1.3
    assert (np.diff(inside) <= 0).all()
    assert inside[-1] == pytest.approx(1.0, abs=1e-3)
    assert line.dr_mps[-1, 1] == 5.0


def test_invalid_records_are_neither_measured_nor_interpolated() -> None:
    valid = np.array([True, False, True, True])
    dvl = dvl_table([0.0, 1.0, 2.0, 3.0], forward=[1.0, 327.67, 1.0, NAN], valid=valid)

    line = timeline(log(dvl=dvl, compass=compass_table(grid(3))))

    assert line.dvl_count.sum() == 2
    np.testing.assert_allclose(line.dr_mps[:, 1], 1.0)


def test_the_order_of_the_records_in_the_file_does_not_matter() -> None:
    rng = np.random.default_rng(1)
    t = np.sort(rng.uniform(0, 50, size=300))
    compass = compass_table(t, heading_deg=rng.normal(0, 20, size=300) % 360)
    tables = {"dvl": dvl_table(t, starboard=rng.normal(size=300)), "compass": compass}
    tables["usbl"] = usbl_table(t, east=rng.normal(size=300))
    sorted_line = timeline(log(**tables))

    shuffled = timeline(log(**{name: table.sample(frac=1, random_state=3) for name, table in tables.items()}))

    for name in ("dvl_mps", "yaw_rad", "dr_mps", "dr_yaw_rad", "fix_time_s", "fix_m"):
        np.testing.assert_array_equal(getattr(shuffled, name), getattr(sorted_line, name))


@pytest.mark.parametrize("turn_dps", [0.0, 3.0])
def test_dead_reckoning_follows_noisy_headings_as_a_steady_kalman_filter_does(turn_dps: float) -> None:
    """Of a turn rate that is a random walk q with noise of density R it has the variance √2 ω R, ω⁴ = q² / R."""
    t, sd_deg = grid(4000), 20.0
    noisy = turn_dps * t + np.random.default_rng(4).normal(0, sd_deg, len(t))

    line = timeline(log(dvl=dvl_table(t), compass=compass_table(t, noisy % 360, sd_deg=sd_deg)))
    off_deg = (np.degrees(-line.dr_yaw_rad) - turn_dps * t + 180) % 360 - 180

    density = math.radians(sd_deg) ** 2 / 5
    omega = (Parameters().process.turn_rate_radps ** 2 / density) ** 0.25
    # the filter also has the motion that it allows for; of the noise alone it leaves three quarters of that variance
    assert off_deg[100:].std() == pytest.approx(math.degrees(math.sqrt(0.75 * math.sqrt(2) * omega * density)), rel=0.1)
    assert abs(off_deg[100:].mean()) < 0.5


def test_dead_reckoning_takes_good_headings_as_they_are_and_follows_only_where_they_are_noisy() -> None:
    t = grid(200)
    heading = 20 + np.random.default_rng(4).normal(0, 1, len(t))
    good = timeline(log(dvl=dvl_table(t), compass=compass_table(t, heading, sd_deg=1.0)))
    part = timeline(log(dvl=dvl_table(t), compass=compass_table(t, heading, sd_deg=np.where(t < 100, 1.0, 30.0))))

    np.testing.assert_array_equal(good.dr_yaw_rad, good.yaw_rad)
    np.testing.assert_array_equal(part.dr_yaw_rad[t < 100], good.yaw_rad[t < 100])
    assert part.dr_yaw_rad[t > 100].std() < good.yaw_rad[t > 100].std() / 2


def test_headings_are_averaged_across_north_and_unwrapped_over_the_whole_log() -> None:
    line = timeline(log(dvl=dvl_table([0.0]), compass=compass_table([0.0, 0.05], heading_deg=[359.0, 1.0])))

    np.testing.assert_allclose(line.yaw_rad, [0.0], atol=1e-12)
    assert line.yaw_count.tolist() == [2]

    t = grid(100, 10.0)
    heading = 30.0 * t  # 8.3 turns clockwise

    line = timeline(log(dvl=dvl_table(grid(100)), compass=compass_table(t, heading_deg=heading % 360)))

    np.testing.assert_allclose(line.dr_yaw_rad, np.radians(-30.0 * line.time_s), atol=1e-9)


def test_several_records_of_an_epoch_are_averaged_and_counted() -> None:
    dvl = dvl_table([0.95, 1.0, 1.05, 2.0], forward=[1.0, 2.0, 6.0, 4.0], sd_mps=[0.1, 0.2, 0.2, 0.3])

    line = timeline(log(dvl=dvl, compass=compass_table(grid(2))))

    assert line.dvl_count[[5, 10]].tolist() == [3, 1]
    assert line.dvl_mps[5, 1] == pytest.approx(3.0)
    assert line.dvl_sd_mps[5] == pytest.approx(math.sqrt(0.09 / 3))  # of one record, not of the mean


def test_records_with_one_stamp_are_one_record() -> None:
    dvl = dvl_table([0.0, 0.0, 1.0, 1.0], forward=[1.0, 1.0, 2.0, 4.0])
    usbl = usbl_table([0.5, 0.5, 0.7, 0.7], east=[1.0, 1.0, 2.0, 3.0], received_s=[2.0, 1.5, 0.7, 0.7])

    line = timeline(log(dvl=dvl, compass=compass_table(grid(1)), usbl=usbl))

    assert line.dvl_count[[0, 5]].tolist() == [1, 1]
    assert line.dvl_mps[5, 1] == 3.0
    assert line.fix_m[:, 0].tolist() == [1.0, 2.0, 3.0]  # fixes with other values are all kept
    assert line.fix_received_s.tolist() == [1.5, 0.7, 0.7]


def test_a_fix_keeps_its_own_time_and_its_covariance_and_there_is_an_epoch_after_it() -> None:
    usbl = usbl_table([0.33, 10.01], east=[1.0, 2.0], received_s=[NAN, 9.0])

    line = timeline(log(dvl=dvl_table(grid(8)), compass=compass_table(grid(8)), usbl=usbl))

    assert line.fix_time_s.tolist() == [0.33, 10.01]
    assert line.fix_received_s.tolist() == [0.33, 10.01]  # never before it was true
    assert line.fix_cov_m2[0].tolist() == [[1.0, 0.25], [0.25, 2.0]]
    assert line.time_s[-1] == 10.2


def test_records_from_before_time_0_belong_to_no_epoch() -> None:
    t = grid(2) - 0.5

    line = timeline(log(dvl=dvl_table(t), compass=compass_table(grid(2)), usbl=usbl_table([-0.7, 1.0])))

    assert line.time_s[0] == 0.0
    assert line.dvl_count.sum() == np.sum(t >= -0.1)
    assert line.fix_time_s.tolist() == [-0.7, 1.0]


def test_a_usbl_outage_is_measured_by_the_sensors_own_rate() -> None:
    t = np.arange(0, 600, 20.0)  # every 20 s by design
    present = t[(t < 200) | (t > 340)]
    vehicle = {"dvl": dvl_table(grid(600)), "compass": compass_table(grid(600))}

    slow = timeline(log(**vehicle, usbl=usbl_table(present)))
    quick = timeline(log(**vehicle, usbl=usbl_table(np.concatenate([grid(100, 1), 112.0 + grid(488, 1)]))))
    none = timeline(log(**vehicle))

    assert slow.outages == (Outage("usbl", 180.0, 360.0),)
    assert quick.outages == (Outage("usbl", 100.0, 112.0),)
    assert none.outages == (Outage("usbl", 0.0, 600.0),)


@pytest.mark.parametrize("length", [1, 2, 3, 100])
def test_outages_are_found_in_blocks_of_any_length(length: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(layouts, "BLOCK_RECORDS", length)
    times = [6.0, 7.0, 8.0, 15.0, 16.0, 30.0, 31.0, 32.0]

    made = timeline(log(dvl=dvl_table(times), compass=compass_table(np.arange(41))))

    found = [(outage.start_s, outage.end_s) for outage in made.outages if outage.sensor == "dvl"]
    assert found == [(0.0, 6.0), (8.0, 15.0), (16.0, 30.0), (32.0, 40.0)]


def test_errors_are_taken_on_the_slow_grid() -> None:
    tables = {"dvl": dvl_table(grid(10.4)), "compass": compass_table(grid(10.4))}

    assert timeline(log(**tables)).slow.tolist() == list(range(0, 53, 5))
    halves = timeline(log(**tables), fast_hz=10.0, slow_hz=0.5)
    np.testing.assert_allclose(halves.time_s[halves.slow], [0, 2, 4, 6, 8, 10])


@pytest.mark.parametrize(("fast_hz", "slow_hz"), [(5.0, 2.0), (1.0, 5.0), (0.0, 1.0), (5.0, -1.0), (5.0, NAN)])
def test_rates_that_do_not_fit_are_refused(fast_hz: float, slow_hz: float) -> None:
    with pytest.raises(UsageError, match=r"rate"):
        timeline(log(dvl=dvl_table([0.0]), compass=compass_table([0.0])), fast_hz, slow_hz)


def test_an_unknown_sigma_is_estimated_from_the_native_records_and_none_is_zero() -> None:
    rng = np.random.default_rng(0)
    t = grid(1000, 1.5)
    noise = rng.normal(0, 0.2, size=(2, len(t)))
    dvl = dvl_table(t, starboard=noise[0], forward=1 + noise[1], sd_mps=NAN)

    line = timeline(log(dvl=dvl, compass=compass_table(grid(1000))))

    np.testing.assert_allclose(line.dvl_sd_mps, 0.2, rtol=0.1)

    still = dvl_table(grid(10), sd_mps=NAN)

    line = timeline(log(dvl=still, compass=compass_table(grid(10), sd_deg=NAN)))

    assert line.dvl_sd_mps.min() == 1e-3
    np.testing.assert_allclose(line.yaw_sd_rad, math.radians(0.3))


def test_gps_keeps_its_native_times_and_loses_records_without_a_position() -> None:
    gps = pd.DataFrame({"time_s": [2.5, 1.5, -0.5], "east_m": [3.0, NAN, 1.0], "north_m": [4.0, 2.0, 2.0]})
    gps["sd_m"] = [0.7, 0.7, NAN]

    line = timeline(log(dvl=dvl_table([0.0]), compass=compass_table([0.0]), gps=gps))

    assert line.gps_time_s.tolist() == [-0.5, 2.5]
    assert line.gps_m.tolist() == [[1.0, 2.0], [3.0, 4.0]]
    assert line.gps_sd_m is not None
    np.testing.assert_array_equal(line.gps_sd_m, [NAN, 0.7])
    assert line.time_s.tolist() == [0.0]


def test_a_missing_sensor_measures_at_no_epoch() -> None:
    line = timeline(log(dvl=dvl_table([0.0, 0.2])))

    assert not line.yaw_count.any()
    assert np.isnan(line.yaw_rad).all()
    assert np.isnan(line.dr_yaw_rad).all()
    assert line.dvl_count.tolist() == [1, 1]


@pytest.mark.parametrize(
    ("tables", "sentence"),
    [
        ({}, r"^dive\.mcap: no dvl data \(sensors in this log: none\)"),
        ({"dvl": dvl_table([0.0, 1.0], valid=False), "compass": compass_table([0.0])}, "none of the 2 dvl records is"),
        ({"dvl": dvl_table([0.0, 1e9]), "compass": compass_table([0.0])}, "stamps span 11574 days"),  # in no memory
    ],
)
def test_a_log_of_no_epochs_or_of_too_many_is_refused(tables: Mapping[str, pd.DataFrame], sentence: str) -> None:
    with pytest.raises(LogError, match=sentence):
        timeline(log(**tables))
