"""Errors of sensors: what is put into the records by hand comes out of a filter with its sign and in its unit."""

from dataclasses import replace

import numpy as np
import pytest

from usbldr.filters.errors import UsageError
from usbldr.filters.models.calibration import REPORTED_QUANTITIES, STATES, estimated_errors, layout_for
from usbldr.filters.models.motion import VehicleMotion
from usbldr.filters.models.noise import Gaussian
from usbldr.filters.models.parameters import Parameters, ProcessNoise, SensorErrors, Start
from usbldr.filters.models.sensors import dvl_models
from usbldr.filters.replay.methods import METHODS, FilterSettings
from usbldr.filters.replay.prior import prior
from usbldr.filters.replay.run import run
from usbldr.filters.types import Timeline
from weaving import SD_RAD, Faults, weaving_dive

ASSUMED = Parameters(
    process=ProcessNoise(0.005, 0.001, 0.02, 0.02), usbl=Gaussian(), start=Start(0.0, 0.0, 0.05), errors=SensorErrors()
)


def read_back(method: str, timeline: Timeline, *keys: str) -> dict[str, tuple[float, float]]:
    """Return value and sigma of every error at the end."""
    track = run(method, timeline, replace(ASSUMED, calibrate=keys), FilterSettings(particles=50))
    return {name: (float(value[-1]), float(sd[-1])) for name, _, value, sd in estimated_errors(track)}


@pytest.mark.parametrize(
    ("key", "faults"),
    [
        ("scale", Faults(dvl_scale=0.02)),
        ("misalignment", Faults(dvl_mount_deg=3.0)),
        ("heading", Faults(heading_bias_deg=4.0)),
        ("deviation", Faults(deviation_sin_deg=3.0, deviation_cos_deg=2.0)),
        ("latency", Faults(usbl_latency_s=0.5)),
        ("current", Faults(current_east_mps=0.2, current_north_mps=0.3)),
    ],
)
def test_what_a_sensor_reads_too_much_is_found_with_its_sign_and_unit(key: str, faults: Faults) -> None:
    reported = read_back("adf", weaving_dive(faults), key)

    assert set(reported) == {REPORTED_QUANTITIES[state].name for state in STATES[key]}
    for name, (value, sd) in reported.items():
        assert abs(value - getattr(faults, name)) < 4 * sd
        assert 0 < sd < getattr(faults, name) / 5


def test_the_current_is_a_random_walk_and_the_dvl_through_water_lacks_it() -> None:
    errors = SensorErrors(current_walk_mps=0.01)
    layout = layout_for(("scale", "misalignment", "current"))
    x = np.zeros((len(layout), 1))
    for name, value in {"psi": np.radians(-30.0), "v": 1.0, "current_east": 0.4, "current_north": 0.1}.items():
        x[layout.index(name)] = value
    x[layout.index("dvl_scale")] = 0.1

    starboard, forward = (model.predict(x).item() for model in dvl_models(layout, (0.0, 0.0, 0.0)))

    ahead, to_starboard = 0.4 * 0.5 + 0.1 * np.sqrt(0.75), 0.4 * np.sqrt(0.75) - 0.1 * 0.5  # heading 30 degrees
    assert (starboard, forward) == pytest.approx((-1.1 * to_starboard, 1.1 * (1.0 - ahead)))
    noise = VehicleMotion(layout, ProcessNoise(), errors).noise(3.0, 7.0)
    rows = layout.rows("current_east", "current_north")
    np.testing.assert_allclose(noise[list(rows)], 4 * 0.01**2)


@pytest.mark.parametrize("method", [name for name, method in METHODS.items() if method.is_filter])
def test_every_filter_takes_the_states(method: str) -> None:
    reported = read_back(method, weaving_dive(Faults(current_east_mps=0.3, current_north_mps=-0.2)), "current")
    assert reported["current_east_mps"][0] == pytest.approx(0.3, abs=0.02)
    assert reported["current_north_mps"][0] == pytest.approx(-0.2, abs=0.02)
    if method != "pf":
        reported = read_back(method, weaving_dive(Faults(dvl_scale=0.02, heading_bias_deg=-4.0)), "scale", "heading")
        assert reported["dvl_scale"][0] == pytest.approx(0.02, abs=0.003)
        assert reported["heading_bias_deg"][0] == pytest.approx(-4.0, abs=0.3)


def test_a_particle_filter_carries_constants_as_gaussians_and_agrees_with_one() -> None:
    timeline = weaving_dive(Faults(dvl_scale=0.02, usbl_latency_s=0.4))
    assumed = replace(ASSUMED, calibrate=("scale", "latency"))

    sampled, gaussian = (
        estimated_errors(run(name, timeline, assumed, FilterSettings(particles=300))) for name in ("pf", "adf")
    )

    for (_, _, value, sd), (_, _, other, other_sd) in zip(sampled, gaussian, strict=True):
        assert sd[-1] == pytest.approx(other_sd[-1], rel=0.25)
        assert abs(value[-1] - other[-1]) < other_sd[-1]


