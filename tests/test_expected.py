"""The reference numbers that the collectors of the field logs measured, met by usbldr's readers and dead reckoning.

Counts, stamps and raw fixes of uib and stpere stand in test_field_logs, anchored dead reckoning in test_baselines; here
are the tracks fitted to the truth (an evaluation: no filter ever sees such a fit), and all that is open of the logs
that are held back, whose errors nobody looks at.
"""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from usbldr.filters.alignment import Alignment, fit_rigid
from usbldr.filters.baselines import displacement_m
from usbldr.filters.types import Array, Timeline
from usbldr.io.log import Log
from usbldr.io.mcap_log import McapLog
from usbldr.io.read import Request, read_log
from usbldr.io.readings import reread
from usbldr.io.timeline import timeline

FIELD = Path(__file__).parents[1] / "benchmarks" / "field"
UIB = '[dvl]\naxes = "FLU"\n[compass]\nconvention = "NED"\n[usbl]\ntopic = "none"\n[gps]\ntopic = "none"\n'


def reference(field_logs: Path, name: str, log: str = "") -> Mapping[str, Any]:
    document = json.loads((field_logs / name / "expected.json").read_text(encoding="utf-8"))
    return document["logs"][log]["reference"] if log else document["reference"]


def euler(log: Log) -> Array:
    """Dead reckoning at the truth's times as the collectors did it: each DVL record holds until the next, (T, 2)."""
    assert log.truth is not None
    dvl, compass = log.tables["dvl"], log.tables["compass"]
    dvl = dvl[dvl["valid"]]
    t = dvl["time_s"].to_numpy()
    heading = np.interp(t, compass["time_s"], np.unwrap(np.radians(compass["heading_deg"])))
    u, v = dvl["starboard_mps"].to_numpy(), dvl["forward_mps"].to_numpy()
    V = np.column_stack([u * np.cos(heading) + v * np.sin(heading), v * np.cos(heading) - u * np.sin(heading)])
    moved = np.vstack([np.zeros((1, 2)), np.cumsum(V[:-1] * np.diff(t)[:, None], axis=0)])
    return np.column_stack([np.interp(log.truth.time_s, t, moved[:, axis]) for axis in (0, 1)])


def on_the_grid(log: Log, line: Timeline) -> Array:
    """Dead reckoning at the truth's times as usbldr does it, (T, 2)."""
    assert log.truth is not None
    moved = displacement_m(line)
    return np.column_stack([np.interp(log.truth.time_s, line.time_s, moved[:, axis]) for axis in (0, 1)])


def fitted(log: Log, track: Array) -> tuple[Array, Alignment]:
    """Distances of a track from every truth row once it was turned and shifted onto all of them."""
    assert log.truth is not None
    found = fit_rigid(track, log.truth.position_m)
    return np.hypot(*(found.points(track) - log.truth.position_m).T), found


def assert_as_expected(errors: Array, numbers: Mapping[str, Any], repeated: int = 0) -> None:
    tolerance = numbers["tolerance"]
    assert len(errors) == numbers["n"] - repeated  # truth rows of one stamp are one here
    assert np.sqrt(np.mean(errors**2)) == pytest.approx(numbers["rms_m"], abs=tolerance["rms_m"])
    assert np.max(errors) == pytest.approx(numbers["max_m"], abs=tolerance["max_m"])


def clockwise_deg(found: Alignment) -> float:
    return float(np.degrees(-found.rotation_rad))


