"""The parts of a log whose clock goes back, or far forward: which record is in which; the one chosen, or all joined.

A computer that starts again, or whose clock is set, logs a stretch of time twice: sorted, one would lie within the
other. So stretches are never merged. A clock that does not go back there is another one: its records are used for the
part within whose time they are. A pause that all sensors share is two recordings in one log, or a clock that was set
forward. Integer nanoseconds.
"""

from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from usbldr.filters.errors import UsageError
from usbldr.filters.types import Indices, Mask
from usbldr.io.conventions.clock_steps import DAY, LASTING, LONGEST_LOG_NS, SECOND, STEP_NS, ClockStep, Wrap, examined
from usbldr.io.findings import Finding
from usbldr.io.messages.layouts import RawRecords, blocks
from usbldr.io.messages.roles import SENSORS
from usbldr.io.reader import Nanoseconds, utc

FEW = 2  # [records] of a slow topic within a stretch that is logged twice
MIN_PAUSE_NS = 1800 * SECOND  # [ns] a clock that is set to another time zone moves by half an hour or more
MOST_STEPS = 20  # [steps] of a clock in one log: more are records in another order
JOINED = "joined"


class PartsError(UsageError):
    """The clock of a log goes back, and no part is chosen; ``finding`` lists the parts."""

    finding: Finding


@dataclass(frozen=True, slots=True)
class _Sensor:
    """The records of a sensor, and the steps of its clock."""

    raw: RawRecords  # in the order of the file
    steps: list[ClockStep]
    of_stamps: bool  # the stamps go back
    of_receipt: bool  # the log times go back
    wraps: list[Wrap]


def in_time_order(
    raws: Mapping[str, RawRecords], by_log: Collection[str], part: str | int | None
) -> tuple[dict[str, RawRecords], list[Finding]]:
    """Return the records, which are in the order of the file, in the order of log time, and what was found.

    ``part``: which part of a log whose clock goes back, from 1 on, or JOINED. Roles in ``by_log`` are timed without
    stamps. Raises PartsError if a part has to be chosen, UsageError if there is no such part.
    """
    sensors, findings = _examined(raws, by_log)
    if wraps := [wrap for one in sensors.values() for wrap in one.wraps]:
        sensors, findings = _examined(raws, by_log, wraps)
    paused, longest_ns = shared_pauses({role: one.raw.received_ns for role, one in sensors.items()})
    if not paused and longest_ns == LONGEST_LOG_NS:  # the clock of the stamps alone may have been set
        stamped = {role: one.raw for role, one in sensors.items() if role not in by_log and one.raw.stamped.all()}
        paused, longest_ns = shared_pauses({role: raw.stamp_ns for role, raw in stamped.items()})
    if longest_ns < LONGEST_LOG_NS:
        sensors, findings = _examined(raws, by_log, wraps, longest_ns)
    findings += paused
    first = max(sensors.values(), key=lambda one: (len(one.steps), len(one.raw.received_ns)), default=None)
    if first is None or not first.steps:
        if part is not None:
            findings.append(Finding("KEY-UNUSED", "part is not used; no clock goes back within the log"))
        made = {role: one.raw for role, one in sensors.items()}
    else:
        made, finding = _chosen(sensors, first, part)
        findings.append(finding)
    made = {role: _sorted(raw) for role, raw in made.items()}
    return {role: replace(made[role], attitude=made.get(f"{role} attitude")) for role in raws if role in made}, findings


def on_one_clock(raw: RawRecords) -> tuple[RawRecords, list[Finding]]:
    """Return positions of a file, which are in its order, in the order of time, and what was found.

    Raises UsageError if their clock goes back: the parts would be mixed.
    """
    one, findings = _sensor(raw, True, (), LONGEST_LOG_NS)
    if step := next((step for step in one.steps if step.size_ns > 0), None):
        text = f"the clock goes back by {step.size_ns / SECOND:.3f} s after {utc(step.before_ns)}, at record"
        raise UsageError(f"{text} {step.row + 1}; write the records from there on to a file of their own", path=raw.log)
    return _sorted(one.raw), findings


