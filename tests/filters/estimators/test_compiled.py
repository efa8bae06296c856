"""The compiled kernel against the NumPy reference, which owes it nothing: equal for every filter, state and noise.

The kernel of other compilers and of ARM is held against the one that is installed, on the calls of some runs. ARM is
emulated (Debian: gcc-aarch64-linux-gnu and qemu-user). Its logarithms and error functions come from another library of
mathematics, which may round the last digit otherwise.
"""

import math
import shutil
import struct
import subprocess
import tomllib
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from checkout import ROOT
from needed_kernel import require_kernel
from usbldr.filters.errors import LogError
from usbldr.filters.estimators import compiled
from usbldr.filters.estimators.compiled import CompiledFilter, Doubt
from usbldr.filters.estimators.cpf import CubatureParticleFilter
from usbldr.filters.estimators.encoding import seed_words
from usbldr.filters.estimators.hypotheses import hypothesis_likelihoods, usbl_measurements
from usbldr.filters.estimators.kalman import KalmanFilter
from usbldr.filters.estimators.mode_updates import moment_matched
from usbldr.filters.estimators.multi_hypothesis import MultiHypothesisFilter
from usbldr.filters.estimators.protocol import Prior, SeededRng, Step
from usbldr.filters.kernel import KERNEL, Kernel
from usbldr.filters.models.calibration import STATES, layout_for
from usbldr.filters.models.motion import VehicleMotion
from usbldr.filters.models.noise import Contamination, Gaussian, Mixture, Noise, NoiseFamily, StudentT
from usbldr.filters.models.parameters import Parameters, ProcessNoise, Start
from usbldr.filters.models.sensors import DeviatingCompass, compass_model
from usbldr.filters.models.sigma_points import linearised
from usbldr.filters.models.states import StateLayout
from usbldr.filters.replay.methods import METHODS, FilterSettings
from usbldr.filters.replay.prior import prior
from usbldr.filters.replay.run import make_estimator, run
from usbldr.filters.replay.steps import sensor_kinds, steps, vehicle_motion
from usbldr.filters.types import Array, Timeline, Trajectory
from usbldr.filters.updates import UpdateTable
from weaving import Faults, weaving_dive

require_kernel()

NUMPY = Kernel("numpy", "as the test says")
EVERYTHING = tuple(STATES)
FAMILIES = [Gaussian(), Mixture(), Mixture(per_scalar=False), Contamination(), StudentT()]


def dive() -> Timeline:
    """Twenty seconds with an offset for each fix, a gap of the DVL, outliers, and GPS at the end."""
    line = weaving_dive(Faults(0.01, 2.0, 1.0, 2.0, 1.0, 0.3, 0.1, -0.2), seconds=20)
    rng = np.random.default_rng(0)
    fix_m, in_gap = line.fix_m.copy(), (line.time_s > 6) & (line.time_s < 12)
    fix_m[rng.integers(0, len(fix_m), 5)] += 8.0
    gps_m = line.fix_m[-5:] + 0.5
    return replace(
        line,
        fix_time_s=line.fix_time_s - 0.07,
        fix_m=fix_m,
        fix_cov_m2=line.fix_cov_m2 + np.array([[0.2, 0.1], [0.1, 0.3]]),
        dvl_count=np.where(in_gap, 0, line.dvl_count),
        gps_time_s=line.fix_time_s[-5:],
        gps_m=gps_m,
    )


LINE = dive()
PARAMETERS = Parameters(
    usbl_lever_m=(0.5, -1.0, 0.0),
    dvl_lever_m=(0.3, 0.8, 0.0),
    aid=((14.0, 20.0),),
    process=ProcessNoise(position_m=0.1),
)


