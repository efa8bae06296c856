"""Which records a sensor's table was made of, and by which conventions; only here are they put in words."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Literal, TypeAlias

from usbldr.filters.errors import sentence

ChosenBy: TypeAlias = Literal[
    "configuration", "option", "type", "frame_id", "column names", "values", "records", "data", "model", "default"
]

CHOSEN_BY_TEXTS: Mapping[ChosenBy, str] = {
    "type": "by type",
    "frame_id": "by frame_id",
    "column names": "by column names",
    "values": "by its values",
    "records": "by its records",
    "data": "by the log",
    "model": "World Magnetic Model",
}
"""Texts of who chose a convention, if not the word itself."""

CONVENTION_TEXTS: Mapping[str, str] = {
    "age_s": "stamps shifted back by {}",
    "bearing_from": "bearings count from the {}",
    "bearing_sd_deg": "bearing sd {}",
    "bias_deg": "bias {} subtracted",
    "declination_deg": "declination {} added",
    "deviation_cos_deg": "deviation {} cos H subtracted",
    "deviation_sin_deg": "deviation {} sin H subtracted",
    "east_m": "at {} east",
    "heading_deg": "rotated by {}",
    "horizontal_range": "slant to horizontal range by {}",
    "latency_s": "latency {} subtracted",
    "level": "turned level by {}",
    "lever_arm": "lever arm turned level by {}",
    "lever_arm_m": "at {} starboard, forward, up of the antenna",
    "min_sd_m": "sd at least {}",
    "mount_deg": "mount {}",
    "north": "from {} north",
    "north_m": "at {} north",
    "range_sd_m": "range sd {}",
    "range_sd_rel": "range sd {} of the slant range",
    "relative_to": "relative to the {}",
    "scale_error": "scale error {} removed",
    "sd_deg": "sd {}",
    "sd_m": "sd {}",
    "sd_mps": "sd {}",
    "sd_rel": "sd {} of the slant range",
    "skip_rows": "first {} rows left out",
    "sound_speed_mps": "speed of sound {} in place of the assumed one",
    "sound_speed_scale": "ranges times {} for the speed of sound",
    "surface_pa": "surface {}",
    "time": "timed by {}",
}
"""Texts of conventions, with a place for the value; for other keys, the key and the value."""


@dataclass(frozen=True, slots=True)
class Convention:
    """One convention by which records were read, or one correction that was made."""

    key: str  # that of the configuration, if it has one: "axes", "mount_deg", "time"
    value: str | float
    chosen_by: ChosenBy
    unit: str = ""
    note: str = ""  # details for people: a frame_id, a model, how many records
    of: str = ""  # "": the sensor itself; else what it counts from: "ship", "head"

    def __post_init__(self) -> None:
        """Keep control characters of names in the log from terminals."""
        object.__setattr__(self, "note", sentence(self.note))


NO_CONVENTION = Convention("", "", "default")


@dataclass(frozen=True, slots=True)
class Provenance:
    """Which records a sensor's table was made of, and by which conventions."""

    topic: str
    type: str
    chosen_by: str  # "configuration", "option", "type and name"
    conventions: tuple[Convention, ...]
    messages: int  # in the file
    used: int
    geodetic: bool = False  # its positions are known by latitude and longitude

    def convention(self, key: str) -> Convention:
        """Return the sensor's own convention of that key, NO_CONVENTION if there is none."""
        return next((c for c in self.conventions if c.key == key and not c.of), NO_CONVENTION)


def chosen_by_text(convention: Convention) -> str:
    """Return who chose a convention: "by type", "by frame_id: base_ned"."""
    who = CHOSEN_BY_TEXTS.get(convention.chosen_by, convention.chosen_by)
    return f"{who}: {convention.note}" if convention.note else who


def convention_text(convention: Convention) -> str:
    """Return a convention in one sentence: "axes FRD (by type)", "mount 135 deg (configuration)"."""
    value = convention.value
    shown = value if isinstance(value, str) else f"{value:g}"
    text = CONVENTION_TEXTS.get(convention.key, f"{convention.key} {{}}")
    text = text.format(f"{shown} {convention.unit}" if convention.unit else shown)
    return f"{convention.of + ': ' if convention.of else ''}{text} ({chosen_by_text(convention)})"


def provenance_values(provenance: Provenance) -> dict[str, Any]:
    """Return a provenance as JSON has it: each convention with its values and its sentence."""
    values = asdict(provenance)
    values["conventions"] = [asdict(c) | {"text": convention_text(c)} for c in provenance.conventions]
    return values


def provenance_lines(role: str, provenance: Provenance) -> list[str]:
    """Return of which records a sensor was made and who chose them, then each convention, as lines of text."""
    p = provenance
    head = f"{role}: {p.topic} ({p.chosen_by}), {p.used} of {p.messages} records used"
    return [head, *(f"  {convention_text(convention)}" for convention in p.conventions)]
