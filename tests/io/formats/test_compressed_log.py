"""Compressed logs are what their contents are; the libraries that compress them owe nothing to usbldr."""

import gc
import gzip
import hashlib
import random
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import pytest
import zstandard

import damage
from compressions import PACK
from damaged_formats import COUNT, FORMATS, dive
from logs import refusal
from recordings import SECOND, T0, saved, saved_lines, sentence, short_dive, write_bag, write_csv, write_mcap
from speed.bombs import in_mcap_in_file
from usbldr.filters.errors import LogError, UsageError
from usbldr.io.decoding.collected import read_whole
from usbldr.io.formats.detect import open_reader
from usbldr.io.limits import VARIABLE
from usbldr.io.reader import Records
from usbldr.io.reading.opening import Request
from usbldr.io.reading.read import read_log

DVL = "time_ns,forward_mps,starboard_mps\n" + "".join(f"{T0 + k * SECOND},{1 + k / 7:.9f},0.5\n" for k in range(60))
HEADINGS = [f"2020-09-13T12:26:{k:02d}Z {sentence(f'HEHDT,{k}.5,T')}" for k in range(60)]
WRITERS: Mapping[str, tuple[Callable[[Path], Path], Mapping[str, list[str]]]] = {
    "mcap": (lambda d: write_mcap(d / "a.mcap", dive()), {"/dvl": ["header.stamp", "twist.linear.x"]}),
    "bag": (lambda d: write_bag(d / "a.bag", dive()), {"/dvl": ["header.stamp", "twist.linear.x"]}),
    "csv": (lambda d: write_csv(d / "a", dvl=DVL) / "dvl.csv", {"/dvl": ["forward_mps", "starboard_mps"]}),
    "nmea": (lambda d: saved_lines(d / "a.nmea", HEADINGS), {"/HEHDT": ["heading_deg"]}),
}


def same(a: Records, b: Records) -> bool:
    same_times = np.array_equal(a.received_ns, b.received_ns)
    return same_times and all(np.array_equal(a.columns[path], b.columns[path]) for path in a.columns)


@pytest.mark.parametrize("ending", PACK)
@pytest.mark.parametrize("form", WRITERS)
def test_a_log_in_any_compression_is_the_log_itself(tmp_path: Path, form: str, ending: str) -> None:
    write, wanted = WRITERS[form]
    file = write(tmp_path)
    whole, pack = file.read_bytes(), PACK[ending]
    packed = tmp_path / f"{file.name}.{ending}"
    log = open_reader(file)

    for content in (pack(whole), pack(whole[:700]) + pack(whole[700:]), pack(whole) + bytes(512)):  # frames, zeros
        packed.write_bytes(content)
        found = open_reader(packed)
        assert found.topics() == log.topics()
        (topic,) = wanted
        assert same(read_whole(found, wanted)[topic], read_whole(log, wanted)[topic])
        assert found.findings() == log.findings()
        assert found.path == packed


def test_a_zstd_file_that_begins_with_a_frame_to_skip_is_read(tmp_path: Path) -> None:
    file = write_mcap(tmp_path / "a.mcap", dive())
    packed = saved(tmp_path / "a.zst", b"\x50\x2a\x4d\x18\4\0\0\0size", zstandard.compress(file.read_bytes()))

    assert open_reader(packed).topics() == open_reader(file).topics()


def test_a_run_names_the_file_that_the_user_has(tmp_path: Path) -> None:
    whole = write_mcap(tmp_path / "a.mcap", short_dive()).read_bytes()
    file = saved(tmp_path / "dive.mcap.zst", zstandard.compress(whole))
    before = set(Path(tmp_path).iterdir())
    log = read_log(file)

    assert log.path == file
    assert log.sha256 == hashlib.sha256(file.read_bytes()).hexdigest()
    assert log.format == "MCAP, zstd"
    assert set(Path(tmp_path).iterdir()) == before
    assert refusal(LogError, read_log, file, Request(topics={"dvl": "/absent"})).startswith(f"{file}: ")


@pytest.mark.parametrize("ending", ["bz2", "xz"])
def test_a_compressed_log_with_a_wrong_checksum_is_reported(tmp_path: Path, ending: str) -> None:
    """As those of gzip and zstd, which are among the formats of test_damage."""
    packed, rng = PACK[ending](FORMATS["CSV"].write(tmp_path).read_bytes()), random.Random(ending)
    file = saved(tmp_path / f"usbl.csv.{ending}", packed)
    right = damage.read(file, "CSV")
    for _ in range(40):
        file.write_bytes(damage.flipped(packed, rng))
        found = damage.read(file, "CSV")
        assert found.said or found.rows == right.rows
    assert len(right.rows["/usbl"]) == COUNT


def test_the_finding_says_how_far_the_file_was_decompressed(tmp_path: Path) -> None:
    file, packed = tmp_path / "dvl.csv.gz", gzip.compress(DVL.encode())
    size = len(packed)

    file.write_bytes(packed[:-9])
    (finding, *_) = open_reader(file).findings()
    assert finding.text == f"the gzip data end early, at byte {size - 9} of {size - 9}: what precedes is read"

    file.write_bytes(packed[:-5] + bytes([packed[-5] ^ 1]) + packed[-4:])
    (finding, *_) = open_reader(file).findings()
    assert finding.text.startswith(f"the gzip data are damaged at byte {size} of {size} (Error -3 while decompressing")


