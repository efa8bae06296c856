"""``--calibrate auto``: sensor errors and noise identified from dives whose faults are known."""

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest

from checkout import ROOT
from scored_runs import scored
from timelines import HZ
from usbldr.filters.identification.conclusions import Choice, explanations
from usbldr.filters.identification.evidence import _likeliest, _present, _score, identify, subsets_of
from usbldr.filters.identification.identification import (
    ErrorEstimate,
    Explanation,
    FalseRun,
    Identification,
    SensorErrorEvidence,
)
from usbldr.filters.identification.linearisation import (
    ARM,
    COMPASS_CLOCK,
    DVL_CLOCK,
    HEAD,
    KEYS,
    LEVER,
    PASS_STATES,
    RANGE,
    REPORTED,
    STEPS,
    linearised,
)
from usbldr.filters.identification.usbl_likelihood import FixLikelihoods, Member, kept_linearised
from usbldr.filters.models.noise import Gaussian, Mixture
from usbldr.filters.models.parameters import Parameters, ProcessNoise, SensorErrors, Start
from usbldr.filters.replay.run import run
from usbldr.filters.types import Timeline
from usbldr.io.reading.epochs import timeline
from usbldr.io.reading.read import Request, read_log
from usbldr.io.scenarios.shipped import find_scenario, read_scenario
from usbldr.io.scenarios.simulated_log import simulated_log
from weaving import DIVE, SD_M, Faults, apart_m, mean_nees, weaving_dive

ASSUMED = Parameters(process=ProcessNoise(0.005, 0.001, 0.02, 0.02), usbl=Gaussian(), start=Start(0.0, 0.0, 0.05))
CLEAN = run("adf", DIVE, ASSUMED)
OWN_KEYS = tuple(key for key in KEYS if key not in (HEAD, RANGE, ARM))  # of fixes without a head
SUBSETS = subsets_of(OWN_KEYS)


def chosen(score: np.ndarray, rows: Mapping[str, np.ndarray], *keys: str) -> Choice:
    likelihoods = FixLikelihoods(score, rows, rows, np.empty(0))
    return Choice(Member(ASSUMED, frozenset(keys)), 0, frozenset(), SUBSETS, score, likelihoods, frozenset())


def existing(found: Identification) -> set[str]:
    return {one.key for one in found.evidence if one.exists}


def test_a_dive_without_faults_has_evidence_against_every_sensor_error() -> None:
    found = identify(DIVE, ASSUMED)

    assert [one.key for one in found.evidence] == list(OWN_KEYS)
    assert existing(found) == set()
    assert all(one.log_odds < 0 for one in found.evidence)
    assert found.parameters.calibrate == ("usbl-bias",)
    assert found.warnings == ()
    assert found.parameters.errors.usbl_bias_m < ASSUMED.errors.usbl_bias_m  # the fixes share none


@pytest.mark.parametrize(
    ("faults", "key", "value"),
    [
        (Faults(dvl_scale=0.03), "scale", (0.03,)),
        (Faults(dvl_scale=0.04), "scale", (0.04,)),
        (Faults(dvl_scale=0.3), "scale", (0.3,)),
        (Faults(heading_bias_deg=3.0), "heading", (3.0,)),
        (Faults(heading_bias_deg=40.0), "heading", (40.0,)),
        (Faults(deviation_sin_deg=3.0, deviation_cos_deg=-2.0), "deviation", (3.0, -2.0)),
        (Faults(deviation_sin_deg=-20.0, deviation_cos_deg=10.0), "deviation", (-20.0, 10.0)),
        (Faults(usbl_latency_s=0.7), "latency", (0.7,)),
        (Faults(usbl_latency_s=-1.8), "latency", (-1.8,)),
    ],
)
def test_one_fault_is_found_and_no_other_with_its_effect_and_what_is_left_begins_at_four_sigma(faults, key, value):
    line = weaving_dive(faults)

    found = identify(line, ASSUMED)

    (one,) = [one for one in found.evidence if one.exists]
    assert one.key == key
    assert [estimate.value for estimate in one.estimates] == pytest.approx(value, abs=4 * one.estimates[0].sd)
    assert one.log_odds > 3
    found_value = one.estimates[0].value
    ratio = {"scale": found_value / (1 + found_value), "heading": 2 * math.sin(math.radians(found_value) / 2)}
    if key in ratio:
        distance_m = math.sqrt(line.fix_m.var(axis=0).sum())  # from their centre
        assert one.effect_m == pytest.approx(abs(ratio[key]) * distance_m, rel=0.1)
    assert [other.effect_m for other in found.evidence if not other.exists] == [0.0] * (len(OWN_KEYS) - 1)
    errors = found.parameters.errors
    left = {"heading": math.degrees(errors.heading_rad), "scale": errors.scale, "latency": errors.latency_s}
    if key in left and value[0] > 0:  # fixes that are early are not moved
        assert left[key] == pytest.approx(4 * one.estimates[0].sd)
    assert kept_linearised.cache_info().currsize == 0


