"""Files of all formats, cut at any byte or with flipped bits, and what was read of them, counted.

$ PYTHONPATH=tests/support:benchmarks python tests/support/damage.py --write docs/broken_files.md
"""

import argparse
import math
import random
import sys
import tempfile
import traceback
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from textwrap import fill
from typing import NamedTuple

from damaged_formats import FORMATS
from usbldr.filters.errors import UsbldrError
from usbldr.io.decoding.collected import read_whole
from usbldr.io.formats.detect import open_reader
from usbldr.io.reader import Reader

MARKERS = ("<!-- make fuzz: begin -->", "<!-- make fuzz: end -->")


class Read(NamedTuple):
    rows: Mapping[str, set[tuple[float, ...]]]
    said: bool  # that data were lost, or that it cannot be read at all


def read(path: Path, form: str) -> Read:
    """Read the wanted topics as far as they are there; a row that lacks a value is none."""
    wanted, timed = FORMATS[form].wanted, FORMATS[form].times_checked
    rows: dict[str, set[tuple[float, ...]]] = {topic: set() for topic in wanted}
    try:
        log = open_reader(path)
        present = [topic for topic in log.topics() if topic.name in wanted]
        names = {topic.key: topic.name for topic in present if all(map(topic.has, wanted[topic.name]))}
        unread = any(topic.problem for topic in present)  # a problem is reported
        for key, records in read_whole(log, {k: wanted[n] for k, n in names.items()}).items() if not unread else ():
            topic = names[key]
            columns = [*([records.received_ns] if timed else []), *(records.columns[path] for path in wanted[topic])]
            found = set(zip(*(column.tolist() for column in columns), strict=True))
            rows[topic] |= {row for row in found if not any(isinstance(v, float) and math.isnan(v) for v in row)}
        of_all = len(names) == len(present) and {*names.values()} == {*wanted}  # a type without the fields is named
        said = unread or not of_all or any(finding.lost_data for finding in log.findings())
    except UsbldrError:
        said = True
    return Read(rows, said)


def count(log: Reader, form: str) -> list[int]:
    """Return how many records of each wanted topic are read."""
    wanted = FORMATS[form].wanted
    present = {one.key for one in log.topics() if all(map(one.has, wanted.get(one.name, ())))}
    found = read_whole(log, {topic: paths for topic, paths in wanted.items() if topic in present})
    return [len(found[topic].received_ns) if topic in found else 0 for topic in FORMATS[form].wanted]


@contextmanager
def recorded(form: str) -> Iterator[tuple[Path, Path, bytes, list[int]]]:
    """Write a recording; give its file, what is opened, the bytes, and how many records are read of each topic."""
    with tempfile.TemporaryDirectory() as name:
        file = FORMATS[form].write(Path(name))
        path = file.parent if FORMATS[form].folder else file
        yield file, path, file.read_bytes(), count(open_reader(path), form)


def attempt(path: Path, form: str) -> tuple[list[int], bool]:
    """Return how many records are read, and whether a loss is said, or why nothing can be read."""
    try:
        log = open_reader(path)
        found = count(log, form)
        return found, any(finding.lost_data for finding in log.findings()) or any(one.problem for one in log.topics())
    except UsbldrError:
        return [0] * len(FORMATS[form].wanted), True


def cut(whole: bytes, rng: random.Random) -> bytes:
    return whole[: rng.randrange(len(whole))]


def flipped(whole: bytes, rng: random.Random) -> bytes:
    bent = bytearray(whole)
    for _ in range(rng.choice([1, 1, 1, 5, 50])):
        bent[rng.randrange(len(bent))] ^= 1 << rng.randrange(8)
    return bytes(bent)