@pytest.mark.parametrize(
    ("content", "text"),
    [
        (b"\x28\xb5\x2f\xfdrest", "is damaged: no zstd data could be decompressed at byte 8 of 8"),
        (b"\x1f\x8brest", "is damaged: no gzip data could be decompressed at byte 6 of 6"),
        (gzip.compress(gzip.compress(b"time_ns\n")), "is compressed twice; decompress it once"),
        (gzip.compress(b""), "the file is empty"),
        (gzip.compress(b"\0\1\2"), "unknown format (starts with b'\\x00\\x01\\x02')"),
    ],
    ids=("no zstd data", "no gzip data", "twice", "empty", "unknown"),  # gzip holds the time of day
)
def test_what_cannot_be_decompressed_is_named(tmp_path: Path, content: bytes, text: str) -> None:
    file = saved(tmp_path / "dive.mcap.zst", content)

    assert refusal(LogError, open_reader, file).startswith(f"{file}: {text}")


def test_a_disk_that_is_full_is_one_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = saved(tmp_path / "dvl.csv.gz", gzip.compress(DVL.encode()))

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("usbldr.io.limits.UnpackingBudget.take_record", full)
    with pytest.raises(LogError, match=r"dvl.csv.gz: cannot be copied into .* \(No space left on device\); TMPDIR"):
        open_reader(file)


TRUTH = "timestamp,x,y\n" + "".join(f"{T0 / 1e9 + k},{2 * k},{3 * k}\n" for k in range(20))
TUM = "".join(f"{T0 / 1e9 + k} {2 * k} {3 * k} 0 0 0 0 1\n" for k in range(20))


@pytest.mark.parametrize("ending", PACK)
@pytest.mark.parametrize(("name", "text"), [("a.csv", TRUTH), ("a.tum", TUM), ("dive.mcap", "")])
def test_a_compressed_truth_is_read(tmp_path: Path, name: str, text: str, ending: str) -> None:
    log = write_mcap(tmp_path / "dive.mcap", short_dive())
    file = saved(tmp_path / name, text) if text else log
    saved(tmp_path / f"{name}.{ending}", PACK[ending](file.read_bytes()))

    plain, packed = (read_log(log, Request(truth=file)) for file in (name, f"{name}.{ending}"))

    assert plain.truth is not None
    assert packed.truth is not None
    assert packed.truth.position_m.tolist() == plain.truth.position_m.tolist()
    assert packed.truth.source.startswith(f"{name}.{ending}")


def test_a_compressed_truth_that_is_cut_is_read_up_to_the_cut(tmp_path: Path) -> None:
    log = write_mcap(tmp_path / "dive.mcap", short_dive())
    saved(tmp_path / "a.csv.gz", gzip.compress(TRUTH.encode())[:-20])
    lost = [one.text for one in read_log(log, Request(truth="a.csv.gz")).findings if one.lost_data]
    assert any(text.startswith("the gzip data end early") for text in lost)

    saved(tmp_path / "a.csv.gz", gzip.compress(b"a,b\n1,2\n"))
    with pytest.raises(UsageError, match=r"/a.csv.gz: which columns hold time and position \(it has a, b\)"):
        read_log(log, Request(truth="a.csv.gz"))
    saved(tmp_path / "a.csv.gz", gzip.compress(gzip.compress(TRUTH.encode())))
    with pytest.raises(LogError, match=r"/a.csv.gz: is compressed twice; decompress it once"):
        read_log(log, Request(truth="a.csv.gz"))


def test_the_limits_of_the_contents_follow_from_the_size_of_the_compressed_file(tmp_path, monkeypatch):
    file = in_mcap_in_file(tmp_path / "a.mcap.zst", 1_300_000, 300)
    monkeypatch.setenv(VARIABLE, "0.01")
    monkeypatch.setattr("usbldr.io.limits.UNPACKED_RATIO", 2_000_000)  # by its own size the copy could have 600 MB

    assert "too much for its size" in refusal(LogError, open_reader(file).topics)


def test_the_copy_goes_with_the_reader(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "temporary"))
    (tmp_path / "temporary").mkdir()
    file = saved(tmp_path / "dvl.csv.gz", gzip.compress(DVL.encode()))
    log = open_reader(file)

    assert len(list((tmp_path / "temporary").iterdir())) == 1
    del log
    gc.collect()
    assert list((tmp_path / "temporary").iterdir()) == []


def test_frames_of_several_compressions_are_read(tmp_path: Path) -> None:
    rows = gzip.compress("".join(f"{T0 + k},{k}\n" for k in range(9)).encode())
    file = saved(tmp_path / "compass.csv", zstandard.compress(b"time_ns,heading_deg\n"), rows)

    assert [topic.count for topic in open_reader(file).topics()] == [9]
