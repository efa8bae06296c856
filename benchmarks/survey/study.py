"""Print what info, doctor, init and replay say of every log at hand, and our numbers beside those of its collectors.

    python benchmarks/survey/study.py

The words of two versions of usbldr can be compared by `diff`: they hold no path of the machine. The exit code is 1 if a
command broke, if `doctor` missed what is known of a log, or if a number of an expected.json is not met.
"""

import argparse
import os
import re
import subprocess
import sys
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # paper, field and survey are packages

from field.logs import CASES, HERE, field_folder
from survey.expected import EXPLAINED, Number, compared, expected
from survey.measured import measured
from usbldr.filters.errors import UsbldrError
from usbldr_cli.runs.jobs import THREADS

CALL = "from usbldr_cli.main import main; main()"
FINDING = re.compile(r"^(?:error|warning|info) +([A-Z][A-Z-]+): ", re.MULTILINE)
OTHERS = "stpere_marina"  # whose configuration is tried on files that are no dives
ODD = ("reader_zoo/[0-9]*", "*/*.PD0", "*/original", "*/csv")  # odd files of others, and what is beside the logs
OF_UIB = "REPEATED MAP-FRAME HEADING-CONVENTION DVL-MOUNT USBL-DELAYED USBL-LATENCY USBL-OUTLIERS"
KNOWN: Mapping[str, str] = {  # what doctor has to find
    "doctor uib_field/uib_field.mcap --config none": OF_UIB,
    "doctor stpere_marina/stpere_marina.mcap --config none": "DVL-INVALID DVL-MOUNT",
    "doctor stpere_marina/stpere_marina.mcap --config stpere_marina.toml": "HEADING-BIAS",
    "doctor mhkit_tanana/tanana_002.mcap --config none": "LOST-LOCK",
    "doctor mhkit_tanana/tanana_003.mcap --config none": "LOST-LOCK",
}


class Surveyed(NamedTuple):
    """A log by its path in the folder of logs, and the configuration that it is read by."""

    name: str
    configuration: str
    held_back: bool = False


class CommandOutput(NamedTuple):
    """What a command output."""

    command: str
    code: int
    words: str

    @property
    def broke(self) -> bool:
        """Whether a fault of the program came to light."""
        return "Traceback" in self.words or self.code not in (0, 1, 2, 3)

    @property
    def missed(self) -> list[str]:
        """The codes that doctor should have come to and did not."""
        return sorted({*KNOWN.get(self.command, "").split()} - {*FINDING.findall(self.words)})


def surveyed(folder: Path) -> list[Surveyed]:
    """Return the logs of vehicles, `uib_field` in each of its formats, and every file that is no dive."""
    logs = [Surveyed(f"{c.folder}/{c.name}.mcap", c.name, c.held_back) for c in CASES.values() if c.folder]
    logs += [Surveyed(f"uib_field/{name}", "uib_field") for name in ("uib_field.bag", "uib_field_db3", "csv")]
    known = {log.name for log in logs}
    odd = sorted({str(path.relative_to(folder)) for kind in ODD for path in folder.glob(kind)} - known)
    return logs + [Surveyed(name, OTHERS, name.startswith("mhkit")) for name in odd]


def commands(log: Surveyed, folder: Path, scratch: Path, replayed: bool) -> Iterator[CommandOutput]:
    """Run every command on one log: without a configuration, with one, and replay with the one that init wrote."""
    place = scratch / log.name.replace("/", "-")
    place.mkdir()
    written, stated = place / "init.toml", str(HERE / f"{log.configuration}.toml")

    def execute(command: str, *options: str) -> CommandOutput:
        words = (command, str(folder / log.name), *options)
        quiet = ("--filter", "adf", "--quiet", "--output", str(place / "run"), "--force") if command == "replay" else ()
        done = subprocess.run(
            [sys.executable, "-c", CALL, *words, *quiet],
            capture_output=True,
            text=True,
            cwd=place,
            env={**os.environ, **dict.fromkeys(THREADS, "1")},
        )
        texts = (" ".join(words), done.stdout + done.stderr)
        for path in (folder, place, HERE):
            texts = tuple(text.replace(f"{path}/", "") for text in texts)
        return CommandOutput(texts[0], done.returncode, texts[1])

    for configuration in ("none", stated):
        yield execute("info", "--config", configuration)
        yield execute("doctor", "--config", configuration)
    output = execute("init", "--output", str(written))
    yield output._replace(words=output.words + (written.read_text(encoding="utf-8") if written.exists() else ""))
    for configuration in ("none", stated, str(written)) if replayed else ():
        if Path(configuration) != written or written.exists():
            yield execute("replay", "--config", configuration)


def line(number: Number) -> str:
    """Return a number beside ours, and whether they are near enough."""
    tolerance = "not stated" if number.tolerance is None else f"within {number.tolerance:.3g}"
    why = EXPLAINED.get((number.log, number.key), "not explained")
    verdict = "" if number.met else f"; NOT MET: {why}"
    return f"{number.key}: {number.theirs}, ours {number.ours} ({tolerance}){verdict}"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--jobs", type=int, default=2, help="logs at a time")
    parser.add_argument("--held-back", action="store_true", help="errors of the logs that judge the defaults, too")
    arguments = parser.parse_args()
    faults: list[str] = []
    try:
        folder = field_folder()
        with TemporaryDirectory() as scratch, ThreadPoolExecutor(arguments.jobs) as pool:
            logs = surveyed(folder)
            shown = (arguments.held_back or not log.held_back for log in logs)
            outputs = pool.map(lambda log, replayed: [*commands(log, folder, Path(scratch), replayed)], logs, shown)
            for output in (output for all_of in outputs for output in all_of):
                print(f"\n$ usbldr {output.command}\n{output.words}exit code {output.code}", flush=True)
                faults += [f"{output.command}: broke"] if output.broke else []
                faults += [f"{output.command}: lacks {code}" for code in output.missed]
        for case in (case for case in CASES.values() if case.folder):
            ours = measured(folder, case.name, arguments.held_back or not case.held_back)
            theirs = expected(folder / case.folder, case.name)
            numbers = [number for number in compared(case.name, theirs, ours) if not number.held_back]
            print(f"\n{case.name}: {len(numbers)} numbers of its collectors", *map(line, numbers), sep="\n")
            faults += [line(one) for one in numbers if not one.met and (one.log, one.key) not in EXPLAINED]
    except UsbldrError as fault:
        print(f"benchmarks/survey/study.py: {fault}", file=sys.stderr)
        return fault.exit_code
    print("", *faults, f"{len(faults)} faults", sep="\n")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
