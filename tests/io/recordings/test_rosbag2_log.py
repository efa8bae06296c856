"""rosbag2 recordings: folders, single files, parts, and what is wrong with them."""

import shutil
import sqlite3
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import zstandard
from rosbags.rosbag2 import CompressionMode, StoragePlugin

import logs
from logs import TWIST_X, refusal
from recordings import SECOND, T0, Row, execute, short_dive, twist, write_rosbag2
from usbldr.filters.errors import LogError
from usbldr.io.decoding.collected import read_whole
from usbldr.io.formats.detect import open_reader
from usbldr.io.reader import Reader
from usbldr.io.reading.read import read_log, require


def stretch(first: int, last: int) -> list[Row]:
    return [twist(T0 + k * SECOND, float(k), 0.0) for k in range(first, last)]


def parts(folder: Path, *numbers: int) -> Path:
    """Write parts of ten records each, without metadata.yaml."""
    folder.mkdir()
    for number in numbers:
        made = write_rosbag2(folder.with_name(f"made{number}"), stretch(10 * number, 10 * number + 10))
        shutil.move(made / f"made{number}.db3", folder / f"dive_{number}.db3")
    return folder


def x_of(source: Path | Reader) -> list[float]:
    return logs.x_of(open_reader(source) if isinstance(source, Path) else source)


def five(folder: Path, *statements: str) -> Path:
    """Return a file of five messages after some statements of SQL."""
    file = write_rosbag2(folder / "dive", stretch(0, 5)) / "dive.db3"
    execute(file, *statements)
    return file


@pytest.mark.parametrize("storage", [StoragePlugin.SQLITE3, StoragePlugin.MCAP])
@pytest.mark.parametrize("metadata", [True, False])
def test_a_folder_is_read_with_and_without_its_metadata(tmp_path: Path, storage: StoragePlugin, metadata: bool) -> None:
    folder = write_rosbag2(tmp_path / "dive", short_dive(), storage)
    if not metadata:
        (folder / "metadata.yaml").unlink()

    log = open_reader(folder)
    dvl = read_whole(log, TWIST_X)["/dvl"]

    assert log.format == "rosbag2 folder"
    assert {topic.name: topic.count for topic in log.topics()} == {"/dvl": 11, "/imu": 11, "/usbl": 11}
    np.testing.assert_array_equal(dvl.columns["header.stamp"], T0 + np.arange(11) * SECOND)
    np.testing.assert_array_equal(dvl.columns["twist.linear.x"], np.ones(11))
    assert log.findings() == ()


def test_a_file_alone_is_read_and_nothing_is_written_beside_it(tmp_path: Path) -> None:
    file = five(tmp_path, "PRAGMA journal_mode=wal")
    (file.parent / "metadata.yaml").unlink()

    assert x_of(file) == [0, 1, 2, 3, 4]
    assert [child.name for child in file.parent.iterdir()] == ["dive.db3"]


def test_rows_in_the_journal_beside_the_file_are_read(tmp_path: Path) -> None:
    file = five(tmp_path)
    killed = tmp_path / "killed"
    killed.mkdir()
    with sqlite3.connect(file, isolation_level=None) as database:
        database.execute("PRAGMA journal_mode=wal")
        database.execute("INSERT INTO messages SELECT 90 + id, topic_id, 50000000000 + timestamp, data FROM messages")
        for name in ("dive.db3", "dive.db3-wal"):  # as they lie while the recorder still runs
            shutil.copy(file.with_name(name), killed)
    database.close()
    before = {path: path.read_bytes() for path in killed.iterdir()}

    log = open_reader(killed / "dive.db3")

    assert read_whole(log, TWIST_X)["/dvl"].columns["twist.linear.x"].tolist() == [0, 1, 2, 3, 4] * 2
    assert [(finding.code, finding.lost_data) for finding in log.findings()] == [("JOURNAL", False)]
    assert {path: path.read_bytes() for path in killed.iterdir()} == before
    assert open_reader(file).topics()[0].count == 10


def test_a_recording_with_a_missing_journal_is_reported(tmp_path: Path) -> None:
    (tmp_path / "spoilt").mkdir()
    file = five(tmp_path / "spoilt")
    file.with_name("dive.db3-wal").write_bytes(b"rows")

    (missing,) = open_reader(five(tmp_path, "PRAGMA journal_mode=wal")).findings()
    (spoilt,) = open_reader(file).findings()

    said = "the file was recorded with a journal; if the recorder was killed, rows of dive.db3-wal are missing"
    assert (missing.code, missing.lost_data, missing.text) == ("JOURNAL", False, said)
    assert (spoilt.code, spoilt.lost_data, x_of(file)) == ("JOURNAL", True, [0, 1, 2, 3, 4])


