"""ROS 2 messages of navigation logs that are in no ROS distribution: their fields, in the order of the bytes.

A recording from before ROS 2 Iron carries no definitions. If the layout of a type has changed, the newest is first.
The order is that of the packages' own .msg files (ndahn, paagutie: dvl_msgs; apl-ocean-engineering:
marine_acoustic_msgs; patrykcieslak: stonefish_ros2; Iqua Robotics: cola2_msgs; smarc-project: smarc_msgs;
BYU-FROST-Lab: seatrac_interfaces; isabelleviraldo: seatrac_driver; GSO-soslab: acomms_msgs; swri-robotics: gps_msgs;
mavlink: mavros_msgs; ros-drivers: nmea_msgs; foxglove; ros-geographic-info; ctu-vras: compass; byu-holoocean).
"""

from collections.abc import Mapping

from usbldr.io.decoding.known_instruments import HEADER, INSTRUMENTS, each

GPS_NUMBERS = (  # of GPSFix, one after the other
    "latitude longitude altitude track speed climb pitch roll dip time gdop pdop hdop vdop tdop "
    "err err_horz err_vert err_track err_speed err_climb err_time err_pitch err_roll err_dip"
)
FIX = """float64 latitude; float64 longitude; float64 altitude; float64[9] position_covariance; uint8
    position_covariance_type;"""
SIMULATED_DVL = (  # uuv_simulator's DVL, copied by others
    f"{HEADER} geometry_msgs/Vector3 velocity; float64[9] velocity_covariance; float64 altitude; DVLBeam[] beams"
)
SIMULATED_BEAM = (
    "float64 range; float64 range_covariance; float64 velocity; float64 velocity_covariance; "
    "geometry_msgs/PoseStamped pose"
)
SIMULATORS = ("stonefish_ros2", "cola2_msgs", "smarc_msgs", "uuv_sensor_ros_plugins_msgs")
WATER_LINKED = f"{HEADER} float64 time; geometry_msgs/Vector3 velocity; float64 fom;"
USBL_DATA = """int32 remote_address; geometry_msgs/Vector3 xyz; geometry_msgs/Vector3 enu; geometry_msgs/Quaternion
    orientation; float32 propagation_time; int32 rssi; int32 integrity; float32 accuracy"""
GPS_RAW = f"""{HEADER} uint8 fix_type; int32 lat; int32 lon; int32 alt; uint16 eph; uint16 epv; uint16 vel; uint16
        cog; uint8 satellites_visible; int32 alt_ellipsoid; uint32 h_acc; uint32 v_acc; uint32 vel_acc; int32
        hdg_acc;"""
AZIMUTH = f"{HEADER} float64 azimuth; float64 variance; uint8 unit; uint8 orientation; uint8 reference"

