"""What is being done, as records of the standard library's logging: stages with their time, choices with their reason.

The logger is "usbldr", the level INFO; `usbldr --verbose` prints the records, and `--progress json` those of stages.
"""

import logging
import time
from collections.abc import Generator
from contextlib import contextmanager

LOGGER = logging.getLogger("usbldr")


def say(*texts: str) -> None:
    """Record what was chosen and why, a sentence each."""
    for text in texts:
        LOGGER.info("%s", text)


@contextmanager
def stage(name: str) -> Generator[None]:
    """Record the beginning of a stage, and after the block its end and wall time; also a decorator."""
    LOGGER.info("%s", name, extra={"stage": name, "state": "begin"})
    began_s = time.perf_counter()
    yield
    seconds = time.perf_counter() - began_s
    LOGGER.info("%s: %.2f s", name, seconds, extra={"stage": name, "state": "end", "seconds": round(seconds, 3)})
