"""Everything that can be the user's affair: each fault is a sentence and knows the exit code of the command.

The sentence says which file or topic, what is wrong, and what to do.
"""

import difflib
from collections.abc import Iterable, Sequence
from pathlib import Path

MAX_SENTENCE = 2000  # [characters] of a sentence; longer ones are cut


def printable(text: str) -> str:
    """Return a text without control characters: each is spelt out, as \\x1b, so that none reaches a terminal."""
    if text.isprintable():
        return text
    return "".join(char if char.isprintable() else ascii(char)[1:-1] for char in text)


def sentence(text: str) -> str:
    """Return a sentence without control characters, its middle left out if it is endless."""
    text = printable(text)
    if len(text) <= MAX_SENTENCE:
        return text
    half = MAX_SENTENCE // 2
    return f"{text[:half]} ... ({len(text) - 2 * half} characters left out) ... {text[-half:]}"


def did_you_mean(name: str, known: Iterable[str], count: int = 1) -> str:
    """Return "; did you mean NAME?" with the known names closest to a misspelt one, "" if none is close."""
    lower = {one.lower(): one for one in known}
    near = difflib.get_close_matches(name.lower(), lower, n=count)
    return f"; did you mean {' or '.join(lower[one] for one in near)}?" if near else ""


def listed(names: Sequence[str], most: int) -> str:
    """Return names as text, of many the first ``most``."""
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more


class UsbldrError(Exception):
    """A fault reported in one sentence, without a traceback."""

    exit_code = 1

    def __init__(self, text: str, *, path: Path | str | None = None, topic: str = "") -> None:
        """Take the sentence, without the file or folder that it begins with, and the topic that is at fault."""
        self.text, self.path, self.topic = sentence(text), path, topic
        super().__init__(self.text)

    def __str__(self) -> str:
        """Return the sentence as a user gets it."""
        return self.text if self.path is None else f"{printable(str(self.path))}: {self.text}"

    def text_beside(self, path: Path) -> str:
        """Return the sentence for a place that has already named ``path``."""
        return self.text if self.path == path else str(self)


class CheckError(UsbldrError):
    """A check failed."""

    exit_code = 1


class UsageError(UsbldrError):
    """The options or the configuration ask for something that does not exist or does not fit together."""

    exit_code = 2


class SettingError(UsageError):
    """A key of the configuration does not fit the log; the sentence begins with the key, and lacks the file."""


class LogError(UsbldrError):
    """The log cannot be read, is incomplete, or lacks what was requested."""

    exit_code = 3


class StorageError(UsbldrError):
    """A file cannot be written, because the disk is full or broken."""

    exit_code = 3
