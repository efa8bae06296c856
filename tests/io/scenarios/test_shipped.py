"""Scenarios as TOML: what a file says is what the dive has, and a mistake is one sentence."""

import dataclasses
import re
from pathlib import Path
from typing import get_args, get_type_hints

import msgspec
import pytest

from checkout import ROOT
from commands import output_of
from everything import EVERYTHING, SCENARIO
from recordings import saved
from usbldr.filters.errors import UsageError
from usbldr.filters.simulation.scenario import RandomWalkMotion
from usbldr.filters.simulation.simulate import simulate
from usbldr.io.scenarios.sections import ScenarioFile
from usbldr.io.scenarios.shipped import find_scenario, read_scenario, scenario_names
from usbldr.io.scenarios.survey_scenarios import SurveyFile


def test_every_key_of_a_file_arrives_in_the_dive_with_angles_counter_clockwise(tmp_path: Path) -> None:
    assert read_scenario(saved(tmp_path / "everything.toml", EVERYTHING)) == SCENARIO


def test_a_file_like_another_states_only_what_differs(tmp_path: Path) -> None:
    text = 'schema = 1\nlike = "paper"\nabout = "slower"\n[dvl]\nrate_hz = 2.0\n[drawn]\ndvl_scale_sd = 0.02\n'
    paper = find_scenario("paper")

    mine = read_scenario(saved(tmp_path / "mine.toml", text))

    dvl, drawn = dataclasses.replace(paper.dvl, rate_hz=2.0), RandomWalkMotion(0.2, 0.02, 0.0)
    assert mine == dataclasses.replace(paper, name="mine", about="slower", dvl=dvl, drawn=drawn)


@pytest.mark.parametrize(
    ("was", "now", "sentence"),
    [
        ("sd_mps = 0.02", "sd_mp = 0.02", r"\[dvl\] has no key sd_mp; did you mean sd_mps\?"),
        ("turn_rate_dps = 6.0\n", "turn_rate = 6.0\n",
         r"\[leg\[1\]\] has no key turn_rate; did you mean turn_rate_dps"),
        ("scatter_m = 0.7", "scatter = 0.7", r"\[usbl.multipath\] has no key scatter; did you mean scatter_m"),
        ("rate_hz = 10.0", "rate_hz = 0.0", r"\[compass\] rate_hz: expected number > 0"),
        ("dropout_share = 0.06", "dropout_share = 1.0", r"\[dvl\] dropout_share: expected number < 1"),
        ("silences_s = [[7.0, 8.0]]", "silences_s = [[8.0, 7.0]]", r"\[dvl\]: silences_s: \[8, 7\] ends before"),
        ("jitter_s = 0.04", "jitter_s = 0.4", r"\[dvl\]: jitter_s must not exceed the 0.2 s between two records"),
        ('kind = "student-t"', 'kind = "student"', r"\[dvl\] noise: kind is missing or unknown"),
        ("sd_m = 0.2, sd_rel = 0.01, ", "", r"\[usbl\] accuracy: state sd_m, sd_rel or both"),
        ("[current]", "[drawn]\n[current]", r"\[drawn\] cannot be combined with \[current\]"),
        ("duration_s = 60.0\n\n[v", "\n[v", r"the key duration_s is missing"),
        ("duration_s = 60.0\n\n[v", "duration_s = 1e9\n\n[v",
         r"dvl.rate_hz and duration_s give 5e\+09 records; the limit is 1e\+07"),
        ("every_s = 100.0", "every_s = 1e-6", r"usbl.multipath.every_s and duration_s give 6e\+07"),
        ("schema = 1", "schema = 2", r"schema"),
        ("schema = 1", 'schema = 1\nlike = "pool"', r"like = 'pool': no such scenario \(scenarios: .*paper"),
        ("[current]", "[[current", r"is not valid TOML"),
    ],
)  # fmt: skip
def test_a_mistake_is_one_sentence_with_file_and_key(tmp_path: Path, was: str, now: str, sentence: str) -> None:
    assert EVERYTHING.count(was) == 1
    file = saved(tmp_path / "mine.toml", EVERYTHING.replace(was, now))

    with pytest.raises(UsageError, match=sentence) as fault:
        read_scenario(file)

    assert str(fault.value).startswith(f"{file}: ")
    assert "\n" not in str(fault.value)


