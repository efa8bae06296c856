"""Everything that is wrong with a log for navigation, found without options.

Works for a log that cannot be replayed as is, too: the reason is a finding like the others.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice, product
from pathlib import Path

import numpy as np

from usbldr.filters.errors import UsageError, UsbldrError
from usbldr.filters.types import Timeline, Vector
from usbldr.io.conventions.dvl_depth import dvl
from usbldr.io.conventions.sanity import underwater_findings
from usbldr.io.doctor.cross_check import CrossCheck, cross_check, moves_alike
from usbldr.io.doctor.head_calibration import vertical_findings
from usbldr.io.doctor.interpretations import HandednessEvidence, recorded_value
from usbldr.io.doctor.message_evidence import RAW_FIELDS, message_evidence
from usbldr.io.doctor.thresholds import THRESHOLDS
from usbldr.io.findings import Finding
from usbldr.io.log import Log, missing_sensor_text
from usbldr.io.messages.roles import SENSORS, candidates
from usbldr.io.reading.epochs import timeline
from usbldr.io.reading.opening import OpenedLog, Request, open_configured
from usbldr.io.reading.read import read
from usbldr.io.reading.sensors import roles_of
from usbldr.io.units import MPS_PER_UNIT

# fixed: 16-bit integers of a DVL without bottom lock, in mm/s and cm/s
SENTINELS_MPS = (32.767, 32.768, 327.67, 327.68)


@dataclass(frozen=True, slots=True)
class Examination:
    """The findings of a log, errors first."""

    path: Path
    format: str
    configuration: Path | None
    findings: tuple[Finding, ...]
    log: Log | None  # None: it cannot be read with any choice
    timeline: Timeline | None
    alternatives: Mapping[str, Sequence[str]]  # role -> the topics that could be the sensor instead
    sensor_check: CrossCheck = CrossCheck(())

    @property
    def healthy(self) -> bool:
        """Tell whether there is no error."""
        return not any(d.level == "error" for d in self.findings)


def examine(path: Path, request: Request, with_errors: bool = True) -> Examination:
    """Examine a log; raise LogError if it cannot be opened, UsageError if its configuration is invalid.

    Without the errors of its sensors it takes a fraction of the time; `with_sensor_errors` adds them.
    """
    opened = open_configured(path, request)
    faults, chosen, tied = _resolve_topics(opened, request)
    log, fault, fixed = None, None, chosen
    for picks in islice(product(*tied.values()), THRESHOLDS.max_topic_combinations):
        trial = fixed | dict(zip(tied, picks, strict=True))
        try:
            tried = read(opened, replace(request, topics=dict(request.topics) | trial), RAW_FIELDS)
        except UsbldrError as err:
            fault = fault or err
            continue
        alike = not tied or moves_alike(tried)
        if log is None or alike:  # of several the first that moves with the others, else the first
            log, chosen = tried, trial
        if alike:
            break
    found = [
        Finding("ROLE-UNDECIDED", faults[role] + (f"; doctor uses {chosen[role]}" if log else ""), chosen.get(role, ""))
        for role in tied
    ]
    found += [Finding("UNUSABLE", text) for role, text in faults.items() if role not in tied]
    if log is None:
        why = fault.text_beside(path) if fault else ""
        found += [*opened.reader.findings(), Finding("UNUSABLE", why)]
        return Examination(path, opened.reader.format, opened.file, _errors_first(found), None, None, {})
    alternatives = {role: [name for name in tied[role] if name != chosen[role]] for role in tied}
    found += [*_clock_findings(log), *_invalid(log)]
    return _examine_tables(log, found, message_evidence(log), alternatives, with_errors)


def examine_log(log: Log) -> Examination:
    """Examine a log that has no file, such as a simulated one."""
    return _examine_tables(log, [], [], {})


def with_sensor_errors(found: Examination) -> Examination:
    """Return an examination with the errors of the sensors."""
    log, line, check = found.log, found.timeline, found.sensor_check
    if log is None or line is None or not {*SENSORS} <= log.tables.keys():
        return found
    others = [one for one in found.findings if one not in check.findings]
    check = cross_check(log, line, message_evidence(log))
    return replace(found, findings=_errors_first([*others, *check.findings]), sensor_check=check)


def _examine_tables(
    log: Log,
    found: list[Finding],
    sources: Sequence[HandednessEvidence],
    alternatives: Mapping[str, Sequence[str]],
    with_errors: bool = True,
) -> Examination:
    found = [*found, *underwater_findings(log.tables, log.topic_of("gps")), *vertical_findings(log)]
    said = {(one.code, one.topic) for one in found}
    found += [one for one in log.findings if (one.code, one.topic) not in said]
    for role in SENSORS:
        if role not in log.tables:
            found.append(Finding("SENSOR-MISSING", missing_sensor_text(log, role)))
    dive_timeline, check = None, CrossCheck(())
    try:
        dive_timeline = timeline(log)
    except UsbldrError as err:
        if not any(d.code in ("SENSOR-MISSING", "ROLE-UNDECIDED") for d in found):
            found.append(Finding("UNUSABLE", err.text_beside(log.path)))
    found += _delays(log)
    if dive_timeline is not None:
        found += _outages(log, dive_timeline)
        check = cross_check(log, dive_timeline, sources, with_errors) if {*SENSORS} <= log.tables.keys() else check
    ordered = _errors_first([*found, *check.findings])
    return Examination(log.path, log.format, log.configuration, ordered, log, dive_timeline, alternatives, check)


def _errors_first(found: Sequence[Finding]) -> tuple[Finding, ...]:
    order = {"error": 0, "warning": 1, "info": 2}
    return tuple(sorted(found, key=lambda finding: order[finding.level]))


def _resolve_topics(opened: OpenedLog, request: Request) -> tuple[dict[str, str], dict[str, str], dict[str, list[str]]]:
    """Return why roles are not filled, those set to "none", and the candidate topics of ambiguous roles.

    Candidates with the most messages come first.
    """
    path, topics = opened.reader.path, opened.reader.topics()
    roles = roles_of(topics, request, opened)
    taken = {choice.topic.name for choice in roles.chosen.values()}
    faults = {role: fault.text_beside(path) for role, fault in roles.unresolved.items()}
    tied: dict[str, list[str]] = {}
    for role, fault in roles.unresolved.items():
        free = candidates(role, topics, taken).best
        if isinstance(fault, UsageError) and len(free) > 1:
            tied[role] = [topic.name for topic in sorted(free, key=lambda topic: -topic.count)]
    return faults, {role: "none" for role in faults if role not in tied}, tied


def _clock_findings(log: Log) -> list[Finding]:
    """Compare the delay from stamp to log of DVL and heading: usually one computer logs both."""
    raws, lag_s, after_s = log.raws, dict[str, float](), dict[str, float]()
    for role, section in (("dvl", log.settings.dvl), ("compass", log.settings.compass)):
        if role not in raws:
            return []
        stamp = None if section.time == "log" else raws[role].stamp_ns
        lags: Vector = np.zeros(1) if stamp is None else (raws[role].received_ns - stamp)[stamp > 0] / 1e9
        if not len(lags):
            return []
        lag_s[role] = float(np.median(lags))
        after_s[role] = lag_s[role] + section.latency_s
    wrong, right = ("dvl", "compass") if _implausible_delay(after_s["dvl"], after_s["compass"]) else ("compass", "dvl")
    apart_s = after_s[wrong] - after_s[right]
    far = max(map(abs, lag_s.values())) >= THRESHOLDS.max_epoch_difference_s
    if far or abs(apart_s) <= THRESHOLDS.max_clock_difference_s:
        return []
    headless = " (it has no stamps)" if raws[wrong].stamp_ns is None else ""
    text = (
        f"logged {after_s[wrong]:.2f} s after its time of validity{headless}, {raws[right].topic.name} "
        f"{after_s[right]:.2f} s after its own; if both have the same delay, state latency_s = "
        f"{after_s[right] - lag_s[wrong]:.2f} under [{wrong}]"
    )
    return [log.finding("CLOCK-OFFSET", wrong, text, None, apart_s, "s")]


def _implausible_delay(lag_s: float, other_s: float) -> bool:
    """Tell whether a delay from stamp to log is negative or too long for a driver, and longer than the other's."""
    late = lag_s < -THRESHOLDS.max_clock_difference_s or lag_s > THRESHOLDS.max_logging_delay_s
    return late and abs(other_s) < abs(lag_s)


