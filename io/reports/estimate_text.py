"""Estimates in words: a sensor error with the digits that its sigma supports, and noise that the log contradicted."""

import math
from collections.abc import Mapping, Sequence

from usbldr.filters.identification.identification import NoiseChange, SensorErrorEvidence
from usbldr.filters.models.calibration import EstimatedError

NOISE_WORDS: Mapping[str, tuple[str, float, str]] = {
    "dvl_sd_scale": ("sigma of the DVL", 1.0, "times the stated one"),
    "compass_sd_scale": ("sigma of the compass", 1.0, "times the stated one"),
    "velocity_walk_mps": ("process noise of the velocity", 1.0, "m/s/√s"),
    "position_walk_m": ("process noise of dead reckoning", 1.0, "m/√s"),
    "usbl_sd_scale": ("sigma of the USBL", 1.0, "times the stated one"),
    "usbl_outlier_share": ("share of USBL outliers", 100.0, "%"),
    "usbl_bias_sd_m": ("sigma of the USBL error that neighbouring fixes share", 1.0, "m"),
    "usbl_bias_time_s": ("correlation time of that error", 1.0, "s"),
    "usbl_outlier_sd_m": ("size of USBL outliers", 1.0, "m"),
}
"""Words, factor and unit for numbers of the noise; others are shown by their names."""
FIXED_ERRORS = {
    "dvl_lever_starboard_m": ("DVL", 1, "m to starboard of the transponder", "m to port of the transponder"),
    "dvl_lever_forward_m": ("DVL", 1, "m ahead of it", "m astern of it"),
    "dvl_clock_s": ("DVL", 1, "s late against compass and fixes", "s early against compass and fixes"),
    "compass_clock_s": ("compass", 1, "s late against DVL and fixes", "s early against DVL and fixes"),
    "usbl_heading_deg": ("USBL", 1, "deg clockwise of the true bearing", "deg counterclockwise of the true bearing"),
    "usbl_range_scale": ("USBL", 100, "% too long", "% too short"),
    "usbl_arm_starboard_m": ("USBL head", 1, "m to starboard of where it is stated", "m to port of where it is stated"),
    "usbl_arm_forward_m": ("USBL head", 1, "m ahead of there", "m astern of there"),
}
"""Sensor, factor, and words for a positive and a negative error."""


def in_unit(unit: str) -> tuple[float, str]:
    """Return the factor and the unit in which an error is shown: a ratio in percent, and m/s for "mps"."""
    return (1.0, "m/s" if unit == "mps" else unit) if unit else (100.0, "%")


def with_sigma(value: float, sd: float) -> str:
    """Return "1.4 ± 1.1": the sigma to two significant digits, the value to the same place."""
    decimals = max(0, 1 - math.floor(math.log10(sd))) if 0 < sd < math.inf else 4
    return f"{value:z.{decimals}f} ± {sd:.{decimals}f}"


def error_text(error: EstimatedError) -> str:
    """Return a sensor error at the end of the run with its sigma and unit."""
    factor, unit = in_unit(error.unit)
    return f"{error.title} {with_sigma(factor * float(error.value[-1]), factor * float(error.sd[-1]))} {unit}"


def noise_changes_text(changes: Sequence[NoiseChange]) -> str:
    """Return the numbers of the noise that the log contradicted, new and old."""
    texts: list[str] = []
    for change in changes:
        words, factor, unit = NOISE_WORDS.get(change.name, (change.name.replace("_", " "), 1.0, ""))
        after = f"{factor * change.after:.3g} {unit}".rstrip()
        texts.append(f"{words} {after} instead of {factor * change.before:.3g}")
    return ", ".join(texts)


def evidence_text(evidence: Sequence[SensorErrorEvidence]) -> str:
    """Return which sensor errors were found and which not, with the natural logarithms of their odds.

    Possible is one that another error explains as well, or better: the track covers both.
    """
    sides: dict[str, list[str]] = {"found": [], "possible": [], "not found": []}
    for one in evidence:
        side = "not found" if not one.exists else "found" if one.log_odds > 0 else "possible"
        sides[side].append(f"{one.key} ({one.log_odds:+.1f})")
    return "; ".join(f"{side} {', '.join(keys)}" for side, keys in sides.items() if keys) + " (log odds; 3: 20 to 1)"


def fixed_errors_text(evidence: Sequence[SensorErrorEvidence]) -> str:
    """Return lever arm and clocks of DVL and compass, heading and range of the USBL head, if the log has evidence."""
    found = {estimate.name: estimate for one in evidence for estimate in one.estimates}
    return "; ".join(
        f"{sensor} {with_sigma(factor * abs(one.value), factor * one.sd)} {less if one.value < 0 else more}"
        for name, (sensor, factor, more, less) in FIXED_ERRORS.items()
        if (one := found.get(name)) is not None
    )
