"""Sigmas of DVL and compass that are smaller than their records scatter."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

import usbldr
from logs import with_table
from usbldr.filters.models.parameters import ProcessNoise
from usbldr.io.conventions.shown_noise import examined, with_shown_noise
from usbldr.io.drills.drill import Drill, damaged
from usbldr.io.drills.fault_text import fault_of
from usbldr.io.log import Log
from usbldr.io.scenarios.shipped import scenario_names


@pytest.fixture(scope="module")
def dive() -> Log:
    return usbldr.open_log("lawnmower")


@pytest.mark.parametrize("role", ["compass", "dvl"])
@pytest.mark.parametrize("factor", [5.0, 20.0])
def test_records_that_scatter_more_get_that_sigma(dive: Log, role: str, factor: float) -> None:
    """Three columns of white noise of a known sigma, in the middle third of the dive."""
    columns, name = {"compass": (["heading_deg"], "sd_deg"), "dvl": (["starboard_mps", "forward_mps"], "sd_mps")}[role]
    table = dive.tables[role]
    sd, t = float(table[name].iloc[0]), table["time_s"].to_numpy()
    begin_s, end_s = t[-1] / 3 + 5, t[-1] * 2 / 3 + 5  # within blocks of both sensors
    noisy = (t > begin_s) & (t < end_s)
    extra = np.random.default_rng(7).normal(0, sd * np.sqrt(factor**2 - 1), (len(t), len(columns)))
    values = table[columns].to_numpy() + np.where(noisy[:, None], extra, 0)
    log = with_table(dive, role, table.assign(**dict(zip(columns, values.T, strict=True))))
    found = with_shown_noise(log)
    raised = found.tables[role][name].to_numpy() / sd
    inside = noisy & (t > t[-1] / 3 + 20) & (t < t[-1] * 2 / 3 - 20)
    assert np.all(raised[noisy] > factor / 2)  # also in the blocks in which it begins and ends
    outside = (t < t[-1] / 3 - 60) | (t > t[-1] * 2 / 3 + 60)
    assert np.median(raised[inside]) == pytest.approx(factor, rel=0.1)
    assert np.all(raised[outside] == 1)
    (finding,) = (one for one in found.findings if one.code == "NOISE-LARGER")
    assert finding.topic == log.provenance[role].topic
    assert f"not by the {sd:.2g}" in finding.text


@pytest.mark.parametrize("role", ["compass", "dvl"])
def test_manoeuvres_between_slow_records_are_no_noise(dive: Log, role: str) -> None:
    """A record a second of a vehicle that moves as the motion model allows, and accurate sensors."""
    t, process = np.arange(2000.0), ProcessNoise()
    fine = np.random.default_rng(8).normal(0, 0.1, (2, 20_000))
    speed = np.cumsum(process.velocity_mps * np.sqrt(0.1) / 0.1 * fine, axis=1)[:, ::10]
    rate = np.cumsum(process.turn_rate_radps * np.sqrt(0.1) / 0.1 * fine[0])
    heading = np.degrees(np.cumsum(rate) * 0.1)[::10] % 360
    moving = {"compass": {"heading_deg": heading, "sd_deg": 0.1}, "dvl": {"sd_mps": 0.002, "valid": True}}
    moving["dvl"] |= {"starboard_mps": speed[0], "forward_mps": speed[1]}
    log = replace(dive, tables={role: pd.DataFrame({"time_s": t, "received_s": t, **moving[role]})})

    assert with_shown_noise(log) is log


@pytest.mark.parametrize("name", scenario_names())
def test_sigmas_that_are_right_stay(name: str) -> None:
    log = usbldr.open_log(name)

    assert "NOISE-LARGER" not in [one.code for one in log.findings]


def test_unknown_sigmas_short_logs_headings_about_north_and_stamps_that_repeat_stay(dive: Log) -> None:
    unknown = with_table(dive, "dvl", dive.tables["dvl"].assign(sd_mps=np.nan))
    short = replace(dive, tables={role: table.head(99) for role, table in dive.tables.items()})
    headings = np.random.default_rng(1).uniform(0, 360, 99)
    loud = with_table(short, "compass", short.tables["compass"].assign(heading_deg=headings))

    assert with_shown_noise(unknown) is unknown
    assert with_shown_noise(loud) is loud

    t = np.repeat(np.arange(500) / 5, 2)
    heading = (360 + np.random.default_rng(3).normal(0, 0.3, len(t))) % 360
    table = pd.DataFrame({"time_s": t, "received_s": t, "heading_deg": heading, "sd_deg": 0.3})
    log = with_table(dive, "compass", table)

    assert with_shown_noise(log) is log


def test_a_compass_that_scatters_by_20_degrees_costs_little(dive: Log) -> None:
    """The 155 m of a vehicle in lanes at 2 m/s were those of a filter that believed the stated half degree."""
    noisy = damaged(dive, Drill("scatter", (fault_of("scatter", "compass:20deg"),)), 0)
    auto = [replace(log, parameters=usbldr.Parameters(calibrate=("auto",))) for log in (dive, examined(noisy))]
    clean_m, noisy_m = (
        report.horizontal.mean_m for log in auto if (report := usbldr.score(log, usbldr.timeline(log), "adf").report)
    )

    assert noisy_m < 3 * clean_m
