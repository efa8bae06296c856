"""Wrong results whose cause is said: one dive, damaged as logs of companies are, through the commands."""

import re
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pymap3d
import pytest

from checkout import SAMPLES
from commands import findings, output_of, run
from usbldr.filters.errors import UsbldrError
from usbldr.io.doctor import fix_noise
from usbldr.io.doctor.cross_check import convention_warnings
from usbldr.io.doctor.interpretations import compare_interpretations
from usbldr.io.reading.epochs import timeline
from usbldr.io.reading.read import read_log
from usbldr_cli.main import cli

RIVER = Path(__file__).parents[2] / "docs" / "real_log"
Edit = Callable[[pd.DataFrame], pd.DataFrame]
KNOT_MPS = 1852 / 3600
LIMITS = '[dvl]\ntopic = "/dvl"\n[map]\norigin_lat_deg = 45.0\norigin_lon_deg = -30.0\n'


@pytest.fixture(scope="module")
def dive(tmp_path_factory: pytest.TempPathFactory) -> dict[str, pd.DataFrame]:
    folder = tmp_path_factory.mktemp("dive")
    cli(["simulate", "turns", "-o", str(folder / "turns")], standalone_mode=False)
    return {name: pd.read_csv(folder / "turns" / f"{name}.csv") for name in ("dvl", "compass", "usbl", "gps")}


@pytest.fixture(scope="module")
def river(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, pd.DataFrame], str]:
    """Return the sensors and the configuration of a real log: a boat's ADCP, compass and GPS."""
    folder = tmp_path_factory.mktemp("river") / "river"
    run("export", RIVER / "riverpro.mcap", "--config", RIVER / "corrected.toml", "-o", folder)
    configuration = (folder / "usbldr.toml").read_text(encoding="utf-8")
    tables = {name: pd.read_csv(folder / f"{name}.csv") for name in ("dvl", "compass", "usbl", "gps")}
    return tables, re.sub(r"\[truth\]\n(.+\n)*", "", configuration)


def seconds(table: pd.DataFrame) -> pd.Series:
    return (table["time_ns"] - table["time_ns"].iloc[0]) / 1e9


@pytest.fixture
def edited(dive: dict[str, pd.DataFrame], tmp_path: Path) -> Callable[..., Path]:
    def write(configuration: str = LIMITS, tables: dict[str, pd.DataFrame] | None = None, **edits: Edit) -> Path:
        folder = tmp_path / "dive"
        folder.mkdir(exist_ok=True)
        for name, table in (tables or dive).items():
            edits.get(name, lambda same: same)(table.copy()).to_csv(folder / f"{name}.csv", index=False)
        (folder / "usbldr.toml").write_text(configuration, encoding="utf-8")
        return folder

    return write


def replayed(log: Path, *options: str) -> tuple[int, str]:
    result = run("replay", log, "-f", "adf", "--plots", "none", "-q", "--force", "-o", log.with_name("run"), *options)
    fault = result.exception
    code = fault.exit_code if isinstance(fault, UsbldrError) else result.exit_code
    return code, f"{result.output}{fault or ''}"


EXCHANGED = {"lat_deg": "lon_deg", "lon_deg": "lat_deg"}


def later(table: pd.DataFrame, seconds: float) -> pd.DataFrame:
    moved = ["time_ns", "received_ns"]
    return table.assign(**{name: table[name] + round(seconds * 1e9) for name in moved})


def swapped(table: pd.DataFrame) -> pd.DataFrame:
    return table.drop(columns=["east_m", "north_m"]).rename(columns=EXCHANGED)


def test_swapped_coordinates_and_milliseconds_give_no_result(edited: Callable[..., Path]) -> None:
    code, said = replayed(edited(gps=swapped))
    assert (code, "check whether latitude and longitude are exchanged" in said) == (3, True)
    assert "mirror image" not in said  # which exchanged coordinates are, but not those of the fixes

    def west(table: pd.DataFrame) -> pd.DataFrame:  # -100 degrees are no latitude: no row is valid
        return swapped(table.assign(lon_deg=table["lon_deg"] - 70.0))

    log = edited(gps=west)
    code, said = replayed(log)
    assert (code, "all 701 records of /gps (gps) are invalid" in said) == (3, True)
    assert "latitude and longitude are probably exchanged, so that there is no truth" in said
    assert replayed(log, "--truth", "none")[0] == 0

    assert replayed(edited(dvl=in_ms, compass=in_ms, usbl=in_ms, gps=in_ms))[0] == 3


