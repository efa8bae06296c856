"""The scenarios that usbldr ships, and those of a user: TOML files, found, read and converted to dives.

A file may be ``like`` a shipped one: it then states only what differs, key by key of each section.
"""

import math
from pathlib import Path

from usbldr.filters.errors import UsageError
from usbldr.filters.models.noise import Gaussian, NoiseFamily
from usbldr.filters.models.parameters import ProcessNoise
from usbldr.filters.simulation.scenario import (
    Accuracy,
    AcousticHead,
    Compass,
    CorrelatedError,
    Dvl,
    Gps,
    Leg,
    Multipath,
    Outliers,
    RandomWalkMotion,
    Scenario,
    Timing,
    Usbl,
)
from usbldr.io.scenarios.sections import (
    AccuracySection,
    CompassSensor,
    DvlSensor,
    GpsSensor,
    MultipathSection,
    ScenarioFile,
    SensorSection,
    UsblSensor,
)
from usbldr.io.settings.noise_sections import Section, noise_family_of, start_of, stated_model
from usbldr.io.settings.validation import checked, read_document

FOLDER = Path(__file__).parent


def scenario_names() -> tuple[str, ...]:
    """Return the names of the scenarios that are shipped."""
    return tuple(sorted(file.stem for file in FOLDER.glob("*.toml")))


def find_scenario(name: str) -> Scenario:
    """Return a shipped scenario, or that of a file NAME.toml; raise UsageError with the names."""
    if Path(name).suffix == ".toml":
        return read_scenario(Path(name))
    if name not in scenario_names():
        raise UsageError(
            f"there is no scenario {name!r} (scenarios: {', '.join(scenario_names())}, or a file NAME.toml)"
        )
    return read_scenario(FOLDER / f"{name}.toml")


def read_scenario(file: Path) -> Scenario:
    """Read and check a scenario; raise UsageError with file, key, nearest match and allowed values."""
    stated = checked(_document(file), ScenarioFile, file)
    vehicle, drawn = stated.vehicle, stated.drawn
    return Scenario(
        name=file.stem,
        about=stated.about,
        duration_s=stated.duration_s,
        legs=tuple(
            Leg(leg.duration_s, leg.starboard_mps, leg.forward_mps, _yaw(leg.turn_rate_dps)) for leg in stated.leg
        ),
        dvl=_dvl(stated.dvl),
        compass=_compass(stated.compass),
        usbl=_usbl(stated.usbl),
        gps=_gps(stated.gps),
        yaw_rad=_yaw(vehicle.heading_deg),
        east_m=vehicle.east_m,
        north_m=vehicle.north_m,
        depth_m=vehicle.depth_m,
        current_mps=(stated.current.east_mps, stated.current.north_mps),
        drawn=drawn and RandomWalkMotion(drawn.step_s, drawn.dvl_scale_sd, math.radians(drawn.dvl_mount_sd_deg)),
        process=stated_model(ProcessNoise(), stated.process),
        start=stated.start and start_of(stated.start),
    )


def _document(file: Path) -> dict[str, object]:
    """Return the content of a file, completed by the scenario that it is like."""
    own = read_document(file)
    like = own.pop("like", None)
    if like is None:
        return own
    if like not in scenario_names():
        raise UsageError(f"{file}: like = {like!r}: no such scenario (scenarios: {', '.join(scenario_names())})")
    whole = _document(FOLDER / f"{like}.toml")
    for key, value in own.items():
        inherited = whole.get(key)
        whole[key] = {**inherited, **value} if isinstance(inherited, dict) and isinstance(value, dict) else value
    return whole


def _yaw(clockwise_deg: float) -> float:
    """Return clockwise degrees as radians counter-clockwise."""
    return -math.radians(clockwise_deg)


def _noise(stated: Section | None, sensor: str) -> NoiseFamily:
    return noise_family_of(stated, Gaussian(), sensor)


def _assumed_noise(stated: Section | None, sensor: str) -> NoiseFamily | None:
    return None if stated is None else _noise(stated, sensor)


