"""``usbldr info`` by its exact output and exit codes."""

import json
from pathlib import Path

import pytest

from commands import run as call
from recordings import FIX, T0, fix, point, short_dive, twist, write_csv, write_mcap, write_payloads
from usbldr.filters.errors import LogError

PAGE = """\
{folder}/dive.mcap: MCAP, 34 messages, 2020-09-13T12:26:40.000Z to 2020-09-13T12:26:50.000Z (10.0 s)
configuration: {folder}/usbldr.toml
origin of east and north: 45.000000000, 7.000000000 deg (first gps fix)

topic     type                            messages  rate Hz  span s  role
/dvl      geometry_msgs/msg/TwistStamped        11    1.000  10.000  dvl
/gps/fix  sensor_msgs/msg/NavSatFix              1        -   0.000  gps
/imu      sensor_msgs/msg/Imu                   11    1.000  10.000  compass
/usbl     geometry_msgs/msg/PointStamped        11    1.000  10.000  usbl

dvl: /dvl (configuration), 11 of 11 records used
  axes FRD (configuration)
  unit m/s (default)
  mount 0 deg (default)
  sd estimated from the records (default)
  timed by header stamp (by type)

compass: /imu (type and name), 11 of 11 records used
  convention ENU (by type)
  sd 0.3 deg (default)
  timed by header stamp (by type)

usbl: /usbl (type and name), 11 of 11 records used
  kind position (default)
  frame ENU (default)
  relative to the map (default)
  sd 1 m (default)
  timed by header stamp (by type)

gps: /gps/fix (type and name), 1 of 1 records used
  frame latlon (by type)
  sd unknown (by its records)
  timed by header stamp (by type)

truth: /gps/fix, kind gps
  1 samples from 0.0 to 0.0 s, interpolated over gaps up to 30 s

MAP-UNKNOWN: /usbl: the map origin is not stated: errors against a truth in latitudes are those that remain after \
a constant shift \
(state origin_lat_deg and origin_lon_deg under [map], or the position of the USBL transceiver ([usbl] head) if fixes \
are relative to it)
"""


def run(*arguments: object) -> tuple[int, str]:
    done = call("info", *arguments)
    if done.exception is not None:
        raise done.exception
    return (done.return_value or 0), done.stdout


@pytest.fixture
def dive(tmp_path: Path) -> Path:
    return write_mcap(tmp_path / "dive.mcap", [*short_dive(), fix(T0, 45.0, 7.0)])


def test_the_page_lists_topics_roles_and_every_convention(dive: Path) -> None:
    dive.with_name("usbldr.toml").write_text('[dvl]\ntopic = "/dvl"\naxes = "FRD"', encoding="utf-8")

    assert run(dive) == (0, PAGE.format(folder=dive.parent))


def test_json_says_the_same(dive: Path) -> None:
    code, text = run(dive, "--json")
    (log,) = json.loads(text)["logs"]

    assert (code, log["complete"], log["start_ns"]) == (0, True, T0)
    assert {t["topic"]: (t["type"], t["messages"], t["roles"]) for t in log["topics"]}["/gps/fix"] == (FIX, 1, ["gps"])
    assert log["sensors"]["compass"]["conventions"][0]["text"] == "convention ENU (by type)"
    assert log["truth"] == {"source": "/gps/fix", "kind": "gps", "rows": 1}
    assert [finding["code"] for finding in log["findings"]] == ["MAP-UNKNOWN"]


def test_a_log_with_unclear_roles_is_still_listed_with_the_sensors_that_are_decided(tmp_path: Path) -> None:
    file = write_mcap(tmp_path / "dive.mcap", [*short_dive(), point(T0, 1, 2, topic="/usbl2")])

    code, page = run(file)

    assert code == 3
    assert "\n/usbl2  geometry_msgs/msg/PointStamped         1 " in page
    assert "cannot be replayed as is: 2 topics could be the usbl: /usbl " in page
    assert json.loads(run(file, "--json")[1])["logs"][0]["fault"].startswith("2 topics could be the usbl")
    assert "cannot be replayed" not in run(file, "--usbl", "/usbl")[1]
    assert "\ncompass: /imu (type and name), 11 of 11 records used\n  convention ENU (by type)" in page
    assert "\nusbl: " not in page


