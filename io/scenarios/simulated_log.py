"""Simulated logs: a scenario as the tables of its file when read back, and as files with their configuration.

The configuration states what is known before a dive: the noise, the start, the conventions of the file, but not the
true biases, scales, misalignments or latencies.
"""

import hashlib
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TypeVar

import numpy as np
import pandas as pd
import pymap3d  # pyright: ignore[reportMissingTypeStubs]

from usbldr.filters.frames import heading_deg
from usbldr.filters.models.calibration import AUTO
from usbldr.filters.models.parameters import LeverArm, Parameters
from usbldr.filters.simulation.scenario import Scenario
from usbldr.filters.simulation.simulate import simulate
from usbldr.filters.types import Array, Truth, Vector
from usbldr.io.conventions.usbl_covariance import with_variance_floor
from usbldr.io.geodesy import Origin, OriginKind
from usbldr.io.log import COLUMNS, Log
from usbldr.io.provenance import Convention, Provenance
from usbldr.io.reader import Column
from usbldr.io.settings.toml_text import noise_text, shortest_degrees, stated, toml_text
from usbldr.io.writers.write_log import WRITTEN_BY, conventions_of, log_format_of, write_log_atomically, write_records

Quantity = TypeVar("Quantity")
START_NS = 1_767_225_600_000_000_000  # fixed: 2026-01-01T00:00:00Z, so that the same seed gives the same bytes
ORIGIN = Origin(45.0, -30.0, OriginKind.MAP)  # invented: the open Atlantic


def simulated_log(scenario: Scenario, seed: int) -> Log:
    """Return the log that writing the scenario and reading it back would give, without a file."""
    start_ns, tables = _tables(scenario, seed)
    gps = tables.get("gps")
    truth = None
    if gps is not None:
        truth = Truth(
            time_s=gps["time_s"].to_numpy(),
            position_m=gps[["east_m", "north_m"]].to_numpy(),
            sd_m=gps["sd_m"].to_numpy(),
            kind="simulated",
            source=f"{scenario.name}/gps",
        )
    seeded = (Convention("seed", seed, "option"),)
    return Log(
        path=Path(scenario.name),
        sha256=_digest(tables),
        format="simulated",
        start_ns=start_ns,
        tables=tables,
        provenance={
            sensor: Provenance(f"{scenario.name}/{sensor}", "simulated", "scenario", seeded, len(t), len(t))
            for sensor, t in tables.items()
        },
        parameters=Parameters(
            process=scenario.process,
            dvl=_assumed(scenario.dvl.assumed_noise, scenario.dvl.noise),
            compass=_assumed(scenario.compass.assumed_noise, scenario.compass.noise),
            usbl=_assumed(scenario.usbl.assumed_noise, scenario.usbl.noise),
            dvl_lever_m=scenario.dvl.lever_m,
            usbl_lever_m=scenario.usbl.lever_m,
            gps_lever_m=scenario.gps.lever_m,
            start=scenario.start,
            calibrate=(AUTO,),
        ),
        origin=ORIGIN,
        truth=truth,
    )


def _assumed(stated: Quantity | None, true: Quantity) -> Quantity:
    """Return the value of a quantity that a filter assumes: the scenario's, else the true one."""
    return true if stated is None else stated


def configuration_text(scenario: Scenario, seed: int, conventions: Mapping[str, Mapping[str, str]]) -> str:
    """Return the usbldr.toml of a simulated log; ``conventions`` are the keys of each section that the file needs."""
    dvl, compass, usbl, process = scenario.dvl, scenario.compass, scenario.usbl, scenario.process
    accuracy = _assumed(usbl.assumed_accuracy, usbl.accuracy)
    sections: dict[str, dict[str, str]] = {
        "map": {"origin_lat_deg": f"{ORIGIN.lat_deg!r}", "origin_lon_deg": f"{ORIGIN.lon_deg!r}"},
        "dvl": {
            "sd_mps": repr(_assumed(dvl.assumed_sd_mps, dvl.sd_mps)),
            "noise": noise_text(_assumed(dvl.assumed_noise, dvl.noise), "dvl"),
            **_lever(dvl.lever_m),
        },
        "compass": {
            "sd_deg": repr(shortest_degrees(_assumed(compass.assumed_sd_rad, compass.sd_rad))),
            "noise": noise_text(_assumed(compass.assumed_noise, compass.noise), "compass"),
        },
        "usbl": {
            "sd_m": repr(accuracy.sd_m) if accuracy.constant else '"message"',
            "noise": noise_text(_assumed(usbl.assumed_noise, usbl.noise), "usbl"),
            **_lever(usbl.lever_m),
        },
        "gps": _lever(scenario.gps.lever_m),
        "truth": {"kind": '"simulated"'},
        "process": stated(process),
    }
    if not process.uncalibrated_m:
        del sections["process"]["uncalibrated_m"]
    if scenario.start is not None:
        sections["start"] = stated(scenario.start)
    title = (
        f"{WRITTEN_BY} simulate {scenario.name} --seed {seed}",
        "Known before the dive: noise, start and conventions; not the true biases, scales or latencies.",
    )
    return toml_text(title, sections, conventions)