@pytest.fixture(scope="module", params=[("uib_field", "/slam/graph_vertices"), ("uib_simulation", "/ground_truth")])
def uib(request: pytest.FixtureRequest, field_logs: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[str, Log]:
    name, truth = request.param
    config = tmp_path_factory.mktemp(name) / "usbldr.toml"
    skip = "skip_rows = 2\n" if name == "uib_field" else ""
    config.write_text(f'{UIB}[truth]\ntopic = "{truth}"\nframe = "NED"\n{skip}', encoding="utf-8")
    return name, read_log(field_logs / name / f"{name}.mcap", Request(configuration=str(config)))


def test_dead_reckoning_of_turbot_fits_the_truth_at_the_angle_that_others_found(
    field_logs: Path, uib: tuple[str, Log]
) -> None:
    name, log = uib
    numbers = reference(field_logs, name)["dead_reckoning_fitted"]

    repeated = {"uib_field": 0, "uib_simulation": 432}[name]

    for track in (euler(log), on_the_grid(log, timeline(log))):
        errors, found = fitted(log, track)
        assert_as_expected(errors, numbers, repeated)
        tolerance = numbers["tolerance"]["mount_yaw_deg"]
        assert clockwise_deg(found) == pytest.approx(numbers["mount_yaw_deg"], abs=tolerance)


def test_dead_reckoning_of_turbot_at_its_nominal_mount_drifts_from_the_truth_as_others_found(
    field_logs: Path, uib: tuple[str, Log]
) -> None:
    name, log = uib
    numbers = reference(field_logs, name)["dead_reckoning_anchored"]
    assert log.truth is not None

    turned = Alignment("rigid", -np.radians(numbers["mount_yaw_deg"])).points(euler(log))
    errors = np.hypot(*(turned - turned[0] - log.truth.position_m + log.truth.position_m[0]).T)

    assert_as_expected(errors, numbers, {"uib_field": 0, "uib_simulation": 432}[name])
    assert errors[-1] == pytest.approx(numbers["end_m"], abs=numbers["tolerance"]["end_m"])


def test_the_dvl_of_turbot_read_without_its_flip_fits_worse_as_others_found(
    field_logs: Path, uib: tuple[str, Log]
) -> None:
    name, log = uib
    numbers = reference(field_logs, name)["dead_reckoning_fitted"]

    errors, found = fitted(log, on_the_grid(log, reread(log, timeline(log), (True, False, False))))

    other = numbers["other_y_sign"]
    assert np.sqrt(np.mean(errors**2)) == pytest.approx(other["rms_m"], abs=numbers["tolerance"]["rms_m"])
    assert clockwise_deg(found) == pytest.approx(other["mount_yaw_deg"], abs=numbers["tolerance"]["mount_yaw_deg"])


def test_the_map_of_turbot_begins_where_others_put_it(field_logs: Path, uib: tuple[str, Log]) -> None:
    """Each pair of stamps of /gps_raw (latitude) and /gps (map) tells the origin."""
    from usbldr.io.geodesy import to_plane
    from usbldr.io.log import Origin

    name, _ = uib
    numbers = reference(field_logs, name)["map_origin"]
    records = McapLog(field_logs / name / f"{name}.mcap").read(
        {
            "/gps_raw": ["header.stamp", "latitude", "longitude"],
            "/gps": ["header.stamp", "pose.pose.position.x", "pose.pose.position.y"],
        }
    )
    raw, local = records["/gps_raw"].columns, records["/gps"].columns
    row_of = {int(stamp): row for row, stamp in enumerate(raw["header.stamp"])}
    pairs = [(row_of[int(s)], k) for k, s in enumerate(local["header.stamp"]) if int(s) in row_of]

    origin = Origin(numbers["lat_deg"], numbers["lon_deg"], "the collectors")
    rows, others = (list(column) for column in zip(*pairs, strict=True))
    east, north = to_plane(origin, raw["latitude"][rows], raw["longitude"][rows])
    off_m = np.hypot(north - local["pose.pose.position.x"][others], east - local["pose.pose.position.y"][others])

    assert len(pairs) == numbers["pairs"]
    assert np.max(off_m) < numbers["tolerance_m"]


def test_the_modem_of_turbot_tells_the_ranges_that_others_read(field_logs: Path) -> None:
    numbers = reference(field_logs, "uib_field")["usbllong_range_m"]
    topic = next(t for t in McapLog(field_logs / "uib_field" / "uib_field.mcap").topics() if t.name == "/usbllong")

    columns = (
        McapLog(field_logs / "uib_field" / "uib_field.mcap").read({"/usbllong": ["n", "e", "u"]})["/usbllong"].columns
    )

    length = np.sqrt(sum(columns[axis].astype(float) ** 2 for axis in "neu"))
    assert topic.count == 593
    assert length.min() == pytest.approx(numbers["min"], abs=numbers["tolerance"])
    assert length.max() == pytest.approx(numbers["max"], abs=numbers["tolerance"])


def stpere(field_logs: Path, tmp_path: Path, text: str) -> Log:
    (tmp_path / "usbldr.toml").write_text(text + '[usbl]\ntopic = "none"\n', encoding="utf-8")
    log = field_logs / "stpere_marina" / "stpere_marina.mcap"
    return read_log(log, Request(configuration=str(tmp_path / "usbldr.toml")))


@pytest.mark.parametrize(
    ("topic", "key"),
    [("/imu/data", "dead_reckoning_mti_fitted"), ("/dvl/compass_heading", "dead_reckoning_dvl_compass_fitted")],
)
def test_dead_reckoning_of_stpere_fits_the_gps_at_the_offset_that_others_found(
    field_logs: Path, tmp_path: Path, topic: str, key: str
) -> None:
    """As the heading stands in the messages, without mounting or bias."""
    numbers = reference(field_logs, "stpere_marina")[key]
    log = stpere(field_logs, tmp_path, f'[compass]\ntopic = "{topic}"\n')

    errors, found = fitted(log, euler(log))
    _, ours = fitted(log, on_the_grid(log, timeline(log)))

    assert_as_expected(errors, numbers)
    tolerance = numbers["tolerance"]["heading_offset_deg"]
    assert clockwise_deg(found) == pytest.approx(numbers["heading_offset_deg"], abs=tolerance)
    assert clockwise_deg(ours) == pytest.approx(numbers["heading_offset_deg"], abs=tolerance)


def test_dead_reckoning_of_stpere_at_the_fitted_offset_drifts_from_the_first_fix_as_others_found(
    field_logs: Path, tmp_path: Path
) -> None:
    numbers = reference(field_logs, "stpere_marina")["dead_reckoning_mti_anchored_fitted"]
    offset = numbers["heading_offset_deg"]
    log = stpere(field_logs, tmp_path, f'[dvl]\nmount_deg = {offset}\n[compass]\ntopic = "/imu/data"\n')
    assert log.truth is not None

    at = euler(log)
    errors = np.hypot(*(at - at[0] - log.truth.position_m + log.truth.position_m[0]).T)

    assert_as_expected(errors, numbers)
    assert errors[-1] == pytest.approx(numbers["end_m"], abs=numbers["tolerance"]["end_m"])


def test_the_fixes_of_stpere_err_as_others_measured_once_the_gross_ones_are_known(field_logs: Path) -> None:
    numbers = reference(field_logs, "stpere_marina")["usbl_synthetic"]
    config = str(FIELD / "stpere_marina.toml")
    log = read_log(field_logs / "stpere_marina" / "stpere_marina.mcap", Request(configuration=config))
    folder = field_logs / "stpere_marina" / "csv"
    key = np.genfromtxt(folder / "usbl_synthetic_key.csv", delimiter=",", skip_header=1, dtype=None, encoding="utf-8")
    gross = {int(row[0]) for row in key if row[4]}
    assert log.truth is not None
    usbl = log.tables["usbl"]

    stamps = [log.start_ns + round(t * 1e9) for t in usbl["time_s"]]
    good = np.asarray([min(abs(s - g) for g in gross) > 1000 for s in stamps])
    truth = [np.interp(usbl["time_s"], log.truth.time_s, log.truth.position_m[:, axis]) for axis in (0, 1)]
    position = usbl[["east_m", "north_m"]].to_numpy()
    errors = np.hypot(*(position - np.column_stack(truth)).T)[good]

    assert len(gross) == numbers["gross_outliers"]
    expected, tolerance = numbers["error_without_gross"], numbers["tolerance"]
    assert len(errors) == expected["n"]
    assert np.median(errors) == pytest.approx(expected["median_m"], abs=tolerance["median_m"])
    assert np.mean(errors) == pytest.approx(expected["mean_m"], abs=tolerance["mean_m"])
    assert np.sqrt(np.mean(errors**2)) == pytest.approx(expected["rms_m"], abs=tolerance["rms_m"])


def test_the_way_of_stpere_is_as_long_as_others_found(field_logs: Path, tmp_path: Path) -> None:
    log = stpere(field_logs, tmp_path, '[compass]\ntopic = "/imu/data"\n')
    dvl = log.tables["dvl"]
    dvl = dvl[dvl["valid"]]

    speed = np.hypot(*dvl[["starboard_mps", "forward_mps"]].to_numpy().T)[:-1]
    length_m = float(np.sum(speed * np.diff(dvl["time_s"])))

    assert length_m == pytest.approx(reference(field_logs, "stpere_marina")["dvl_path_length_m"], abs=0.1)
    assert log.origin is not None
    assert (log.origin.lat_deg, log.origin.lon_deg) == pytest.approx(
        tuple(reference(field_logs, "stpere_marina")[f"origin_{axis}_deg"] for axis in ("lat", "lon")), abs=5e-9
    )


HELD_BACK = [
    ("mhkit_tanana", "tanana_002"),
    ("mhkit_tanana", "tanana_003"),
    ("mhkit_riverpro", "mhkit_riverpro"),
]


@pytest.mark.parametrize(("folder", "name"), HELD_BACK)
def test_the_river_logs_have_the_topics_counts_and_spans_that_others_counted(
    field_logs: Path, folder: str, name: str
) -> None:
    document = json.loads((field_logs / folder / "expected.json").read_text(encoding="utf-8"))
    expected = document["logs"][name]["topics"]

    found = {topic.name: topic for topic in McapLog(field_logs / folder / f"{name}.mcap").topics()}

    assert set(found) == set(expected)
    for topic, numbers in expected.items():
        assert (found[topic].type, found[topic].count) == (numbers["type"], numbers["count"])
        assert (found[topic].first_ns, found[topic].last_ns) == (numbers["log_first_ns"], numbers["log_last_ns"])
        assert found[topic].rate_hz == pytest.approx(numbers["rate_hz"], abs=2e-3)


@pytest.mark.parametrize(("folder", "name"), HELD_BACK)
def test_the_river_logs_lose_bottom_lock_as_others_counted(field_logs: Path, folder: str, name: str) -> None:
    numbers = reference(field_logs, folder, name)

    log = read_log(field_logs / folder / f"{name}.mcap", Request(configuration="none"))
    dvl = log.tables["dvl"]
    locked = dvl[dvl["valid"]]["time_s"].to_numpy()

    assert len(dvl) == numbers["ensembles"]
    assert 100 * dvl["valid"].mean() == pytest.approx(numbers["bottom_lock_pct"], abs=0.06)
    assert np.max(np.diff(locked)) == pytest.approx(numbers["longest_loss_s"], abs=0.02)
    assert log.origin is not None
    assert log.origin.lat_deg == pytest.approx(numbers["origin_lat_deg"], abs=5e-9)
    assert log.origin.lon_deg == pytest.approx(numbers["origin_lon_deg"], abs=5e-9)
    assert len(log.tables["usbl"]) == numbers["usbl_synthetic"]["fixes"]
    gps = log.tables["gps"][["east_m", "north_m"]].to_numpy()
    assert float(np.sum(np.hypot(*np.diff(gps, axis=0).T))) == pytest.approx(numbers["gps_path_m_5hz"], abs=0.5)
