"""From the tables of a log to the epochs of the filters: the one place where time is divided into epochs.

Epochs are at k / fast rate seconds. An epoch carries a DVL or compass measurement only from the records of its own
interval, so that each record is used once: a slow DVL leaves epochs without a measurement.
Only dead reckoning uses interpolated values, in a long gap of the DVL the usual velocity (usual_motion.py), and noisy
headings as a filter follows them.
A USBL fix keeps its own time.
"""

import math
from bisect import bisect_right
from collections.abc import Sequence

import numpy as np
import pandas as pd

from usbldr.filters.errors import LogError, UsageError
from usbldr.filters.models.noise import robust_sd
from usbldr.filters.models.usual_motion import LONGEST_GAP_S, VelocityHistory
from usbldr.filters.types import Array, Indices, Outage, Timeline, Vector
from usbldr.io.conventions.clock_steps import LONGEST_LOG_NS
from usbldr.io.conventions.compass import COMPASS_SD_DEG
from usbldr.io.conventions.map_north import headings_on_plane
from usbldr.io.conventions.time_series import unwrap
from usbldr.io.conventions.usbl import AWAY_COLUMNS, LEVELLED_COLUMN, SHIP_COLUMN
from usbldr.io.log import COLUMNS, Log, missing_sensor_text
from usbldr.io.messages.layouts import BLOCK_RECORDS, blocks
from usbldr.io.reader import utc

USBL_GAP_S, USBL_GAP_INTERVALS = 10.0, 5.0  # a USBL outage is longer than both: fixes may come every 10 s by design
NOISY_RAD = math.radians(3.0)  # [rad] of an epoch: its cosines shorten dead reckoning by 0.14 %
SETTLED = 8.0  # [-] of a: what an older heading weighs is below 1e-3
MIN_DVL_SD_MPS = 1e-3  # the resolution of a DVL: rounded records repeat themselves and would give 0
MIN_RATE_HZ, MAX_RATE_HZ = 1e-3, 1e9  # so that epochs can be counted
MAX_EPOCHS = 20_000_000  # 46 days at 5 Hz
LONGEST_GAP_SHARE = 100.0  # [-] of a gap without any record to the rest of the log; days of it may cost hours
MIN_GAP_S = 86400.0  # [s] of such a gap: shorter ones cost little


