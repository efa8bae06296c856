"""Files of all formats, cut, bent or overwritten anywhere: nothing is lost or wrong without a word.

A damaged file is a page, a run, or one sentence; never a traceback.
`make fuzz` takes 1000 cuts and 1000 flips of each format and writes the table of docs/broken_files.md.
"""

import random
import re
import resource
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from checkout import ROOT
from commands import run
from damage import DAMAGES, MARKERS, broken_promises, counted, cut, flipped
from damaged_formats import COUNT, FORMATS, dive
from usbldr.filters.errors import UsbldrError
from usbldr.io.reading.read import read_log


@pytest.mark.parametrize("kind", DAMAGES)
@pytest.mark.parametrize("form", FORMATS)
def test_no_damage_goes_unsaid(tmp_path: Path, form: str, kind: str) -> None:
    assert broken_promises(form, kind, counted(form, kind, 25, tmp_path)) == []


def test_what_goes_unsaid_breaks_a_promise() -> None:
    found = Counter({"tracebacks": 1, "silently short": 2, "silently wrong": 3})

    assert broken_promises("CSV", "flips", found) == ["CSV, flips: 1 tracebacks"]
    assert len(broken_promises("CSV", "cuts", found)) == len(broken_promises("PD0", "flips", found)) == 3


def test_the_page_counts_every_format() -> None:
    text = (ROOT / "docs" / "broken_files.md").read_text(encoding="utf-8")
    table = text.partition(MARKERS[0])[2].partition(MARKERS[1])[0]

    rows = re.findall(r"^\| ([^|]+) \|[^|]*\| \d", table, re.MULTILINE)
    _, _, others = " ".join(table.split()).partition("flips): ")

    assert sorted([*rows, *re.findall(r"([^;]+?) \(\d+, \d+\)[;.] ?", others)]) == sorted(FORMATS)


def test_the_numbers_of_the_dive_all_differ() -> None:
    values = [row[3].get("twist.linear.x", row[3].get("point.x", row[3].get("orientation.z"))) for row in dive()]

    assert len(np.unique([round(float(value or 0.0), 12) for value in values])) > COUNT * 2


def overwritten(whole: bytes, rng: random.Random) -> bytes:
    """Put nonsense into a stretch of a file, or take it out."""
    at, length = rng.randrange(len(whole)), rng.choice([4, 64, 3000])
    nonsense = rng.choice([rng.randbytes(length), bytes(length), b"\xff" * length, b""])
    return whole[:at] + nonsense + whole[at + length :]


def damaged(whole: bytes, rng: random.Random) -> bytes:
    return rng.choice([cut, flipped, overwritten])(whole, rng)


def read_or_refused(path: Path) -> None:
    """Read a log, or be refused in one sentence that names it; anything else is a failure."""
    sentence = f"{path}: "
    try:
        read_log(path)
    except UsbldrError as fault:
        sentence = str(fault)
    assert sentence.startswith(str(path))
    assert "\n" not in sentence


@pytest.mark.slow
@pytest.mark.parametrize("form", FORMATS)
def test_every_command_bears_a_damaged_file(form: str, tmp_path: Path) -> None:
    file = FORMATS[form].write(tmp_path)
    path, whole, rng = file.parent if FORMATS[form].folder else file, file.read_bytes(), random.Random(form)
    before_kb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    out = ["--force", "--output"]

    for case in range(24):
        file.write_bytes((overwritten if case < 12 else damaged)(whole, rng))
        read_or_refused(path)
        replayed = ["replay", path, "--filter", "ekf", "--quiet", *out, tmp_path / "run"]
        for command in (["info", path], ["doctor", path], ["init", path, *out, tmp_path / "found.toml"], replayed):
            done = run(*command) if case >= 12 else None
            if done and isinstance(done.exception, UsbldrError):
                assert done.exception.exit_code in (2, 3), done.exception
            elif done:
                assert done.return_value in (None, 0, 1, 3), (command, done.return_value)

    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before_kb < 400_000


@pytest.mark.slow
def test_odd_files_that_others_made_may_be_damaged_too(field_logs: Path, tmp_path: Path) -> None:
    zoo = (field_logs / "reader_zoo").rglob("*.*")
    files = sorted(path for path in zoo if path.suffix in (".mcap", ".bag", ".db3"))
    rng = random.Random(0)

    for file in files:
        for _ in range(4):
            (tmp_path / file.name).write_bytes(damaged(file.read_bytes(), rng))
            read_or_refused(tmp_path / file.name)
    assert len(files) > 25
