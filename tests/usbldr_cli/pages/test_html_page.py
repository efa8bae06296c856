"""report.html: one file that asks for nothing, holds the numbers of report.json, and runs in a browser."""

import json
import re
from pathlib import Path
from typing import Any

import pytest

from checkout import SAMPLES
from commands import run
from html_pages import HtmlPage, chromium, in_chromium
from usbldr.io.reports.page import Bullets, Code, Labelled, Page, Section
from usbldr.io.reports.report_text import Table
from usbldr_cli.pages.html_page import html
from usbldr_cli.pages.plots import inert

HOSTILE = "</script><img src=http://example.com/x onerror=alert(1)>{{ 7 * 7 }}"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("html") / "run"
    done = run("replay", SAMPLES / "lawnmower_turn_db3", "-f", "ekf", "--html", "--plots", "none", "-o", out)
    assert done.exception is None
    return out


@pytest.fixture(scope="module")
def page(folder: Path) -> HtmlPage:
    return HtmlPage((folder / "report.html").read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def report(folder: Path) -> Any:
    return json.loads((folder / "report.json").read_text(encoding="utf-8"))


def test_the_page_asks_for_no_other_file_and_forbids_requests(page: HtmlPage) -> None:
    assert page.asked_for == []
    assert not [tag for tag, _ in page.elements if tag in ("link", "iframe", "object", "embed", "img")]
    policy = next(a["content"] for tag, a in page.elements if a.get("http-equiv") == "Content-Security-Policy")
    assert policy.startswith("default-src 'none';")


def test_the_verdict_comes_first_and_every_table_has_the_numbers_of_the_json(page: HtmlPage, report: Any) -> None:
    metrics = report["metrics"]

    assert page.shown.index(report["verdict"]) < page.shown.index("Errors")
    east = next(row for row in page.rows if row[0] == "|east|")
    names = ("rmse", "mean_abs", "median_abs", "std_abs", "min_abs", "max_abs")
    assert east[1:7] == [f"{metrics[f'{name}_east_m']:.3f}" for name in names]
    own, usbl = (next(row for row in page.rows if row[0] == label) for label in ("ekf", "usbl"))
    for row, found in ((own, metrics), (usbl, report["reference_tracks"]["usbl"]["metrics"])):
        assert row[3] == f"{found['mean_horizontal_m']:.3f}"
        assert row[6] == f"{found['p95_horizontal_m']:.3f}"
        assert row[8] == f"{found['matched']:.0f}"
    for fix in report["influential_fixes"]:
        assert [f"{fix['row']}", f"{fix['time_s']:.1f}", f"{fix['shift_m']:.2f}"] in [row[:3] for row in page.rows]


def test_the_page_names_the_inputs_the_conventions_and_the_command(page: HtmlPage, report: Any) -> None:
    assert "usbldr" in page.shown
    for one in report["provenance"]["inputs"]:
        assert [one["role"], one["file"], one["sha256"]] in page.rows
    for sensor, found in report["sensors"].items():
        row = next(row for row in page.rows if row[0] == sensor and len(row) == 6)
        assert row[1] == found["topic"]
        assert all(convention["text"] in row[5] for convention in found["conventions"])


def test_the_report_names_the_page_as_its_file(report: Any) -> None:
    assert "report.html" in report["files"]


def test_the_error_that_is_drawn_is_that_of_the_table(page: HtmlPage, report: Any) -> None:
    drawn = next(script for script in page.scripts if script.startswith('{"track"'))

    largest = f"{report['metrics']['max_horizontal_m']:.2f} m"
    assert re.search(rf"largest error: {re.escape(largest)} at \d+ s", drawn)
    assert "<" not in drawn


def test_names_do_nothing_but_show() -> None:
    blocks = (
        *(HOSTILE, Labelled(((HOSTILE, HOSTILE),)), Bullets((HOSTILE,)), Code(HOSTILE)),
        *(Table(HOSTILE, (HOSTILE,), ((HOSTILE, HOSTILE),)), Table("", (HOSTILE,), ((HOSTILE, HOSTILE),), False)),
    )

    page = HtmlPage(html(Page(HOSTILE, HOSTILE, (Section(HOSTILE, blocks),)), {}))

    assert page.scripts == []
    assert not [tag for tag, _ in page.elements if tag == "img"]
    assert page.asked_for == []
    assert page.shown.count(HOSTILE) == 16
    assert not [name for _, a in page.elements for name in a if name.startswith("on")]


def test_bokeh_finds_no_formula_in_a_name() -> None:
    for text in (r"$$x$$", r"\[x\]", r"\(x\)"):
        assert not re.search(r"\$\$|\\\[|\\\(", inert(text))


def test_comparisons_and_checks_write_the_same_kind_of_page(tmp_path: Path) -> None:
    log = SAMPLES / "lawnmower_turn_db3"
    out = tmp_path / "compared"
    assert run("compare", log, "-f", "dr,usbl", "-j", 1, "--html", "-o", out).exception is None
    row = f'[[row]]\nname = "a"\nlog = "{log}"\nfilter = "dr"\n[row.metrics.mean_horizontal_m]\nvalue = 0\nabs = 0.1\n'
    (tmp_path / "baseline.toml").write_text(f"schema = 1\n{row}")
    run("check", tmp_path / "baseline.toml", "-j", 1, "-o", tmp_path / "failed", "--html", tmp_path / "check.html")

    compared = HtmlPage((out / "report.html").read_text(encoding="utf-8"))
    table = json.loads((out / "compare.json").read_text(encoding="utf-8"))
    for one in table["rows"]:
        row = next(row for row in compared.rows if row[0] == one["filter"])
        assert row[3] == f"{one['mean_horizontal_m']:.3f}"
    checked = HtmlPage((tmp_path / "check.html").read_text(encoding="utf-8"))
    assert "FAILED: a: mean_horizontal_m REGRESSION" in checked.shown
    assert compared.asked_for == checked.asked_for == []
    assert run("compare", log, "-f", "dr,usbl", "-j", 1, "--html", "-o", out, "--force").exception is None  # its own


def test_without_a_folder_or_without_bokeh_a_sentence_says_what_to_do(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    done = run("compare", SAMPLES / "paper.mcap", "--html")
    assert "name one" in str(done.exception)

    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    done = run("replay", SAMPLES / "paper.mcap", "--html", "-o", tmp_path / "run")
    assert "pip install 'usbldr[html]'" in str(done.exception)
    assert not (tmp_path / "run").exists()


@pytest.mark.skipif(chromium() is None, reason="Chromium is not installed")
@pytest.mark.parametrize("flags", [(), ("--force-dark-mode", "--window-size=500,900")], ids=["light", "dark"])
def test_figures_are_drawn_without_an_error_on_the_console(
    folder: Path, tmp_path: Path, flags: tuple[str, ...]
) -> None:
    shown, console = in_chromium(folder / "report.html", tmp_path / "profile", *flags)

    assert 'data-ready="yes"' in shown
    assert ('<html lang="en" data-scheme="dark"' in shown) == bool(flags)
    assert [line for line in console if "setting log level" not in line] == []