def test_a_wandering_error_of_the_fixes_is_followed() -> None:
    timeline = weaving_dive(Faults(), wander_m=1.0)
    track = run("adf", timeline, replace(ASSUMED, calibrate=("usbl-bias",), errors=SensorErrors(usbl_bias_m=0.7)))

    at = np.interp(timeline.fix_time_s, track.time_s, np.arange(len(track.time_s))).astype(int)
    truth = np.column_stack([np.sin(timeline.fix_time_s / 40), np.cos(timeline.fix_time_s / 40)])
    for axis, (name, unit, value, sd) in enumerate(estimated_errors(track)):
        assert name == f"usbl_bias_{('east', 'north')[axis]}_m"
        assert unit == "m"
        assert np.corrcoef(value[at], truth[:, axis])[0, 1] > 0.8
        assert np.mean(np.abs(value[at] - truth[:, axis]) < 2 * sd[at]) > 0.85


def test_over_many_dives_the_errors_lie_as_far_off_as_the_filter_says() -> None:
    """The sum over 15 dives of 3 normalised squares is chi-square of 45: 20 to 81 in 998 of 1000 times."""
    rng = np.random.default_rng(7)
    steady = replace(ASSUMED, process=ProcessNoise(0.001, 1e-4, 0.05, 0.05), errors=SensorErrors(heading_walk_rad=0.0))
    total = 0.0
    for seed in range(15):
        faults = Faults(
            dvl_scale=float(rng.normal(0, 0.01)),
            heading_bias_deg=float(rng.normal(0, 5)),
            usbl_latency_s=float(rng.normal(0, 0.3)),
        )
        assumed = replace(steady, calibrate=("scale", "heading", "latency"))
        for name, _, value, sd in estimated_errors(run("adf", weaving_dive(faults, seed, seconds=200), assumed)):
            total += ((value[-1] - getattr(faults, name)) / sd[-1]) ** 2

    assert 20 < total < 81


def test_the_first_yaw_and_the_compass_errors_are_tied_to_what_the_compass_showed() -> None:
    timeline = weaving_dive(Faults())
    layout = layout_for(("heading", "deviation"))
    begin = prior(timeline, ASSUMED, layout)

    psi, b0, b_s, b_c = layout.rows("psi", "heading_bias", "deviation_sin", "deviation_cos")
    h = np.zeros(len(layout))  # what the compass shows
    h[[psi, b0, b_s, b_c]] = 1.0, 1.0, np.sin(timeline.yaw_rad[0]), np.cos(timeline.yaw_rad[0])
    assert np.sqrt(h @ begin.cov @ h) == pytest.approx(SD_RAD)
    assert np.sqrt(begin.cov[b0, b0]) == pytest.approx(np.radians(5))
    assert np.linalg.eigvalsh(begin.cov).min() > 0


def test_the_correlated_error_keeps_its_size_and_forgets_itself() -> None:
    errors = SensorErrors(usbl_bias_m=0.4, usbl_bias_s=30.0)
    layout = layout_for(("usbl-bias",))
    motion = VehicleMotion(layout, ProcessNoise(), errors)
    *_, (rows, decay) = motion.parts(0.0, 6.0)
    kept = 1 + decay.jacobian(np.zeros((len(layout), 1)))[0, 0, 0]

    assert rows == slice(6, 8)
    assert kept == pytest.approx(np.exp(-6 / 30))
    assert kept**2 * 0.16 + motion.noise(0.0, 6.0)[6] == pytest.approx(0.16)  # stationary


def test_an_unexplained_scale_widens_the_position_and_an_estimated_one_does_not() -> None:
    process = ProcessNoise(position_m=0.003, uncalibrated_m=0.004)

    assert VehicleMotion(layout_for(()), process).noise(0.0, 2.0)[4] == pytest.approx(2 * 0.005**2)
    assert VehicleMotion(layout_for(("scale",)), process).noise(0.0, 2.0)[4] == pytest.approx(2 * 0.003**2)


def test_an_error_that_is_unknown_or_that_the_filter_cannot_estimate_is_a_sentence() -> None:
    with pytest.raises(UsageError, match=r"'speed' to calibrate \(known: scale, misalignment"):
        layout_for(("speed",))
    with pytest.raises(UsageError, match="pf cannot estimate heading"):
        run("pf", weaving_dive(Faults()), replace(ASSUMED, calibrate=("scale", "heading")))


@pytest.mark.parametrize("method", ["ekf", "adf", "cpf"])
@pytest.mark.parametrize("key", ["scale", "deviation"])
def test_on_a_straight_course_a_sensor_tells_nothing_of_its_own_error(method: str, key: str) -> None:
    """No fix to speak of, no turn, and a process noise that is not the vehicle's: the error stays what it was."""
    timeline = weaving_dive(Faults(), seconds=200, weaves=False)
    hardly = replace(timeline, fix_cov_m2=1e8 * timeline.fix_cov_m2)
    assumed = Parameters(usbl=Gaussian(), start=Start(0.0, 0.0, 0.05), calibrate=(key,))

    for error in estimated_errors(run(method, hardly, assumed, FilterSettings(particles=20))):
        assert abs(error.value[-1]) < error.sd[0]
        assert np.max(np.abs(error.value)) < error.sd[0]
