"""NMEA sentences, in files and in topics, against the manuals and recordings of their vendors."""

import contextlib
import math
import random
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from logs import HEAD, MAP, codes, columns, covariance, logged, logged_nmea, on_map, read_as
from recordings import SECOND, T0, saved, saved_lines, sentence
from usbldr.filters.errors import UsbldrError
from usbldr.io.decoding.collected import read_whole
from usbldr.io.decoding.nmea_kinds import SENTENCE_KINDS
from usbldr.io.decoding.nmea_times import NO_TIME, prefixed_ns, times_from_sentences
from usbldr.io.formats.detect import open_reader
from usbldr.io.provenance import Convention
from usbldr.io.reading.read import Request, read_log

STRING = "std_msgs/msg/String"
DAY = 86_400 * SECOND

# recorded sentences of a HiPAP, a Ranger 2 and two GAPS with their own checksums
RECORDED_GGA = "$GPGGA,075617.34,7002.968962,N,02938.350607,E,2,12,0.6,-0.52,M,20.34,M,7.0,0907*6F"
NO_REPLY = "$PSIMSSB,083733.036,M17,A,NRy,C,N,F,0.000,0.000,0.000,20.000,T,0.003731,*08"
NORTH_UP = "$PSIMSSB,180554.432,M44,A,,C,N,M,-61.300,39.017,34.026,0.072,T,0.050576,*47"
RANGER = "$PSONLLD,133707.52,2401,A,51.3315406,-0.83563975,999.916,5.33,5.33,0.00,0.62,,,,*2A"
RANGER_SHIP = "$PSONLLD,133707.59,Ship 1,A,51.3306281,-0.83499295,0.000,0.08,0.08,0.00,0.01,,,,*1D"
GAPS = "$PTSAG,#16068,124544.449,18,12,2017,1,4305.25355,N,00631.76852,E,F,1013.10,1,9999.00*23"
GAPS_SHIP = "$PTSAG,#16071,124546.173,18,12,2017,0,4305.25123,N,00631.79102,E,F,0002.89,1,9999.00*25"
GAPS_WEST = "$PTSAG,#2374110,055648.831,05,04,2018,3,2718.19917,N,01747.61373,W,F,0005.8,1,9999.0*"


def timed(*sentences: str) -> list[str]:
    """Return a sentence a second, with log times."""
    return [f"{1600000000 + k} {one}" for k, one in enumerate(sentences)]


NORTH = {"gps.time_s": [0], "gps.lat_deg": [70 + 2.968962 / 60], "gps.lon_deg": [29 + 38.350607 / 60]}
IMPOSSIBLE = GAPS.partition("*")[0].replace("2017", "9999")
MIDNIGHT = [  # one RMC holds the date; a GGA after midnight is of the next day
    sentence("GPRMC,235959.00,A,4500.000,N,00700.000,E,1.0,90.0,311219,,,A"),
    *(sentence(f"GPGGA,{at},4500.000,N,00700.000,E,1,10,0.8,1.0,M,48.0,M,,") for at in ("235959.50", "000000.50")),
]


@pytest.mark.parametrize(
    ("lines", "start", "wanted"),
    [
        ([f"2026-05-23T07:56:17.900Z {RECORDED_GGA}"], "2026-05-23T07:56:17.340", NORTH | {"gps.received_s": [0.56]}),
        ([RECORDED_GGA], "1970-01-01T07:56:17.340", NORTH),
        ([GAPS], "2017-12-18T12:45:44.449", {"usbl.time_s": [0]}),
        ([f"2017-12-18T12:45:46Z {IMPOSSIBLE}"], "2017-12-18T12:45:44.449", {"usbl.time_s": [0]}),
        (MIDNIGHT, "2019-12-31T23:59:59.500", {"gps.time_s": [0, 1]}),
    ],
    ids=["of the log time", "none", "its own", "an impossible one", "without log times midnight is a jump back"],
)
def test_a_time_of_day_has_the_date_that_is_known(tmp_path, lines, start, wanted):
    log = logged_nmea(tmp_path, *lines, toml=MAP if "usbl.time_s" in wanted else "")

    assert log.start_ns == np.datetime64(start, "ns").astype(int)
    assert columns(log, wanted) == {name: pytest.approx(values, abs=1e-9) for name, values in wanted.items()}
    assert ("1970-01-01" in codes(log).get("NMEA-DATE", "")) == start.startswith("1970")


