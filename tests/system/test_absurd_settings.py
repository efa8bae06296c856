"""Any number under any key, after any option, in any record: a run, findings, or one sentence; never a warning.

The keys are found in the section types, so that a new one is fuzzed from its first day. Logs of hardly a record are
among the odd ones.
"""

import datetime
import math
import random
import typing
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from types import UnionType

import numpy as np
import pytest
from click.testing import Result
from msgspec import Struct

from commands import run
from curved import curved_dive
from logs import codes
from recordings import HEADING, POSE_COVARIANCE, PRESSURE, SECOND, T0, TWIST_COVARIANCE, Row, fix, write_mcap, yaw
from usbldr.filters.errors import LogError, UsageError
from usbldr.io.provenance import Convention
from usbldr.io.reading.read import read_log
from usbldr.io.settings.sensor_sections import Configuration
from usbldr_cli.figures.run_figures import run_pictures

SECONDS = range(T0, T0 + 90 * SECOND, SECOND)
DEPTHS: list[Row] = [(t, "/depth", PRESSURE, {"header.stamp": t, "fluid_pressure": 150000.0}) for t in SECONDS]
BASE = sorted([row for row in curved_dive(gps=True) if row[0] < SECONDS.stop] + DEPTHS, key=lambda row: row[0])
"""A dive of ninety seconds with every sensor."""

ABSURD: list[object] = [1e300, -1e300, 1e308, 1e-300, -1e-300, 5e-324, 0, 0.0, -0.0, -1]
ABSURD += ["nan", "inf", "-inf", 1e17, 1e30, 1e100, 2**63 - 1, -(2**63), 10**23, "true", "'word'", "[]", "[1.0]", "{}"]
PLAUSIBLE: list[object] = [1e-6, 1e-3, 0.1, 0.5, 0.9, 1, 2, 3.0, 10, -10, 30, 89.9, 180, -180, 360, 1000, -1000]
PLAUSIBLE += [1e4, -1e4, 1e6, -1e6, 1e7]

FIXED = "head = { east_m = 1.0, north_m = 2.0, heading_deg = 10.0 }"
SHIP = "topic = '/ship/fix', heading_topic = '/ship/imu'"
ALL_STATES = "states = ['scale', 'misalignment', 'heading', 'deviation', 'latency', 'usbl-bias', 'current']"
STATES_OF = {"pf": ALL_STATES.replace(" 'heading', 'deviation',", "")}  # it samples the yaw
START = "east_m = 0\nnorth_m = 0\nsd_m = 1"
UNITS = {"dvl": "mps", "compass": "deg", "usbl": "m", "gps": "m"}
NOISES = {"share": "'contamination', sd_U = 1.0", "variance_ratio": "'mixture'"}
NOISES |= {"dof": "'student-t'", "sd_U": "'contamination'"}
PLACE = {"lat_deg": "lon_deg = 7.0", "lon_deg": "lat_deg = 45.0", "east_m": "north_m = 0", "north_m": "east_m = 0"}


def keys(section: str, names: str, lines: str = "") -> dict[str, str]:
    """Return keys with the lines that let them act; V is the value, and KEY the key, inside a table or an array."""
    return {f"{section}.{name}": lines.replace("KEY", name) for name in names.split()}


