"""Message types of pressure and depth sensors.

Sources: the .msg files of the packages named. An estimate by the vehicle's own navigation is used only if it is
named.
"""

from usbldr.io.messages.layouts import MessageLayout, only_when_named, own_columns

METRES = {"unit": "m"}
UP = METRES | {"positive": "up"}

HEIGHTS = (
    MessageLayout("posestamped", {"height": "pose.position.z"}, defaults=METRES),
    MessageLayout("posewithcovariancestamped", {"height": "pose.pose.position.z"}, defaults=METRES),
    MessageLayout("odometry", {"height": "pose.pose.position.z"}, defaults=METRES),
)
"""Positive up or down by the name of their frame."""

DEPTH = (
    MessageLayout("fluidpressure", {"pressure": "fluid_pressure"}, recognised="by type", defaults={"unit": "Pa"}),
    MessageLayout(
        "depthpressure",  # ds_sensor_msgs
        own_columns("depth"),
        recognised="by type",
        defaults=METRES,
        no_data_values={"depth": (-9999.0,)},
    ),
    MessageLayout(
        "depth", own_columns("depth"), recognised="by type", defaults=METRES
    ),  # riptide_msgs, uuv_sensor_msgs
    MessageLayout("depthsensor", own_columns("depth"), recognised="by type", defaults=METRES),  # holoocean_interfaces
    MessageLayout("float64", {"depth": "data"}, topic=r"rel_alt$", recognised="only when named", defaults=UP),  # mavros
    MessageLayout("float64", {"depth": "data"}, defaults=METRES),
    MessageLayout("float32", {"depth": "data"}, defaults=METRES),
    MessageLayout(
        "ahrs", {"depth": "depth", "ahrs": "fom_ahrs"}, {}, "only when named", METRES, stamp="system_timestamp"
    ),  # Nortek Nucleus
    *only_when_named(HEIGHTS),
    MessageLayout("depth", own_columns("pressure"), recognised="by type", defaults={"unit": "Pa"}),
    MessageLayout("depth", {"pressure": "pressure_pa"}, recognised="by type", fixed={"unit": "Pa"}),
    MessageLayout("depth", {"depth": "depth_m"}, recognised="by type", fixed={"unit": "m", "positive": "down"}),
)