@pytest.mark.parametrize("order", [("GPRMC", "GPGGA"), ("GPGGA", "GPRMC")])
@pytest.mark.parametrize("dates", [("010126", "020126"), ("010126", "180506")])
def test_each_date_is_that_of_sentences_around_it(tmp_path: Path, order: Sequence[str], dates: Sequence[str]) -> None:
    """A receiver that was off for a day and ten minutes, and one whose count of weeks begins again: 2026 is 2006."""
    lines: list[str] = []
    for minute, date in zip(("1200", "1210"), dates, strict=True):
        for second in range(20):
            at, where = f"{minute}{second:02d}.00", "4500.000,N,00700.000,E"
            both = {"GPRMC": f"GPRMC,{at},A,{where},1.0,90.0,{date},,,A"}
            both["GPGGA"] = f"GPGGA,{at},{where},1,10,0.8,1.0,M,48.0,M,,"
            lines += [sentence(both[name]) for name in order]
    log = open_reader(saved_lines(tmp_path / "gps.nmea", [*lines, sentence("HEHDT,1.0,T")]))
    read = read_whole(log, {"/GPGGA": ["header.stamp"], "/GPRMC": ["header.stamp"], "/HEHDT": ["1"]})

    starts = [
        np.datetime64(f"20{d[4:]}-{d[2:4]}-{d[:2]}T12:{m}", "ns") for d, m in zip(dates, ("00", "10"), strict=True)
    ]
    expected = [int(start.astype(int)) + k * SECOND for start in starts for k in range(20)]
    for topic in ("/GPGGA", "/GPRMC"):
        assert read[topic].received_ns.tolist() == expected
        assert read[topic].columns["header.stamp"].tolist() == expected
    assert read["/HEHDT"].received_ns[0] == pytest.approx(expected[-1], abs=20 * SECOND)


def test_sentences_without_a_time_are_spaced_evenly_between_those_with_one() -> None:
    received, dated = times_from_sentences(np.array([10, NO_TIME, NO_TIME, NO_TIME, 14]) * 1, np.full(5, NO_TIME))

    assert received.tolist() == [10, 11, 12, 13, 14]
    assert not dated