KEYS = {
    **keys("map", "origin_lat_deg", "origin_lon_deg = 7.0"),
    **keys("map", "origin_lon_deg", "origin_lat_deg = 45.0"),
    **keys("dvl", "mount_deg scale_error sd_mps sd_scale latency_s clock_step_s min_good_beams sound_speed_mps"),
    **keys("dvl", "assumed_sound_speed_mps", "sound_speed_mps = 1480.0"),
    **keys("dvl", "lever_arm_m", "lever_arm_m = [V, 0, 1]"),
    **{
        f"{sensor}.noise.{key}".replace("U", unit): f"noise = {{ kind = {kind}, {key} = V }}".replace("U", unit)
        for sensor, unit in UNITS.items()
        for key, kind in NOISES.items()
    },
    **{
        f"usbl.{what}.{key}": f"{what} = {{ {key} = V, {other} }}"
        for what in ("head", "beacon")
        for key, other in (PLACE | {"depth_m": "east_m = 0, north_m = 0"}).items()
    },
    **keys("compass", "bias_deg deviation_sin_deg deviation_cos_deg declination_deg"),
    **keys("compass", "sd_deg sd_scale latency_s clock_step_s device"),
    **keys("usbl", "sd_m sd_scale latency_s clock_step_s target"),
    **keys("usbl", "mount_deg mount_roll_deg mount_pitch_deg heading_sd_deg", f"frame = 'body'\n{FIXED}"),
    **keys("usbl", "sound_speed_scale", FIXED),
    **keys("usbl", "sound_speed_mps turnaround_s", f"stamped_at = 'reply'\n{FIXED}"),
    **keys("usbl", "range_sd_m range_sd_rel", f"bearing_sd_deg = 1.0\n{FIXED}"),
    **keys("usbl", "bearing_sd_deg", f"range_sd_m = 1.0\n{FIXED}"),
    **keys("usbl", "lever_arm_m", "lever_arm_m = [0, V, 1]"),
    **keys("usbl.head", "latency_s heading_latency_s sd_m max_gap_s", f"head = {{ {SHIP}, KEY = V }}"),
    **keys("usbl.head", "heading_deg", "frame = 'body'\nhead = { east_m = 0, north_m = 0, heading_deg = V }"),
    **keys("usbl.head", "heading_bias_deg heading_declination_deg", f"frame = 'body'\nhead = {{ {SHIP}, KEY = V }}"),
    **keys("usbl.head", "lever_arm_m", f"head = {{ {SHIP}, lever_arm_m = [V, 1, 1] }}"),
    **keys("usbl.beacon", "sd_m", "beacon = { east_m = 0, north_m = 0, sd_m = V }"),
    **keys("usbl.beacon", "max_gap_s", "frame = 'body'\nbeacon = { east_m = 0, north_m = 0, max_gap_s = V }"),
    **keys("dvl", "device"),
    **keys("gps", "sd_m latency_s device"),
    **keys("gps", "lever_arm_m", "lever_arm_m = [V, 0, 0]"),
    **keys("depth", "surface_pa latency_s device"),
    **keys("truth", "max_gap_s latency_s sd_m heading_sd_deg scale_sd"),
    **keys("truth", "skip_rows", "file = 'truth.csv'"),
    **keys("truth", "lever_arm_m", "lever_arm_m = [0, V, 0]"),
    **keys("process", "position_m heading_deg velocity_mps turn_rate_dps uncalibrated_m"),
    **keys("calibrate", "scale_sd mount_sd_deg heading_sd_deg heading_walk_deg deviation_sd_deg", ALL_STATES),
    **keys("calibrate", "latency_sd_s usbl_bias_sd_m usbl_bias_time_s current_sd_mps current_walk_mps", ALL_STATES),
    **keys(
        "calibrate", "dvl_lever_sd_m dvl_clock_sd_s compass_clock_sd_s usbl_heading_sd_deg usbl_range_sd usbl_arm_sd_m"
    ),
    **keys("start", "east_m", "north_m = 0\nsd_m = 1"),
    **keys("start", "north_m", "east_m = 0\nsd_m = 1"),
    **keys("start", "sd_m", "east_m = 0\nnorth_m = 0"),
    **keys("start", "heading_sd_deg velocity_sd_mps turn_rate_sd_dps", START),
    **keys("file", "clock_offset_s date", "path = 'dive.mcap'"),
}
NEEDED = {"compass": "topic = '/imu'", "gps": "topic = '/gps/fix'"}  # the ship has such topics, too


def numbers(annotation: object, path: str = "") -> Iterator[str]:
    """Yield the dotted paths of all keys that hold a number or a date."""
    if isinstance(annotation, type) and issubclass(annotation, Struct):
        for name, hint in typing.get_type_hints(annotation, include_extras=True).items():
            yield from numbers(hint, f"{path}.{name}".removeprefix("."))
    elif annotation in (int, float, datetime.date):
        yield path
    elif isinstance(annotation, UnionType) or typing.get_origin(annotation) is not typing.Literal:
        for part in typing.get_args(annotation):
            yield from numbers(part, path)


