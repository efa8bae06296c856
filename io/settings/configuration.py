"""usbldr.toml: found beside the log, read, checked key by key, and turned into the assumptions of a run.

The sections themselves stand in sensor_sections.py.
"""

import math
from dataclasses import replace
from pathlib import Path

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
from usbldr.io.settings.validation import checked, read_document


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


def parse_configuration(document: dict[str, object], file: Path) -> Configuration:
    """Turn a parsed TOML document into a Configuration."""
    return checked(document, Configuration, file)


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
