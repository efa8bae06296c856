"""Recordings that do not define their messages: what is known, what a user's folder adds, and other languages."""

import random
import sqlite3
import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from chance import anything
from commands import run
from recordings import SECOND, T0, Row, define, execute, message, saved, write_payloads, write_rosbag2
from usbldr.filters.errors import UsageError
from usbldr.io.decoding.cdr import RosDecoder, ros_decoder
from usbldr.io.decoding.collected import read_whole
from usbldr.io.decoding.columns import DefinitionError
from usbldr.io.decoding.decoders import decoder_of, decoder_without_definition
from usbldr.io.decoding.definitions import KNOWN, SHIPPED, with_folders
from usbldr.io.recordings.db3_log import Db3Log
from usbldr.io.recordings.mcap_log import McapLog

BEAM = "int64 id\nfloat64 velocity\nfloat64 distance\nfloat64 rssi\nfloat64 nsd\nbool valid\n"
START = "std_msgs/Header header\nfloat64 time\ngeometry_msgs/Vector3 velocity\nfloat64 fom\n"
OF_2024 = START + "float64 altitude\nDVLBeam[] beams\nbool velocity_valid\nint64 status\nstring form\n"
OF_2025 = START + (
    "float64[] covariance\nfloat64 altitude\nDVLBeam[] beams\nbool velocity_valid\nint64 status\n"
    "int64 time_of_validity\nint64 time_of_transmission\nstring form\n"
)


