"""Simulated logs: a scenario as the tables that reading its file would give, and as files with their configuration.

The configuration says what a careful user would know beforehand: the noise, the start, the conventions of the file. It
never says a true bias, scale, misalignment or latency.
"""

import hashlib
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
import pandas as pd
import pymap3d  # pyright: ignore[reportMissingTypeStubs]

from usbldr.filters.assumptions import Assumptions
from usbldr.filters.noise import Contamination, Gaussian, Mixture, NoiseFamily, StudentT
from usbldr.filters.scenarios import Scenario
from usbldr.filters.simulation import simulate
from usbldr.filters.types import Array, Truth, Vector
from usbldr.io.log import COLUMNS, Log, Origin, Provenance

START_NS = 1_767_225_600_000_000_000  # 2026-01-01T00:00:00Z: a fixed date, so that the same seed gives the same bytes
ORIGIN = Origin(45.0, -30.0, "[map]")  # invented: the open Atlantic


def simulated_log(scenario: Scenario, seed: int) -> Log:
    """Return the log that writing the scenario and reading it back would give, without a file."""
    tables = _tables(scenario, seed)
    gps = tables["gps"]
    return Log(
        path=Path(scenario.name),
        sha256=_digest(tables),
        format="simulated",
        start_ns=START_NS,
        tables=tables,
        provenance={
            sensor: Provenance(f"{scenario.name}/{sensor}", "simulated", "scenario", (f"seed {seed}",), len(t), len(t))
            for sensor, t in tables.items()
        },
        assumptions=Assumptions(
            process=scenario.process,
            dvl=scenario.dvl.noise,
            compass=scenario.compass.noise,
            usbl=scenario.usbl.assumed_noise,
            start=scenario.start,
        ),
        origin=ORIGIN,
        truth=Truth(
            time_s=gps["time_s"].to_numpy(),
            position_m=gps[["east_m", "north_m"]].to_numpy(),
            sd_m=gps["sd_m"].to_numpy(),
            kind="simulated",
            source=f"{scenario.name}/gps",
        ),
    )


def configuration_text(scenario: Scenario, seed: int, conventions: Mapping[str, Mapping[str, str]]) -> str:
    """Return the usbldr.toml of a simulated log; ``conventions`` are the keys of each section that the file needs."""
    dvl, compass, usbl, process = scenario.dvl, scenario.compass, scenario.usbl, scenario.process
    sections: dict[str, dict[str, str]] = {
        "map": {"origin_lat_deg": f"{ORIGIN.lat_deg!r}", "origin_lon_deg": f"{ORIGIN.lon_deg!r}"},
        "dvl": {"sd_mps": f"{dvl.sd_mps!r}", "noise": noise_text(dvl.noise, "mps")},
        "compass": {"sd_deg": f"{degrees(compass.sd_rad)!r}", "noise": noise_text(compass.noise, "deg")},
        "usbl": {"sd_m": f"{usbl.sd_m!r}", "noise": noise_text(usbl.assumed_noise, "m")},
        "gps": {},
        "truth": {"kind": '"simulated"'},
        "process": {
            "position_m": f"{process.position_m!r}",
            "heading_deg": f"{degrees(process.yaw_rad)!r}",
            "velocity_mps": f"{process.velocity_mps!r}",
            "turn_rate_dps": f"{degrees(process.turn_rate_radps)!r}",
        },
    }
    if scenario.start is not None:
        start = scenario.start
        sections["start"] = {
            "east_m": f"{start.east_m!r}",
            "north_m": f"{start.north_m!r}",
            "sd_m": f"{start.sd_m!r}",
            "heading_sd_deg": f"{degrees(start.sd_yaw_rad)!r}",
            "velocity_sd_mps": f"{start.sd_mps!r}",
            "turn_rate_sd_dps": f"{degrees(start.sd_radps)!r}",
        }
    title = (
        f"Written by: usbldr simulate {scenario.name} --seed {seed}",
        "What a careful user knows: noise, start and conventions; never a true bias, scale or latency.",
    )
    return toml_text(title, sections, conventions)