def timeline(log: Log, fast_hz: float = 5.0, slow_hz: float = 1.0) -> Timeline:
    """Divide a log into epochs, from time 0 to the last DVL, compass or USBL record; without any, to the last truth.

    A DVL or compass that the log lacks has no measurement at any epoch, and dead reckoning is NaN. If a latency was
    subtracted, the first records may be before 0: they have no epoch, and the first fixes are used at time 0 with
    their offset.
    Raises LogError if no record of a DVL or compass is usable, or if the log has no sensor and no truth, UsageError if
    the rates do not fit together.
    """
    every = _epochs_per_slow(fast_hz, slow_hz)
    log = headings_on_plane(log)
    t_d, dvl, sd_d = _dvl(log)
    t_c, yaw, sd_c = _compass(log)
    fixes = _fixes(log)
    t_f = fixes["time_s"].to_numpy(dtype=float)

    ends_s = [*t_d[-1:], *t_c[-1:], *t_f[-1:]]
    if not ends_s and log.truth is not None:
        ends_s = [max(float(log.truth.time_s[-1]), 0.0)]
    if not ends_s:
        raise LogError(missing_sensor_text(log, "dvl"), path=log.path)
    last_s = max(ends_s)
    if last_s > LONGEST_LOG_NS / 1e9:
        raise LogError(f"stamps span {last_s / 86400:.0f} days; one of them must be wrong", path=log.path)
    _check_gap(log, np.sort(np.concatenate([t_d, t_c, t_f])))
    ends = [*_epoch_of(t_d[-1:], fast_hz), *_epoch_of(t_c[-1:], fast_hz)]
    ends += [math.ceil(t * fast_hz) for t in t_f[-1:]]  # a fix is used at the first epoch at or after it
    ends += [] if ends else [math.floor(last_s * fast_hz)]
    count = 1 + int(max(ends))
    if count > MAX_EPOCHS:
        raise UsageError(f"{fast_hz:g} Hz over {last_s:.0f} s are {count:.2g} epochs; use a lower --fast-hz")
    time_s = np.arange(count) / fast_hz

    dvl_count, dvl_mean = _epoch_averages(t_d, (*dvl.T, sd_d), fast_hz, count)
    yaw_count, yaw_mean = _epoch_averages(t_c, (yaw, sd_c), fast_hz, count)
    gps = _gps(log)
    usbl_gap_s = USBL_GAP_S
    if len(t_f) > 1:
        usbl_gap_s = max(USBL_GAP_S, USBL_GAP_INTERVALS * float(np.median(np.diff(t_f))))
    return Timeline(
        start_ns=log.start_ns,
        time_s=time_s,
        slow=np.arange(0, count, every),
        dvl_mps=dvl_mean[:, :2],
        dvl_count=dvl_count,
        dvl_sd_mps=_filled(np.sqrt(dvl_mean[:, 2])),
        yaw_rad=yaw_mean[:, 0],
        yaw_count=yaw_count,
        yaw_sd_rad=_filled(np.sqrt(yaw_mean[:, 1])),
        dr_mps=_reckoned_mps(time_s, t_d, dvl, log.parameters.process.velocity_mps),
        dr_yaw_rad=_followed_yaw(time_s, t_c, yaw, yaw_count, yaw_mean, log.parameters.process.turn_rate_radps),
        fix_time_s=t_f,
        fix_received_s=fixes["received_s"].to_numpy(dtype=float),
        fix_m=fixes[["east_m", "north_m"]].to_numpy(dtype=float),
        fix_cov_m2=fixes[["cov_ee_m2", "cov_en_m2", "cov_en_m2", "cov_nn_m2"]].to_numpy(dtype=float).reshape(-1, 2, 2),
        fix_away_m=fixes[list(AWAY_COLUMNS)].to_numpy(dtype=float) if {*AWAY_COLUMNS} <= {*fixes} else None,
        fix_levelled_by_m=fixes[LEVELLED_COLUMN].to_numpy(dtype=float) if LEVELLED_COLUMN in fixes else None,
        fix_ship_yaw_rad=-np.radians(fixes[SHIP_COLUMN].to_numpy(dtype=float)) if SHIP_COLUMN in fixes else None,
        gps_time_s=gps[:, 0],
        gps_m=gps[:, 1:3],
        outages=(
            *_outages("dvl", t_d, time_s[-1], LONGEST_GAP_S),
            *_outages("compass", t_c, time_s[-1], LONGEST_GAP_S),
            *_outages("usbl", t_f, time_s[-1], usbl_gap_s),
        ),
        gps_sd_m=gps[:, 3],
    )


def _check_gap(log: Log, time_s: Vector) -> None:
    """Raise LogError if the records of a log, at times (n,) in order, leave most of its span empty."""
    gaps_s = np.diff(time_s)
    gap_s = float(gaps_s.max(initial=0.0))
    rest_s = float(gaps_s.sum()) - gap_s
    if gap_s > max(MIN_GAP_S, LONGEST_GAP_SHARE * rest_s):
        before_ns = log.start_ns + round(time_s[int(gaps_s.argmax())] * 1e9)
        roles = [role for role in ("dvl", "compass", "usbl") if role in log.provenance]
        topic = ", ".join(log.provenance[role].topic for role in roles) or "the log"
        text = f"{topic}: no sensor has a record for {gap_s / 86400:.1f} days after {utc(before_ns)}, but for"
        text += f" {rest_s / 60:.0f} minutes around; the dates must be wrong (time_format)"
        raise LogError(f"{text}, else take one side of it with --start or --end", path=log.path)


