"""``--calibrate auto``: what a log can tell of its sensors, on dives whose faults are known."""

from dataclasses import replace

import numpy as np
import pytest

from usbldr.filters.identification.identification import Identification
from usbldr.filters.identification.observability import CANDIDATE_KEYS, MAX_SIGMA_RATIO, _best, _NoiseModel, identify
from usbldr.filters.models.noise import Contamination, Gaussian, Mixture
from usbldr.filters.models.parameters import Parameters, ProcessNoise, Start
from usbldr.filters.replay.run import run
from usbldr.filters.types import Timeline
from weaving import SD_M, Faults, weaving_dive

ASSUMED = Parameters(process=ProcessNoise(0.005, 0.001, 0.02, 0.02), usbl=Gaussian(), start=Start(0.0, 0.0, 0.05))
TWENTY_TO_ONE = np.log(20)  # what Kass and Raftery call strong


def verdicts(found: Identification) -> dict[str, str]:
    return {told.key: told.conclusion for told in found.observed}


def test_on_a_weaving_dive_every_constant_error_is_observable_even_where_it_is_0() -> None:
    found = identify(weaving_dive(Faults()), ASSUMED)
    told = found.parameters

    assert verdicts(found) == {**dict.fromkeys(CANDIDATE_KEYS, "observable"), "usbl-bias": "not observable"}
    assert told.calibrate == ("scale", "heading", "deviation", "latency")
    assert told.usbl_sd_scale == 1.0
    assert told.process == replace(ASSUMED.process, velocity_mps=told.process.velocity_mps)


def test_a_straight_dive_at_constant_speed_tells_scale_and_heading_alone() -> None:
    unknown = replace(ASSUMED, start=Start(0.0, 0.0, 3.0))  # a known one would tell the latency by the first fixes
    found = identify(weaving_dive(Faults(), weaves=False), unknown)
    told = found.parameters

    assert told.calibrate == ("scale", "heading")
    assert verdicts(found)["latency"] == verdicts(found)["deviation"] == "only in turns"


def test_how_far_each_sigma_is_narrowed_is_what_the_filter_will_say() -> None:
    line = weaving_dive(Faults(dvl_scale=0.01, heading_bias_deg=3.0))
    found = identify(line, ASSUMED)
    told = found.parameters
    track = run("adf", line, told)

    assert track.cov is not None
    first = {"scale": ("dvl_scale", 0.01), "heading": ("heading_bias", np.radians(5)), "latency": ("usbl_latency", 0.3)}
    for one in found.observed:
        if one.key in first:
            name, before = first[one.key]
            row = track.names.index(name)
            assert one.sigma_ratio == pytest.approx(float(np.sqrt(track.cov[-1, row, row])) / before, rel=0.3)
            assert one.sigma_ratio < MAX_SIGMA_RATIO


def test_late_stamps_open_the_latency_and_good_ones_do_not() -> None:
    late, good = (
        identify(weaving_dive(Faults(usbl_latency_s=latency_s)), ASSUMED).parameters for latency_s in (-1.8, 0.1)
    )

    assert late.errors.latency_s == 1.0
    assert good.errors.latency_s == ASSUMED.errors.latency_s


def test_fixes_that_err_alike_share_their_variance_and_white_ones_do_not() -> None:
    """The stated sigma is the whole error: what is taken for shared is no longer white."""
    sd_m = np.hypot(SD_M, 0.5)
    wandering = weaving_dive(Faults(), wander_m=0.5 * np.sqrt(2))
    wandering = replace(wandering, fix_cov_m2=np.tile(sd_m**2 * np.eye(2), (len(wandering.fix_time_s), 1, 1)))

    told = identify(wandering, ASSUMED).parameters

    assert told.errors.usbl_bias_m**2 + (told.usbl_sd_scale * sd_m) ** 2 == pytest.approx(sd_m**2)
    assert told.usbl_sd_scale * sd_m == pytest.approx(SD_M, rel=0.3)
    assert "usbl-bias" in told.calibrate
    assert "usbl-bias" not in identify(weaving_dive(Faults()), ASSUMED).parameters.calibrate


