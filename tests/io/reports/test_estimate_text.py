import numpy as np
import pytest

from usbldr.filters.identification.identification import ErrorEstimate, NoiseChange, SensorErrorEvidence
from usbldr.filters.models.calibration import EstimatedError
from usbldr.io.reports.estimate_text import error_text, evidence_text, fixed_errors_text, noise_changes_text, with_sigma


@pytest.mark.parametrize(
    ("value", "sd", "said"),
    [
        (1.3591, 1.1186, "1.4 ± 1.1"),
        (-0.96512, 0.21314, "-0.97 ± 0.21"),
        (-0.004, 0.53, "0.00 ± 0.53"),
        (123.4, 12.34, "123 ± 12"),
        (0.25, 0.0, "0.2500 ± 0.0000"),
    ],
)
def test_a_sigma_has_two_significant_digits_and_its_value_the_same_place(value: float, sd: float, said: str) -> None:
    assert with_sigma(value, sd) == said


def test_a_ratio_is_shown_in_percent_and_an_angle_in_its_unit() -> None:
    scale = EstimatedError("dvl_scale", "", np.array([0.0, 0.0027]), np.array([0.01, 0.0013]))
    heading = EstimatedError("heading_bias_deg", "deg", np.array([1.3591]), np.array([1.1186]))

    assert error_text(scale) == "dvl scale 0.27 ± 0.13 %"
    assert error_text(heading) == "heading bias 1.4 ± 1.1 deg"


def test_changed_noise_is_told_in_words_with_units() -> None:
    changes = (NoiseChange("dvl_sd_scale", 1.0, 1.4), NoiseChange("usbl_outlier_share", 0.05, 0.025))

    assert noise_changes_text(changes) == (
        "sigma of the DVL 1.4 times the stated one instead of 1, share of USBL outliers 2.5 % instead of 5"
    )


def test_the_side_of_a_lever_is_a_word_and_not_a_sign() -> None:
    def text(sign: float) -> str:
        numbers = {"dvl_lever_starboard_m": 0.5, "dvl_lever_forward_m": 2.0, "dvl_clock_s": 1.0}
        estimates = tuple(ErrorEstimate(name, sign * value, 0.1) for name, value in numbers.items())
        return fixed_errors_text([SensorErrorEvidence("dvl-lever", 9.0, True, estimates)])

    assert "to starboard of the transponder" in text(1.0)
    assert "m ahead of it" in text(1.0)
    assert "s late against" in text(1.0)
    assert "to port of the transponder" in text(-1.0)
    assert "m astern of it" in text(-1.0)
    assert "s early against" in text(-1.0)
    assert "-" not in text(-1.0)


def test_an_error_that_another_one_explains_better_is_possible() -> None:
    odds = {"heading": (44.9, True), "latency": (0.8, True), "dvl-lever": (-0.8, True), "scale": (-3.9, False)}
    evidence = [SensorErrorEvidence(key, number, exists, ()) for key, (number, exists) in odds.items()]

    assert evidence_text(evidence) == (
        "found heading (+44.9), latency (+0.8); possible dvl-lever (-0.8); not found scale (-3.9) "
        "(log odds; 3: 20 to 1)"
    )


def test_the_place_of_a_head_on_its_ship_is_said_against_what_is_stated() -> None:
    estimates = ErrorEstimate("usbl_arm_starboard_m", -3.9, 0.9), ErrorEstimate("usbl_arm_forward_m", 3.3, 1.6)

    text = fixed_errors_text([SensorErrorEvidence("usbl-arm", 9.0, True, estimates)])

    assert text == "USBL head 3.90 ± 0.90 m to port of where it is stated; USBL head 3.3 ± 1.6 m ahead of there"