@pytest.mark.parametrize("section", ["gps", "truth"])
@pytest.mark.parametrize("stated_s", [0.0, 10.0])
def test_init_proposes_the_latency_of_the_truth_where_it_is_stated(edited, section: str, stated_s: float) -> None:
    """By GPS of the log, or of a topic of its own."""
    own = '\n[truth]\ntopic = "/gps"\n' if section == "truth" else "\n[gps]\n"
    log = edited(f"{LIMITS}{own}latency_s = {stated_s}\n", gps=lambda table: later(table, 18.0))

    output_of("init", log, "-o", log / "found.toml")

    found = (log / "found.toml").read_text(encoding="utf-8").partition(f"[{section}]\n")[2]
    assert re.search(r"^latency_s = [\d.]+ .*; found: latency_s = 1[78]\.\d\d \(CHECK", found, re.MULTILINE), found


def test_a_clock_of_the_truth_is_no_other_vehicle_and_no_fault_of_the_sigmas(edited: Callable[..., Path]) -> None:
    said = replayed(edited(gps=lambda table: later(table, 18.0)), "--gps", "/gps")[1]

    assert "(GPS time and UTC are 18 s apart)" in said
    assert "over-confident" not in said


def test_exchanged_coordinates_are_no_other_vehicle(edited: Callable[..., Path]) -> None:
    log = edited(gps=lambda table: circling(table).rename(columns=EXCHANGED))

    output_of("init", log, "-o", log / "found.toml")

    assert 'topic = "/gps"' in (log / "found.toml").read_text(encoding="utf-8").partition("[gps]\n")[2]
    assert "TRUTH-MOTION" not in findings(log)


BARE = '[dvl]\ntopic = "/dvl"\ncolumns = { time_ns = "time_ns", x = "vx", y = "vy" }\n'


@pytest.mark.long
def test_axes_by_default_are_decided_by_the_turns_of_a_real_log(edited: Callable[..., Path], river) -> None:
    tables, configuration = river

    def bare(table: pd.DataFrame) -> pd.DataFrame:
        return table[["time_ns"]].assign(vx=table["forward_mps"], vy=table["starboard_mps"])

    said = replayed(edited(configuration.replace("[dvl]\n", BARE), tables, dvl=bare))[1]

    assert "/dvl: read as axes FLU, but FRD fits better" in said
    assert 'state axes = "FRD" under [dvl] [DVL-AXES]' in said


@pytest.mark.long
def test_axes_by_default_on_a_straight_line_are_said_to_be_undecided(edited: Callable[..., Path]) -> None:
    def unnamed(table: pd.DataFrame) -> pd.DataFrame:
        return pd.DataFrame({"time_ns": table["time_ns"], "vx": 1.0, "vy": 0.0})

    def north(table: pd.DataFrame) -> pd.DataFrame:
        noise = np.random.default_rng(2).normal(size=(len(table), 2))
        return table.assign(east_m=noise[:, 0], north_m=seconds(table) + noise[:, 1])

    log = edited(BARE + LIMITS.partition("\n")[2].partition("\n")[2], dvl=unnamed, usbl=north,
                 compass=lambda table: table.assign(heading_deg=0.0))  # fmt: skip
    said = replayed(log, "--truth", "none")[1]
    assert "axes = FLU is only the default, and the log fits FLU and FRD alike" in said
    assert "state axes under [dvl], before any latency or lever arm: in turns wrong axes look like one" in said


def test_a_run_directory_is_called_what_it_is(edited: Callable[..., Path]) -> None:
    log = edited()
    assert replayed(log)[0] == 0
    made = log.with_name("run")
    assert f"usbldr compare {made} shows it" in str(run("info", made).exception)


@pytest.mark.long
def test_excluded_fixes_are_those_that_the_log_never_had(edited: Callable[..., Path]) -> None:
    without = replayed(edited(usbl=lambda table: table[(seconds(table) < 300) | (seconds(table) > 360)]))
    log = edited()

    code, said = replayed(log, "--exclude", "usbl@300:360")

    report = (log.with_name("run") / "report.json").read_text(encoding="utf-8")
    assert "/usbl: 61 of 701 records from 300 to 360 s are left out by --exclude" in report
    assert (code, said.splitlines()[-1]) == (without[0], without[1].splitlines()[-1])
    assert "bit-identical" in run("replay", "--verify", log.with_name("run")).output
    assert "write SENSOR@FROM:TO" in replayed(log, "--exclude", "usbl")[1]


def times(factor: float) -> Edit:
    return lambda table: table.assign(**{name: table[name] * factor for name in ("starboard_mps", "forward_mps")})


def at_the_ends(table: pd.DataFrame) -> pd.DataFrame:
    return table[(seconds(table) < 15) | (seconds(table) > seconds(table).iloc[-1] - 15)]