def _epochs_per_slow(fast_hz: float, slow_hz: float) -> int:
    if not (MIN_RATE_HZ <= slow_hz <= MAX_RATE_HZ and MIN_RATE_HZ <= fast_hz <= MAX_RATE_HZ):
        least, most = f"{MIN_RATE_HZ:g}", f"{MAX_RATE_HZ:g} Hz"
        raise UsageError(f"rates must be between {least} and {most} (fast {fast_hz:g}, slow {slow_hz:g})")
    every = round(fast_hz / slow_hz)
    if every < 1 or not math.isclose(every * slow_hz, fast_hz, rel_tol=1e-9):
        raise UsageError(f"the fast rate must be a multiple of the slow one (fast {fast_hz:g} Hz, slow {slow_hz:g} Hz)")
    return every


def _dvl(log: Log) -> tuple[Vector, Array, Vector]:
    """Times (n,), starboard and forward (n, 2) and 1-sigma (n,) of the valid records, one per stamp."""
    if "dvl" not in log.tables:
        return np.empty(0), np.empty((0, 2)), np.empty(0)
    table = _sorted(log, "dvl")
    velocity = table[["starboard_mps", "forward_mps"]].to_numpy(dtype=float)
    good = table["valid"].to_numpy(dtype=bool) & np.isfinite(velocity).all(axis=1)
    if not good.any():
        raise LogError(f"none of the {len(table)} dvl records is valid", path=log.path)
    known = table["sd_mps"].to_numpy(dtype=float)[good]
    t, values = _one_per_stamp(table["time_s"].to_numpy(dtype=float)[good], np.column_stack([velocity[good], known]))
    velocity, sd = values[:, :2], values[:, 2]
    unknown = ~(sd > 0)
    if unknown.any():
        measured = robust_sd(np.diff(velocity, axis=0).ravel())
        sd = np.where(unknown, measured if measured > MIN_DVL_SD_MPS else MIN_DVL_SD_MPS, sd)
    return t, velocity, sd


def _compass(log: Log) -> tuple[Vector, Vector, Vector]:
    """Times, unwrapped yaw and 1-sigma in radians, (n,) each, one per stamp."""
    if "compass" not in log.tables:
        return np.empty(0), np.empty(0), np.empty(0)
    table = _sorted(log, "compass")
    t, heading, sd = (table[name].to_numpy(dtype=float) for name in ("time_s", "heading_deg", "sd_deg"))
    good = np.isfinite(heading)
    if not good.any():
        raise LogError(f"none of the {len(table)} compass records has a heading", path=log.path)
    if not good.all():
        t, heading, sd = t[good], heading[good], sd[good]
    if sd.strides == (0,):  # one value for all
        sd = np.broadcast_to(np.radians(np.where(sd[:1] > 0, sd[:1], COMPASS_SD_DEG)), len(sd))
    else:
        sd = np.radians(np.where(sd > 0, sd, COMPASS_SD_DEG))
    yaw = _unwrapped_yaw(heading)
    if np.all(t[1:] > t[:-1]):
        return t, yaw, sd
    t, values = _one_per_stamp(t, np.column_stack([yaw, sd]))
    return t, values[:, 0], values[:, 1]


def _unwrapped_yaw(heading_deg: Vector) -> Vector:
    """Return yaw in radians without jumps of whole turns, (n,), which begins within half a turn of north."""
    yaw = np.radians(heading_deg)
    np.negative(yaw, out=yaw)
    whole = 2 * np.pi * round(float(yaw[0]) / (2 * np.pi))
    unwrap(yaw, 2 * np.pi)
    yaw -= whole
    return yaw


