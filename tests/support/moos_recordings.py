"""Logs of MOOS as pLogger writes them."""

from pathlib import Path

from recordings import SECOND, T0

COUNT = 40
BANNER = "%" * 60
HEAD = f"{BANNER}\n%% LOG FILE:       ./a.alog\n%% LOGSTART            {T0 // SECOND}.25\n{BANNER}\n"


def line(time_s: float, variable: str, source: str, value: object) -> str:
    """Return a line with the widths of pLogger."""
    return f"{time_s:<15.5f} {variable:<20} {source:<15} {value} \n"


def lines() -> list[str]:
    """Return a dive; an application posts the values of a reading one after the other, in wrong order of the file."""
    found: list[str] = []
    for k in range(COUNT):
        found += [
            line(k + 0.5, "COMPASS_HEADING", "iCompass", f"{k / 4:.5f}"),
            line(k + 0.0001, "DVL_VEL_Y", "iDVL", f"{0.25:.5f}"),
            line(k, "DVL_VEL_X", "iDVL:driver", f"{1 + k / 64:.6f}"),
            line(k + 0.2, "DVL_TEMPERATURE", "iDVL", "8.00000"),
            line(k + 0.0002, "DVL_STATUS", "iDVL", "all is, well = yes"),
            line(k - 0.2, "GPS_LATITUDE", "gGPS", f"{60 + k * 1e-6:.8f}"),
            line(k - 0.2, "GPS_LONGITUDE", "gGPS", f"{10:.8f}"),
        ]
    return found


def write_alog(file: Path) -> Path:
    file.write_text(HEAD + "".join(lines()), encoding="utf-8")
    return file
