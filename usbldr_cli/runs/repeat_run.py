"""A run made again from its report: the same to the bit, or where it first differs.

The values are compared in the order in which a run makes them, so that the first difference names the cause: another
log, another configuration, other assumptions, another track, other errors. Rounding may differ between machines
(mathematical libraries, width of vectors), so numbers that agree within ROUNDING are reported as such.
"""

import json
import math
import tempfile
from collections.abc import Generator, Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias, cast

from usbldr.filters.errors import LogError, UsageError
from usbldr.io.reports.run_directory import REPORT
from usbldr.io.reports.run_provenance import SCHEMA
from usbldr_cli.options.run_options import RunChoices
from usbldr_cli.runs.one_run import RunPlan

if TYPE_CHECKING:
    from usbldr.io.reports.run import Run

Json: TypeAlias = Any
ROUNDING = 1e-9  # of a value: the kernel and NumPy agree within it, see tests/filters/estimators/test_compiled.py
STAGES = (
    *("log", "time_base", "origin", "configuration", "sensors", "findings", "outages", "truth"),
    *("assumptions", "track", "particles", "calibration", "undecided", "influential_fixes", "reacquisitions"),
    *("outage_recoveries", "window", "alignment", "matching", "metrics"),
)
"""The keys of report.json in the order in which a run makes them; the others follow."""
NOT_COMPARED = ("schema", "tool", "provenance", "request", "timing", "files")
DIGEST = "track.sha256"
MAX_SHOWN = 80  # [characters] of a value in a sentence


class Difference(NamedTuple):
    """One value of a report that another run does not have."""

    place: str  # "metrics.rmse_east_m"
    before: Json
    now: Json

    @property
    def rounding(self) -> bool:
        """Whether it is no more than rounding; of a digest, the numbers beside it decide."""
        if self.place == DIGEST:
            return True
        one, other = self.before, self.now
        numbers = all(isinstance(v, int | float) and not isinstance(v, bool) for v in (one, other))
        return numbers and math.isclose(one, other, rel_tol=ROUNDING, abs_tol=ROUNDING)


class Verification(NamedTuple):
    """A report beside the same run made now."""

    report: Path
    compared: int  # values
    differences: tuple[Difference, ...]  # in the order in which a run makes the values
    environment: tuple[Difference, ...]  # versions, platform, kernel, tool

    @property
    def passed(self) -> bool:
        """Whether nothing differs, or no more than rounding on another machine."""
        return not self.differences or (bool(self.environment) and all(one.rounding for one in self.differences))

    @property
    def verdict(self) -> str:
        """Return the result in a sentence."""
        if not self.differences:
            return f"{self.report}: bit-identical ({self.compared} values and the track)"
        worst = next((one for one in self.differences if not one.rounding), None)
        first = worst or next((one for one in self.differences if one.place != DIGEST), self.differences[0])
        where = f"in {first.place}: {_shown(first.before)} before, {_shown(first.now)} now"
        others = f"; {len(self.differences)} of {self.compared} values differ"
        if worst is None:
            return f"{self.report}: equal within {ROUNDING:g}, but not to the bit; first {where}{others}"
        return f"{self.report}: differs first {where}{others}"

    @property
    def environment_text(self) -> str:
        """Return what else has changed since the report; empty if nothing has."""
        changes = [f"{one.place} {_shown(one.before)}, now {_shown(one.now)}" for one in self.environment]
        return f"the report was made with {'; '.join(changes)}" if changes else ""


def _shown(value: Json) -> str:
    text = "nothing" if value is None else value if isinstance(value, str) else json.dumps(value)
    return text if len(text) <= MAX_SHOWN else f"{text[:MAX_SHOWN]}..."


def verify(report: Path, log: str | None) -> Verification:
    """Run again what a report or run directory says, on its log or another place of it, and compare every value.

    Raises UsageError for a report that replay did not write or whose log is not found.
    """
    from usbldr.io.reports.report_json import json_values, report_content
    from usbldr_cli.runs.one_run import run_again

    report = report / REPORT if report.is_dir() else report
    before = _read(report)
    plan = _plan(before, report, log)
    run = run_again(plan)
    now = json_values(report_content(run))
    keys = dict.fromkeys((*STAGES, *before, *now))
    found = [one for key in keys if key not in NOT_COMPARED for one in _differences(before.get(key), now.get(key), key)]
    same = ("tool", "python", "libraries", "platform", "kernel", "plugins")
    made, here = ({**one["provenance"], "tool": one["tool"]} for one in (before, now))
    changed = [one for key in same for one in _differences(made.get(key), here.get(key), key)]
    differing = [one for one in found if one.before != one.now]
    at = next((k for k, one in enumerate(differing) if one.place == DIGEST), None)
    if at is not None:
        differing[at:at] = _first_epoch(report.parent, before["files"], run)
    return Verification(report, len(found), tuple(differing), tuple(one for one in changed if one.before != one.now))


