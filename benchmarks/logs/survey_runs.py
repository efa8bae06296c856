"""What info, doctor, init and replay say of a log: each is a process of its own, in an empty folder, and heard out.

Of a log that is held back no error against GPS is kept, let alone shown, unless it is asked for.
"""

import os
import re
import subprocess
import sys
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

from field.logs import CASES, HERE
from usbldr_cli.runs.jobs import THREADS

CALL = "from usbldr_cli.main import main; main()"
FINDING = re.compile(r"^(error|warning|info) +([A-Z][A-Z-]+): (.*)$", re.MULTILINE)
TOLD = re.compile(r" \[([A-Z][A-Z-]+)\]$", re.MULTILINE)
SECTION = re.compile(r"^\[(\w+)\]", re.MULTILINE)
STATED = HERE
NOT_OURS = "stpere_marina"  # whose configuration is tried on logs that it was not written for
ZOO = "reader_zoo"
OTHER = "*.PD0", "original", "csv"  # what lies beside the logs


class Surveyed(NamedTuple):
    """A log, and the configuration that was written for it by hand."""

    name: str  # its path in the folder of logs
    configuration: str = ""
    held_back: bool = False


class Said(NamedTuple):
    """What a command said."""

    command: str
    settings: str  # "", "stated" by hand, "another log's", or "init's"
    code: int
    out: str
    err: str

    @property
    def fault(self) -> str:
        """The sentence that it ended with, "" if it did not: what comes with a good run are warnings."""
        if self.code == 0:
            return ""
        lines = [line for line in self.err.splitlines() if line.startswith("usbldr: ") and not TOLD.search(line)]
        return lines[-1].removeprefix("usbldr: ") if lines else ""

    @property
    def broke(self) -> bool:
        """Whether a fault of the program came to light."""
        return "Traceback" in self.err or self.code not in (0, 1, 2, 3)

    @property
    def findings(self) -> tuple[tuple[str, str, str], ...]:
        """Level, code and text of what doctor found."""
        return tuple((found[1], found[2], found[3]) for found in FINDING.finditer(self.out))


def field_logs() -> tuple[Surveyed, ...]:
    """Return the logs of vehicles, uib_field in each of its formats."""
    first = [
        Surveyed(f"{case.folder}/{case.name}.mcap", case.name, case.held_back) for case in CASES.values() if case.folder
    ]
    forms = [Surveyed(f"uib_field/{name}", "uib_field") for name in ("uib_field.bag", "uib_field_db3", "csv")]
    return (first[0], *forms, *first[1:])


def other_files(folder: Path) -> tuple[Surveyed, ...]:
    """Return the odd files of others, and what lies beside the logs in forms that usbldr does not claim to read."""
    zoo = sorted(path for path in (folder / ZOO).iterdir() if path.name[0].isdigit())
    beside = sorted(path for kind in OTHER for path in folder.glob(f"*/{kind}"))
    known = {log.name for log in field_logs()}
    names = [str(path.relative_to(folder)) for path in (*zoo, *beside)]
    return tuple(Surveyed(name, held_back=name.startswith("mhkit")) for name in names if name not in known)


def survey(
    logs: tuple[Surveyed, ...], folder: Path, scratch: Path, jobs: int, held_back: bool
) -> Mapping[Surveyed, tuple[Said, ...]]:
    """Hear every command on every log."""
    with ThreadPoolExecutor(jobs) as pool:
        heard = pool.map(lambda log: tuple(commands(log, folder, scratch, held_back or not log.held_back)), logs)
        return dict(zip(logs, heard, strict=True))


def commands(log: Surveyed, folder: Path, scratch: Path, shown: bool) -> Iterator[Said]:
    """Hear every command on one log: with no configuration, with one, and replay with the one that init wrote."""
    place = scratch / log.name.replace("/", "-")
    place.mkdir()
    path, found = str(folder / log.name), place / "found.toml"

    def hear(command: str, settings: str, *options: str) -> Said:
        done = subprocess.run(
            [sys.executable, "-c", CALL, command, path, *options],
            capture_output=True,
            text=True,
            cwd=place,
            env={**os.environ, **dict.fromkeys(THREADS, "1")},
        )
        kept = shown or command != "replay"
        clean = [text.replace(f"{folder}/", "").replace(f"{place}/", "") for text in (done.stdout, done.stderr)]
        return Said(command, settings, done.returncode, clean[0] if kept else "", clean[1].replace(f"{STATED}/", ""))

    def replay(settings: str, configuration: str) -> Said:
        options = ("--filter", "adf", "--quiet", "--force", "--output", str(place / "run"))
        return hear("replay", settings, "--config", configuration, *options)

    yield hear("info", "", "--config", "none")
    yield hear("doctor", "", "--config", "none")
    wrote = hear("init", "", "--output", str(found))
    yield wrote._replace(out=found.read_text(encoding="utf-8") if found.exists() else "")
    yield replay("", "none")
    if found.exists() and log.configuration:
        yield replay("init's", str(found))
    if not log.configuration:
        yield replay("another log's", str(STATED / f"{NOT_OURS}.toml"))
        return
    stated = str(STATED / f"{log.configuration}.toml")
    yield hear("info", "stated", "--config", stated)
    yield hear("doctor", "stated", "--config", stated)
    yield replay("stated", stated)