def test_with_a_dvl_through_the_water_the_current_is_always_a_state_and_no_evidence_of_an_error() -> None:
    line = weaving_dive(Faults(dvl_scale=0.03, current_east_mps=0.3, current_north_mps=-0.2))

    found = identify(line, replace(ASSUMED, water_track=True))

    assert existing(found) == {"scale"}
    assert found.parameters.calibrate == ("scale", "usbl-bias", "current")


@pytest.mark.long
def test_two_faults_are_both_found_and_the_track_is_better_by_them() -> None:
    line = weaving_dive(Faults(dvl_scale=0.02, heading_bias_deg=4.0))

    found = identify(line, ASSUMED)
    plain, better = run("adf", line, ASSUMED), run("adf", line, found.parameters)

    off = [apart_m(track, CLEAN)[500:].mean() for track in (plain, better)]
    assert existing(found) == {"scale", "heading"}
    assert off[1] < 0.5 * off[0]


def moved_ahead(line: Timeline, ahead_m: float) -> Timeline:
    """Return a dive whose fixes are those of a point further ahead."""
    yaw = np.interp(line.fix_time_s, line.time_s, line.dr_yaw_rad)
    return replace(line, fix_m=line.fix_m + ahead_m * np.column_stack([-np.sin(yaw), np.cos(yaw)]))


def test_a_lever_arm_is_found_as_a_number_of_the_run_and_not_as_a_state() -> None:
    """A DVL 2 m ahead of the transponder: the fixes are those of a point 2 m behind it."""
    found = identify(moved_ahead(DIVE, -2.0), replace(ASSUMED, start=Start(0.0, 0.0, 3.0)))

    assert existing(found) == {LEVER}
    assert found.parameters.calibrate == ("usbl-bias",)
    assert found.parameters.dvl_lever_m == pytest.approx((0.0, 2.0, 0.0), abs=0.15)


def test_of_a_lever_arm_the_sigma_covers_that_the_transponder_is_misplaced_and_not_the_dvl() -> None:
    ahead_m = 2.0
    misplaced = moved_ahead(DIVE, ahead_m)

    found = identify(misplaced, replace(ASSUMED, start=None))
    track = run("adf", misplaced, found.parameters)

    assert apart_m(track, CLEAN).mean() == pytest.approx(ahead_m, abs=0.3)  # in which the log has no say
    assert 1.0 < mean_nees(track, CLEAN) < 4.0
    (warning,) = found.warnings
    assert warning.startswith("RIVAL-EXPLANATIONS: DVL or transponder is ")
    assert found.misplaced_text in warning


def test_at_one_speed_the_sigma_covers_lever_arm_and_latency() -> None:
    """Fixes that are late by 1 s lie where a DVL further ahead would put them: the track may be either's."""
    log = simulated_log(find_scenario("square"), 3)
    line, known = timeline(log), replace(log.parameters, calibrate=(), errors=SensorErrors(dvl_lever_m=1.0))
    clean = run("adf", line, known)

    found = identify(replace(line, fix_time_s=line.fix_time_s + 1.0), known)
    track = run("adf", replace(line, fix_time_s=line.fix_time_s + 1.0), found.parameters)

    assert set(found.undecided) >= {"usbl_latency_s", "dvl_lever_forward_m"}
    assert mean_nees(track, clean) < 4.0