def test_parts_are_read_in_the_order_of_time(tmp_path: Path) -> None:
    assert x_of(parts(tmp_path / "dive", 0, 10, 2, 1, 3, 4, 5, 6, 7, 8, 9)) == list(range(110))


def named(folder: Path, *names: str) -> Path:
    listed = "".join(f"    - {name}\n" for name in names)
    (folder / "metadata.yaml").write_text(f"rosbag2_bagfile_information:\n  relative_file_paths:\n{listed}")
    return folder


@pytest.mark.parametrize(
    ("numbers", "names", "code", "text"),
    [
        ((0, 2), (), "MISSING-PART", "part 1 is missing: the parts are numbered from 0"),
        ((0, 1), ("dive_0", "dive_1", "dive_2"), "MISSING-PART", "dive_2.db3 is missing: metadata.yaml names it"),
        ((0,), ("old_0",), "RENAMED",
         "metadata.yaml names old_0.db3, which is missing; dive_0.db3 is read instead"),
    ],
)  # fmt: skip
def test_a_missing_part_is_lost_data_and_a_renamed_one_is_not(tmp_path, numbers, names, code, text):
    folder = parts(tmp_path / "dive", *numbers)
    if names:
        named(folder, *(f"{name}.db3" for name in names))

    (finding,) = open_reader(folder).findings()

    assert x_of(folder) == [x for number in numbers for x in range(10 * number, 10 * number + 10)]
    assert (finding.code, finding.text, finding.lost_data) == (code, text, code == "MISSING-PART")


@pytest.mark.parametrize("name", ["a_1.db3", "other.mcap"])
def test_a_part_that_the_metadata_do_not_name_is_lost_data(tmp_path: Path, name: str) -> None:
    folder = write_rosbag2(tmp_path / "a", short_dive())
    (folder / name).touch()

    (lost,) = open_reader(folder).findings()
    assert lost.text == f"{name}: not read, because metadata.yaml does not name it; --with FILE adds it"
    assert lost.lost_data


@pytest.mark.parametrize(
    ("files", "sentence"),
    [
        ([], "metadata.yaml names dive_0.db3, which is missing (the folder holds metadata.yaml)"),
        (["dive_0.db3", "other_0.db3"],
         "holds 2 recordings (dive_0.db3, other_0.db3); name one of them, or join them with --with"),
    ],
)  # fmt: skip
def test_a_folder_that_is_no_recording_is_named(tmp_path: Path, files: list[str], sentence: str) -> None:
    folder = parts(tmp_path / "dive", 0)
    whole = (folder / "dive_0.db3").read_bytes()
    (folder / "dive_0.db3").unlink()
    for name in files:
        (folder / name).write_bytes(whole)
    if not files:
        named(folder, "dive_0.db3")

    assert refusal(LogError, open_reader, folder) == f"{folder}: {sentence}"


@pytest.mark.parametrize("mode", [CompressionMode.FILE, CompressionMode.MESSAGE])
@pytest.mark.parametrize("storage", [StoragePlugin.SQLITE3, StoragePlugin.MCAP])
def test_a_compressed_recording_is_read(tmp_path: Path, storage: StoragePlugin, mode: CompressionMode) -> None:
    folder = write_rosbag2(tmp_path / "dive", stretch(0, 10), storage, mode)
    (part,) = (file for file in folder.iterdir() if file.name != "metadata.yaml")
    assert part.name.endswith(".zstd") == (mode is CompressionMode.FILE)

    for path in (folder, part):
        assert x_of(path) == list(range(10))
        assert open_reader(path).findings() == ()
    (folder / "metadata.yaml").unlink()
    assert x_of(folder) == list(range(10))


def test_a_compressed_part_beside_its_copy_is_read_once(tmp_path: Path) -> None:
    folder = write_rosbag2(tmp_path / "dive", stretch(0, 10), packed=CompressionMode.FILE)
    packed = folder / "dive.db3.zstd"
    packed.with_suffix("").write_bytes(zstandard.ZstdDecompressor().decompressobj().decompress(packed.read_bytes()))

    assert x_of(folder) == list(range(10))
    packed.write_bytes(b"damaged")
    assert x_of(folder) == list(range(10))


