"""MCAP channels in protobuf and JSON, written by Google's and Python's own libraries."""

import json
import math
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from google.protobuf.descriptor_pb2 import FieldDescriptorProto as Field
from google.protobuf.descriptor_pb2 import FileDescriptorProto, FileDescriptorSet
from mcap.writer import Writer

from logs import only
from protobuf_recordings import defined
from recordings import SECOND, T0, write_payloads
from usbldr.filters.errors import LogError
from usbldr.io.decoding.collected import read_whole
from usbldr.io.decoding.columns import DefinitionError
from usbldr.io.decoding.json_messages import JsonDecoder, schema_of
from usbldr.io.decoding.protobuf import ProtobufDecoder
from usbldr.io.formats.detect import open_reader
from usbldr.io.provenance import Convention
from usbldr.io.reading.read import Request, read_log


def field(
    name: str, number: int, kind: Any, type_name: str = "", repeated: bool = False, optional: bool = False
) -> Field:
    made = Field(name=name, number=number, type=kind, label=Field.LABEL_REPEATED if repeated else Field.LABEL_OPTIONAL)
    if type_name:
        made.type_name = type_name
    if optional:
        made.proto3_optional, made.oneof_index = True, 0
    return made


def described() -> FileDescriptorProto:
    """Return foxglove.LocationFix by its published field numbers, and a DVL report of ours."""
    file = FileDescriptorProto(name="all.proto", package="foxglove", syntax="proto3")
    fix = file.message_type.add(name="LocationFix")
    fix.enum_type.add(name="PositionCovarianceType").value.add(name="UNKNOWN", number=0)
    fix.enum_type[0].value.add(name="DIAGONAL_KNOWN", number=2)
    fix.field.extend(
        [
            field("timestamp", 6, Field.TYPE_MESSAGE, ".google.protobuf.Timestamp"),
            field("frame_id", 7, Field.TYPE_STRING),
            field("latitude", 1, Field.TYPE_DOUBLE),
            field("longitude", 2, Field.TYPE_DOUBLE),
            field("position_covariance", 4, Field.TYPE_DOUBLE, repeated=True),
            field("position_covariance_type", 5, Field.TYPE_ENUM, ".foxglove.LocationFix.PositionCovarianceType"),
            field("heading", 10, Field.TYPE_DOUBLE, optional=True),
            field("raw", 99, Field.TYPE_BYTES),
        ]
    )
    fix.oneof_decl.add(name="_heading")
    dvl = file.message_type.add(name="DVL")
    vector = dvl.nested_type.add(name="Vector")
    vector.field.extend(field(axis, k + 1, Field.TYPE_DOUBLE) for k, axis in enumerate("xyz"))
    dvl.field.extend(
        [
            field("velocity", 1, Field.TYPE_MESSAGE, ".foxglove.DVL.Vector"),
            field("velocity_valid", 2, Field.TYPE_BOOL),
            field("again", 3, Field.TYPE_MESSAGE, ".foxglove.DVL"),  # definitions may be recursive
        ]
    )
    return file


DESCRIPTORS, type_of = defined(described(), imports_first=False)
LocationFix, Dvl = type_of("LocationFix"), type_of("DVL")
TIME = {"type": "object", "title": "time", "properties": {"sec": {"type": "integer"}, "nsec": {"type": "integer"}}}
SCHEMA = {
    "title": "foxglove.LocationFix",
    "type": "object",
    "properties": {
        "timestamp": TIME,
        "frame_id": {"type": "string"},
        "latitude": {"type": "number"},
        "longitude": {"type": "number"},
        "position_covariance": {"type": "array", "items": {"type": "number"}},
        "position_covariance_type": {"oneOf": [{"title": "UNKNOWN", "const": 0}, {"title": "KNOWN", "const": 3}]},
        "heading": {"type": ["number", "null"]},
    },
}

Channel = tuple[str, str, str, bytes]  # type, encoding, encoding of the definition, definition
PROTOBUF: Channel = ("foxglove.LocationFix", "protobuf", "protobuf", DESCRIPTORS.SerializeToString())
JSON: Channel = ("foxglove.LocationFix", "json", "jsonschema", json.dumps(SCHEMA).encode())


def write(file: Path, channel: Channel, payloads: Iterable[bytes], topic: str = "location") -> Path:
    name, encoding, schema_encoding, definition = channel
    return write_payloads(file, topic, encoding, (name, schema_encoding, definition), payloads)


def in_protobuf(time_ns: int, values: Mapping[str, Any]) -> bytes:
    made = LocationFix(**values)
    made.timestamp.seconds, made.timestamp.nanos = divmod(time_ns, SECOND)
    return made.SerializeToString()