CIRCLES = """
schema = 1
about = "a vehicle that circles at one speed, and a fix every 5 s"
duration_s = 1000.0

[[leg]]
duration_s = 1000.0
forward_mps = 1.0
turn_rate_dps = 1.0

[dvl]
rate_hz = 5.0
sd_mps = 0.02

[compass]
rate_hz = 10.0
sd_deg = 0.3
bias_deg = {bias_deg}

[usbl]
rate_hz = 0.2
accuracy = {{ sd_m = 0.7 }}
latency_s = {latency_s}

[gps]
rate_hz = 1.0
"""


@pytest.mark.parametrize(("bias_deg", "latency_s"), [(1.2, 0.0), (0.0, 2.0)])
def test_in_a_circle_the_sigma_covers_a_turned_compass_and_late_fixes(bias_deg, latency_s, tmp_path) -> None:
    """While a vehicle turns by a degree in a second, fixes late by two are a compass turned by two, or a lever arm."""
    file = tmp_path / "circles.toml"
    file.write_text(CIRCLES.format(bias_deg=bias_deg, latency_s=latency_s))
    log = simulated_log(read_scenario(file), 3)
    line = timeline(log)

    found = identify(line, Parameters())
    errors = scored(log, line, run("adf", line, found.parameters)).report

    assert len(found.explanations) > 1
    assert errors.nees is not None
    assert errors.nees.mean < 4.0


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_on_a_straight_way_the_sigma_covers_a_latency_that_no_fix_shows(seed: int) -> None:
    line, assumed = weaving_dive(Faults(), seed, weaves=False), replace(ASSUMED, start=None)
    late = weaving_dive(Faults(usbl_latency_s=1.0), seed, weaves=False)

    track, clean = run("adf", late, identify(late, assumed).parameters), run("adf", line, assumed)

    assert apart_m(track, clean).mean() == pytest.approx(1.2, abs=0.3)  # in which the log has no say
    assert mean_nees(track, clean) < 4.0


def test_a_latency_against_which_the_log_speaks_is_not_in_the_sigma() -> None:
    found = identify(DIVE, replace(ASSUMED, start=None))

    assert found.parameters.settled_sd["usbl_latency"] < 0.02


@pytest.mark.parametrize(
    ("key", "columns", "name"),
    [(DVL_CLOCK, ("dvl_mps", "dr_mps"), "dvl_clock_s"), (COMPASS_CLOCK, ("yaw_rad", "dr_yaw_rad"), "compass_clock_s")],
)
def test_a_late_clock_of_dvl_or_compass_is_found_as_a_number_of_the_run(key, columns, name):
    late = replace(DIVE, **{column: np.roll(getattr(DIVE, column), HZ, axis=0) for column in columns})

    found = identify(late, ASSUMED)

    assert existing(found) == {key}
    assert found.estimates[name].value == pytest.approx(1.0, abs=0.25)
    assert found.parameters.settled == {name.removesuffix("_s"): found.estimates[name].value}


def test_late_fixes_are_moved_to_when_they_were_valid_and_early_ones_are_not() -> None:
    """The whole log knows the latency, which the first fixes do not show."""
    assumed = replace(ASSUMED, start=None)
    late, early = (weaving_dive(Faults(usbl_latency_s=seconds)) for seconds in (1.5, -1.5))

    found, of_early = identify(late, assumed).parameters, identify(early, assumed).parameters

    assert found.settled == {"usbl_latency": pytest.approx(1.5, abs=0.1)}
    assert found.settled_sd["usbl_latency"] < 0.05  # as no other error moves the fixes so
    assert of_early.settled == {}
    off_m, as_state_m = (
        apart_m(run("adf", late, one), CLEAN)[: 30 * HZ].mean() for one in (found, replace(found, settled={}))
    )
    assert off_m < 2 / 3 * as_state_m


def test_a_rival_latency_goes_beside_a_lever_arm_unless_it_is_clearly_worse() -> None:
    score = np.full(len(SUBSETS), -50.0)
    one, other = (SUBSETS.index(frozenset([key])) for key in (LEVER, "latency"))
    score[one], score[other] = 0.0, -2.9

    assert _present(score, SUBSETS)[0] == {LEVER, "latency"}
    score[other] = -3.1  # log 20 is 2.996
    assert _present(score, SUBSETS)[0] == {LEVER}


