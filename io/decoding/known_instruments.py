"""ROS 2 messages of the drivers of instruments: their fields, in the order of the bytes (see known_messages).

The order is that of the drivers' own .msg files (NortekSupport/nucleus_driver: interfaces; SBG-Systems/sbg_ros2_driver;
septentrio-gnss/septentrio_gnss_driver; dawonn/vectornav: vectornav_msgs; KumarRobotics/ublox: ublox_msgs). If a part of
a type has had several layouts, each has a name of its own here (SbgEkfStatus2020).
"""

from collections.abc import Mapping

HEADER = "std_msgs/Header header;"


def each(kind: str, names: str) -> str:
    """Return the definition of fields of one type."""
    return "".join(f"{kind} {name}; " for name in names.split())


NUCLEUS = "builtin_interfaces/Time system_timestamp; bool posix_time; uint32 timestamp; uint32 microseconds; "
NUCLEUS_TRACK = (
    NUCLEUS
    + each("bool", " ".join(f"beam_{k}_{of}_valid" for of in ("velocity", "distance", "fom") for k in (1, 2, 3)))
    + each("bool", " ".join(f"{axis}_{of}_valid" for of in ("velocity", "fom") for axis in "xyz"))
    + "uint32 serial_number; "
    + each("float32", "sound_speed temperature pressure")
    + each(
        "float32",
        " ".join(f"{of}_beam_{k}" for of in ("velocity", "distance", "fom", "dt", "time_vel") for k in (1, 2, 3)),
    )
    + each("float32", " ".join(f"{of}_{axis}" for of in ("velocity", "fom") for axis in "xyz"))
    + "float32 dt_xyz; "
)
NUCLEUS_AHRS = (
    f"{NUCLEUS} uint32 serial_number; uint8 operation_mode; "
    + each("float32", "fom_ahrs fom_fc1 roll pitch heading quaternion_w quaternion_x quaternion_y quaternion_z")
    + each("float32", " ".join(f"rotation_matrix_{k}" for k in range(9)))
    + each("float32", "declination depth")
)
NUCLEUS_INS = (
    f"{NUCLEUS_AHRS} float32 fom_ins; bool lat_long_is_valid; "
    + each("float32", "course_over_ground temperature pressure altitude")
    + each("float64", "latitude longitude")
    + each(
        "float32",
        " ".join(f"{of}_{axis}" for of in ("position_frame", "velocity_ned", "velocity_nucleus") for axis in "xyz"),
    )
    + each("float32", "speed_over_ground turn_rate_x turn_rate_y turn_rate_z")
)
SBG_EULER = f"{HEADER} uint32 time_stamp; geometry_msgs/Vector3 angle; geometry_msgs/Vector3 accuracy; "
SBG_QUATERNION = SBG_EULER.replace("Vector3 angle", "Quaternion quaternion")
SBG_NAV = f"""{HEADER} uint32 time_stamp; geometry_msgs/Vector3 velocity; geometry_msgs/Vector3 velocity_accuracy;
    float64 latitude; float64 longitude; float64 altitude; float32 undulation; geometry_msgs/Vector3
    position_accuracy; """
SBG_VALID = "uint8 solution_mode; " + each("bool", "attitude_valid heading_valid velocity_valid position_valid")
SBG_STATUS = {  # by the type that stands for each layout of SbgEkfStatus: the bools after those of SBG_VALID
    # the longest is first, because up to 3 bytes that are left at the end are taken for padding
    "SbgEkfStatus2024": """vert_ref_used mag_ref_used gps1_vel_used gps1_pos_used gps1_hdt_used gps2_vel_used
        gps2_pos_used gps2_hdt_used odo_used dvl_bt_used dvl_wt_used user_pos_used user_vel_used user_heading_used
        usbl_used air_data_used zupt_used align_valid depth_used""",
    "SbgEkfStatus": """vert_ref_used mag_ref_used gps1_vel_used gps1_pos_used gps1_hdt_used gps2_vel_used gps2_pos_used
        gps2_hdt_used odo_used dvl_bt_used dvl_wt_used vel1_used usbl_used air_data_used zupt_used align_valid
        depth_used zaru_used""",  # since November 2025
    "SbgEkfStatus2020": """vert_ref_used mag_ref_used gps1_vel_used gps1_pos_used gps1_course_used gps1_hdt_used
        gps2_vel_used gps2_pos_used gps2_course_used gps2_hdt_used odo_used""",
}
SBG_GPS = """uint32 gps_tow; float64 latitude; float64 longitude; float64 altitude; float32 undulation;
    geometry_msgs/Vector3 position_accuracy; """
