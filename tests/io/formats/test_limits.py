"""Files made to exhaust memory or time: each is refused in one sentence, at once and without the memory.

The files are small: the limits are lowered to a hundredth, as --limits 0.01 does.
"""

import bz2
import gzip
import json
import lzma
import os
import struct
import time
import tracemalloc
from collections.abc import Callable
from pathlib import Path

import pytest
import zstandard
from google.protobuf.descriptor_pb2 import FileDescriptorProto, FileDescriptorSet

from logs import refusal
from recordings import HEADING, T0, execute, saved, short_dive, write_mcap, write_payloads, write_rosbag2
from speed.bombs import bz2_of, in_bag, in_db3, in_file, in_mcap, in_mcap_in_file, lz4_of, zstd_of
from usbldr.filters.errors import LogError, UsageError, UsbldrError
from usbldr.io.decoding.collected import read_whole
from usbldr.io.decoding.decoders import decoder_of
from usbldr.io.findings import Finding
from usbldr.io.formats.detect import open_reader
from usbldr.io.limits import VARIABLE, factor
from usbldr.io.reading.opening import Request
from usbldr.io.reading.read import read_log
from usbldr.io.settings.validation import read_document

MB = 1 << 20
CHUNK = 1_300_000  # [bytes] within the lowered limit of a chunk, 1.3 MB

BOMBS: dict[str, Callable[[Path], Path]] = {
    "bag bz2, one chunk": lambda d: in_bag(d / "a", "bz2", [(0xFFFFFFFF, bz2_of(20 * MB))]),
    "bag bz2, a chunk larger than stated": lambda d: in_bag(d / "a", "bz2", [(1000, bz2_of(20 * MB))]),
    "bag bz2, many chunks": lambda d: in_bag(d / "a", "bz2", [(CHUNK, bz2_of(CHUNK))] * 1000),
    "bag lz4, many chunks": lambda d: in_bag(d / "a", "lz4", [(CHUNK, lz4_of(CHUNK))] * 1000),
    "mcap zstd, one chunk": lambda d: in_mcap(d / "a", "zstd", [(20 * MB, zstd_of(20 * MB))]),
    "mcap zstd, a chunk larger than stated": lambda d: in_mcap(d / "a", "zstd", [(1000, zstd_of(20 * MB))]),
    "mcap zstd, many chunks": lambda d: in_mcap(d / "a", "zstd", [(CHUNK, zstd_of(CHUNK))] * 1000),
    "mcap lz4, many chunks": lambda d: in_mcap(d / "a", "lz4", [(CHUNK, lz4_of(CHUNK))] * 1000),
    "mcap zstd, many records": lambda d: in_mcap(
        d / "a", "zstd", [(930_000, zstandard.compress((b"\x05" + struct.pack("<Q", 22) + bytes(22)) * 30_000))] * 9
    ),
    "csv gzip, many rows": lambda d: in_file(d / "a", gzip.compress, b"time_ns,x\n", b"1,2\n" * 1000, 1000),
    "csv gzip, many bytes": lambda d: in_file(d / "a", gzip.compress, b"time_ns,x\n", b"1," * 100_000, 1000),
    "mcap.bz2, many zeros": lambda d: in_file(d / "a", bz2.compress, b"\x89MCAP0\r\n\0", bytes(CHUNK), 1000),
    "mcap.xz, many zeros": lambda d: in_file(d / "a", lzma.compress, b"\x89MCAP0\r\n\0", bytes(CHUNK), 100),
    "mcap.zst, many chunks in a file": lambda d: in_mcap_in_file(d / "a", CHUNK, 1000),
    "db3 zstd, many messages": lambda d: in_db3(d / "a", [zstd_of(CHUNK)] * 1000),
    "db3 zstd, one message": lambda d: in_db3(d / "a", [zstd_of(20 * MB)]),
}


