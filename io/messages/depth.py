"""Message types of pressure and depth sensors.

Sources: the .msg files of the packages named. An estimate of the vehicle's own navigation serves only where it is
named.
"""

from usbldr.io.messages.layouts import Layout, only_when_named, own

METRES = {"unit": "m"}
UP = METRES | {"positive": "up"}

HEIGHTS = (
    Layout("posestamped", {"height": "pose.position.z"}, defaults=METRES),
    Layout("posewithcovariancestamped", {"height": "pose.pose.position.z"}, defaults=METRES),
    Layout("odometry", {"height": "pose.pose.position.z"}, defaults=METRES),
)
"""Up or down by the name of their frame."""

DEPTH = (
    Layout("fluidpressure", {"pressure": "fluid_pressure"}, recognised="by type", defaults={"unit": "Pa"}),
    Layout(
        "depthpressure",  # ds_sensor_msgs
        own("depth"),
        recognised="by type",
        defaults=METRES,
        missing={"depth": (-9999.0,)},
    ),
    Layout("depth", own("depth"), recognised="by type", defaults=METRES),  # riptide_msgs, uuv_sensor_msgs
    Layout("depthsensor", own("depth"), recognised="by type", defaults=METRES),  # holoocean_interfaces
    Layout("float64", {"depth": "data"}, topic=r"rel_alt$", recognised="only when named", defaults=UP),  # mavros
    Layout("float64", {"depth": "data"}, defaults=METRES),
    Layout("float32", {"depth": "data"}, defaults=METRES),
    *only_when_named(HEIGHTS),
    Layout("depth", own("pressure"), recognised="by type", defaults={"unit": "Pa"}),
    Layout("depth", {"depth": "depth_m"}, recognised="by type", fixed={"unit": "m", "positive": "down"}),
)