SBG_GPS_STATUS = "uint8 status; uint8 type; "
BLOCK = f"{HEADER} BlockHeader block_header; "
VECTORNAV = f"{HEADER} uint16 group_fields; "
UBLOX_PVT = (
    "uint32 iTOW; uint16 year; "
    + each("uint8", "month day hour min sec valid")
    + "uint32 tAcc; int32 nano; "
    + each("uint8", "fixType flags flags2 numSV")
    + each("int32", "lon lat height hMSL")
    + "uint32 hAcc; uint32 vAcc; "
    + each("int32", "velN velE velD gSpeed heading")
    + "uint32 sAcc; uint32 headAcc; uint16 pDOP; uint8[6] reserved1; "
)

INSTRUMENTS: Mapping[str, tuple[str, ...]] = {
    **{
        f"interfaces/msg/{kind}": (
            NUCLEUS_TRACK,
            f"{NUCLEUS_TRACK} float32 time_vel_xyz",
        )  # since November 2025, before
        for kind in ("BottomTrack", "WaterTrack")
    },
    "interfaces/msg/AHRS": (NUCLEUS_AHRS,),
    "interfaces/msg/INS": (NUCLEUS_INS,),
    **{f"sbg_driver/msg/{name}": (SBG_VALID + each("bool", more),) for name, more in SBG_STATUS.items()},
    "sbg_driver/msg/SbgEkfEuler": tuple(f"{SBG_EULER} {status} status" for status in SBG_STATUS),
    "sbg_driver/msg/SbgEkfQuat": tuple(f"{SBG_QUATERNION} {status} status" for status in SBG_STATUS),
    "sbg_driver/msg/SbgEkfNav": tuple(f"{SBG_NAV} {status} status" for status in SBG_STATUS),
    "sbg_driver/msg/SbgGpsPosStatus": (
        f"{SBG_GPS_STATUS} uint8 ifm; uint8 spoofing; uint8 osnma; "
        + each(
            "bool", "gps_l1_used gps_l2_used gps_l5_used glo_l1_used glo_l2_used glo_l3_used gal_e1_used gal_e5a_used"
        )
        + each("bool", "gal_e5b_used gal_e5alt_used gal_e6_used bds_b1_used bds_b2_used bds_b3_used")
        + each("bool", "qzss_l1_used qzss_l2_used qzss_l5_used"),
    ),
    "sbg_driver/msg/SbgGpsPosStatus2021": (
        SBG_GPS_STATUS + each("bool", "gps_l1_used gps_l2_used gps_l5_used glo_l1_used glo_l2_used"),
    ),
    "sbg_driver/msg/SbgGpsPos": (
        f"""{HEADER} uint32 time_stamp; SbgGpsPosStatus status; {SBG_GPS} uint8 num_sv_tracked; uint8 num_sv_used;
        uint16 base_station_id; uint16 diff_age""",
        f"""{HEADER} uint32 time_stamp; SbgGpsPosStatus2021 status; {SBG_GPS} uint8 num_sv_used; uint16
        base_station_id; uint16 diff_age""",
    ),
    "septentrio_gnss_driver/msg/BlockHeader": (
        "uint8 sync_1; uint8 sync_2; uint16 crc; uint16 id; uint8 revision; uint16 length; uint32 tow; uint16 wnc",
    ),
    "septentrio_gnss_driver/msg/AttEuler": (
        f"{BLOCK} uint8 nr_sv; uint8 error; uint16 mode; "
        + each("float32", "heading pitch roll pitch_dot roll_dot heading_dot"),
    ),
    "septentrio_gnss_driver/msg/INSNavGeod": (
        f"{BLOCK} uint8 gnss_mode; uint8 error; uint16 info; uint16 gnss_age; "
        + each("float64", "latitude longitude height")
        + "float32 undulation; uint16 accuracy; uint16 latency; uint8 datum; uint16 sb_list; "
        + each("float32", "latitude_std_dev longitude_std_dev height_std_dev latitude_longitude_cov")
        + each("float32", "latitude_height_cov longitude_height_cov heading pitch roll heading_std_dev pitch_std_dev")
        + each("float32", "roll_std_dev heading_pitch_cov heading_roll_cov pitch_roll_cov ve vn vu ve_std_dev")
        + each("float32", "vn_std_dev vu_std_dev ve_vn_cov ve_vu_cov vn_vu_cov"),
    ),
    "septentrio_gnss_driver/msg/PVTGeodetic": (
        f"{BLOCK} uint8 mode; uint8 error; "
        + each("float64", "latitude longitude height")
        + each("float32", "undulation vn ve vu cog")
        + """float64 rx_clk_bias; float32 rx_clk_drift; uint8 time_system; uint8 datum; uint8 nr_sv; uint8 wa_corr_info;
        uint16 reference_id; uint16 mean_corr_age; uint32 signal_info; uint8 alert_flag; uint8 nr_bases; uint16
        ppp_info; uint16 latency; uint16 h_accuracy; uint16 v_accuracy; uint8 misc""",
    ),
    "vectornav_msgs/msg/InsStatus": (
        "uint8 mode; "
        + each("bool", "gps_fix time_error imu_error mag_pres_error gps_error gps_heading_ins gps_compass"),
    ),
    "vectornav_msgs/msg/TimeUTC": (each("uint8", "year month day hour min sec") + "uint16 ms",),
    "vectornav_msgs/msg/DOP": (each("float32", "g p t v h n e"),),
    "vectornav_msgs/msg/CommonGroup": (
        VECTORNAV
        + each("uint64", "timestartup timegps timesyncin")
        + "geometry_msgs/Vector3 yawpitchroll; geometry_msgs/Quaternion quaternion; "
        + "geometry_msgs/Vector3 angularrate; geometry_msgs/Point position; "
        + each("geometry_msgs/Vector3", "velocity accel imu_accel imu_rate magpres_mag")
        + each("float32", "magpres_temp magpres_pres deltatheta_dtime")
        + each("geometry_msgs/Vector3", "deltatheta_dtheta deltatheta_dvel")
        + "InsStatus insstatus; uint32 syncincnt; uint16 timegpspps",
    ),
    "vectornav_msgs/msg/GpsGroup": (
        VECTORNAV
        + "TimeUTC utc; uint64 tow; uint16 week; uint8 numsats; uint8 fix; "
        + each("geometry_msgs/Point", "poslla posecef")
        + each("geometry_msgs/Vector3", "velned velecef posu")
        + "float32 velu; uint32 timeu; uint8 timeinfo_status; int8 timeinfo_leapseconds; DOP dop",
    ),
    "vectornav_msgs/msg/InsGroup": (
        VECTORNAV
        + "InsStatus insstatus; "
        + each("geometry_msgs/Point", "poslla posecef")
        + each("geometry_msgs/Vector3", "velbody velned velecef magecef accelecef linearaccelecef")
        + "float32 posu; float32 velu",
    ),
    "ublox_msgs/msg/NavPVT": (f"{UBLOX_PVT} int32 headVeh; int16 magDec; uint16 magAcc",),
    "ublox_msgs/msg/NavPVT7": (UBLOX_PVT,),
}
"""Fields by type, the newest layout first, as far as bytes tell it from the others."""
