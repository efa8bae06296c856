"""Elements of arrays of messages: "beams[2].velocity" names one, in every encoding."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from google.protobuf.descriptor_pb2 import FieldDescriptorProto as Field
from google.protobuf.descriptor_pb2 import FileDescriptorProto, FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from commands import run
from logs import read_as, refusal
from recordings import ROS1, ROS2, SECOND, T0, Row, define, write_bag, write_mcap, write_payloads
from usbldr.filters.errors import UsageError
from usbldr.io.decoding.cdr import ros_decoder
from usbldr.io.reading.read import Request, read_log

TYPES = {
    "ping_msgs/msg/Hit": "string who\nbuiltin_interfaces/Time at\nfloat64[2] place\n",
    "ping_msgs/msg/Pings": "string note\nping_msgs/Hit[] hits\n",
}
PINGS = "ping_msgs/msg/Pings"
define(TYPES)
for _name, _text in TYPES.items():
    ROS1.register(get_types_from_msg(_text, _name))

SECONDS = (1, 3, 0, 2, 2, 3)  # hits of each message
COLUMNS = """
[usbl]
columns = { time_ns = "hits[1].at", x = "hits[1].place[0]", y = "hits[1].place[1]", target = "hits[1].who" }
target = "B1"
"""


def hits(k: int) -> list[dict[str, Any]]:
    """Return the hits of message k as JSON objects."""
    return [
        {"who": f"B{j}", "at": {"sec": T0 // SECOND + k, "nsec": 7 + j}, "place": [100.0 * j + k, 10.0 * j - k]}
        for j in range(SECONDS[k])
    ]


def rows() -> list[Row]:
    hit, time = ROS2.types["ping_msgs/msg/Hit"], ROS2.types["builtin_interfaces/msg/Time"]
    made: list[Row] = []
    for k in range(len(SECONDS)):
        parts = [hit(one["who"], time(*one["at"].values()), np.array(one["place"])) for one in hits(k)]
        made.append((T0 + k * SECOND + SECOND // 2, "/pings", PINGS, {"note": "x" * k, "hits": parts}))
    return made


def written_in_json(file: Path) -> Path:
    hit = {"who": {"type": "string"}, "at": {"properties": {"sec": {}, "nsec": {}}}}
    hit["place"] = {"items": {"type": "number"}}
    schema = {"properties": {"hits": {"items": {"properties": hit}}}}
    payloads = [json.dumps({"hits": hits(k)}).encode() for k in range(len(SECONDS))]
    return write_payloads(file, "/pings", "json", ("Pings", "jsonschema", json.dumps(schema).encode()), payloads)


def written_in_protobuf(file: Path) -> Path:
    described = FileDescriptorProto(name="pings.proto", package="ping", syntax="proto3")
    described.dependency.append("google/protobuf/timestamp.proto")
    hit, pings = (described.message_type.add(name=name) for name in ("Hit", "Pings"))
    stamp, many = ".google.protobuf.Timestamp", Field.LABEL_REPEATED
    hit.field.append(Field(name="who", number=1, type=Field.TYPE_STRING, label=Field.LABEL_OPTIONAL))
    hit.field.append(Field(name="at", number=2, type=Field.TYPE_MESSAGE, type_name=stamp, label=Field.LABEL_OPTIONAL))
    hit.field.append(Field(name="place", number=3, type=Field.TYPE_DOUBLE, label=many))
    pings.field.append(Field(name="hits", number=1, type=Field.TYPE_MESSAGE, type_name=".ping.Hit", label=many))
    files = FileDescriptorSet(file=[timestamp_file(), described])
    pool = DescriptorPool()
    for one in files.file:
        pool.Add(one)
    made: Any = GetMessageClass(pool.FindMessageTypeByName("ping.Pings"))
    payloads: list[bytes] = []
    for k in range(len(SECONDS)):
        message = made()
        for one in hits(k):
            part = message.hits.add(who=one["who"], place=one["place"])
            part.at.seconds, part.at.nanos = one["at"].values()
        payloads.append(message.SerializeToString())
    definition = ("ping.Pings", "protobuf", files.SerializeToString())
    return write_payloads(file, "/pings", "protobuf", definition, payloads)


def timestamp_file() -> FileDescriptorProto:
    from google.protobuf import timestamp_pb2

    return FileDescriptorProto.FromString(timestamp_pb2.DESCRIPTOR.serialized_pb)


WRITERS: dict[str, Callable[[Path], Path]] = {
    "ROS 2": lambda folder: write_mcap(folder / "dive.mcap", rows()),
    "ROS 1": lambda folder: write_bag(folder / "dive.bag", rows()),
    "JSON": lambda folder: written_in_json(folder / "dive.mcap"),
    "protobuf": lambda folder: written_in_protobuf(folder / "dive.mcap"),
}


@pytest.mark.parametrize("kind", WRITERS)
def test_the_second_of_several_hits_is_read_if_there_is_one(tmp_path: Path, kind: str) -> None:
    log = read_as(WRITERS[kind](tmp_path), COLUMNS)

    second = [(k, hits(k)[1]) for k in range(len(SECONDS)) if SECONDS[k] > 1]
    table = log.tables["usbl"]
    np.testing.assert_array_equal(table[["east_m", "north_m"]], [one["place"] for _, one in second])
    assert [log.start_ns + round(t * 1e9) for t in table["time_s"]] == [T0 + k * SECOND + 8 for k, _ in second]


@pytest.mark.parametrize("kind", WRITERS)
def test_the_fields_of_a_topic_show_the_first_element(tmp_path: Path, kind: str) -> None:
    shown = run("info", WRITERS[kind](tmp_path), "--fields", "/pings").output

    for name in ("hits[0].who", "hits[0].at", "hits[0].place[0]"):
        assert f"  {name}\n" in shown


@pytest.mark.parametrize(
    ("name", "hint"),
    [
        ("hits[1]", "hits[0].at"),
        ("hits.at", "hits[0].at"),
        ("hits[1].place", "hits[0].place[0]"),
        ("hits[1].at[0]", "hits[0].at"),
        ("note[0].at", "hits[0].at"),
    ],
)
def test_a_part_that_is_no_field_is_one_sentence(tmp_path: Path, name: str, hint: str) -> None:
    toml = f'[depth]\ntopic = "/pings"\ncolumns = {{ depth_m = "{name}" }}\n'
    (tmp_path / "other.toml").write_text(toml, encoding="utf-8")

    file, request = write_mcap(tmp_path / "dive.mcap", rows()), Request(configuration=str(tmp_path / "other.toml"))
    sentence = refusal(UsageError, read_log, file, request)

    assert f"/pings has no {name} ([depth] columns depth_m)" in sentence
    assert "(it has note, hits[0].who, hits[0].at, hits[0].place[0])" in sentence
    assert hint in sentence


def test_many_lengths_of_arrays_need_no_decoder_for_each_message(monkeypatch: pytest.MonkeyPatch) -> None:
    store = get_typestore(Stores.ROS2_HUMBLE)
    name, definition = "ranges_msgs/msg/Ranges", "ranges_msgs/Beam[] beams\nbuiltin_interfaces/Time end\n"
    beam = "uint8 ok\nfloat64 range\n"
    store.register(get_types_from_msg(definition, name) | get_types_from_msg(beam, "ranges_msgs/msg/Beam"))
    one, whole, time = (store.types[t] for t in ("ranges_msgs/msg/Beam", name, "builtin_interfaces/msg/Time"))
    lengths = np.random.default_rng(5).integers(0, 6, 300)
    made = [whole([one(j % 2, k + j / 8) for j in range(n)], time(k, 0)) for k, n in enumerate(lengths.tolist())]
    payloads = [bytes(store.serialize_cdr(message, name)) for message in made]
    decoder = ros_decoder(name, store.generate_msgdef(name, ros_version=2)[0].encode())
    monkeypatch.setattr(Typestore, "deserialize_cdr", None)

    pieces = decoder.pieces(payloads, ["beams.3.range", "end"])

    rows_and_values = (zip(piece.rows, piece.columns["beams.3.range"], strict=True) for piece in pieces)
    read = {int(row): value for one in rows_and_values for row, value in one}
    expected = [k + 3 / 8 if n > 3 else np.nan for k, n in enumerate(lengths.tolist())]
    np.testing.assert_array_equal([read[k] for k in range(300)], expected)