def _timing(stated: SensorSection) -> Timing:
    return Timing(
        stated.latency_s,
        stated.delay_s,
        stated.delay_spread_s,
        stated.jitter_s,
        stated.clock_offset_s,
        stated.dropout_share,
        stated.silences_s,
    )


def _correlated(sd: float, stated: SensorSection) -> CorrelatedError | None:
    return CorrelatedError(sd, stated.correlated_time_s) if sd else None


def _outliers(between: tuple[float, float], stated: SensorSection) -> Outliers | None:
    return Outliers(stated.outlier_share, *between) if stated.outlier_share else None


def _dvl(stated: DvlSensor) -> Dvl:
    return Dvl(
        stated.rate_hz,
        stated.sd_mps,
        _noise(stated.noise, "dvl"),
        scale_error=stated.scale_error,
        misalignment_rad=_yaw(stated.mount_deg),
        bias_mps=stated.bias_mps,
        lever_m=stated.lever_arm_m,
        water_track_s=stated.water_track_s,
        correlated=_correlated(stated.correlated_sd_mps, stated),
        outliers=_outliers(stated.outlier_mps, stated),
        timing=_timing(stated),
        told_sd_mps=stated.told_sd_mps,
        told_noise=_assumed_noise(stated.told_noise, "dvl"),
    )


def _compass(stated: CompassSensor) -> Compass:
    """The heading reads h + A sin h + B cos h, so the yaw psi = -h reads psi + A sin psi - B cos psi."""
    told_sd = stated.told_sd_deg
    return Compass(
        stated.rate_hz,
        math.radians(stated.sd_deg),
        _noise(stated.noise, "compass"),
        bias_rad=_yaw(stated.bias_deg),
        deviation_rad=(math.radians(stated.deviation_sin_deg), _yaw(stated.deviation_cos_deg)),
        correlated=_correlated(math.radians(stated.correlated_sd_deg), stated),
        outliers=_outliers((math.radians(stated.outlier_deg[0]), math.radians(stated.outlier_deg[1])), stated),
        timing=_timing(stated),
        told_sd_rad=None if told_sd is None else math.radians(told_sd),
        told_noise=_assumed_noise(stated.told_noise, "compass"),
    )


def _usbl(stated: UsblSensor) -> Usbl:
    return Usbl(
        stated.rate_hz,
        _accuracy(stated.accuracy),
        _noise(stated.noise, "usbl"),
        head=AcousticHead(stated.head.east_m, stated.head.north_m, stated.head.depth_m),
        inverted=stated.inverted,
        scale_error=stated.scale_error,
        misalignment_rad=_yaw(stated.mount_deg),
        bias_m=stated.bias_m,
        lever_m=stated.lever_arm_m,
        correlated=_correlated(stated.correlated_sd_m, stated),
        outliers=_outliers(stated.outlier_m, stated),
        multipath=stated.multipath and _multipath(stated.multipath),
        timing=_timing(stated),
        told_accuracy=stated.told_accuracy and _accuracy(stated.told_accuracy),
        told_noise=_assumed_noise(stated.told_noise, "usbl"),
    )


def _accuracy(stated: AccuracySection) -> Accuracy:
    bearing = stated.bearing_sd_deg
    return Accuracy(stated.sd_m, stated.sd_rel, None if bearing is None else math.radians(bearing))


def _multipath(stated: MultipathSection) -> Multipath:
    return Multipath(
        *stated.offset_m, stated.scatter_m, stated.share, stated.clusters_s, stated.every_s, stated.lasts_s
    )


def _gps(stated: GpsSensor) -> Gps:
    return Gps(
        stated.rate_hz,
        stated.sd_m,
        _noise(stated.noise, "gps"),
        lever_m=stated.lever_arm_m,
        bias_m=stated.bias_m,
        correlated=_correlated(stated.correlated_sd_m, stated),
        outliers=_outliers(stated.outlier_m, stated),
        timing=_timing(stated),
        told_sd_m=stated.told_sd_m,
    )
