"""What the name of a topic, file or column suggests."""

import re
from collections.abc import Mapping

GPS_ITSELF = r"gps|gnss|navsat|global_position"
HINTS: Mapping[str, str] = {  # PX4 and ArduSub take a DVL for visual odometry
    "dvl": r"dvl|doppler|velocity_report|bottom_?(track|lock)|nortek|a50|a125|vehicle_visual_odometry",
    "compass": r"[ck]ompass|(?:^|[/_ ])kurs|heading|hdg|hdt|ahrs|imu|gyro|euler|(?:^|[/_ ])att(?:itude)?(?:[/_ ]|$)",
    "usbl": r"usbl|ssbl|sea_?trac|evo_?logics|sinaps|modem|ugps|acoustic|ranger|(?:hi|mu)_?pap|waterlinked/fix|"
    r"positions/|subsonus|track_?point|easy_?trak|posidonia|micron_?nav|rovl|beacon|transponder|track_?link|scout_?pro|"
    r"(?:^|[/_ ])(?:apos|gaps|s2_?c|tp|bac|buc)(?:[/_ ]|$)",  # the last two are French for ultra-short baseline
    "gps": rf"{GPS_ITSELF}|fix",
    "depth": r"depth|pressure",
}
"""Words of topic names that suggest a role."""

NO_SENSOR = re.compile(
    r"(^|[/_])(usbldr|(?<!acoustic[/_])filtered|(?<!vehicle_visual_)odometry|odom|ekf|ukf|estimate|estimated|"
    r"ground_?truth|truth|gt|sim|setpoint|cmd|cmd_vel)($|[/_])"
)
"""Words of topic names that suggest computed values, or simulated ones beside the sensors."""

SHIP = re.compile(r"(^|[/_])(ship|vessel|mothership|boat|topside|tender)($|[/_])")
"""Words of topic names that suggest a sensor of the ship, which says nothing about the vehicle."""

SECOND_CHOICE = re.compile(r"data_raw$|global_position/global$|acoustic[/_]filtered$")
"""Ends of topic names that rank last: an Imu without orientation; what mavros and Water Linked's UGPS computed."""

PART = re.compile(r"[-_. ]+\d[\dTZ:_-]*(?=/|$)")
"""The number or date of a part in the name of a topic: "/dvl_001", "/dive_2/usbl"."""


def names_ship(name: str) -> bool:
    """Return whether the name of a topic suggests a sensor of the ship: "/ship/gps", "/ShipGPS"."""
    return bool(SHIP.search(re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", name).lower()))


def suggested_sensors(name: str) -> set[str]:
    """Return the sensors that a topic's name suggests; a "fix" is a GPS fix unless the name suggests USBL."""
    name = name.lower()
    hints = {sensor for sensor, words in HINTS.items() if re.search(words, name)}
    return hints - {"gps"} if "usbl" in hints and not re.search(GPS_ITSELF, name) else hints


def without_numbers(name: str) -> str:
    """Return the name of a topic without the numbers that distinguish parts of it."""
    return PART.sub("", name)