@pytest.mark.parametrize(("key", "state"), [("latency", "usbl_latency"), (COMPASS_CLOCK, "compass_clock")])
def test_an_early_clock_is_twenty_times_rarer_than_a_late_one(key: str, state: str) -> None:
    def score(value_s: float) -> float:
        mean = {"usbl_latency": np.zeros(1), "compass_clock": np.zeros(1), state: np.array([value_s])}
        (found,) = _score(FixLikelihoods(np.array([7.0]), mean, mean, np.empty(0)), [frozenset([key])], frozenset())
        return float(found)

    assert score(1.0) == pytest.approx(7.0 - np.log(20))
    assert score(-1.0) == pytest.approx(7.0 - 2 * np.log(20))


def test_two_of_three_clocks_say_all() -> None:
    assert not any(subset >= {COMPASS_CLOCK, usual} for subset in SUBSETS for usual in (DVL_CLOCK, "latency"))


@pytest.mark.parametrize(
    ("key", "far", "better", "is_taken"),
    [
        *(("latency", "latency", 3.1, True), ("latency", "latency", 2.9, False), ("scale", "latency", 9.0, False)),
        *((HEAD, HEAD, 6.1, True), (HEAD, HEAD, 5.9, False)),  # errors of a head are always present: it pays again
    ],
)
def test_a_wide_prior_is_taken_only_for_an_error_that_exists(key: str, far: str, better: float, is_taken: bool) -> None:
    """And if the evidence against the usual prior is strong."""
    score, rows = np.zeros(len(SUBSETS)), {name: np.zeros(len(SUBSETS)) for name in REPORTED}
    usual, wide = chosen(score, rows, key), chosen(score + better, rows, key)
    wide = wide._replace(far=frozenset({far}), named=wide.named if far == HEAD else frozenset({key}))

    assert _likeliest([usual, wide]) is (wide if is_taken else usual)


@pytest.mark.parametrize("latency_s", [3.0, -3.0])
def test_fixes_that_were_valid_before_or_after_the_log_are_reckoned_on(latency_s: float) -> None:
    line = weaving_dive(Faults(usbl_latency_s=latency_s))
    about = dict.fromkeys(STEPS, 0.0) | {"usbl_latency": latency_s}

    log = linearised(line, (0.0, 0.0), len(line.fix_time_s), tuple(about.values()))

    off_m = log.residual_m - log.measurement_matrix[:, :, PASS_STATES.index("usbl_latency")] * latency_s
    assert np.hypot(*off_m.T).max() < 5 * SD_M  # at the ends 2.4 m without


def test_a_walk_of_dead_reckoning_is_no_slow_error_of_the_fixes_in_three_minutes() -> None:
    """A compass near iron: both are as likely, and with the slow error the smoothed track errs by 1.6 m, not 0.7."""
    folder = ROOT / "docs" / "real_log"
    log = read_log(folder / "riverpro.mcap", Request(configuration=str(folder / "corrected.toml")))

    assert identify(timeline(log), log.parameters).parameters.process.position_m > 5 * log.parameters.process.position_m


@pytest.mark.parametrize(
    "error", [{"usbl_latency": -9.0}, {"dvl_clock": 7.0}, {"compass_clock": -7.0, "dvl_scale": 0.1}]
)
def test_what_is_recorded_after_the_last_fix_says_nothing_of_it(error: Mapping[str, float]) -> None:
    line, point = weaving_dive(Faults(), seconds=200), tuple({**dict.fromkeys(STEPS, 0.0), **error}.values())

    first, every = (linearised(line, (0.0, 0.0), fixes, point) for fixes in (60, len(line.fix_time_s)))

    np.testing.assert_array_equal(first.residual_m, every.residual_m[:60])
    np.testing.assert_array_equal(first.measurement_matrix, every.measurement_matrix[:60])


def test_without_fixes_there_is_no_evidence_of_sensor_errors() -> None:
    found = identify(DIVE.with_fixes(np.arange(0)), replace(ASSUMED, calibrate=("scale",)))

    assert found.parameters.calibrate == ()
    assert found.evidence == ()


