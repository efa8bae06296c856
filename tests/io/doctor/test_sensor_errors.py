"""What the doctor says of sensor errors and of noise: numbers as identified, and rivals instead of a guess."""

import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TypeAlias

import numpy as np
import pandas as pd
import pytest

from commands import replayed
from logs import with_table
from usbldr.filters.frames import rotated
from usbldr.filters.identification.identification import ErrorEstimate, Explanation, Identification, SensorErrorEvidence
from usbldr.filters.models.parameters import Parameters, SensorChange
from usbldr.filters.types import Array, Vector
from usbldr.io.conventions.implausible import without_implausible
from usbldr.io.doctor import fix_noise
from usbldr.io.doctor.doctor import examine_log
from usbldr.io.doctor.fix_noise import apart_by_turns_m, exceeds_heavy_tail, fix_noise_findings
from usbldr.io.doctor.interpretations import compare_interpretations
from usbldr.io.doctor.sensor_errors import sensor_error_findings
from usbldr.io.drills.drill import Drill, damaged
from usbldr.io.drills.fault_text import fault_of
from usbldr.io.findings import Finding
from usbldr.io.log import Log
from usbldr.io.reading.epochs import timeline
from usbldr.io.reading.opening import Request
from usbldr.io.session import open_log
from weaving import DIVE

Table: TypeAlias = tuple[Vector, Mapping[str, Vector]]  # times, s, and columns

NUMBERS: Mapping[str, Mapping[str, tuple[float, float]]] = {
    "scale": {"dvl_scale": (0.05, 0.004)},
    "heading": {"heading_bias_deg": (3.0, 0.2)},
    "deviation": {"deviation_sin_deg": (3.0, 0.2), "deviation_cos_deg": (-1.0, 0.3)},
    "latency": {"usbl_latency_s": (-2.6, 0.1)},
    "dvl-lever": {"dvl_lever_starboard_m": (-0.2, 0.1), "dvl_lever_forward_m": (2.0, 0.15)},
    "dvl-clock": {"dvl_clock_s": (1.0, 0.2)},
    "compass-clock": {"compass_clock_s": (-1.0, 0.2)},
}


@pytest.fixture(scope="module")
def log() -> Log:
    return open_log("turns", Request(configuration="none"))


@pytest.fixture(scope="module")
def usual(log: Log) -> set[str]:
    return {one.code for one in examine_log(log).findings}


def explanation(*keys: str, log_odds: float = 0.0, times: float = 1.0) -> Explanation:
    numbers = [(name, *number) for key in keys for name, number in NUMBERS[key].items()]
    return Explanation(keys, log_odds, tuple(ErrorEstimate(name, times * v, sd) for name, v, sd in numbers))


def identification(*explanations: Explanation, exist: tuple[str, ...] = ()) -> Identification:
    """Say that the errors of the first explanation exist, or those named."""
    value = {one.name: one for explained in explanations for one in explained.estimates}
    evidence = tuple(
        SensorErrorEvidence(key, 13.0, True, tuple(value[name] for name in NUMBERS[key]))
        for key in exist or explanations[0].keys
    )
    return Identification(Parameters(dvl_lever_m=(-0.2, 2.0, 0.0)), evidence, (), explanations)


def reported(log: Log, found: Identification) -> Mapping[str, Finding]:
    return {one.code: one for one in sensor_error_findings(log, found)}


@pytest.mark.parametrize(
    ("key", "code", "words"),
    [
        ("scale", "DVL-SCALE", ("5.00 ± 0.40 %", "scale_error = 0.050 under [dvl]")),
        ("deviation", "COMPASS-DEVIATION", ("(3.0 ± 0.2) sin H + (-1.0 ± 0.3) cos H",)),
        ("latency", "USBL-LATENCY", ("2.60 ± 0.10 s after", "latency_s = -2.60 under [usbl]")),
        ("dvl-lever", "DVL-LEVER", ("2.00 ± 0.15 m", "lever_arm_m = [-0.20, 2.00, 0.00] under [dvl]")),
        ("dvl-clock", "DVL-CLOCK", ("1.00 ± 0.20 s late", "latency_s = 1.00 under [dvl]")),
        ("compass-clock", "COMPASS-CLOCK", ("1.00 ± 0.20 s early", "latency_s = -1.00 under [compass]")),
    ],
)
def test_an_error_is_told_with_its_sigma_its_evidence_and_the_key_that_removes_it(log, key, code, words):
    found = reported(log, identification(explanation(key)))

    assert set(found) == {code}
    assert "log odds +13.0" in found[code].text
    for word in words:
        assert word in found[code].text