_FIELDS: Mapping[str, tuple[str, ...]] = {
    "marine_acoustic_msgs/msg/Dvl": (
        f"""uint8 DVL_MODE_BOTTOM=1; uint8 DVL_MODE_WATER=2; uint8 DVL_TYPE_PISTON=0; uint8 DVL_TYPE_PHASED_ARRAY=1;
        {HEADER} uint8 velocity_mode; uint8 dvl_type; geometry_msgs/Vector3 velocity; float64[9] velocity_covar;
        float64 altitude; float64 course_gnd; float64 speed_gnd; uint8 num_good_beams; float32 sound_speed; bool
        beam_ranges_valid; bool beam_velocities_valid; geometry_msgs/Vector3[4] beam_unit_vec; float64[4] range;
        float32[4] range_covar; float32[4] beam_quality; float32[4] beam_velocity; float32[4]
        beam_velocity_covar""",
    ),
    "dvl_msgs/msg/DVL": (
        f"""{WATER_LINKED} float64[] covariance; float64 altitude; DVLBeam[] beams; bool velocity_valid; int64
        status; int64 time_of_validity; int64 time_of_transmission; string form""",  # since June 2025
        f"{WATER_LINKED} float64 altitude; DVLBeam[] beams; bool velocity_valid; int64 status; string form",
    ),
    "dvl_msgs/msg/DVLBeam": ("int64 id; float64 velocity; float64 distance; float64 rssi; float64 nsd; bool valid",),
    **{f"{package}/msg/DVL": (SIMULATED_DVL,) for package in SIMULATORS},
    **{f"{package}/msg/DVLBeam": (SIMULATED_BEAM,) for package in SIMULATORS},
    "stonefish_ros2/msg/BeaconInfo": (
        f"""{HEADER} uint8 beacon_id; float32 range; float32 azimuth; float32 elevation; geometry_msgs/Point
        relative_position; geometry_msgs/Quaternion local_orientation; float32 local_depth""",
    ),
    "cola2_msgs/msg/DecimalLatLon": ("float64 latitude; float64 longitude",),
    "cola2_msgs/msg/NED": ("float64 north; float64 east; float64 depth",),
    "cola2_msgs/msg/RPY": ("float32 roll; float32 pitch; float32 yaw",),
    "cola2_msgs/msg/NavSts": (
        f"""{HEADER} DecimalLatLon global_position; DecimalLatLon origin; NED position; float32 altitude;
        geometry_msgs/Point body_velocity; RPY orientation; RPY orientation_rate; NED position_variance; RPY
        orientation_variance""",
    ),
    "cola2_msgs/msg/GPSData": (
        f"""{HEADER} string time_utc; float64 latitude; float64 longitude; int32 fix_quality; int32
        number_of_satellites; float32 hdop; float32 altitude; float32 geoidal_separation; float32 heading;
        float32 latitude_stdev; float32 longitude_stdev; float32 altitude_stdev; string raw_gpgga; string
        raw_gphdt; string raw_gpgst""",
    ),
    "smarc_msgs/msg/LatLonStamped": (f"{HEADER} float64 latitude; float64 longitude",),
    "smarc_msgs/msg/LatLonOdometry": (
        f"""{HEADER} geographic_msgs/GeoPose lat_lon_pose; float64[36] covariance; geometry_msgs/TwistWithCovariance
        twist""",
    ),
    "seatrac_interfaces/msg/ModemRec": (
        f"""{HEADER} uint8 msg_id; bool local_flag; bool position_enhanced; bool position_flt_error; uint8 dest_id;
        uint8 src_id; int16 attitude_yaw; int16 attitude_pitch; int16 attitude_roll; int16 depth_local; uint16
        vos; uint16 rssi; bool includes_range; uint32 range_count; int32 range_time; uint16 range_dist; bool
        includes_usbl; uint8 usbl_channels; int16[4] usbl_rssi; int16 usbl_azimuth; int16 usbl_elevation; int16
        usbl_fit_error; bool includes_position; int16 position_easting; int16 position_northing; int16
        position_depth; uint8 packet_len; uint8[30] packet_data; bool includes_remote_depth; int32 remote_depth;
        bool includes_remote_supply; uint16 remote_supply; bool includes_remote_temp; int16 remote_temp; bool
        includes_remote_attitude; int16 remote_yaw; int16 remote_pitch; int16 remote_roll""",
    ),
    "seatrac_driver/msg/AcousticFix": (
        """uint8 destination_id; uint8 source_id; bool range_valid; bool usbl_valid; bool position_valid; bool
        position_enhanced; bool position_filter_error; uint8 msg_type; float32 attitude_yaw; float32
        attitude_pitch; float32 attitude_roll; float32 depth_local; float32 vos; float32 rssi; uint32
        range_count; float32 range_time; float32 range_dist; float32 usbl_azimuth; float32 usbl_elevation;
        float32 usbl_fit_error; float32 position_easting; float32 position_northing; float32 position_depth""",
    ),
    "seatrac_driver/msg/TransceiverFixStatus": ("AcousticFix fix",),
    "seatrac_driver/msg/NavigationQueryResponseStatus": (
        """AcousticFix fix; bool query_depth; bool query_supply; bool query_temp; bool query_attitude; bool
        query_data; float32 remote_depth; float32 remote_supply; float32 remote_temp; float32 remote_yaw;
        float32 remote_pitch; float32 remote_roll; uint8 packet_length; uint8[] packet_data; bool local_flag""",
    ),
    "acomms_msgs/msg/UsblData": (
        f"{HEADER} float64 current_time; float64 measurement_time; {USBL_DATA}",
        f"{HEADER} float32 current_time; float32 measurement_time; {USBL_DATA}",
    ),
    "gps_msgs/msg/GPSStatus": (
        f"""{HEADER} uint16 satellites_used; int32[] satellite_used_prn; uint16 satellites_visible; int32[]
        satellite_visible_prn; int32[] satellite_visible_z; int32[] satellite_visible_azimuth; int32[]
        satellite_visible_snr; int16 status; uint16 motion_source; uint16 orientation_source; uint16
        position_source""",
    ),
    "gps_msgs/msg/GPSFix": (
        f"{HEADER} GPSStatus status; "
        + each("float64", GPS_NUMBERS)
        + "float64[9] position_covariance; uint8 position_covariance_type",
    ),
    "mavros_msgs/msg/GPSRAW": (
        f"{GPS_RAW} uint16 yaw; uint8 dgps_numch; uint32 dgps_age",
        f"{GPS_RAW} uint8 dgps_numch; uint32 dgps_age",  # before November 2021
    ),
    "mavros_msgs/msg/VfrHud": (
        f"""{HEADER} float32 airspeed; float32 groundspeed; int16 heading; float32 throttle; float32 altitude; float32
        climb""",
    ),
    "nmea_msgs/msg/Sentence": (f"{HEADER} string sentence",),
    "nmea_msgs/msg/Gpgga": (
        f"""{HEADER} string message_id; float64 utc_seconds; float64 lat; float64 lon; string lat_dir; string
        lon_dir; uint32 gps_qual; uint32 num_sats; float32 hdop; float32 alt; string altitude_units; float32
        undulation; string undulation_units; uint32 diff_age; string station_id""",
    ),
    "foxglove_msgs/msg/Color": ("float64 r; float64 g; float64 b; float64 a",),
    "foxglove_msgs/msg/KeyValuePair": ("string key; string value",),
    "foxglove_msgs/msg/LocationFix": (
        f"""builtin_interfaces/Time timestamp; string frame_id; {FIX} float64 heading; float64 heading_variance;
        float64 velocity_x; float64 velocity_y; float64 velocity_z; Color color; KeyValuePair[] metadata""",
        f"builtin_interfaces/Time timestamp; string frame_id; {FIX}",
        f"string frame_id; builtin_interfaces/Time timestamp; {FIX}",
    ),
    "geographic_msgs/msg/GeoPoint": ("float64 latitude; float64 longitude; float64 altitude",),
    "geographic_msgs/msg/GeoPointStamped": (f"{HEADER} GeoPoint position",),
    "geographic_msgs/msg/GeoPose": ("GeoPoint position; geometry_msgs/Quaternion orientation",),
    "compass_interfaces/msg/Azimuth": (AZIMUTH,),
    "compass_msgs/msg/Azimuth": (AZIMUTH,),
    "holoocean_interfaces/msg/AcousticBeaconSensor": (
        """int64 timestamp; string msg_type; int32 from_beacon; float32 azimuth; float32 elevation; float32 range;
        float32 z""",
    ),
    "holoocean_interfaces/msg/DVLSensorRange": (f"{HEADER} float32[4] range",),
    "holoocean_interfaces/msg/DepthSensor": (f"{HEADER} float32 depth",),
    **INSTRUMENTS,
}

KNOWN: Mapping[str, tuple[str, ...]] = {
    name: tuple("\n".join(" ".join(field.split()) for field in text.split(";")) for text in texts)
    for name, texts in _FIELDS.items()
}
"""Definitions by type; a nested type without a package is of the same package."""
