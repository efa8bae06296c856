"""When each record was valid and when it arrived: clocks, stamps, latencies, order and repeats. Integer nanoseconds.

Stamps may come from another clock than the log's: one that counts from power-on, or was never set. Stamps of one clock
are not changed. If clocks disagree by more than half an hour, stamps are shifted to log time: all of one clock by the
same amount, which keeps their spacing, and by the smallest delay from stamp to log, so that no record is stamped much
before it was measured.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from usbldr.filters.errors import LogError, SettingError
from usbldr.filters.types import Indices, Mask, Vector
from usbldr.io.findings import Finding
from usbldr.io.geodesy import Origin, OriginKind, to_plane
from usbldr.io.messages.layouts import RawRecords, blocks
from usbldr.io.provenance import Convention
from usbldr.io.reader import MAX_TIME_NS, Nanoseconds

COARSE_SHARE = 0.2  # [-] of records with the stamp of the next, at least: times are too coarse for the sensor's rate
COARSE_RECORDS = 10  # with the stamp of the next, at least: a few may be sent twice
SAME_CLOCK_NS = 1800 * 1_000_000_000  # time zones are whole hours apart, or half ones
DATED_NS = 946_684_800 * 1_000_000_000  # fixed: the year 2000, since 1970; earlier times count from something else
APART_RATIO = 3.0  # [-] of what stamps differ by: one sensor differs within a stamp by no more
LEAST_APART = 3.0  # [m, deg] noise and rounding of a sensor at rest are less
MIN_STAMPS = 10  # fewer show no usual difference
OF_SEVERAL = "they are of several devices under one name; record each under its own name"
LEAST = 0.01  # [1] share of records that may have smaller delays
LOG_TIME = "log time"  # times records that have no stamp
TIMES = ("time_ns", "received_ns", "stamp_ns")
"""Columns of a table in the making: time of validity, arrival, and the stamp before latency was subtracted."""


def align_clocks(raws: Mapping[str, RawRecords], by_log: frozenset[str]) -> tuple[dict[str, RawRecords], list[Finding]]:
    """Return the raws on one clock, and what was shifted; roles in ``by_log`` are timed without stamps."""
    raws = {role: raw if role in by_log else _received_as_stamped(raw) for role, raw in raws.items()}
    delay_ns = {role: 0 if role in by_log else least_delay_ns(raw) for role, raw in raws.items()}
    if not delay_ns or max(delay_ns.values()) - min(delay_ns.values()) <= SAME_CLOCK_NS:
        return dict(raws), []
    shifted, findings = dict(raws), list[Finding]()
    for role, raw in raws.items():
        if raw.stamp_ns is None or abs(delay_ns[role]) <= SAME_CLOCK_NS:
            continue
        shift_ns = min(ns for ns in delay_ns.values() if abs(ns - delay_ns[role]) <= SAME_CLOCK_NS)
        shifted[role] = raw.later_by(shift_ns)
        text = "stamps come from another clock than the log's and other sensors'; shifted by "
        text += f"{shift_ns / 1e9:.3f} s, the smallest delay from stamp to log"
        findings.append(raw.finding("CLOCK-SHIFTED", text))
    return shifted, findings


def _received_as_stamped(raw: RawRecords) -> RawRecords:
    """Return records that arrived when they were stamped, if stamps are dates and log times only count records."""
    stamps = raw.stamp_ns
    if stamps is None or not len(stamps) or not raw.received_ns.max() < DATED_NS <= stamps.min():
        return raw
    return replace(raw, received_ns=stamps)


def least_delay_ns(raw: RawRecords) -> int:
    """Return the smallest delay from stamp to log, a few records apart; 0 without stamps."""
    if raw.stamp_ns is None or raw.topic.type.startswith("usbldr/"):  # a column of times, not a clock
        return 0
    known = raw.stamped
    rank = int(LEAST * np.count_nonzero(known))
    least = np.empty(0, dtype=np.int64)  # the smallest of the blocks so far, as many as decide
    for rows in blocks(len(known)):
        delays = (raw.received_ns[rows] - raw.stamp_ns[rows])[known[rows]]
        least = np.sort(np.concatenate([least, delays]))[: rank + 1]
    return int(least[rank]) if len(least) else 0


@dataclass(frozen=True, slots=True)
class Times:
    """Times of n records, and what was assumed."""

    time_ns: Nanoseconds  # (n,) of validity
    received_ns: Nanoseconds  # (n,) max(time of validity, log time)
    stamp_ns: Nanoseconds  # (n,) as stamped
    conventions: tuple[Convention, ...]
    findings: tuple[Finding, ...]


def times_of(
    raw: RawRecords, clock: str | None, latency_s: float, clock_step_s: float = 0.0, section: str = ""
) -> Times:
    """Time the records: by header, or by log time if there is none or so configured; subtract latency and clock step.

    The clock was set forward at the longest gap of the stamps; arrivals are moved, too, if they have the gap.
    Raises SettingError, which names the ``section`` of the step, if that gap is shorter than the step.
    """
    made, findings = list[Convention](), list[Finding]()
    if raw.stamp_ns is None:
        stamp = raw.received_ns
        made.append(Convention("time", LOG_TIME, "type", note="it has no header"))
        findings.append(raw.finding("NO-HEADER", "its type has no header, so it is timed by log time"))
    elif clock == "log":
        stamp = raw.received_ns
        made.append(Convention("time", LOG_TIME, "configuration"))
    else:
        own = raw.topic.type.startswith("usbldr/")
        unset = ~raw.stamped
        stamp = np.where(unset, raw.received_ns, raw.stamp_ns) if unset.any() else raw.stamp_ns
        stamps = "time_ns" if own else "header stamp" if raw.layout.stamp == "header.stamp" else raw.layout.stamp
        made.append(Convention("time", stamps, "configuration" if clock else "type"))
        if unset.any():
            text = f"{unset.sum()} of {len(unset)} header stamps are zero; those records are timed by log time"
            findings.append(raw.finding("ZERO-STAMP", text))
        age_ns = _age_ns(raw) if clock is None else None
        if age_ns is not None:
            what, longest_s = ("their age", 60) if "age_s" in raw.values else ("transmission minus validity", 5)
            known = (age_ns >= 0) & (age_ns < longest_s * 1_000_000_000) & ~unset
            if known.any():
                stamp = stamp - np.where(known, age_ns, 0)
                median_s = float(np.median(age_ns[known])) / 1e9
                made.append(Convention("age_s", median_s, "type", "s", f"median of {what}"))
    time, received = stamp, raw.received_ns
    if clock_step_s:
        time, received = _without_step(raw, stamp, clock_step_s, section)
        made.append(Convention("clock_step_s", clock_step_s, "configuration", "s"))
    if latency_s:
        time = time - round(latency_s * 1e9)
        made.append(Convention("latency_s", latency_s, "configuration", "s"))
    received = received if np.all(received >= time) else np.maximum(time, received)
    return Times(time, received, stamp, tuple(made), tuple(findings))


def _without_step(
    raw: RawRecords, stamp_ns: Nanoseconds, step_s: float, section: str
) -> tuple[Nanoseconds, Nanoseconds]:
    """Return stamps and arrivals, (n,) each, less the step after the longest gap of the stamps."""
    gaps_ns, step_ns = np.diff(stamp_ns), round(step_s * 1e9)
    longest_ns = int(gaps_ns.max(initial=0))
    if longest_ns < step_ns:
        raise SettingError(
            f"[{section}] clock_step_s = {step_s:g}, but the longest gap between stamps of {raw.topic.name} is "
            f"{longest_ns / 1e9:.2f} s: a clock that was set forward leaves a gap as long"
        )
    last = int(np.argmax(gaps_ns))
    late_ns = np.where(np.arange(len(stamp_ns)) > last, step_ns, 0)
    arrived_late = raw.received_ns[last + 1] - raw.received_ns[last] >= step_ns
    return stamp_ns - late_ns, raw.received_ns - late_ns if arrived_late else raw.received_ns


def _age_ns(raw: RawRecords) -> Nanoseconds | None:
    """Return how old each record was when its instrument sent it, (n,), -1 if unset; None: not stated."""
    for unit, to_ns in (("us", 1000), ("ns", 1)):
        if f"transmission_{unit}" in raw.values and f"validity_{unit}" in raw.values:
            sent, valid = (raw.values[f"{what}_{unit}"].astype(np.int64) for what in ("transmission", "validity"))
            return np.where(valid > 0, (sent - valid) * to_ns, -1)
    if "age_s" in raw.values:
        return _whole_ns(raw.number("age_s"))
    if "sent_s" in raw.values and "valid_s" in raw.values:
        sent_s, valid_s = raw.number("sent_s"), raw.number("valid_s")
        return np.where(valid_s > 0, _whole_ns(sent_s - valid_s), -1)
    return None


def _whole_ns(seconds: Vector) -> Nanoseconds:
    """Return seconds (n,) as nanoseconds, -1 if unknown."""
    return np.rint(np.where(np.isfinite(seconds), seconds, -1e-9) * 1e9).astype(np.int64)


def sorted_by_time(table: pd.DataFrame, topic: str, sensor: str) -> tuple[pd.DataFrame, list[Finding]]:
    """Sort a table (in order of arrival) by time of validity; remove repeated records.

    Same time and values: one record. Same time, other values: USBL fixes are all kept, records of other sensors are
    averaged (only the valid ones, if the table has a column of validity).
    """
    findings: list[Finding] = []
    time = table["time_ns"].to_numpy()
    late = int(np.sum(time[1:] < time[:-1]))
    if late:
        why = "fixes arrive late; sorted by stamp, arrival kept" if sensor == "usbl" else "sorted by stamp"
        text = f"{topic}: {late} of {len(time)} records are stamped earlier than the previous one ({why})"
        findings.append(Finding("OUT-OF-ORDER", text, topic))
        table = table.sort_values("time_ns", kind="stable", ignore_index=True)

    values = [column for column in table if column not in ("received_ns", "stamp_ns")]
    same = _same_as_next(table)
    rows = np.append(same, False) | np.append(False, same)  # only records of one stamp can be repeats
    repeated = np.zeros(len(table), dtype=np.bool_)
    if same.any():
        repeated[rows] = table[rows].duplicated(subset=values)
    if repeated.any():
        text = f"{topic}: {repeated.sum()} of {len(table)} records repeat another's stamp and values and are left out"
        findings.append(Finding("REPEATED", text, topic))
        table = table[~repeated].reset_index(drop=True)
    shared = _same_as_next(table)
    some = table.iloc[next(blocks(len(table)), slice(0))]
    if sensor != "usbl" and not shared.any() and (turns := _by_turns(some)):
        text = f"{topic or f'records read as {sensor}'}: {turns}: {OF_SEVERAL}"
        raise LogError(f"{text}, or leave the topic out: --{sensor} none" if topic else text)
    if shared.any():
        found = _same_stamp(table["time_ns"].to_numpy(), int(shared.sum()), topic, sensor)
        if apart := _apart(table, shared) if found.code == "COARSE-TIMES" else "":
            what = topic or f"records read as {sensor}"
            text = f"{what}: {shared.sum()} of {len(table)} records have another's stamp, {apart}: {OF_SEVERAL}"
            if sensor != "usbl":
                raise LogError(f"{text}, or leave the topic out: --{sensor} none" if topic else text)
            found = replace(found, text=text)
        findings.append(found)
        if sensor != "usbl":
            table = _averaged(table)
    return table, findings


def _same_stamp(time_ns: Nanoseconds, count: int, topic: str, sensor: str) -> Finding:
    """Report that some of the records have the time of the next, in order of time (n,), and times that are coarse."""
    what = "all are kept" if sensor == "usbl" else "records of one stamp are averaged"
    text = f"{topic}: {count} of {len(time_ns)} records have another's stamp and other values; {what}"
    if count < max(COARSE_RECORDS, COARSE_SHARE * len(time_ns)):
        return Finding("SAME-STAMP", text, topic)
    steps_ns = np.diff(time_ns)
    step_s = float(steps_ns[steps_ns > 0].min(initial=MAX_TIME_NS)) / 1e9
    steps = f"its times have steps of {step_s:g} s or more" if np.any(steps_ns) else "all its times are the same"
    return Finding("COARSE-TIMES", f"{text}; {steps}: export them with more digits", topic, None, step_s, "s")


def _apart(table: pd.DataFrame, shared: Mask) -> str:
    """Return how far records are from the next of their stamp, ``shared`` (n - 1,), if far more than stamps differ."""
    away, unit = _distances(table)
    rows, firsts = np.flatnonzero(shared), np.flatnonzero(np.append(True, ~shared))
    if not unit or len(firsts) < MIN_STAMPS:
        return ""
    seconds = np.minimum(firsts[1:] + 1, len(table) - 1)  # of the next stamp, if the devices change their order
    within = float(np.median(away(rows, rows + 1)))
    next_to = float(np.median(np.minimum(away(firsts[:-1], firsts[1:]), away(firsts[:-1], seconds))))
    if not within > max(APART_RATIO * next_to, LEAST_APART):
        return ""
    return f"{within:.3g} {unit} away, and those of the next stamp {next_to:.2g} {unit}"


def _by_turns(table: pd.DataFrame) -> str:
    """Return how far records are from the next, if the one behind that is far nearer in most of them."""
    away, unit = _distances(table)
    rows = np.arange(len(table) - 2)
    if not unit or len(rows) < 2 * MIN_STAMPS:
        return ""
    next_to, second = (float(np.median(away(rows, rows + k))) for k in (1, 2))
    if not next_to > max(APART_RATIO * second, LEAST_APART):
        return ""
    return f"records are {next_to:.3g} {unit} from the next, and {second:.2g} {unit} from the one behind it"


def _distances(table: pd.DataFrame) -> tuple[Callable[[Indices, Indices], Vector], str]:
    """Return a function of rows and others to their distances, (n,) each, and its unit, empty if there is none."""
    unit = "m"
    if {"lat_deg", "lon_deg"} <= {*table}:
        lat, lon = (table[name].to_numpy(dtype=float) for name in ("lat_deg", "lon_deg"))
        middle = Origin(float(np.median(lat)), float(np.median(lon)), OriginKind.FIRST_GPS)
        places = np.column_stack(to_plane(middle, lat, lon))
    elif {"east_m", "north_m"} <= {*table}:
        places = table[["east_m", "north_m"]].to_numpy(dtype=float)
    else:
        unit = "deg" if "heading_deg" in table else ""
        places = table[["heading_deg"] if unit else []].to_numpy(dtype=float)

    def away(rows: Indices, others: Indices) -> Vector:
        between = places[others] - places[rows]
        return np.linalg.norm(between if unit == "m" else (between + 180.0) % 360.0 - 180.0, axis=1)

    return away, unit


def _same_as_next(table: pd.DataFrame) -> Mask:
    """Return which records but the last, (n - 1,), have the time of the next."""
    time = table["time_ns"].to_numpy()
    return time[1:] == time[:-1]


def _averaged(table: pd.DataFrame) -> pd.DataFrame:
    """Average the records of each time; angles as directions; the last arrival counts."""
    if "valid" in table:
        some_valid = table.groupby("time_ns")["valid"].transform("any")
        table = table[table["valid"] | ~some_valid]
    parts = table.copy()
    if "heading_deg" in table:
        heading = np.radians(table["heading_deg"].to_numpy(dtype=float))
        parts["cosine"], parts["sine"] = np.cos(heading), np.sin(heading)
    how = {str(column): "mean" for column in parts if column != "time_ns"} | {"received_ns": "max", "stamp_ns": "min"}
    if "valid" in table:
        how["valid"] = "any"
    mean = parts.groupby("time_ns", as_index=False).agg(how)
    if "heading_deg" in table:
        mean["heading_deg"] = np.degrees(np.arctan2(mean["sine"], mean["cosine"])) % 360.0
    return mean[list(table.columns)]
