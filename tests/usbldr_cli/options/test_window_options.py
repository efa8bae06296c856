"""--aid on the command line: what is taken, what is refused, and what the reports say of it."""

import json
import math
from pathlib import Path

import pytest

from checkout import SAMPLES
from commands import output_of
from logs import refusal
from usbldr.filters.errors import UsageError
from usbldr_cli.options.window_options import aid_windows

SAMPLE = SAMPLES / "lawnmower.mcap"


def test_windows_come_in_their_order_of_time() -> None:
    assert aid_windows("gps@500:520,0:60") == ((0.0, 60.0), (500.0, 520.0))


@pytest.mark.parametrize(
    ("text", "reported"),
    [
        ("usbl@0:60", "write gps@FROM:TO"),
        ("gps", "write gps@FROM:TO"),
        ("gps@", "'' is not a window"),
        ("gps@0-60", "'0-60' is not a window"),
        ("gps@60:0", "the window 60:0 must start"),
        ("gps@-5:60", "the window -5:60 must start"),
        ("gps@0:inf", "the window 0:inf must start"),
        ("gps@0:60,50:70", "a window starts at 50 s before another has ended at 60 s"),
    ],
)
def test_what_is_no_window_is_refused_in_one_sentence(text: str, reported: str) -> None:
    said = refusal(UsageError, aid_windows, text)

    assert said.startswith(f"--aid {text}: ")
    assert reported in said


def test_replay_uses_gps_in_the_windows_and_says_so_wherever_it_gives_a_number(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    reported = output_of("replay", str(SAMPLE), "--filter", "ekf", "--aid", "gps@30:60,500:520", "-o", str(folder))
    report = json.loads((folder / "report.json").read_text(encoding="utf-8"))

    sentence = "GPS fixes used as measurements from 30 to 60, 500 to 520 s of the log"
    assert sentence in " ".join(reported.split())
    assert sentence in (folder / "report.md").read_text(encoding="utf-8")
    assert report["aid"] == [[30.0, 60.0], [500.0, 520.0]]
    assert report["reference_tracks"]["dr"]["aid"] == report["aid"]
    assert report["matching"]["aided"] == 52  # 31 and 21 epochs of 1 Hz
    scored = [float(line.split(",")[0]) for line in (folder / "errors_1hz.csv").read_text().splitlines()[1:]]
    assert not [t for t in scored if 30 <= t <= 60 or 500 <= t <= 520]
    assert report["metrics"]["updates_used_gps"] > 0
    assert math.isfinite(report["metrics"]["nis_mean_gps"])


def test_compare_says_it_too_and_refuses_to_set_it_beside_a_run_without(tmp_path: Path) -> None:
    aided, alone = tmp_path / "aided", tmp_path / "alone"
    reported = output_of("compare", str(SAMPLE), "--filters", "dr,ekf", "--aid", "gps@500:520", "--jobs", "1")
    for folder, more in ((aided, ("--aid", "gps@500:520")), (alone, ())):
        output_of("replay", str(SAMPLE), "--filter", "ekf", "-o", str(folder), *more)

    assert "from 500 to 520 s of the log" in " ".join(reported.split())
    with pytest.raises(UsageError, match=r"has aid 500 to 520 s, .* has none"):
        output_of("compare", str(aided), str(alone))
