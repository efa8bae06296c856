"""usbldr.toml: found beside the log, read, checked key by key, and turned into the assumptions of a run.

The sections themselves stand in sensor_sections.py.
"""

import difflib
import math
import re
import tomllib
import typing
from dataclasses import replace
from pathlib import Path
from typing import Literal, TypeVar

import msgspec
from msgspec import Struct

from usbldr.filters.errors import UsageError
from usbldr.filters.models.calibration import AUTO, STATES
from usbldr.filters.models.noise import Contamination, Gaussian, Mixture, NoiseFamily, StudentT
from usbldr.filters.models.parameters import Assumptions, ProcessNoise, SensorErrors, Start
from usbldr.io.settings.noise_sections import (
    CalibrateSection,
    CompassContamination,
    CompassNoise,
    DvlContamination,
    DvlNoise,
    GaussianNoise,
    MixtureNoise,
    ProcessSection,
    StartSection,
    StudentNoise,
    UsblContamination,
    UsblNoise,
)
from usbldr.io.settings.sensor_sections import Configuration

Form = TypeVar("Form", bound=Struct)


def find_configuration(log: Path, asked: str | None) -> Path | None:
    """Return the file to read for ``log``: the one asked for, else NAME.usbldr.toml, else usbldr.toml, else none.

    ``asked`` = "none" ignores all of them.
    """
    if asked == "none":
        return None
    if asked is not None:
        if not Path(asked).is_file():
            raise UsageError(f"{asked}: no such configuration file")
        return Path(asked)
    return next((place for place in configuration_places(log, log.is_dir()) if place.is_file()), None)


def configuration_places(log: Path, folder: bool) -> tuple[Path, ...]:
    """Return where the configuration of a log, a folder or a file, is sought: its own place first."""
    own = [log / "usbldr.toml"] if folder else []
    return (*own, log.parent / f"{log.name if folder else log.stem}.usbldr.toml", log.parent / "usbldr.toml")


def own_configuration(log: Path, folder: bool) -> Path:
    """Return where a log's own configuration stands: inside a folder, beside a file."""
    return configuration_places(log, folder)[0]


def read_configuration(file: Path) -> Configuration:
    """Read and check a configuration; raise UsageError with file, key, nearest match and allowed values."""
    return parse_configuration(read_document(file), file)


def read_document(file: Path) -> dict[str, object]:
    """Return what a TOML file says, unchecked; raise UsageError where it is none."""
    try:
        return tomllib.loads(file.read_text(encoding="utf-8"))
    except OSError as err:
        raise UsageError(f"{file}: cannot be read ({err.strerror})") from err
    except (UnicodeDecodeError, tomllib.TOMLDecodeError) as err:
        raise UsageError(f"{file}: is not TOML ({err})") from err


def parse_configuration(document: dict[str, object], file: Path) -> Configuration:
    """Turn a parsed TOML document into a Configuration."""
    return parse_section(document, Configuration, file)


def parse_section(document: dict[str, object], form: type[Form], file: Path) -> Form:
    """Turn a parsed TOML document into a typed one; raise UsageError with file, key, nearest match, allowed values."""
    _refuse_unknown_keys(document, form, "", file)
    try:
        return msgspec.convert(document, form)
    except msgspec.ValidationError as err:
        raise UsageError(f"{file}: {_sentence(str(err), form)}") from err


def _structs(annotation: object) -> list[type[Struct]]:
    """Return the sections that a key may hold."""
    if isinstance(annotation, type) and issubclass(annotation, Struct):
        return [annotation]
    return [s for part in typing.get_args(annotation) for s in _structs(part)]


def _refuse_unknown_keys(table: dict[str, object], section: type[Struct], path: str, file: Path) -> None:
    hints = typing.get_type_hints(section, include_extras=True)
    tag = [section.__struct_config__.tag_field] if section.__struct_config__.tag_field else []
    allowed = [*tag, *section.__struct_fields__]
    for key, value in table.items():
        if key not in allowed:
            near = difflib.get_close_matches(key, allowed, n=1)
            hint = f"; did you mean {near[0]}?" if near else ""
            where = f"[{path}] has no key" if path else "there is no section"
            raise UsageError(f"{file}: {where} {key}{hint} (allowed: {', '.join(allowed)})")
        if isinstance(value, float) and not math.isfinite(value):
            raise UsageError(f"{file}: [{path}] {key} = {value} is no finite number")
        if isinstance(value, list) and key in hints and _structs(hints[key]):
            for row, inner in enumerate(typing.cast("list[object]", value)):
                if isinstance(inner, dict):
                    table_of_row = typing.cast("dict[str, object]", inner)
                    _refuse_unknown_keys(table_of_row, _structs(hints[key])[0], f"{key}[{row}]", file)
        if isinstance(value, dict) and key in hints:
            inner = typing.cast("dict[str, object]", value)
            sections = _structs(hints[key])
            tagged = [s for s in sections if s.__struct_config__.tag is not None]
            chosen = [s for s in tagged if s.__struct_config__.tag == inner.get("kind")] if tagged else sections
            if tagged and not chosen:
                kinds = ", ".join(str(s.__struct_config__.tag) for s in tagged)
                raise UsageError(f"{file}: [{path}] {key}: kind is missing or unknown (allowed: {kinds})")
            if chosen:
                _refuse_unknown_keys(inner, chosen[0], f"{path}.{key}" if path else key, file)