def in_json(time_ns: int, values: Mapping[str, Any]) -> bytes:
    sec, nsec = divmod(time_ns, SECOND)
    return json.dumps({"timestamp": {"sec": sec, "nsec": nsec}, **values}).encode()


BOTH = pytest.mark.parametrize(
    ("channel", "encode"), [(PROTOBUF, in_protobuf), (JSON, in_json)], ids=["protobuf", "json"]
)
BERMUDA = {"latitude": 32.25, "longitude": -64.75, "frame_id": "gps"}


@BOTH
def test_a_foxglove_fix_is_a_gps_fix_at_its_own_time(tmp_path: Path, channel: Channel, encode: Any) -> None:
    known = {"position_covariance": np.diag([4.0, 4.0, 9.0]).ravel().tolist(), "position_covariance_type": 2}
    payloads = [encode(T0 - 1, BERMUDA | known), encode(T0 + SECOND - 1, BERMUDA)]

    log = read_log(write(tmp_path / "dive.mcap", channel, payloads))

    table = log.tables["gps"]
    assert table["lat_deg"].tolist() == [32.25, 32.25]
    assert table["lon_deg"].tolist() == [-64.75, -64.75]
    np.testing.assert_allclose(table["sd_m"], [2.0, np.nan])  # an empty covariance is unknown
    assert log.start_ns == T0 - 1
    assert table["time_s"].tolist() == [0.0, 1.0]
    assert log.provenance["gps"].type == "foxglove.LocationFix"


def test_a_pose_in_json_may_be_a_usbl_fix(tmp_path: Path) -> None:
    xyz = {"type": "object", "properties": {axis: {"type": "number"} for axis in "xyz"}}
    pose = {"type": "object", "properties": {"position": xyz}}
    schema = {"properties": {"timestamp": TIME, "frame_id": {"type": "string"}, "pose": pose}}
    channel = ("foxglove.PoseInFrame", "json", "jsonschema", json.dumps(schema).encode())
    payload = in_json(T0, {"frame_id": "map_ned", "pose": {"position": {"x": 3.0, "y": 4.0, "z": 5.0}}})

    table = read_log(write(tmp_path / "dive.mcap", channel, [payload], "/usbl/fix")).tables["usbl"]

    assert (table["east_m"].iloc[0], table["north_m"].iloc[0]) == (4.0, 3.0)


NO_SCHEMA = [("", b""), ("jsonschema", b""), ("jsonschema", b"{}"), ("jsonschema", b'{"type": "object"}')]


@pytest.mark.parametrize(("encoding", "definition"), NO_SCHEMA)
def test_json_without_fields_in_its_schema_is_read(tmp_path: Path, encoding: str, definition: bytes) -> None:
    known = {"position_covariance": (np.eye(3) * 4.0).ravel().tolist(), "position_covariance_type": 2}
    payloads = [b"no json", in_json(T0, {"heading": None}), in_json(T0 + 7, BERMUDA | known)]

    log = read_log(write(tmp_path / "dive.mcap", ("foxglove.LocationFix", "json", encoding, definition), payloads))

    assert log.tables["gps"][["lat_deg", "lon_deg", "sd_m"]].to_numpy().tolist() == [[32.25, -64.75, 2.0]]
    assert log.start_ns == T0 + 7


def test_json_without_the_name_of_a_type_is_refused(tmp_path: Path) -> None:
    with (tmp_path / "dive.mcap").open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        writer.add_message(writer.register_channel("location", "json", 0), T0, in_json(T0, BERMUDA), T0)
        writer.finish()

    with pytest.raises(LogError, match=r"location cannot be read as gps: its messages \(json\) have no definition"):
        read_log(tmp_path / "dive.mcap", Request(topics={"gps": "location"}))


@BOTH
def test_a_heading_may_be_absent(tmp_path: Path, channel: Channel, encode: Any) -> None:
    payloads = [encode(T0, BERMUDA), encode(T0 + SECOND, BERMUDA | {"heading": math.pi / 2})]

    log = read_log(write(tmp_path / "dive.mcap", channel, payloads), Request(topics={"compass": "location"}))

    assert log.tables["compass"]["heading_deg"].tolist() == pytest.approx([90.0])
    assert only(log, "COMPASS-INVALID") == "location: 1 of 2 records are invalid and left out (1 not a number)"


@BOTH
def test_bytes_that_do_not_fit_are_counted(tmp_path: Path, channel: Channel, encode: Any) -> None:
    payloads = [encode(T0, BERMUDA), b"\xff\xff\xff", b'{"latitude": "north"}', b'{"timestamp": 5}']

    log = read_log(write(tmp_path / "dive.mcap", channel, payloads))

    assert len(log.tables["gps"]) == 1
    assert (
        only(log, "UNDECODED")
        == "location: 3 messages, the first of 2020-09-13T12:26:41.000Z, do not match their definition in the file"
    )


