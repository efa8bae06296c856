"""The truth of a log, from its source: a file, a topic, or the GPS."""

from dataclasses import replace

from usbldr.filters.types import Truth
from usbldr.io.conventions.sanity import repeated_fix_findings, truth_jump_findings, truth_overlap_findings
from usbldr.io.conventions.truth import by_fixes, read_truth_file, truth_from_table
from usbldr.io.findings import Finding
from usbldr.io.provenance import Provenance
from usbldr.io.reading.sensors import SensorTables
from usbldr.io.reading.truth_source import TruthSource, place_unknown
from usbldr.io.settings.sensor_sections import Configuration


def read_truth(
    source: TruthSource, kind: str, configuration: Configuration, sensors: SensorTables, start_ns: int
) -> tuple[Truth | None, dict[str, Provenance], list[Finding]]:
    """Return the truth, or None, how one of its own was read (role -> provenance), and what was found.

    A topic of its own is taken out of the tables of ``sensors``. Raises LogError if its file cannot be read, or none of
    its rows is left.
    """
    own: dict[str, Provenance] = {}
    findings: list[Finding] = []
    tables, section, gps = sensors.tables, configuration.truth, sensors.provenance.get("gps")
    if source.file is not None:
        table, own["truth"], *_ = read_truth_file(source.file, source.chosen_by, section, start_ns, sensors.origin)
    elif source.off:
        table = None
    elif source.topic is not None:
        table, own["truth"] = tables.pop("truth"), sensors.provenance["truth"]
    else:
        table = tables.get("gps")
    if source.file is None and source.topic is None and table is not None and section.frame:
        text = "frame of [truth] is not used: the truth is the log's GPS, which is read by the frame of [gps]"
        findings.append(Finding("KEY-UNUSED", text))
    if table is None or (used := own.get("truth", gps)) is None:
        return None, own, findings
    truth, more = truth_from_table(table, used.topic, start_ns, section, kind)
    findings += more
    truth = replace(truth, place_unknown=place_unknown(sensors.provenance | own, sensors.origin))
    if own and "usbl" in tables:
        truth, own["truth"], more = by_fixes(truth, used, tables["usbl"], start_ns)
        findings += more
    findings += [*truth_overlap_findings(truth, tables, start_ns), *truth_jump_findings(truth)]
    findings += repeated_fix_findings(table, own.get("truth", used), start_ns)
    return truth, own, findings
