"""The calibration of a USBL's installation as text, as JSON, as a page, and as keys of a configuration."""

import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import tomlkit

from usbldr.filters.usbl_survey.calibration import Installation, Known
from usbldr.filters.usbl_survey.geometry import PLACE, UsblSurvey
from usbldr.filters.usbl_survey.verdict import Parameter, Verdict
from usbldr.io.conventions.usbl_head import SHIP, SHIP_HEADING
from usbldr.io.geodesy import to_geodetic
from usbldr.io.log import Log
from usbldr.io.reading.usbl_survey import SurveyLog
from usbldr.io.reports.page import Block, Bullets, Page, PageSection
from usbldr.io.reports.report_text import TextTable
from usbldr.io.reports.run_page import provenance_section
from usbldr.io.reports.run_provenance import RunProvenance, made_by, provenance_content
from usbldr.io.settings.configuration import parse_configuration
from usbldr.io.settings.toml_text import comment, put
from usbldr.io.settings.validation import read_text

LABELS = {  # unit and decimal places
    "mount_roll_deg": ("roll of the head", "deg", 3),
    "mount_pitch_deg": ("pitch of the head", "deg", 3),
    "mount_heading_deg": ("heading of the head", "deg", 3),
    "scale": ("scale of ranges", "", 5),
    "arm_starboard_m": ("starboard arm", "m", 3),
    "arm_forward_m": ("forward arm", "m", 3),
    "attitude_latency_s": ("latency of attitude", "s", 3),
    "position_latency_s": ("latency of position", "s", 3),
    "east_m": ("transponder east", "m", 2),
    "north_m": ("transponder north", "m", 2),
    "depth_m": ("transponder depth", "m", 2),
}
USBL_KEYS = {
    "mount_roll_deg": "mount_roll_deg",
    "mount_pitch_deg": "mount_pitch_deg",
    "mount_heading_deg": "mount_deg",
    "scale": "sound_speed_scale",
}
HEAD_KEYS = {"attitude_latency_s": "heading_latency_s", "position_latency_s": "latency_s"}
DEPTHS_APART = 3.0  # sigmas between the depth of the transponder as found and as stated


class Calibration(NamedTuple):
    """What a survey or a dive says of the installation."""

    log: SurveyLog | Log
    topics: Mapping[str, str]  # what was read -> topic
    level: bool  # the fixes are turned by the ship's roll and pitch
    verdict: Verdict
    numbers: Mapping[str, float]  # of the noise, for JSON
    slant_m: float  # median of the ranges
    fixes: int
    measured: str  # in a sentence
    remarks: tuple[str, ...]
    provenance: RunProvenance


def of_survey(
    log: SurveyLog, survey: UsblSurvey, found: Verdict, fit: Installation, known: Known, made: RunProvenance
) -> Calibration:
    """Return the calibration by a survey, as it was fitted."""
    level = log.level and not survey.level
    minutes = (survey.time_s[-1] - survey.time_s[0]) / 60
    nearest, farthest = np.quantile(survey.range_m, [0.01, 0.99])
    turned = "with roll and pitch of the ship" if level else "roll and pitch of the ship are not used"
    range_sd_m, angle_sd_deg = float(fit.noise_sd[0]), float(np.degrees(fit.noise_sd[1]))
    measured = (
        f"{len(survey)} fixes in {minutes:.0f} min at {nearest:.0f} to {farthest:.0f} m; "
        f"{found.false_share:.1%} false; {turned}; "
        f"noise of ranges {range_sd_m:.2f} m, of angles {angle_sd_deg:.2f} deg"
    )
    remarks: list[str] = []
    if not log.level:
        remarks.append("the ship's records hold no roll and pitch, so its waves are in the noise of the angles")
    found_m, stated_m = fit.values[-1], known.values[-1]
    if abs(found_m - stated_m) > DEPTHS_APART * np.hypot(fit.sd[-1], known.sd[-1]):
        remarks.append(
            f"the transponder lies {found_m:.1f} m deep, but {stated_m:.1f} m by --transponder-depth: "
            "both count from the surface if depth_m in head says how deep the head is"
        )
    if log.origin is not None:
        lat, lon = to_geodetic(log.origin, *fit.values[PLACE][:2, None])
        remarks.append(f"the transponder lies at latitude {lat[0]:.7f}, longitude {lon[0]:.7f}")
    numbers = {"range_sd_m": range_sd_m, "angle_sd_deg": angle_sd_deg}
    slant_m = float(np.median(survey.range_m))
    return Calibration(log, log.topics, level, found, numbers, slant_m, len(survey), measured, tuple(remarks), made)


