"""Axes, signs and units of DVL, compass and depth: simulate +x by hand, read +x back."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from logs import codes, logged, logged_csv, read_as, refusal
from recordings import (
    DVL,
    HEADING,
    IMU,
    MARINE,
    ODOMETRY,
    SECOND,
    T0,
    TWIST_COVARIANCE,
    Row,
    pressure,
    record,
    twist,
    write_csv,
    yaw,
)
from usbldr.filters.errors import LogError, UsageError
from usbldr.io.provenance import Convention
from usbldr.io.reading.read import read_log
from usbldr.io.units import PASCALS_PER_UNIT


def body(table: pd.DataFrame) -> list[float]:
    """Starboard, forward, up of the first record."""
    return [float(table[c].iloc[0]) for c in ("starboard_mps", "forward_mps", "up_mps")]


def marine(time_ns: int, beams: int = 4, **more: Any) -> Row:
    values = {"header.stamp": time_ns, "velocity.x": 1.0, "velocity.y": 0.2, "velocity_mode": 1}
    values |= {"num_good_beams": beams, "velocity_covar": np.full(9, -1.0)}
    return time_ns, "/dvl/data", MARINE, values | {path.replace("__", "."): value for path, value in more.items()}


def water_linked(time_ns: int, more: Mapping[str, Any]) -> Row:
    values = {"header.stamp": time_ns, "velocity.x": 1.0, "velocity.y": 0.5, "velocity_valid": True, "fom": 0.03}
    return time_ns, "/dvl/data", DVL, {**values, **more}


def number(value: float, topic: str = "/heading") -> Row:
    return T0, topic, HEADING, {"data": value}


def tilted(*yaw_pitch_roll_deg: float) -> Row:
    """Return an Imu that is turned by each angle about the turned axes."""
    x, y, z, w = Rotation.from_euler("ZYX", yaw_pitch_roll_deg, degrees=True).as_quat()
    turn = {"orientation.x": x, "orientation.y": y, "orientation.z": z, "orientation.w": w}
    return T0, "/imu", IMU, {"header.stamp": T0, **turn}


FORWARD_2_STARBOARD_1_UP_3 = {
    "FSD": (2, 1, -3),
    "FRD": (2, 1, -3),
    "FLU": (2, -1, 3),
    "FPU": (2, -1, 3),
    "SFU": (1, 2, 3),
    "BSU": (-2, 1, 3),
    "UPB": (3, -1, -2),
}
SIN, COS = math.sin(math.radians(30)), math.cos(math.radians(30))
BAR_M = 1e5 / (1025 * 9.80665)  # of sea water
SPEED = "[dvl]\nsound_speed_mps = 1545.0"


@pytest.mark.parametrize(
    ("row", "toml", "expected"),
    [
        *((twist(T0, *xyz), f'[dvl]\naxes = "{axes}"', [1, 2, 3]) for axes, xyz in FORWARD_2_STARBOARD_1_UP_3.items()),
        # the bow moves at 1 m/s; an FRD instrument turned 30 deg to starboard sees it 30 deg to its left
        (twist(T0, COS, -SIN), '[dvl]\naxes = "FRD"\nmount_deg = 30', [0, 1]),
        # the formula of TURBOT's authors, Rz(135 deg) (vx, -vy), x forward, y starboard: (-0.4 - 0.3, 0.4 - 0.3) / √2
        (twist(T0, 0.4, -0.3), '[dvl]\naxes = "FLU"\nmount_deg = 135', [0.1 * 0.5**0.5, -0.7 * 0.5**0.5]),
        (twist(T0, 2.02, 0.0), "[dvl]\nscale_error = 0.01", [0, 2]),
        # speed = Doppler shift x speed of sound / (2 x frequency), up to the beam's angle
        (marine(T0, sound_speed=1500.0), "", [0.2, 1]),
        (marine(T0, sound_speed=1500.0), SPEED, [0.206, 1.03]),
        (marine(T0, sound_speed=1484.0), SPEED, [0.2 * 1545 / 1484, 1545 / 1484]),  # what each record assumed
        (marine(T0, sound_speed=0.0), SPEED, [0.206, 1.03]),  # none recorded: the usual 1500 m/s
        (marine(T0, sound_speed=1500.0), f"{SPEED}\nassumed_sound_speed_mps = 1400.0",
         [0.2 * 1545 / 1400, 1545 / 1400]),
        *((yaw(T0, ccw), "", [heading]) for ccw, heading in ((0, 90), (90, 0), (180, 270), (-45, 135))),
        (yaw(T0, 30), '[compass]\nconvention = "NED"', [30]),
        (tilted(40, -20, 10), "", [50]),
        (number(361.0), "[compass]\nbias_deg = 2.0", [359]),
        (number(350.0), "[compass]\ndeclination_deg = 15.6", [5.6]),
        (pressure(T0, 201325.0), "", [BAR_M]),
        *(
            (pressure(T0, 201325.0 / pascals), f'[depth]\nunit = "{unit}"', [BAR_M])
            for unit, pascals in PASCALS_PER_UNIT.items()
        ),
        (number(-4.0, "/depth"), '[depth]\npositive = "up"', [4]),
    ],
)  # fmt: skip
def test_a_record_is_read_as_its_conventions_say(tmp_path: Path, row: Row, toml: str, expected: list[float]) -> None:
    (role, table), *_ = logged(tmp_path, [row], toml).tables.items()

    column = {"compass": "heading_deg", "depth": "depth_m"}
    found = body(table) if role == "dvl" else table[column[role]].tolist()
    assert found[: len(expected)] == pytest.approx(expected)


IN_RADIANS = '/heading: no value is above 6.3; if they are radians, state [compass] unit = "rad"'
NO_HEADER = "/heading: its type has no header, so it is timed by log time"
UNKNOWN = {"orientation_covariance": np.array([-1.0] + [0.0] * 8)}
NO_ORIENTATION = [(T0 + k, "/imu", IMU, {**yaw(T0 + k, 10)[3], **UNKNOWN}) for k in range(2)]
NO_LOCK = [twist(T0 + k * SECOND, *((327.67, 327.67) if k % 3 else (1.0, 0.1))) for k in range(12)]


@pytest.mark.parametrize(
    ("rows", "toml", "used", "said"),
    [
        ([number(3.0)], "", {"compass": 1}, {"HEADING-UNIT": IN_RADIANS, "NO-HEADER": NO_HEADER}),
        ([*NO_ORIENTATION, (T0 + 5, "/imu", IMU, {"header.stamp": T0 + 5}), yaw(T0 + 9, 10)], "", {"compass": 1},
         {"COMPASS-INVALID": "/imu: 3 of 4 records are invalid and left out "
         "(2 without orientation (covariance -1), 1 zero quaternion)"}),
        ([yaw(T0 + k * SECOND, 30.0) for k in range(3)], '[compass]\nunit = "rad"', {"compass": 3},
         {"KEY-UNUSED": "/imu: unit of the configuration is not used; its records are not plain angles"}),
        # one number for no bottom lock is no velocity in mm/s
        (NO_LOCK, "", {"dvl": 12},
         {"DVL-INVALID": "/dvl: 8 of 12 records are invalid and not used (8 faster than 20 m/s)"}),
        ([pressure(T0, 1013.0)], "", {},
         {"DEPTH-UNIT": '/pressure: not used as depth: a median of 1013 cannot be Pa; state unit = "hPa", in which the '
          "least is that of the air, under [depth]"}),
    ],
    ids=["perhaps radians", "no orientation", "a quaternion", "no bottom lock", "no pascals"],
)  # fmt: skip
def test_numbers_that_are_in_doubt_are_pointed_out_or_left_out(tmp_path, rows, toml, used, said):
    log = logged(tmp_path, rows, toml)

    assert {role: len(table) for role, table in log.tables.items()} == used
    assert said.items() <= codes(log).items()


@pytest.mark.parametrize(
    ("rows", "toml", "valid"),
    [
        ([marine(T0, beams=0), marine(T0 + 1, beams=0)], "", [True, True]),  # a field that nobody fills
        ([marine(T0, beams=3), marine(T0 + 1)], "min_good_beams = 4", [False, True]),
        ([water_linked(T0, {"velocity.x": 0.0, "velocity.y": 0.0})], "", [True]),  # at rest, and it says so
    ],
)
def test_a_dvl_record_is_valid_if_its_own_word_and_the_configuration_say_so(tmp_path, rows, toml, valid):
    assert list(logged(tmp_path, rows, f"[dvl]\n{toml}").tables["dvl"]["valid"]) == valid


def test_a_csv_folder_in_millimetres_or_radians_is_told_how_its_columns_are_named(tmp_path: Path) -> None:
    rows = "".join(f"{T0 + k * SECOND},{k},1500,200\n" for k in range(5))
    folder = write_csv(tmp_path / "dive", dvl="time_ns,none,starboard_mps,forward_mps\n" + rows)

    said = refusal(LogError, read_log, folder)

    advice = said.partition("state ")[2].removesuffix(" under [dvl]").replace(", axes", "\naxes")
    log = read_as(folder, "[dvl]\n" + advice.replace(" and unit", "\nunit"))
    assert log.tables["dvl"]["forward_mps"].tolist() == [0.2] * 5


def test_with_water_track_bottom_track_is_not_used_and_without_it_the_key_is_named(tmp_path: Path) -> None:
    rows = [marine(T0 + k * SECOND, velocity_mode=mode) for k, mode in enumerate((2, 1, 2))]

    log = logged(tmp_path, rows, '[dvl]\ntrack = "water"')

    assert list(log.tables["dvl"]["valid"]) == [True, False, True]
    assert "1 bottom track" in codes(log)["DVL-INVALID"]
    assert Convention("track", "water", "configuration") in log.provenance["dvl"].conventions
    assert log.parameters.water_track
    with pytest.raises(LogError, match=r'2 water track; to use .* state track = "water" under \[dvl\]'):
        logged(tmp_path, [rows[0], rows[2]])


def test_a_dvl_record_is_as_old_as_its_transmission_took(tmp_path: Path) -> None:
    ages = {"time_of_validity": 5_000_000, "time_of_transmission": 5_189_000}
    rows = [water_linked(T0 + k * SECOND, ages) for k in range(3)]

    log = logged(tmp_path, [*rows, yaw(T0, 0), yaw(T0 + 2 * SECOND, 0)])
    as_stamped = logged(tmp_path, [*rows, yaw(T0, 0), yaw(T0 + 2 * SECOND, 0)], '[dvl]\ntime = "header"')

    assert log.start_ns == T0 - 189_000_000
    np.testing.assert_allclose(log.tables["dvl"]["time_s"], [0, 1, 2])
    np.testing.assert_allclose(log.tables["compass"]["time_s"], [0.189, 2.189])
    assert log.convention("dvl", "age_s").value == pytest.approx(0.189)
    assert as_stamped.start_ns == T0


@pytest.mark.parametrize("kind", [TWIST_COVARIANCE, ODOMETRY])
def test_a_negative_covariance_makes_a_twist_invalid(tmp_path: Path, kind: str) -> None:
    covariances = [np.eye(1, 36)[0] * variance for variance in (0.0004, -1.0)]
    values = [{"twist.twist.linear.x": 1.0, "twist.covariance": covariance} for covariance in covariances]
    rows = [record("/dvl", kind, one, k) for k, one in enumerate(values)]

    log = logged(tmp_path, rows, '[dvl]\nsd_mps = "message"')

    assert list(log.tables["dvl"]["valid"]) == [True, False]
    assert log.tables["dvl"]["sd_mps"].iloc[0] == pytest.approx(0.02)


SECTION, LOG = "{folder}/usbldr.toml: [{section}] ", "{folder}/dive.mcap: "


@pytest.mark.parametrize(
    ("rows", "toml", "fault", "said"),
    [
        ([marine(T0, 1), marine(T0 + 1, 1), marine(T0 + 2, velocity__y=math.inf)], "[dvl]", LogError,
         LOG + "all 3 records of /dvl/data (dvl) are invalid: 1 not a number, 2 fewer than 3 good beams"),
        ([twist(T0, 800.0, 12.0)], "[dvl]", LogError, LOG + "all 1 records of /dvl (dvl) are invalid: 1 faster than "
         '20 m/s; if they are in mm/s, state unit = "mm/s" under [dvl]'),
        ([marine(T0)], "[dvl]\nassumed_sound_speed_mps = 1500.0", UsageError,
         SECTION.replace("] ", "]: ") + "assumed_sound_speed_mps needs the true one beside it: state sound_speed_mps"),
        ([twist(T0, 1.0, 0.0)], "[dvl]\nmin_good_beams = 3", UsageError,
         SECTION + "min_good_beams: /dvl (geometry_msgs/msg/TwistStamped) has no such field"),
        ([pressure(T0, 201325.0)], '[depth]\nunit = "m"', UsageError,
         SECTION + 'unit = "m": /pressure holds pressures (Pa, hPa, kPa, dbar, bar, psi)'),
        ([pressure(T0, 201325.0)], '[depth]\npositive = "up"', UsageError,
         SECTION + "positive: /pressure holds pressures, to which it does not apply"),
        ([number(4.0, "/depth")], '[depth]\ntopic = "/depth"\nunit = "Pa"', UsageError,
         SECTION + 'unit = "Pa": /depth holds depths in m'),
        ([number(4.0, "/depth")], '[depth]\ntopic = "/depth"\nsurface_pa = 0', UsageError,
         SECTION + "surface_pa: /depth holds depths, to which it does not apply"),
    ],
)  # fmt: skip
def test_what_the_records_refute_is_one_sentence_with_its_file(tmp_path, rows, toml, fault, said):
    expected = said.format(folder=tmp_path, section=toml[1:].partition("]")[0])
    assert refusal(fault, logged, tmp_path, rows, toml) == expected


def test_a_dvl_in_millimetres_is_refused_though_it_lay_still_at_first(tmp_path: Path) -> None:
    """At rest its noise of some mm/s would pass for a vehicle's speed in m/s."""
    rows = [twist(T0 + k * SECOND, (-1) ** k * 4.0 if k < 6 else 900.0 + k, 3.0) for k in range(10)]

    log = logged(tmp_path, rows, '[dvl]\nunit = "mm/s"')

    assert refusal(LogError, logged, tmp_path, rows) == (
        f"{tmp_path / 'dive.mcap'}: 4 of 10 records of /dvl (dvl) are faster than 20 m/s; "
        'state unit = "mm/s" under [dvl] if they are mm/s, unit = "m/s" if not'
    )
    assert log.tables["dvl"]["forward_mps"].max() == pytest.approx(0.909)


