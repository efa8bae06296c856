"""Odd and broken logs that others made: `usbldr info` lists what is there, and says what is not, in a sentence."""

import json
import shutil
from pathlib import Path

import pytest
from mcap.reader import make_reader

from commands import run
from usbldr.filters.errors import UsbldrError
from usbldr.io.decoding.collected import read_whole
from usbldr.io.formats.detect import open_reader

# file -> messages counted (the collection's expected.json), and words that the page must hold
ZOO: dict[str, tuple[int, str]] = {
    "01_TenMessages.mcap": (10, "no topic is a sensor that usbldr knows"),
    "02_TenMessages-ch-chx-mx-pad-rch-rsh-st-sum.mcap": (10, "no topic is a sensor that usbldr knows"),
    "03_TenMessages-ch-pad.mcap": (10, "no topic is a sensor that usbldr knows"),
    "04_TenMessages-ch-mx.mcap": (10, "no topic is a sensor that usbldr knows"),
    "05_OneMessage-rsh-sum.mcap": (1, "no topic is a sensor that usbldr knows"),
    "06_OneAttachment-ax-pad-st-sum.mcap": (0, "holds no messages"),
    "07_chatter.db3": (7, "no topic is a sensor that usbldr knows"),
    "08_test_bad_schema.mcap": (20, "/bad/data: the definition of its type broken_msgs/Garbage is not valid"),
    "09_test_publish_vs_log_time.mcap": (50, "1970-01-01T00:00:00.500Z"),
    "10_test_large_file.mcap": (50_000, "/bulk/data"),
    "11_test.mcap": (2172, "more topics (--all lists them)"),
    "12_nav2_turtlebot.mcap": (8197, "no topic is a sensor that usbldr knows"),
    "13_tf_example.bag": (518, "no topic is a sensor that usbldr knows"),
    "14_tutorial.mcap": (153, "gps: location (type and name), 51 of 51 records used"),
    "15_cdr_test": (7, "metadata.yaml names cdr_test_0.db3, which is missing; cdr_test.db3 is read instead"),
    "16_compressed_bag": (0, "holds no messages"),
    "17_multiple_files": (52, "2021-09-01T08:52:01.838Z to 2021-09-01T08:52:27.339Z"),
    "18_cdr_test": (7, "no topic is a sensor that usbldr knows"),
    "19_wrong_rmw_test": (7, "encoding wrong_format"),
    "20_test": (7, "test_msgs/Primitives"),
    "21_empty_bag": (0, "holds no messages"),
    "22_only_services.mcap": (12, "no topic is a sensor that usbldr knows"),
    "23_talker": (20, "/topic"),  # its metadata.yaml counts none, its table holds 20 rows
    "24_example-bz2.bag": (8647, "no topic is a sensor that usbldr knows"),
    "25_example-unsorted-chunks.bag": (3, "1970-01-01T00:00:01.000Z to 1970-01-01T00:00:03.000Z"),
    "26_no-messages.bag": (0, "holds no messages"),
    "27_fake_sensors_sample.bag": (20, "no topic is a sensor that usbldr knows"),
    "28_test.bag": (11, "no topic is a sensor that usbldr knows"),
    "29_test1.bag": (16_806, "gps: /fix (type and name), 982 of 989 records used"),
}


@pytest.fixture
def zoo(field_logs: Path) -> Path:
    return field_logs / "reader_zoo"


@pytest.mark.parametrize("name", ZOO)
def test_info_says_of_each_odd_file_what_it_is(zoo: Path, tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    (shutil.copytree if (zoo / name).is_dir() else shutil.copy)(zoo / name, path)
    before = sorted(str(file) for file in tmp_path.rglob("*"))
    count, words = ZOO[name]

    result = run("info", path, "--config", "none")

    assert words in result.stdout
    assert result.return_value == (3 if "\ncannot be replayed as is: " in result.stdout else 0)
    assert len(result.stdout.splitlines()) < 70
    described = json.loads(run("info", path, "--json").stdout)["logs"][0]
    assert sum(topic["messages"] for topic in described["topics"]) == count
    assert sorted(str(file) for file in tmp_path.rglob("*")) == before


@pytest.mark.parametrize("name", ZOO)
def test_replay_refuses_each_odd_file_in_one_sentence(zoo: Path, tmp_path: Path, name: str) -> None:
    result = run("replay", zoo / name, "--filter", "adf", "--output", tmp_path / "run")

    assert isinstance(result.exception, UsbldrError), result.exception
    assert result.exception.exit_code == 3
    assert not list(tmp_path.iterdir())


def test_info_says_which_sensor_a_replay_would_miss(zoo: Path) -> None:
    result = run("info", zoo / "29_test1.bag")

    assert result.return_value == 3
    assert "cannot be replayed as is: no dvl data (sensors in this log: compass, gps)" in result.stdout


def test_a_bad_definition_leaves_the_other_topics_readable(zoo: Path) -> None:
    log = open_reader(zoo / "08_test_bad_schema.mcap")
    readable = [topic for topic in log.topics() if not topic.problem]

    read = read_whole(log, {topic.name: topic.fields[:1] for topic in readable})

    assert sum(len(records.received_ns) for records in read.values()) == sum(topic.count for topic in readable) > 0


def test_log_time_is_arrival_and_publish_time_is_not(zoo: Path) -> None:
    log = open_reader(zoo / "09_test_publish_vs_log_time.mcap")
    (topic,) = log.topics()
    with (zoo / "09_test_publish_vs_log_time.mcap").open("rb") as file:
        messages = [message for _, _, message in make_reader(file).iter_messages()]

    received = read_whole(log, {topic.name: topic.fields[:1]})[topic.name].received_ns

    assert received.tolist() == [message.log_time for message in messages]
    assert received.tolist() != [message.publish_time for message in messages]


def test_no_odd_file_is_forgotten(zoo: Path) -> None:
    assert sorted(ZOO) == sorted(path.name for path in zoo.iterdir() if path.name[0].isdigit())
