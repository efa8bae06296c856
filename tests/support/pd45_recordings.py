"""PD4 and PD5 files by the tables of Teledyne's manuals, whose bytes count from 1."""

from collections.abc import Mapping
from pathlib import Path

COUNT = 40
SIZES = {4: 45, 5: 86}  # bytes before the checksum
PLACES: Mapping[str, tuple[int, int]] = {  # of the first and the last byte
    "id": (1, 1), "data structure": (2, 2), "number of bytes": (3, 4), "system config": (5, 5),
    "x": (6, 7), "y": (8, 9), "z": (10, 11),
    "hour": (36, 36), "minute": (37, 37), "second": (38, 38), "hundredths": (39, 39),
    "depth": (47, 48), "heading": (53, 54),
}  # fmt: skip
SHIP, BAD = 0b10 << 6, -32768


def pd45_ensemble(form: int, hundredths: int, **fields: int) -> bytes:
    """Return an ensemble of PD4 or PD5 at hundredths of a second since midnight; other bytes are 0x55."""
    clock = {"hour": hundredths // 360_000 % 24, "minute": hundredths // 6000 % 60, "second": hundredths // 100 % 60}
    head = {"id": 0x7D, "data structure": form - 4, "number of bytes": SIZES[form], "system config": SHIP}
    whole = bytearray(b"\x55" * SIZES[form])
    for name, value in (head | clock | {"hundredths": hundredths % 100} | fields).items():
        first, last = PLACES[name]
        if last <= len(whole):
            whole[first - 1 : last] = value.to_bytes(last - first + 1, "little", signed=value < 0)
    return bytes(whole) + (sum(whole) % 65536).to_bytes(2, "little")


def pd45_ensembles(form: int, first_hundredths: int = 4_474_050) -> list[bytes]:
    """Return ensembles that are half a second apart, the first at 12:25:40.50; the fourth has no velocity."""
    made: list[bytes] = []
    for k in range(COUNT):
        values = {"x": BAD if k == 3 else -250, "y": 1500 + k, "z": 10}
        values |= {"depth": 100 + k, "heading": (35_500 + 50 * k) % 36_000}
        made.append(pd45_ensemble(form, first_hundredths + 50 * k, **values))
    return made


def write_pd45(file: Path, form: int, first_hundredths: int = 4_474_050) -> Path:
    file.write_bytes(b"".join(pd45_ensembles(form, first_hundredths)))
    return file
