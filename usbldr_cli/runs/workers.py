"""What runs and those who make them share: the run, and the interface of an executor."""

from collections.abc import Callable, Generator, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol, TypeVar

from usbldr.io.drills.drill import UNDAMAGED, Drill
from usbldr_cli.options.run_options import RunChoices

Task = TypeVar("Task")
Shared = TypeVar("Shared")
Result = TypeVar("Result")

KEPT = "with --output, finished runs are kept"


@dataclass(frozen=True, slots=True)
class Job:
    """One run. The seed in ``choices`` is that of the filter and, for a scenario, of the dive."""

    log: str  # as the user gave it: a file, a folder, or else a scenario
    method: str
    choices: RunChoices
    selection: Mapping[str, Any] = field(default_factory=dict[str, Any])  # values of options.selection_options
    bound: bool = False  # compute the least error of a filter that estimates the same states, and run nothing
    drill: Drill = UNDAMAGED  # faults that are put into the log, by the same seed
    examine: bool = False  # list the findings of the doctor, and run nothing

    @property
    def simulated(self) -> bool:
        """Whether each seed is a dive of its own."""
        from usbldr.io.session import is_simulated

        return is_simulated(self.log)


class Executor(Protocol):
    """Where work is done."""

    @property
    def elsewhere(self) -> bool:
        """Whether the workers may have other files and other code than this process."""
        ...

    @property
    def workers(self) -> int:
        """How many tasks run at once."""
        ...

    def finished(
        self, call: Callable[[Task, Shared], Result], tasks: Iterable[Task], shared: Shared
    ) -> Generator[tuple[int, Result]]:
        """Yield the place of each task and ``call(task, shared)`` as they finish; ``shared`` is sent once.

        ``call`` is a function of a module that the workers can import. Raises UsbldrError if workers are lost again
        and again, and whatever ``call`` raises.
        """
        ...
