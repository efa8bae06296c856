"""The driver: which measurement enters which step, and what comes out at the end."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest

from timelines import HZ, five_hz
from usbldr.filters.errors import LogError, UsageError
from usbldr.filters.models.noise import Gaussian, Mixture, NoiseFamily
from usbldr.filters.models.parameters import Parameters, Start
from usbldr.filters.models.sensors import UsblFix
from usbldr.filters.models.states import StateLayout
from usbldr.filters.replay.methods import FilterSettings
from usbldr.filters.replay.prior import find_anchor, prior
from usbldr.filters.replay.run import run
from usbldr.filters.replay.steps import steps
from usbldr.filters.types import Timeline, Truth
from weaving import Faults, weaving_dive


def timeline(seconds: float = 4.0, fixes: tuple[float, ...] = (0.0, 1.0, 1.31, 1.39, 3.05)) -> Timeline:
    """A vehicle going north at 1 m/s with the bow north."""
    count = round(seconds * HZ) + 1
    fix_s = np.array(fixes)
    fix_m = np.stack([0 * fix_s, fix_s], axis=1).reshape(-1, 2)
    return five_hz(np.tile([0.0, 1.0], (count, 1)), np.zeros(count), fix_s, fix_m, fix_received_s=fix_s + 0.5)


def test_each_fix_is_used_once_at_the_first_epoch_at_or_after_its_time_of_validity() -> None:
    used = {}
    for step in steps(timeline(), Parameters(), StateLayout()):
        for reading in step.measurements:
            if reading.sensor == "usbl":
                assert reading.row not in used
                assert isinstance(reading.model, UsblFix)
                used[reading.row] = (step.t1_s, reading.model.offset_s)

    assert {row: round(t1, 9) for row, (t1, _) in used.items()} == {0: 0.0, 1: 1.0, 2: 1.4, 3: 1.4, 4: 3.2}
    np.testing.assert_allclose([used[row][1] for row in range(5)], [0.0, 0.0, -0.09, -0.01, -0.15], atol=1e-12)


def test_measurements_of_a_step_come_by_time_then_sensor() -> None:
    step = list(steps(timeline(), Parameters(), StateLayout()))[7]

    measured = [(m.sensor, m.axis, m.row) for m in step.measurements]
    assert measured[:2] == [("usbl", "position", 2), ("usbl", "position", 3)]
    assert measured[2:] == [("compass", "yaw", 7), ("dvl", "starboard", 7), ("dvl", "forward", 7)]


def test_a_fix_is_taken_by_axis_if_the_errors_of_its_axes_are_independent() -> None:
    line = timeline()
    line.fix_cov_m2[2] += 0.1

    def axes(epoch: int, usbl: NoiseFamily) -> list[list[str]]:
        step = list(steps(line, Parameters(usbl=usbl), StateLayout()))[epoch]
        return [[part.axis for part in m.parts()] for m in step.measurements if m.sensor == "usbl"]

    assert axes(0, Mixture()) == [["east", "north"]]
    assert axes(0, Mixture(per_scalar=False)) == [["position"]]
    assert axes(7, Mixture()) == [["position"], ["east", "north"]]


def test_a_fix_taken_by_axis_has_one_update_with_the_sum_and_the_worst_of_both() -> None:
    line = timeline(30.0, tuple(np.arange(0.0, 30.0)))
    line.fix_m[20, 1] += 100.0

    tracks = (run("ekf", line, Parameters(usbl=Gaussian(each)), FilterSettings(gate=0.99)) for each in (True, False))
    by_axis, at_once = ({one.row: one for one in track.updates if one.sensor == "usbl"} for track in tracks)

    for row in range(30):
        assert by_axis[row].dof == at_once[row].dof == 2
        np.testing.assert_allclose(by_axis[row].innovation, at_once[row].innovation, atol=1e-3)
        assert by_axis[row].nis == pytest.approx(at_once[row].nis, rel=1e-3, abs=1e-3)
    east, north = by_axis[20].parts
    assert (east.outcome, north.outcome, by_axis[20].outcome) == ("used", "rejected", "rejected")
    assert by_axis[20].shift == east.shift
    assert at_once[20].parts == (at_once[20],)


def test_n_averaged_records_have_a_variance_of_r_over_n_and_epochs_without_a_record_no_measurement() -> None:
    line = timeline()
    line.dvl_count[2:4], line.yaw_count[2] = (0, 4), 0
    line.dvl_mps[2] = np.nan

    without, averaged = list(steps(line, Parameters(), StateLayout()))[2:4]

    dvl = next(m for m in averaged.measurements if m.sensor == "dvl")
    assert dvl.noise.cov[0, 0, 0] == pytest.approx(0.02**2 / 4)
    assert not without.measurements


def test_time_passes_from_epoch_to_epoch_and_not_in_the_first_step() -> None:
    spans = [(s.t0_s, s.t1_s) for s in steps(timeline(), Parameters(), StateLayout())]
    assert spans[0] == (0.0, 0.0)
    assert all(a[1] == b[0] for a, b in itertools.pairwise(spans))


def test_the_start_is_the_stated_one_else_the_fixes_say_it_and_without_both_it_is_a_fault() -> None:
    stated = prior(timeline(), Parameters(start=Start(5.0, -2.0, 0.01)), StateLayout())
    reported = prior(timeline(), Parameters(), StateLayout())

    np.testing.assert_allclose(stated.mean, [0, 0, 1, 0, 5, -2])
    np.testing.assert_allclose(reported.mean, [0, 0, 1, 0, 0, 0], atol=1e-9)
    assert reported.cov[4, 4] >= 9
    with pytest.raises(LogError, match=r"no USBL fix gives a filter its start: state \[start\]"):
        prior(timeline(fixes=()), Parameters(), StateLayout())


def test_a_transponder_beside_the_reference_point_shifts_neither_the_start_nor_an_anchor() -> None:
    line = weaving_dive(Faults())
    starboard_m, forward_m = 2.0, 7.0
    yaw = np.interp(line.fix_time_s, line.time_s, line.dr_yaw_rad)
    c, s = np.cos(yaw), np.sin(yaw)
    arm_m = np.column_stack([starboard_m * c - forward_m * s, starboard_m * s + forward_m * c])  # east, north
    off, levered = replace(line, fix_m=line.fix_m + arm_m), Parameters(usbl_lever_m=(starboard_m, forward_m, -1.0))

    plain, beside = prior(line, Parameters(), StateLayout()), prior(off, levered, StateLayout())
    np.testing.assert_allclose(beside.mean, plain.mean, atol=1e-9)

    for where in ("start", "first-fix"):
        anchor, same = find_anchor(where, line, Parameters(), None), find_anchor(where, off, levered, None)
        np.testing.assert_allclose(same.position_m, anchor.position_m, atol=1e-9)


def test_the_truths_own_lever_arm_does_not_shift_an_anchor_on_it() -> None:
    """At the first row the bow points east: 2 m ahead is 2 m east, 1 m to starboard is 1 m south."""
    line = five_hz(np.tile([0.0, 1.0], (50, 1)), np.full(50, -math.pi / 2), np.empty(0), np.empty((0, 2)))
    rows = Truth(np.array([3.0]), np.array([[12.0, 4.0]]), np.array([np.nan]), "gps", "gps", lever_m=(1.0, 2.0, 0.0))

    anchor = find_anchor("first-truth", line, Parameters(), rows)

    np.testing.assert_allclose(anchor.position_m, [10.0, 5.0])


@pytest.mark.parametrize(
    ("name", "settings", "said"),
    [
        ("ekf", FilterSettings(order="backwards"), "there is no order 'backwards'"),
        ("pf", FilterSettings(guard=True), "pf takes no guard"),
        ("kf", FilterSettings(), "there is no filter 'kf'"),
        ("cpf", FilterSettings(gate=0.99), "cpf weighs outliers and takes no gate"),
    ],
)
def test_settings_that_do_not_fit_the_filter_are_a_sentence(name: str, settings: FilterSettings, said: str) -> None:
    with pytest.raises(UsageError, match=said):
        run(name, timeline(), Parameters(), settings)


def test_a_gross_first_fix_does_not_spoil_the_run() -> None:
    line = timeline(60.0, tuple(np.arange(0.0, 60.0)))
    line.fix_m[0] += 100.0

    for name in ("cpf", "adf"):
        north = run(name, line, Parameters(), FilterSettings(particles=50)).position_m[:, 1]
        assert np.abs(north - line.time_s)[100:].max() < 0.5  # 20 s later it has forgotten


def test_fixes_that_nearly_all_look_wrong_are_told() -> None:
    line = timeline(60.0, tuple(np.arange(0.0, 60.0)))
    line.fix_m[10:] += np.arange(50)[:, None] * [30.0, -20.0]  # as a wrong scale or unit would have it

    # the guard would follow them, and say so
    said = run("adf", line, Parameters(), FilterSettings(guard=False)).warnings
    sound = run("adf", timeline(60.0, tuple(np.arange(0.0, 60.0))), Parameters(), FilterSettings()).warnings

    assert any("USBL fixes look like outliers" in text for text in said)
    assert not sound


@pytest.mark.parametrize("stage", ["prior", "smooth"])
def test_a_covariance_that_breaks_down_at_any_stage_is_one_sentence(monkeypatch, stage):
    def breaks_down(*_: object) -> None:
        np.linalg.cholesky(np.zeros((2, 2)))

    monkeypatch.setattr(f"usbldr.filters.replay.run.{stage}", breaks_down)

    with pytest.raises(LogError, match=r"^adf: a covariance grew beyond what numbers can hold apart"):
        run("adf", timeline(), Parameters(), FilterSettings(smooth=True))
