"""A sensor's records in the making: the convention of each key, the valid records, and the table of both."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from usbldr.filters.errors import listed
from usbldr.filters.types import Mask, Vector
from usbldr.io.conventions.timestamps import TIMES, Times
from usbldr.io.findings import Finding
from usbldr.io.messages.layouts import BAD, FLAG_WORDS, GOOD, RawRecords
from usbldr.io.provenance import Convention

MOST_WORDS = 5  # in a sentence
ANY_COLUMNS = "docs/configuration.md#any-columns-any-message"


@dataclass(frozen=True, slots=True)
class ConvertedTable:
    """A sensor's table in the making: the canonical columns, with times.TIMES in place of time_s and received_s."""

    table: pd.DataFrame  # in order of arrival
    conventions: tuple[Convention, ...]
    findings: tuple[Finding, ...]
    geodetic: bool = False  # its positions are known by latitude and longitude
    attitude: "ConvertedTable | None" = None  # of a compass that knows it: fewer records, with compass.VERTICAL

    def only(self, good: Mask) -> "ConvertedTable":
        """Return it without the records that are not good."""
        return self if good.all() else replace(self, table=self.table[good].reset_index(drop=True))


def chosen_convention(
    raw: RawRecords, key: str, value: str | None, default: str, by_frame: bool = False
) -> tuple[str, Convention, list[Finding]]:
    """Return a key's value, its convention, and a finding if the log contradicts the configuration.

    ``by_frame``: the default is what the name of the frame means.
    """
    if key in raw.layout.fixed:
        fixed = raw.layout.fixed[key]
        text = f'{key} = "{value}" of the configuration is not used; its columns are {fixed}'
        text += f"; name them by columns to read them otherwise ({ANY_COLUMNS})"
        unused = [] if value in (None, fixed) else [raw.finding("KEY-UNUSED", text)]
        return fixed, Convention(key, fixed, "column names"), unused
    if value is not None:
        chosen = Convention(key, value, "configuration")
    elif key in raw.layout.defaults:
        chosen = Convention(key, raw.layout.defaults[key], "type")
    elif by_frame:
        chosen = Convention(key, default, "frame_id", note=raw.frame_id)
    else:
        chosen = Convention(key, default, "default")
    return str(chosen.value), chosen, []


def corrections(unit: str = "", **stated: float) -> list[Convention]:
    """Return the corrections that the configuration states by its keys, without those of 0."""
    return [Convention(key, value, "configuration", unit) for key, value in stated.items() if value]


def converted_table(
    times: Times, columns: Mapping[str, Vector | Mask], chosen: Sequence[Convention], findings: Sequence[Finding]
) -> ConvertedTable:
    """Put times and columns into one table, times' conventions last."""
    table = pd.DataFrame({name: getattr(times, name) for name in TIMES} | dict(columns), copy=False)
    return ConvertedTable(table, (*chosen, *times.conventions), (*findings, *times.findings))


def valid_mask(
    raw: RawRecords, causes: Mapping[str, Mask], sensor: str, treatment: str, advice: str = ""
) -> tuple[Mask, list[Finding]]:
    """Return which records (n,) are good, and a finding that counts the others by their first cause.

    Raises LogError if none is good, ending in the advice.
    """
    error = raw.number("error")
    flags = {"flagged invalid": raw.number("valid") == 0, "with an error code": (error > 0) | (error < 0)}
    findings = _unknown_words(raw, ("valid",) if sensor == "dvl" else ("valid", "status"))
    if flag := next(filter(raw.is_counter, ("valid", "velocity_valid")), ""):
        text = f"its flag {raw.layout.optional.get(flag, flag)} numbers the records: no record is invalid by it"
        findings.append(raw.finding("FLAG-COUNTS", text))
    good = np.ones(len(raw.received_ns), dtype=np.bool_)
    counts: dict[str, int] = {}
    for cause, mask in {**flags, **causes}.items():
        counts[cause] = int(np.sum(mask & good))
        good = good & ~mask
    bad = int(np.sum(~good))
    if not bad:
        return good, findings
    parts = ", ".join(f"{count} {cause}" for cause, count in counts.items() if count)
    if bad == len(good):
        raise raw.fault(f"all {bad} records of {raw.topic.name} ({sensor}) are invalid: {parts}{advice}")
    text = f"{bad} of {len(good)} records are invalid and {treatment} ({parts})"
    return good, [*findings, raw.finding(f"{sensor.upper()}-INVALID", text)]


def _unknown_words(raw: RawRecords, quantities: Sequence[str]) -> list[Finding]:
    """Report words of flags that are not understood."""
    words = {word for quantity in quantities for word in np.unique(raw.words(quantity))}
    unknown = [str(word) for word in sorted(words) if word[:1].isalpha() and word != "nan" and word not in FLAG_WORDS]
    if not unknown:
        return []
    text = f"words of its flags are not understood, and such records are used: {listed(unknown, MOST_WORDS)}"
    return [raw.finding("FLAG-WORDS", f"{text}; write {', '.join(GOOD)} or 1, else {', '.join(BAD)} or 0")]
