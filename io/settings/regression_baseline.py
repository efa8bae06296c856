"""The baseline of a regression check: a TOML file of runs with their metrics, and how far these may change.

Each ``[[row]]`` names a run: name, log (relative to the file's folder, or a scenario), filter, seeds, any long option
of ``usbldr replay`` (``dr_from`` for --dr-from), and a table ``metrics`` by their names in report.json. Each metric has
a value, a tolerance (limit = abs + rel |value|) and, unless it is the usual one, a direction. ``log_sha256``, and
``tool`` and ``date`` of the file, are written with the values: of which log they are, and who made them when.
"""

import datetime
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, TypeAlias, cast

import tomlkit
from msgspec import Meta, Struct
from tomlkit.items import InlineTable

from usbldr.filters.errors import UsageError
from usbldr.filters.evaluation.error_report import METRICS
from usbldr.filters.evaluation.metrics import Direction
from usbldr.filters.evaluation.seed_statistics import DIVERGED_SHARE
from usbldr.io.settings.noise_sections import NotNegative
from usbldr.io.settings.validation import checked, read_document, read_text

Option: TypeAlias = str | int | float | list[str]

DIRECTIONS: Mapping[str, Direction] = {metric.name: metric.direction for metric in (*METRICS, DIVERGED_SHARE)}


class Metric(Struct, frozen=True, kw_only=True):
    """The value of a metric, and how far it may change: at least one tolerance is stated."""

    value: float | None = None  # None: not yet known, set by --update
    abs: NotNegative | None = None
    rel: NotNegative | None = None
    direction: Direction | None = None

    @property
    def limit(self) -> float:
        """How far a new value may lie from the stored one."""
        return (self.abs or 0.0) + (self.rel or 0.0) * abs(self.value or 0.0)


@dataclass(frozen=True, slots=True)
class BaselineRow:
    """A run, or one for each of ``seeds`` seeds, and its expected metrics."""

    name: str
    log: str
    filter: str
    seeds: int
    options: Mapping[str, Option]  # by their names on the command line, with _ for -
    metrics: Mapping[str, Metric]
    log_sha256: str = ""  # of the log that the values are of; "" if not known


class _Stated(Struct, frozen=True, kw_only=True):
    """The keys of a row that are not options of a run."""

    name: Annotated[str, Meta(min_length=1)]
    log: str
    filter: str
    seeds: Annotated[int, Meta(ge=1)] = 1
    metrics: dict[str, object]
    log_sha256: str = ""


class _Document(Struct, frozen=True, kw_only=True):
    """A whole file; the keys of a row are not known in advance."""

    schema: Literal[1]
    tool: str = ""
    date: datetime.date | None = None
    row: tuple[dict[str, object], ...] = ()


@dataclass(frozen=True, slots=True)
class RegressionBaseline:
    """A baseline file: its rows, and its text, of which an update changes only the values."""

    file: Path
    text: str
    rows: tuple[BaselineRow, ...]
    tool: str = ""  # which version made the values; "" if not known
    date: datetime.date | None = None  # when


def usual_direction(metric: str) -> Direction:
    """Return which way a metric is better unless the file states it: as declared, else neither."""
    return DIRECTIONS.get(metric.removesuffix("_se").removesuffix("_seed_median"), "both")


def read_baseline(file: Path) -> RegressionBaseline:
    """Read and check a baseline; raise UsageError that names row and key."""
    if file.exists() and file.suffix != ".toml":
        raise UsageError(f"{file}: is no baseline, NAME.toml; usbldr baseline {file} writes a first one of a log")
    document = checked(read_document(file), _Document, file)
    stated = document.row
    if not stated:
        raise UsageError(f"{file}: has no [[row]]: such a check would always pass")
    rows = tuple(_row(file, number, row) for number, row in enumerate(stated, start=1))
    names = [row.name for row in rows]
    if repeated := [name for name in names if names.count(name) > 1]:
        raise UsageError(f"{file}: two rows are called {repeated[0]!r}: give each its own name")
    return RegressionBaseline(file, read_text(file), rows, document.tool, document.date)


def _row(file: Path, number: int, stated: Mapping[str, object]) -> BaselineRow:
    where = f"{file}: row {stated.get('name') or number!r}"
    known = checked({key: stated[key] for key in _Stated.__struct_fields__ if key in stated}, _Stated, where)
    options = {
        key: checked(value, cast("type[Option]", Option), where, key)
        for key, value in stated.items()
        if key not in _Stated.__struct_fields__
    }
    metrics = {key: checked(value, Metric, where, f"metrics.{key}") for key, value in known.metrics.items()}
    if not metrics:
        raise UsageError(f"{where}: metrics is empty: such a row would always pass")
    for key, metric in metrics.items():
        if metric.abs is None and metric.rel is None:
            raise UsageError(f"{where}: metrics.{key} states no tolerance: give abs, rel or both")
    return BaselineRow(known.name, known.log, known.filter, known.seeds, options, metrics, known.log_sha256)


def with_new_values(
    baseline: RegressionBaseline, values: Sequence[tuple[Mapping[str, float], str]], tool: str, date: datetime.date
) -> str:
    """Return the file's text with the new metrics of each row, and the digest of its log; all else is preserved.

    The digest is "" for a simulated log, whose last bits depend on the machine. ``tool`` and ``date`` say who made the
    values when; they stay as they were if no value changes.
    """
    document: Any = tomlkit.parse(baseline.text)
    for row, (metrics, log_sha256) in zip(document["row"], values, strict=True):
        if log_sha256:
            _set(row, "log_sha256", tomlkit.string(log_sha256), after="log")
        for name, value in metrics.items():
            metric, number = row["metrics"][name], f"{value:.6g}"
            if "value" in metric or not isinstance(metric, InlineTable):
                metric["value"] = tomlkit.value(number)
            else:  # a first value is inserted at the front
                row["metrics"][name] = tomlkit.value(f"{{ value = {number}, {metric.as_string().lstrip('{ ')}")
    text = tomlkit.dumps(document)
    if text == baseline.text:
        return text
    document = tomlkit.parse(text)
    _set(document, "tool", tomlkit.string(tool), after="schema")
    _set(document, "date", tomlkit.item(date), after="schema")
    return tomlkit.dumps(document)


def _set(table: Any, key: str, value: Any, after: str) -> None:
    """Set a key; a new one gets the line after another."""
    if key in table or isinstance(table, InlineTable):
        table[key] = value
    else:
        before = table[after].trivia
        before.trail = f"{before.trail.rstrip(' ') or chr(10)}{key} = {value.as_string()}\n"
