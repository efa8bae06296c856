"""A log as its own records show it."""

from usbldr.io.conventions.implausible import without_implausible
from usbldr.io.conventions.shown_noise import with_shown_noise
from usbldr.io.log import Log


def examined(log: Log) -> Log:
    """Return the log without records that cannot be measurements, and with sigmas as large as the others scatter."""
    return with_shown_noise(without_implausible(log))