def _examined(
    raws: Mapping[str, RawRecords],
    by_log: Collection[str],
    known: Collection[Wrap] = (),
    longest_ns: int = LONGEST_LOG_NS,
) -> tuple[dict[str, _Sensor], list[Finding]]:
    """Examine the clock of each sensor; ``known`` are the wraps of all; see `examined`."""
    sensors: dict[str, _Sensor] = {}
    findings: list[Finding] = []
    for role, raw in raws.items():
        sensors[role], found = _sensor(raw, role != "usbl" and role not in by_log, known, longest_ns)
        findings += found
        if raw.attitude is not None:
            sensors[f"{role} attitude"], _ = _sensor(raw.attitude, role not in by_log, known, longest_ns)
    return sensors, findings


def _sensor(
    raw: RawRecords, stamps_count: bool, known_wraps: Collection[Wrap], longest_ns: int
) -> tuple[_Sensor, list[Finding]]:
    """Examine the log times of a sensor, and its stamps; with wraps put right."""
    groups = None
    if (targets := raw.values.get("target", raw.values.get("device"))) is not None:
        names, which = np.unique(targets, return_inverse=True)
        groups = [np.flatnonzero(which == k) for k in range(len(names))]
    received = examined(raw.received_ns, groups, known_wraps, longest_ns)
    wraps, steps, single, stamp_ns = received.wraps, received.steps, received.single, raw.stamp_ns
    of_stamps = False
    if stamp_ns is not None:
        known = slice(None) if raw.stamped.all() else np.flatnonzero(raw.stamped)
        stamps = examined(stamp_ns[known], groups if isinstance(known, slice) else None, known_wraps, longest_ns)
        of_stamps = bool(stamps.steps)
        wraps = [*wraps, *(wrap for wrap in stamps.wraps if wrap.name not in {one.name for one in wraps})]
        if stamps.wraps:
            stamp_ns = stamp_ns.copy()
            stamp_ns[known] = stamps.times_ns
        if stamps_count and not steps and stamps.steps:
            rows = np.arange(len(stamp_ns))[known]
            steps = [step._replace(row=int(rows[step.row])) for step in stamps.steps]
    findings = [
        raw.finding("CLOCK-WRAP", f"its time is a {name} that began again ({count}×); counted on")
        for name, count in Counter(wrap.name for wrap in wraps).items()
    ]
    if single:
        text = f"{single} records are before the one in front of them by more than {STEP_NS / SECOND:g} s; sorted"
        findings.append(raw.finding("OUT-OF-ORDER", text))
    made = replace(raw, received_ns=received.times_ns, stamp_ns=stamp_ns)
    return _Sensor(made, steps, of_stamps, bool(received.steps), wraps), findings


class _Part(NamedTuple):
    first_ns: int
    last_ns: int
    shift_ns: int  # to count on from the part before, or up to the one behind if the clock was set forward

    def holds(self, times_ns: Nanoseconds) -> Mask:
        """Return which times (n,) are within it."""
        return (times_ns >= self.first_ns) & (times_ns <= self.last_ns)


def _chosen(
    sensors: Mapping[str, _Sensor], first: _Sensor, part: str | int | None
) -> tuple[dict[str, RawRecords], Finding]:
    """Return the records of a part, or of all parts joined."""
    last_ns = max(int(_clock(one)[-1]) for one in sensors.values() if one.steps)
    numbers = {role: _numbers(one, first.steps, last_ns) for role, one in sensors.items()}
    parts = _parts(sensors, numbers, first.steps)
    number = str(part) if part is not None else ""
    stepped = sorted({one.raw.topic.name for one in sensors.values() if one.steps})
    unordered = len(first.steps) > MOST_STEPS and part is None
    sizes = ", ".join(
        f"{'back' if step.size_ns > 0 else 'forward'} by {abs(step.size_ns) / SECOND:.3f} s after {utc(step.before_ns)}"
        for step in (first.steps[:1] if unordered else first.steps)
    )
    listed = "; ".join(f"part {k}: {utc(p.first_ns)} to {utc(p.last_ns)}" for k, p in enumerate(parts, start=1))
    if paused := [-step.size_ns for step in first.steps if -LONGEST_LOG_NS <= step.size_ns < 0]:
        why = "another recording, or dates to be read by time_format" if max(paused) > DAY else "another recording"
        sizes += f" (or all sensors pause there: {why})"
    listed = f"{len(first.steps)} times in all, as no clock does" if unordered else listed
    text = f"{', '.join(stepped)}: the clock goes {sizes}, at record {first.steps[0].row + 1}; {listed}"
    if number != JOINED and number not in map(str, range(1, len(parts) + 1)):
        advice = f"choose one with --part N or part = N in the configuration; {JOINED} in place of N continues it"
        advice = "the records are not in the order of their times: sort them" if unordered else advice
        if part is not None:
            raise UsageError(f"there is no part {part}: {text}; {advice}", path=first.raw.log)
        error = PartsError(f"{text}; {advice}", path=first.raw.log)
        error.finding = _finding(first, text)
        raise error
    made: dict[str, RawRecords] = {}
    for role, one in sensors.items():
        own = numbers[role]
        if number == JOINED:
            made[role] = _joined(one, own if own is not None else _by_span(one, parts), parts)
        else:
            k = int(number) - 1
            rows = own == k if own is not None else parts[k].holds(_clock(one))
            if rows.any():
                made[role] = one.raw.part(rows)
    what = "the parts are joined" if number == JOINED else f"only part {number} is used"
    return made, _finding(first, f"{text}; {what}")