def test_a_lever_arm_or_a_latency_is_one_finding_with_both_numbers(log: Log) -> None:
    rivals = explanation("latency"), explanation("dvl-lever", log_odds=-1.1)

    found = reported(log, identification(*rivals, exist=("latency", "dvl-lever")))

    assert set(found) == {"LEVER-OR-LATENCY"}
    assert "2.60 ± 0.10 s after" in found["LEVER-OR-LATENCY"].text
    assert "2.00 ± 0.15 m further ahead" in found["LEVER-OR-LATENCY"].text
    assert "log odds -1.1 against the likeliest" in found["LEVER-OR-LATENCY"].text


def test_only_what_every_explanation_contains_has_a_finding_of_its_own(log: Log) -> None:
    rivals = explanation("scale", "dvl-clock"), explanation("scale", "deviation", log_odds=-2.0)

    found = reported(log, identification(*rivals))

    assert set(found) == {"DVL-SCALE", "RIVAL-EXPLANATIONS"}
    assert "stamps of the DVL are 1.00 ± 0.20 s late" in found["RIVAL-EXPLANATIONS"].text


@pytest.mark.parametrize(("delay_s", "late_s"), [(2.0, "0.60"), (2.4, None), (3.0, None), (np.nan, None)])
def test_fixes_that_would_arrive_before_they_are_valid_show_that_dvl_and_compass_are_late(log, delay_s, late_s):
    """They are valid 2.6 s after their stamps, known to 0.1 s: four sigma are 0.4 s."""
    table = log.tables["usbl"]
    arriving = with_table(log, "usbl", table.assign(received_s=table["time_s"] + delay_s))

    text = reported(arriving, identification(explanation("latency")))["USBL-LATENCY"].text

    assert (f"DVL and compass are late by {late_s} s at least" in text) == (late_s is not None)


@pytest.mark.parametrize(
    ("kind", "fault", "code", "worst"),
    [
        ("lever", "dvl:2m", "DVL-LEVER", 2.0),
        ("clock", "dvl:1.5s", "DVL-CLOCK", 1.5),
        ("clock", "compass:1.5s", "COMPASS-CLOCK", 1.5),
        ("latency", "usbl:2s", "USBL-LATENCY", 2.0),
        ("bias", "compass:3deg", "DVL-MOUNT", -3.0),
    ],
)
@pytest.mark.long
def test_the_doctor_names_the_error_of_a_dive_and_no_other(log, usual, kind, fault, code, worst):
    found = examine_log(without_implausible(damaged(log, Drill("one", (fault_of(kind, fault),)), 0))).findings

    named = [one for one in found if one.code not in usual]
    assert [one.code for one in named] == [code]
    assert named[0].worst == pytest.approx(worst, abs=0.6)
    assert usual == {"CONVENTION-CHECKED", "HEADING-CHECKED"}


def student_t(count: int, seed: int, dof: float = 4.0) -> Vector:
    """Distances of a bivariate Student-t, drawn as a normal over the root of a chi-square."""
    rng = np.random.default_rng(seed)
    normal = rng.standard_normal((count, 2)) / np.sqrt(rng.chisquare(dof, count) / dof)[:, None]
    return np.hypot(*normal.T)


def test_a_heavy_tail_is_taken_for_gross_errors_once_in_a_hundred_logs_at_most() -> None:
    assert sum(exceeds_heavy_tail(student_t(700, seed)) for seed in range(200)) <= 2


