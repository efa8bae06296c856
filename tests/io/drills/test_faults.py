"""Each fault changes what it says in the records that it says, and nothing else; as text it is said in one sentence."""

import dataclasses
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from logs import refusal, with_table
from recordings import saved
from usbldr.filters.errors import LogError, UsageError
from usbldr.filters.simulation.scenario import Leg
from usbldr.io.drills.drill import NAMED_BY, UNDAMAGED, Drill, damaged, is_named
from usbldr.io.drills.effects import EFFECTS
from usbldr.io.drills.fault_text import Fault, Span, fault_of
from usbldr.io.drills.kinds import KINDS, SENSORS
from usbldr.io.drills.suite import STANDARD, read_suite
from usbldr.io.log import Log
from usbldr.io.scenarios.shipped import find_scenario
from usbldr.io.scenarios.simulated_log import simulated_log

SCENARIO = dataclasses.replace(find_scenario("square"), duration_s=100.0)
LOG = simulated_log(SCENARIO, 0)
UNITS = {"": "2", "deg": "2deg", "m/s": "2m/s", "m": "2m", "Hz": "0.5Hz", "s": "2s"}


def with_faults(*texts: str, log: Log = LOG, seed: int = 0) -> Log:
    faults = tuple(fault_of(*text.split(" ", 1)) for text in texts)
    return damaged(log, Drill("drill", faults), seed)


def change(text: str, *columns: str) -> np.ndarray:
    """Return damaged minus undamaged values of the fault's sensor, (n, k)."""
    sensor = text.split()[1].split(":")[0].split("@")[0]
    before, after = LOG.tables[sensor], with_faults(text).tables[sensor]
    return after[list(columns)].to_numpy(dtype=float) - before[list(columns)].to_numpy(dtype=float)


def times(sensor: str) -> np.ndarray:
    return LOG.tables[sensor]["time_s"].to_numpy(dtype=float)


def every_fault() -> list[str]:
    found: list[str] = []
    for name, kind in KINDS.items():
        for sensor, unit in kind.units.items():
            amount = "" if unit is None else f":{UNITS[unit]}"
            span = "@20:40" if kind.spans == "needed" or name == "drop" else ""
            found.append(f"{name} {sensor}{amount}{'@0.3' if kind.share == 'needed' else ''}{span}")
    return found


@pytest.mark.parametrize("text", every_fault())
def test_a_fault_changes_the_table_of_its_sensor_alone_and_not_the_log_that_it_was_given(text: str) -> None:
    sensor = text.split()[1].split(":")[0].split("@")[0]
    copies = {name: table.copy(deep=True) for name, table in LOG.tables.items()}

    hurt = with_faults(text)

    for name, table in LOG.tables.items():
        pd.testing.assert_frame_equal(table, copies[name])
        assert table.equals(hurt.tables[name]) == (name != sensor), name
    assert list(hurt.tables[sensor].columns) == list(LOG.tables[sensor].columns)
    assert list(hurt.tables[sensor].dtypes) == list(LOG.tables[sensor].dtypes)
    assert list(hurt.tables[sensor].index) == list(range(len(hurt.tables[sensor])))


def test_every_kind_has_an_effect_and_an_example_that_can_be_written() -> None:
    assert set(EFFECTS) == set(KINDS)
    for name, kind in KINDS.items():
        assert set(kind.units) <= set(SENSORS)
        with_faults(f"{name} {kind.example}", log=simulated_log(find_scenario("square"), 0))


def test_a_single_spike_is_one_record_off_by_exactly_its_size_to_either_side() -> None:
    sides: set[float] = set()
    for seed in range(8):
        before = LOG.tables["compass"]["heading_deg"]
        turn = with_faults("spike compass:120deg@one", seed=seed).tables["compass"]["heading_deg"] - before
        (off,) = np.flatnonzero(turn)
        sides.add(round((turn[off] + 180) % 360 - 180, 6))
    assert sides == {120.0, -120.0}


