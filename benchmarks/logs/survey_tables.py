"""The tables of logs.md: of each command the exit code and the one sentence or verdict that matters."""

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from logs.survey_runs import SECTION, TOLD, Said, Surveyed
from usbldr.io.reports.report_text import Table
from usbldr_cli.tables.compare_table import piped

LEVELS = ("error", "warning", "info")
UIB, STPERE = "uib_field/uib_field.mcap", "stpere_marina/stpere_marina.mcap"
Heard = Mapping[Surveyed, tuple[Said, ...]]


class Wanted(NamedTuple):
    """A finding that doctor has to come to without being told."""

    what: str
    log: str
    code: str
    settings: str = ""


WANTED = (
    Wanted("the DVL records are there twice", UIB, "REPEATED"),
    Wanted("the map is NED", UIB, "MAP-FRAME"),
    Wanted("the IMU is NED", UIB, "HEADING-CONVENTION"),
    Wanted("the DVL is mounted near 135 to 141°", UIB, "DVL-MOUNT"),
    Wanted("the fixes are delayed", UIB, "USBL-DELAYED"),
    Wanted("the fixes are delayed", UIB, "USBL-LATENCY"),
    Wanted("some fixes are gross outliers", UIB, "USBL-OUTLIERS"),
    Wanted("DVL records say 327.67 m/s", STPERE, "DVL-INVALID"),
    Wanted("IMU heading and DVL axis are -20° ± 2° apart", STPERE, "DVL-MOUNT"),
    Wanted("at the nominal mounting of -26° the heading is biased by 6° ± 2°", STPERE, "HEADING-BIAS", "stated"),
    Wanted("the bottom lock is lost", "mhkit_tanana/tanana_002.mcap", "LOST-LOCK"),
    Wanted("the bottom lock is lost", "mhkit_tanana/tanana_003.mcap", "LOST-LOCK"),
)


def quote(wanted: Wanted, heard: Heard) -> str:
    """Return what doctor said to it, "" if nothing."""
    return next(
        (
            text
            for log, all_of in heard.items()
            for said in all_of
            for _, code, text in said.findings
            if (log.name, said.settings, code) == (wanted.log, wanted.settings, wanted.code)
        ),
        "",
    )


def findings(heard: Heard) -> str:
    rows = [(one.what, one.log, f"`{one.code}`", quote(one, heard) or "not found") for one in WANTED]
    return table(("what there is", "log", "code", "what `doctor` says"), rows)


def sections(heard: Heard) -> str:
    """Return a table for each log: every command, by every configuration; of a second form only what differs."""
    header = ("command", "configuration", "exit", "what it says")
    parts: list[str] = []
    first: dict[str, tuple[str, set[tuple[str, ...]]]] = {}
    for log, all_of in heard.items():
        rows = [(said.command, settings(log, said), str(said.code), plain(matter(said, log))) for said in all_of]
        known, already = first.setdefault(log.configuration, (log.name, set()))
        new = [row for row in rows if row not in already]
        parts += [f"### {log.name}", ""]
        if new:
            parts += [table(header, new), ""]
        if len(new) < len(rows):
            parts += [f"{'The rest' if new else 'All'} is word for word as of {known}.", ""]
        already.update(rows)
    return "\n".join(parts).rstrip()


def plain(text: str) -> str:
    """Return a sentence with types in the short form, which ROS 1 and ROS 2 share."""
    return text.replace("/msg/", "/")


def others(heard: Heard) -> str:
    """Return one row a file: no command makes anything of it, and each has to say why."""
    header = ("file", "info", "doctor", "init", "replay", "replay by another log's configuration")
    rows = []
    for log, all_of in heard.items():
        cells: list[str] = []
        told: list[str] = []
        for said in all_of:
            sentence = matter(said, log)
            cells.append(f"{said.code}: {'the same' if sentence in told else sentence}")
            told.append(sentence)
        rows.append((log.name.removeprefix("reader_zoo/"), *cells))
    return table(header, rows)


def settings(log: Surveyed, said: Said) -> str:
    return {"stated": f"`{log.configuration}.toml`", "init's": "as `init` wrote it"}.get(said.settings, "none")


def matter(said: Said, log: Surveyed) -> str:
    """Return the one thing that a user has to know of what a command said."""
    if said.fault:
        return said.fault.removeprefix(f"{log.name}: ")
    return {"info": understood, "doctor": codes, "init": written, "replay": verdict}[said.command](said)


def understood(said: Said) -> str:
    """Return info's last word, or which topic it takes for which sensor."""
    lines = said.out.splitlines()
    if lines[-1].startswith(("not to be replayed", "no topic here")):
        unread = [line for line in lines if line.startswith("cannot be read: ")]
        return "; ".join([lines[-1], *unread])
    return "; ".join(line for line in lines if line.endswith("records used") or line.startswith("errors are measured"))


def codes(said: Said) -> str:
    """Return doctor's codes, the worst level first."""
    by_level = {level: Counter(code for is_level, code, _ in said.findings if is_level == level) for level in LEVELS}
    return "; ".join(
        f"{level} " + " ".join(f"`{code}`" + (f" ×{n}" if n > 1 else "") for code, n in of_level.items())
        for level, of_level in by_level.items()
        if of_level
    )


def written(said: Said) -> str:
    """Return which sections init wrote, and what it leaves to the user."""
    lines = said.out.splitlines()
    asked = [line.lstrip("# ").rstrip(".") for line in lines if "# CHECK" in line]
    told = f"wrote {', '.join(SECTION.findall(said.out))}"
    return f"{told}; to be decided: " + "; ".join(" ".join(line.split()) for line in asked) if asked else told


def verdict(said: Said) -> str:
    """Return replay's verdict and the findings that came with it."""
    came = " ".join(f"`{code}`" for code in dict.fromkeys(TOLD.findall(said.err)))
    told = said.out.strip() or "ran; its errors are held back"
    return f"{told} ({came})" if came else told


def summary(heard: Heard) -> str:
    runs = [said for all_of in heard.values() for said in all_of]
    by_code = Counter(said.code for said in runs)
    ended = ", ".join(f"{by_code[code]} with {code}" for code in sorted(by_code))
    broke = sum(said.broke for said in runs)
    found = sum(bool(quote(one, heard)) for one in WANTED)
    return (
        f"{len(runs)} commands on {len(heard)} logs and files ended {ended}; {broke or 'none'} in a traceback. "
        f"`doctor` says {found} of the {len(WANTED)} things that it had to find without being told."
    )


def table(header: Sequence[str], rows: Sequence[tuple[str, ...]]) -> str:
    """Return Markdown with every column to the left: most cells are sentences."""
    return piped(Table(header[0], tuple(header[1:]), tuple(rows))).replace("---:", "---")
