"""Message types of pressure and depth sensors."""

from usbldr.io.messages import Layout, own

DEPTH = (
    Layout("fluidpressure", {"pressure": "fluid_pressure"}, recognised="by type", defaults={"unit": "Pa"}),
    Layout("float64", {"depth": "data"}, defaults={"unit": "m"}),
    Layout("float32", {"depth": "data"}, defaults={"unit": "m"}),
    Layout("depth", own("pressure"), recognised="by type", defaults={"unit": "Pa"}),
    Layout("depth", {"depth": "depth_m"}, recognised="by type", fixed={"unit": "m", "positive": "down"}),
)