@pytest.mark.parametrize(("toml", "sd_mps"), [("", math.nan), ("[dvl]\nsd_mps = 0.1", 0.1)])
def test_the_dvl_noise_is_left_open_unless_somebody_states_it(tmp_path: Path, toml: str, sd_mps: float) -> None:
    np.testing.assert_array_equal(logged(tmp_path, [twist(T0, 1.0, 0.0)], toml).tables["dvl"]["sd_mps"], sd_mps)


def test_gauge_pressures_are_not_taken_for_absolute_ones(tmp_path: Path) -> None:
    """From the surface down to 19.9 m: all but the first ten metres could be absolute pressures."""
    rows = [pressure(T0 + k, k * 1025 * 9.80665 / 10) for k in range(200)]

    unsaid, said = logged(tmp_path, rows), logged(tmp_path, rows, "[depth]\nsurface_pa = 0")

    assert "depth" not in unsaid.tables
    said_why = "is below air pressure: gauge pressures need surface_pa = 0 under [depth]"
    assert codes(unsaid)["DEPTH-UNIT"].endswith(said_why)
    assert said.tables["depth"]["depth_m"].to_numpy() == pytest.approx(np.arange(200) / 10)


def test_keys_that_the_column_names_settle_are_said_not_to_act(tmp_path: Path) -> None:
    sheet = "time_ns,starboard_mps,forward_mps\n0,0.1,1.0\n200000000,0.1,1.0"

    log = logged_csv(tmp_path, '[dvl]\naxes = "FRD"\nmount_deg = 90', dvl=sheet)

    assert codes(log) == {
        "KEY-UNUSED": '/dvl: axes = "FRD" of the configuration is not used; its columns are SFU; name them by columns '
        "to read them otherwise (docs/configuration.md#any-columns-any-message)"
    }
    assert body(log.tables["dvl"])[:2] == pytest.approx([1.0, -0.1])