def of_dive(log: Log, found: Verdict, slant_m: float, fixes: int, measured: str, made: RunProvenance) -> Calibration:
    """Return the calibration by a dive."""
    remark = "lever arm and latencies of the head are taken as stated: a survey of a transponder finds them, too"
    topics = {role: one.topic for role, one in log.provenance.items()}
    return Calibration(log, topics, log.settings.usbl.level, found, {}, slant_m, fixes, measured, (remark,), made)


def name_of(parameter: str) -> str:
    """Return how texts name a parameter."""
    return LABELS[parameter][0] if parameter in LABELS else parameter


def cells(one: Parameter) -> tuple[str, str, str]:
    """Return the value, its sigma, and how far the sigma moves a fix, with their units."""
    _, unit, digits = LABELS[one.name]
    value, sd = (f"{number:.{digits}f} {unit}".strip() for number in (one.value, one.sd))
    return value, sd, f"{one.effect_m:.3f} m"


def tables(found: Calibration) -> tuple[TextTable, TextTable]:
    """Return the errors of the installation, and the scatter of the fixes before and after."""
    verdict = found.verdict
    rows = tuple((name_of(one.name), *cells(one)) for one in verdict.parameters)
    reach = f"moves a fix at {found.slant_m:.0f} m by"
    shown = {"median (CEP50)": (1, 1), "DRMS": (1, 0), "2 DRMS": (2, 0), "CEP95": (1, 2)}  # factor, place in Scatter
    scatters = (
        [f"{k * one[at]:.2f} m ({k * one[at + 3]:.2f} %)" for k, at in shown.values()]
        for one in (verdict.before, verdict.after)
    )
    return (
        TextTable("installation", ("value", "sigma", f"sigma {reach}"), rows),
        TextTable("scatter (of slant range)", ("before", "after"), tuple(zip(shown, *scatters, strict=True))),
    )


def summary(found: Calibration) -> str:
    """Return the verdict as a sentence."""
    text = found.verdict.why
    for name, (label, *_) in LABELS.items():
        text = text.replace(name, label)
    return f"{found.verdict.result}: {text}"


def notes(found: Calibration) -> list[str]:
    """Return what is left open, and what else there is to say."""
    lines = [*states(found.verdict.parameters), *found.remarks]
    return [*lines, *(f"{finding.code}: {finding.text}" for finding in found.log.findings)]


def states(parameters: Sequence[Parameter]) -> list[str]:
    """Return which parameters are open, and what would settle them."""
    groups: dict[tuple[str, frozenset[str]], list[str]] = {}  # by leg, and all that are not separated
    for one in parameters:
        if one.open:
            groups.setdefault((one.leg, frozenset({one.name, *one.rivals} if one.rivals else ())), []).append(one.name)
    lines: list[str] = []
    for (leg, together), names in groups.items():
        others = ", ".join(map(name_of, sorted(together.difference(names)))) or "each other"
        apart = f"cannot be separated from {others}; " if together else ""
        lines.append(f"{', '.join(map(name_of, names))}: open: {apart}{leg}")
    return lines