def without_sector(whole: bytes, rng: random.Random) -> bytes:
    """Return the bytes with a sector of a disk lost."""
    size = min(512, len(whole) // 8)
    at = rng.randrange(len(whole) // size) * size
    return whole[:at] + bytes(size) + whole[at + size :]


DAMAGES: Mapping[str, Callable[[bytes, random.Random], bytes]] = {
    "cuts": cut,
    "flips": flipped,
    "sectors": without_sector,
}
COUNTED = ("cuts", "flips")  # in the table


def counted(form: str, kind: str, cases: int, folder: Path) -> Counter[str]:
    """Return how often a damaged file was a traceback, silently short or silently wrong, and the share read of it."""
    one = FORMATS[form]
    file = one.write(folder)
    whole, path = file.read_bytes(), file.parent if one.folder else file
    ends = one.ends(whole) if kind == "cuts" else set[int]()
    all_rows, rng, found = read(path, form).rows, random.Random(form), Counter[str]()
    total = sum(map(len, all_rows.values()))
    for _ in range(cases):
        spoilt = DAMAGES[kind](whole, rng)
        file.write_bytes(spoilt)
        try:
            rows, said = read(path, form)
        except Exception:  # whatever it is: a user would see a traceback, which is counted
            traceback.print_exc()
            found["tracebacks"] += 1
            continue
        wrong = any(rows[topic] - all_rows[topic] for topic in all_rows)
        short = any(all_rows[topic] - rows[topic] for topic in all_rows)
        found["silently wrong"] += wrong and not said
        found["silently short"] += short and not wrong and not said and len(spoilt) not in ends
        found["messages"] += sum(len(rows[topic] & all_rows[topic]) for topic in all_rows)
    found["read, %"] = round(100 * found["messages"] / (cases * total))
    return found


def broken_promises(form: str, kind: str, found: Counter[str]) -> list[str]:
    """Return which numbers should be zero and are not."""
    shows, zero = FORMATS[form].shows, ["tracebacks"]
    if kind in ("cuts", "sectors") or shows:
        zero.append("silently short")
    if kind == "cuts" or shows == "all":
        zero.append("silently wrong")
    return [f"{form}, {kind}: {found[name]} {name}" for name in zero if found[name]]


def job(form: str, kind: str, cases: int) -> Counter[str]:
    with tempfile.TemporaryDirectory() as folder:
        return counted(form, kind, cases, Path(folder))


def table(counts: Mapping[str, Sequence[Counter[str]]]) -> str:
    """Return a row of each format of which cuts and flips lost or altered messages in silence, and name the others."""
    heads = ["file", "shown", "cuts: read", "flips: lost, wrong", "flips: read"]
    rows, good = [f"| {' | '.join(heads)} |", f"|{'---|' * len(heads)}"], list[str]()
    for form, (cuts, flips) in counts.items():
        silent = flips["silently short"], flips["silently wrong"]
        if any(silent):
            cells = (form, FORMATS[form].shows, cuts["read, %"], f"{silent[0]}, {silent[1]}", flips["read, %"])
            rows.append(f"| {' | '.join(map(str, cells))} |")
        else:
            good.append(f"{form} ({cuts['read, %']}, {flips['read, %']})")
    rest = f"Nothing is lost or altered without a report (in brackets, read after cuts and flips): {'; '.join(good)}."
    return "\n".join((*rows, "", fill(rest, 120, break_on_hyphens=False)))


def main() -> None:
    options = argparse.ArgumentParser(description="Print the table as Markdown; exit 1 if a number should be zero.")
    options.add_argument("--cases", type=int, default=1000, help="cuts and flips of each format")
    options.add_argument("--formats", nargs="+", default=list(FORMATS), choices=FORMATS, metavar="FORMAT")
    options.add_argument("--write", type=Path, nargs="*", default=[], help="pages whose markers take the table")
    arguments = options.parse_args()
    from speed.peers_table import write

    broken, counts = list[str](), dict[str, list[Counter[str]]]()
    with ProcessPoolExecutor() as pool:
        jobs = {form: [pool.submit(job, form, kind, arguments.cases) for kind in COUNTED] for form in arguments.formats}
        for form, both in jobs.items():
            counts[form] = [one.result() for one in both]
            for kind, found in zip(COUNTED, counts[form], strict=True):
                broken += broken_promises(form, kind, found)
    print(table(counts))
    for page in arguments.write:
        write(page, table(counts), MARKERS)
    sys.exit("\n".join(broken) or 0)


if __name__ == "__main__":
    main()