def test_a_log_without_sensors_says_so_and_files_that_are_no_sensor_are_listed(tmp_path: Path) -> None:
    code, page = run(write_mcap(tmp_path / "dive.mcap", [twist(T0, 1, 2, topic="/cmd_vel")]))
    folder = write_csv(tmp_path / "dive", compass="time_ns,heading_deg\n1,2", events="when,what\nnow,start")

    assert code == 3
    assert page.endswith("\n\ncannot be replayed as is: no topic is a sensor that usbldr knows\n")
    assert "cannot be read: /events: its columns match no sensor" in run(folder)[1]


def test_many_topics_are_cut_short_unless_all_are_asked_for(tmp_path: Path) -> None:
    rows = [twist(T0, 1, 2, topic=f"/vehicle/{k:03}") for k in range(50)]
    file = write_mcap(tmp_path / "dive.mcap", rows)

    assert "and 10 more topics (--all lists them)" in run(file)[1]
    assert "/vehicle/049" in run(file, "--all")[1]


def test_the_current_folder_is_a_log_and_a_scenario_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_csv(tmp_path, dvl=f"time_ns,starboard_mps,forward_mps\n{T0},0,1\n{T0 + 1},0,2\n{T0 + 2},0,3")
    monkeypatch.chdir(tmp_path)

    code, page = run("paper")

    assert "dvl: /dvl (type and name), 3 of 3 records used" in run(Path())[1]
    assert code == 0
    assert page.startswith("paper: simulated, 12004 messages, 2026-01-01T00:00:00.000Z to 2026-01-01T00:16:40.000Z")
    assert "dvl: paper/dvl (scenario), 5001 of 5001 records used" in page


def test_the_fields_of_a_topic_are_listed_as_columns_can_name_them(tmp_path: Path) -> None:
    file = write_mcap(tmp_path / "dive.mcap", [fix(T0, 45.0, 7.0)])
    fields = ["header.stamp", "header.frame_id", "status.status", "status.service", "latitude", "longitude",
              "altitude", "position_covariance[0]", "position_covariance_type"]  # fmt: skip

    page = "\n".join(["fields of /gps/fix (sensor_msgs/msg/NavSatFix):", *(f"  {f}" for f in fields)])

    assert page in run(file, "--fields", "gps/fix")[1]
    assert json.loads(run(file, "--json", "--fields", "/gps/fix")[1])["logs"][0]["topics"][0]["fields"] == fields
    assert "fields" not in json.loads(run(file, "--json")[1])["logs"][0]["topics"][0]
    with pytest.raises(LogError, match=r"no topic /gps/fixx; did you mean /gps/fix\? \(topics in this log: /gps/fix\)"):
        run(file, "--fields", "/gps/fixx")


def test_a_sensor_that_cannot_be_read_is_exit_code_3(tmp_path: Path) -> None:
    gps, camera = ((f"foxglove.{kind}", "flatbuffer", b"{}") for kind in ("LocationFix", "RawImage"))
    file = write_payloads(tmp_path / "a.mcap", "/gps/fix", "flatbuffer", gps, [b"{}"])
    other = write_payloads(tmp_path / "b.mcap", "/camera", "flatbuffer", camera, [b""])

    code, page = run(file)

    assert code == 3
    assert "TOPIC-UNREAD: /gps/fix: could be the gps by its type foxglove.LocationFix, but cannot be read: " in page
    assert run(file, "--gps", "/gps/fix")[0] == 3
    for code, page in (run(file, "--gps", "none"), run(other)):
        assert code == 3
        assert "TOPIC-UNREAD" not in page
        assert "cannot be replayed as is: no topic is a sensor that usbldr knows" in page
