"""The baseline of a regression check: a TOML file of runs with the metrics that they had, and how far they may move.

Each ``[[row]]`` names a run: name, log (relative to the file's folder, or a scenario), filter, seeds, any long option
of ``usbldr replay`` (``dr_from`` for --dr-from), and a table ``metrics`` by their names in report.json. Each metric has
a value, a tolerance (limit = abs + rel |value|) and, where the usual one is not meant, a direction.
"""

import math
import re
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, TypeAlias, cast

import msgspec
from msgspec import Meta, Struct

from usbldr.filters.errors import UsageError

Direction: TypeAlias = Literal["lower", "higher", "both"]  # which way is better; both: neither is
Option: TypeAlias = str | int | float | list[str]
NotNegative: TypeAlias = Annotated[float, Meta(ge=0)]

ERROR = re.compile(r"(rmse|mean|median|std|min|p95|max|final|surfacing_error)_.*m$|surfacing_percent|drift_percent")
LOWER = ("diverged_share", "filter_time_s")
HIGHER = ("real_time_factor", "coverage")
KNOWN = ("name", "log", "filter", "seeds", "metrics")


class Metric(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What a metric was, and how far it may move: at least one tolerance is stated."""

    value: float | None = None  # None: not yet known, --update fills it in
    abs: NotNegative | None = None
    rel: NotNegative | None = None
    direction: Direction | None = None

    @property
    def limit(self) -> float:
        """How far a new value may lie from the stored one."""
        return (self.abs or 0.0) + (self.rel or 0.0) * abs(self.value or 0.0)


@dataclass(frozen=True, slots=True)
class BaselineRow:
    """A run, or one for each of ``seeds`` seeds, and what it has to give."""

    name: str
    log: str
    filter: str
    seeds: int
    options: Mapping[str, Option]  # by their names on the command line, with _ for -
    metrics: Mapping[str, Metric]


class _Stated(Struct, frozen=True, kw_only=True):
    """The keys of a row that are no option of a run."""

    log: str
    filter: str
    seeds: Annotated[int, Meta(ge=1)] = 1
    metrics: dict[str, object]


@dataclass(frozen=True, slots=True)
class RegressionBaseline:
    """A baseline file: its rows, and its text, which an update keeps but for the values."""

    file: Path
    text: str
    rows: tuple[BaselineRow, ...]


def usual_direction(metric: str) -> Direction:
    """Return which way a metric is better where the file does not say: errors lower, consistency neither."""
    plain = re.sub(r"_(se|seed_median)$", "", metric)
    if plain in LOWER or ERROR.match(plain):
        return "lower"
    return "higher" if plain in HIGHER else "both"


def read_baseline(file: Path) -> RegressionBaseline:
    """Read and check a baseline; raise UsageError that names row and key."""
    try:
        text = file.read_text(encoding="utf-8")
        document = tomllib.loads(text)
    except OSError as err:
        raise UsageError(f"{file}: cannot be read ({err.strerror})") from err
    except (UnicodeDecodeError, tomllib.TOMLDecodeError) as err:
        raise UsageError(f"{file}: is not TOML ({err})") from err
    if foreign := sorted(set(document) - {"schema", "row"}):
        raise UsageError(f"{file}: there is no section {foreign[0]} (allowed: schema, row)")
    if document.get("schema") != 1:
        raise UsageError(f"{file}: schema = {document.get('schema')!r} is not known; this usbldr reads schema = 1")
    stated = document.get("row")
    if not isinstance(stated, list) or not stated:
        raise UsageError(f"{file}: has no [[row]]: a check of nothing would always pass")
    rows = tuple(_row(file, number, row) for number, row in enumerate(cast("list[Any]", stated), start=1))
    names = [row.name for row in rows]
    if repeated := [name for name in names if names.count(name) > 1]:
        raise UsageError(f"{file}: two rows are called {repeated[0]!r}: give each its own name")
    return RegressionBaseline(file, text, rows)


def _row(file: Path, number: int, stated: Any) -> BaselineRow:
    if not isinstance(stated, dict):
        raise UsageError(f"{file}: row {number}: expected a table; write [[row]]")
    table = cast("dict[str, Any]", stated)
    name = table.get("name")
    if not isinstance(name, str) or not name.strip():
        raise UsageError(f"{file}: row {number}: name is missing or no text")
    where = f"{file}: row {name!r}"
    known = _typed({key: table[key] for key in KNOWN if key in table}, _Stated, where, "")
    options = {key: _typed(value, Option, where, key) for key, value in table.items() if key not in KNOWN}
    metrics = {key: _typed(value, Metric, where, f"metrics.{key}") for key, value in known.metrics.items()}
    if not metrics:
        raise UsageError(f"{where}: metrics is empty: a row that compares nothing would always pass")
    for key, metric in metrics.items():
        if metric.abs is None and metric.rel is None:
            raise UsageError(f"{where}: metrics.{key} states no tolerance: give abs, rel or both")
        if not all(math.isfinite(number) for number in (metric.value, metric.abs, metric.rel) if number is not None):
            raise UsageError(f"{where}: metrics.{key} has a number that is not finite")
    return BaselineRow(name, known.log, known.filter, known.seeds, options, metrics)


def _typed(value: object, kind: Any, where: str, key: str) -> Any:
    """Return a value of the file as what it has to be; ``key`` leads to it."""
    try:
        return msgspec.convert(value, kind)
    except msgspec.ValidationError as err:
        raise UsageError(f"{where}: {_sentence(str(err), key)}") from err


def _sentence(message: str, key: str) -> str:
    """Turn msgspec's "Expected `float`, got `str` - at `$.abs`" below a key into words, the whole key first."""
    what, _, place = message.partition(" - at ")
    key = f"{key}{place.strip('`').removeprefix('$')}".removeprefix(".")
    what = what.replace("`", "").replace("Object contains unknown field", "there is no key")
    what = what.replace("Object missing required field", "lacks the key")
    what = re.sub(r"\b(float|int)\b", "number", re.sub(r" \| null", "", what)).replace("str", "text")
    what = what[:1].lower() + what[1:]
    return f"{key}: {what}" if key else what


def with_new_values(baseline: RegressionBaseline, values: Sequence[Mapping[str, float]]) -> str:
    """Return the file's text with new values, ``values`` by row and metric; comments, order and tolerances stay.

    Raises UsageError where the text is laid out in a way that cannot be followed line by line.
    """
    found, row, table = list[str](), -1, ""
    for line in baseline.text.splitlines(keepends=True):
        if header := re.match(r"\s*\[\[?\s*([^\]]+?)\s*\]", line):
            table = header[1].replace('"', "")
            row += line.lstrip().startswith("[[") and table == "row"
        elif row >= 0 and (assigned := re.match(r'\s*([\w."-]+)\s*=\s*', line)):
            path = f"{table}.{assigned[1]}".replace('"', "").removesuffix(".value").removeprefix("row.metrics.")
            if path in values[row]:
                line = _with_value(line, assigned.end(), f"{values[row][path]:.6g}")
        found.append(line)
    text = "".join(found)
    _require_values(baseline, text, values)
    return text


def _with_value(line: str, start: int, value: str) -> str:
    """Put the value of one line, a number or an inline table behind ``start``."""
    head, rest = line[:start], line[start:]
    if not rest.startswith("{"):
        return head + re.sub(r"^[\w.+-]+", value, rest, count=1)
    if re.search(r"\bvalue\s*=", rest):
        return head + re.sub(r"(\bvalue\s*=\s*)[\w.+-]+", rf"\g<1>{value}", rest, count=1)
    return f"{head}{{ value = {value}, {rest[1:].lstrip()}"


def _require_values(baseline: RegressionBaseline, text: str, values: Sequence[Mapping[str, float]]) -> None:
    """Refuse a text that does not say exactly what it should: the old document with the new values."""
    wanted = tomllib.loads(baseline.text)
    for stated, new in zip(wanted["row"], values, strict=True):
        for metric, value in new.items():
            stated["metrics"][metric]["value"] = float(f"{value:.6g}")
    try:
        same = tomllib.loads(text) == wanted
    except tomllib.TOMLDecodeError:
        same = False
    if not same:
        raise UsageError(
            f"{baseline.file}: cannot be updated line by line: "
            "write each metric on a line of its own below [row.metrics], as NAME = { value = ..., rel = ... }"
        )