@pytest.mark.long
def test_dead_reckoning_without_bottom_lock_is_no_longer_trusted() -> None:
    """The velocities of the DVL have nothing to do with those of the vehicle."""
    walk = 0.05 * np.cumsum(np.random.default_rng(8).standard_normal(DIVE.dvl_mps.shape), axis=0)
    unlocked = replace(DIVE, dvl_mps=walk, dr_mps=walk)

    found = identify(unlocked, ASSUMED)
    tracks = [run("adf", unlocked, p) for p in (found.parameters, ASSUMED)]

    last = np.searchsorted(DIVE.fix_time_s, DIVE.time_s, side="right") - 1  # fix at each epoch
    held_m = np.hypot(*(DIVE.fix_m[last] - CLEAN.position_m).T).mean()
    identified_m, trusting_m = (apart_m(track, CLEAN).mean() for track in tracks)
    assert identified_m < 1.5 * held_m
    assert trusting_m > 5 * held_m
    assert any("bottom lock" in text for text in found.warnings)


def test_a_stated_family_of_noise_is_kept() -> None:
    found = identify(weaving_dive(Faults(), seconds=100), replace(ASSUMED, usbl=Mixture(0.3, 100.0)))

    assert isinstance(found.parameters.usbl, Mixture)


def test_the_truth_has_no_part_and_the_same_log_gives_the_same() -> None:
    line = weaving_dive(Faults(), seconds=100)
    other = replace(line, gps_time_s=line.time_s, gps_m=np.full((len(line.time_s), 2), 1e4))

    assert identify(line, ASSUMED) == identify(line, ASSUMED) == identify(other, ASSUMED)


def test_an_error_that_is_stated_to_be_none_is_not_looked_for() -> None:
    none = replace(ASSUMED, errors=SensorErrors(dvl_lever_m=0.0, dvl_clock_s=0.0, compass_clock_s=0.0))

    found = identify(weaving_dive(Faults(usbl_latency_s=2.0), seconds=150), none)

    assert set(found.estimates) == {"usbl_latency_s"}
    assert not {error.key for error in found.evidence} & {LEVER, DVL_CLOCK, COMPASS_CLOCK}


def test_rivals_are_within_odds_of_20_and_neither_contains_the_other() -> None:
    score = np.full(len(SUBSETS), -50.0)
    for keys, value in (
        (["scale", "latency"], 0.0),
        (["latency"], -0.5),  # says the same, but for the scale
        (["scale", "latency", DVL_CLOCK], -1.0),
        (["scale", LEVER], -2.0),
        (["scale", LEVER, "heading"], -2.5),  # a rival already has its lever arm
        ([DVL_CLOCK], -3.1),  # log 20 is 2.996
    ):
        score[SUBSETS.index(frozenset(keys))] = value
    rows = {name: np.arange(len(SUBSETS), dtype=float) for name in REPORTED}

    best, rival = explanations(chosen(score, rows))

    assert (best.keys, best.log_odds) == (("scale", "latency"), 0.0)
    assert (rival.keys, rival.log_odds) == (("scale", LEVER), -2.0)
    assert [one.name for one in rival.estimates] == ["dvl_scale", "dvl_lever_starboard_m", "dvl_lever_forward_m"]
    assert rival.estimates[0].value == SUBSETS.index(frozenset(["scale", LEVER]))
    found = Identification(ASSUMED, explanations=(best, rival))
    assert found.contested == {"latency", LEVER}
    assert Identification(ASSUMED, explanations=(best,)).contested == set()


def test_a_latency_far_beyond_the_usual_is_no_lever_arm_if_the_vehicle_turns() -> None:
    """At a constant speed of 1.2 m/s fixes that are 5 s late lie where a DVL 6 m ahead would put them, but in turns."""
    log = simulated_log(find_scenario("square"), 3)
    line = timeline(log)

    found = identify(replace(line, fix_time_s=line.fix_time_s + 5.0), log.parameters)

    assert set(found.estimates) == {"usbl_latency_s"}
    assert found.estimates["usbl_latency_s"].value == pytest.approx(5.0, abs=4 * found.estimates["usbl_latency_s"].sd)
    assert found.estimates["usbl_latency_s"].sd < 0.2