def test_spikes_of_velocity_have_their_size_any_direction_and_their_share() -> None:
    error = change("spike dvl:3m/s@0.1", "starboard_mps", "forward_mps")
    size = np.hypot(*error.T)
    hit = size > 0
    assert np.allclose(size[hit], 3.0)
    assert abs(hit.mean() - 0.1) < 4 * np.sqrt(0.1 * 0.9 / len(hit))  # four sigma of the binomial share
    assert np.abs(error[hit].mean(axis=0)).max() < 4 * 3 / np.sqrt(2 * hit.sum())  # no preferred direction


def test_outliers_and_scatter_have_their_sigma() -> None:
    for text in ("outlier usbl:20m@0.9", "scatter usbl:20m"):
        error = change(text, "east_m", "north_m")
        error = error[np.abs(error).sum(axis=1) > 0]
        assert abs(error.std() / 20 - 1) < 4 / np.sqrt(2 * error.size)


def test_a_cluster_moves_the_fixes_of_its_span_by_the_same_vector() -> None:
    error = change("cluster usbl:32m@30:60", "east_m", "north_m")
    inside = (times("usbl") >= 30) & (times("usbl") < 60)
    assert np.allclose(error[~inside], 0)
    assert np.allclose(error[inside], error[inside][0])
    assert np.isclose(np.hypot(*error[inside][0]), 32)


def test_a_bias_is_clockwise_forward_or_east_and_a_drift_grows_to_it() -> None:
    assert np.allclose((change("bias compass:3deg", "heading_deg") + 180) % 360 - 180, 3)
    assert np.allclose(change("bias dvl:1m/s", "starboard_mps", "forward_mps"), [0, 1])
    assert np.allclose(change("bias usbl:1m", "east_m", "north_m"), [1, 0])
    error, t = change("drift usbl:10m@20:60", "east_m"), times("usbl")
    assert np.allclose(error[:, 0], np.where((t >= 20) & (t < 60), 10 * (t - 20) / 40, 0.0))


def test_a_stuck_sensor_repeats_the_first_record_of_each_span_under_new_stamps() -> None:
    table, t = with_faults("stuck usbl@20:40,60:70").tables["usbl"], times("usbl")
    assert np.array_equal(table["time_s"], t)
    for first_s, last_s in ((20, 40), (60, 70)):
        inside = (t >= first_s) & (t < last_s)
        assert table.loc[inside, "east_m"].nunique() == 1
        assert table.loc[inside, "north_m"].iloc[-1] == LOG.tables["usbl"].loc[inside, "north_m"].iloc[0]
    between = (t >= 40) & (t < 60)
    assert table.loc[between, "east_m"].nunique() == between.sum()


def test_zeros_are_stated_as_valid() -> None:
    log = with_table(LOG, "dvl", LOG.tables["dvl"].assign(valid=False))
    hurt = with_faults("zero dvl@10:20", log=log).tables["dvl"]
    inside = (times("dvl") >= 10) & (times("dvl") < 20)
    assert hurt["valid"].tolist() == inside.tolist()
    assert (hurt.loc[inside, ["starboard_mps", "forward_mps"]] == 0).all(axis=None)
    assert (hurt.loc[~inside, "forward_mps"] != 0).all()


def test_dropped_and_thinned_records_are_gone() -> None:
    assert with_faults("drop dvl@20:").tables["dvl"]["time_s"].max() < 20 <= times("dvl").max()
    thin = with_faults("thin usbl:0.1Hz@0:50").tables["usbl"]["time_s"]
    assert np.allclose(thin[thin < 50], [0, 10, 20, 30, 40])
    assert (thin >= 50).sum() == (times("usbl") >= 50).sum()


def test_the_stated_sigma_changes_and_the_records_do_not() -> None:
    hurt = with_faults("sd usbl:4").tables["usbl"]
    for column in ("cov_ee_m2", "cov_en_m2", "cov_nn_m2"):
        assert np.allclose(hurt[column], 16 * LOG.tables["usbl"][column])
    assert np.allclose(with_faults("sd compass:0.5").tables["compass"]["sd_deg"], LOG.tables["compass"]["sd_deg"] / 2)
    assert np.allclose(change("sd usbl:4", "east_m", "north_m"), 0)


