"""A suite of drills as TOML: each has a name and a list of faults, and may say which filters are for it.

[[drill]]
name = "outage with false fixes after it"
faults = ["drop usbl@200:320", "cluster usbl:32m@320:380"]
"""

from pathlib import Path
from typing import Literal

from usbldr.filters.errors import UsageError, did_you_mean
from usbldr.io.drills.drill import UNDAMAGED, Drill
from usbldr.io.drills.fault_text import Fault, fault_of
from usbldr.io.settings.noise_sections import Section
from usbldr.io.settings.validation import checked, read_document

FOLDER = Path(__file__).parent
STANDARD = "standard"  # the suite that is shipped


class DrillSection(Section, frozen=True, kw_only=True):
    """One drill: faults that happen together."""

    name: str
    faults: tuple[str, ...]


class SuiteFile(Section, frozen=True, kw_only=True):
    """A whole suite."""

    drill: tuple[DrillSection, ...]
    schema: Literal[1] = 1


def read_suite(file: str) -> tuple[Drill, ...]:
    """Return the drills of a suite, a file or STANDARD; raise UsageError that names the key that is wrong."""
    path = FOLDER / f"{STANDARD}.toml" if file == STANDARD else Path(file)
    if not path.exists():
        raise UsageError(f"there is no suite {file}{did_you_mean(file, [STANDARD])} (a file NAME.toml, or {STANDARD})")
    stated = checked(read_document(path), SuiteFile, file)
    drills = tuple(Drill(one.name, tuple(_fault(file, one.name, text) for text in one.faults)) for one in stated.drill)
    refuse_repeats(file, [UNDAMAGED.name, *(drill.name for drill in drills)])
    if empty := [drill.name for drill in drills if not drill.faults]:
        raise UsageError(f"{file}: the drill {empty[0]!r} has no faults")
    return drills


def refuse_repeats(where: str, names: list[str]) -> None:
    """Raise UsageError if two drills have the same name."""
    if repeated := [name for k, name in enumerate(names) if name in names[:k]]:
        raise UsageError(f"{where}: two drills are called {repeated[0]!r}")


def _fault(file: str, drill: str, text: str) -> Fault:
    kind, _, rest = text.strip().partition(" ")
    try:
        return fault_of(kind, rest.strip())
    except UsageError as err:
        raise UsageError(f"{file}: drill {drill!r}: {err}") from err