def test_what_is_observed_makes_the_track_better() -> None:
    line = weaving_dive(Faults(dvl_scale=0.02, heading_bias_deg=4.0, usbl_latency_s=0.7))
    clean = run("adf", weaving_dive(Faults()), ASSUMED)

    plain, told = run("adf", line, ASSUMED), run("adf", line, identify(line, ASSUMED).parameters)

    off = [np.hypot(*(track.position_m - clean.position_m)[500:].T).mean() for track in (plain, told)]
    assert off[1] < 0.5 * off[0]


def test_without_fixes_nothing_is_told() -> None:
    line = weaving_dive(Faults())

    found = identify(line.with_fixes(np.arange(0)), replace(ASSUMED, calibrate=("scale",)))
    told = found.parameters

    assert told.calibrate == ()
    assert set(verdicts(found).values()) == {"not observable"}


def scattering(line: Timeline, sd_mps: float, walk_mps: float = 0.02) -> Timeline:
    """Return the dive with velocities that walk by so much in a second and scatter so far, whatever they state."""
    rng = np.random.default_rng(6)
    walk = np.cumsum(walk_mps * np.sqrt(0.2) * rng.standard_normal((len(line.time_s), 2)), axis=0)
    return replace(line, dvl_mps=walk + sd_mps * rng.standard_normal(walk.shape))


@pytest.mark.parametrize("fixes", [True, False])
def test_records_that_scatter_more_than_they_state_are_trusted_less(fixes: bool) -> None:
    """Some 2000 records of two axes tell a sigma to 2 %."""
    line = weaving_dive(Faults()) if fixes else weaving_dive(Faults()).with_fixes(np.arange(0))

    found = identify(scattering(line, 3.0 * float(line.dvl_sd_mps[0])), ASSUMED)
    told = found.parameters

    assert told.dvl_sd_scale == pytest.approx(3.0, rel=0.06)
    assert ("dvl_sd_scale", 1.0, told.dvl_sd_scale) in found.noise_changes
    assert found.tuned == ()


def test_records_that_scatter_less_than_they_state_are_trusted_no_more() -> None:
    line = weaving_dive(Faults())

    assert identify(scattering(line, 0.3 * float(line.dvl_sd_mps[0])), ASSUMED).parameters.dvl_sd_scale == 1.0


def test_how_fast_a_vehicle_changes_its_velocity_is_heard_where_it_is_not_as_assumed() -> None:
    line = weaving_dive(Faults())
    sd_mps = float(line.dvl_sd_mps[0])

    calm, usual = (identify(scattering(line, sd_mps, walk_mps), ASSUMED) for walk_mps in (0.002, 0.02))

    assert calm.parameters.process.velocity_mps == pytest.approx(0.002, rel=0.5)
    assert ("velocity_walk_mps", 0.02, calm.parameters.process.velocity_mps) in calm.noise_changes
    assert usual.parameters.process == ASSUMED.process
    assert usual.noise_changes == usual.warnings == ()


def test_a_few_records_change_nothing() -> None:
    line = weaving_dive(Faults())
    line = scattering(line, 1.5 * float(line.dvl_sd_mps[0]))
    few = replace(line, dvl_count=np.where(np.arange(len(line.time_s)) < 4, line.dvl_count, 0))

    assert identify(few, ASSUMED).parameters.dvl_sd_scale == 1.0
    assert identify(line, ASSUMED).parameters.dvl_sd_scale > 1.4


def test_fixes_that_err_alike_for_long_are_taken_for_such_and_the_run_says_so() -> None:
    """A first-order Gauss-Markov error of 240 s; the usual 60 s are kept where they are right."""
    rng = np.random.default_rng(4)

    def wandering(line: Timeline, time_s: float) -> Timeline:
        fade = float(np.exp(-1.0 / time_s))  # a fix each second
        error = np.zeros((len(line.fix_time_s), 2))
        for k in range(1, len(error)):
            error[k] = fade * error[k - 1] + np.sqrt(1 - fade**2) * rng.normal(0.0, SD_M, 2)
        return replace(line, fix_m=line.fix_m + error, fix_cov_m2=2 * line.fix_cov_m2)

    long, usual = (identify(wandering(weaving_dive(Faults()), time_s), ASSUMED) for time_s in (240.0, 60.0))

    assert long.parameters.errors.usbl_bias_s > 60.0
    assert ("usbl_bias_time_s", 60.0, long.parameters.errors.usbl_bias_s) in long.noise_changes
    assert usual.parameters.errors.usbl_bias_s == 60.0


