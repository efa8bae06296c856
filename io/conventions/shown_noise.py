"""Stretches in which DVL or compass scatter more than they state: their records get the sigma that they show.

How far a record lies from the straight line between its neighbours shows the white part of its noise. Its variance is
that of the three records, weighted, and of what the motion model allows: velocity is a random walk, heading the
integral of one. The median over a block of records ignores manoeuvres and single outliers. A sigma only grows, as a
smooth series may be a filtered one.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from usbldr.filters.frames import wrapped
from usbldr.filters.models.noise import TO_SD
from usbldr.filters.models.parameters import DEGREES, ProcessNoise
from usbldr.filters.types import Indices, Vector
from usbldr.io.conventions.implausible import TimedRecords, without_implausible
from usbldr.io.conventions.repeats import runs
from usbldr.io.findings import Finding
from usbldr.io.log import Log

BLOCKS_AT_ONCE = 1000  # [blocks] so that a long log needs little memory
BLOCK = 100  # [records] of a median: its sigma is known to 12 %
MANOEUVRES = 3.0  # [-] of the variance of the motion: medians of blocks scatter about it by a third
NOTABLE_FACTOR = 3.0  # [-] of a sigma: the tails of the noise families reach 2 in some block


class _Sensor(NamedTuple):
    """What is examined of a sensor."""

    columns: tuple[str, ...]
    sd: str
    unit: str
    walked: Callable[[Vector, Vector], Vector]  # variance of that distance by the motion, of h s before and after


def _velocity_walk(before_s: Vector, after_s: Vector) -> Vector:
    return ProcessNoise().velocity_mps ** 2 * before_s * after_s / (before_s + after_s)


def _heading_walk(before_s: Vector, after_s: Vector) -> Vector:
    rate_dps = ProcessNoise().turn_rate_radps * DEGREES
    return rate_dps**2 * (before_s * after_s) ** 2 / (3 * (before_s + after_s))


SENSORS: Mapping[str, _Sensor] = {
    "dvl": _Sensor(("starboard_mps", "forward_mps"), "sd_mps", "m/s", _velocity_walk),
    "compass": _Sensor(("heading_deg",), "sd_deg", "deg", _heading_walk),
}


def examined(log: Log) -> Log:
    """Return the log without records that cannot be measurements, and with sigmas as large as the others scatter."""
    return with_shown_noise(without_implausible(log))


def with_shown_noise(log: Log) -> Log:
    """Return the log with larger sigmas where records scatter so, and a finding for each such sensor."""
    tables, findings = dict(log.tables), list[Finding]()
    for role, sensor in SENSORS.items():
        if role not in tables:
            continue
        records = TimedRecords.of(log.provenance[role].topic, tables[role], sensor.columns)
        sd = tables[role][sensor.sd].to_numpy(dtype=float)
        known = sd if records.good.all() else sd[records.good]
        factor = _shown_factor(records, known, sensor)
        if factor.max(initial=1.0) == 1.0:
            continue
        raised = sd.copy()
        raised[records.good] = factor * known
        tables[role] = tables[role].assign(**{sensor.sd: raised})
        findings.append(_finding(records, known, factor, sensor.unit))
    return replace(log, tables=tables, findings=(*log.findings, *findings)) if findings else log


def _shown_factor(records: TimedRecords, sd: Vector, sensor: _Sensor) -> Vector:
    """Return by what factor the noise of n records exceeds their sigma (n,), (n,); 1 if not notably."""
    blocks = len(sd) // BLOCK
    if not blocks:
        return np.ones(len(sd))
    first = np.append(np.arange(blocks - 1) * BLOCK, len(sd) - BLOCK)  # the last block ends with the last record
    some = (first[k : k + BLOCKS_AT_ONCE] for k in range(0, blocks, BLOCKS_AT_ONCE))
    own = np.concatenate([_block_factors(records, sd, sensor, each) for each in some])
    own[~(own > NOTABLE_FACTOR)] = 1.0
    near = np.pad(own, 1, constant_values=1.0)
    beside = np.maximum(near[:-2], near[2:])
    own = np.where(own > beside / 2, own, beside)  # a stretch begins and ends within a block, which shows less of it
    return own[np.minimum(np.arange(len(sd)) // BLOCK, blocks - 1)]


def _block_factors(records: TimedRecords, sd: Vector, sensor: _Sensor, first: Indices) -> Vector:
    """Return the factor of B blocks, by the first record of each, (B,); NaN if none of its records states a sigma."""
    rows = first[:, None] + np.arange(BLOCK)
    interval_s, change = np.diff(records.time_s[rows]), np.diff(records.values[rows], axis=1)
    before_s, after_s, sd = interval_s[:, :-1], interval_s[:, 1:], sd[rows]
    change = wrapped(change, 180.0) if sensor.unit == "deg" else change
    with np.errstate(divide="ignore", invalid="ignore"):
        share = after_s / (before_s + after_s)
        apart = change[:, :-1] * share[..., None] - change[:, 1:] * (1 - share)[..., None]
        variance = sd[:, 1:-1] ** 2 + (share * sd[:, :-2]) ** 2 + ((1 - share) * sd[:, 2:]) ** 2
        ratio = (TO_SD**2 * apart**2 - MANOEUVRES * sensor.walked(before_s, after_s)[..., None]) / variance[..., None]
    ratio = np.where(np.isfinite(ratio), ratio, np.nan).reshape(len(first), -1)
    known, found = ~np.isnan(ratio).all(axis=1), np.full(len(first), np.nan)
    found[known] = np.sqrt(np.maximum(np.nanmedian(ratio[known], axis=1), 0.0))
    return found


def _finding(records: TimedRecords, sd: Vector, factor: Vector, unit: str) -> Finding:
    raised, shown = factor > 1, factor * sd
    first, end = runs(raised)
    worst, longest = int(np.argmax(np.where(raised, shown, 0.0))), int(np.argmax(end - first))
    stretch = f"from {records.time_s[first[longest]]:.0f} to {records.time_s[end[longest] - 1]:.0f} s"
    where = stretch if len(first) == 1 else f"in {len(first)} stretches, the longest {stretch}"
    text = (
        f"{records.topic}: {np.count_nonzero(raised)} of {len(sd)} records, {where}, scatter by up to "
        f"{shown[worst]:.2g} {unit}, not by the {sd[worst]:.2g} {unit} of their sigma: it was raised to what they show"
    )
    return Finding("NOISE-LARGER", text, records.topic, float(records.time_s[worst]), float(shown[worst]), unit)
