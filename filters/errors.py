"""Everything that can be the user's affair: each fault is a sentence and knows the exit code of the command.

The sentence says which file or topic, what is wrong, and what to do.
"""


class UsbldrError(Exception):
    """A fault that the user is told in one sentence, without a traceback."""

    exit_code = 1


class CheckError(UsbldrError):
    """A check was made and failed."""

    exit_code = 1


class UsageError(UsbldrError):
    """The options or the configuration ask for something that does not exist or does not fit together."""

    exit_code = 2


class SettingError(UsageError):
    """A key of the configuration does not fit the log; the sentence begins with the key, and lacks the file."""


class LogError(UsbldrError):
    """The log can't be read, is incomplete, or lacks what was asked of it."""

    exit_code = 3
