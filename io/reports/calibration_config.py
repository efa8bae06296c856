"""A configuration for the next dive: that of this dive, with the sensor errors that a filter estimated added.

All other lines stay as they are. Signs and units are those of docs/configuration.md: degrees
clockwise, an error is positive if the sensor reads too much.
"""

import tomllib
from pathlib import Path
from typing import Any

import tomlkit

from usbldr.filters.errors import UsageError
from usbldr.filters.identification.identification import Identification
from usbldr.filters.models.calibration import MAX_SIGMA_RATIO, REPORTED_QUANTITIES, assumed_sd, estimated_errors
from usbldr.filters.types import Trajectory
from usbldr.io.log import Log
from usbldr.io.reports.estimate_text import error_text
from usbldr.io.settings.configuration import parse_configuration
from usbldr.io.settings.toml_text import comment, put
from usbldr.io.settings.validation import read_text

KEYS = {reported.name: reported for reported in REPORTED_QUANTITIES.values() if reported.key}
"""By the name that an error has at the border; a USBL bias that drifts is not a property of the sensor."""


def calibrated_configuration(log: Log, found: Identification, trajectory: Trajectory) -> str:
    """Return the text of a configuration that also subtracts the estimated sensor errors.

    An error that was hardly observable is left as it was, and the start of the dive becomes a comment. Raises
    UsageError if the track has no such errors, or if an error becomes too large for its key.
    """
    errors = estimated_errors(trajectory)
    if not errors:
        raise UsageError(f"{trajectory.label} estimated no sensor errors, so there is nothing to write")
    document: Any = tomlkit.parse("schema = 1\n" if log.configuration is None else read_text(log.configuration))
    found_on = f"{trajectory.label} found on {log.path.name}"
    title = [comment(f"Errors of sensors that {found_on} are added to what was stated.")]
    assumed = assumed_sd(found.parameters.errors)
    for error in errors:
        value, sd, place = float(error.value[-1]), float(error.sd[-1]), KEYS.get(error.name)
        if error.name in found.undecided:
            title.append(comment(f"Left out: {found.lever_or_latency_text}."))
            continue
        if place is None or sd > MAX_SIGMA_RATIO * assumed[error.name]:
            why = "it drifts, so it holds for that dive only" if place is None else "it was hardly observable"
            title.append(comment(f"{error_text(error)}, left out: {why}."))
            continue
        section = document.setdefault(place.section, tomlkit.table())
        before = float(section.get(place.key, 0.0))
        both = before + value if place.unit else (1 + before) * (1 + value) - 1  # relative errors multiply
        number = tomlkit.item(round(both, place.digits))
        estimated = f"{value:+.{place.digits}f} ± {sd:.{place.digits}f} estimated"
        put(section, place.key, number, f"{before:g} stated, {estimated}")
    _add_lever_and_clocks(document, found)
    text = "\n".join(title) + "\n" + _without_start(document)
    parse_configuration(tomllib.loads(text), log.configuration or Path("usbldr.toml"))
    return text


def _add_lever_and_clocks(document: Any, found: Identification) -> None:
    """State the lever arm of the DVL and the clocks of DVL and compass if the log has evidence for them."""
    estimates = {estimate.name: estimate for one in found.decided for estimate in one.estimates}
    if forward := estimates.get("dvl_lever_forward_m"):
        starboard = estimates["dvl_lever_starboard_m"]
        lever = tomlkit.item([round(metres, 3) for metres in found.parameters.dvl_lever_m])
        section = document.setdefault("dvl", tomlkit.table())
        put(section, "lever_arm_m", lever, f"± {starboard.sd:.3f}, {forward.sd:.3f} estimated")
    for sensor in ("dvl", "compass"):
        if clock := estimates.get(f"{sensor}_clock_s"):
            section = document.setdefault(sensor, tomlkit.table())
            before = float(section.get("latency_s", 0.0))
            late = tomlkit.item(round(before + clock.value, 3))
            put(section, "latency_s", late, f"{before:g} stated, {clock.value:+.3f} ± {clock.sd:.3f} estimated")


def _without_start(document: Any) -> str:
    """Return the text of a configuration with its section [start] turned into comments."""
    text = tomlkit.dumps(document)
    if "start" not in document:
        return text
    start = tomlkit.dumps(tomlkit.document().add("start", document["start"]))
    why = "# the start of that dive; state that of the next dive, if it is known:\n"
    commented = "".join(f"# {line}" if line.strip() else line for line in start.splitlines(keepends=True))
    return text.replace(start, why + commented, 1)
