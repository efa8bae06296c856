"""The result of a run, and the folder that stores results: a JSON file per job, and its errors over time beside it.

Metres and seconds, east and north, as everywhere.
"""

import io
import json
import math
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import msgspec

from usbldr.filters.errors import LogError, UsageError, UsbldrError
from usbldr.io.reports.run_directory import json_text, write_atomically

if TYPE_CHECKING:
    from usbldr.filters.evaluation.error_report import Window
    from usbldr.filters.types import Array, Vector

SCHEMA = 4  # fixed: the version of stored runs


@dataclass(frozen=True, slots=True)
class ScoringContext:
    """What every number depends on: the log, the truth, and how it was scored."""

    log: str
    log_format: str
    log_sha256: str
    configuration: str  # name of the file, "" for none
    truth_kind: str
    truth_source: str
    window_start_s: float | None  # None: from the start
    window_end_s: float | None
    align: str
    aid: tuple[tuple[float, float], ...] = ()  # windows in which GPS aided the filters and nothing is scored
    order: str = "validity"  # of late fixes
    lost: tuple[str, ...] = ()  # sentences on parts of the log that could not be read

    @property
    def window(self) -> "Window":
        """The window that was scored."""
        from usbldr.filters.evaluation.error_report import Window

        first_s, last_s = self.window_start_s, self.window_end_s
        return Window(-math.inf if first_s is None else first_s, math.inf if last_s is None else last_s)


@dataclass(frozen=True, slots=True)
class JobResult:
    """The result of one job: its metrics, or the sentence that says why there are none."""

    metrics: Mapping[str, float] = field(default_factory=dict[str, float])  # by their names in report.json; finite
    warnings: tuple[str, ...] = ()
    fault: str | None = None
    exit_code: int = 0  # of the fault
    scored_against: ScoringContext | None = None  # None if there is a fault
    trace: Path | None = None  # path for read_trace
    reused: bool = False  # taken from the store
    findings: tuple[str, ...] = ()  # codes, of a job that examines a log
    filter_time_s: float | None = None  # wall time: of the machine, so it is no metric


def common_fault(sentences: Iterable[str | None], exit_code: int) -> UsbldrError:
    """Return one error for runs that all failed: their sentences, each once, and the exit code of the worst."""
    kind = {UsageError.exit_code: UsageError, LogError.exit_code: LogError}.get(exit_code, UsbldrError)
    return kind("; ".join(dict.fromkeys(map(str, sentences))))


class Trace(NamedTuple):
    """M scored epochs of a run."""

    time_s: "Vector"  # (M,)
    estimate_m: "Array"  # (M, 2) east, north
    truth_m: "Array"  # (M, 2)
    cov_m2: "Array | None" = None  # (M, 2, 2) of the estimate; None if it has none, or for a run directory

    @property
    def error_m(self) -> "Array":
        """Estimate minus truth, (M, 2)."""
        return self.estimate_m - self.truth_m

    @property
    def horizontal_m(self) -> "Vector":
        """Length of the error, (M,)."""
        import numpy as np

        return np.hypot(*self.error_m.T)


def stored_results(folder: Path) -> dict[str, JobResult]:
    """Return the results in a folder that can be read, by the keys of their jobs.

    A job is finished when its JSON exists, which is written last.
    """
    found: dict[str, JobResult] = {}
    for file in sorted(folder.glob("*.json")):
        trace = file.with_suffix(".npz")
        with suppress(OSError, ValueError, KeyError, TypeError):
            content: Any = json.loads(file.read_text(encoding="utf-8"))
            if content["schema"] == SCHEMA and trace.is_file():
                found[file.stem] = replace(msgspec.convert(content["result"], JobResult), trace=trace, reused=True)
    return found


def store_result(folder: Path, key: str, outcome: JobResult, trace: Trace | None) -> JobResult:
    """Store a result and its trace; return the result with the path of the trace."""
    import numpy as np

    place = folder / f"{key}.npz"
    if trace is not None:
        packed = io.BytesIO()
        np.savez_compressed(packed, **{name: part for name, part in trace._asdict().items() if part is not None})
        write_atomically(place, packed.getvalue())
    content = {"schema": SCHEMA, "result": asdict(replace(outcome, trace=None))}
    write_atomically(place.with_suffix(".json"), (json_text(content) + "\n").encode())
    return replace(outcome, trace=place if trace is not None else None)


def read_trace(path: Path) -> Trace:
    """Read the epochs of a stored run: a .npz of the store, or a run directory with its two TUM files."""
    import numpy as np

    if path.is_dir():
        estimate, truth = (np.loadtxt(path / f"{name}.tum", ndmin=2) for name in ("track", "truth"))
        start_s = json.loads((path / "report.json").read_text(encoding="utf-8"))["time_base"]["start_ns"] / 1e9
        return Trace(truth[:, 0] - start_s, estimate[:, 1:3], truth[:, 1:3])

    with np.load(path) as packed:
        return Trace(**{name: packed[name] for name in packed.files})
