"""Make logs.md: what info, doctor, init and replay say of every log at hand, and the numbers that others measured.

    python benchmarks/logs/survey.py

The logs are third-party: USBLDR_FIELD_LOGS names their folder. Errors of the logs that are held back are neither kept
nor shown unless they are asked for. Exit code 1 where a command broke, or a finding or number is not what it has to be.
"""

import argparse
import sys
import time
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path
from tempfile import TemporaryDirectory

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # paper, field and logs are packages

from field.logs import CASES, field_folder
from logs import number_tables
from logs import survey_tables as tables
from logs.expected import EXPLAINED, compared, expected
from logs.measured import measured
from logs.survey_runs import Said, Surveyed, field_logs, other_files, survey
from paper.study import filled, minutes
from usbldr.filters.errors import UsbldrError
from usbldr.io.reports.run_directory import write_atomically

ROOT = Path(__file__).resolve().parents[2]
TEXT = Path(__file__).with_name("text.md")


def main() -> int:
    asked = arguments()
    began = time.monotonic()
    try:
        folder = field_folder()
        with TemporaryDirectory() as scratch:
            logs = (*field_logs(), *other_files(folder))
            heard = survey(logs, folder, Path(scratch), asked.jobs, asked.held_back)
        numbers = measure(folder, asked.held_back)
    except UsbldrError as fault:
        print(f"benchmarks/logs/survey.py: {fault}", file=sys.stderr)
        return fault.exit_code
    asked.output.mkdir(parents=True, exist_ok=True)
    write_atomically(asked.output / "logs.md", document(heard, numbers).encode())
    wrong = [
        *(
            f"{log.name}: {said.command} broke: {said.err}"
            for log, all_of in heard.items()
            for said in all_of
            if said.broke
        ),
        *(f"{row.log}: doctor does not say {row.code}" for row in tables.WANTED if not tables.quote(row, heard)),
        *(
            f"{one.log}: {one.key} is {one.ours}, not {one.theirs}"
            for of_log in numbers.values()
            for one in of_log
            if not (one.met or one.held_back or (one.log, one.key) in EXPLAINED)
        ),
    ]
    print(*wrong, f"{asked.output / 'logs.md'}: {minutes(began)}", sep="\n")
    return 1 if wrong else 0


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--jobs", type=int, default=2, help="logs at a time")
    parser.add_argument("--output", type=Path, default=ROOT / "docs" / "studies", help="folder of logs.md")
    parser.add_argument("--held-back", action="store_true", help="errors of the logs that judge the defaults, too")
    return parser.parse_args()


def measure(folder: Path, held_back: bool) -> number_tables.Numbers:
    """Hold our numbers beside those of each log's collectors."""
    return {
        name: compared(
            name, expected(folder / case.folder, name), measured(folder, name, held_back or not case.held_back)
        )
        for name, case in CASES.items()
        if case.folder
    }


def document(heard: Mapping[Surveyed, tuple[Said, ...]], numbers: number_tables.Numbers) -> str:
    """Return docs/studies/logs.md: the text with every table in its place."""
    field = {log: said for log, said in heard.items() if log in field_logs()}
    other = {log: said for log, said in heard.items() if log not in field}
    parts = {
        "made": f"usbldr {version('usbldr')}",
        "summary": tables.summary(heard),
        "findings": tables.findings(heard),
        "field": tables.sections(field),
        "numbers": number_tables.summary(numbers),
        "measured": number_tables.sections(numbers),
        "other": tables.others(other),
    }
    return filled(TEXT.read_text(encoding="utf-8"), parts)


if __name__ == "__main__":
    sys.exit(main())