def page(found: Calibration, figures: Sequence[Block]) -> Page:
    """Return the report as a page."""
    installation, scatter = tables(found)
    judged = "Half of the fixes were fitted and the other half judged, both ways round; false fixes are left out."
    return Page(
        f"USBL calibration: {found.log.path.name}",
        summary(found),
        (
            PageSection("", (found.measured + ".", installation, Bullets(tuple(notes(found))))),
            PageSection("Scatter", (scatter, judged)),
            PageSection("Figures", tuple(figures)),
            provenance_section(found.provenance),
        ),
    )


def content(found: Calibration, files: Sequence[str] = ()) -> dict[str, Any]:
    """Return the calibration as JSON has it."""
    verdict = found.verdict
    return {
        **made_by(),
        "log": {"path": str(found.log.path), "sha256": found.log.sha256, "topics": dict(found.topics)},
        "provenance": provenance_content(found.provenance),
        "result": verdict.result,
        "why": verdict.why,
        "level": found.level,
        "fixes": found.fixes,
        "false_share": verdict.false_share,
        **found.numbers,
        "halves_chi_square": verdict.disagreement,
        "parameters": [one._asdict() for one in verdict.parameters],
        "before": verdict.before._asdict(),
        "after": verdict.after._asdict(),
        "remarks": list(found.remarks),
        "findings": [{"code": f.code, "text": f.text, "topic": f.topic} for f in found.log.findings],
        "files": sorted(files),
    }


def calibrated_configuration(found: Calibration) -> str:
    """Return the configuration of the log with the installation that was found; open errors stay as stated."""
    file = found.log.configuration
    document: Any = tomlkit.parse("schema = 1\n" if file is None else read_text(file))
    title = [comment(f"The installation of the USBL as calibrate-usbl found it on {found.log.path.name}.")]
    left = [name_of(one.name) for one in found.verdict.parameters if one.open]
    title += [comment(f"{name} is left as stated: the fixes do not settle it.") for name in left]
    if "depth_m" not in document.get("usbl", {}).get("head", {}):
        title.append(comment("A dive needs depth_m in head, how deep the head is: a survey does not find it."))
    usbl = document.setdefault("usbl", tomlkit.table())
    usbl["level"] = found.level
    settled: dict[str, float] = {}
    for one in found.verdict.parameters:
        if not one.open:
            *_, digits = LABELS[one.name]
            settled[one.name] = round(one.value, digits)
            if one.name in USBL_KEYS:
                put(usbl, USBL_KEYS[one.name], tomlkit.item(settled[one.name]), f"± {one.sd:.{digits}f}")
    if "head" not in usbl:
        usbl["head"] = tomlkit.inline_table()
        usbl["head"].update({"topic": found.topics[SHIP], "heading_topic": found.topics[SHIP_HEADING]})
    head = usbl["head"]
    arm = [float(metres) for metres in head.get("lever_arm_m", (0.0, 0.0, 0.0))]
    for axis, name in enumerate(("arm_starboard_m", "arm_forward_m")):
        if name in settled:
            arm[axis] = settled[name]
            head["lever_arm_m"] = arm
    head.update({key: settled[name] for name, key in HEAD_KEYS.items() if name in settled})
    text = "\n".join(title) + "\n" + tomlkit.dumps(document)
    parse_configuration(tomllib.loads(text), file or Path("usbldr.toml"))
    return text


def plan_table(planned: Sequence[Parameter]) -> TextTable:
    """Return the sigmas that a planned survey will reach."""
    rows = tuple((name_of(one.name), *cells(one)[1:]) for one in planned)
    return TextTable("installation", ("sigma", "moves a fix by"), rows)


def plan_content(scenario: str, fixes: int, planned: Sequence[Parameter]) -> dict[str, Any]:
    """Return the plan as JSON has it; the values are those of the scenario."""
    parameters = [one._asdict() for one in planned]
    return {**made_by(), "scenario": scenario, "fixes": fixes, "parameters": parameters}
