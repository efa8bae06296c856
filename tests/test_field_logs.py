"""Real logs: counts, spans, stamps and raw USBL errors against what others made of the same files."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from usbldr.filters.errors import UsageError
from usbldr.io.log import Log
from usbldr.io.mcap_log import McapLog
from usbldr.io.read import Request, read_log

FIELD = Path(__file__).parents[1] / "benchmarks" / "field"
SIMULATED_TWIN = """
[dvl]
axes = "FLU"
[compass]
convention = "NED"
[usbl]
frame = "NED"
[gps]
topic = "none"
[truth]
topic = "/ground_truth"
frame = "NED"
"""


def expected(field_logs: Path, name: str) -> Mapping[str, Any]:
    """What the collectors measured; of the held-back log only the topics are looked at."""
    document = json.loads((field_logs / name / "expected.json").read_text(encoding="utf-8"))
    return document if "topics" in document else document["logs"][name]


def field_log(field_logs: Path, name: str, **more: Any) -> Log:
    return read_log(field_logs / name / f"{name}.mcap", Request(configuration=str(FIELD / f"{name}.toml"), **more))


@pytest.mark.parametrize("name", ["uib_field", "uib_simulation", "stpere_marina", "mhkit_riverpro"])
def test_topics_have_the_counts_types_and_times_that_others_counted(field_logs: Path, name: str) -> None:
    log = McapLog(field_logs / name / f"{name}.mcap")

    found = {topic.name: topic for topic in log.topics()}

    topics = expected(field_logs, name)["topics"]
    assert set(found) == set(topics)
    for topic, numbers in topics.items():
        assert found[topic].type == numbers["type"]
        assert found[topic].count == numbers["count"]
        assert found[topic].first_ns == numbers["log_first_ns"]
        assert found[topic].last_ns == numbers["log_last_ns"]
        assert found[topic].span_s == pytest.approx(numbers["span_s"], abs=1e-3)
        assert found[topic].rate_hz == pytest.approx(numbers["rate_hz"], abs=2e-3)


@pytest.mark.parametrize("name", ["uib_field", "stpere_marina"])
def test_stamps_repeat_and_lag_as_others_measured(field_logs: Path, name: str) -> None:
    topics = {t: n for t, n in expected(field_logs, name)["topics"].items() if "repeated_stamps" in n}
    records = McapLog(field_logs / name / f"{name}.mcap").read({topic: ["header.stamp"] for topic in topics})

    for topic, numbers in topics.items():
        stamps = records[topic].columns["header.stamp"]
        lag_s = (records[topic].received_ns - stamps) / 1e9
        assert len(stamps) - len(np.unique(stamps)) == numbers["repeated_stamps"]
        for statistic in ("min", "median", "max"):
            value = float(getattr(np, statistic)(lag_s))
            assert value == pytest.approx(numbers["log_minus_stamp_s"][statistic], abs=1e-4)


def usbl_errors(log: Log) -> np.ndarray[Any, Any]:
    """Distance of each fix, at its own time, from the truth interpolated linearly; outside the truth none."""
    assert log.truth is not None
    usbl, truth = log.tables["usbl"], log.truth
    t = usbl["time_s"].to_numpy()
    inside = (t >= truth.time_s[0]) & (t <= truth.time_s[-1])
    at = [np.interp(t[inside], truth.time_s, truth.position_m[:, axis]) for axis in (0, 1)]
    return np.hypot(usbl["east_m"].to_numpy()[inside] - at[0], usbl["north_m"].to_numpy()[inside] - at[1])


def assert_as_measured(
    errors: np.ndarray[Any, Any], numbers: Mapping[str, Any], tolerance: Mapping[str, float]
) -> None:
    assert len(errors) == pytest.approx(numbers["n"], abs=tolerance.get("n", 0))
    assert np.median(errors) == pytest.approx(numbers["median_m"], abs=tolerance["median_m"])
    assert np.mean(errors) == pytest.approx(numbers["mean_m"], abs=tolerance["mean_m"])
    assert np.sqrt(np.mean(errors**2)) == pytest.approx(numbers["rms_m"], abs=tolerance["rms_m"])
    assert np.max(errors) == pytest.approx(numbers["max_m"], abs=tolerance["max_m"])


@pytest.mark.parametrize("topic", ["modem_delayed_acoustic", "modem_raw"])
def test_the_usbl_of_uib_field_errs_as_others_measured(field_logs: Path, topic: str) -> None:
    """Against the 490 poses of the log itself, the first two left out."""
    numbers = expected(field_logs, "uib_field")["reference"][f"usbl_error_{topic}"]

    log = field_log(field_logs, "uib_field", topics={"usbl": f"/{topic}"}, truth="/slam/graph_vertices")

    assert_as_measured(usbl_errors(log), numbers, numbers["tolerance"])


def test_the_usbl_of_stpere_errs_as_others_measured(field_logs: Path) -> None:
    numbers = expected(field_logs, "stpere_marina")["reference"]["usbl_synthetic"]

    log = field_log(field_logs, "stpere_marina")

    assert_as_measured(usbl_errors(log), numbers["error_all"], numbers["tolerance"])


@pytest.mark.parametrize("topic", ["modem_delayed_acoustic", "modem_raw"])
def test_the_usbl_of_the_simulated_twin_errs_as_others_measured(field_logs: Path, tmp_path: Path, topic: str) -> None:
    (tmp_path / "twin.toml").write_text(SIMULATED_TWIN, encoding="utf-8")
    numbers = expected(field_logs, "uib_simulation")["reference"][f"usbl_error_{topic}"]

    request = Request(configuration=str(tmp_path / "twin.toml"), topics={"usbl": f"/{topic}"})
    log = read_log(field_logs / "uib_simulation" / "uib_simulation.mcap", request)

    assert_as_measured(usbl_errors(log), numbers, numbers["tolerance"])


def test_the_doubled_dvl_of_uib_field_becomes_single(field_logs: Path) -> None:
    reference = expected(field_logs, "uib_field")["reference"]["dvl"]

    log = field_log(field_logs, "uib_field")
    dvl = log.tables["dvl"]

    assert len(dvl) == reference["unique_stamps"] == 2715
    assert f"/dvl: {reference['repeated']} of 5422 records repeat" in " ".join(f.text for f in log.findings)
    speed = np.hypot(dvl["starboard_mps"].to_numpy(), dvl["forward_mps"].to_numpy())[:-1]
    path_m = float(np.sum(speed * np.diff(dvl["time_s"].to_numpy())))
    assert path_m == pytest.approx(reference["path_m"], abs=reference["path_tolerance_m"])


def test_the_truth_of_uib_field_begins_after_the_map_jump(field_logs: Path) -> None:
    reference = expected(field_logs, "uib_field")["reference"]["truth"]

    log = field_log(field_logs, "uib_field", truth="/slam/graph_vertices")

    assert log.truth is not None
    assert len(log.truth.time_s) == reference["rows_used"]
    assert log.truth.kind == "slam"
    assert float(np.sum(np.hypot(*np.diff(log.truth.position_m.T)))) == pytest.approx(reference["path_m"], abs=1.0)


def test_two_modem_topics_are_no_choice_for_a_program(field_logs: Path) -> None:
    with pytest.raises(UsageError, match=r"/modem_delayed_acoustic .* /modem_raw .*--usbl TOPIC"):
        read_log(field_logs / "uib_field" / "uib_field.mcap", Request(configuration="none"))


def test_the_depths_and_locks_of_stpere_are_as_others_counted(field_logs: Path) -> None:
    reference = expected(field_logs, "stpere_marina")["reference"]

    log = field_log(field_logs, "stpere_marina")

    assert int(log.tables["dvl"]["valid"].sum()) == reference["dvl_bottom_lock"]["good"]
    assert log.tables["depth"]["depth_m"].min() == pytest.approx(reference["depth_m"]["min"], abs=2e-3)
    assert log.tables["depth"]["depth_m"].max() == pytest.approx(reference["depth_m"]["max"], abs=2e-3)
    gps = log.tables["gps"]
    assert np.ptp(gps["east_m"]) == pytest.approx(reference["gps_box_m"]["east"], abs=0.2)
    assert np.ptp(gps["north_m"]) == pytest.approx(reference["gps_box_m"]["north"], abs=0.2)
    assert any(f.text.startswith("/usbl/fix_synthetic: 144 of 3037") for f in log.findings)


def test_the_gps_of_uib_field_lies_where_others_found_it(field_logs: Path) -> None:
    reference = expected(field_logs, "uib_field")["reference"]["gps_minus_truth_end"]

    log = field_log(field_logs, "uib_field", topics={"gps": "/gps_raw"}, truth="/slam/graph_vertices")

    assert log.truth is not None
    gps = log.tables["gps"].tail(reference["n"])
    for axis, name in enumerate(("east", "north")):
        at = np.interp(gps["time_s"], log.truth.time_s, log.truth.position_m[:, axis])
        error = float(np.median(gps[f"{name}_m"] - at))
        assert error == pytest.approx(reference[f"median_{name}_m"], abs=reference["tolerance_m"])