def test_a_late_stamp_arrives_no_earlier_than_it_says_and_a_clock_moves_both() -> None:
    usbl = LOG.tables["usbl"].assign(received_s=LOG.tables["usbl"]["time_s"] + 5)
    log = with_table(LOG, "usbl", usbl)
    late = with_faults("latency usbl:2s", log=log).tables["usbl"]
    assert np.allclose(late["time_s"] - usbl["time_s"], 2)
    assert np.allclose(late["received_s"], usbl["received_s"])
    later = with_faults("latency usbl:7s", log=log).tables["usbl"]
    assert np.allclose(later["received_s"], later["time_s"])
    ahead = with_faults("clock usbl:2s", log=log).tables["usbl"]
    assert np.allclose(ahead["received_s"] - usbl["received_s"], 2)


@pytest.mark.parametrize("sensor", ["dvl", "usbl"])
def test_a_lever_arm_does_what_the_simulator_does(sensor: str) -> None:
    """The simulator has the true turn rate; the same noise of the same seed cancels."""
    legs = (Leg(40.0, 0.0, 1.0, 0.0), Leg(60.0, 0.0, 1.0, -0.1))
    exact = dataclasses.replace(SCENARIO, legs=legs, compass=dataclasses.replace(SCENARIO.compass, sd_rad=1e-9))
    part = dataclasses.replace(getattr(exact, sensor), lever_m=(0.0, 2.0, 0.0))
    want = simulated_log(dataclasses.replace(exact, **{sensor: part}), 0).tables[sensor]

    found = with_faults(f"lever {sensor}:2m", log=simulated_log(exact, 0)).tables[sensor]

    columns = {"dvl": ["starboard_mps", "forward_mps"], "usbl": ["east_m", "north_m"]}[sensor]
    t = want["time_s"].to_numpy(dtype=float)
    steady = (np.abs(t - 40) > 1.1) & (t < 98.9)  # the turn rate is a mean over 2 s
    assert np.abs((found[columns] - want[columns]).to_numpy(dtype=float)[steady]).max() < 1e-6
    moved = (want[columns] - simulated_log(exact, 0).tables[sensor][columns]).to_numpy(dtype=float)[t > 42]
    assert np.hypot(*moved.T).min() > 0.19


def test_spans_are_seconds_shares_of_the_log_or_lengths() -> None:
    t = times("usbl")
    for text, first_s, last_s in (
        ("10:20", 10, 20),
        ("10%:20%", 10, 20),
        ("10%:+10", 10, 20),
        ("90:", 90, np.inf),
        ("10%+5:+10", 15, 25),
    ):
        lost = np.setdiff1d(t, with_faults(f"drop usbl@{text}").tables["usbl"]["time_s"])
        assert np.array_equal(lost, t[(t >= first_s) & (t < last_s)]), text
    faults = (fault_of("drop", "usbl@10%:+10,30:"), fault_of("sd", "usbl:2"))
    assert Drill("drill", faults).spans_s(100.0) == ((10.0, 20.0), (30.0, 100.0))


def test_the_same_seed_gives_the_same_damage_whatever_the_order_in_which_faults_are_stated() -> None:
    texts = ("spike dvl:3m/s@0.1", "outlier usbl:20m@0.5", "drop usbl@20:40")
    one, other = with_faults(*texts, seed=3), with_faults(*reversed(texts), seed=3)
    for sensor, table in one.tables.items():
        pd.testing.assert_frame_equal(table, other.tables[sensor])
    assert not with_faults(*texts, seed=4).tables["dvl"].equals(one.tables["dvl"])
    assert damaged(LOG, UNDAMAGED, 0) is LOG


def test_a_fault_that_finds_no_record_says_so() -> None:
    with pytest.raises(UsageError, match=r"drop usbl@300:400: the log has no usbl record there \(0 to 100 s\)"):
        with_faults("drop usbl@300:400")
    without = dataclasses.replace(LOG, tables={k: v for k, v in LOG.tables.items() if k != "usbl"})
    assert "no usbl data" in refusal(LogError, with_faults, "sd usbl:4", log=without)
    unknown = LOG.tables["dvl"].assign(sd_mps=np.nan)
    assert "state no sigma" in refusal(UsageError, with_faults, "sd dvl:4", log=with_table(LOG, "dvl", unknown))