@pytest.mark.parametrize(("latency_s", "said"), [(-0.8, True), (-0.2, False), (0.8, False)])
def test_early_stamps_of_fixes_may_be_a_late_compass_and_then_the_track_is_late(latency_s: float, said: bool) -> None:
    latency = (ErrorEstimate("usbl_latency_s", latency_s, 0.1),)
    found = Identification(ASSUMED, (SensorErrorEvidence("latency", 9.0, True, latency),))

    warned = [text for text in found.warnings if text.startswith("USBL-LATENCY: ")]

    assert len(warned) == said
    assert all("stamps of the fixes are 0.80 ± 0.10 s early by DVL and compass" in text for text in warned)


@pytest.mark.parametrize("last", [True, False])
@pytest.mark.parametrize(
    ("runs", "begins"),
    [
        ([(10.0, 50.0, 40), (660.0, 856.0, 50)], "90 USBL fixes (in 2 runs, the longest from 660 to 856 s) lie"),
        ([(660.0, 660.0, 1)], "a USBL fix at 660 s lies beside the track"),
        ([(10, 10, 1), (60, 61, 2), (90, 90, 1)], "4 USBL fixes, no more than 3 in a row, lie beside the track"),
    ],
)
def test_false_fixes_at_the_end_of_a_log_may_be_a_fault_of_dead_reckoning_unless_they_are_outliers(runs, begins, last):
    found = [FalseRun(*run) for run in runs]

    (text,) = Identification(ASSUMED, false_runs=(*found[:-1], found[-1]._replace(last=last))).warnings

    assert text.startswith(f"FALSE-FIXES: {begins}")
    assert ("no fix follows those from" in text) == (last and "in a row" not in begins)


@pytest.mark.parametrize(("share", "said"), [(0.02, True), (0.005, False)])
def test_false_fixes_that_may_be_right_instead_are_said(share, said):
    (text,) = Identification(ASSUMED, false_runs=(FalseRun(10.0, 290.0, 281, rival_share=share),)).warnings

    assert ("those from 10 to 290 s are so many that perhaps dead reckoning is wrong" in text) == said


@pytest.mark.parametrize(("late_s", "ahead_m", "unusual"), [(5.0, 6.0, True), (2.0, 2.4, False)])
def test_a_lever_arm_or_a_latency_that_is_larger_than_usual_is_said_to_be(late_s, ahead_m, unusual):
    late = Explanation(("latency",), 0.0, (ErrorEstimate("usbl_latency_s", late_s, 0.1),))
    ahead = Explanation((LEVER,), -1.0, (ErrorEstimate("dvl_lever_forward_m", ahead_m, 0.1),))

    found = Identification(ASSUMED, explanations=(late, ahead))

    assert f"{late_s:.2f} ± 0.10 s late" in found.lever_or_latency_text
    assert f"{ahead_m:.2f} ± 0.10 m further ahead" in found.lever_or_latency_text
    assert ("more than is usual: at one speed" in found.lever_or_latency_text) == unusual
    assert found.lever_or_latency_text in "".join(found.warnings)


@pytest.mark.parametrize("bias_deg", [0.5, 2.0])
def test_on_one_heading_a_deviation_is_a_bias_and_a_state_covers_it(bias_deg: float) -> None:
    """The prior of the deviation is narrower, so that its evidence is larger, but not by much."""
    found = identify(weaving_dive(Faults(heading_bias_deg=bias_deg), weaves=False), ASSUMED)

    assert [set(one.keys) for one in found.explanations] == [{"deviation"}, {"heading"}]
    assert found.estimates.keys() == {"heading_bias_deg"}
    assert found.estimates["heading_bias_deg"].value == pytest.approx(bias_deg, abs=0.1)
    assert {"heading", "deviation"} <= {*found.parameters.calibrate}
    assert found.parameters.errors.deviation_rad == ASSUMED.errors.deviation_rad


def test_on_many_headings_a_deviation_is_no_bias() -> None:
    found = identify(weaving_dive(Faults(deviation_sin_deg=1.5)), ASSUMED)

    assert found.estimates.keys() == {"deviation_sin_deg", "deviation_cos_deg"}
    assert "heading" not in found.parameters.calibrate
