"""Files of other programs that no reader of records or tables reads, and what to do about them: foreign.toml."""

import re
import tomllib
from importlib.resources import files

_FOREIGN = tomllib.loads((files("usbldr.io.tables") / "foreign.toml").read_text(encoding="utf-8"))


def foreign_text(head: bytes) -> str:
    """Return what a text is that no reader reads, empty if it is none of these."""
    text = head.decode(errors="replace")
    return next((what for begin, what in _FOREIGN["text"].items() if re.match(begin, text, re.MULTILINE)), "")


def foreign_file(head: bytes) -> str:
    """Return what a file is that no reader reads, empty if it is none of these."""
    text = head.decode("latin-1")
    return next((what for begin, what in _FOREIGN["bytes"].items() if re.match(begin, text)), "") or foreign_text(head)