def test_a_fault_has_a_sensor_an_amount_and_places() -> None:
    text = "compass:-1.5e1deg@0.02@10%:+60,300:400"
    spans = (Span(0.1, 0.0, 0.0, 60.0, end_after_start=True), Span(0.0, 300.0, 0.0, 400.0))
    assert fault_of("spike", text) == Fault("spike", "compass", -15.0, spans, 0.02, False, f"spike {text}")
    assert fault_of("spike", "compass:120@one").one
    assert fault_of("drop", "dvl@20:").spans[0].seconds(100.0)[1] == float("inf")


@pytest.mark.parametrize(
    ("kind", "text", "reported"),
    [
        ("melt", "usbl", "there is no fault 'melt'"),
        ("drop", "sonar@1:2", "write a sensor of compass, dvl, usbl"),
        ("drop", "usbl", "needs a span FROM:TO or a share"),
        ("drop", "usbl:3@1:2", "takes no number"),
        ("drop", "usbl@2:1", "must end after its start"),
        ("drop", "usbl@1:2:3", "is not a span"),
        ("drop", "usbl@1:+5%", "is not a span"),
        ("drop", "usbl@1+5:10", "is not a span"),
        ("drop", "usbl@1.5", "must be above 0 and at most 1"),
        ("drop", "usbl@soon", "neither a share"),
        ("spike", "compass@0.1", "needs a number in deg"),
        ("spike", "compass:3m@0.1", "is not a number in deg"),
        ("spike", "compass:3deg", 'needs a share or "one"'),
        ("lever", "dvl:2m@1:2", "takes no span"),
        ("bias", "compass:3deg@0.1", 'takes no share or "one"'),
        ("zero", "usbl@1:2", "write a sensor of dvl"),
        ("sd", "usbl:0", "must be above 0"),
        ("clock", "dvl:1e999s", "must be finite"),
    ],
)
def test_a_fault_that_cannot_be_read_is_refused_in_one_sentence(kind: str, text: str, reported: str) -> None:
    said = refusal(UsageError, fault_of, kind, text)
    assert reported in said
    assert said.startswith(f"{kind} {text}")
    assert "\n" not in said


def test_the_suite_that_is_shipped_can_be_read_and_has_every_kind_but_those_of_a_user() -> None:
    drills = read_suite(STANDARD)
    used = {fault.kind for drill in drills for fault in drill.faults}
    assert len(drills) > 30
    assert set(KINDS) == used


@pytest.mark.parametrize(
    ("content", "reported"),
    [
        ('[[drill]]\nname = "a"\nfaults = ["melt usbl"]', "drill 'a': melt usbl: there is no fault 'melt'"),
        ('[[drill]]\nname = "a"\nfaults = []', "the drill 'a' has no faults"),
        ('[[drill]]\nname = "undamaged"\nfaults = ["sd usbl:2"]', "two drills are called 'undamaged'"),
        ('[[drill]]\nname = "a"\nfault = []', "did you mean faults?"),
        ('[[drill]]\nfaults = ["sd usbl:2"]', "the key name is missing"),
    ],
)
def test_a_suite_that_cannot_be_read_names_file_and_drill(tmp_path: Path, content: str, reported: str) -> None:
    file = saved(tmp_path / "own.toml", content)
    said = refusal(UsageError, read_suite, str(file))
    assert said.startswith(f"{file}: ")
    assert reported in said


def test_a_drill_is_named_if_findings_name_each_of_its_faults() -> None:
    drill = Drill("both", (fault_of("drop", "usbl@1:2"), fault_of("outlier", "usbl:20m@0.1")))
    assert not is_named(drill, {"OUTAGE"})
    assert is_named(drill, {"OUTAGE", "USBL-OUTLIERS", "DVL-SCALE"})
    assert is_named(drill, {"OUTAGE", "USBL-OUTLIERS"}, {"USBL-OUTLIERS"}) is None  # it says so of the log as it is
    assert not is_named(drill, {"USBL-OUTLIERS"}, {"HEADING-CHECKED"})
    assert is_named(Drill("rare", (fault_of("thin", "usbl:0.1Hz"),)), ()) is None
    declared = {(kind, sensor) for kind, one in KINDS.items() for sensor in one.units}
    assert {(kind, sensor) for kind, codes in NAMED_BY.items() for sensor in codes} <= declared