def at_anchor(table: pd.DataFrame) -> pd.DataFrame:
    near = {"lat_deg": 5e-5 * np.cos(seconds(table) / 60), "lon_deg": 1e-4 * np.sin(seconds(table) / 40)}
    places = {name: table[name].mean() + value for name, value in near.items()}
    return table.drop(columns=["east_m", "north_m"]).assign(**places)


def of_the_ship(table: pd.DataFrame) -> pd.DataFrame:
    noise_m = np.random.default_rng(1).normal(size=(2, len(table)))
    return table.assign(east_m=20 + noise_m[0], north_m=10 + noise_m[1])


def around(table: pd.DataFrame) -> pd.DataFrame:  # 28 m from the vehicle, and with it
    angle = seconds(table) / 60
    lon_deg = table["lon_deg"] + np.degrees(28 * np.sin(angle) / 6.371e6) / np.cos(np.radians(table["lat_deg"]))
    lat_deg = table["lat_deg"] + np.degrees(28 * np.cos(angle) / 6.371e6)
    return table.drop(columns=["east_m", "north_m"]).assign(lat_deg=lat_deg, lon_deg=lon_deg)


def scattered(table: pd.DataFrame) -> pd.DataFrame:
    in_second_half = np.arange(len(table))[:, None] > len(table) / 2
    more_m = 7.0 * np.random.default_rng(1).normal(size=(len(table), 2)) * in_second_half
    return table.assign(east_m=table["east_m"] + more_m[:, 0], north_m=table["north_m"] + more_m[:, 1])


def noisy(table: pd.DataFrame) -> pd.DataFrame:
    noise_deg = np.random.default_rng(1).normal(0.0, 12.0, len(table))
    return table.assign(heading_deg=table["heading_deg"] + noise_deg)


def in_degrees(table: pd.DataFrame, lon_deg: int = 1) -> pd.DataFrame:
    east_m, north_m = table["east_m"].to_numpy(), table["north_m"].to_numpy()
    lat, lon, _ = pymap3d.enu2geodetic(east_m, north_m, 0 * east_m, 60.0, 10.0, 0.0)
    return table[["time_ns"]].assign(lat_deg=lat, lon_deg=lon_deg * lon)