def _fixes(log: Log) -> pd.DataFrame:
    """Usable fixes by time of validity; a fix that was logged twice is used once, from its first arrival."""
    if "usbl" not in log.tables:
        return pd.DataFrame(columns=list(COLUMNS["usbl"]))
    table = log.tables["usbl"]
    table = table[np.isfinite(table[["time_s", "east_m", "north_m"]].to_numpy(dtype=float)).all(axis=1)]
    arrival = np.fmax(table["time_s"], table["received_s"])  # not before it was valid; unknown: without delay
    table = table.assign(received_s=arrival).sort_values(["time_s", "received_s"], kind="stable")
    return table.drop_duplicates(["time_s", "east_m", "north_m"])


def _gps(log: Log) -> Array:
    """Time, east, north and 1-sigma (NaN: unknown), (n, 4), of the usable GPS fixes."""
    if "gps" not in log.tables:
        return np.empty((0, 4))
    values = log.tables["gps"][["time_s", "east_m", "north_m", "sd_m"]].to_numpy(dtype=float)
    values = values[np.isfinite(values[:, :3]).all(axis=1)]
    return values[np.argsort(values[:, 0], kind="stable")]


def _sorted(log: Log, sensor: str) -> pd.DataFrame:
    if sensor not in log.tables or log.tables[sensor].empty:
        raise LogError(missing_sensor_text(log, sensor), path=log.path)
    table = log.tables[sensor]
    time_s = table["time_s"].to_numpy(dtype=float)
    if np.all(time_s[1:] >= time_s[:-1]) and np.isfinite(time_s[[0, -1]]).all():  # with a NaN it is not so
        return table
    rows = np.flatnonzero(np.isfinite(time_s))
    return table.iloc[rows[np.argsort(time_s[rows], kind="stable")]]


def _one_per_stamp(time_s: Vector, values: Array) -> tuple[Vector, Array]:
    """Average the records that share a stamp: they are one measurement."""
    stamps, group = np.unique(time_s, return_inverse=True)
    if len(stamps) == len(time_s):
        return time_s, values
    return stamps, _averages(group, values, len(stamps))[1]


def _epoch_of(time_s: Vector, fast_hz: float) -> Indices:
    """Return k with t_k - dt/2 <= t < t_k + dt/2."""
    return np.floor(time_s * fast_hz + 0.5).astype(np.intp)


def _epoch_averages(t: Vector, columns: Sequence[Vector], fast_hz: float, count: int) -> tuple[Indices, Array]:
    """Return how many records are in each of ``count`` epochs, and the means of their columns, (count, k).

    ``t`` (n,) is ascending; of the last column, a 1-sigma, the mean of its squares. In blocks that end with an epoch.
    """
    found, means = np.zeros(count, dtype=np.intp), np.full((count, len(columns)), np.nan)
    first = 0
    while first < len(t):
        last = _epoch_of(t[min(first + BLOCK_RECORDS, len(t)) - 1], fast_hz)
        end = bisect_right(range(len(t)), last, lo=first, key=lambda row: _epoch_of(t[row], fast_hz))
        rows, first = slice(first, end), end
        epoch = _epoch_of(t[rows], fast_hz)
        inside = (epoch >= 0) & (epoch < count)
        values = np.column_stack([*(column[rows] for column in columns[:-1]), columns[-1][rows] ** 2])[inside]
        if not inside.any():
            continue
        begin = int(epoch[inside][0])
        here = slice(begin, min(int(last) + 1, count))
        found[here], means[here] = _averages(epoch[inside] - begin, values, here.stop - begin)
    return found, means


def _averages(group: Indices, values: Array, count: int) -> tuple[Indices, Array]:
    """Return how many records fell into each of ``count`` groups and their means, (count, k), NaN if none did."""
    n = np.bincount(group, minlength=count)
    sums = np.column_stack([np.bincount(group, weights=column, minlength=count) for column in values.T])
    return n, np.divide(sums, n[:, None], out=np.full(sums.shape, np.nan), where=n[:, None] > 0)


def _filled(sd: Vector) -> Vector:
    """Give epochs without a record the median sigma, so that no value is NaN."""
    return sd if np.isnan(sd).all() else np.where(np.isnan(sd), np.nanmedian(sd), sd)


