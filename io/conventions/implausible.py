"""Records of a log that cannot be measurements: named with counts and times, and left out before a filter runs.

Only what is certain is left out: values and fixes that a noisy sensor repeats to the last bit while the vehicle moves,
zeros between records at speed, and spikes that no vehicle could follow. Jumps of the heading are taken out. The noise
families of the filters are made for what is only unlikely.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple, Self

import numpy as np
import pandas as pd

from usbldr.filters.types import Array, Mask, Truth, Vector
from usbldr.io.conventions.displaced import Fixes, false_velocities
from usbldr.io.conventions.repeats import (
    copied_fixes,
    extrapolated_fixes,
    interpolated_fixes,
    noisy,
    runs,
    some_runs,
    stuck,
    sudden_zeros,
)
from usbldr.io.conventions.spikes import heading_jumps, heading_spikes, velocity_spikes, without_jumps
from usbldr.io.findings import Finding
from usbldr.io.log import Log

REST_MPS = 0.05  # [m/s] of the mean velocity: the sensors of a slower vehicle may show the same values again
USUAL_STEPS = 0.999  # [-] of the steps from record to record, by judgement: those beyond may be errors themselves
SPIKE_PASSES = 20  # of eight hours at 10 Hz with 40 % false headings 12 find some, with 20 % two
LEFT_OUT = "they are left out"
TOO_FAST = "no vehicle moves there and back so fast"
BY_FIXES = "the fixes show that the vehicle did not move there and back so"


class TimedRecords(NamedTuple):
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

    def without(self, some: Mask) -> "TimedRecords":
        """Leave out some of the records."""
        if not some.any():
            return self
        good = self.good.copy()
        good[good] = ~some
        return TimedRecords(self.topic, good, self.time_s[~some], self.values[~some])


Tables = Mapping[str, pd.DataFrame]
SpikesOf = Callable[..., Vector]  # of times and values: how far each is off, with what is reached in a second
Judged = tuple[TimedRecords, list[Finding]]  # the records of a table that may be measurements, and what is to be said


def without_implausible(log: Log) -> Log:
    """Return the log without the records that cannot be measurements, with a finding for each kind of them.

    A log without such records is returned as it is.
    """
    tables, provenance, found = dict(log.tables), dict(log.provenance), list[Finding]()
    for role, (columns, judge) in CHECKS.items():
        if role not in tables:
            continue
        records = TimedRecords.of(provenance[role].topic, tables[role], columns)
        kept, findings = judge(records, tables)
        found += findings
        before = records.values if kept.good is records.good else records.values[kept.good[records.good]]
        if kept.values is not before and not np.array_equal(kept.values, before):
            turned = {name: tables[role][name].to_numpy(copy=True) for name in columns}
            for column, values in zip(turned.values(), kept.values.T, strict=True):
                column[kept.good] = values
            tables[role] = tables[role].assign(**turned)
        if len(kept.values) < len(records.values):
            rows = kept.good | ~records.good
            tables[role] = tables[role][rows].reset_index(drop=True)
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


def _dvl(records: TimedRecords, tables: Tables) -> Judged:
    zero = sudden_zeros(records.time_s, records.values)
    text = f"are exactly 0 between records at speed: the DVL has no lock then, although it calls them valid; {LEFT_OUT}"
    found = _stretch_finding("DVL-ZERO", records, zero, text)
    records, stuck_found = _without_stuck(records.without(zero), tables, "velocities")
    records, held = _without_held(records, tables)
    records, spikes = _without_false_spikes("dvl", records, velocity_spikes, "m/s", tables)
    displaced = false_velocities(records.time_s, records.values, _fixes(tables, "dvl", records))
    text = f"lie between two steps of the velocity, there and back, that the vehicle did not make; {LEFT_OUT}"
    steps = _stretch_finding("DVL-JUMP", records, displaced, text)
    return records.without(displaced), [*found, *stuck_found, *held, *spikes, *steps]


def _without_held(records: TimedRecords, tables: Tables) -> Judged:
    copied = copied_fixes(records.values)
    if not copied.any() or not noisy(records.values[~copied]):
        return records, []
    copied = _while_moving(copied, records.time_s, tables)
    text = f"repeat the previous velocity to the last digit; {LEFT_OUT}"
    return records.without(copied), _stretch_finding("DVL-HELD", records, copied, text)


def _fixes(tables: Tables, role: str, records: TimedRecords) -> Fixes | None:
    """Return the fixes beside velocities, with these records of a sensor; None if a sensor has less than two."""
    if not {"dvl", "compass", "usbl"} <= tables.keys():
        return None
    of = {name: TimedRecords.of("", tables[name], CHECKS[name][0]) for name in ("dvl", "compass", "usbl")} | {
        role: records
    }
    if min(len(one.time_s) for one in of.values()) < 2:
        return None
    dvl, usbl, headings_rad = of["dvl"], of["usbl"], np.unwrap(np.radians(of["compass"].values[:, 0]))
    yaw_rad = np.interp(dvl.time_s, of["compass"].time_s, headings_rad)
    stated_m2 = float(np.median(tables["usbl"][["cov_ee_m2", "cov_nn_m2"]].to_numpy(dtype=float)))
    return Fixes.beside(usbl.time_s, usbl.values, stated_m2, (dvl.time_s, dvl.values, yaw_rad))


def _compass(records: TimedRecords, tables: Tables) -> Judged:
    records, found = _without_stuck(records, tables, "headings")
    records, spikes = _without_false_spikes("compass", records, heading_spikes, "deg", tables)
    records, jumps = _without_jumps(records)
    return records, [*found, *spikes, *jumps]


def _without_copies(records: TimedRecords, tables: Tables, code: str, left_out: str) -> Judged:
    copied = copied_fixes(records.values)
    if not noisy(records.values[~copied]):  # at rest, fixes without noise are equal
        copied = _while_moving(copied, records.time_s, tables)
    text = f"repeat the previous fix to the last digit; {left_out}"
    return records.without(copied), _stretch_finding(code, records, copied, text)


def _usbl(records: TimedRecords, tables: Tables) -> Judged:
    records, copies = _without_copies(records, tables, "USBL-REPEATED", LEFT_OUT)
    between = interpolated_fixes(records.time_s, records.values)
    text = (
        f"lie on the line between the fixes before and after: the table was resampled; {LEFT_OUT}; export the fixes as "
        "they were measured"
    )
    found = [*copies, *_stretch_finding("USBL-INTERPOLATED", records, between, text)]
    records = records.without(between)
    beyond = extrapolated_fixes(records.time_s, records.values)
    text = (
        "go on along a straight line at constant speed from the fixes before: software extrapolated, as if no reply "
        f"came; {LEFT_OUT}"
    )
    return records.without(beyond), [*found, *_stretch_finding("USBL-EXTRAPOLATED", records, beyond, text)]


CHECKS: Mapping[str, tuple[Sequence[str], Callable[[TimedRecords, Tables], Judged]]] = {
    "dvl": (("starboard_mps", "forward_mps"), _dvl),  # first: it shows when the vehicle is at rest
    "compass": (("heading_deg",), _compass),
    "usbl": (("east_m", "north_m"), _usbl),
    "gps": (  # in degrees, in which they were rounded
        ("lat_deg", "lon_deg"),
        partial(_without_copies, code="GPS-HELD", left_out=f"{LEFT_OUT}, also of a truth that is the GPS"),
    ),
    # named alone: they have served already, for slant ranges
    "depth": (("depth_m",), lambda records, tables: (records, _without_stuck(records, tables, "depths")[1])),
}


def _without_stuck(records: TimedRecords, tables: Tables, what: str) -> Judged:
    equal = stuck(records.time_s, records.values)
    frozen = _while_moving(equal, records.time_s, tables)
    if what == "headings":
        frozen |= _before_a_step(equal, records.values[:, 0])
    kept = "" if what == "depths" else f"; {LEFT_OUT}"
    text = f"are equal to the last digit, for longer than rounding explains: the sensor was stuck{kept}"
    return records.without(frozen), _stretch_finding("STUCK", records, frozen, text)


def _before_a_step(repeats: Mask, heading_deg: Vector) -> Mask:
    """Return the records (n,) of runs after which headings step by more than they usually do: the vehicle turned."""
    if not repeats.any() or repeats.all():
        return np.zeros_like(repeats)
    steps = np.abs(np.diff(np.unwrap(heading_deg, period=360.0)))
    usual = np.quantile(steps[~repeats[1:] & ~repeats[:-1]], USUAL_STEPS)
    _, end = runs(repeats)
    return some_runs(repeats, np.append(steps, 0.0)[end - 1] > usual)


def _while_moving(repeats: Mask, time_s: Vector, tables: Tables) -> Mask:
    """Return the records (n,) of runs in which the DVL does not show a vehicle at rest."""
    if "dvl" not in tables or not repeats.any():
        return repeats
    dvl = TimedRecords.of("", tables["dvl"], CHECKS["dvl"][0])
    first, end = runs(repeats)
    begin, stop = (np.searchsorted(dvl.time_s, time_s[at]) for at in (np.maximum(first - 1, 0), end - 1))
    count = np.maximum(stop - begin, 1)
    sums = np.concatenate([np.zeros((1, 2)), np.cumsum(dvl.values, axis=0)])
    speed = np.linalg.norm((sums[stop] - sums[begin]) / count[:, None], axis=1)
    return some_runs(repeats, (stop == begin) | ~(speed < REST_MPS))


def _stretch_finding(code: str, records: TimedRecords, which: Mask, text: str) -> list[Finding]:
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


def _without_false_spikes(role: str, records: TimedRecords, spikes_of: SpikesOf, unit: str, tables: Tables) -> Judged:
    """Leave out spikes that no vehicle can follow, and those that one can if the fixes show that this one did not."""
    others, possible = _without_spikes(records, partial(spikes_of, reached=0.0), unit, BY_FIXES)
    if not possible:
        return records, []
    records, certain = _without_spikes(records, spikes_of, unit, TOO_FAST)
    before, after = (_fixes(tables, role, each) for each in (records, others))
    if before is None or after is None or len(others.values) == len(records.values) or not before.contradict(after):
        return records, certain
    return others, possible


def _without_spikes(records: TimedRecords, spikes_of: SpikesOf, unit: str, why: str) -> Judged:
    """Leave out spikes as long as there are any: where they are dense, some show once their neighbours are gone."""
    count, worst = len(records.values), (0.0, 0.0)
    for _ in range(SPIKE_PASSES):
        deviation = spikes_of(records.time_s, records.values)
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
        f"{size:.3g} {unit} at {time_s:.1f} s, and {why}; {LEFT_OUT}"
    )
    return records, [Finding("SPIKES", text, records.topic, time_s, size, unit)]


def _without_jumps(records: TimedRecords) -> Judged:
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