def assert_equal(name: str, parameters: Parameters, settings: FilterSettings, line: Timeline = LINE) -> Trajectory:
    """Run both, compare everything that a track holds, and return the kernel's."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(compiled, "KERNEL", NUMPY)
        want = run(name, line, parameters, settings)
    got = run(name, line, parameters, settings)

    assert want.cov is not None
    assert got.cov is not None
    np.testing.assert_allclose(got.mean, want.mean, rtol=0, atol=1e-9)
    np.testing.assert_allclose(got.cov, want.cov, rtol=1e-9, atol=1e-9)
    assert (got.ess is None) == (want.ess is None) == (want.acceptance is None)
    if got.ess is not None and want.ess is not None:
        np.testing.assert_allclose(got.ess, want.ess, rtol=1e-8)
        np.testing.assert_array_equal(got.acceptance, want.acceptance)
    for one, other in zip(got.updates, want.updates, strict=True):
        for a, b in zip(one.parts, other.parts, strict=True):
            mine, theirs = ((u.sensor, u.axis, u.row, u.time_s, u.dof, u.outcome) for u in (a, b))
            assert mine == theirs
            assert (a.shift is None) == (b.shift is None)
            for name in ("innovation", "innovation_sd", "nominal_sd", "scores", "nominal_probability", "nis"):
                np.testing.assert_allclose(getattr(a, name), getattr(b, name), rtol=1e-8, atol=1e-9)
            np.testing.assert_allclose(a.shift or (), b.shift or (), rtol=1e-8, atol=1e-9)
    return got


@pytest.mark.parametrize("calibrate", [(), *((key,) for key in STATES), EVERYTHING], ids="+".join)
@pytest.mark.parametrize("name", ["ekf", "ckf", "ukf", "adf", "cpf"])
def test_every_state_gives_the_same_track(name: str, calibrate: tuple[str, ...]) -> None:
    assert_equal(name, replace(PARAMETERS, calibrate=calibrate), FilterSettings(particles=11, guard=False))


@pytest.mark.parametrize("family", [*FAMILIES, Gaussian(per_scalar=False)], ids=repr)
@pytest.mark.parametrize("name", ["ckf", "adf", "upf"])
def test_every_noise_family_gives_the_same_track(name: str, family: NoiseFamily) -> None:
    parameters = replace(PARAMETERS, dvl=family, compass=family, usbl=family, calibrate=("scale", "usbl-bias"))
    assert_equal(name, parameters, FilterSettings(particles=17, guard=False))


@pytest.mark.parametrize("name", ["adf", "cpf"])
@pytest.mark.parametrize("settings", [FilterSettings(particles=20), FilterSettings(particles=20, order="arrival")])
def test_hypotheses_and_late_fixes_give_the_same_track(name: str, settings: FilterSettings) -> None:
    line = replace(LINE, fix_received_s=LINE.fix_time_s + np.random.default_rng(1).uniform(0, 5, len(LINE.fix_time_s)))
    assert_equal(name, replace(PARAMETERS, calibrate=("scale",)), settings, line)


@pytest.mark.parametrize("seconds", [8, 3])
@pytest.mark.parametrize("family", FAMILIES, ids=repr)
def test_a_cluster_after_an_outage_stops_the_kernel_for_the_same_hypotheses(family: NoiseFamily, seconds: int) -> None:
    """Fixes whose axes are taken together and in sequence, at their epochs and between them."""
    out = (LINE.fix_time_s > 4) & (LINE.fix_time_s < 8)
    cluster = (LINE.fix_time_s >= 8) & (LINE.fix_time_s < 8 + seconds)
    fix_m = np.where(cluster[:, None], LINE.fix_m + 60.0, LINE.fix_m)
    coupled = np.where(np.arange(len(fix_m)) % 2, 1.0, 0.0)[:, None, None] * np.array([[0, 0.1], [0.1, 0]])
    cov_m2 = LINE.fix_cov_m2 * np.eye(2) + coupled
    at_epochs = np.where(np.arange(len(fix_m)) % 3, LINE.fix_time_s, np.round(LINE.fix_time_s * 5) / 5)
    line = replace(LINE, fix_m=fix_m, fix_cov_m2=cov_m2, fix_time_s=at_epochs).with_fixes(~out)
    parameters = Parameters(usbl=family, process=ProcessNoise(position_m=0.1))

    alone, guarded = (assert_equal("adf", parameters, FilterSettings(guard=on), line) for on in (False, True))

    assert alone.cov is not None
    assert guarded.cov is not None
    assert not np.array_equal(alone.cov, guarded.cov)


@pytest.mark.parametrize("family", FAMILIES, ids=repr)
@pytest.mark.parametrize("offset_s", [0.0, 0.07])
def test_the_kernel_stops_before_the_fixes_that_call_for_hypotheses_and_no_others(family: NoiseFamily, offset_s: float):
    """Each fix is off by another distance, so that some are just near enough."""
    epochs_s = np.round(LINE.fix_time_s * 5) / 5
    off_m = np.linspace(0, 12, len(epochs_s))[:, None] * [[1.0, -0.3]]
    by_axis_m2, stamps_s = LINE.fix_cov_m2 * np.eye(2), epochs_s - offset_s
    line = replace(LINE, fix_time_s=stamps_s, fix_m=LINE.fix_m + off_m, fix_cov_m2=by_axis_m2)
    parameters, layout = Parameters(usbl=family), StateLayout()
    motion = vehicle_motion(line, parameters, layout)
    guard = make_estimator(METHODS["adf"], motion, FilterSettings(), parameters)
    assert isinstance(guard, MultiHypothesisFilter)
    kernel, linear = guard.filter, KalmanFilter(motion, linearised, moment_matched)
    assert isinstance(kernel, CompiledFilter)
    every, belief = steps(line, parameters, layout), kernel.start(prior(line, parameters, layout))

    stops = 0
    for k, step in enumerate(every):
        if fixes := usbl_measurements(step):
            before = linear.start(Prior(belief.estimate.mean, belief.estimate.cov))
            bank = linear.step(before, step._replace(measurements=()), SeededRng(0, 0)).bank
            reported = hypothesis_likelihoods(bank, fixes, guard.outlier_noise)
            log_relocation = math.log(0.05)
            calls = reported.informative or log_relocation + reported.relocated > reported.inlier
            doubt = Doubt(np.array([log_relocation]), guard.outlier_noise.sd**2)
            _, run_on = kernel.span_until(belief, every, range(k, k + 1), 0, doubt)
            assert len(run_on.mean) == (not calls)
            stops += calls
        belief = kernel.step(belief, step, SeededRng(0, step.epoch))
    assert 2 < stops < 0.9 * len(line.fix_time_s)


@pytest.mark.parametrize("name", ["ukf", "adf", "cpf"])
def test_steps_as_columns_give_the_numbers_of_the_steps_one_by_one(name: str) -> None:
    parameters = replace(PARAMETERS, dvl=Mixture(), usbl=StudentT(), calibrate=("scale", "latency"))
    layout, settings = layout_for(parameters.calibrate), FilterSettings(particles=9, guard=False)
    motion = vehicle_motion(LINE, parameters, layout)
    kernel = make_estimator(METHODS[name], motion, settings, parameters)
    assert isinstance(kernel, CompiledFilter)
    every, at_start = steps(LINE, parameters, layout), prior(LINE, parameters, layout)

    belief, at_once = kernel.span(kernel.start(at_start), every, range(len(every)), seed=3)
    one_by_one = [kernel.start(at_start)]
    for step in every:
        one_by_one.append(kernel.step(one_by_one[-1], step, SeededRng(3, step.epoch)))

    np.testing.assert_array_equal(at_once.mean, [one.estimate.mean for one in one_by_one[1:]])
    np.testing.assert_array_equal(at_once.cov, [one.estimate.cov for one in one_by_one[1:]])
    np.testing.assert_array_equal(belief.state, one_by_one[-1].state)
    assert belief.past == one_by_one[-1].past
    assert at_once.updates == [update for one in one_by_one[1:] for update in one.estimate.updates]


AWAY_M = np.linspace(0, 40, len(LINE.fix_m))[:, None]
CLUSTER_M = np.where((LINE.fix_time_s >= 8) & (LINE.fix_time_s < 11), 60.0, 0.0)[:, None]


@pytest.mark.parametrize(
    ("name", "parameters", "smooth", "off_m", "outcome"),
    [
        ("afukf", PARAMETERS, False, AWAY_M, "used"),
        ("aekf", PARAMETERS, False, AWAY_M, "used"),
        ("adf", PARAMETERS, True, 0.0, "used"),
        ("adf", Parameters(), False, CLUSTER_M, "rejected"),
    ],
    ids=["afukf", "aekf", "smoothing", "a refused cluster"],
)
def test_inflation_smoothing_and_refusals_give_the_same_track(name, parameters, smooth, off_m, outcome):
    line = replace(LINE, fix_m=LINE.fix_m + off_m)
    track = assert_equal(name, parameters, FilterSettings(smooth=smooth), line)
    assert outcome in UpdateTable.of(track.updates).outcome


@pytest.mark.parametrize("name", ["ukf", "cpf"])
def test_a_vehicle_without_compass_gives_the_same_track(name: str) -> None:
    """The yaw grows so uncertain that the transform is linearised, for some particles before others."""
    blind = replace(LINE, yaw_count=np.where(LINE.time_s < 2, LINE.yaw_count, 0))
    fast = replace(PARAMETERS, process=ProcessNoise(yaw_rad=0.5), calibrate=("current",))
    track = assert_equal(name, fast, FilterSettings(particles=12, guard=False), blind)
    assert track.cov[:, 0, 0].max() > np.pi**2 / 4 / 3


@pytest.mark.parametrize("particles", [1, 2, 7, 8, 9, 100])
def test_any_number_of_particles_is_resampled_alike(particles: int) -> None:
    noisy = replace(PARAMETERS, dvl=Mixture(), compass=Mixture(), usbl=Mixture(), calibrate=("scale",))
    track = assert_equal("cpf", noisy, FilterSettings(particles=particles, guard=False))
    assert track.acceptance is not None
    assert particles <= 2 or np.isfinite(track.acceptance).any()  # the effective size of two is never below half


def test_all_variants_give_the_same_numbers_to_the_bit(monkeypatch: pytest.MonkeyPatch) -> None:
    from usbldr.filters.kernel import _kernel

    parameters = replace(PARAMETERS, dvl=Mixture(), calibrate=("scale", "misalignment", "usbl-bias", "latency"))
    tracks: list[Trajectory] = []
    for name, variant in _kernel.VARIANTS:
        monkeypatch.setattr(compiled, "KERNEL", KERNEL._replace(name=name, variant=variant))
        tracks.append(run("cpf", LINE, parameters, FilterSettings(particles=21)))

    for track in tracks[1:]:
        np.testing.assert_array_equal(track.mean, tracks[0].mean)
        np.testing.assert_array_equal(track.cov, tracks[0].cov)


@pytest.mark.parametrize(("seed", "epoch"), [(0, 0), (1, 5000), (2**32 + 5, 7), (2**63, 3), (2**100, 9)])
def test_any_seed_gives_the_numbers_of_numpy(seed: int, epoch: int) -> None:
    """The last seed has more words than the kernel takes: it gets the state of the generator."""
    assert (seed_words(seed, epoch) is None) == (seed > 2**64)
    settings = FilterSettings(particles=9, seed=seed, guard=False)
    noisy = replace(PARAMETERS, dvl=Mixture(), compass=Mixture(), usbl=Mixture())
    assert_equal("cpf", noisy, settings)


def test_a_singular_covariance_is_one_sentence() -> None:
    start = Start(0.0, 0.0, 1e-200)
    frozen = replace(LINE, fix_cov_m2=np.zeros_like(LINE.fix_cov_m2))
    still = ProcessNoise(0.0, 0.0, 0.0, 0.0)
    with pytest.raises(LogError, match="start"):
        run("ekf", frozen, Parameters(start=start, process=still, usbl=Gaussian()), FilterSettings(guard=False))


def test_the_belief_before_a_step_stays_as_it_was() -> None:
    motion = VehicleMotion(layout_for(()), ProcessNoise())
    kernel = compiled.compiled(KalmanFilter(motion, linearised, moment_matched), ())
    assert isinstance(kernel, CompiledFilter)
    before = kernel.start(Prior(np.arange(6.0), np.eye(6)))
    kept = before.state.copy()

    after = kernel.step(before, Step(1, 0.0, 1.0, ()), SeededRng(0, 1))

    np.testing.assert_array_equal(before.state, kept)
    assert not np.array_equal(after.state, kept)


@dataclass(frozen=True)
class ManyModes:
    """A noise family of one's own: twelve modes, all alike, so that the track is that of a Gaussian."""

    per_scalar: bool = True

    def modes(self, R: Array) -> Noise:
        return Noise(np.full(12, 1 / 12), np.repeat(R[None], 12, axis=0), self.per_scalar)


