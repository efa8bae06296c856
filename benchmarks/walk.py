"""Follow one USBL fix from the file to the report: through which files of the source it goes, and in which forms.

    python benchmarks/walk.py sample_logs/lawnmower.mcap 100

prints them in the order in which they first hold the fix. A function holds it if an argument or its result contains the
fix's east or north as a number, so that the log's fixes must be such numbers. The compiled kernel is not looked into.
"""

import sys
import types
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

import usbldr

SOURCE = Path(__file__).resolve().parents[1]
ROOMS = ("filters", "io", "usbldr_cli")
TOLERANCE = 1e-9  # of a number: it is copied, or rounded in the last digits
DEEPEST = 4  # containers within containers


class Walk:
    """The files and forms that hold a number, as a profiler of this thread sees them."""

    def __init__(self, numbers: tuple[float, ...]) -> None:
        self.numbers = numbers
        self.files: dict[str, str] = {}  # file -> its first function that held one of them
        self.forms: dict[str, str] = {}  # type -> where it first did

    def __call__(self, frame: types.FrameType, event: str, result: object) -> None:
        """Look at the arguments or the result of a function of the project."""
        code = frame.f_code
        file = Path(code.co_filename)
        if event not in ("call", "return") or not file.is_relative_to(SOURCE):
            return
        room = file.relative_to(SOURCE)
        if room.parts[0] not in ROOMS:
            return
        held = (
            [result]
            if event == "return"
            else [frame.f_locals.get(name) for name in code.co_varnames[: code.co_argcount]]
        )
        for one in filter(self._holds, held):
            self.files.setdefault(room.as_posix(), code.co_name)
            self.forms.setdefault(type(one).__qualname__, f"{room.as_posix()}: {code.co_name}")

    def _holds(self, value: object, depth: int = 0) -> bool:
        if isinstance(value, float | np.floating):
            return any(abs(value - number) < TOLERANCE * abs(number) for number in self.numbers)
        if isinstance(value, np.ndarray):
            return value.dtype.kind == "f" and any(
                bool(np.isclose(value, number, rtol=TOLERANCE, atol=0.0).any()) for number in self.numbers
            )
        return depth < DEEPEST and any(self._holds(part, depth + 1) for part in _parts(value))


def _parts(value: Any) -> Iterator[object]:
    if isinstance(value, pd.DataFrame):
        yield from (value[name].to_numpy() for name in value if value[name].dtype.kind == "f")
    elif isinstance(value, pd.Series):
        yield value.to_numpy()
    elif isinstance(value, dict):
        yield from value.values()
    elif isinstance(value, list | tuple):
        yield from value
    elif is_dataclass(value) and not isinstance(value, type):
        yield from (getattr(value, field.name, None) for field in fields(value))


def main(log_file: str, row: str) -> None:
    log = usbldr.open_log(log_file)
    fix = log.tables["usbl"].iloc[int(row)]
    walk = Walk((fix["east_m"], fix["north_m"]))
    sys.setprofile(walk)
    try:
        log = usbldr.open_log(log_file)
        line = usbldr.timeline(log)
        usbldr.evaluate(log, line, usbldr.replay(log, line))
    finally:
        sys.setprofile(None)
    for what, found in (("files", walk.files), ("forms", walk.forms)):
        print(f"{len(found)} {what}")
        for name, where in found.items():
            print(f"  {name}  ({where})")


if __name__ == "__main__":
    main(*sys.argv[1:])
