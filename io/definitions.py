"""Message definitions that a log may lack: those of ROS 2 itself, and of the few navigation types that we know."""

from functools import cache

from rosbags.typesys import Stores, TypesysError, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

# The fields of marine_acoustic_msgs/msg/Dvl (apl-ocean-engineering/marine_msgs); no ROS distribution brings it.
MARINE_DVL = """\
uint8 DVL_MODE_BOTTOM=1
uint8 DVL_MODE_WATER=2
uint8 DVL_TYPE_PISTON=0
uint8 DVL_TYPE_PHASED_ARRAY=1
std_msgs/Header header
uint8 velocity_mode
uint8 dvl_type
geometry_msgs/Vector3 velocity
float64[9] velocity_covar
float64 altitude
float64 course_gnd
float64 speed_gnd
uint8 num_good_beams
float32 sound_speed
bool beam_ranges_valid
bool beam_velocities_valid
geometry_msgs/Vector3[4] beam_unit_vec
float64[4] range
float32[4] range_covar
float32[4] beam_quality
float32[4] beam_velocity
float32[4] beam_velocity_covar
"""
# The fields of dvl_msgs/msg/DVL (paagutie/dvl_msgs) since 2025: Water Linked's report.
DVL_BEAM = """\
int64 id
float64 velocity
float64 distance
float64 rssi
float64 nsd
bool valid
"""
DVL = """\
std_msgs/Header header
float64 time
geometry_msgs/Vector3 velocity
float64 fom
float64[] covariance
float64 altitude
dvl_msgs/DVLBeam[] beams
bool velocity_valid
int64 status
int64 time_of_validity
int64 time_of_transmission
string form
"""
DEFINITIONS = {
    "marine_acoustic_msgs/msg/Dvl": MARINE_DVL,
    "dvl_msgs/msg/DVLBeam": DVL_BEAM,
    "dvl_msgs/msg/DVL": DVL,
}


@cache
def known_types(ros_version: int) -> Typestore:
    """Return the standard types of ROS 1 (Noetic) or ROS 2 (Humble) and those of DEFINITIONS."""
    store = get_typestore(Stores.ROS1_NOETIC if ros_version == 1 else Stores.ROS2_HUMBLE)
    for name, text in DEFINITIONS.items():
        store.register(get_types_from_msg(text, name))
    return store


def definition_of(type_name: str) -> str | None:
    """Return the definition of a ROS 2 type and of all types in it, None where it is not known."""
    name = type_name if type_name.count("/") > 1 else type_name.replace("/", "/msg/")  # the first rosbag2: pkg/Type
    try:
        return known_types(2).generate_msgdef(name, ros_version=2)[0]
    except (TypesysError, KeyError):
        return None
