"""The geometry of a survey against rotations of SciPy, and the calibration against surveys with known errors."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from usbldr.filters.errors import LogError
from usbldr.filters.simulation.simulate import simulate_survey
from usbldr.filters.usbl_survey.calibration import assumed, calibrated, halves, known_of, levelled
from usbldr.filters.usbl_survey.geometry import (
    LATENCIES,
    NAMES,
    PLACE,
    attitude_matrix,
    mount_matrix,
    placed,
    residuals,
    seen_from_head,
    ship_motion,
)
from usbldr.filters.usbl_survey.verdict import Scatter, decided, judged, planned
from usbldr.filters.usbl_survey.vertical import VerticalFit, vertical_fit
from usbldr.io.scenarios.survey_scenarios import find_survey

BOX, CIRCLE, SPIN = (find_survey(f"survey-{pattern}") for pattern in ("box", "circle", "spin"))
STATED = np.array([0.0, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0])
KNOWN = known_of(STATED)
SEEDS = range(400, 412)
ERRORS = slice(0, 8)


def noiseless(scenario, **changes):
    exact = dict.fromkeys(("position_sd_m", "attitude_sd_deg", "range_sd_m", "angle_sd_deg", "outlier_share"), 0.0)
    return replace(scenario, **exact, **changes)


def in_time():
    """Return a survey without noise and latencies, and its true values."""
    exact = BOX.true_values * np.where([name.endswith("latency_s") for name in NAMES], 0.0, 1.0)
    return simulate_survey(noiseless(BOX, true_values=exact, position_rate_hz=20.0), 0), exact


@pytest.fixture(scope="module")
def fits():
    surveys = [simulate_survey(BOX, seed) for seed in SEEDS]
    return [calibrated(survey, STATED, KNOWN) for survey in surveys]


def test_an_attitude_turns_as_rotations_of_scipy_do():
    """Forward, starboard, down of the ship to north, east, down: rotations about z, y, x by the moving axes."""
    angles = np.random.default_rng(0).uniform(-180, 180, (50, 3)) * [1, 0.45, 1]
    vectors = np.random.default_rng(1).normal(size=(50, 3))  # starboard, forward, up
    frd = vectors[:, [1, 0, 2]] * [1, 1, -1]
    ned = Rotation.from_euler("ZYX", angles, degrees=True).apply(frd)
    turned = np.einsum("nij,nj->ni", attitude_matrix(*angles.T), vectors)
    assert turned == pytest.approx(ned[:, [1, 0, 2]] * [1, 1, -1], abs=1e-12)


def test_records_come_at_their_rates_with_and_without_latencies():
    plain = replace(BOX, true_values=BOX.true_values * np.where(np.arange(11) == LATENCIES.start, 0.0, 1.0))
    for scenario in (BOX, plain, replace(BOX, true_values=in_time()[1])):
        ship = simulate_survey(scenario, 0).ship
        assert [np.diff(t)[0] for t in (ship.position_time_s, ship.attitude_time_s)] == pytest.approx([0.2, 0.05])


def test_exact_fixes_place_the_transponder_and_leave_no_residual():
    survey, exact = in_time()
    assert np.ptp(placed(survey, exact), axis=0) == pytest.approx(np.zeros(3), abs=0.01)  # waves between two records
    assert residuals(survey, exact) == pytest.approx(np.zeros((len(survey), 3)), abs=0.005)
    lonely = replace(survey, direction=np.full((len(survey), 3), np.nan))
    assert residuals(lonely, exact)[:, 1] == pytest.approx(residuals(survey, exact)[:, 1], abs=1e-4)
    assert placed(lonely, exact) == pytest.approx(placed(survey, exact), abs=0.05)


def test_the_range_of_a_reply_is_the_mean_of_both_ways():
    survey, exact = in_time()
    two_way_s = np.full(len(survey), 2.0)
    before = np.linalg.norm(seen_from_head(replace(survey, time_s=survey.time_s - two_way_s), exact), axis=1)
    replies = replace(survey, range_m=(survey.range_m + before) / 2, two_way_s=two_way_s)
    replies, survey = (one.part(np.isfinite(before)) for one in (replies, survey))
    assert np.abs(replies.range_m - survey.range_m).max() > 1.0
    assert residuals(replies, exact) == pytest.approx(np.zeros((len(replies), 3)), abs=0.005)
    assert np.ptp(placed(replies, exact), axis=0) == pytest.approx(np.zeros(3), abs=0.02)


def test_bearing_and_range_of_a_hand_made_fix():
    """A ship that heads east, listing by nothing, with the transponder 30 m north of it and 40 m down."""
    survey = simulate_survey(noiseless(SPIN), 0).part(np.arange(598) == 0)
    level = survey.ship.attitude_deg * 0 + [90.0, 0.0, 0.0]
    there = survey.ship._replace(attitude_deg=level, smoothed_m=survey.ship.smoothed_m * 0)
    values = np.array([0.0, 0, 0, 1, 0, 0, 0, 0, 0, 30, 40])
    assert seen_from_head(replace(survey, ship=there), values)[0] == pytest.approx([-30, 0, -40])
    values[2] = -90.0  # the head's forward axis points to port of the bow
    assert seen_from_head(replace(survey, ship=there), values)[0] == pytest.approx([0, 30, -40])


def test_late_positions_are_those_of_an_antenna_that_sways_but_not_of_its_noise():
    """Of 0.6 m in 8 s, as high above a ship that rolls; less noise between two records would look like a latency."""
    times_s, now_s = np.arange(0, 600, 0.2), np.arange(100.0, 500.0, 2.0)

    def true_m(t):
        return np.column_stack([1.5 * t, 0.6 * np.sin(2 * np.pi * t / 8)])

    level = np.zeros((len(times_s), 3))
    exact = ship_motion(times_s, true_m(times_s), times_s, level)
    assert exact.positions(now_s, 0.3) == pytest.approx(true_m(now_s + 0.3), abs=0.02)
    noise_m = np.random.default_rng(0).normal(size=(len(times_s), 2))
    noisy = ship_motion(times_s, noise_m, times_s, level)
    at_records, between = (np.std(noisy.positions(times_s, late_s)[50:-50]) for late_s in (0.0, 0.1))
    assert between == pytest.approx(at_records, rel=0.1)


GOALS = [0.078, 0.039, 0.026, 0.00039, 0.13, 0.026]  # roll, pitch, heading, scale, arms: of RMS errors


def test_a_box_finds_the_errors_within_their_sigmas(fits):
    error = np.array([fit.values - BOX.true_values for fit in fits])[:, ERRORS]
    assert (np.sqrt(np.mean(error**2, axis=0))[:6] < GOALS).all()
    z = error / np.array([fit.sd[ERRORS] for fit in fits])
    assert 0.75 < np.sqrt(np.mean(z**2)) < 1.3  # 96 numbers, correlated in pairs
    assert np.abs(z).max() < 4.5


def test_a_plan_gives_the_sigmas_that_surveys_reach(fits):
    plan = planned(simulate_survey(BOX, 0), BOX.true_values, KNOWN, (BOX.range_sd_m, np.radians(BOX.angle_sd_deg)))
    expected = np.array([one.sd for one in plan])[ERRORS]
    assert (expected[:6] < GOALS).all()
    reached = np.mean([fit.sd for fit in fits], axis=0)[ERRORS]
    assert reached / expected == pytest.approx(np.ones(8), abs=0.2)


def test_the_noise_of_positions_tells_no_latency():
    """On a circle at one speed nothing else does, either: its sigma is that of exact positions."""
    noise = (CIRCLE.range_sd_m, np.radians(CIRCLE.angle_sd_deg))
    exact = replace(CIRCLE, position_sd_m=0.0)
    plans = [planned(simulate_survey(one, 0), CIRCLE.true_values, KNOWN, noise) for one in (CIRCLE, exact)]
    noisy, known = np.array([[one.sd for one in plan] for plan in plans])
    assert noisy / known == pytest.approx(np.ones(11), abs=0.1)


def test_a_box_is_good_and_calibrated_fixes_scatter_as_their_noise():
    found, fit = judged(simulate_survey(BOX, 500), STATED, KNOWN)
    assert (found.result, [one.name for one in found.parameters if one.open]) == ("good", [])
    assert found.before.drms_m > 5 * found.after.drms_m
    exact = placed(simulate_survey(BOX, 500), BOX.true_values)[fit.good]
    own = np.median(np.linalg.norm((exact - np.median(exact, axis=0))[:, :2], axis=1))
    assert found.after.cep50_m == pytest.approx(own, rel=0.02)


def apart(parameters):
    """Return the groups of open parameters that are not separated."""
    return {frozenset({one.name, *one.rivals}) for one in parameters if one.rivals}


ON_A_CIRCLE = (
    {"mount_pitch_deg", "mount_heading_deg", "arm_forward_m", "position_latency_s"},
    {"mount_roll_deg", "scale", "depth_m"},
)
ON_A_SPIN = ({"scale", "arm_forward_m", "east_m", "north_m", "depth_m"},)


@pytest.mark.parametrize(
    ("scenario", "seed", "groups"),
    [
        (CIRCLE, 1, ON_A_CIRCLE),
        (SPIN, 1, ON_A_SPIN),
        (SPIN, 2, ON_A_SPIN),  # false fixes near the vertical, where bearings mean nothing
    ],
)
def test_a_pattern_that_leaves_errors_open_names_them_and_the_leg(scenario, seed, groups):
    """On a circle abeam, each of a group moves the transponder along the same axis: forward; up and outward."""
    found, _ = judged(simulate_survey(scenario, seed), STATED, KNOWN)
    assert found.result == "open"
    assert apart(found.parameters) == set(map(frozenset, groups))
    noise = (scenario.range_sd_m, np.radians(scenario.angle_sd_deg))
    plan = planned(simulate_survey(scenario, 0), scenario.true_values, KNOWN, noise)
    assert apart(plan) == apart(found.parameters)
    reached, expected = (np.array([one.sd for one in rows]) for rows in (found.parameters, plan))
    assert reached / expected == pytest.approx(np.ones(11), abs=0.25)
    assert all(one.leg for one in found.parameters if one.open)


def test_a_known_depth_settles_the_scale():
    survey = simulate_survey(SPIN, 1)
    values = calibrated(survey, STATED, known_of(STATED, 100.0, 0.1))
    assert values.sd[NAMES.index("scale")] < 0.002
    assert values.values[NAMES.index("scale")] == pytest.approx(0.99, abs=4 * values.sd[NAMES.index("scale")])


def along(leg, forward_mps):
    """Return a leg along the same line at another speed."""
    factor = forward_mps / leg.forward_mps
    changes = {"duration_s": leg.duration_s / factor, "turn_rate_radps": leg.turn_rate_radps * factor}
    return replace(leg, forward_mps=forward_mps, **changes)


def test_a_latency_that_one_speed_leaves_open_is_in_the_sigma_of_the_arm():
    at_one_speed = replace(BOX, legs=tuple(along(leg, 1.5) for leg in BOX.legs))
    survey = simulate_survey(at_one_speed, 2)  # late by 0.3 s
    found, _ = judged(survey, STATED, KNOWN)
    assert found.result == "open"
    forward, latency = (found.parameters[NAMES.index(name)] for name in ("arm_forward_m", "position_latency_s"))
    assert forward.name in latency.rivals
    assert latency.name in forward.rivals
    for one in (forward, latency):
        assert one.value == pytest.approx(at_one_speed.true_values[NAMES.index(one.name)], abs=3 * one.sd)
    known = at_one_speed.true_values
    assert judged(survey, known, known_of(known, latency_sd_s=0.02))[0].result == "good"


@pytest.mark.parametrize(("share", "result"), [(0.2, "good"), (0.37, "bad")])
def test_many_false_fixes_are_found_and_do_not_move_the_errors(share, result):
    """Their ranges are too long, too, as those of echoes."""
    survey = simulate_survey(replace(BOX, outlier_share=share), 8)
    rng = np.random.default_rng(8)
    false = np.linalg.norm(survey.direction - simulate_survey(replace(BOX, outlier_share=0.0), 8).direction, axis=1)
    echo_m = np.where(false > 0.05, 30 * np.abs(rng.normal(size=len(survey))), 0.0)
    survey = levelled(replace(survey, range_m=survey.range_m + echo_m), STATED, KNOWN)
    found, fit = judged(survey, STATED, KNOWN)
    assert (survey.level, found.result) == (False, result)
    assert found.false_share == pytest.approx(share, abs=0.05)
    z = (fit.values - BOX.true_values) / fit.sd
    assert np.abs(z).max() < 4.0


def test_a_head_mounted_backwards_is_found():
    turned = BOX.true_values.copy()
    turned[NAMES.index("mount_heading_deg")] = -178.0
    fit = calibrated(simulate_survey(replace(BOX, true_values=turned), 3), STATED, KNOWN)
    assert fit.values[NAMES.index("mount_heading_deg")] == pytest.approx(-178.0, abs=0.1)


def test_fixes_that_are_level_already_are_not_turned_again():
    level = replace(BOX, roll_deg=0.0, pitch_deg=0.0)
    rolling = simulate_survey(BOX, 4)
    compensated = replace(simulate_survey(level, 4), ship=rolling.ship)
    assert [levelled(one, STATED, KNOWN).level for one in (rolling, compensated)] == [False, True]


def test_of_level_fixes_roll_and_pitch_turn_the_arm_alone():
    """What a head that takes off roll and pitch shows of fixes places them where the fixes themselves do."""
    survey = replace(simulate_survey(noiseless(BOX), 4), arm_up_m=-19.0)
    angles = survey.ship.attitudes(survey.time_s + BOX.true_values[NAMES.index("attitude_latency_s")])
    upright = np.einsum("nji,njk->nik", attitude_matrix(*(angles * [1, 0, 0]).T), attitude_matrix(*angles.T))
    in_ship = survey.direction @ mount_matrix(BOX.true_values).T
    unmounted = np.append(np.zeros(3), BOX.true_values[3:])
    direction = np.einsum("nij,nj->ni", upright, in_ship)

    level = replace(survey, direction=direction, bearing_rad=np.arctan2(*direction[:, :2].T), level=True)

    assert placed(level, unmounted) == pytest.approx(placed(survey, BOX.true_values), abs=1e-6)


def test_a_transponder_that_moves_is_bad():
    survey = simulate_survey(BOX, 5)
    moved = replace(survey, range_m=survey.range_m + np.where(halves(len(survey))[0], 0.0, 2.0))
    found, _ = judged(moved, STATED, KNOWN)
    assert found.result == "bad"
    assert "different installations" in found.why
    # each half is judged by the installation of the other, which is wrong for it
    assert found.after.cep50_m > 1.4 * judged(survey, STATED, KNOWN)[0].after.cep50_m


@pytest.mark.parametrize(
    ("sides", "why"),
    [((1, 1, -1), "m above the head, or the surface if its depth is stated: check the third of axes"),
     ((-1, 1, 1), "% of their range: check axes and headings")],
)  # fmt: skip
def test_axes_that_are_stated_mirrored_are_bad(sides, why):
    """The vertical mirrored is a transponder in the air and a tilt of the wrong sign; starboard fits nowhere."""
    survey = simulate_survey(BOX, 500)
    direction = survey.direction * np.array(sides)
    mirrored = replace(survey, direction=direction, bearing_rad=np.arctan2(direction[:, 0], direction[:, 1]))
    found, _ = judged(mirrored, STATED, KNOWN)
    assert found.result == "bad"
    assert why in found.why


def test_headings_that_are_stated_in_another_convention_do_not_search_for_ever():
    survey = simulate_survey(BOX, 500)
    attitude_deg = survey.ship.attitude_deg * [-1, 1, 1] + [90, 0, 0]
    with pytest.raises(LogError, match="does not converge; check head, heading_topic"):
        calibrated(replace(survey, ship=survey.ship._replace(attitude_deg=attitude_deg)), STATED, KNOWN)


def test_a_fix_at_the_very_edge_of_false_ends_the_search():
    """In every second round of this survey, one of 575 fixes is false."""
    fit = calibrated(simulate_survey(CIRCLE, 15), STATED, KNOWN)
    assert int(fit.good.sum()) in (574, 575)


@pytest.mark.parametrize(("after_m", "result"), [(1.0, "good"), (1.2, "bad")])
def test_a_calibration_that_scatters_more_than_none_is_bad(after_m, result):
    before, after = (Scatter(*(metres,) * 6) for metres in (1.0, after_m))
    assert decided((), before, after, np.ones(100, dtype=bool), 0.0, 31.3).result == result


def test_too_few_fixes_are_refused():
    survey = simulate_survey(BOX, 6)
    with pytest.raises(LogError, match="at least 40"):
        calibrated(survey.part(np.arange(len(survey)) < 30), STATED, KNOWN)


def test_the_start_is_the_median_of_the_fixes():
    survey = simulate_survey(noiseless(SPIN), 0)
    begun = assumed(survey, BOX.true_values)
    assert begun[PLACE] == pytest.approx(np.nanmedian(placed(survey, BOX.true_values), axis=0) * [1, 1, -1])


def a_dive(seed, roll_deg=0.8, pitch_deg=-0.6, scale=0.99, deepest_m=80.0, count=400):
    """Fixes of a head that is rolled and pitched, of a vehicle that goes around it and down."""
    rng = np.random.default_rng(seed)
    angle, depth = rng.uniform(0, 2 * np.pi, count), np.linspace(20, deepest_m, count)
    reach = rng.uniform(20, 120, count)
    forward_starboard_down = np.column_stack([reach * np.cos(angle), reach * np.sin(angle), depth])
    mount = Rotation.from_euler("ZYX", [0, pitch_deg, roll_deg], degrees=True)
    seen = mount.inv().apply(forward_starboard_down) / scale
    drop = seen[:, 2] + 0.3 * rng.standard_t(4, count)
    drop[::40] += 25.0  # false fixes
    return drop, depth, seen[:, [1, 0]]


def fitted(seed: int, deepest_m: float = 80.0) -> VerticalFit | None:
    return vertical_fit(*a_dive(seed, deepest_m=deepest_m))


def test_tilt_and_scale_are_found_within_their_sigmas():
    true = np.array([0.8, -0.6, 0.99, 0.0])
    found = [fitted(seed) for seed in range(30)]
    assert all(all(fit.settled) for fit in found)
    z = [(fit.value - true) / fit.sd for fit in found]
    assert 0.75 < np.sqrt(np.mean(np.square(z))) < 1.3
    assert found[-1].sd[0] < 0.05
    assert found[-1].sd[2] < 0.005


def test_a_dive_at_one_depth_does_not_settle_the_scale():
    assert fitted(1, deepest_m=20.0).settled[:3] == [True, True, False]


def test_fixes_without_a_vertical_say_nothing():
    drop, depth, along = a_dive(2)
    assert vertical_fit(drop * np.nan, depth, along) is None
