"""The options that put faults into a log: one for each kind, and suites of drills."""

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

from usbldr.filters.errors import UsageError
from usbldr.io.drills.kinds import KINDS
from usbldr_cli.options.completion import words
from usbldr_cli.options.option import fault_option

if TYPE_CHECKING:
    from usbldr.io.drills.drill import Drill

USUAL = ("bias", "spike", "outlier", "drop", "latency")  # the faults of any dive; --help-all lists every kind


def fault_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add --suite, and one option for each kind of fault; the command gets them under the names of the kinds."""
    for kind in reversed(list(KINDS)):
        declared = KINDS[kind]
        help_text = f"{declared.meaning}  [{declared.example}]"
        rare = kind not in USUAL
        command = fault_option(f"--{kind}", multiple=True, metavar="FAULT", help=help_text, rare=rare)(command)
    help_text = 'Drills of a TOML file; "standard" is the suite that is shipped.  [default without faults: standard]'
    return fault_option("--suite", type=words("standard", files=True), metavar="FILE", help=help_text)(command)


def chosen_drills(suite: str | None, given: Mapping[str, tuple[str, ...]]) -> "tuple[Drill, ...]":
    """Return the drills of the suite and one of the faults of the options, which happen together."""
    from usbldr.io.drills.drill import Drill
    from usbldr.io.drills.fault_text import fault_of
    from usbldr.io.drills.suite import STANDARD, read_suite

    faults: list[Any] = []
    for kind, texts in given.items():
        for text in texts:
            try:
                faults.append(fault_of(kind, text))
            except UsageError as err:
                raise UsageError(f"--{err}") from err
    own = (Drill(", ".join(fault.text for fault in faults), tuple(faults)),) if faults else ()
    named = read_suite(suite or STANDARD) if suite is not None or not faults else ()
    return (*own, *named)
