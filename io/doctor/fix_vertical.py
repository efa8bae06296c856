"""The vertical of the fixes against the log's depth: tilt of the head, scale of its ranges."""

import numpy as np

from usbldr.filters.types import Array, Vector
from usbldr.filters.usbl_survey.vertical import VerticalFit, vertical_fit
from usbldr.io.conventions.timestamps import times_of
from usbldr.io.conventions.usbl import along_axes
from usbldr.io.doctor.interpretations import recorded_value
from usbldr.io.findings import Finding
from usbldr.io.log import Log
from usbldr.io.messages.layouts import RawRecords

SOUND_MPS = 1500.0  # of usual sea water, to state a scale as a speed


def vertical_of(log: Log) -> VerticalFit | None:
    """Return what the fixes' own vertical says of their head; None if they have none, or the log has no depth."""
    raw = log.raws.get("usbl")
    if raw is None or "depth" not in log.tables:
        return None
    time_s = (times_of(raw, log.settings.usbl.time, log.settings.usbl.latency_s).time_ns - log.start_ns) / 1e9
    along, drop = _measured(log, raw)
    return vertical_fit(drop, depth_below_head_m(log, time_s), along)


def depth_below_head_m(log: Log, time_s: Vector) -> Vector:
    """Return how deep the vehicle is below the head, (n,), by the log's depth; NaN where it has none."""
    if (table := log.tables.get("depth")) is None:
        return np.full(len(time_s), np.nan)
    known_s, depth_m = table[["time_s", "depth_m"]].to_numpy(dtype=float).T
    head = log.settings.usbl.head
    return np.interp(time_s, known_s, depth_m, left=np.nan, right=np.nan) - (head.depth_m if head else 0.0)


def _measured(log: Log, raw: RawRecords) -> tuple[Array, Vector]:
    """Return fixes along starboard and forward, or east and north, (n, 2), and how deep each lies by itself, (n,)."""
    if recorded_value(log, "usbl", "frame") == "body" and "x" in raw.values:
        along, *_ = along_axes(raw, log.settings.usbl)
        return along[:, :2], -along[:, 2]
    slant, bearing = raw.number("slant_range_m"), np.radians(raw.number("bearing_deg"))
    drop = slant * np.sin(np.abs(np.radians(raw.number("elevation_deg"))))
    drop = np.where(np.isfinite(drop), drop, raw.number("depth_m"))
    flat = np.sqrt(np.maximum(slant**2 - drop**2, 0.0))
    return np.column_stack([flat * np.sin(bearing), flat * np.cos(bearing)]), drop


def vertical_text(found: VerticalFit) -> str:
    """Return what was settled, in one line."""
    roll, pitch, _, offset = (f"{v:+.2f} ± {s:.2f}" for v, s in zip(found.value, found.sd, strict=True))
    sound = SOUND_MPS * found.value[2], SOUND_MPS * found.sd[2]
    texts = (
        f"roll {roll} deg",
        f"pitch {pitch} deg",
        f"scale {found.value[2]:.4f} ± {found.sd[2]:.4f} ({sound[0]:.0f} ± {sound[1]:.0f} m/s if 1500 m/s was set)",
        f"offset {offset} m",
    )
    settled = [text for text, known in zip(texts, found.settled, strict=True) if known]
    left = [name for name, known in zip(("roll", "pitch", "scale", "offset"), found.settled, strict=True) if not known]
    return (", ".join(settled) or "nothing is settled") + (f"; open: {', '.join(left)}" if left and settled else "")


def vertical_findings(log: Log) -> list[Finding]:
    """Report tilt of the head and scale of its ranges by the vertical of the fixes, in one line."""
    found = vertical_of(log)
    if found is None:
        return []
    text = f"z of {found.fixes} fixes against the depth: the head has {vertical_text(found)}"
    return [log.finding("USBL-VERTICAL", "usbl", f"{text}; noise of z {found.noise_m:.2f} m", None, found.noise_m, "m")]
