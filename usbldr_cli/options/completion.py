"""What a shell suggests for the value of an option or argument: files, topics of the log, filters, scenarios, words.

Click asks the type of a parameter (``shell_complete``); values are not checked here.
"""

import os
import signal
from collections.abc import Callable, Generator, Iterable
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import click
from click.shell_completion import BashComplete, CompletionItem, add_completion_class

PATIENCE_S = 2.0  # [s] to list the topics of a log: longer than an index takes, shorter than a user waits

Words = Callable[[click.Context], Iterable[str]]


class Suggested(click.ParamType):  # pyright: ignore[reportMissingTypeArgument] - click 8.1 has none
    """A text for which there are suggestions: words, names of files, or both, one kind at a time."""

    name = "text"

    def __init__(
        self, words: Words = lambda ctx: (), files: bool = False, words_first: bool = False, several: bool = False
    ) -> None:
        """Take a function that returns the words; ``several`` words stand between commas.

        Where both words and files begin like the text, files are suggested, unless ``words_first``.
        """
        self.words, self.files, self.words_first, self.several = words, files, words_first, several

    def shell_complete(self, ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem[Any]]:
        """Return the suggestions for the beginning of a value."""
        before, comma, last = incomplete.rpartition(",") if self.several else ("", "", incomplete)
        file = [CompletionItem(incomplete, type="file")] if self.files else []  # the shell itself completes its name
        if file and not self.words_first and _begins_a_file(incomplete):
            return file
        return [CompletionItem(before + comma + word) for word in self.words(ctx) if word.startswith(last)] or file


class Bash(BashComplete):
    """Bash hands "--filter=ek" over as three words."""

    def get_completion_args(self) -> tuple[list[str], str]:
        """Return the words before the incomplete one, and that one."""
        words, incomplete = super().get_completion_args()
        return [word for word in words if word != "="], incomplete


def register() -> None:
    """Let click use the classes of this file."""
    add_completion_class(Bash)


def words(*known: str, files: bool = False) -> Suggested:
    """Return the type of a value that is often one of these words."""
    return Suggested(lambda ctx: known, files)


def filters(ctx: click.Context) -> Iterable[str]:
    """Return the names of the methods."""
    from usbldr.filters.replay.methods import METHODS, add_installed

    add_installed()
    return METHODS


def sensor_errors(ctx: click.Context) -> Iterable[str]:
    """Return the words of --calibrate."""
    from usbldr.filters.models.calibration import AUTO, STATES

    return (AUTO, "none", *STATES)


def places(ctx: click.Context) -> Iterable[str]:
    """Return the words of --dr-from."""
    from usbldr.io.session import ANCHORS

    return ANCHORS


def scenarios(ctx: click.Context) -> Iterable[str]:
    """Return the names of the scenarios, which are logs."""
    from usbldr.io.scenarios.shipped import scenario_names

    return scenario_names()


def topics(role: str | None = None, also: Iterable[str] = ("none",)) -> Words:
    """Return what lists the topics of the log of the command line: those that may be the role, if there are any."""

    def listed(ctx: click.Context) -> list[str]:
        log = next(iter((*ctx.args, ctx.params.get("log"), *(ctx.params.get("logs") or ()))), None)
        if log is None:
            return []
        found: list[str] = []
        with suppress(Exception), _patience():  # whatever is wrong with the log, the command itself will say
            from usbldr.io.formats.detect import open_reader
            from usbldr.io.messages.registry import message_layout_of

            known = open_reader(Path(log).expanduser()).topics()
            found = [topic.name for topic in known if role is not None and message_layout_of(role, topic) is not None]
            found = found or [topic.name for topic in known]
        return [*found, *also]

    return listed


def _begins_a_file(text: str) -> bool:
    folder, name = os.path.split(os.path.expanduser(text))
    try:
        return any(entry.startswith(name) for entry in os.listdir(folder or "."))
    except OSError:
        return False


@contextmanager
def _patience() -> Generator[None]:
    """Raise TimeoutError in the block after PATIENCE_S; without timers (Windows) never."""
    if not hasattr(signal, "setitimer"):
        yield
        return

    def give_up(*_: object) -> None:
        raise TimeoutError

    before = signal.signal(signal.SIGALRM, give_up)
    signal.setitimer(signal.ITIMER_REAL, PATIENCE_S)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


FILE = Suggested(files=True)
LOG = Suggested(scenarios, files=True)
TRUTH = Suggested(topics(), files=True, words_first=True)
ESTIMATE = Suggested(topics(also=()), files=True, words_first=True)
FILTER = Suggested(filters)
FILTERS = Suggested(filters, several=True)