def _read(report: Path) -> dict[str, Json]:
    try:
        content: Json = json.loads(report.read_text(encoding="utf-8"))
        made = content["tool"]["name"] == "usbldr" and "filter" in content["request"]
        schema = content["schema"]
    except (OSError, ValueError, KeyError, TypeError) as err:
        raise UsageError(f"{report}: is no report.json of usbldr replay: name one for --verify") from err
    if not made:
        raise UsageError(f"{report}: was not written by usbldr replay, which --verify repeats")
    if schema != SCHEMA:
        raise UsageError(
            f"{report}: has schema {schema}, this version writes {SCHEMA}: verify it with {content['tool']}"
        )
    return content


def _plan(content: Mapping[str, Json], report: Path, log: str | None) -> RunPlan:
    """Return the plan of a report; its log is sought as given there, else beside the run directory."""
    from usbldr.io.session import is_simulated

    request = content["request"]
    options, selection = (_tuples(request[key]) for key in ("options", "selection"))
    unknown = set(options) - {field.name for field in fields(RunChoices)}
    if unknown:
        raise UsageError(f"{report}: options.{min(unknown)} is no option of this version")
    beside = report.resolve().parent.parent / Path(request["log"]).name
    places = [log] if log is not None else [request["log"], str(beside)]
    simulated = content["log"]["format"] == "simulated"
    place = next((one for one in places if Path(one).exists() or (simulated and is_simulated(one))), None)
    if place is None:
        raise LogError(f"{places[0]}: no such log; name it: usbldr replay LOG --verify {report}")
    more = {"leave_one_out": request["leave_one_out"], "bound": request["bound"]}
    return RunPlan(place, request["filter"], RunChoices(**options), selection, **more)


def _tuples(options: Mapping[str, Json]) -> dict[str, Json]:
    """Return options with tuples for lists, as the command line gives them."""
    return {name: tuple(cast("list[str]", v)) if isinstance(v, list) else v for name, v in options.items()}


def _differences(before: Json, now: Json, place: str) -> Generator[Difference]:
    """Give every value of both, in order, the same ones included."""
    if isinstance(before, dict) and isinstance(now, dict):
        ours, theirs = cast("dict[str, Json]", before), cast("dict[str, Json]", now)
        for key in dict.fromkeys((*ours, *theirs)):
            yield from _differences(ours.get(key), theirs.get(key), f"{place}.{key}")
    elif (
        isinstance(before, list)
        and isinstance(now, list)
        and len(cast("list[Json]", before)) == len(cast("list[Json]", now))
    ):
        for k, (one, other) in enumerate(zip(cast("list[Json]", before), cast("list[Json]", now), strict=True)):
            yield from _differences(one, other, f"{place}[{k}]")
    else:
        yield Difference(place, before, now)


def _first_epoch(folder: Path, files: Sequence[str], run: "Run") -> list[Difference]:
    """Return the first value of the track's CSV that differs, if the run directory has it and there is one."""
    from usbldr.io.reports.tracks import track_table, write_csv

    old = next((folder / name for name in files if name.startswith("track_") and name.endswith(".csv")), None)
    if old is None or not old.is_file():
        return []
    with tempfile.TemporaryDirectory(prefix="usbldr-verify-") as temporary:
        new = Path(temporary) / "track.csv"
        write_csv(new, track_table(run.scored.trajectory, None if run.log.map_unknown else run.log.origin))
        before, now = (file.read_text(encoding="utf-8").splitlines() for file in (old, new))
    names = now[0].split(",")
    for one, other in zip(before[1:], now[1:], strict=False):
        for name, *pair in zip(names, one.split(","), other.split(","), strict=False):
            if pair[0] != pair[1]:
                at = f"the track at {other.split(',')[0]} s, {name}"
                return [Difference(at, *(float(value) if value else None for value in pair))]
    return []
