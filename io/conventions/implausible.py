"""Records of a log that cannot be measurements: named with counts and times, and left out before a filter runs.

Only what is certain is left out: values and fixes that a noisy sensor repeats to the last bit while the vehicle moves,
zeros between records at speed, and spikes that no vehicle could follow. Jumps of the heading are taken out. The noise
families of the filters are made for what is only unlikely.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple, Self

import numpy as np
import pandas as pd

from usbldr.filters.frames import rotated
from usbldr.filters.models.noise import TO_SD
from usbldr.filters.types import Array, Mask, Truth, Vector
from usbldr.io.conventions.repeats import MAX_ACCELERATION_MPS2, copied_fixes, runs, some_runs, stuck, sudden_zeros
from usbldr.io.conventions.spikes import (
    MIN_SPIKE_MPS,
    displaced_velocities,
    heading_jumps,
    heading_spikes,
    velocity_spikes,
    without_jumps,
)
from usbldr.io.findings import Finding
from usbldr.io.log import Log

REST_MPS = 0.05  # [m/s] of the mean velocity: the sensors of a slower vehicle may show the same values again
SPIKE_PASSES = 20  # of eight hours at 10 Hz with 40 % false headings 12 find some, with 20 % two
MIN_LOG_ODDS = 3.0  # log 20: strong evidence, as of sensor errors
MIN_JUMP_MPS = 0.1  # [m/s] of the velocity, if the fixes must confirm it: 20 s of it displace a track by 2 m
FIXES_BESIDE = 7  # before and after a stretch: their median endures two outliers
RIGHT = 0.5  # [-] of the way between fixes, by judgement: what right velocities leave of it, noise included, at most
DR_ERROR = 0.1  # [-] of the way: dead reckoning before its errors are estimated
LEFT_OUT = "they are left out"


class Records(NamedTuple):
    """Records of a table, in order of time."""

    topic: str
    good: Mask  # (rows of the table,) which rows these are
    time_s: Vector  # (n,)
    values: Array  # (n, k)

    @classmethod
    def of(cls, topic: str, table: pd.DataFrame, columns: Sequence[str]) -> Self:
        """Take the columns of the rows that are finite, and valid, if the table has that column."""
        one = len(columns) == 1  # no copy is made then
        values = table[columns[0]].to_numpy(dtype=float)[:, None] if one else table[list(columns)].to_numpy(dtype=float)
        good: Mask = np.all(np.isfinite(values), axis=1)
        time_s = table["time_s"].to_numpy(dtype=float)
        if "valid" in table:
            good = good & table["valid"].to_numpy(dtype=np.bool_)
        return cls(topic, good, time_s, values) if good.all() else cls(topic, good, time_s[good], values[good])

    def without(self, some: Mask) -> "Records":
        """Leave out some of the records."""
        if not some.any():
            return self
        good = self.good.copy()
        good[good] = ~some
        return Records(self.topic, good, self.time_s[~some], self.values[~some])


Tables = Mapping[str, pd.DataFrame]
Judged = tuple[Records, list[Finding]]  # the records of a table that may be measurements, and what is to be said


def without_implausible(log: Log) -> Log:
    """Return the log without the records that cannot be measurements, with a finding for each kind of them.

    A log without such records is returned as it is.
    """
    tables, provenance, found = dict(log.tables), dict(log.provenance), list[Finding]()
    for role, (columns, judge) in CHECKS.items():
        if role not in tables:
            continue
        records = Records.of(provenance[role].topic, tables[role], columns)
        kept, findings = judge(records, tables)
        found += findings
        before = records.values if kept.good is records.good else records.values[kept.good[records.good]]
        if kept.values is not before and not np.array_equal(kept.values, before):
            assert kept.values.shape == before.shape
            table = {str(name): column.to_numpy() for name, column in tables[role].items()}
            for name, values in zip(columns, kept.values.T, strict=True):
                if kept.good.all():
                    table[name] = values
                else:
                    table[name] = table[name].copy()
                    table[name][kept.good] = values
            tables[role] = pd.DataFrame(table, copy=False)
        if len(kept.values) < len(records.values):
            rows = kept.good | ~records.good
            columns_kept = {str(name): column.to_numpy()[rows] for name, column in tables[role].items()}
            tables[role] = pd.DataFrame(columns_kept, copy=False)
            provenance[role] = replace(provenance[role], used=provenance[role].used - int(np.count_nonzero(~rows)))
    if not found:
        return log
    truth = _of_kept_gps(log, tables)
    return replace(log, tables=tables, provenance=provenance, truth=truth, findings=(*log.findings, *found))


def _of_kept_gps(log: Log, tables: Tables) -> Truth | None:
    """Return the truth of a log; if that is its GPS, without the fixes that are no longer in the tables."""
    truth = log.truth
    if truth is None or "gps" not in tables or truth.source != log.provenance["gps"].topic:
        return truth
    before_s, kept_s = (of["gps"]["time_s"].to_numpy(dtype=float) for of in (log.tables, tables))
    left_out_s = np.setdiff1d(before_s, kept_s) - log.settings.truth.latency_s
    return truth.only(~np.isin(truth.time_s, left_out_s)) if len(left_out_s) else truth


def _dvl(records: Records, tables: Tables) -> Judged:
    zero = sudden_zeros(records.time_s, records.values)
    text = f"are exactly 0 between records at speed: the DVL has no lock then, although it calls them valid; {LEFT_OUT}"
    found = _stretch_finding("DVL-ZERO", records, zero, text)
    records, stuck_found = _without_stuck(records.without(zero), tables, "velocities")
    records, spikes = _without_spikes(records, velocity_spikes, "m/s")
    displaced = _displaced(records, tables)
    text = f"lie between two steps of the velocity, there and back, that the vehicle did not make; {LEFT_OUT}"
    steps = _stretch_finding("DVL-JUMP", records, displaced, text)
    return records.without(displaced), [*found, *stuck_found, *spikes, *steps]


def _displaced(records: Records, tables: Tables) -> Mask:
    """Return which velocities (n,) lie between a jump and the jump back that the vehicle did not make.

    If no vehicle can, only the fixes before and after them can show that a simulated one did; if one can, the fixes
    must show that it did not, and that the other velocities are right.
    """
    impossible = displaced_velocities(records.time_s, records.values, MIN_SPIKE_MPS, MAX_ACCELERATION_MPS2)
    if "usbl" not in tables or "compass" not in tables:
        return impossible
    some = impossible | displaced_velocities(records.time_s, records.values, MIN_JUMP_MPS, 0.0)
    if not some.any():
        return some
    odds, trusted = _log_odds_against(some, records, tables)
    confirmed = MIN_LOG_ODDS + math.log(len(odds)) if trusted else math.inf  # by chance, one of all may be likely
    return some_runs(some, odds > np.where(impossible[runs(some)[0]], -MIN_LOG_ODDS, confirmed))


def _log_odds_against(displaced: Mask, records: Records, tables: Tables) -> tuple[Vector, bool]:
    """Return the log odds of the fixes against each of r runs of velocities, (r,), and whether the others are right.

    The way between fixes before and after is compared with that of dead reckoning with these velocities, and with those
    before and after them, from which the vehicle may have differed as it usually does from its mean. Those elsewhere
    are right if they explain the ways between fixes as far apart: a wrong convention of the compass does not.
    """
    fixes, headings = (Records.of("", tables[role], CHECKS[role][0]) for role in ("usbl", "compass"))
    first, end = runs(displaced)
    without = records.values.copy()
    for run in zip(first, end, strict=True):
        without[slice(*run)] = np.median(records.values[[max(run[0] - 1, 0), min(run[1], len(without) - 1)]], axis=0)
    yaw = np.interp(records.time_s, headings.time_s, np.unwrap(np.radians(headings.values[:, 0])))
    dt_s = np.gradient(records.time_s)[:, None]
    ways = [np.cumsum(rotated(-yaw, velocity) * dt_s, axis=0) for velocity in (records.values, without)]
    row = np.clip(np.searchsorted(records.time_s, fixes.time_s), 0, len(dt_s) - 1)
    away_m = np.stack([way[row] - fixes.values for way in ways], axis=1)  # (F, 2 ways, 2)
    bent_m = fixes.values[1:-1] - (fixes.values[:-2] + fixes.values[2:]) / 2  # its variance is 1.5 times that of a fix
    shown_m2 = (TO_SD * float(np.median(np.abs(bent_m)))) ** 2 / 1.5 if len(bent_m) else 0.0
    fix_variance_m2 = max(float(np.median(tables["usbl"][["cov_ee_m2", "cov_nn_m2"]].to_numpy(dtype=float))), shown_m2)
    variance_m2ps2 = float(np.var(records.values[~displaced], axis=0).mean())
    span_s = records.time_s[end - 1] - records.time_s[first]
    odds = np.zeros(len(first))
    for run, (before, after) in enumerate(np.searchsorted(fixes.time_s, records.time_s[[first, end - 1]]).T):
        count = min(FIXES_BESIDE, before, len(fixes.time_s) - after)
        if not count:
            continue
        pairs = slice(after, after + count), np.arange(before - 1, before - 1 - count, -1)
        error_m = np.median(away_m[pairs[0]] - away_m[pairs[1]], axis=0)
        way_m = np.median(np.linalg.norm(fixes.values[pairs[0]] - fixes.values[pairs[1]], axis=1))
        variance_m2 = math.pi * fix_variance_m2 / count + (DR_ERROR * way_m) ** 2  # pi / 2: of a median
        of_both_m2 = variance_m2 + np.array([0.0, variance_m2ps2 * span_s[run] ** 2])
        cost = np.sum(error_m**2, axis=1) / of_both_m2 + 2 * np.log(of_both_m2)
        odds[run] = (cost[0] - cost[1]) / 2
    later = np.searchsorted(fixes.time_s, fixes.time_s + np.median(span_s))
    count = np.cumsum(displaced)[row]
    start = np.flatnonzero((later < len(row)) & (count[np.minimum(later, len(row) - 1)] == count))
    errors_m = np.linalg.norm(away_m[later[start], 0] - away_m[start, 0], axis=1)
    ways_m = np.linalg.norm(fixes.values[later[start]] - fixes.values[start], axis=1)
    return odds, len(start) > 0 and bool(np.median(errors_m) < RIGHT * np.median(ways_m))


def _compass(records: Records, tables: Tables) -> Judged:
    records, found = _without_stuck(records, tables, "headings")
    records, spikes = _without_spikes(records, lambda time_s, values: heading_spikes(time_s, values[:, 0]), "deg")
    records, jumps = _without_jumps(records)
    return records, [*found, *spikes, *jumps]


def _without_copies(records: Records, tables: Tables, code: str, left_out: str) -> Judged:
    copied = _while_moving(copied_fixes(records.values), records.time_s, tables)
    text = f"repeat the previous fix to the last digit; {left_out}"
    return records.without(copied), _stretch_finding(code, records, copied, text)


CHECKS: Mapping[str, tuple[Sequence[str], Callable[[Records, Tables], Judged]]] = {
    "dvl": (("starboard_mps", "forward_mps"), _dvl),  # first: it shows when the vehicle is at rest
    "compass": (("heading_deg",), _compass),
    "usbl": (("east_m", "north_m"), partial(_without_copies, code="USBL-REPEATED", left_out=LEFT_OUT)),
    "gps": (  # in degrees, in which they were rounded
        ("lat_deg", "lon_deg"),
        partial(_without_copies, code="GPS-HELD", left_out=f"{LEFT_OUT}, also of a truth that is the GPS"),
    ),
    # named alone: they have served already, for slant ranges
    "depth": (("depth_m",), lambda records, tables: (records, _without_stuck(records, tables, "depths")[1])),
}


def _without_stuck(records: Records, tables: Tables, what: str) -> Judged:
    frozen = _while_moving(stuck(records.time_s, records.values), records.time_s, tables)
    kept = "" if what == "depths" else f"; {LEFT_OUT}"
    text = f"repeat the previous one to the last digit, for longer than rounding explains: the sensor was stuck{kept}"
    return records.without(frozen), _stretch_finding("STUCK", records, frozen, text)


def _while_moving(repeats: Mask, time_s: Vector, tables: Tables) -> Mask:
    """Return the repeats (n,) of runs in which the DVL does not show a vehicle at rest."""
    if "dvl" not in tables or not repeats.any():
        return repeats
    dvl = Records.of("", tables["dvl"], CHECKS["dvl"][0])
    first, end = runs(repeats)
    begin, stop = (np.searchsorted(dvl.time_s, time_s[at]) for at in (first - 1, end - 1))
    count = np.maximum(stop - begin, 1)
    sums = np.concatenate([np.zeros((1, 2)), np.cumsum(dvl.values, axis=0)])
    speed = np.linalg.norm((sums[stop] - sums[begin]) / count[:, None], axis=1)
    return some_runs(repeats, (stop == begin) | ~(speed < REST_MPS))


def _stretch_finding(code: str, records: Records, which: Mask, text: str) -> list[Finding]:
    """Report some of the records, if any: how many, in which stretches."""
    if not which.any():
        return []
    first, end = runs(which)
    lengths_s = records.time_s[end - 1] - records.time_s[np.maximum(first - 1, 0)]
    longest = int(np.argmax(lengths_s))
    start_s, length_s = float(records.time_s[first[longest]]), float(lengths_s[longest])
    where = f"{length_s:.1f} s from {start_s:.1f} s on"
    where = where if len(first) == 1 else f"in {len(first)} stretches, the longest {where}"
    whole = f"{records.topic}: {which.sum()} of {len(which)} records, {where}, {text}"
    return [Finding(code, whole, records.topic, start_s, length_s, "s")]


def _without_spikes(records: Records, deviation_of: Callable[[Vector, Array], Vector], unit: str) -> Judged:
    """Leave out spikes as long as there are any: where they are dense, some show once their neighbours are gone."""
    count, worst = len(records.values), (0.0, 0.0)
    for _ in range(SPIKE_PASSES):
        deviation = deviation_of(records.time_s, records.values)
        if not deviation.any():
            break
        row = int(np.argmax(deviation))
        worst = max(worst, (float(records.time_s[row]), float(deviation[row])), key=lambda one: one[1])
        records = records.without(deviation > 0)
    if len(records.values) == count:
        return records, []
    (time_s, size), left = worst, count - len(records.values)
    text = (
        f"{records.topic}: {left} of {count} records are far from their neighbours, the worst by "
        f"{size:.3g} {unit} at {time_s:.1f} s, and no vehicle moves there and back so fast; {LEFT_OUT}"
    )
    return records, [Finding("SPIKES", text, records.topic, time_s, size, unit)]


def _without_jumps(records: Records) -> Judged:
    """Turn the headings beside the longest stretch to fit it; the compass has one constant error then."""
    heading_deg = records.values[:, 0]
    rows, jump_deg = heading_jumps(records.time_s, heading_deg)
    if not len(rows):
        return records, []
    worst = int(np.argmax(np.abs(jump_deg)))
    time_s, size = float(records.time_s[rows[worst]]), abs(float(jump_deg[worst]))
    text = (
        f"{records.topic}: {len(rows)} jump{'s' if len(rows) > 1 else ''} of the heading that no vehicle can turn, the "
        f"largest by {size:.0f} deg at {time_s:.1f} s; the headings of the longest stretch stay, the others are "
        "turned to fit them"
    )
    turned = without_jumps(records.time_s, heading_deg, rows, jump_deg)
    return records._replace(values=turned[:, None]), [Finding("HEADING-JUMP", text, records.topic, time_s, size, "deg")]
