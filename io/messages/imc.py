"""IMC messages of LSTS' vehicles (.lsf).

Source: IMC.xml of LSTS/imc. Angles are radians, velocities and rotations those of SNAME: forward, starboard, down.
"""

from usbldr.io.messages.layouts import MessageLayout
from usbldr.io.units import DEG_PER_RAD

IN_RADIANS = {"lat_deg": DEG_PER_RAD, "lon_deg": DEG_PER_RAD}
PLACE = {"lat_deg": "lat", "lon_deg": "lon"}
LATLON = {"frame": "latlon"}
FIXES = {"kind": "latlon"}
IMC = ("imc",)

IMC_DVL = (
    MessageLayout(
        "groundvelocity",
        {"x": "x", "y": "y", "z": "z", "velocity_valid": "validity.VEL_X", "y_valid": "validity.VEL_Y"},
        {},
        "by type",
        {"axes": "FRD"},
        packages=IMC,
    ),
)
IMC_COMPASS = (
    MessageLayout(
        "eulerangles", {"angle": "psi"}, {}, "by type", {"convention": "compass", "unit": "rad"}, packages=IMC
    ),
)
IMC_USBL = (
    MessageLayout(
        "usblfixextended",
        PLACE,
        {"sd_m": "accuracy", "target": "target"},
        "by type",
        FIXES,
        packages=IMC,
        scale=IN_RADIANS,
    ),
    MessageLayout("usblfix", PLACE, {"target": "target"}, "by type", FIXES, packages=IMC, scale=IN_RADIANS),
)
IMC_GPS = (
    MessageLayout(
        "gpsfix",
        PLACE | {"valid": "validity.VALID_POS"},
        {"imc_fix_type": "type"},
        "by type",
        LATLON,
        packages=IMC,
        scale=IN_RADIANS,
    ),
)
IMC_DEPTH = (
    MessageLayout("depth", {"depth": "value"}, {}, "by type", {"unit": "m", "positive": "down"}, packages=IMC),
)