def test_every_shipped_scenario_can_be_read_and_has_a_description() -> None:
    assert {"paper", "lawnmower"} <= set(scenario_names())
    for name in scenario_names():
        found = find_scenario(name)
        assert found.name == name
        assert 20 < len(found.about) <= 100, name
        assert sum(leg.duration_s for leg in found.legs) >= found.duration_s - 1e-9, name


def test_a_file_is_a_scenario_wherever_a_log_is_expected(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    saved(tmp_path / "short.toml", 'schema = 1\nlike = "paper"\nabout = "a short one"\nduration_s = 20.0\n')

    written = output_of("simulate", "short.toml", "-o", "short.mcap", "--seed", 3)
    compared = output_of("compare", "short.toml", "--filters", "ekf,usbl", "--seeds", 2, "--jobs", 1)
    replayed = output_of("replay", "short.toml", "--filter", "ekf", "--seed", 3, "--quiet", "--output", "a")
    from_file = output_of("replay", "short.mcap", "--filter", "ekf", "--quiet", "--output", "b")

    assert written.startswith("short.mcap: scenario short, seed 3, 20 s, records: 101 dvl, 101 compass, 21 usbl")
    assert "each seed simulates its own dive" in compared
    assert replayed.splitlines()[0] == from_file.splitlines()[0]


def test_a_file_of_a_scenario_that_is_not_there_is_one_sentence() -> None:
    with pytest.raises(UsageError, match=r"pool\.toml: cannot be read \(No such file"):
        find_scenario("pool.toml")


def _documented() -> str:
    return (ROOT / "docs" / "scenarios.md").read_text(encoding="utf-8")


def test_the_files_that_the_documentation_shows_are_scenarios(tmp_path: Path) -> None:
    shown = re.findall(r"^```toml\n(.*?)^```", _documented(), re.MULTILINE | re.DOTALL)

    assert len(shown) == 2
    for number, text in enumerate(shown):
        assert len(simulate(read_scenario(saved(tmp_path / f"shown{number}.toml", text)), 0).usbl.time_s) > 80


def test_the_documentation_has_every_scenario_and_every_key() -> None:
    text = _documented()

    listed = set(re.findall(r"^\| `([a-z-]+)` \|", text.split("## A scenario file")[0], re.MULTILINE))
    assert listed == set(scenario_names())
    named = set(re.findall(r"[a-z_]+", text))
    sections = {name: part for name, part in get_type_hints(ScenarioFile).items() if name not in ("process", "start")}
    structs = [struct for section in sections.values() for struct in (section, *get_args(section))]
    keys = {key for struct in structs for key in getattr(struct, "__struct_fields__", ())}
    assert len(keys) > 40
    for key in keys:
        assert key in named or re.sub("_(mps|deg|m)$", "_*", key) in text, key


def test_the_documentation_has_every_key_of_a_survey_with_its_default() -> None:
    rows = re.findall(
        r"^\| `\[(ship|transponder|installation|fixes)\]` (.*?) \|.*\| (.*?) \|$", _documented(), re.MULTILINE
    )
    shown: dict[str, dict[str, str]] = {}
    for section, keys, defaults in rows:
        names, values = re.findall(r"`(\w+)`", keys), defaults.split("; ")
        values = values * len(names) if len(values) == 1 else values
        shown.setdefault(section, {}).update(zip(names, values, strict=True))

    stated = {name: part for name, part in get_type_hints(SurveyFile).items() if name in shown}
    assert {name: {key: float(value) for key, value in keys.items()} for name, keys in shown.items()} == {
        name: msgspec.structs.asdict(part()) for name, part in stated.items()
    }
    assert len(stated) == 4
