"""Logs of IMC messages, written by imcpy."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import pytest

from recordings import SECOND, T0

imcpy: Any = pytest.importorskip("imcpy", reason="imcpy has no wheel for this Python")
COUNT = 40
NUMBERS = {
    "EulerAngles": (254, [f"{name}:fp64_t" for name in ("time", "phi", "theta", "psi", "psi_magnetic")]),
    "GroundVelocity": (259, ["validity:uint8_t:VEL_X=1,VEL_Y=2,VEL_Z=4", "x:fp64_t", "y:fp64_t", "z:fp64_t"]),
    "WaterVelocity": (260, ["validity:uint8_t:VEL_X=1,VEL_Y=2,VEL_Z=4", "x:fp64_t", "y:fp64_t", "z:fp64_t"]),
    "GpsFix": (
        253,
        [
            "validity:uint16_t:NOTHING=0,VALID_DATE=1,VALID_TIME=2,VALID_POS=4",
            *("type:uint8_t", "utc_year:uint16_t", "utc_month:uint8_t", "utc_day:uint8_t", "utc_time:fp32_t"),
            *("lat:fp64_t", "lon:fp64_t", "height:fp32_t", "satellites:uint8_t", "cog:fp32_t", "sog:fp32_t"),
            *("hdop:fp32_t", "vdop:fp32_t", "hacc:fp32_t", "vacc:fp32_t"),
        ],
    ),
    "EstimatedState": (
        350,
        [
            *("lat:fp64_t", "lon:fp64_t", "height:fp32_t", "x:fp32_t", "y:fp32_t", "z:fp32_t"),
            *("phi:fp32_t", "theta:fp32_t", "psi:fp32_t", "u:fp32_t", "v:fp32_t", "w:fp32_t"),
            *("vx:fp32_t", "vy:fp32_t", "vz:fp32_t", "p:fp32_t", "q:fp32_t", "r:fp32_t", "depth:fp32_t", "alt:fp32_t"),
        ],
    ),
    "Depth": (265, ["value:fp32_t"]),
    "EntityInfo": (3, ["id:uint8_t", "label:plaintext", "component:plaintext", "act_time:uint16_t"]),
    "UsblFix": (892, ["target:uint16_t", "lat:fp64_t", "lon:fp64_t", "z_units:uint8_t", "z:fp32_t"]),
    "UsblFixExtended": (
        900,
        ["target:plaintext", "lat:fp64_t", "lon:fp64_t", "z_units:uint8_t", "z:fp32_t", "accuracy:fp32_t"],
    ),
}


def definitions() -> str:
    """Return definitions of some messages, as IMC.xml has them."""
    text = ""
    for name, (number, fields) in NUMBERS.items():
        text += f'<message id="{number}" abbrev="{name}">'
        for field in fields:
            label, kind, *flags = field.split(":")
            values = "".join(
                f'<value id="{flag.partition("=")[2]}" abbrev="{flag.partition("=")[0]}"/>'
                for flag in (flags[0].split(",") if flags else [])
            )
            unit = ' unit="Bitfield"' if flags else ""
            text += f'<field abbrev="{label}" type="{kind}"{unit}>{values}</field>'
        text += "</message>"
    return f"<messages>{text}</messages>"


def sent(kind: str, time_s: float, entity: int, **fields: Any) -> bytes:
    message = getattr(imcpy, kind)()
    message.timestamp, message.src, message.src_ent = time_s, 30, entity
    for name, value in fields.items():
        setattr(message, name, value)
    return bytes(imcpy.Packet.serialize(message))


def write_messages(folder: Path, sequence: Iterable[bytes]) -> Path:
    (folder / "IMC.xml").write_text(definitions())
    (folder / "Data.lsf").write_bytes(b"".join(sequence))
    return folder / "Data.lsf"


def messages() -> list[bytes]:
    valid = imcpy.GroundVelocity.ValidityBits(7)
    found = [sent("EntityInfo", T0 / SECOND, 5, id=5, label="DVL", component="Sensors.DVL")]
    for k in range(COUNT):
        time_s = T0 / SECOND + k + 0.25
        found += [
            sent("GroundVelocity", time_s, 5, validity=valid, x=1 + k / 7, y=0.25, z=-0.01),
            sent("EulerAngles", time_s, 6, psi=k / 40, phi=0.01),
            sent("Depth", time_s, 7, value=2 + k / 8),
            sent("Temperature", time_s, 7, value=8.0),  # not among the definitions
            sent("UsblFixExtended", time_s, 8, target="lauv-1", lat=0.75 + k * 1e-8, lon=0.125, accuracy=2.5),
        ]
    return found


def write_lsf(folder: Path) -> Path:
    return write_messages(folder, messages())