@pytest.mark.parametrize("bomb", BOMBS)
def test_what_decompresses_to_too_much_is_refused_or_left_out_and_said(tmp_path, bomb, monkeypatch):
    file = BOMBS[bomb](tmp_path)
    monkeypatch.setenv(VARIABLE, "0.01")
    tracemalloc.start()
    begun = time.process_time()
    findings: tuple[Finding, ...] = ()
    sentence = ""
    try:
        log = open_reader(file)
        log.topics()
        findings = log.findings()
    except LogError as fault:
        sentence = str(fault)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()

    assert peak < 12 * MB
    assert time.process_time() - begun < 10
    if "many" in bomb:
        assert sentence.endswith(" for its size; --limits 10 raises the limits tenfold")
    else:
        assert any(finding.lost_data for finding in findings)


def test_the_limits_are_raised_by_a_factor(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = write_mcap(tmp_path / "a.mcap", short_dive() * 60)
    monkeypatch.setenv(VARIABLE, "0.0015")  # a chunk of 0.2 MB
    log = open_reader(file)
    read_whole(log, {"/dvl": ["header.stamp"]})
    (finding,) = log.findings()
    assert "chunks are damaged or decompress to more than 0.201 MB each (--limits 10 raises the limits" in finding.text

    monkeypatch.setenv(VARIABLE, "0.01")
    log = open_reader(file)
    assert len(read_whole(log, {"/dvl": ["header.stamp"]})["/dvl"].received_ns) == 660
    assert log.findings() == ()


@pytest.mark.parametrize("text", ["0", "-1", "nan", "inf", "much"])
def test_a_factor_that_is_no_positive_number_is_an_error(monkeypatch: pytest.MonkeyPatch, text: str) -> None:
    monkeypatch.setenv(VARIABLE, text)

    with pytest.raises(UsageError, match=f"is {text}, not a positive number"):
        factor()


def test_a_view_in_place_of_messages_is_refused(tmp_path: Path) -> None:
    file = in_db3(tmp_path / "a.db3", [])
    endless = "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n) SELECT 1, i, x'00' FROM n"
    execute(file, "DROP TABLE messages", f"CREATE VIEW messages(topic_id, timestamp, data) AS {endless}")

    assert "messages is no table" in refusal(LogError, open_reader(file).topics)


def nested(levels: int, twice: bool) -> str:
    """Return a type in a type in a type, each once or twice."""
    lines = "a/B{0} x\n" + "a/B{0} y\n" * twice
    parts = [lines.format(0), *(f"MSG: a/B{k}\n" + lines.format(k + 1) for k in range(levels))]
    return ("=" * 80 + "\n").join([*parts, f"MSG: a/B{levels}\nfloat64 v\n"])


def recursive_protobuf() -> bytes:
    file = FileDescriptorProto(name="a.proto", syntax="proto3")
    message = file.message_type.add(name="A")
    for k in range(20):
        message.field.add(name=f"f{k}", number=k + 1, type=11, type_name=".A", label=1)  # pyright: ignore
    return FileDescriptorSet(file=[file]).SerializeToString()


HUGE_ARRAY = f"a/B[2000000000] x\n{'=' * 80}\nMSG: a/B\nint8 v"
RECURSIVE_JSON = json.dumps(
    {"properties": {f"p{k}": {"$ref": "#/definitions/x"} for k in range(10)}}
    | {"definitions": {"x": {"properties": {f"p{k}": {"$ref": "#/definitions/x"} for k in range(10)}}}}
).encode()
ENDLESS: dict[str, tuple[str, bytes, str]] = {
    "a/msg/A contains itself": ("ros2msg", b"a/A x", "cdr"),
    "a/msg/A contains itself ": ("ros2msg", b"a/A[] x", "cdr"),
    "it has more than 20000 fields  ": ("ros2msg", nested(40, True).encode(), "cdr"),
    "it is nested too deeply": ("ros2msg", nested(3000, False).encode(), "cdr"),
    "it has more than 20000 fields   ": ("ros2msg", HUGE_ARRAY.encode(), "cdr"),
    "it is nested too deeply ": ("jsonschema", b'{"a":' * 100_000, "json"),
    "it has more than 20000 fields": ("jsonschema", RECURSIVE_JSON, "json"),
    "it has more than 20000 fields ": ("protobuf", recursive_protobuf(), "protobuf"),
}


@pytest.mark.parametrize("sentence", ENDLESS)
def test_a_definition_without_end_is_named(sentence: str) -> None:
    language, definition, encoding = ENDLESS[sentence]
    name = "A" if encoding == "protobuf" else "a/A"

    problem = decoder_of(name, definition, encoding, language)

    assert isinstance(problem, str)
    assert problem.startswith(f"the definition of its type {name} is not valid ({sentence.strip()}")


def test_too_many_topics_or_definitions_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    topics = write_mcap(tmp_path / "a.mcap", [(T0 + k, f"/t{k}", HEADING, {}) for k in range(21)])
    long = (HEADING, "ros2msg", "".join(f"float64 f{i}\n" for i in range(20)).encode())
    definitions = write_payloads(tmp_path / "b.mcap", "/t", "cdr", long, [b"\0\1\0\0" + bytes(8)])

    monkeypatch.setenv(VARIABLE, "0.01")
    assert "has more than 20 topics" in refusal(LogError, open_reader(topics).topics)
    monkeypatch.setenv(VARIABLE, "0.0001")
    monkeypatch.setattr("usbldr.io.decoding.decoders.TOPICS", 1 << 20)
    assert "more than 0 kB" in open_reader(definitions).topics()[0].problem


@pytest.mark.parametrize("name", ["a.csv", "a.nmea"])
def test_a_line_without_end_is_refused(tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    text = "time_ns,heading_deg\n1," if name == "a.csv" else "$HEHDT,1.0,T\n" * 9 + "$HEHDT,"
    monkeypatch.setenv(VARIABLE, "0.01")

    with pytest.raises(LogError, match=r"line \d+ is longer than 10486 characters, too long for a log"):
        open_reader(saved(tmp_path / name, text, "9" * 20_000 + "\n")).topics()


@pytest.fixture
def pipe(tmp_path: Path) -> Path:
    os.mkfifo(tmp_path / "pipe.msg")
    return tmp_path / "pipe.msg"


def test_a_pipe_is_not_waited_for(pipe: Path, tmp_path: Path) -> None:
    file = write_mcap(tmp_path / "a.mcap", short_dive())
    assert "is neither a file nor a folder" in refusal(LogError, read_log, pipe)
    assert "is no file of at most" in refusal(UsageError, read_log, file, Request(msg_path=(str(tmp_path),)))
    assert "is neither a file nor a folder" in refusal(LogError, read_log, file, Request(joined=(str(pipe),)))
    with pytest.raises(UsbldrError):
        read_log(file, Request(configuration=str(pipe)))


def test_a_folder_of_definitions_without_end_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "link").symlink_to("/")
    file = write_mcap(tmp_path / "a.mcap", short_dive())
    monkeypatch.setenv(VARIABLE, "0.01")

    with pytest.raises(UsageError, match="holds more than 500 files and folders; name the folder of the packages"):
        read_log(file, Request(msg_path=(str(tmp_path / "link"),)))


def test_a_file_that_cannot_be_read_is_one_sentence() -> None:
    with pytest.raises(LogError, match=r"^/proc/self/mem: cannot be read \(Input/output error\)$"):
        open_reader(Path("/proc/self/mem"))


@pytest.mark.parametrize(
    "text",
    [
        "a0: &a0 [x, x]\n" + "".join(f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 10)}]\n" for k in range(1, 12))
        + "rosbag2_bagfile_information:\n  relative_file_paths: *a11\n",
        "a: " + "[" * 3_000,
        "{ : [",
    ],
    ids=["aliases", "depth", "no YAML"],
)  # fmt: skip
def test_metadata_that_multiplies_or_is_not_yaml_is_ignored(tmp_path: Path, text: str) -> None:
    folder = write_rosbag2(tmp_path / "a", short_dive())
    (folder / "metadata.yaml").write_text(text, encoding="utf-8")

    assert sum(topic.count for topic in open_reader(folder).topics()) == 33


@pytest.mark.parametrize("text", ["a = " + "[" * 100_000, "a" + ".a" * 100_000 + " = 1"], ids=["lists", "keys"])
def test_a_configuration_that_is_nested_too_deeply_is_refused(tmp_path: Path, text: str) -> None:
    assert "nested too deeply" in refusal(UsageError, read_document, saved(tmp_path / "usbldr.toml", text))
