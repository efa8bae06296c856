"""The driver: which measurement enters which step, and what comes out at the end.

Before the first fix the track begins with the log, and its sigmas know how little that is based on.
"""

import itertools
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from commands import output_of
from logs import refusal
from timelines import HZ, five_hz
from usbldr.filters.errors import LogError, UsageError
from usbldr.filters.evaluation.consistency import nees
from usbldr.filters.models.calibration import layout_for
from usbldr.filters.models.noise import Gaussian, Mixture, NoiseFamily
from usbldr.filters.models.parameters import Parameters, SensorErrors, Start
from usbldr.filters.models.sensors import UsblFix
from usbldr.filters.models.states import StateLayout
from usbldr.filters.replay.dead_reckoning import displacement_m
from usbldr.filters.replay.methods import METHODS, FilterSettings
from usbldr.filters.replay.prior import find_anchor, prior
from usbldr.filters.replay.run import run
from usbldr.filters.replay.steps import steps
from usbldr.filters.types import Array, Timeline, Trajectory, Truth
from weaving import ASSUMED, DIVE, SD_M, Faults, weaving_dive


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


def test_time_passes_from_epoch_to_epoch_and_measurements_of_a_step_come_by_time_then_sensor() -> None:
    every = list(steps(timeline(), Parameters(), StateLayout()))

    assert (every[0].t0_s, every[0].t1_s) == (0.0, 0.0)
    assert all(a.t1_s == b.t0_s for a, b in itertools.pairwise(every))
    measured = [(m.sensor, m.axis, m.row) for m in every[7].measurements]
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


def nees_at_fixes(track: Trajectory, line: Timeline) -> Array:
    """Return the NEES at the times of fixes, (F,): these are exact to 0.2 m, whether the filter knew them or not."""
    at = np.searchsorted(track.time_s, line.fix_time_s)
    return nees(track.position_m[at] - line.fix_m, track.position_cov_m2[at] + SD_M**2 * np.eye(2))


# a bootstrap particle filter has to hit the first heading and velocity by chance, fixes or not (assumptions.Start)
@pytest.mark.parametrize("method", [name for name, method in METHODS.items() if method.is_filter and name != "pf"])
def test_every_filter_estimates_from_the_start_on_where_the_first_fix_comes_after_a_minute(method: str) -> None:
    whole = weaving_dive(Faults(), seconds=90)
    late = whole.with_fixes(whole.fix_time_s >= 60.0)
    track = run(method, late, Parameters(usbl=Gaussian()), FilterSettings(particles=50))

    assert track.time_s[0] == 0
    assert np.isfinite(track.mean).all()
    assert nees_at_fixes(track, whole)[whole.fix_time_s < 60].mean() < 4


def test_a_start_that_was_carried_back_for_minutes_is_as_doubtful_as_what_carried_it() -> None:
    """240 m straight ahead with a heading that errs by 5 degrees are 20 m. NEES of 10 dives: 20 degrees of freedom."""
    rng, before, after = np.random.default_rng(3), [], []
    for seed in range(10):
        faults = Faults(dvl_scale=float(rng.normal(0, 0.01)), heading_bias_deg=float(rng.normal(0, 5)))
        whole = weaving_dive(faults, seed, seconds=230, weaves=False)
        assumed = Parameters(usbl=Gaussian(), calibrate=("scale", "heading"))
        track = run("ekf", whole.with_fixes(whole.fix_time_s >= 200.0), assumed)
        value = nees_at_fixes(track, whole)
        before.append(value[0])
        after.append(value[(whole.fix_time_s > 205) & (whole.fix_time_s < 220)].mean())

        sd_m = np.sqrt(track.position_cov_m2.trace(axis1=1, axis2=2))
        assert sd_m[0] > 15
        assert sd_m[0] > 2 * sd_m[990]  # what carried the start back brings the track to the fix

    assert np.mean(before) < 4.5  # 999 of 1000
    assert np.mean(after) < 4.5


def test_an_error_that_the_first_fixes_share_is_in_the_start_once() -> None:
    """All fixes of a dive are off by the same 4 m per axis (1-sigma). NEES of 30 dives: 60 degrees of freedom."""
    rng, found = np.random.default_rng(5), []
    errors = SensorErrors(usbl_bias_m=4.0, usbl_bias_s=600.0)
    for seed in range(30):
        whole = weaving_dive(Faults(), seed, seconds=20)
        shifted = replace(whole, fix_m=whole.fix_m + rng.normal(0, 4, 2))
        track = run("ekf", shifted, Parameters(usbl=Gaussian(), calibrate=("usbl-bias",), errors=errors))
        found.append(nees_at_fixes(track, whole).mean())

    assert 1.2 < np.mean(found) < 3.0  # 998 of 1000