def _lever(arm_m: LeverArm) -> dict[str, str]:
    return {"lever_arm_m": str(list(arm_m))} if any(arm_m) else {}


def _tables(scenario: Scenario, seed: int) -> tuple[int, dict[str, pd.DataFrame]]:
    """Return the absolute time of time_s = 0, and each sensor's table; one without records has none."""
    dive = simulate(scenario, seed)
    dvl, compass, gps = scenario.dvl, scenario.compass, scenario.gps
    cov_m2 = with_variance_floor(dive.fix_cov_m2)
    gps_sd_m = _assumed(gps.assumed_sd_m, gps.sd_m) or math.nan  # many formats take 0 for "unknown"
    lat_deg, lon_deg = _at_sea_level(dive.gps.value)
    columns: dict[str, tuple[Column | float, ...]] = {
        "dvl": (*dive.dvl.value.T, 0.0, _assumed(dvl.assumed_sd_mps, dvl.sd_mps), dive.dvl.valid),
        "compass": (
            heading_deg(dive.compass.value[:, 0]),
            shortest_degrees(_assumed(compass.assumed_sd_rad, compass.sd_rad)),
        ),
        "usbl": (*dive.usbl.value.T, cov_m2[:, 0, 0], cov_m2[:, 0, 1], cov_m2[:, 1, 1]),
        "gps": (*dive.gps.value.T, gps_sd_m, lat_deg, lon_deg),
    }
    records = {"dvl": dive.dvl, "compass": dive.compass, "usbl": dive.usbl, "gps": dive.gps}
    times = [found.time_s[0] for sensor, found in records.items() if sensor != "gps" and len(found.time_s)]
    first_s = min(times, default=0.0)
    made = {
        s: pd.DataFrame(
            dict(zip(COLUMNS[s], (found.time_s - first_s, found.received_s - first_s, *columns[s]), strict=True))
        )
        for s, found in records.items()
        if len(found.time_s)
    }
    return START_NS + round(first_s * 1e9), made


def _at_sea_level(position_m: Array) -> tuple[Vector, Vector]:
    """Return latitude and longitude of east, north (n, 2) for a receiver at height 0.

    The tangent plane is 8 cm above the sea 1 km from the origin; the height below it is found by iterating, so that
    readers that take the altitude and readers that do not agree.
    """
    to_geodetic: Callable[..., tuple[Vector, Vector, Vector]] = pymap3d.enu2geodetic  # pyright: ignore
    east, north = position_m.T
    up = np.zeros(len(east))
    lat, lon, height = up, up, up
    for _ in range(3):  # each iteration leaves 1e-7 of the error
        up = up - height
        lat, lon, height = to_geodetic(east, north, up, ORIGIN.lat_deg, ORIGIN.lon_deg, 0.0)
    return lat, lon


def _digest(tables: Mapping[str, pd.DataFrame]) -> str:
    digest = hashlib.sha256()
    for sensor, table in tables.items():
        digest.update(sensor.encode())
        for column in table:
            digest.update(table[column].to_numpy().tobytes())
    return digest.hexdigest()


def write_scenario(
    scenario: Scenario, seed: int, out: Path, force: bool = False, stated: str | None = None
) -> tuple[Log, Path]:
    """Write to ``out``, in the stated format or that of its name; return the log and the configuration's path.

    Raises UsageError as write_log_atomically does.
    """
    form = log_format_of(out, stated)
    log = simulated_log(scenario, seed)
    remarks = {"scenario": scenario.name, "seed": str(seed)}
    configuration = configuration_text(scenario, seed, conventions_of(log, form, exported=False))

    def make(target: Path) -> None:
        write_records(log, target, form, remarks, exported=False)

    return log, write_log_atomically(out, form, configuration, make, force)