def settings(values: Mapping[str, object]) -> str:
    """Return a configuration in which the keys, each of another section, have the values, and act."""
    text = {section: f"[{section}]\n{line}\n" for section, line in NEEDED.items()}
    for key, value in values.items():
        section, _, name = key.partition(".")
        lines = KEYS[key] if "V" in KEYS[key] else f"{name} = V\n{KEYS[key]}"
        title = "[[file]]\n" if section == "file" else f"[{section}]\n"
        text[section] = text.get(section, title) + lines.replace("V", str(value)) + "\n"
    return "".join(text.values())


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The dive, beside a ship."""
    rows = [row for t in SECONDS for row in (fix(t, 45.0, 7.0, topic="/ship/fix"), yaw(t, 30.0, topic="/ship/imu"))]
    folder = tmp_path_factory.mktemp("absurd")
    truth = "".join(f"{T0 + k * SECOND},{k / 10},{k / 5}\n" for k in range(90))
    (folder / "truth.csv").write_text("time_ns,east_m,north_m\n" + truth)
    return write_mcap(folder / "dive.mcap", sorted([*BASE, *rows], key=lambda row: row[0]))


def replay_with(log: Path, values: Mapping[str, object], *options: str) -> Result:
    file, target = log.with_name("settings.toml"), str(log.with_name("run"))
    states = next((able for method, able in STATES_OF.items() if method in options), ALL_STATES)
    file.write_text(settings(values).replace(ALL_STATES, states), encoding="utf-8")
    return run("replay", str(log), "--config", str(file), "--quiet", "--force", "--output", target, *options)


def check_sentence(done: Result, key: str) -> None:
    """Where the value was refused, file and key are named."""
    if isinstance(done.exception, UsageError):
        section, *_, name = key.split(".")
        assert "settings.toml: [" in str(done.exception)
        assert f"[{section}" in str(done.exception)
        assert name in str(done.exception)


def test_every_key_that_holds_a_number_or_a_date_is_among_those_tried() -> None:
    assert set(numbers(Configuration)) - {"schema", "part"} == set(KEYS)


@pytest.mark.parametrize("key", KEYS)
@pytest.mark.long
def test_an_absurd_value_is_a_run_or_a_sentence(log: Path, key: str) -> None:
    value = random.Random(key).choice(ABSURD)

    check_sentence(replay_with(log, {key: value}, "--filter", "ekf"), key)


def test_a_start_too_far_from_the_fixes_for_any_covariance_is_one_sentence(log: Path) -> None:
    values = {"calibrate.latency_sd_s": 3.0, "process.heading_deg": 0.5, "start.north_m": 1e6}

    done = replay_with(log, values | {"usbl.lever_arm_m": 0.5}, "--filter", "ekf")

    assert isinstance(done.exception, LogError)
    assert str(done.exception).startswith("ekf: a covariance grew beyond what numbers can hold apart")


@pytest.mark.slow
@pytest.mark.parametrize("method", ["ekf", "adf", "pf"])
def test_any_value_is_a_run_or_a_sentence_for_any_filter(log: Path, method: str) -> None:
    for key in KEYS:
        for value in ABSURD + PLAUSIBLE if method == "ekf" else PLAUSIBLE:
            check_sentence(replay_with(log, {key: value}, "--filter", method), key)


@pytest.mark.slow
def test_several_odd_values_at_once_are_a_run_or_a_sentence(log: Path) -> None:
    rng = random.Random(0)
    choices = [["--smooth"], ["--order", "arrival"], ["--guard"], ["--calibrate", "auto"], []]

    for _ in range(150):
        values = {key.split(".")[0]: (key, rng.choice(PLAUSIBLE)) for key in rng.sample(list(KEYS), 6)}
        replay_with(log, dict(values.values()), "--filter", rng.choice(["ekf", "adf"]), *rng.choice(choices))


NUMBERED = {f"--{name}": f"ekf --{name} V" for name in ("gate", "start", "end", "fast-hz", "slow-hz")}
NUMBERED |= {"--seed": "cpf --seed V", "both rates": "ekf --slow-hz V --fast-hz V"}
NUMBERED |= {"--dr-from latitude": "dr --dr-from V,7", "--dr-from longitude": "dr --dr-from 45,V"}
NUMBERED |= {"--aid from": "ekf --aid gps@V:60", "--aid to": "ekf --aid gps@0:V"}
NUMBERED |= {
    f"--noise {sensor}={kind}": f"adf --noise {sensor}={kind}:V"
    for sensor in ("dvl", "compass", "usbl", "gps")
    for kind in ("mixture", "mixture:0.3", "student-t", "contamination", "contamination:0.1")
}
MOMENTS = ["", "x", "0001-01-01T00:00:00+14:00", "9999-12-31T23:59:59Z", "2020-09-13T12:27:00Z"]


@pytest.mark.parametrize("option", NUMBERED)
def test_an_absurd_number_of_an_option_is_a_run_or_a_sentence(log: Path, option: str) -> None:
    rng = random.Random(option)

    for value in rng.sample(ABSURD + MOMENTS, 3):
        words = ["replay", str(log), "-q", "--force", "--output", str(log.with_name("run")), "--filter"]
        run(*words, *(word.replace("V", str(value)) for word in NUMBERED[option].split()))


@pytest.mark.parametrize("option", ["--start", "--end"])
def test_an_export_from_or_to_no_moment_is_a_sentence(log: Path, option: str) -> None:
    for value in (*ABSURD, *MOMENTS):
        run("export", str(log), "--force", "--output", str(log.with_name("out.mcap")), option, str(value))


ODD = (1e300, -1e300, 1e308, math.nan, math.inf, -math.inf, 0.0, 1e-300, 1e17, 1e10, 1e6, -1e6)
FIELDS = {
    "/dvl": ("twist.linear.x", "twist.linear.y", "twist.linear.z"),
    "/imu": ("orientation.x", "orientation.z", "orientation.w", "linear_acceleration.z"),
    "/usbl": ("point.x", "point.y", "point.z"),
    "/gps/fix": ("latitude", "longitude", "altitude"),
    "/depth": ("fluid_pressure", "variance"),
}
STAMPS = (0, 1, T0, (2**31 - 1) * SECOND)
WHICH: dict[str, Callable[[int], bool]] = {"all": lambda _: True, "one": lambda n: n == 7, "half": lambda n: n % 2 == 1}


def changed(topic: str, field: str, value: object, which: str = "all") -> list[Row]:
    """Return the dive with a field of a topic's messages changed, of those that are chosen."""
    seen, rows = 0, list[Row]()
    for row in BASE:
        hit = row[1] == topic and WHICH[which](seen)
        seen += row[1] == topic
        rows.append((*row[:3], dict(row[3]) | {field: value}) if hit else row)
    return sorted(rows, key=lambda row: row[0])


