"""``usbldr info``: the topics of a log, the sensor that each is, and the conventions by which it is read."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from usbldr.filters.errors import LogError, listed
from usbldr_cli.options.completion import LOG
from usbldr_cli.options.log_options import read_request, selection_options
from usbldr_cli.options.verbosity import verbose_option

if TYPE_CHECKING:
    from usbldr.io.log import Log
    from usbldr.io.reader import TopicInfo
    from usbldr.io.reading.opening import Request
    from usbldr.io.reading.survey import Survey

MAX_COLUMNS_SHOWN = 12  # [columns] of those that no sensor uses
MAX_TOPICS_SHOWN = 40  # [rows] shown of a longer list without --all
NO_SENSOR = "no topic is a sensor that usbldr knows"


@click.command()
@click.argument("logs", metavar="LOG...", type=LOG, nargs=-1, required=True)
@selection_options
@click.option("--all", "all_topics", is_flag=True, help=f"List every topic, not only the first {MAX_TOPICS_SHOWN}.")
@click.option(
    "--fields",
    "fields_of",
    metavar="TOPIC",
    multiple=True,
    help="List the fields of TOPIC, which the key columns of the configuration can name.  [may be repeated]",
)
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
@verbose_option
def info(logs: tuple[str, ...], all_topics: bool, fields_of: tuple[str, ...], as_json: bool, **selection: Any) -> int:
    """List the topics of LOG and how each sensor is read.

    Lists topics with type, count, rate, span and role, every convention and its source, and the findings on the log.
    Exit code 3 if a part of LOG, or a sensor's topic, could not be read, or if LOG cannot be replayed as is.

    \b
    $ usbldr info dive.mcap
    """
    found = [_survey(log, read_request(**selection)) for log in logs]
    if as_json:
        from usbldr.io.reports.run_provenance import made_by

        click.echo(
            json.dumps({**made_by(), "logs": [_described(one, fields_of) for one in found]}, indent=1, allow_nan=False)
        )
    else:
        click.echo("\n\n".join(_text(one, all_topics, fields_of) for one in found))
    return 0 if all(one.complete and not one.fault for one in found) else LogError.exit_code


def _survey(log: str, request: "Request") -> "Survey":
    from usbldr.io.reading.survey import survey, survey_of
    from usbldr.io.session import is_simulated, open_log

    if is_simulated(log):
        return survey_of(open_log(log, request))
    found = survey(Path(log), request)
    return found if found.roles or found.fault else _without_sensors(found, request)


def _without_sensors(found: "Survey", request: "Request") -> "Survey":
    """Return the survey with what to do with its fields if their names look like sensors, else with its tracks."""
    from dataclasses import replace

    from usbldr.io.doctor.proposed_columns import proposed_columns
    from usbldr.io.messages.roles import Roles
    from usbldr.io.reading.read import computed_tracks
    from usbldr.io.settings.sensor_sections import Configuration

    proposed = proposed_columns(found.topics, Roles({}, {}, ()), request, Configuration())
    fields = f"fields of {' and '.join(dict.fromkeys(one.topic.name for one in proposed.values()))}"
    text = f"{NO_SENSOR}, but {fields} look like {', '.join(proposed)}; run usbldr init {found.path.name}"
    tracks = [f"{name} {judged}" for name, judged in computed_tracks(found.path, found.topics).items()]
    return replace(found, fault=text if proposed else "; ".join([NO_SENSOR, *tracks]))


def _text(found: "Survey", all_topics: bool, fields_of: Sequence[str]) -> str:
    from usbldr.filters.errors import printable
    from usbldr.io.provenance import provenance_lines
    from usbldr.io.reader import utc

    total = sum(topic.count for topic in found.topics)
    times = [t for topic in found.topics for t in (topic.first_ns, topic.last_ns) if t is not None]
    when = f", {utc(min(times))} to {utc(max(times))} ({(max(times) - min(times)) / 1e9:.1f} s)" if times else ""
    lines = [f"{found.path}: {found.format}, {total} messages{when}"]
    lines.append(f"configuration: {found.configuration or 'none'}")
    if found.log is not None and found.log.origin is not None:
        origin = found.log.origin
        lines.append(f"origin of east and north: {origin.lat_deg:.9f}, {origin.lon_deg:.9f} deg ({origin.kind})")
    lines += ["", *_topic_table(found, all_topics)]
    for topic in _topics_named(found, fields_of):
        lines += ["", f"fields of {topic.name} ({topic.type or '?'}):", *(f"  {name}" for name in topic.shown_fields)]
    if found.log is not None and found.log.tables:
        for role, p in found.log.provenance.items():
            lines += ["", *provenance_lines(role, p)]
        lines += ["", *_truth(found.log)]
    if found.findings:
        lines += ["", *(f"{finding.code}: {finding.text}" for finding in found.findings)]
    if found.fault:
        lines += ["", f"cannot be replayed as is: {found.fault}"]
    return "\n".join(map(printable, lines))


def _truth(log: "Log") -> list[str]:
    if log.truth is None:
        return ["truth: none (no GPS and no other reference)"]
    truth = log.truth
    span = f"{truth.time_s[0]:.1f} to {truth.time_s[-1]:.1f} s"
    return [
        f"truth: {truth.source}, kind {truth.kind}",
        f"  {len(truth.time_s)} samples from {span}, interpolated over gaps up to {truth.max_gap_s:g} s",
    ]


def _topic_table(found: "Survey", all_topics: bool) -> list[str]:
    roles: dict[str, list[str]] = {}
    for role, topic in found.roles.items():
        roles.setdefault(topic, []).append(role)
    topics = sorted(found.topics, key=lambda topic: (topic.name not in roles, topic.name))
    shown = topics if all_topics else topics[:MAX_TOPICS_SHOWN]
    header = ("topic", "type", "messages", "rate Hz", "span s", "role")
    rows = [header, *((*_cells(topic), " ".join(roles.get(topic.name, ()))) for topic in shown)]
    widths = [max(len(row[i]) for row in rows) for i in range(len(header))]
    left = (True, True, False, False, False, True)
    lines = [
        "  ".join(
            cell.ljust(w) if to_left else cell.rjust(w) for cell, w, to_left in zip(row, widths, left, strict=True)
        )
        for row in rows
    ]
    lines = [line.rstrip() for line in lines]
    if len(topics) > len(shown):
        lines.append(f"and {len(topics) - len(shown)} more topics (--all lists them)")
    problems: dict[str, list[str]] = {}
    for topic in topics:
        if topic.problem:
            problems.setdefault(topic.problem, []).append(topic.name)
    for problem, names in problems.items():
        lines.append(f"cannot be read: {listed(names, 3)}: {problem}")
    for table, unused in {topic.table: topic.unused for topic in topics if topic.unused}.items():
        lines.append(f"columns of {table} that no sensor uses: {listed(unused, MAX_COLUMNS_SHOWN)}")
    return lines


def _cells(topic: "TopicInfo") -> tuple[str, str, str, str, str]:
    rate = f"{topic.rate_hz:.3f}" if topic.span_s > 1e-3 else "-"
    return topic.name, topic.type or "?", str(topic.count), rate, f"{topic.span_s:.3f}"


def _topics_named(found: "Survey", names: Sequence[str]) -> list["TopicInfo"]:
    """Return the topics of these names; raise LogError if one is not there."""
    from usbldr.io.messages.roles import existing_topic

    return [existing_topic(found.path, found.topics, name) for name in names]


def _described(found: "Survey", fields_of: Sequence[str]) -> dict[str, Any]:
    """Return the content of the page for JSON; times in nanoseconds since 1970 if they are absolute."""
    from dataclasses import asdict

    from usbldr.io.provenance import provenance_values

    log = found.log
    truth = log.truth if log else None
    listed = [topic.name for topic in _topics_named(found, fields_of)]
    return {
        "path": str(found.path),
        "format": found.format,
        "sha256": log.sha256 if log else None,
        "complete": found.complete,
        "configuration": str(found.configuration) if found.configuration else None,
        "start_ns": log.start_ns if log else None,
        "origin": asdict(log.origin) if log and log.origin else None,
        "topics": [
            {
                "topic": topic.name,
                "type": topic.type,
                "encoding": topic.encoding,
                "messages": topic.count,
                "first_ns": topic.first_ns,
                "last_ns": topic.last_ns,
                "rate_hz": round(topic.rate_hz, 6) if topic.span_s > 0 else None,
                "roles": [role for role, name in found.roles.items() if name == topic.name],
                "problem": topic.problem or None,
                **({"fields": topic.shown_fields} if topic.name in listed else {}),
            }
            for topic in found.topics
        ],
        "sensors": {role: provenance_values(p) for role, p in log.provenance.items()} if log else {},
        "truth": {"source": truth.source, "kind": truth.kind, "rows": len(truth.time_s)} if truth else None,
        "findings": [asdict(finding) for finding in found.findings],
        "fault": found.fault or None,
    }
