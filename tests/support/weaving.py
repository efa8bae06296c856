"""A vehicle that weaves through all headings, and sensors with faults put in by hand; angles are clockwise degrees."""

from dataclasses import replace
from functools import cache
from typing import NamedTuple

import numpy as np

from timelines import HZ, five_hz
from usbldr.filters.identification.evidence import identify
from usbldr.filters.models.noise import Contamination
from usbldr.filters.models.parameters import Parameters, ProcessNoise
from usbldr.filters.replay.run import run
from usbldr.filters.types import Timeline, Trajectory, Vector

SD_MPS, SD_RAD, SD_M = 0.01, np.radians(0.2), 0.2
ASSUMED = Parameters(process=ProcessNoise(0.005, 0.001, 0.02, 0.02), usbl=Contamination())  # without a stated start


class Faults(NamedTuple):
    """What is wrong with the sensors, as a navigator says it: angles clockwise."""

    dvl_scale: float = 0.0
    dvl_mount_deg: float = 0.0
    heading_bias_deg: float = 0.0
    deviation_sin_deg: float = 0.0
    deviation_cos_deg: float = 0.0
    usbl_latency_s: float = 0.0
    current_east_mps: float = 0.0  # which a DVL does not see through the water
    current_north_mps: float = 0.0


def weaving_dive(
    faults: Faults, seed: int = 0, wander_m: float = 0.0, seconds: int = 400, weaves: bool = True
) -> Timeline:
    """Weave at 1.2 m/s with some sway, or go straight on towards 60 degrees at a constant speed."""
    rng = np.random.default_rng(seed)
    fine_s = np.arange(-5 * 100, (seconds + 5) * 100 + 1) / 100
    heading_deg = 3.6 * fine_s + 30 * np.sin(fine_s / 20)
    forward, starboard = 1.2 + 0.1 * np.sin(fine_s / 7), 0.1 * np.cos(fine_s / 11)
    if not weaves:
        heading_deg, forward, starboard = np.full(len(fine_s), 60.0), np.full(len(fine_s), 1.2), np.zeros(len(fine_s))
    h = np.radians(heading_deg)
    north_mps, east_mps = forward * np.cos(h) - starboard * np.sin(h), forward * np.sin(h) + starboard * np.cos(h)
    east, north = (np.concatenate([[0.0], np.cumsum((v[1:] + v[:-1]) / 200)]) for v in (east_mps, north_mps))
    zero = int(np.argmin(np.abs(fine_s)))
    east, north = east - east[zero], north - north[zero]

    t = np.arange(seconds * HZ + 1) / HZ
    H, f, s = (np.interp(t, fine_s, value) for value in (heading_deg, forward, starboard))
    sin, cos = np.sin(np.radians(H)), np.cos(np.radians(H))
    f = f - faults.current_east_mps * sin - faults.current_north_mps * cos
    s = s - faults.current_east_mps * cos + faults.current_north_mps * sin
    mount = np.radians(faults.dvl_mount_deg)  # the DVL's bow points to starboard of the vehicle's
    seen_forward = (1 + faults.dvl_scale) * (f * np.cos(mount) + s * np.sin(mount))
    seen_starboard = (1 + faults.dvl_scale) * (s * np.cos(mount) - f * np.sin(mount))
    seen_heading_deg = (
        H
        + faults.heading_bias_deg
        + faults.deviation_sin_deg * np.sin(np.radians(H))
        + faults.deviation_cos_deg * np.cos(np.radians(H))
    )
    dvl = np.column_stack([seen_starboard, seen_forward]) + SD_MPS * rng.standard_normal((len(t), 2))
    yaw = -np.radians(seen_heading_deg) + SD_RAD * rng.standard_normal(len(t))

    stamp_s = np.arange(1.0, seconds)
    fixes = np.column_stack([np.interp(stamp_s - faults.usbl_latency_s, fine_s, x) for x in (east, north)])
    fixes += wander_m * np.column_stack([np.sin(stamp_s / 40), np.cos(stamp_s / 40)])
    fixes += SD_M * rng.standard_normal(fixes.shape)
    return five_hz(dvl, yaw, stamp_s, fixes, dvl_sd_mps=SD_MPS, yaw_sd_rad=float(SD_RAD), fix_sd_m=SD_M)


DIVE = weaving_dive(Faults())


def headings_off(by_rad: Vector, dive: Timeline = DIVE) -> Timeline:
    return replace(dive, yaw_rad=dive.yaw_rad + by_rad, dr_yaw_rad=dive.dr_yaw_rad + by_rad)


def track_of(line: Timeline) -> Trajectory:
    """Return the default track."""
    return run("adf", line, identify(line, ASSUMED).parameters)


@cache
def clean_track() -> Trajectory:
    return track_of(DIVE)


def mean_error_m(line: Timeline, found: Parameters) -> float:
    """Return how far the track of a dive with faults lies, by what was identified, from that of the dive without."""
    return float(apart_m(run("adf", line, found), clean_track()).mean())


def apart_m(track: Trajectory, clean: Trajectory) -> Vector:
    """Return the distance at each epoch, (K,)."""
    return np.hypot(*(track.position_m - clean.position_m).T)


def mean_nees(track: Trajectory, clean: Trajectory) -> float:
    e = track.position_m - clean.position_m
    assert track.position_cov_m2 is not None
    return float(np.einsum("ka,kab,kb->k", e, np.linalg.inv(track.position_cov_m2), e).mean())