def retyped(topic: str, kind: str, fields: dict[str, str], **more: object) -> list[Row]:
    """Return the dive with a topic's messages of another type: new field -> old field."""
    rows: list[Row] = []
    for row in BASE:
        values = {new: row[3][old] for new, old in fields.items()} if row[1] == topic else {}
        of_all = {name.replace("__", "."): value for name, value in more.items()}
        rows.append((row[0], topic, kind, values | of_all) if values else row)
    return rows


def with_covariance(value: float) -> dict[str, list[Row]]:
    square, stamp = np.full(36, value), {"header.stamp": "header.stamp"}
    of_point = stamp | {f"pose.pose.position.{axis}": f"point.{axis}" for axis in "xyz"}
    of_twist = stamp | {f"twist.twist.linear.{axis}": f"twist.linear.{axis}" for axis in "xyz"}
    return {
        f"{value} as covariance of the fixes": retyped("/usbl", POSE_COVARIANCE, of_point, pose__covariance=square),
        f"{value} as covariance of the DVL": retyped("/dvl", TWIST_COVARIANCE, of_twist, twist__covariance=square),
        f"{value} as covariance of the heading": changed("/imu", "orientation_covariance", square[:9]),
        f"{value} as every heading": [
            (r[0], "/heading", HEADING, {"data": value}) if r[1] == "/imu" else r for r in BASE
        ],
    }