def in_ms(table: pd.DataFrame) -> pd.DataFrame:
    return table.assign(time_ns=table["time_ns"] // 1_000_000).drop(columns="received_ns")


HORIZONTAL = ["starboard_mps", "forward_mps"]
CAUSES = {
    "a clock of the truth": ({"gps": lambda table: later(table, 18.0)}, r"\(GPS time and UTC are 18 s apart\)"),
    "milliseconds": (dict.fromkeys(("dvl", "compass", "usbl", "gps"), in_ms), "stamps are probably milliseconds"),
    "exchanged coordinates": ({"gps": swapped}, "latitude and longitude are (probably )?exchanged"),
    "a wrong sign": (
        {"dvl": lambda table: table.assign(starboard_mps=-table["starboard_mps"])},
        r"read as axes SFU, but PFD fits better; .* check them, and the signs of their values \[DVL-AXES\]",
    ),
    "headings of the wrong sign": (
        {"compass": lambda table: table.assign(heading_deg=-table["heading_deg"])},
        r"its headings have the wrong sign: .* correct them in the log \[HEADING-CONVENTION\]",
    ),
    "exchanged velocities": (
        {"dvl": lambda table: table.rename(columns=dict(zip(HORIZONTAL, reversed(HORIZONTAL), strict=True)))},
        r"its first two velocities are exchanged: .* exchange their columns \[DVL-AXES\]",
    ),
    "two fixes": ({"usbl": lambda table: table.iloc[[0, 82]]}, r"not comparable with raw USBL \(2 common epochs\)"),
    "a truth at the surface": ({"gps": at_the_ends}, r"in the \d+ % of the epochs that have a truth"),
    "cm/s": ({"dvl": times(100.0)}, r'unit = "cm/s" under \[dvl\] if they are cm/s|they are in cm/s, state '),
    "knots": ({"dvl": times(1 / KNOT_MPS)}, r"they are knots: state scale_error = 0\.9438 under \[dvl\]"),
    "late fixes": (
        {"usbl": lambda table: later(table, 6.0)},
        # both are corrected, by turns and by changes of speed: as good as without a fault; 6 s left would be 6 m
        r"mean horizontal error (0\.2|1\.1)\d m",
    ),
    "noise that rises": (
        {"usbl": scattered},
        r"from ([789]|3[3-7])\d s on the USBL fixes scatter [1-4]\.\d times as much as before",
    ),
    "a noisy compass": (
        {"compass": noisy},
        r"scatter by up to 1\d deg, not by the [\d.]+ deg of their sigma: .* \[NOISE-LARGER\]",
    ),
    "the GPS of another vessel": ({"gps": at_anchor}, "track and truth move differently"),
    "the GPS of a ship beside it": ({"gps": around}, "so that the truth is of another vehicle"),
    "the ship's end of the USBL": ({"usbl": of_the_ship}, r"the fixes move unlike dead reckoning.* \[USBL-MOTION\]"),
}


@pytest.mark.parametrize("name", CAUSES)
@pytest.mark.parametrize("kind", [pytest.param("made", marks=pytest.mark.slow), "real"])
@pytest.mark.long
def test_each_cause_is_said_of_a_made_and_of_a_real_log(kind: str, name: str, request, edited) -> None:
    """The ship's GPS is named, too: by --gps it is as wrong."""
    tables, configuration = request.getfixturevalue("river") if kind == "real" else (None, LIMITS)
    edits, sentence = CAUSES[name]

    said = replayed(edited(configuration, tables, **edits), "--gps", "/gps")[1]

    assert re.search(sentence, said), said


@pytest.mark.parametrize(
    ("edit", "what"),
    [
        (lambda table: in_degrees(table, lon_deg=-1), "its longitudes have the wrong sign"),
        (lambda table: in_degrees(table).rename(columns=EXCHANGED), "latitude and longitude are exchanged"),
    ],
)
def test_wrong_latitudes_of_fixes_are_no_wrong_axes(edited: Callable[..., Path], edit: Edit, what: str) -> None:
    alone, far_from_map = (read_log(edited(toml, usbl=edit)) for toml in ("", LIMITS))

    (found,) = convention_warnings(alone, timeline(alone))
    assert (found.code, found.text.split(": ")[1]) == ("MAP-FRAME", what)
    assert convention_warnings(far_from_map, timeline(far_from_map)) == []
    assert "PLACES-APART" in [one.code for one in far_from_map.findings]


@pytest.mark.long
def test_of_two_topics_the_one_that_moves_with_the_others_is_chosen(edited, dive, tmp_path):
    """The ship's come first in the log, and have as many messages."""
    log = edited(LIMITS)
    for name, edit in {"usbl": of_the_ship, "gps": at_anchor}.items():
        (log / f"{name}.csv").rename(log / f"{name}_b.csv")
        edit(dive[name]).to_csv(log / f"{name}_a.csv", index=False)

    output_of("init", log, "-o", tmp_path / "found.toml")
    found = (tmp_path / "found.toml").read_text(encoding="utf-8")
    assert 'topic = "/usbl_b"' in found
    assert 'topic = "/gps_b"' in found


def test_a_gps_that_moves_unlike_the_vehicle_is_no_truth_but_perhaps_the_place_of_the_head(edited) -> None:
    log = edited("", usbl=in_degrees, gps=circling)

    output_of("init", log, "--output", log / "found.toml")

    found = (log / "found.toml").read_text(encoding="utf-8")
    assert '# head = { topic = "/gps" }' in found
    assert "/gps moves unlike the fixes and dead reckoning" in found
    assert tomllib.loads(found)["gps"] == {"topic": "none"}


@pytest.mark.parametrize(("median", "judged"), [(0.1, True), (0.9, False)])
def test_a_truth_is_not_judged_by_fixes_that_mostly_contradict_dead_reckoning(edited, monkeypatch, median, judged):
    log = read_log(edited("", usbl=in_degrees, gps=circling))
    of_fixes: Any = compare_interpretations(log, timeline(log))
    shares = iter([0.4, median, 0.9])  # of a quarter and of half of the fixes, and of the truth
    monkeypatch.setattr(fix_noise, "unexplained_share", lambda *_: next(shares))

    assert [one.code for one in fix_noise.motion_findings(log, timeline(log), of_fixes)] == ["TRUTH-MOTION"] * judged


def circling(table: pd.DataFrame) -> pd.DataFrame:
    angle = seconds(table) / 90
    return in_degrees(table.assign(east_m=150 * np.sin(angle), north_m=150 * np.cos(angle)))


@pytest.mark.parametrize(("starboard", "late_s", "said"), [(-1, 0.0, True), (1, 6.0, False)])
def test_a_latency_that_wrong_axes_would_explain_is_said_with_them(edited, starboard: int, late_s: float, said: bool):
    """A vehicle that turns to either side and keeps its speed, as a lawnmower does."""
    tables = {
        name: pd.read_csv(SAMPLES / "lawnmower_csv" / f"{name}.csv") for name in ("dvl", "compass", "usbl", "gps")
    }
    tables["dvl"]["starboard_mps"] *= starboard
    tables["usbl"] = later(tables["usbl"], late_s)

    text = findings(edited("schema = 1\n" + LIMITS, tables))["USBL-LATENCY"]["text"]

    assert ("or the axes of the DVL are PFD: in turns wrong axes look like it" in text) == said
    assert ("axes of the DVL" in text) == said