def test_a_compressed_part_that_is_missing_or_cut_is_reported(tmp_path: Path) -> None:
    folder = tmp_path / "dive"
    parts(folder, 0, 1, 2)
    for file in list(folder.glob("*.db3")):
        file.with_name(file.name + ".zstd").write_bytes(zstandard.compress(file.read_bytes()))
        file.unlink()
    (folder / "dive_1.db3.zstd").unlink()

    (finding,) = open_reader(folder).findings()
    assert finding.text == "part 1 is missing: the parts are numbered from 0"
    (folder / "dive_2.db3.zstd").write_bytes(zstandard.compress(bytes(9))[:8])

    log = open_reader(folder)

    assert [finding.text for finding in log.findings() if finding.lost_data][1:] == [
        "dive_2.db3.zstd cannot be read: is damaged: no zstd data could be decompressed at byte 8 of 8"
    ]
    (alone,) = open_reader(folder / "dive_0.db3.zstd").topics()
    assert log.topics() == (replace(alone, file="dive_0.db3.zstd"),)


def test_a_file_from_before_definitions_is_read_by_the_standard_types(tmp_path: Path) -> None:
    unknown = "INSERT INTO topics SELECT 9, '/x', 'my_msgs/msg/X', 'cdr', '', '' FROM topics"
    log = open_reader(five(tmp_path, "DROP TABLE message_definitions", unknown))

    problems = {topic.name: topic.problem for topic in log.topics()}

    assert x_of(log) == [0, 1, 2, 3, 4]
    assert problems["/dvl"] == ""
    assert problems["/x"].startswith("the file holds no definition of its type my_msgs/msg/X")


@pytest.mark.parametrize("keep", [0.02, 0.25, 0.5, 0.75, 0.9, 0.99])
def test_a_cut_db3_is_an_error_that_names_a_way_to_recover_it(tmp_path: Path, keep: float) -> None:
    file = write_rosbag2(tmp_path / "dive", short_dive() * 50) / "dive.db3"
    whole = file.read_bytes()
    file.write_bytes(whole[: round(keep * len(whole))])

    said = refusal(LogError, x_of, file)

    assert said.startswith(f"{file}: is not a readable rosbag2 recording (")
    assert ".recover" in said


WITHOUT_NUMBERS = "CREATE TABLE topics AS SELECT NULL AS id, name, type, serialization_format FROM sound"
NO_RECORDING = (
    "is a sqlite3 file, but not a rosbag2 recording (no such table: messages); export the tables of another database "
    "as CSV (sqlite3 -header -csv "
)


@pytest.mark.parametrize(
    ("opened", "statements", "sentence"),
    [
        ("dive.db3", ["DROP TABLE messages"], NO_RECORDING),
        ("", ["ALTER TABLE topics RENAME TO sound", WITHOUT_NUMBERS], "is not a readable rosbag2 recording"),
    ],
)
def test_sqlite_that_is_no_recording_is_an_error(tmp_path, opened, statements, sentence):
    file = five(tmp_path, *statements)

    assert refusal(LogError, lambda: open_reader(file.parent / opened).topics()).startswith(f"{file}: {sentence}")


@pytest.mark.parametrize(
    ("statements", "times", "code", "text", "lost"),
    [
        ([], 2, "PART-TWICE", "", False),
        (["DELETE FROM messages WHERE id = 3"], 1, "", "1 of 5 messages in metadata.yaml are missing", True),
    ],
    ids=["a part that is listed twice", "a message that is missing"],
)
def test_a_part_is_read_once_and_counted_against_the_metadata(tmp_path, statements, times, code, text, lost):
    metadata = five(tmp_path, *statements).with_name("metadata.yaml")
    listed, part = metadata.read_text(encoding="utf-8"), "  - dive.db3\n"
    assert part in listed
    metadata.write_text(listed.replace(part, times * part, 1), encoding="utf-8")
    log = open_reader(metadata.parent)

    (finding,) = [finding for finding in log.findings() if finding.code != "JOURNAL"]

    assert sum(topic.count for topic in log.topics()) == 5 - lost
    assert finding.code.endswith(code)
    assert text in finding.text
    assert (finding.level, finding.lost_data) == ("error" if lost else "warning", lost)


def test_an_encoding_that_is_not_read_is_named_if_its_sensor_is_missing(tmp_path: Path) -> None:
    folder = five(tmp_path, "UPDATE topics SET serialization_format = 'wrong'").parent

    with pytest.raises(LogError, match=r"no dvl data .*; /dvl cannot be read: encoding wrong is not supported, only"):
        require(read_log(folder), ["dvl"])