@pytest.mark.parametrize(
    ("prefix", "time_ns"),
    [
        ("1600000000.123456789 ", T0 + 123_456_789),
        ("1600000000 ", T0),
        ("[1600000000123] ", T0 + 123_000_000),
        ("1600000000123456,", T0 + 123_456_000),
        ("1600000000123456789,", T0 + 123_456_789),
        ("2020-09-13T12:26:40.5Z ", T0 + SECOND // 2),
        ("2020/09/13 12:26:40,5\t", T0 + SECOND // 2),
        ("2020-09-13 14:26:40+02:00 ", T0),
        ("2020-09-13 09:56:40 -0230 ", T0),
        ("13.09.2020 12:26:40,5 ", T0 + SECOND // 2),
        ("\\s:GP0001,c:1600000000*4A\\", T0),
        ("\\c:1600000000500*4A\\", T0 + SECOND // 2),
        ("SN1600000001 ", NO_TIME),
        ("no. 100012345 ", NO_TIME),
        ("9999-09-13 12:26:40 ", NO_TIME),
        ("9999999999999999999,", NO_TIME),
        ("12:26:40 ", NO_TIME),
        ("COM1: ", NO_TIME),
    ],
)
def test_lines_begin_with_their_log_time_in_many_ways(prefix: str, time_ns: int) -> None:
    assert prefixed_ns(prefix) == time_ns


TENTHS = [*range(30), *range(50, 60)]
OF_DAY = [f"[23:59:{57 + k // 10}.{k % 10}00] {sentence(f'HEHDT,{k}.0,T')}" for k in TENTHS if k < 30]
OF_DAY += [f"[00:00:{k // 10 - 3:02d}.{k % 10}00] {sentence(f'HEHDT,{k}.0,T')}" for k in TENTHS if k >= 30]
BODIES = (f"GPGGA,1226{k:02d}.00,4500.0,N,00700.0,E,1,10,0.8,1.0,M,48.0,M,," for k in range(40, 60))
SAME = [f"COM3 1234567890 {sentence(body)}" for body in BODIES]  # a number that is no time
IN_LINES = [f"[12:26:{40 + k / 10:06.3f}] {sentence(f'HEHDT,{k}.0,T')}" for k in range(10, 30, 2)]
IN_LINES.insert(3, f"[12:26:41.500] {sentence('PACME,122641.10,1')}")
IN_LINES.insert(7, f"[12:26:42.300] {sentence('PACME,1600000002.1,1')}")
BY_TIME = {"NMEA-TIME": "lines are timed by the time of day before them", "NMEA-DATE": "the only date is that of PACME"}
BY_DAY = {"NMEA-TIME": "timed by the time of day before them", "NMEA-DATE": "no sentence contains a date"}


def scs(form: str, day: int) -> list[str]:
    """Return lines as SCS of NOAA writes them: 09/13/2020,23:59:58.100,$HEHDT."""
    times = [datetime(2020, 9, day, 23, 59, 58, tzinfo=UTC) + timedelta(seconds=k) for k in range(4)]
    dates = [form.format(m=time.month, d=time.day, y=time.year) for time in times]
    return [f"{date},{time:%H:%M:%S}.100,{sentence('HEHDT,30.0,T')}" for date, time in zip(dates, times, strict=True)]


@pytest.mark.parametrize(
    ("lines", "first", "spaced_ns", "said"),
    [
        (SAME, "1970-01-01T12:26:40", np.arange(20) * SECOND, {"NMEA-DATE": "", "NMEA-TIME": ""}),
        (OF_DAY, "1970-01-01T23:59:57", np.array(TENTHS) * (SECOND // 10), BY_DAY),
        (IN_LINES, "2020-09-13T12:26:40", np.arange(10, 30, 2) * SECOND // 10, BY_TIME),
        (scs("{m:02}/{d:02}/{y}", 13), "2020-09-13T23:59:58.1", np.arange(4) * SECOND, {}),
        (scs("{d}/{m}/{y}", 13), "2020-09-13T23:59:58.1", np.arange(4) * SECOND, {}),
        (scs("{m:02}/{d:02}/{y}", 5), "2020-09-05T23:59:58.1", np.arange(4) * SECOND, {"DATE-ORDER": ""}),
    ],
    ids=["a number that stays the same", "of the day", "beside their times", "month first", "day first", "either"],
)
def test_lines_are_timed_by_what_stands_before_their_sentences(tmp_path, lines, first, spaced_ns, said):
    log = open_reader(saved_lines(tmp_path / "a.nmea", lines))

    topic = log.topics()[0]
    times = read_whole(log, {topic.name: ["1"]})[topic.name].received_ns
    np.testing.assert_array_equal(times, np.datetime64(first, "ns").astype(int) + spaced_ns)
    found = {one.code: one.text for one in log.findings()}
    assert found.keys() == said.keys()
    assert all(text in found[code] for code, text in said.items())


@pytest.mark.parametrize(
    ("sentences", "sensor", "code", "said"),
    [
        ([RECORDED_GGA, RECORDED_GGA.replace("7002", "7003")], "gps", "NMEA-CHECKSUM",
         "ship.nmea: 1 of 2 sentences are cut or have a wrong checksum, the first in line 2; left out"),
        ([RECORDED_GGA, RECORDED_GGA[:3] + "\0" * 40 + sentence("HEHDT,12.5,T")], "compass", "NMEA-CHECKSUM",
         "ship.nmea: 1 of 3 sentences are cut or have a wrong checksum, the first in line 2; left out"),
        ([sentence("HEHDT,12.5,T"), sentence("HEHDT,north,T")], "compass", "UNDECODED",
         "/HEHDT: 1 sentences do not have the fields of their type; left out"),
        ([RECORDED_GGA, RECORDED_GGA.partition("*")[0]], "gps", "NMEA-CHECKSUM",
         "ship.nmea: 1 of 2 sentences have no checksum, while others of their name have one (GPGGA in line 2)"),
        ([RECORDED_GGA.partition("*")[0]], "gps", "NMEA-UNCHECKED",
         "ship.nmea: 1 of 1 sentences have no checksum"),
        ([sentence(f"GPTHS,10.0,{mode}") for mode in "AV"], "compass", "COMPASS-INVALID",
         "/GPTHS: 1 of 2 records are invalid and left out"),
    ],
)  # fmt: skip
def test_a_sentence_that_is_cut_incomplete_or_invalid_by_its_own_word_is_left_out_and_counted(
    tmp_path: Path, sentences: list[str], sensor: str, code: str, said: str
) -> None:
    log = logged_nmea(tmp_path, *timed(*sentences))

    assert len(log.tables[sensor]) == 1
    assert codes(log)[code].startswith(said)
    is_lost = any(finding.lost_data for finding in log.findings if finding.code == code)
    assert is_lost == (code in ("UNDECODED", "NMEA-CHECKSUM"))


GGA = "GPGGA,122640.00,4500.000,{},00700.000,{},{},10,0.8,1.0,M,48.0,M,,"


@pytest.mark.parametrize(
    ("body", "good", "bad"),
    [
        (GGA, ("N", "E", "1"), ("N", "E", "6")),
        (GGA, ("N", "E", "4"), ("N", "E", "8")),
        (GGA, ("N", "E", "1"), ("", "E", "1")),
        (GGA, ("S", "W", "1"), ("S", "", "1")),
        ("GPGGA,122640.00,{},10,0.8,1.0,M,48.0,M,,", ["4500.000,N,00700.000,E,1"], [",,,,0"]),
        ("GPRMC,122640.00,{},4500.000,N,00700.000,E,1.0,90.0,130920,,,{}", "AA", "AS"),
        ("GPRMC,122640.00,{},4500.000,N,00700.000,E,1.0,90.0,130920,,,{}", "AD", "AE"),
        ("GPGLL,4500.000,N,00700.000,E,122640.00,{},{}", "AA", "AM"),
        ("GPGNS,122640.00,4500.000,N,00700.000,E,{},10,0.8,1.0,48.0,,", ["NAN"], ["NEN"]),
    ],
)
def test_a_position_that_was_not_measured_or_has_no_hemisphere_is_left_out(tmp_path, body, good, bad):
    log = logged_nmea(tmp_path, *timed(*(sentence(body.format(*one)) for one in (good, bad))))

    assert len(log.tables["gps"]) == 1
    assert "1 of 2 records are invalid and left out" in codes(log)["GPS-INVALID"]


@settings(max_examples=25)
@given(cold=st.integers(0, 30), warm=st.integers(2, 30), zda=st.booleans(), clock=st.integers(0, 86_000))
def test_a_cold_start_neither_dates_nor_places(cold: int, warm: int, zda: bool, clock: int) -> None:
    """The receiver counts from a time of its own in 1980 until it has a fix; a gyro is logged beside it."""
    lines: list[str] = []
    for k in range(cold + warm):
        second = clock + k if k < cold else 44_800 + k
        hms = f"{second // 3600 % 24:02d}{second // 60 % 60:02d}{second % 60:02d}.00"
        date = ("060180", "06,01,1980") if k < cold else ("130920", "13,09,2020")
        lines += [sentence(f"GPZDA,{hms},{date[1]},00,00")] if zda else []
        lines.append(sentence(f"GPRMC,{hms},{'V' if k < cold else 'A'},4500.0,N,00700.0,E,1.0,90.0,{date[0]},,,A"))
        lines.append(sentence(f"HEHDT,{k}.0,T"))

    with TemporaryDirectory() as folder:
        log = logged_nmea(Path(folder), *lines)

    assert len(log.tables["gps"]) == warm
    time_s = log.tables["compass"]["time_s"].to_numpy()
    assert np.diff(time_s) == pytest.approx(np.ones(cold + warm - 1), abs=0.51)
    assert abs(log.start_ns - T0) < SECOND


def test_rmc_repeats_the_position_of_gga_and_is_used_if_that_is_missing(tmp_path: Path) -> None:
    rmc = sentence("GPRMC,122640.00,A,4500.000,N,00700.000,E,1.0,90.0,130920,,,A")
    gga = sentence("GPGGA,122640.00,4500.000,N,00700.000,E,1,10,0.8,1.0,M,48.0,M,,")

    both, alone = logged_nmea(tmp_path, rmc, gga), logged_nmea(tmp_path, rmc)

    assert both.provenance["gps"].topic == "/GPGGA"
    assert alone.provenance["gps"].topic == "/GPRMC"
    assert alone.start_ns == T0


# the last but one is magnetic 30, deviation 2 west, variation 7.25 east
@pytest.mark.parametrize("body", ["HEHDT,35.25,T", "GPTHS,35.25,A", "HCHDG,30.0,2.0,W,7.25,E", "HCHDM,35.25,M"])
def test_headings_are_degrees_clockwise_from_north_and_a_magnetic_one_is_said(tmp_path: Path, body: str) -> None:
    log = logged_nmea(tmp_path, f"1600000000 {sentence(body)}")

    assert log.tables["compass"]["heading_deg"][0] == pytest.approx(35.25)
    assert ("HEADING-MAGNETIC" in codes(log)) == ("HDM" in body)


SOUTH = GAPS_WEST.partition("*")[0].replace(",N,", ",S,")
AT_A_PLACE = NO_REPLY[1:-3].replace("M17", "M44").replace("0.000,0.000", "3.000,4.000")
SILENT = sentence(AT_A_PLACE.replace("083733", "180555"))
RANGER_NORTH_M = 9.125e-4 * 111258  # metres a degree at 51.33


@pytest.mark.parametrize(
    ("sentences", "toml", "east_north_m", "topic"),
    [
        ([NORTH_UP, SILENT], HEAD, [139.017, 138.7], "/PSIMSSB_C_N"),
        ([RANGER_SHIP, RANGER], on_map(51.3306281, -0.83563975), [0, RANGER_NORTH_M], "/PSONLLD"),
        ([GAPS, GAPS_SHIP], on_map(43 + 5.25355 / 60, 6 + 31.76852 / 60), [0, 0], "/PTSAG"),
        ([SOUTH], on_map(-27 - 18.19917 / 60, -17 - 47.61373 / 60), [0, 0], "/PTSAG"),
    ],
)
def test_a_fix_is_that_of_the_target_where_its_maker_counts_it_from(tmp_path, sentences, toml, east_north_m, topic):
    """A HiPAP north-up has x north and y east of the head; no reply and the ships of others are no fixes."""
    log = logged_nmea(tmp_path, *timed(*sentences), toml=toml)

    assert log.provenance["usbl"].topic == topic
    assert log.tables["usbl"][["east_m", "north_m"]].to_numpy() == pytest.approx(np.array([east_north_m]), abs=0.02)
    if topic == "/PSONLLD":
        assert log.tables["usbl"]["cov_nn_m2"][0] == pytest.approx(5.33**2)
    if topic == "/PSIMSSB_C_N":
        said = {Convention("kind", "position", "type"), Convention("frame", "NED", "type")}
        assert said <= set(log.provenance["usbl"].conventions)


def test_the_ellipse_of_ranger_is_along_its_direction(tmp_path: Path) -> None:
    """Semi-axes 4 and 1 m, the long one 30 degrees clockwise from north."""
    line = sentence("PSONLLD,122640.00,2401,A,45.0,7.0,10.0,4.0,1.0,30.0,0.6,,,,")
    along, across = np.array([0.5, math.sqrt(3) / 2]), np.array([math.sqrt(3) / 2, -0.5])

    R = covariance(logged_nmea(tmp_path, f"1600000000 {line}", toml=MAP))

    assert along @ R @ along == pytest.approx(16)
    assert across @ R @ across == pytest.approx(1)
    assert along @ R @ across == pytest.approx(0, abs=1e-12)


def test_sentences_in_a_topic_of_text_are_topics_of_their_own(tmp_path: Path) -> None:
    gga = sentence("GPGGA,122640.25,4500.000,N,00700.000,E,1,10,0.8,1.0,M,48.0,M,,")
    both = gga + "\r\n" + sentence("HEHDT,12.5,T") + "\r\n"
    texts = [(1, "/nmea", both), (2, "/nmea", "hello"), (2, "/status", "diving")]
    rows = [(T0 + k * SECOND, topic, STRING, {"data": text}) for k, topic, text in texts]

    log = logged(tmp_path, rows)

    assert log.provenance["gps"].topic == "/nmea/GPGGA"
    assert log.provenance["compass"].topic == "/nmea/HEHDT"
    assert log.tables["compass"]["heading_deg"].tolist() == [12.5]
    assert log.tables["gps"]["time_s"][0] - log.tables["compass"]["time_s"][0] == pytest.approx(-0.75)


def test_a_gga_on_a_usbl_topic_is_the_target(tmp_path: Path) -> None:
    gga = sentence("GPGGA,122640.00,4500.054,N,00700.000,E,1,10,0.8,1.0,M,48.0,M,,")

    log = logged(tmp_path, [(T0, "/usbl/nmea", STRING, {"data": gga})], MAP)

    assert list(log.tables) == ["usbl"]
    assert log.tables["usbl"]["north_m"][0] == pytest.approx(0.054 / 60 * 111132, abs=0.1)


def test_a_file_of_sentences_is_recognised_by_its_content(tmp_path: Path) -> None:
    log = open_reader(saved(tmp_path / "a.csv", f"time,text\n1600000000.5,{RECORDED_GGA}\n1600000001.5,{GAPS}\n"))

    assert log.format == "NMEA text"
    assert [topic.name for topic in log.topics()] == ["/GPGGA", "/PTSAG"]
    assert log.topics()[0].first_ns == T0 + SECOND // 2


def test_bytes_that_are_no_text_are_lines_without_a_sentence(tmp_path: Path) -> None:
    noise = bytes(range(128, 200))
    lines = b"".join(b"%d %s\n" % (1600000000 + k, RECORDED_GGA.encode()) for k in range(3))
    log = read_log(saved(tmp_path / "noisy.txt", lines + noise + b"\n"))

    assert len(log.tables["gps"]) == 1  # the same time and place thrice
    assert codes(log)["NMEA-OTHER"] == "noisy.txt: 1 lines hold no NMEA sentence"


@pytest.mark.parametrize("seed", range(40))
def test_flipped_bytes_end_in_a_log_or_in_a_sentence(tmp_path: Path, seed: int) -> None:
    rng = random.Random(seed)
    lines = [RECORDED_GGA, NORTH_UP, RANGER, GAPS, sentence("HEHDT,12.5,T"), "$GPRMC,122640.00,A,,,,,,,130920,,"]
    unchecked = [line.partition("*")[0] for line in lines]
    text = bytearray("".join(f"{1600000000 + k} {line}\n" for k, line in enumerate(unchecked * 3)), "ascii")
    for _ in range(rng.choice([1, 10, 100])):
        text[rng.randrange(len(text))] = rng.randrange(256)
    file = saved(tmp_path / "noisy.txt", text[: rng.randrange(200, len(text))])

    for usbl in ("/PSONLLD", "/PTSAG", "/PSIMSSB_C_N", "none"):
        with contextlib.suppress(UsbldrError):
            read_as(file, MAP, Request(topics={"usbl": usbl}))


@settings(max_examples=25, deadline=None)
@given(talkers=st.lists(st.sampled_from(["GP", "GN", "GL", "GA"]), min_size=4, max_size=12), twice=st.booleans())
def test_a_receiver_with_several_talkers_is_one_topic_and_two_are_two(talkers: Sequence[str], twice: bool) -> None:
    bodies = [f"{one}GGA,1200{k:02d}.00,4500.0,N,00700.0,E,1,9,0.6,0,M,20,M,," for k, one in enumerate(talkers)]
    if twice:  # a second receiver states a time of the first one
        bodies.append(bodies[0].replace(talkers[0], "GQ", 1))
    with TemporaryDirectory() as folder:
        log = open_reader(saved_lines(Path(folder) / "a.nmea", map(sentence, bodies)))
        counts = {topic.name: topic.count for topic in log.topics()}

    if twice:
        assert counts == {f"/{one}GGA": [*talkers, "GQ"].count(one) for one in {*talkers, "GQ"}}
    else:
        assert counts == {f"/{talkers[0]}GGA": len(talkers)}


@pytest.mark.parametrize(
    ("line", "topic", "days"),
    [
        ("PING,{t}.5,{k}", "/PING", 0),
        ("$PUBX,00,12264{k}.50,1", "/PUBX", -18518),
        ("$PACME,12264{k}.50,1", "/PACME", -18518),
        ("HDG,{t}.5,40.5", "/HDG", 0),
    ],
)
def test_sentences_that_are_unknown_are_timed_by_a_time_at_their_beginning(tmp_path: Path, line, topic, days) -> None:
    """18518 days after 1970 is 2020-09-13."""
    lines = [line.format(k=k, t=T0 // SECOND + k) for k in range(4)]

    (found,) = open_reader(saved_lines(tmp_path / "a.txt", lines)).topics()

    begin_ns = T0 // SECOND * SECOND + SECOND // 2 + days * 86400 * SECOND
    assert (found.name, found.first_ns, found.last_ns) == (topic, begin_ns, begin_ns + 3 * SECOND)
    assert found.type not in {f"nmea/{kind}" for kind in SENTENCE_KINDS}


def bottom_track(first_s: int) -> list[str]:
    """Return velocities of 90 s whose sentences hold hour, minute and second, behind log times 0.4 s later."""
    clocks = [(datetime(2026, 1, 1) + timedelta(seconds=first_s + k)) for k in range(90)]
    return [
        f"{at:%Y-%m-%dT%H:%M:%S}.400Z {sentence(f'PACME,1,{at:%d%m%y},{at:%H%M%S}.00,{k / 100},0.5')}"
        for k, at in enumerate(clocks)
    ]


@pytest.mark.parametrize("first_s", [43_170, 86_370])  # over a full minute; over midnight
def test_a_field_of_hour_minute_and_second_is_a_time_of_the_day(tmp_path: Path, first_s: int) -> None:
    toml = '[dvl]\ncolumns = {{ {}, x = "4", y = "5" }}\nunit = "m/s"\naxes = "FSD"\n'
    log = logged_nmea(tmp_path, *bottom_track(first_s), toml=toml.format('time_ns = "3 [hhmmss]"'))

    dvl = log.tables["dvl"]
    assert dvl["time_s"].tolist() == pytest.approx(range(90))
    assert (dvl["received_s"] - dvl["time_s"]).tolist() == pytest.approx([0.4] * 90)
    for key in ("time_unix_s", "time_s"):
        with pytest.raises(UsbldrError, match=r'3 of /PACME is a time of the day.* state time_ns = "3 \[hhmmss\]"'):
            logged_nmea(tmp_path, *bottom_track(first_s), toml=toml.format(f'{key} = "3"'))


def test_such_a_time_has_the_date_that_the_configuration_states(tmp_path: Path) -> None:
    toml = '[dvl]\ncolumns = { time_ns = "3 [hhmmss]", x = "4", y = "5" }\nunit = "m/s"\naxes = "FSD"\n'
    lines = [line.partition("Z ")[2] for line in bottom_track(43_170)]
    clocks = [sentence(f"HEHDT,{k},T") for k in range(90)]
    dated = '[[file]]\npath = "ship.nmea"\ndate = 2026-05-01\n'
    times = [f"[{line.split(',')[3][:2]}:{line.split(',')[3][2:4]}:{line.split(',')[3][4:6]}]" for line in lines]
    both = [f"{at} {one}" for at, *two in zip(times, lines, clocks, strict=True) for one in two]
    log = logged_nmea(tmp_path, *both, toml=toml + dated)

    assert log.start_ns == int(datetime(2026, 5, 1, 11, 59, 30, tzinfo=UTC).timestamp()) * SECOND
    assert log.tables["dvl"]["time_s"].tolist() == pytest.approx(range(90))