def _reckoned_mps(time_s: Vector, t: Vector, mps: Array, walk_mps: float) -> Array:
    """Return velocities (n, 2) at the epochs: interpolated, and relaxing to the usual one in long gaps."""
    if not len(t):
        return np.full((len(time_s), 2), np.nan)
    reckoned, history = _interpolated(time_s, t, mps), VelocityHistory.of(t, mps)
    gaps = np.flatnonzero(np.diff(t, append=np.inf) > LONGEST_GAP_S)
    for row in gaps.tolist():
        begins_s = float(t[row]) + LONGEST_GAP_S
        ends_s = float(t[row + 1]) if row + 1 < len(t) else np.inf
        inside = slice(*np.searchsorted(time_s, (begins_s, ends_s), side="right").tolist())
        if (usual := history.in_gap(np.nextafter(begins_s, np.inf), walk_mps, stopped=0.0)) is not None:
            left = usual.remaining(time_s[inside, None] - begins_s)
            reckoned[inside] = usual.mean + (mps[row] - usual.mean) * left
    return reckoned


def _followed_yaw(time_s: Vector, t: Vector, yaw: Vector, count: Indices, mean: Array, walk_radps: float) -> Vector:
    """Return yaw at the epochs: interpolated, and where it is noisy as a filter of the motion model follows it.

    Cosines of noisy headings would shorten dead reckoning. ``mean`` (K, 2) is yaw and the mean square of its sigma.
    """
    held, rows = _interpolated(time_s, t, yaw[:, None])[:, 0], np.flatnonzero(count)
    if len(rows) < 2 or not walk_radps:
        return held
    variance = np.interp(time_s, time_s[rows], mean[rows, 1] / count[rows])
    noisy = variance > NOISY_RAD**2
    if not noisy.any():
        return held
    dt_s, interval_s = float(time_s[1] - time_s[0]), float(time_s[-1]) / len(rows)
    # a steady Kalman filter of a turn rate that is a random walk q, with noise of the density R, is the weight
    # √2 ω exp(-a) cos a of a heading t ago, a = ω t / √2, ω⁴ = q² / R: it follows a steady turn without delay
    omega = (walk_radps**2 / (float(np.median(variance[noisy])) * interval_s)) ** 0.25 / math.sqrt(2)
    a = omega * np.arange(0.0, min(SETTLED / omega, time_s[-1]), dt_s)
    weight = np.exp(-a) * np.cos(a)
    measured = np.where(count > 0, mean[:, 0], held)
    before = 2 * measured[0] - measured[len(a) - 1 : 0 : -1]
    followed = np.convolve(np.concatenate([before, measured]), weight / weight.sum(), "valid")
    return np.where(noisy, followed, held)


def _interpolated(time_s: Vector, t: Vector, values: Array) -> Array:
    """Return values (n, k) at the epochs: linear across gaps up to LONGEST_GAP_S, else the last one (or the first)."""
    if not len(t):
        return np.full((len(time_s), values.shape[1]), np.nan)
    before = np.clip(np.searchsorted(t, time_s, side="right") - 1, 0, len(t) - 1)
    after = np.minimum(before + 1, len(t) - 1)
    gap = t[after] - t[before]
    share = np.divide(time_s - t[before], gap, out=np.zeros(len(time_s)), where=(gap > 0) & (gap <= LONGEST_GAP_S))
    return values[before] + np.clip(share, 0, 1)[:, None] * (values[after] - values[before])


def _outages(sensor: str, t: Vector, last_s: float, longest_s: float) -> list[Outage]:
    spans = [(0.0, last_s)]
    if len(t):
        parts = [t[rows.start : rows.stop + 1] for rows in blocks(len(t))]
        inside = [(part[k], part[k + 1]) for part in parts for k in np.flatnonzero(np.diff(part) > longest_s)]
        spans = [(0.0, t[0]), *inside, (t[-1], last_s)]
    return [Outage(sensor, float(start), float(end)) for start, end in spans if end - start > longest_s]