def _invalid(log: Log) -> list[Finding]:
    """Report the DVL's invalid records, and the largest velocity in one, m/s along its own axes."""
    counted = [finding for finding in log.findings if finding.code == "DVL-INVALID"]
    if not counted or "dvl" not in log.tables:
        return []
    table = log.tables["dvl"]
    bad = table[~table["valid"]]
    raw = log.raws["dvl"]
    invalid = ~dvl(raw, log.settings.dvl).table["valid"].to_numpy(dtype=bool)  # (n,) as they arrived
    xyz_mps = np.column_stack([raw.number(axis) for axis in "xyz"]) * MPS_PER_UNIT[recorded_value(log, "dvl", "unit")]
    largest = np.max(np.abs(np.nan_to_num(xyz_mps[invalid])), axis=1)
    near = {s: np.abs(largest - s) < THRESHOLDS.sentinel_tolerance_mps for s in SENTINELS_MPS}
    worst = float(largest.max())
    counts = [f"{np.sum(found)} have the no-bottom-lock value {s:g} m/s" for s, found in near.items() if found.any()]
    text = "; ".join([counted[0].text, *counts])
    time_s = float(bad["time_s"].iloc[0]) if len(bad) else None
    return [Finding("DVL-INVALID", text, log.provenance["dvl"].topic, time_s, worst, "m/s")]


def _delays(log: Log) -> list[Finding]:
    if "usbl" not in log.tables:
        return []
    table = log.tables["usbl"]
    late = (table["received_s"] - table["time_s"]).to_numpy(dtype=float)
    median, worst = float(np.nanmedian(late)), int(np.nanargmax(late))
    if not median > THRESHOLDS.notable_delay_s:
        return []
    text = f"fixes arrive {median:.2f} s (median) to {late[worst]:.2f} s after their time of validity"
    return [log.finding("USBL-DELAYED", "usbl", text, float(table["time_s"].iloc[worst]), float(late[worst]), "s")]


def _outages(log: Log, dive_timeline: Timeline) -> list[Finding]:
    found: list[Finding] = []
    for role in SENSORS:
        mine = [outage for outage in dive_timeline.outages if outage.sensor == role]
        if not mine or role not in log.provenance:
            continue
        longest = max(mine, key=lambda outage: outage.end_s - outage.start_s)
        length_s = longest.end_s - longest.start_s
        total_s = sum(outage.end_s - outage.start_s for outage in mine)
        lost = role == "dvl" and not log.tables["dvl"]["valid"].all()
        code, what = ("LOST-LOCK", "no bottom lock") if lost else ("OUTAGE", "no records")
        span = f"{length_s:.1f} s from {longest.start_s:.1f} s on"
        several = f"in {len(mine)} stretches, {total_s:.0f} s in total, the longest {span}"
        where = several if len(mine) > 1 else f"for {span}"
        found.append(log.finding(code, role, f"{what} {where}", longest.start_s, length_s, "s"))
    return found