@pytest.mark.parametrize(("share", "size"), [(0.004, 40.0), (0.03, 15.0), (0.5, 8.0)])
def test_gross_errors_are_told_from_a_heavy_tail_be_they_few_and_far_or_many(share: float, size: float) -> None:
    rng = np.random.default_rng(3)
    sigmas = np.hypot(*rng.standard_normal((2, 700)))
    sigmas[: round(share * 700)] = size

    assert exceeds_heavy_tail(sigmas)


@pytest.mark.parametrize(("ratio", "reported"), [(0.5, True), (0.7, False), (1.4, False), (1.6, True)])
def test_a_stated_sigma_is_reported_if_it_makes_nees_wrong_by_more_than_two(log, ratio, reported):
    parameters = replace(log.parameters, usbl_sd_scale=0.8)  # as configured
    found = Identification(replace(parameters, usbl_sd_scale=0.8 * ratio))

    printed = fix_noise_findings(replace(log, parameters=parameters), timeline(log), found)

    noise = [one for one in printed if one.code == "USBL-NOISE"]
    assert bool(noise) == reported
    assert all(f"sd_scale = {0.8 * ratio:.2g} under [usbl]" in one.text for one in noise)


@pytest.mark.parametrize(("changes", "named"), [((), 1), ((SensorChange(300.0, 0.0, 0.0, fix_sd_scale=3.0),), 0)])
def test_a_change_of_noise_is_named_once(log, monkeypatch, changes, named):
    """A found change is a SENSOR-CHANGE."""
    line = timeline(log)
    residual_m = np.hypot(*np.random.default_rng(1).normal(0.0, 1.0, (2, len(line.fix_time_s))))
    residual_m[len(residual_m) // 2 :] *= 4.0
    monkeypatch.setattr(fix_noise, "residuals_m", lambda _: residual_m)

    printed = fix_noise_findings(log, line, Identification(replace(log.parameters, changes=changes)))

    assert [one.code for one in printed].count("USBL-NOISE-CHANGE") == named


@pytest.mark.filterwarnings("error")
def test_fixes_without_dead_reckoning_between_them_show_no_noise(log: Log, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fix_noise, "residuals_m", lambda line: np.full(len(line.fix_time_s), np.nan))

    codes = [one.code for one in fix_noise_findings(log, timeline(log), identification(explanation("scale")))]

    assert {"USBL-OUTLIERS", "USBL-NOISE-CHANGE"}.isdisjoint(codes)


def test_the_lever_arm_of_a_ships_head_is_stated_as_the_configuration_has_it(tmp_path: Path) -> None:
    """Fixes count from a head that lies 1 m to port and 6 m ahead of the antenna; stated is 2 m ahead."""
    fix_s = DIVE.fix_time_s
    heading_deg = 80.0 + 60.0 * np.sin(fix_s / 40.0)
    sin, cos = np.sin(np.radians(heading_deg)), np.cos(np.radians(heading_deg))
    antenna_m = np.column_stack([100 * np.sin(fix_s / 70.0), 50 * np.cos(fix_s / 50.0)])
    head_m = antenna_m + np.column_stack([6 * sin - cos, 6 * cos + sin])
    tables = {
        **own_sensors(DIVE.dvl_mps),
        "usbl": (fix_s, dict(zip(("east_m", "north_m"), (DIVE.fix_m - head_m).T, strict=True))),
        "ship": (fix_s, dict(zip(("east_m", "north_m"), antenna_m.T, strict=True))),
        "gyro": (fix_s, {"heading_deg": heading_deg}),
    }
    save(tmp_path, tables)
    head = 'head = { topic = "ship", heading_topic = "gyro", lever_arm_m = [0.0, 2.0, 0.0] }'
    (tmp_path / "usbldr.toml").write_text(f'schema = 1\n[compass]\ntopic = "compass"\n[usbl]\ntopic = "usbl"\n{head}\n')

    findings = examine_log(open_log(str(tmp_path))).findings

    (found,) = (one for one in findings if one.code == "USBL-ARM")
    assert re.search(
        r"head is [34]\.\d\d ± 0\.\d\d m further ahead and [01]\.\d\d ± 0\.\d\d m further to port", found.text
    )
    starboard, forward, up = map(float, re.findall(r"lever_arm_m = \[(.*?)\]", found.text)[0].split(","))
    assert (starboard, forward, up) == (pytest.approx(-1.0, abs=0.2), pytest.approx(6.0, abs=0.2), 0.0)


def test_fixes_beside_a_dvl_that_measures_through_a_current_are_of_the_same_vehicle(tmp_path: Path) -> None:
    current_mps = (9.0, -3.0)  # on a course that changes all the time, less is still like the fixes within a minute
    tables = own_sensors(DIVE.dvl_mps - rotated(-DIVE.yaw_rad, np.array(current_mps)))
    tables["usbl"] = DIVE.fix_time_s, dict(zip(("east_m", "north_m"), DIVE.fix_m.T, strict=True))
    save(tmp_path, tables)
    log = open_log(str(tmp_path))
    result = compare_interpretations(log, line := timeline(log))
    assert result is not None
    result = replace(result, best=result.as_read)
    through = SensorChange(-np.inf, 0.0, 0.0, current_mps=current_mps)

    (found,) = fix_noise.motion_findings(log, line, result)
    assert found.code == "USBL-MOTION"
    assert fix_noise.motion_findings(log, line, result, Identification(Parameters(changes=(through,)))) == []


def test_fixes_of_two_targets_by_turns_are_named(tmp_path: Path) -> None:
    fix_m = DIVE.fix_m.copy()
    fix_m[1::2] = np.random.default_rng(0).normal((60.0, -40.0), 0.5, fix_m[1::2].shape)  # lies on the bottom
    tables = own_sensors(DIVE.dvl_mps)
    tables["usbl"] = DIVE.fix_time_s, dict(zip(("east_m", "north_m"), fix_m.T, strict=True))
    save(tmp_path, tables)

    findings = examine_log(open_log(str(tmp_path))).findings

    (found,) = (one for one in findings if one.code == "USBL-TURNS")
    assert "lie by turns in places" in found.text
    to_other_m = np.hypot(*(DIVE.fix_m - (60.0, -40.0)).T)
    assert to_other_m.min() < found.worst < to_other_m.max()
    assert f"{found.text} [USBL-TURNS]" in replayed(tmp_path)


@pytest.mark.parametrize("seed", range(3))
def test_turns_of_places_are_told_from_scatter_and_outliers(seed: int) -> None:
    rng = np.random.default_rng(seed)
    t, (x, y) = np.arange(600.0), rng.normal(0.0, 0.5, (2, 600))
    noise, at_random = x + 1j * y, rng.random(600) < 0.5
    outliers = np.where(at_random, 20.0 * (rng.normal(size=600) + 1j * rng.normal(size=600)), 0.0)

    assert apart_by_turns_m(noise + 30.0 * (t % 2)) == pytest.approx(30.0, abs=1.0)
    assert apart_by_turns_m(noise + 30.0 * at_random) == pytest.approx(30.0, abs=1.0)
    assert apart_by_turns_m(noise + 30.0 * np.exp(2j * np.pi * t / 3)) == pytest.approx(52.0, abs=1.0)
    for one_place in (noise, noise + outliers, noise + 3.0 * np.sin(2 * np.pi * t / 9.3), noise + 30.0 * (t > 300)):
        assert apart_by_turns_m(one_place) == 0.0


def own_sensors(dvl_mps: Array) -> dict[str, Table]:
    return {
        "dvl": (DIVE.time_s, {"starboard_mps": dvl_mps[:, 0], "forward_mps": dvl_mps[:, 1]}),
        "compass": (DIVE.time_s, {"heading_deg": -np.degrees(DIVE.yaw_rad) % 360}),
    }


def save(folder: Path, tables: Mapping[str, Table]) -> None:
    for name, (time_s, columns) in tables.items():
        table = pd.DataFrame({"time_ns": np.rint(1e9 * time_s).astype(int)} | dict(columns))
        table.to_csv(folder / f"{name}.csv", index=False)
