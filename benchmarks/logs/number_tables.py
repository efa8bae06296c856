"""The tables of logs.md that hold our numbers beside those of the collectors of each log."""

import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import groupby

from logs.expected import EXPLAINED, OURS, Number, Value, last_digit
from logs.survey_tables import table

Numbers = Mapping[str, Sequence[Number]]  # by log


def sections(numbers: Numbers) -> str:
    """Return for each log what is in its file, topic by topic, and every other number."""
    parts = []
    for log, of_log in numbers.items():
        shown = [one for one in of_log if not one.held_back]
        held = len(of_log) - len(shown)
        counted = [one for one in shown if one.key.startswith("/")]
        rows = [row(one) for one in shown if not one.key.startswith("/")]
        parts += [f"### {log}", "", *topics(counted), "", table(("number", "theirs", "ours", "tolerance", "met"), rows)]
        if held:
            parts += ["", f"{held} errors against GPS are held back."]
        parts.append("")
    return "\n".join(parts).rstrip()


def topics(counted: Sequence[Number]) -> Iterator[str]:
    """Say how many numbers of each topic are as others counted them."""
    rows = []
    for topic, group in groupby(counted, key=lambda one: one.key.split(".")[0]):
        of_topic = list(group)
        count = next(one for one in of_topic if one.key == f"{topic}.count")
        missed = [one.key.removeprefix(f"{topic}.") for one in of_topic if not one.met]
        met = f"{len(of_topic) - len(missed)} of {len(of_topic)}"
        rows.append(
            (topic, told(count.theirs), told(count.ours), met + (f", not {', '.join(missed)}" if missed else ""))
        )
    yield table(("topic", "their count", "our count", "numbers that agree"), rows)


def row(one: Number) -> tuple[str, ...]:
    tolerance = "not stated" if one.tolerance is None else f"{one.tolerance:.3g}"
    met = "yes" if one.met else "no"
    key = one.key.replace(OURS, ", usbldr's way")
    return key, told(one.theirs), told(one.ours, one.theirs), tolerance, met if one.tolerance is not None else ""


def told(value: Value | None, like: Value = "") -> str:
    """Return a number as it is written, ours with a digit more than theirs."""
    if isinstance(value, float) and isinstance(like, float):
        return f"{value:.{max(0, 1 - round(math.log10(last_digit(like))))}f}"
    return "not measured" if value is None else str(value)


def summary(numbers: Numbers) -> str:
    """Say how many numbers agree, and why some do not."""
    every = [one for of_log in numbers.values() for one in of_log]
    held = sum(one.held_back for one in every)
    judged = [one for one in every if not one.held_back and one.tolerance is not None]
    missed = [one for one in judged if not one.met]
    told_held = f"; {held} errors against GPS are held back" if held else ""
    lines = [
        f"{len(judged) - len(missed)} of {len(judged)} numbers of the `expected.json` files are met by our own "
        f"computation{told_held}." + (" Not met:" if missed else "")
    ]
    for one in missed:
        why = EXPLAINED.get((one.log, one.key), "not explained")
        lines.append(f"- {one.log}, `{one.key}`: theirs {told(one.theirs)}, ours {told(one.ours, one.theirs)}: {why}.")
    return "\n".join(lines)