def _finding(first: _Sensor, text: str) -> Finding:
    if any(step.size_ns > 0 for step in first.steps):
        return Finding("CLOCK-BACK", text, first.raw.topic.name)
    return Finding("CLOCK-FORWARD", text, first.raw.topic.name)


def _clock(one: _Sensor) -> Nanoseconds:
    """Return the times that go back: log times, else stamps."""
    by_stamps = one.of_stamps and not one.of_receipt
    return one.raw.stamp_ns if by_stamps and one.raw.stamp_ns is not None else one.raw.received_ns


def _numbers(one: _Sensor, steps: Sequence[ClockStep], last_ns: int) -> Indices | None:
    """Return the number of the part, from 0 on, of each record (n,); None for a clock that does not go back.

    ``last_ns`` is the last time of those that do.
    """
    times = _clock(one)
    numbers, k = np.zeros(len(times), dtype=np.intp), 0
    if one.steps:
        for at, own in enumerate(one.steps):
            left = range(k, len(steps) - (len(one.steps) - at - 1))
            apart_ns = [abs(steps[i].before_ns - own.before_ns) + abs(steps[i].after_ns - own.after_ns) for i in left]
            k = 1 + left[int(np.argmin(apart_ns))]
            numbers[own.row :] = k
        return numbers
    for step in steps:
        if (behind := _behind(times, step, last_ns)) is None:
            return None
        numbers += behind
    return numbers


