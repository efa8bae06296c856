"""The truth of a log: where it comes from (a file, a topic, or the GPS), of which kind it is, and its positions."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from usbldr.filters.errors import LogError, SettingError, UsageError, did_you_mean
from usbldr.filters.types import Truth
from usbldr.io.conventions.sanity import repeated_fix_findings, truth_jump_findings, truth_overlap_findings
from usbldr.io.conventions.truth import by_fixes, truth_from_table
from usbldr.io.conventions.usbl_head import SHIP, SHIP_HEADING
from usbldr.io.findings import Finding
from usbldr.io.geodesy import Origin, OriginKind
from usbldr.io.messages.roles import TopicChoice, find_topic, topic_named
from usbldr.io.provenance import Provenance
from usbldr.io.reader import TopicInfo
from usbldr.io.reading.opening import Request
from usbldr.io.reading.position_files import find_truth_file, read_positions
from usbldr.io.reading.sensors import SensorTables
from usbldr.io.settings.sensor_sections import Configuration
from usbldr.io.tables.csv_text import text_files

KINDS_BY_NAME = {
    "slam": re.compile(r"slam|graph_vertices|pose_graph"),
    "simulated": re.compile(r"(^|[/_])(sim|simulated|simulator|gazebo|stonefish|holoocean)($|[/_.])"),
}
"""Words of the names of local truths."""


@dataclass(frozen=True, slots=True)
class TruthSource:
    """The source of the truth: a file, a topic, none (off), else the GPS."""

    file: Path | None = None
    topic: TopicChoice | None = None
    off: bool = False
    chosen_by: str = "configuration"


def truth_source(
    path: Path, topics: Sequence[TopicInfo], request: Request, configuration: Configuration
) -> TruthSource:
    """Return the source: of the option, else of [truth], else the simulator's own topic, else the GPS.

    Raises LogError if a file or topic is not there.
    """
    section, option = configuration.truth, request.truth
    if option == "none" or (option is None and section.topic == "none"):
        return TruthSource(off=True)
    if option is not None:
        file = find_truth_file(option, path, from_option=True)
        if file is not None:
            return TruthSource(file, chosen_by="option")
        if find_topic(topics, option) is None:
            hint = did_you_mean(option, [topic.name for topic in topics], 3)
            raise LogError(f"truth {option} is neither a file, here or beside the log, nor a topic{hint}", path=path)
        return TruthSource(topic=topic_named(path, topics, "truth", option, "option"), chosen_by="option")
    if section.file is not None:
        file = find_truth_file(section.file, path, from_option=False)
        if file is None:
            raise LogError("no such truth file ([truth] file)", path=path.resolve().parent / section.file)
        return TruthSource(file)
    if section.topic is not None:
        return TruthSource(topic=topic_named(path, topics, "truth", section.topic, "configuration"))
    own = [topic for topic in topics if topic.type == "usbldr/truth"]
    if len(own) != 1:
        return TruthSource()
    files = text_files(path) if own[0].problem and path.is_dir() else ()  # its columns are not usbldr's own
    file = next((file for file in files if file.stem == "truth"), None)
    if file is not None:
        return TruthSource(file, chosen_by="name")
    return TruthSource(topic=topic_named(path, topics, "truth", own[0].name, "type and name"))


def refuse_as_sensor(path: Path, choices: Mapping[str, TopicChoice], truth_role: str | None) -> None:
    """Raise UsageError if a sensor of the filter reads the topic of the truth."""
    if truth_role is None or truth_role not in choices:
        return
    for role in ("dvl", "compass", "usbl", SHIP, SHIP_HEADING):
        if role not in choices or choices[role].topic.name != choices[truth_role].topic.name:
            continue
        fields, true_fields = (set(choices[who].layout.required.values()) for who in (role, truth_role))
        if fields & true_fields or not choices[role].layout.by_columns:  # which give one topic several sensors
            text = f"{choices[role].topic.name} cannot be the {role} and the truth at once"
            raise UsageError(f'{text}: name another --truth, or "none"', path=path)


def read_truth(
    source: TruthSource, request: Request, configuration: Configuration, sensors: SensorTables, start_ns: int
) -> tuple[Truth | None, dict[str, Provenance], list[Finding]]:
    """Return the truth, or None, how one of its own was read (role -> provenance), and what was found.

    A topic of its own is taken out of the tables of ``sensors``. Raises LogError if its file cannot be read, or none of
    its rows is left.
    """
    own: dict[str, Provenance] = {}
    findings: list[Finding] = []
    tables, section, gps = sensors.tables, configuration.truth, sensors.provenance.get("gps")
    if source.file is not None:
        asked = ("truth", source.chosen_by)
        try:
            read = read_positions(source.file, asked, request, section, start_ns, sensors.origin)
        except SettingError as err:
            raise UsageError(f"[truth] {err.text}", path=source.file) from err
        table, own["truth"], findings = read.table, read.provenance, [*read.findings]
    elif source.off:
        table = None
    elif source.topic is not None:
        table, own["truth"] = tables.pop("truth"), sensors.provenance["truth"]
    else:
        table = tables.get("gps")
    if source.file is None and source.topic is None and table is not None and section.frame:
        text = "frame of [truth] is not used: the truth is the log's GPS, which is read by the frame of [gps]"
        findings.append(Finding("KEY-UNUSED", text))
    if section.file is None and source.file is None and not source.off and section.columns:
        text = "columns of [truth] are not used: they are those of a file, which file under [truth] or --truth names"
        findings.append(Finding("KEY-UNUSED", text))
    if table is None or (used := own.get("truth", gps)) is None:
        return None, own, findings
    kind = _truth_kind(source, request, configuration)
    rows = table if source.file else table.iloc[section.skip_rows :]
    truth = truth_from_table(rows, used.topic, start_ns, section, kind)
    by_gps = kind == "gps" and not own and not section.latency_s
    clock = ("gps", configuration.gps.latency_s) if by_gps else ("truth", section.latency_s)
    unknown = _place_unknown(sensors.provenance | own, sensors.origin)
    truth = replace(truth, section=clock[0], latency_s=clock[1], place_unknown=unknown)
    if own and "usbl" in tables:
        truth, own["truth"], more = by_fixes(truth, used, tables["usbl"], start_ns)
        findings += more
    findings += [*truth_overlap_findings(truth, tables, start_ns), *truth_jump_findings(truth)]
    findings += repeated_fix_findings(table, own.get("truth", used), start_ns)
    return truth, own, findings


def _truth_kind(source: TruthSource, request: Request, configuration: Configuration) -> str:
    """Return the kind of truth: as stated, unless an option names another source; else by type, then by name."""
    section = configuration.truth
    if section.kind is not None and (source.chosen_by != "option" or request.truth in (section.topic, section.file)):
        return section.kind
    named = source.file.name if source.file else source.topic.topic.name if source.topic else ""
    by_name = next((kind for kind, words in KINDS_BY_NAME.items() if words.search(named.lower())), None)
    if source.file is not None or (source.topic is not None and source.topic.layout.defaults.get("frame") != "latlon"):
        return by_name or "other"
    return "gps"


def _place_unknown(provenance: Mapping[str, Provenance], origin: Origin | None) -> bool:
    """Return whether only one of fixes and truth has latitudes, and the origin of the other's map is not stated."""
    if "usbl" not in provenance or origin is None:
        return False
    truth = provenance["truth" if "truth" in provenance else "gps"]
    fixes_latlon, truth_latlon = provenance["usbl"].geodetic, truth.convention("frame").value == "latlon"
    stated = (OriginKind.MAP, OriginKind.HEAD, OriginKind.BEACON) if truth_latlon else (OriginKind.MAP,)
    return fixes_latlon != truth_latlon and origin.kind not in stated
