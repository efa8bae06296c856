"""The result of a check as JUnit XML, which GitLab, Jenkins and others show: a suite per row, a case per metric.

There is no standard; these are the elements of Ant's JUnit task that all of them read: testsuites, testsuite, testcase,
failure, error, system-out.
"""

from collections.abc import Sequence
from xml.etree import ElementTree

from usbldr.filters.errors import printable
from usbldr_cli.tables.check_verdicts import FAILURES, CheckedRow, MetricChange, notes


def junit(baseline: str, checked: Sequence[CheckedRow]) -> str:
    """Return the XML text; a row that could not be run, or not on its whole log, is an error."""
    root = ElementTree.Element("testsuites", name=f"usbldr check {printable(baseline)}")
    for one in checked:
        suite = ElementTree.SubElement(root, "testsuite", name=printable(one.row.name))
        name = f"{baseline}: {one.row.name}"
        for change in one.changes:
            _case(suite, name, change)
        broken = [one.fault] if one.fault is not None else list(one.lost)
        if broken:
            case = ElementTree.SubElement(suite, "testcase", classname=printable(name), name="run")
            ElementTree.SubElement(case, "error", message=printable(broken[0])).text = printable("; ".join(broken))
        failures = sum(change.verdict in FAILURES for change in one.changes)
        suite.set("tests", str(len(suite)))
        suite.set("failures", str(failures))
        suite.set("errors", str(len(broken[:1])))
        said = [printable(text) for _, text in notes([one])]
        if said:
            ElementTree.SubElement(suite, "system-out").text = "\n".join(said)
    for count in ("tests", "failures", "errors"):
        root.set(count, str(sum(int(suite.get(count, "0")) for suite in root)))
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode", xml_declaration=True) + "\n"


def _case(suite: ElementTree.Element, row: str, change: MetricChange) -> None:
    case = ElementTree.SubElement(suite, "testcase", classname=printable(row), name=printable(change.metric))
    if change.verdict in FAILURES:
        old, new = ("none" if value is None else f"{value:.6g}" for value in (change.old, change.new))
        text = f"{change.verdict}: {old} before, {new} now, limit {change.limit:.3g}"
        ElementTree.SubElement(case, "failure", message=text).text = text