def _behind(times_ns: Nanoseconds, step: ClockStep, last_ns: int) -> Mask | None:
    """Return which records (n,) are behind a step that their times do not show; None if their clock has none.

    A gap hides a step that is shorter. A clock without the step would go on after the last time of those with it.
    """
    if np.sum((times_ns > step.after_ns) & (times_ns <= step.before_ns)) <= FEW:
        return times_ns > max(step.before_ns, (step.before_ns + step.after_ns) // 2)
    gaps_ns = np.diff(times_ns)
    at_step = (times_ns[:-1] <= step.before_ns) & (times_ns[1:] >= step.after_ns)
    last = int(np.argmax(np.where(at_step, gaps_ns, 0)))
    if gaps_ns[last] <= LASTING * np.median(gaps_ns) or times_ns[-1] - last_ns > step.size_ns // 2:
        return None
    return np.arange(len(times_ns)) > last


def _by_span(one: _Sensor, parts: Sequence[_Part]) -> Indices:
    """Return the number of the part of each record (n,) of a clock without a step; all 0 if two parts hold one."""
    inside = np.array([part.holds(_clock(one)) for part in parts])
    return np.argmax(inside & np.all(inside.sum(axis=0) < 2), axis=0).astype(np.intp)


def _parts(
    sensors: Mapping[str, _Sensor], numbers: Mapping[str, Indices | None], steps: Sequence[ClockStep]
) -> list[_Part]:
    found: list[_Part] = []
    shift_ns = 0
    for k in range(len(steps) + 1):
        times = [_clock(one)[numbers[role] == k] for role, one in sensors.items() if one.steps]
        times = [some for some in times if len(some)]
        if k:
            shift_ns += steps[k - 1].size_ns
        found.append(_Part(min(int(t.min()) for t in times), max(int(t.max()) for t in times), shift_ns))
    set_ns = min(part.shift_ns for part in found)  # below 0 if a clock was set forward: the time after that is right
    return [part._replace(shift_ns=part.shift_ns - set_ns) for part in found]


def _joined(one: _Sensor, numbers: Indices, parts: Sequence[_Part]) -> RawRecords:
    """Return the records with each part counted on from the one before; only the clocks that go back are shifted."""
    shift_ns = np.array([part.shift_ns for part in parts], dtype=np.int64)[numbers]
    raw, stamp_ns = one.raw, one.raw.stamp_ns
    received_ns = raw.received_ns + shift_ns if one.of_receipt or not one.of_stamps else raw.received_ns
    if stamp_ns is not None and (one.of_stamps or (not one.steps and _one_clock(raw, shift_ns))):
        stamp_ns = np.where(raw.stamped, stamp_ns + shift_ns, 0)
    return replace(raw, received_ns=received_ns, stamp_ns=stamp_ns)


def _one_clock(raw: RawRecords, shift_ns: Nanoseconds) -> bool:
    """Tell whether stamps and log times have the same steps: the delay between them is then the steadier one."""
    if raw.stamp_ns is None or not raw.stamped.any():
        return False
    delay_ns, moved_ns = (raw.received_ns - raw.stamp_ns)[raw.stamped], shift_ns[raw.stamped]
    apart = [float(np.mean(np.abs(one - np.median(one)))) for one in (delay_ns, delay_ns + moved_ns)]
    return apart[0] <= apart[1]


def _sorted(raw: RawRecords) -> RawRecords:
    """Return the records in the order of log time, those of equal time as they came."""
    if np.all(raw.received_ns[1:] >= raw.received_ns[:-1]):
        return raw
    return raw.part(np.argsort(raw.received_ns, kind="stable"))


def shared_pauses(times_ns: Mapping[str, Nanoseconds | None]) -> tuple[list[Finding], int]:
    """Report where no sensor has a record for MIN_PAUSE_NS, and return which of it divides the log: what is longer.

    That is the length of the log without the longest pauses, if each is longer than that; else LONGEST_LOG_NS.
    DVL, compass and USBL have records before and behind a pause. ``times_ns``: by role, in the order of the file.
    """
    stretches = {role: _stretches(times) for role, times in times_ns.items() if times is not None and len(times)}
    if not stretches:
        return [], LONGEST_LOG_NS
    every = np.concatenate(list(stretches.values()))
    first, last = every[np.argsort(every[:, 0])].T
    last = np.maximum.accumulate(last)
    pauses = [(int(last[k]), int(first[k + 1])) for k in np.flatnonzero(first[1:] - last[:-1] > MIN_PAUSE_NS)]
    both = [part for role, part in stretches.items() if role in SENSORS]
    shared = [(before, after) for before, after in pauses if all(s.min() <= before and s.max() >= after for s in both)]
    lengths = np.sort([after - before for before, after in shared])[::-1]
    recorded = last[-1] - first[0] - np.cumsum(lengths)
    longest_ns = int(min(recorded[lengths > recorded], default=LONGEST_LOG_NS))
    return [_pause(before, after - before) for before, after in shared if after - before <= longest_ns], longest_ns


def _pause(before_ns: int, length_ns: int) -> Finding:
    text = f"all sensors pause for {length_ns / SECOND:.0f} s together after {utc(before_ns)}"
    text += ": two recordings, or a clock that was set forward"
    return Finding("PAUSE", f"{text}; score one side with --start or --end, or undo a step with clock_step_s")


def _stretches(times_ns: Nanoseconds) -> Indices:
    """Return the first and last times (k, 2) of the stretches between steps forward by MIN_PAUSE_NS."""
    steps = [
        rows.start + 1 + np.flatnonzero(np.diff(times_ns[rows.start : rows.stop + 1]) > MIN_PAUSE_NS)
        for rows in blocks(len(times_ns))
    ]
    begins = np.concatenate([[0], *steps])
    return np.column_stack([np.minimum.reduceat(times_ns, begins), np.maximum.reduceat(times_ns, begins)])
