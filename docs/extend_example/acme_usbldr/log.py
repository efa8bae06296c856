"""ACME logs: a first line "ACME 1", then a line for each record: nanoseconds since 1970, its kind, its numbers."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

import usbldr

FIELDS = {"Velocity": ("forward", "starboard"), "Heading": ("degrees",), "UsblFix": ("east", "north")}  # of each kind
TIME = "time_ns"


class AcmeLog:
    """An opened ACME log: what usbldr.Reader asks for. Each kind of record is a topic."""

    format = "ACME log"

    def __init__(self, path: Path) -> None:
        self.path = path
        self._rows: dict[str, list[tuple[float, ...]]] = {kind: [] for kind in FIELDS}
        self._times_ns: dict[str, list[int]] = {kind: [] for kind in FIELDS}
        self._bad = 0
        for line in path.read_text(errors="replace").splitlines()[1:]:
            self._add(line.split())

    def _add(self, words: Sequence[str]) -> None:
        try:
            time_ns, kind, *numbers = words
            row = tuple(map(float, numbers))
            if len(row) != len(FIELDS[kind]):
                raise ValueError(kind)
            self._times_ns[kind].append(int(time_ns))
            self._rows[kind].append(row)
        except (ValueError, KeyError):
            self._bad += 1

    def topics(self) -> tuple[usbldr.TopicInfo, ...]:
        """List the topics of the log."""
        return tuple(
            usbldr.TopicInfo(f"acme/{kind}", f"acme/{kind}", "text", len(t), min(t), max(t), (TIME, *FIELDS[kind]))
            for kind, t in self._times_ns.items()
            if t
        )

    def blocks(self, wanted: Mapping[str, Sequence[str]]) -> Iterator[tuple[str, usbldr.Records]]:
        """Read the fields of the topics: of each topic one block of records, or several in order of time."""
        for topic, paths in wanted.items():
            kind = topic.removeprefix("acme/")
            columns = np.array(self._rows[kind]).T
            values = dict(zip(FIELDS[kind], columns, strict=True))
            values[TIME] = times_ns = np.array(self._times_ns[kind], np.int64)
            yield topic, usbldr.Records(times_ns, {path: values[path] for path in paths if path in values})

    def findings(self) -> tuple[usbldr.Finding, ...]:
        """Report what was lost: nothing is passed over in silence."""
        if not self._bad:
            return ()
        return (usbldr.Finding("TRUNCATED", f"{self._bad} lines are no records of an ACME log", lost_data=True),)


def acme_log(path: Path, head: bytes) -> AcmeLog | None:
    """Return the reader if the first bytes of a file are those of an ACME log."""
    return AcmeLog(path) if head.startswith(b"ACME 1\n") else None


def _layout(kind: str, fields: Mapping[str, str], **defaults: str) -> usbldr.MessageLayout:
    """Return which field of a kind of record is which quantity, and the conventions of its numbers."""
    return usbldr.MessageLayout(
        kind.lower(),
        fields,
        recognised="by type",
        packages=("acme",),
        defaults=defaults,
        stamp="time_ns",
        stamp_unit_ns=1,
    )


LAYOUTS = {
    "dvl": [_layout("Velocity", {"x": "forward", "y": "starboard"}, axes="FSD")],
    "compass": [_layout("Heading", {"angle": "degrees"}, convention="NED")],
    "usbl": [_layout("UsblFix", {"x": "east", "y": "north"}, frame="ENU")],
}