class OwnCompass(DeviatingCompass):
    """A sensor model of one's own."""


def test_noise_of_more_modes_than_the_kernel_holds_runs_in_numpy() -> None:
    few, many = (run("ekf", LINE, replace(PARAMETERS, usbl=family)) for family in (Gaussian(), ManyModes()))

    np.testing.assert_allclose(many.mean, few.mean, rtol=0, atol=1e-9)


def test_moves_of_more_steps_than_the_kernel_holds_run_in_numpy() -> None:
    method = METHODS["cpf"]
    assert method.build is not None
    parameters, layout = PARAMETERS, layout_for(())
    motion = vehicle_motion(LINE, parameters, layout)
    deep = method.build(motion, FilterSettings(particles=9))
    assert isinstance(deep, CubatureParticleFilter)
    deep = replace(deep, move_steps=5)

    assert compiled.compiled(deep, sensor_kinds(parameters, layout)) is deep


def test_a_sensor_model_of_ones_own_runs_in_numpy() -> None:
    layout = layout_for(("heading", "deviation"))
    motion = VehicleMotion(layout, ProcessNoise())
    estimator = KalmanFilter(motion, linearised, moment_matched)
    known = compass_model(layout)
    assert isinstance(known, DeviatingCompass)
    own = OwnCompass(**{field.name: getattr(known, field.name) for field in fields(known)})

    assert isinstance(compiled.compiled(estimator, [(known, Gaussian())]), CompiledFilter)
    assert compiled.compiled(estimator, [(own, Gaussian())]) is estimator


