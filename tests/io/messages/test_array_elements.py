"""Elements of arrays of messages: "beams[2].velocity" names one, in every encoding."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from google.protobuf.descriptor_pb2 import FieldDescriptorProto as Field
from google.protobuf.descriptor_pb2 import FileDescriptorProto
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from commands import run
from logs import logged, read_as, refusal
from protobuf_recordings import defined
from recordings import ROS2, SECOND, T0, Row, define, write_bag, write_mcap, write_payloads
from usbldr.filters.errors import UsageError
from usbldr.io.decoding.cdr import ros_decoder

TYPES = {
    "ping_msgs/msg/Hit": "string who\nbuiltin_interfaces/Time at\nfloat64[2] place\n",
    "ping_msgs/msg/Pings": "string note\nping_msgs/Hit[] hits\n",
}
PINGS = "ping_msgs/msg/Pings"
define(TYPES, ros_1=True)

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
    hit, pings = (described.message_type.add(name=name) for name in ("Hit", "Pings"))
    stamp, many = ".google.protobuf.Timestamp", Field.LABEL_REPEATED
    hit.field.append(Field(name="who", number=1, type=Field.TYPE_STRING, label=Field.LABEL_OPTIONAL))
    hit.field.append(Field(name="at", number=2, type=Field.TYPE_MESSAGE, type_name=stamp, label=Field.LABEL_OPTIONAL))
    hit.field.append(Field(name="place", number=3, type=Field.TYPE_DOUBLE, label=many))
    pings.field.append(Field(name="hits", number=1, type=Field.TYPE_MESSAGE, type_name=".ping.Hit", label=many))
    files, type_of = defined(described, imports_first=True)
    payloads: list[bytes] = []
    for k in range(len(SECONDS)):
        message = type_of("Pings")()
        for one in hits(k):
            part = message.hits.add(who=one["who"], place=one["place"])
            part.at.seconds, part.at.nanos = one["at"].values()
        payloads.append(message.SerializeToString())
    definition = ("ping.Pings", "protobuf", files.SerializeToString())
    return write_payloads(file, "/pings", "protobuf", definition, payloads)


WRITERS: dict[str, Callable[[Path], Path]] = {
    "ROS 2": lambda folder: write_mcap(folder / "dive.mcap", rows()),
    "ROS 1": lambda folder: write_bag(folder / "dive.bag", rows()),
    "JSON": lambda folder: written_in_json(folder / "dive.mcap"),
    "protobuf": lambda folder: written_in_protobuf(folder / "dive.mcap"),
}


@pytest.mark.parametrize("kind", WRITERS)
def test_the_second_of_several_hits_is_read_if_there_is_one_and_the_first_is_shown(tmp_path: Path, kind: str) -> None:
    file = WRITERS[kind](tmp_path)
    log, shown = read_as(file, COLUMNS), run("info", file, "--fields", "/pings").output

    second = [(k, hits(k)[1]) for k in range(len(SECONDS)) if SECONDS[k] > 1]
    table = log.tables["usbl"]
    np.testing.assert_array_equal(table[["east_m", "north_m"]], [one["place"] for _, one in second])
    assert [log.start_ns + round(t * 1e9) for t in table["time_s"]] == [T0 + k * SECOND + 8 for k, _ in second]
    assert all(f"  {name}\n" in shown for name in ("hits[0].who", "hits[0].at", "hits[0].place[0]"))


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

    sentence = refusal(UsageError, logged, tmp_path, rows(), toml)

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