def test_a_velocity_that_is_not_set_is_not_standing_still(tmp_path: Path) -> None:
    """proto3 gives zeros for a message that is absent; an absent DVL message is not zero velocity."""
    still = Dvl(velocity_valid=True)
    still.velocity.x = 0.0
    payloads = [still.SerializeToString(), Dvl(velocity_valid=True).SerializeToString()]

    log = read_log(write(tmp_path / "dive.mcap", ("foxglove.DVL", *PROTOBUF[1:]), payloads, "/dvl"))

    assert log.tables["dvl"]["valid"].tolist() == [True, False]
    assert log.provenance["dvl"].conventions[0] == Convention("axes", "FRD", "type")


STAMPED = {"stamp": "2020-09-13T12:26:40.5Z", "header": {"stamp": {"sec": 5, "nanosec": 7}}, "name": "B01"}
WHOLE = {"properties": {"a": {"type": "integer"}, "b": {"type": "number"}}}


def stamp_of(inner: Any) -> Any:
    return {"properties": {"header": {"properties": {"stamp": inner}}}}


@pytest.mark.parametrize(
    ("schema", "sample", "values"),
    [
        *((stamp_of({"properties": {name: {} for name in spelled}}), {"header": {"stamp": spelled}},
           {"header.stamp": 5_000_000_007})
          for spelled in ({"sec": 5, "nsec": 7}, {"secs": 5, "nsecs": 7}, {"seconds": 5, "nanos": 7},
                          {"sec": 5, "nanosec": 7})),
        (stamp_of({"format": "date-time", "type": "string"}), {"header": {"stamp": "1970-01-01T00:00:05.000000007Z"}},
         {"header.stamp": 5_000_000_007}),
        # times without a schema are known by their look
        (None, STAMPED, {"stamp": T0 + SECOND // 2, "header.stamp": 5_000_000_007, "name": "B01"}),
        # integers of 64 bits keep all their digits as text
        (WHOLE, {"a": "1600000000123456789", "b": "1.5"}, {"a": 1600000000123456789, "b": 1.5}),
        (WHOLE, {"a": "many", "b": "1.5"}, {"a": None, "b": None}),
    ],
)  # fmt: skip
def test_fields_of_json_have_their_values(schema: Any, sample: Any, values: dict[str, Any]) -> None:
    text = json.dumps(sample).encode()
    decoder = JsonDecoder("x", schema_of([text]) if schema is None else json.dumps(schema).encode())

    found = decoder.extractor(list(values))(text)

    assert found == (None if None in values.values() else tuple(values.values()))
    assert decoder.fields == tuple(values)


def test_json_schemas_may_refer_to_their_own_parts() -> None:
    part = {"type": "object", "properties": {"x": {"type": "number"}, "again": {"$ref": "#/definitions/v"}}}
    schema = {"properties": {"twist": {"$ref": "#/definitions/v"}}, "definitions": {"v": part}}
    decoder = JsonDecoder("x", json.dumps(schema).encode())

    assert decoder.fields[:2] == ("twist.x", "twist.again.x")
    assert decoder.extractor(["twist.x", "twist.again.x"])(b'{"twist": {"x": 1}}')[0] == 1  # type: ignore[index]


@pytest.mark.parametrize(
    ("decoder", "definition"),
    [(JsonDecoder, b"{"), (JsonDecoder, b"[]"), (ProtobufDecoder, b"\xff"), (ProtobufDecoder, b"")],
)
def test_a_definition_without_sense_is_named(decoder: Any, definition: bytes) -> None:
    with pytest.raises(DefinitionError):
        decoder("foxglove.LocationFix", definition)


def test_an_import_that_the_file_lacks_is_named(tmp_path: Path) -> None:
    alone = FileDescriptorSet(file=[DESCRIPTORS.file[0]]).SerializeToString()
    file = write(tmp_path / "dive.mcap", ("foxglove.LocationFix", "protobuf", "protobuf", alone), [b""])

    (topic,) = open_reader(file).topics()

    assert topic.problem.startswith("the definition of its type foxglove.LocationFix is not valid (")


def test_the_fields_of_a_ships_protobuf_log_are_found(field_logs: Path) -> None:
    reader = open_reader(field_logs / "reader_zoo" / "11_test.mcap")
    topic = max(reader.topics(), key=lambda topic: topic.count)

    records = read_whole(reader, {topic.name: ["timestamp"]})[topic.name]

    assert topic.fields == ("timestamp",)
    assert np.all(np.abs(records.columns["timestamp"] - records.received_ns) < 3600 * SECOND)