def _sentence(message: str, form: type[Struct]) -> str:
    """Turn msgspec's "Expected `float`, got `str` - at `$.dvl.mount_deg`" into "[dvl] mount_deg: expected ..."."""
    what, _, place = message.partition(" - at ")
    path = re.sub(r"^.*\$\.?|`$", "", place)
    invalid = re.fullmatch(r"Invalid enum value '?(.*?)'?", what)
    if invalid:
        what = f"{invalid[1]} is not allowed (allowed: {', '.join(_allowed(path, form))})"
    elif what.startswith("Object missing required field"):
        what = f"lacks the key {what.split('`')[1]}"
    elif what.startswith("Expected"):
        what = what.replace("`", "").replace("Expected", "expected").replace(" | null", "")
        what = re.sub(r"\b(float|int)\b", "number", what).replace("str", "text").replace("object", "table")
    section, _, key = path.partition(".")
    where = f"[{section}] {key}" if key else section if section == "schema" else f"[{section}]"
    return f"{where}: {what}"


def _allowed(path: str, form: type[Struct]) -> list[str]:
    """Return the words that the key at a dotted path takes."""
    annotation: object = form
    for name in path.removesuffix("[...]").split("."):
        hints = [typing.get_type_hints(s, include_extras=True) for s in _structs(annotation)]
        annotation = next((h[name] for h in hints if name in h), None)
    return list(dict.fromkeys(_words(annotation)))


def _words(annotation: object) -> list[str]:
    if typing.get_origin(annotation) is Literal:
        return [str(word) for word in typing.get_args(annotation)]
    if annotation is float:
        return ["a number"]
    return [word for part in typing.get_args(annotation) for word in _words(part)]


def assumptions(configuration: Configuration) -> Assumptions:
    """Return the model side of a run: what the file states, usbldr's defaults for the rest. Angles become radians."""
    start, default = configuration.start, Assumptions()
    return replace(
        default,
        process=process_noise(configuration.process),
        dvl=noise_family_of(configuration.dvl.noise, default.dvl),
        compass=noise_family_of(configuration.compass.noise, default.compass),
        usbl=noise_family_of(configuration.usbl.noise, default.usbl),
        gps=noise_family_of(configuration.gps.noise, default.gps),
        dvl_lever_m=configuration.dvl.lever_arm_m,
        usbl_lever_m=configuration.usbl.lever_arm_m,
        gps_lever_m=configuration.gps.lever_arm_m,
        start=start_of_section(start) if start else None,
        calibrate=_calibrated(configuration.calibrate),
        errors=sensor_errors(configuration.calibrate),
        dvl_sd_scale=configuration.dvl.sd_scale,
        usbl_sd_scale=configuration.usbl.sd_scale,
    )


def process_noise(stated: ProcessSection) -> ProcessNoise:
    """Return the random walks that a section states, usbldr's defaults for the rest."""
    walks = {
        "position_m": stated.position_m,
        "yaw_rad": _radians(stated.heading_deg),
        "velocity_mps": stated.velocity_mps,
        "turn_rate_radps": _radians(stated.turn_rate_dps),
        "uncalibrated_m": stated.uncalibrated_m,
    }
    return replace(ProcessNoise(), **{name: walk for name, walk in walks.items() if walk is not None})


def _calibrated(stated: CalibrateSection) -> tuple[str, ...]:
    """Return the keys in their own order, or AUTO alone."""
    return (AUTO,) if stated.states == AUTO else tuple(key for key in STATES if key in stated.states)


def sensor_errors(stated: CalibrateSection) -> SensorErrors:
    """Return how large the sensors' errors may be: what a section states, usbldr's defaults for the rest."""
    sizes = {
        "scale": stated.scale_sd,
        "misalignment_rad": _radians(stated.mount_sd_deg),
        "heading_rad": _radians(stated.heading_sd_deg),
        "heading_walk_rad": _radians(stated.heading_walk_deg),
        "deviation_rad": _radians(stated.deviation_sd_deg),
        "latency_s": stated.latency_sd_s,
        "usbl_bias_m": stated.usbl_bias_sd_m,
        "usbl_bias_s": stated.usbl_bias_time_s,
    }
    return replace(SensorErrors(), **{name: size for name, size in sizes.items() if size is not None})


def start_of_section(stated: StartSection) -> Start:
    """Return the start that a section states."""
    return Start(
        stated.east_m,
        stated.north_m,
        stated.sd_m,
        math.radians(stated.heading_sd_deg),
        stated.velocity_sd_mps,
        math.radians(stated.turn_rate_sd_dps),
    )


def _radians(angle_deg: float | None) -> float | None:
    return None if angle_deg is None else math.radians(angle_deg)


def noise_family_of(noise: DvlNoise | CompassNoise | UsblNoise | None, default: NoiseFamily) -> NoiseFamily:
    """Return the noise family that a section states; ``per`` is the family's own unless stated."""
    chosen: Gaussian | Mixture | StudentT | Contamination
    match noise:
        case None:
            return default
        case GaussianNoise():
            chosen = Gaussian()
        case MixtureNoise():
            chosen = Mixture(noise.share, noise.variance_ratio)
        case StudentNoise():
            chosen = StudentT(noise.dof)
        case DvlContamination():
            chosen = Contamination(noise.share, noise.sd_mps)
        case CompassContamination():
            chosen = Contamination(noise.share, math.radians(noise.sd_deg))
        case UsblContamination():
            chosen = Contamination(noise.share, noise.sd_m)
    return chosen if noise.per is None else replace(chosen, per_scalar=noise.per == "scalar")
