"""Before the first fix: the track begins with the log, and its sigmas know how little that is based on."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from commands import output_of
from logs import refusal
from usbldr.filters.errors import LogError
from usbldr.filters.evaluation.consistency import nees
from usbldr.filters.models.calibration import layout_for
from usbldr.filters.models.noise import Gaussian
from usbldr.filters.models.parameters import Parameters, SensorErrors
from usbldr.filters.replay.methods import METHODS, FilterSettings
from usbldr.filters.replay.prior import prior
from usbldr.filters.replay.run import run
from usbldr.filters.types import Array, Timeline, Trajectory
from weaving import SD_M, Faults, weaving_dive


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
        "use GPS fixes at the surface (--aid gps@FROM:TO); without fixes this is dead reckoning: --filter dr needs no "
        "start"
    )

    said = refusal(LogError, replayed, log, "-f", "dr")
    assert "nothing to start from: give --dr-from first-gps or LAT,LON, or state [start]" in said


def test_without_usbl_a_stated_start_or_gps_at_the_surface_will_do(log: Path) -> None:
    own = log.with_name("dive.usbldr.toml").read_text(encoding="utf-8")
    started = log.with_name("started.toml")
    started.write_text(f"{own}\n[start]\neast_m = 300.0\nnorth_m = -200.0\nsd_m = 1.0\n", encoding="utf-8")

    for options in (("--config", str(started)), ("--aid", "gps@0:10")):
        said = replayed(log, "-f", "adf", *options)
        assert said.startswith("adf: mean horizontal error 0.")  # metres
    assert replayed(log, "-f", "dr", "--dr-from", "first-gps").startswith("dr: mean horizontal error 0.")