def few(topic: str, count: int) -> list[Row]:
    """Return the dive with some messages of a topic, or of each, only."""
    seen, rows = Counter[str](), list[Row]()
    for row in BASE:
        seen[row[1]] += 1
        if seen[row[1]] <= count or topic not in (row[1], "each"):
            rows.append(row)
    return rows


def odd_logs() -> dict[str, list[Row]]:
    """Return all the logs by what is odd about them."""
    made = {
        f"{value} in {which} of {topic} {field}": changed(topic, field, value, which)
        for topic, fields in FIELDS.items()
        for field in fields
        for value in ODD
        for which in WHICH
    }
    for value in ODD:
        made |= with_covariance(value)
    for topic in FIELDS:
        for stamp in STAMPS:
            made |= {f"{which} of {topic} at {stamp}": changed(topic, "header.stamp", stamp, which) for which in WHICH}
    for topic in (*FIELDS, "each"):
        made |= {f"{count} of {topic}": few(topic, count) for count in (0, 1, 2, 3, 5) if topic != "each" or count}
    made["every stamp alike"] = [(T0, *row[1:3], dict(row[3]) | {"header.stamp": T0}) for row in BASE]
    made |= {f"every log time {t}": [(t, *row[1:]) for row in BASE] for t in (0, 1, 2**62, 2**63 - 1)}
    return made


def commands(log: Path) -> list[list[str]]:
    target = str(log.with_name("run"))
    return [
        ["info", str(log)],
        ["doctor", str(log)],
        ["init", str(log), "--force", "--output", str(log.with_name("found.toml"))],
        ["replay", str(log), "-f", "ekf", "--force", "-q", "-o", target],
    ]


@pytest.mark.parametrize("some", [pytest.param(6, marks=pytest.mark.long), pytest.param(None, marks=pytest.mark.slow)])
def test_odd_logs_end_in_findings_or_one_sentence(tmp_path: Path, some: int | None) -> None:
    every = odd_logs()
    for what in random.Random(1).sample(sorted(every), some or len(every)):
        log = write_mcap(tmp_path / "odd.mcap", every[what])
        for command in commands(log):
            run(*command)


@pytest.mark.slow
def test_pictures_of_odd_logs_are_drawn_without_a_warning(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("usbldr_cli.figures.run_figures.run_pictures", run_pictures)
    every = odd_logs()
    for what in [*random.Random(2).sample(sorted(every), 25), "1 of each", "every stamp alike", "1 of /usbl"]:
        log = write_mcap(tmp_path / "odd.mcap", every[what])
        run(*commands(log)[-1])


@pytest.mark.parametrize(
    ("topic", "field", "value", "code", "cause"),
    [
        ("/usbl", "point.x", 3e9, "USBL-INVALID", "1 beyond 20000 km"),
        ("/depth", "fluid_pressure", 3e9, "DEPTH-INVALID", "1 beyond 12 km"),
        ("/imu", "orientation.z", 1e200, "COMPASS-INVALID", "1 not a number"),
    ],
)
def test_a_record_of_another_world_is_left_out_and_counted(tmp_path, topic, field, value, code, cause):
    log = read_log(write_mcap(tmp_path / "dive.mcap", changed(topic, field, value, "one")))

    assert codes(log)[code].endswith(f"records are invalid and left out ({cause})")


def test_a_variance_without_bounds_is_unknown(tmp_path: Path) -> None:
    log = read_log(write_mcap(tmp_path / "dive.mcap", with_covariance(1e17)["1e+17 as covariance of the fixes"]))

    assert Convention("sd_m", 1.0, "default", "m") in log.provenance["usbl"].conventions