def undefined_dvl(folder: Path, layout: str) -> Path:
    """Write ten messages of dvl_msgs/DVL, x counting up, into a db3 that does not define them."""
    store = get_typestore(Stores.ROS2_FOXY)
    store.register(get_types_from_msg(BEAM, "dvl_msgs/msg/DVLBeam") | get_types_from_msg(layout, "dvl_msgs/msg/DVL"))
    beam = message("dvl_msgs/msg/DVLBeam", {"velocity": 0.1, "distance": 5.0, "rssi": -40.0, "valid": True}, store)
    values = {"header.frame_id": "dvl_link", "time": 0.2, "velocity.y": 0.5, "fom": 0.01, "altitude": 12.0}
    values |= {"beams": [beam] * 4, "velocity_valid": True, "form": "json_v3"}
    if "covariance" in layout:
        clocks = {"time_of_validity": T0 // 1000, "time_of_transmission": T0 // 1000 + 189_000}
        values |= {"covariance": np.arange(9.0), **clocks}
    times = [T0 + k * SECOND for k in range(10)]
    own = [values | {"header.stamp": t, "velocity.x": float(k)} for k, t in enumerate(times)]
    write_rosbag2(
        folder, [(t, "/dvl/data", "dvl_msgs/msg/DVL", one) for t, one in zip(times, own, strict=True)], store=store
    )
    (file,) = folder.glob("*.db3")
    execute(file, "DROP TABLE message_definitions")
    return file


@pytest.mark.parametrize(("layout", "has_covariance"), [(OF_2024, False), (OF_2025, True)])
def test_the_layout_that_the_bytes_have_is_found(tmp_path: Path, layout: str, has_covariance: bool) -> None:
    log = Db3Log(undefined_dvl(tmp_path / "a", layout))

    (topic,) = log.topics()
    dvl = read_whole(log, {"/dvl/data": ["velocity.x", "fom", "velocity_valid", "header.stamp"]})["/dvl/data"]

    assert topic.has("covariance.0") == has_covariance
    np.testing.assert_array_equal(dvl.columns["velocity.x"], np.arange(10.0))
    np.testing.assert_array_equal(dvl.columns["header.stamp"], T0 + np.arange(10) * SECOND)
    assert dvl.columns["velocity_valid"].all()
    assert log.findings() == ()


def test_so_it_is_in_an_mcap_file(tmp_path: Path) -> None:
    with sqlite3.connect(undefined_dvl(tmp_path / "a", OF_2024)) as database:
        rows = database.execute("SELECT timestamp, data FROM messages").fetchall()
    database.close()
    schema = ("dvl_msgs/msg/DVL", "ros2msg", b"")
    file = write_payloads(tmp_path / "a.mcap", "/dvl/data", "cdr", schema, [data for _, data in rows])

    dvl = read_whole(McapLog(file), {"/dvl/data": ["velocity.x"]})["/dvl/data"]

    np.testing.assert_array_equal(dvl.columns["velocity.x"], np.arange(10.0))


def test_bytes_of_no_known_layout_are_named_with_the_way_out(tmp_path: Path) -> None:
    file = undefined_dvl(tmp_path / "a", OF_2024)
    execute(file, "UPDATE messages SET data = substr(data, 1, length(data) - 20)")
    log = Db3Log(file)

    assert [topic.problem for topic in log.topics()] == [
        "the file holds no definition of its type dvl_msgs/msg/DVL, and its messages do not match the 2 known layouts; "
        "name a folder that holds the right dvl_msgs/msg/DVL.msg with --msg-path DIR"
    ]


PUBLISHED = {  # checksums of the fields as the packages' own .msg files give them, in the order of the layouts
    "interfaces/msg/BottomTrack": (530532187, 3672009620),
    "interfaces/msg/AHRS": (2777103905,),
    "interfaces/msg/INS": (357821593,),
    "sbg_driver/msg/SbgEkfEuler": (1423584575, 4058058632, 327793669),
    "sbg_driver/msg/SbgEkfQuat": (1032460708, 1330022712, 3844379208),
    "sbg_driver/msg/SbgEkfNav": (41585990, 609418882, 36108182),
    "sbg_driver/msg/SbgGpsPos": (1301906655, 3354498289),
    "septentrio_gnss_driver/msg/AttEuler": (118665567,),
    "septentrio_gnss_driver/msg/INSNavGeod": (1602391508,),
    "septentrio_gnss_driver/msg/PVTGeodetic": (2105092687,),
    "vectornav_msgs/msg/CommonGroup": (2703983523,),
    "vectornav_msgs/msg/GpsGroup": (2659939396,),
    "vectornav_msgs/msg/InsGroup": (2918653756,),
    "ublox_msgs/msg/NavPVT": (3967674807,),
    "ublox_msgs/msg/NavPVT7": (1931569046,),
    "mavros_msgs/msg/VfrHud": (3719652947,),
}


def fields_of(types: Any, name: str, prefix: str = "") -> list[str]:
    """Return kind and path of each field of a type, parts of its own package resolved."""
    found: list[str] = []
    for field, (node, what) in types[name][1]:
        inside = node is Nodetype.NAME and what.split("/")[0] == name.split("/")[0]
        found += fields_of(types, what, f"{prefix}{field}.") if inside else [f"{what} {prefix}{field}"]
    return found


@pytest.mark.parametrize("name", PUBLISHED)
def test_known_instruments_have_the_fields_that_their_drivers_publish(name: str) -> None:
    layouts = SHIPPED.layouts(name)

    assert [zlib.crc32("\n".join(fields_of(types, name)).encode()) for types in layouts] == list(PUBLISHED[name])


@pytest.mark.parametrize("name", [name for name, sums in PUBLISHED.items() if len(sums) > 1])
def test_layouts_of_an_instrument_are_told_apart_by_their_bytes(name: str) -> None:
    for types in SHIPPED.layouts(name):
        store = get_typestore(Stores.EMPTY)
        store.register(dict(types))
        rng = random.Random(name)
        made = [anything(store, (Nodetype.NAME, name), rng, 4) for _ in range(5)]
        samples = [bytes(store.serialize_cdr(one, name)) for one in made]

        decoder = decoder_without_definition(name, SHIPPED, samples)

        assert isinstance(decoder, RosDecoder)
        assert decoder.fields == RosDecoder(name, types).fields


@pytest.fixture
def own(tmp_path: Path) -> Path:
    """Return a recording of messages that only its maker knows."""
    texts = {"Angle": "float64 degrees\n", "Compass": "std_msgs/Header header\nour_msgs/Angle heading\n"}
    define({f"our_msgs/msg/{name}": text for name, text in texts.items()})
    values = [{"header.stamp": k * SECOND, "heading.degrees": float(k)} for k in range(5)]
    rows: list[Row] = [(T0 + k, "/compass", "our_msgs/msg/Compass", one) for k, one in enumerate(values)]
    write_rosbag2(tmp_path / "own", rows)
    execute(tmp_path / "own" / "own.db3", "DROP TABLE message_definitions")
    messages = tmp_path / "src" / "our_msgs" / "msg"
    messages.mkdir(parents=True)
    for name, text in texts.items():
        saved(messages / f"{name}.msg", "# ours\n", text)
    return tmp_path


def test_a_damaged_definition_of_time_does_no_harm() -> None:
    """The layout of a time is fixed; rosbags refuses any other."""
    parts = "builtin_interfaces/Time stamp\nfloat64 data\n", "MSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosfc\n"
    decoder = decoder_of("our_msgs/msg/Timed", f"\n{'=' * 80}\n".join(parts).encode(), "cdr", "ros2msg")

    assert isinstance(decoder, RosDecoder)
    assert decoder.extractor(["data"])(b"\0\1\0\0" + struct.pack("<iId", 5, 0, 1.5)) == (1.5,)


@pytest.mark.parametrize("folder", ["src", "src/our_msgs", "src/our_msgs/msg"])
def test_a_folder_of_definitions_makes_messages_readable(own: Path, folder: str) -> None:
    log = Db3Log(own / "own" / "own.db3", with_folders([str(own / folder)]))

    read = read_whole(log, {"/compass": ["heading.degrees"]})["/compass"]

    np.testing.assert_array_equal(read.columns["heading.degrees"], np.arange(5.0))


def test_a_definition_of_a_type_that_nobody_defines_is_named(own: Path, tmp_path: Path) -> None:
    (tmp_path / "our_msgs").mkdir()
    (tmp_path / "our_msgs" / "Compass.msg").write_text("other_msgs/Heading heading")

    (topic,) = Db3Log(own / "own" / "own.db3", with_folders([str(tmp_path)])).topics()

    assert topic.problem.startswith("the file holds no definition of its type our_msgs/msg/Compass, and the one that")
    assert "--msg-path names is not valid (" in topic.problem


def test_every_command_that_reads_a_log_has_the_option_for_it(own: Path) -> None:
    log = str(own / "own")

    without = run("info", log)
    with_it = run("info", log, "--msg-path", own / "src")
    wrong = run("info", log, "--msg-path", own / "gone")

    assert "msgs/msg/Compass; name a folder that holds our_msgs/msg/Compass.msg with --msg-path DIR" in without.output
    assert "--msg-path" not in with_it.output
    assert isinstance(wrong.exception, UsageError)
    assert str(wrong.exception) == (f"--msg-path {own / 'gone'}: no such folder; expected PACKAGE/msg/TYPE.msg")


@pytest.mark.parametrize("content", [b"float64 = =", b"\xff\xfe\x00", None])
def test_a_definition_that_makes_no_sense_or_none_is_named(tmp_path: Path, content: bytes | None) -> None:
    (tmp_path / "our_msgs").mkdir()
    if content:
        (tmp_path / "our_msgs" / "Bad.msg").write_bytes(content)

    said = r"our_msgs/Bad\.msg: is not a message definition \(" if content else r"holds no \.msg file"
    with pytest.raises(UsageError, match=said):
        with_folders([str(tmp_path)])


@pytest.mark.parametrize("name", KNOWN)
def test_every_known_message_is_known_with_all_its_parts(name: str) -> None:
    for types in SHIPPED.layouts(name):
        store = get_typestore(Stores.EMPTY)
        store.register(dict(types))
        assert store.get_msgdef(name)


IDL = """\
// generated from rosidl_adapter/resource/msg.idl.em
#include "std_msgs/msg/Header.idl"

module our_msgs {
  module msg {
    typedef double double__3[3];
    struct Fix {
      std_msgs::msg::Header header;
      double__3 position;
      boolean valid;
      string name;
    };
  };
};
"""
HEADER_IDL = """\
#include "builtin_interfaces/msg/Time.idl"
module std_msgs { module msg { struct Header { builtin_interfaces::msg::Time stamp; string frame_id; }; }; };
"""
TIME_IDL = "module builtin_interfaces { module msg { struct Time { int32 sec; uint32 nanosec; }; }; };\n"


def test_definitions_in_idl_are_read(tmp_path: Path) -> None:
    line = "=" * 80 + "\n"
    parts = {"our_msgs/msg/Fix": IDL, "std_msgs/msg/Header": HEADER_IDL, "builtin_interfaces/msg/Time": TIME_IDL}
    definition = "".join(f"{line}IDL: {name}\n{text}" for name, text in parts.items())
    data = b"\0\1\0\0" + struct.pack("<iII4s", 7, 5, 4, b"map") + struct.pack("<3d?xxxI4s", 1, 2, 3, True, 4, b"one")
    schema = ("our_msgs/msg/Fix", "ros2idl", definition.encode())
    file = write_payloads(tmp_path / "a.mcap", "/fix", "cdr", schema, [data])

    paths = ["header.stamp", "header.frame_id", "position.1", "valid", "name"]
    read = read_whole(McapLog(file), {"/fix": paths})["/fix"]

    values = dict(zip(paths, [7_000_000_005, "map", 2.0, True, "one"], strict=True))
    assert {path: column[0] for path, column in read.columns.items()} == values


@pytest.mark.parametrize("size", ["1 << 40000000000", "9999999999 * 9999999999", "9" * 5000])
def test_constants_in_idl_are_not_computed(size: str) -> None:
    with pytest.raises(DefinitionError):
        ros_decoder(
            "our_msgs/msg/Fix",
            f"module our_msgs {{ module msg {{ const long A = {size}; }}; }};".encode(),
            language="idl",
        )


def test_operators_in_comments_and_texts_of_idl_compute_nothing() -> None:
    text = """\
module our_msgs { module msg {
  /* a * b << c */
  @verbatim (language="comment", text="a b * c << 3")
  struct Fix { double x; // x * 2
  };
}; };
"""
    assert ros_decoder("our_msgs/msg/Fix", text.encode(), language="idl").fields == ("x",)
