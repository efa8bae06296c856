"""The scenarios that usbldr ships, and those of a user: TOML files, found, read and converted to dives.

A file may be ``like`` a shipped one: it then states only what differs, key by key of each section.
"""

import dataclasses
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, TypeVar

from usbldr.filters.errors import UsageError, did_you_mean
from usbldr.filters.models.noise import Gaussian
from usbldr.filters.models.parameters import UNKNOWN_START, ProcessNoise
from usbldr.filters.models.quantities import SENSOR_UNITS
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
from usbldr.io.scenarios.sections import AccuracySection, LegSection, ScenarioFile, SensorSection
from usbldr.io.settings.noise_sections import Section, noise_family_of, stated_model
from usbldr.io.settings.validation import checked, read_document

Made = TypeVar("Made")
FOLDER = Path(__file__).parent


def names_in(folder: Path) -> tuple[str, ...]:
    """Return the names of the TOML files of a folder."""
    return tuple(sorted(file.stem for file in folder.glob("*.toml")))


def scenario_names() -> tuple[str, ...]:
    """Return the names of the scenarios that are shipped."""
    return names_in(FOLDER)


def file_of(name: str, what: str, folder: Path, beside: Sequence[str] = ()) -> Path:
    """Return the shipped file of a name, or a file NAME.toml; raise UsageError with the names, and those ``beside``."""
    if Path(name).suffix == ".toml":
        return Path(name)
    if name not in (known := names_in(folder)):
        known = (*known, *beside)
        hint = did_you_mean(name, known)
        raise UsageError(f"there is no {what} {name!r}{hint} ({what}s: {', '.join(known)}, or a file NAME.toml)")
    return folder / f"{name}.toml"


def find_scenario(name: str, beside: Sequence[str] = ()) -> Scenario:
    """Return a shipped scenario, or that of a file NAME.toml; raise UsageError with the names, and those ``beside``."""
    return read_scenario(file_of(name, "scenario", FOLDER, beside))


def read_scenario(file: Path) -> Scenario:
    """Read and check a scenario; raise UsageError with file, key, nearest match and allowed values."""
    stated = checked(_document(file), ScenarioFile, file)
    dvl, compass, usbl, gps, drawn = stated.dvl, stated.compass, stated.usbl, stated.gps, stated.drawn
    assumed_compass_sd = compass.assumed_sd_deg
    return Scenario(
        name=file.stem,
        about=stated.about,
        duration_s=stated.duration_s,
        legs=legs_of(stated.leg),
        dvl=_sensor(Dvl, dvl, "dvl", misalignment_rad=yaw_rad(dvl.mount_deg), lever_m=dvl.lever_arm_m),
        # the heading reads h + A sin h + B cos h, so the yaw psi = -h reads psi + A sin psi - B cos psi
        compass=_sensor(
            Compass,
            compass,
            "compass",
            sd_rad=math.radians(compass.sd_deg),
            bias_rad=yaw_rad(compass.bias_deg),
            deviation_rad=(math.radians(compass.deviation_sin_deg), yaw_rad(compass.deviation_cos_deg)),
            assumed_sd_rad=None if assumed_compass_sd is None else math.radians(assumed_compass_sd),
        ),
        usbl=_sensor(
            Usbl,
            usbl,
            "usbl",
            accuracy=_accuracy(usbl.accuracy),
            head=made(AcousticHead, usbl.head),
            misalignment_rad=yaw_rad(usbl.mount_deg),
            lever_m=usbl.lever_arm_m,
            multipath=usbl.multipath
            and made(Multipath, usbl.multipath, least_m=usbl.multipath.offset_m[0], most_m=usbl.multipath.offset_m[1]),
            assumed_accuracy=usbl.assumed_accuracy and _accuracy(usbl.assumed_accuracy),
        ),
        gps=_sensor(Gps, gps, "gps", lever_m=gps.lever_arm_m),
        yaw_rad=yaw_rad(stated.vehicle.heading_deg),
        east_m=stated.vehicle.east_m,
        north_m=stated.vehicle.north_m,
        depth_m=stated.vehicle.depth_m,
        current_mps=(stated.current.east_mps, stated.current.north_mps),
        drawn=drawn and made(RandomWalkMotion, drawn, dvl_misalignment_sd_rad=math.radians(drawn.dvl_mount_sd_deg)),
        process=stated_model(ProcessNoise(), stated.process),
        start=stated.start and stated_model(UNKNOWN_START, stated.start),
    )


def _document(file: Path) -> dict[str, object]:
    """Return the content of a file, completed by the scenario that it is like."""
    own = read_document(file)
    like = own.pop("like", None)
    if like is None:
        return own
    if like not in (known := scenario_names()):
        hint = did_you_mean(str(like), known)
        raise UsageError(f"{file}: like = {like!r}: no such scenario{hint} (scenarios: {', '.join(known)})")
    whole = _document(FOLDER / f"{like}.toml")
    for key, value in own.items():
        inherited = whole.get(key)
        whole[key] = {**inherited, **value} if isinstance(inherited, dict) and isinstance(value, dict) else value
    return whole


def legs_of(stated: Sequence[LegSection]) -> tuple[Leg, ...]:
    """Return the legs of a course."""
    return tuple(made(Leg, leg, turn_rate_radps=yaw_rad(leg.turn_rate_dps)) for leg in stated)


def yaw_rad(clockwise_deg: float) -> float:
    """Return clockwise degrees as radians counter-clockwise."""
    return -math.radians(clockwise_deg)


def made(owner: type[Made], stated: Section, **converted: Any) -> Made:
    """Return a dataclass with the values of the keys that have the names of its fields, and the converted ones."""
    names = [field.name for field in dataclasses.fields(owner) if hasattr(stated, field.name)]  # pyright: ignore
    return owner(**{name: getattr(stated, name) for name in names} | converted)


def _sensor(owner: type[Made], stated: SensorSection, sensor: str, **converted: Any) -> Made:
    """Return a sensor with the errors that all of them can have, and its own converted values."""
    unit = SENSOR_UNITS[sensor]
    errors = getattr(stated, f"correlated_sd_{unit}"), *getattr(stated, f"outlier_{unit}")
    sd, least, most = map(math.radians, errors) if unit == "deg" else errors
    noises = {key: getattr(stated, key) for key in ("noise", "assumed_noise") if hasattr(stated, key)}
    families = {key: noise and noise_family_of(noise, Gaussian(), sensor) for key, noise in noises.items()}
    return made(
        owner,
        stated,
        correlated=CorrelatedError(sd, stated.correlated_time_s) if sd else None,
        outliers=Outliers(stated.outlier_share, least, most) if stated.outlier_share else None,
        timing=made(Timing, stated),
        **families | {"noise": families["noise"] or Gaussian()},
        **converted,
    )


def _accuracy(stated: AccuracySection) -> Accuracy:
    bearing = stated.bearing_sd_deg
    return made(Accuracy, stated, bearing_sd_rad=None if bearing is None else math.radians(bearing))
