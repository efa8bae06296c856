"""Simulated surveys of a transponder that lies still: their scenarios, and their files."""

from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import pandas as pd
from msgspec import Meta
from msgspec.structs import asdict, astuple

from usbldr.filters.simulation.scenario import SurveyScenario
from usbldr.filters.simulation.simulate import simulate_survey
from usbldr.filters.usbl_survey.geometry import UsblSurvey
from usbldr.io.geodesy import to_geodetic
from usbldr.io.scenarios.sections import LegSection, Part
from usbldr.io.scenarios.shipped import file_of, legs_of, made, names_in, yaw_rad
from usbldr.io.scenarios.simulated_log import ORIGIN, START_NS
from usbldr.io.settings.noise_sections import NotNegative, Positive, Section
from usbldr.io.settings.toml_text import toml_text
from usbldr.io.settings.validation import checked, read_document
from usbldr.io.writers.write_log import WRITTEN_BY, write_log_atomically

FOLDER = Path(__file__).parent / "surveys"


class ShipSection(Section, frozen=True, kw_only=True):
    """The course of the antenna begins here; the ship rolls and pitches, and records position and attitude."""

    east_m: float = 0.0
    north_m: float = 0.0
    heading_deg: float = 0.0
    roll_deg: NotNegative = 4.0
    roll_period_s: Positive = 9.0
    pitch_deg: NotNegative = 1.5
    pitch_period_s: Positive = 7.0
    position_rate_hz: Positive = 5.0
    position_sd_m: NotNegative = 0.02
    attitude_rate_hz: Positive = 20.0
    attitude_sd_deg: NotNegative = 0.02


class TransponderSection(Section, frozen=True, kw_only=True):
    """Where the transponder lies."""

    east_m: float = 10.0
    north_m: float = -5.0
    depth_m: Positive = 100.0


class InstallationSection(Section, frozen=True, kw_only=True):
    """The errors of the USBL's installation, in the order of geometry.NAMES; the transponder's place follows."""

    mount_roll_deg: float = 0.8
    mount_pitch_deg: float = -0.6
    mount_deg: float = 1.5
    sound_speed_scale: Annotated[float, Meta(ge=0.5, le=2)] = 0.99
    arm_starboard_m: float = 1.2
    arm_forward_m: float = -8.0
    heading_latency_s: float = 0.1
    latency_s: float = 0.3


class FixSection(Section, frozen=True, kw_only=True):
    """The fixes and their noise."""

    rate_hz: Positive = 0.5
    range_sd_m: Positive = 0.1
    angle_sd_deg: Positive = 0.25
    dof: Annotated[float, Meta(gt=2)] = 4.0
    outlier_share: Part = 0.03
    outlier_deg: Positive = 10.0


class SurveyFile(Section, frozen=True, kw_only=True):
    """A whole survey."""

    schema: Literal[1]
    about: str
    leg: Annotated[tuple[LegSection, ...], Meta(min_length=1)]
    ship: ShipSection = ShipSection()
    transponder: TransponderSection = TransponderSection()
    installation: InstallationSection = InstallationSection()
    fixes: FixSection = FixSection()


def survey_names() -> tuple[str, ...]:
    """Return the names of the surveys that are shipped."""
    return names_in(FOLDER)


def is_survey(name: str) -> bool:
    """Return whether a name is a shipped survey, or a file NAME.toml with a transponder or fixes of a survey."""
    if Path(name).suffix == ".toml":
        return not {"ship", "transponder", "installation", "fixes"}.isdisjoint(read_document(Path(name)))
    return name in survey_names()


def find_survey(name: str) -> SurveyScenario:
    """Return a shipped survey, or that of a file NAME.toml.

    Raises UsageError with the names, and for a fault of the file with file, key, nearest match and allowed values.
    """
    file = file_of(name, "survey", FOLDER)
    stated = checked(read_document(file), SurveyFile, file)
    return made(
        SurveyScenario,
        stated.ship,
        **asdict(stated.fixes),
        name=file.stem,
        about=stated.about,
        legs=legs_of(stated.leg),
        yaw_rad=yaw_rad(stated.ship.heading_deg),
        true_values=np.array([*astuple(stated.installation), *astuple(stated.transponder)]),
    )


def write_survey(scenario: SurveyScenario, seed: int, out: Path, force: bool = False) -> tuple[UsblSurvey, Path]:
    """Write a survey as a folder of CSV files with its configuration; return it and the configuration's path.

    The configuration states how the files are read, and no error of the installation. Raises UsageError if the folder
    exists and is not replaced.
    """
    survey = simulate_survey(scenario, seed)
    ship = survey.ship
    lat_deg, lon_deg = to_geodetic(ORIGIN, *ship.position_m.T)
    fixes = {"slant_range_m": survey.range_m, "bearing_deg": np.degrees(survey.bearing_rad) % 360}
    fixes["elevation_deg"] = np.degrees(np.arcsin(-survey.direction[:, 2]))
    heading, pitch, roll = ship.attitude_deg.T
    tables = {
        "gps": (ship.position_time_s, {"lat_deg": lat_deg, "lon_deg": lon_deg}),
        "compass": (ship.attitude_time_s, {"heading_deg": heading % 360, "roll_deg": roll, "pitch_deg": pitch}),
        "usbl": (survey.time_s, fixes),
    }
    text = toml_text(
        (f"{WRITTEN_BY} simulate {scenario.name} --seed {seed}", "How the files are read; no error of the USBL."),
        {
            "map": {"origin_lat_deg": f"{ORIGIN.lat_deg!r}", "origin_lon_deg": f"{ORIGIN.lon_deg!r}"},
            "usbl": {"frame": '"body"', "level": "true", "head": '{ topic = "gps", heading_topic = "compass" }'},
        },
        {},
    )

    def make(target: Path) -> None:
        target.mkdir()
        for name, (time_s, columns) in tables.items():
            time_ns = START_NS + np.round(time_s * 1e9).astype(np.int64)
            pd.DataFrame({"time_ns": time_ns, **columns}).to_csv(target / f"{name}.csv", index=False)

    return survey, write_log_atomically(out, "csv", text, make, force)