def test_depths_that_count_up_are_read_as_the_advice_says(tmp_path: Path) -> None:
    rows = "time_ns,depth_m\n" + "".join(f"{T0 + k * SECOND},{-20 - k}\n" for k in range(3))
    said = codes(logged_csv(tmp_path, "", depth=rows))["DEPTH-SIGN"]
    advice = said.split("state ")[1].replace(" and ", "\n").removesuffix(" under [depth]")

    log = logged_csv(tmp_path, f"schema = 1\n[depth]\n{advice}\n", depth=rows)

    assert log.tables["depth"]["depth_m"].tolist() == [20.0, 21.0, 22.0]
    assert "DEPTH-SIGN" not in codes(log)
    named = codes(logged_csv(tmp_path, "", depth=rows.replace("depth_m", "Depth [m]")))["DEPTH-SIGN"]
    assert named.endswith('state its columns of time and depth and positive = "up" under [depth]')


def test_depths_that_no_vehicle_reaches_and_leaves_are_left_out(tmp_path: Path) -> None:
    """A sensor that writes 0 for no reading; the vehicle dives and climbs at 2 m/s."""
    depth_m = 60.0 - np.abs(60.0 - 2.0 * np.arange(60))
    lost = np.isin(np.arange(60), [20, 31, 32, 45])
    rows = "".join(f"{T0 + k * SECOND},{z:.1f}\n" for k, z in enumerate(np.where(lost, 0.0, depth_m)))

    log = logged_csv(tmp_path, "", depth="time_ns,depth_m\n" + rows)

    assert log.tables["depth"]["depth_m"].tolist() == depth_m[~lost].tolist()
    assert "(4 far from their neighbours)" in codes(log)["DEPTH-INVALID"]