SOURCES = ROOT / "filters" / "kernel"
FLAGS = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["setuptools"]["ext-modules"][0]
MACHINES = {
    "ARM": (("aarch64-linux-gnu-gcc", "-static"), ("qemu-aarch64",)),
    "clang": (("clang",), ()),
    "one number at a time": (("gcc", "-DONE_AT_A_TIME"), ()),
}


class Recorder:
    """Runs the installed kernel, and keeps what it was given and what it returned."""

    def __init__(self) -> None:
        self.calls, self.answers = bytearray(), bytearray()

    def __call__(self, *given: Any) -> int:
        assert KERNEL.advance is not None
        _, settings, past, count, steps, readings, log_relocation, outlier_m2, *changed = given
        watched = b"" if log_relocation is None else log_relocation
        blocks = [bytes(block) for block in (settings, steps, readings, watched, *changed)]
        self.calls += struct.pack("=9qd", *map(len, blocks), past, count, outlier_m2) + b"".join(blocks)
        done = KERNEL.advance(*given)
        self.answers += struct.pack("=q", done) + b"".join(
            map(bytes, changed[1:])
        )  # the unused places of a bank differ
        return done


@pytest.fixture(scope="module")
def recorded() -> Recorder:
    """Hypotheses, resampling, a gap of the DVL, all kinds of states and sigma points."""
    require_kernel()
    line, found = weaving_dive(Faults(0.01, 2.0, 1.0, 2.0, 1.0, 0.3, 0.1, -0.2), seconds=12), Recorder()
    line = replace(line, dvl_count=np.where((line.time_s > 4) & (line.time_s < 9), 0, line.dvl_count))
    parameters = Parameters(usbl_lever_m=(0.5, -1.0, 0.0), dvl=Mixture(), usbl=StudentT())
    errors = ("scale", "misalignment", "heading", "deviation", "latency", "usbl-bias", "current")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(compiled, "KERNEL", KERNEL._replace(advance=found))
        for name in ("ekf", "adf", "cpf"):
            run(name, line, replace(parameters, calibrate=errors), FilterSettings(particles=11))
        run("upf", line, parameters, FilterSettings(particles=40, guard=False))
    return found


@pytest.mark.parametrize("machine", MACHINES)
def test_another_machine_gives_the_same_numbers(machine: str, recorded: Recorder, tmp_path: Path) -> None:
    (compiler, *options), emulator = MACHINES[machine]
    if missing := [tool for tool in (compiler, *emulator) if shutil.which(tool) is None]:
        pytest.skip(f"{machine}: {' and '.join(missing)} not installed")
    program = str(tmp_path / "driver")
    files = [str(ROOT / "tests" / "support" / "kernel_driver.c"), str(SOURCES / "variant_portable.c")]
    flags = [*FLAGS["extra-compile-args"], "-O1", f"-I{SOURCES}"]  # -O3 takes a minute more and changes no number
    subprocess.run([compiler, *options, *flags, *files, "-o", program, "-lm"], check=True)

    done = subprocess.run([*emulator, program], input=recorded.calls, capture_output=True, check=True)

    got, want = np.frombuffer(done.stdout), np.frombuffer(recorded.answers)
    rounding = 1e-12 if machine == "ARM" else 0.0
    np.testing.assert_allclose(got, want, rtol=rounding, atol=rounding)