@pytest.mark.parametrize(("share", "expected"), [(0.05, 0.05), (0.3, 0.2)])
def test_the_log_says_how_many_of_its_fixes_are_outliers_where_it_speaks_strongly(
    share: float, expected: float
) -> None:
    rng = np.random.default_rng(5)
    line = weaving_dive(Faults())
    gross = rng.random(len(line.fix_time_s)) < share
    lying = replace(line, fix_m=line.fix_m + gross[:, None] * rng.normal(0.0, 10.0, (len(gross), 2)))

    told = identify(lying, replace(ASSUMED, usbl=Contamination())).parameters

    assert isinstance(told.usbl, Contamination)
    assert told.usbl.share == pytest.approx(expected) if share == 0.05 else told.usbl.share >= expected


def test_dead_reckoning_that_does_not_reckon_is_no_longer_trusted() -> None:
    """A DVL that hears the water below it and not the ground: for half of the dive the vehicle seems to lie still."""
    line = weaving_dive(Faults())
    deaf = replace(line, dvl_mps=line.dvl_mps.copy())
    deaf.dvl_mps[len(line.time_s) // 2 :] = 0.0
    deaf = replace(deaf, dr_mps=deaf.dvl_mps)
    assumed = replace(ASSUMED, usbl=Contamination())
    clean = run("adf", line, assumed)

    found = identify(deaf, assumed)
    told = found.parameters
    tracks = [run("adf", deaf, one) for one in (told, replace(told, process=assumed.process))]

    last = np.searchsorted(line.fix_time_s, line.time_s, side="right") - 1  # fix at each epoch: what is left to know
    late = line.time_s > line.time_s[-1] / 2
    held_m, told_m, trusting_m = (
        float(np.hypot(*(position - clean.position_m)[late].T).mean())
        for position in (line.fix_m[last], *(track.position_m for track in tracks))
    )
    assert ("position_walk_m", assumed.process.position_m, told.process.position_m) in found.noise_changes
    assert told_m < 1.1 * held_m
    assert trusting_m > 10 * held_m
    assert any("bottom lock" in said for said in found.warnings)


def test_fixes_that_scatter_more_than_they_state_are_no_fault_of_dead_reckoning() -> None:
    line = weaving_dive(Faults())
    boasting = replace(line, fix_cov_m2=line.fix_cov_m2 / 9)

    told = identify(boasting, replace(ASSUMED, usbl=Contamination())).parameters

    assert told.process.position_m == ASSUMED.process.position_m


@pytest.mark.parametrize(
    ("lead", "best"), [(-100.0, 1), (0.9 * TWENTY_TO_ONE, 1), (1.1 * TWENTY_TO_ONE, 0), (100.0, 0)]
)
def test_drift_is_dropped_where_wider_fixes_are_the_better_story_by_far_and_these_are_no_choice(
    lead: float, best: int
) -> None:
    among = [
        _NoiseModel(ASSUMED),
        _NoiseModel(ASSUMED, 1, inflates_dr_walk=True),
        _NoiseModel(ASSUMED, 1, inflates_usbl_sd=True),
    ]

    assert _best(among, np.array([0.0, 50.0, 50.0 + lead])) == best


@pytest.mark.parametrize(("departs", "lead", "best"), [(1, 0.9, 0), (1, 1.1, 1), (2, 1.9, 0), (2, 2.1, 1)])
def test_each_departure_from_what_is_assumed_takes_a_strong_word(departs: int, lead: float, best: int) -> None:
    among = [_NoiseModel(ASSUMED), _NoiseModel(ASSUMED, departs)]

    assert _best(among, np.array([0.0, lead * TWENTY_TO_ONE])) == best


def test_a_stated_family_of_noise_is_kept() -> None:
    mixture = Mixture(0.3, 100.0)

    assert identify(weaving_dive(Faults()), replace(ASSUMED, usbl=mixture)).parameters.usbl == mixture