def test_the_start_from_late_fixes_lies_behind_them_by_latency_times_velocity() -> None:
    whole = weaving_dive(Faults(), seconds=20, weaves=False)
    layout = layout_for(("latency",))

    begin = prior(whole, Parameters(calibrate=("latency",)), layout)

    place, latency = list(layout.rows("x", "y")), layout.index("usbl_latency")
    speed_mps = np.hypot(*whole.dr_mps.mean(axis=0))
    assert np.hypot(*begin.cov[place, latency]) == pytest.approx(speed_mps * begin.cov[latency, latency], rel=0.05)
    course = np.array([-np.sin(whole.dr_yaw_rad[0]), np.cos(whole.dr_yaw_rad[0])])
    assert begin.cov[place, latency] @ course > 0  # the vehicle was ahead of a fix that is stamped too late


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("blind")
    (folder / "short.toml").write_text(
        'schema = 1\nlike = "square"\nabout = "short"\nduration_s = 60.0\n\n'
        "[vehicle]\neast_m = 300.0\nnorth_m = -200.0\n",
        encoding="utf-8",
    )
    output_of("simulate", folder / "short.toml", "-o", folder / "dive.mcap")
    return folder / "dive.mcap"


def replayed(log: Path, *options: str) -> str:
    return output_of("replay", log, "--usbl", "none", "--force", "-q", "-o", log.with_name("run"), *options)


def test_without_usbl_it_is_said_what_to_state(log: Path) -> None:
    assert refusal(LogError, replayed, log, "-f", "adf") == (
        f"{log}: no USBL fix gives a filter its start: state [start] east_m, north_m, sd_m in the configuration, or "
        "use GPS fixes at the surface (--aid gps@FROM:TO); without fixes this is dead reckoning: --filter dr --dr-from "
        "first-gps"
    )
    assert replayed(log, "-f", "dr", "--dr-from", "first-gps").startswith("dr: mean horizontal error")

    said = refusal(LogError, replayed, log, "-f", "dr")
    assert "nothing to start from: give --dr-from first-gps or LAT,LON, or state [start]" in said


def test_without_any_position_dead_reckoning_starts_at_0_0(log: Path) -> None:
    blind = ("--config", "none", "--gps", "none", "--truth", "none")
    nowhere, a_map = ("-f", "dr", *blind), ("--set", "map={origin_lat_deg=1,origin_lon_deg=2}")

    for more, how in ((), "starts at 0, 0"), (a_map, "--dr-from LAT,LON"):
        assert refusal(LogError, replayed, log, "-f", "adf", *blind, *more).endswith(f": --filter dr {how}")
    replayed(log, *nowhere)
    said = (log.with_name("run") / "report.md").read_text(encoding="utf-8")
    first = (log.with_name("run") / "track.tum").read_text(encoding="utf-8").split()
    placed = refusal(LogError, replayed, log, *nowhere, *a_map)

    assert "dr: no fix, GPS or [start] says where the vehicle was: the track starts at 0, 0" in said
    assert (float(first[1]), float(first[2])) == (0.0, 0.0)
    assert "nothing to start from" in placed  # a map on which the vehicle is nowhere


def test_without_usbl_a_stated_start_or_gps_at_the_surface_will_do(log: Path) -> None:
    own = log.with_name("dive.usbldr.toml").read_text(encoding="utf-8")
    started = log.with_name("started.toml")
    started.write_text(f"{own}\n[start]\neast_m = 300.0\nnorth_m = -200.0\nsd_m = 1.0\n", encoding="utf-8")

    for options in (("--config", str(started)), ("--aid", "gps@0:10")):
        said = replayed(log, "-f", "adf", *options)
        assert said.startswith("adf: mean horizontal error 0.")  # metres
    assert replayed(log, "-f", "dr", "--dr-from", "first-gps").startswith("dr: mean horizontal error 0.")


@pytest.mark.parametrize("name", ["ekf", "ukf", "adf"])
def test_without_fixes_a_compass_shows_nothing_of_its_deviation(name: str) -> None:
    """The vehicle turns less than the motion model allows: that is no sign that the compass turns too little."""
    parameters = replace(ASSUMED, start=Start(*DIVE.fix_m[0], sd_m=1.0), calibrate=("heading", "deviation"))
    track = run(name, DIVE.with_fixes(DIVE.fix_time_s < 20.0), parameters)
    assert track.cov is not None
    rows = [track.names.index(error) for error in ("deviation_sin", "deviation_cos")]
    later = np.flatnonzero(track.time_s > 25.0)

    errors = track.mean[later][:, rows]
    sds = np.sqrt(track.cov[later][:, rows, rows])
    moved_m = np.diff(track.position_m[later[[0, -1]]], axis=0)[0]
    reckoned_m = np.diff(displacement_m(DIVE)[later[[0, -1]]], axis=0)[0]

    np.testing.assert_allclose(errors, np.broadcast_to(errors[0], errors.shape), atol=1e-9)
    np.testing.assert_allclose(sds, np.broadcast_to(sds[0], sds.shape), rtol=1e-9)
    turned = np.degrees(np.abs(np.angle(complex(*moved_m) / complex(*reckoned_m))))
    assert turned < 4.0