def toml_text(
    title: Sequence[str], sections: Mapping[str, Mapping[str, str]], conventions: Mapping[str, Mapping[str, str]]
) -> str:
    """Return a usbldr.toml; ``sections`` hold TOML values, ``conventions`` words of the same sections."""
    lines = [*(f"# {line}" for line in title), "schema = 1"]
    for section, keys in sections.items():
        stated = {name: f'"{value}"' for name, value in conventions.get(section, {}).items()} | dict(keys)
        if stated:
            lines += ["", f"[{section}]", *(f"{name} = {value}" for name, value in stated.items())]
    return "\n".join(lines) + "\n"


def _tables(scenario: Scenario, seed: int) -> dict[str, pd.DataFrame]:
    dive = simulate(scenario, seed)
    variance_m2 = scenario.usbl.sd_m**2
    gps_sd_m = scenario.gps.sd_m or math.nan  # no format can say "exact": 0 is how many say "unknown"
    lat_deg, lon_deg = _at_sea_level(dive.gps.value)
    columns: dict[str, tuple[Vector | float | bool, ...]] = {
        "dvl": (*dive.dvl[:2], *dive.dvl.value.T, 0.0, scenario.dvl.sd_mps, True),
        "compass": (*dive.compass[:2], _heading_deg(dive.compass.value[:, 0]), degrees(scenario.compass.sd_rad)),
        "usbl": (*dive.usbl[:2], *dive.usbl.value.T, variance_m2, 0.0, variance_m2),
        "gps": (*dive.gps[:2], *dive.gps.value.T, gps_sd_m, lat_deg, lon_deg),
    }
    return {s: pd.DataFrame(dict(zip(COLUMNS[s], values, strict=True))) for s, values in columns.items()}


def _at_sea_level(position_m: Array) -> tuple[Vector, Vector]:
    """Return latitude and longitude of east, north (n, 2) for a receiver at height 0.

    The tangent plane lies 8 cm above the sea 1 km from the origin; the height below it is found by iterating, so that
    readers that take the altitude and readers that do not agree.
    """
    to_geodetic: Callable[..., tuple[Vector, Vector, Vector]] = pymap3d.enu2geodetic  # pyright: ignore
    east, north = position_m.T
    up = np.zeros(len(east))
    lat, lon, height = up, up, up
    for _ in range(3):  # each leaves 1e-7 of the error
        up = up - height
        lat, lon, height = to_geodetic(east, north, up, ORIGIN.lat_deg, ORIGIN.lon_deg, 0.0)
    return lat, lon


def _heading_deg(yaw_rad: Vector) -> Vector:
    return np.degrees(-yaw_rad) % 360.0


def degrees(angle_rad: float) -> float:
    """Degrees with the fewest digits that bring back the angle: 0.1 deg in a scenario is 0.1 in its file."""
    candidates = [float(f"{math.degrees(angle_rad):.{digits}g}") for digits in range(1, 18)]
    return next((deg for deg in candidates if math.radians(deg) == angle_rad), candidates[-1])


def noise_text(family: NoiseFamily, unit: str) -> str:
    """Return the family as a TOML value."""
    match family:
        case Gaussian():
            keys = 'kind = "gaussian"'
        case Mixture():
            keys = f'kind = "mixture", share = {family.share!r}, variance_ratio = {family.variance_ratio!r}'
        case Contamination():
            sd = degrees(family.sd) if unit == "deg" else family.sd
            keys = f'kind = "contamination", share = {family.share!r}, sd_{unit} = {sd!r}'
        case StudentT():
            keys = f'kind = "student-t", dof = {family.dof!r}'
        case _:
            raise TypeError(f"no TOML form for the noise {family!r}")
    return f'{{ {keys}, per = "{"scalar" if family.per_scalar else "record"}" }}'


def _digest(tables: Mapping[str, pd.DataFrame]) -> str:
    digest = hashlib.sha256()
    for sensor, table in tables.items():
        digest.update(sensor.encode())
        for column in table:
            digest.update(table[column].to_numpy().tobytes())
    return digest.hexdigest()
