"""What a log holds and how it would be interpreted, also if it cannot be replayed as is."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from usbldr.filters.errors import LogError, UsbldrError
from usbldr.io.conventions.clock_parts import PartsError
from usbldr.io.findings import Finding
from usbldr.io.log import Log
from usbldr.io.reader import TopicInfo
from usbldr.io.reading.opening import Request, open_configured
from usbldr.io.reading.read import read, require
from usbldr.io.reading.sensors import roles_of


@dataclass(frozen=True, slots=True)
class Survey:
    """A log's topics, their roles, and the log itself or why it cannot be read."""

    path: Path
    format: str
    configuration: Path | None
    topics: tuple[TopicInfo, ...]
    roles: Mapping[str, str]  # role -> topic
    findings: tuple[Finding, ...]
    log: Log | None  # without the undecided roles; None: see fault
    fault: str  # why it cannot be replayed as is; empty also for a log without any sensor
    complete: bool = True  # whether all topics of sensors could be read, and nothing of the file was lost


def survey(path: Path, request: Request) -> Survey:
    """Survey a log; raise LogError if it is not a log, UsageError if the configuration is invalid."""
    opened = open_configured(path, request)
    reader = opened.reader
    topics = reader.topics()
    found = roles_of(topics, request, opened)
    roles, undecided = found.chosen, dict.fromkeys(found.unresolved, "none")
    more: tuple[Finding, ...] = ()
    log, fault = None, "; ".join(unresolved.text_beside(path) for unresolved in found.unresolved.values())
    try:
        log = read(opened, replace(request, topics={**request.topics, **undecided}))
        if roles and not fault:
            require(log, ("dvl", "compass"))  # without fixes, dead reckoning is still possible
    except UsbldrError as err:
        why = err.text_beside(path)
        repeated = any(topic.problem and topic.problem in why for topic in topics)  # the fault that is known says it
        fault = f"{fault}; {why}" if fault and not repeated else fault or why
        more = (err.finding,) if isinstance(err, PartsError) else ()
    findings = log.findings if log else (*reader.findings(), *more)
    unreadable = any(isinstance(unresolved, LogError) for unresolved in found.unresolved.values())
    return Survey(
        path=path,
        format=reader.format,
        configuration=opened.file,
        topics=topics,
        roles={role: choice.topic.name for role, choice in roles.items()},
        findings=findings,
        log=log,
        fault=fault,
        complete=not unreadable and not any(finding.lost_data for finding in findings),
    )


def survey_of(log: Log) -> Survey:
    """Survey a log that has no file, such as a simulated one."""
    topics: list[TopicInfo] = []
    for role, table in log.tables.items():
        received = [log.start_ns + round(t * 1e9) for t in (table["received_s"].min(), table["received_s"].max())]
        p = log.provenance[role]
        topics.append(TopicInfo(p.topic, p.type, log.format, len(table), received[0], received[1]))
    roles = {role: log.provenance[role].topic for role in log.tables}
    return Survey(log.path, log.format, None, tuple(topics), roles, log.findings, log, "")
