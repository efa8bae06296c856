"""report.html: one file that asks for nothing, holds the numbers of report.json, and runs in a browser.

What the page gets of a figure is what matplotlib drew.
"""

import base64
import json
import re
import shutil
import subprocess
from dataclasses import dataclass, field
from html.parser import HTMLParser
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from checkout import SAMPLES
from commands import output_of, report_of, run
from usbldr.io.reports.page import Bullets, Code, Labelled, Page, PageSection, Plot
from usbldr.io.reports.report_text import TextTable
from usbldr_cli.figures.page_data import detail, page_data, plot_inside, text_of, thinned
from usbldr_cli.figures.style import MANY_POINTS, WRAPPED, in_style, legend_below, one_a_dot, titled_figure
from usbldr_cli.pages.html_page import html

FLAGS = (
    *("--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-sync"),
    *("--disable-background-networking", "--disable-component-update", "--enable-logging=stderr"),
    *("--virtual-time-budget=20000", "--dump-dom"),
)


@dataclass
class HtmlPage(HTMLParser):
    """A page as a browser without scripts reads it: elements, rows of tables, text outside of scripts and styles."""

    text: str
    elements: list[tuple[str, dict[str, str]]] = field(default_factory=list)
    rows: list[list[str]] = field(default_factory=list)
    words: list[str] = field(default_factory=list)
    scripts: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        super().__init__()
        self._inside = ""
        self.feed(self.text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, {name: value or "" for name, value in attrs}))
        self._inside = tag
        if tag == "tr":
            self.rows.append([])
        if tag in ("td", "th"):
            self.rows[-1].append("")

    def handle_endtag(self, tag: str) -> None:
        self._inside = ""

    def handle_data(self, data: str) -> None:
        if self._inside == "script":
            self.scripts.append(data)
        elif self._inside != "style":
            self.words.append(data)
            if self._inside in ("td", "th"):
                self.rows[-1][-1] += data

    @property
    def shown(self) -> str:
        """The text that a reader sees, with single blanks."""
        return re.sub(r"\s+", " ", " ".join(self.words))

    @property
    def plots(self) -> dict[str, Any]:
        """What the page's script draws, by the names of the figures."""
        return next(json.loads(text) for text in self.scripts if text.startswith("{"))

    @property
    def asked_for(self) -> list[str]:
        """The addresses that elements name, other than data in the page itself."""
        named = [a[key] for _, a in self.elements for key in ("src", "href", "action", "data", "srcset") if key in a]
        return [address for address in named if not address.startswith("data:")]


def chromium() -> str | None:
    """Return the path of Chromium, if it is installed."""
    return shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")


def in_chromium(file: Path, profile: Path, *flags: str) -> tuple[str, list[str]]:
    """Return the page after its scripts have run, and the lines of its console."""
    command = [chromium() or "", *FLAGS, f"--user-data-dir={profile}", *flags, file.as_uri()]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True)
    console = [line for line in done.stderr.splitlines() if "CONSOLE" in line]
    return done.stdout, console


HOSTILE = "</script><img src=http://example.com/x onerror=alert(1)>{{ 7 * 7 }}"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("html") / "run"
    output_of("replay", SAMPLES / "lawnmower_turn_db3", "-f", "ekf", "--html", "-o", out)  # an option of before
    return out


@pytest.fixture(scope="module")
def page(folder: Path) -> HtmlPage:
    return HtmlPage((folder / "report.html").read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def report(folder: Path) -> Any:
    return report_of(folder)


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
    assert "report.html" in report["files"]
    assert "usbldr" in page.shown
    assert f"(commit {report['provenance']['commit']})" in page.shown or report["provenance"]["commit"] is None
    for one in report["provenance"]["inputs"]:
        assert [one["role"], one["file"], one["sha256"]] in page.rows
    for sensor, found in report["sensors"].items():
        row = next(row for row in page.rows if row[0] == sensor and len(row) == 6)
        assert row[1] == found["topic"]
        assert all(convention["text"] in row[5] for convention in found["conventions"])


def column(figure: Any, place: int) -> np.ndarray[Any, Any]:
    return np.frombuffer(base64.b64decode(figure["numbers"][place]), "<f4")


def test_every_figure_is_on_the_page_with_what_it_shows_in_words(page: HtmlPage, folder: Path) -> None:
    plots = {a["id"]: a for _, a in page.elements if a.get("class") == "plot"}

    assert set(plots) == {f"plot-{picture.stem}" for picture in folder.glob("*.png")}
    assert set(page.plots) == {picture.stem for picture in folder.glob("*.png")}
    assert "east: mean |error|" in plots["plot-errors"]["aria-label"]
    assert (folder / "report.html").stat().st_size < 2e6


def test_the_errors_and_fixes_of_the_page_are_those_of_the_report(page: HtmlPage, report: Any, folder: Path) -> None:
    errors, track = page.plots["errors"], page.plots["track"]

    line = next(mark for mark in errors["columns"][0]["panels"][0]["marks"] if mark.get("label") == "ekf")
    sizes = column(errors, dict(line["rows"])["horizontal error [m]"])
    assert sizes.max() == pytest.approx(report["metrics"]["max_horizontal_m"])
    fixes = pd.read_csv(folder / "fixes.csv")
    marks = [mark for mark in track["columns"][0]["panels"][0]["marks"] if mark["key"].startswith("USBL fix")]
    east_m = np.concatenate([column(track, mark["x"]) for mark in marks])
    assert np.sort(east_m) == pytest.approx(np.sort(fixes["east_m"]), abs=1e-3)


def test_names_do_nothing_but_show() -> None:
    blocks = (
        *(HOSTILE, Labelled(((HOSTILE, HOSTILE),)), Bullets((HOSTILE,)), Code(HOSTILE)),
        *(
            TextTable(HOSTILE, (HOSTILE,), ((HOSTILE, HOSTILE),)),
            TextTable("", (HOSTILE,), ((HOSTILE, HOSTILE),), False),
        ),
    )

    page = HtmlPage(html(Page(HOSTILE, HOSTILE, (PageSection(HOSTILE, blocks),)), {}))

    assert page.scripts == []
    assert not [tag for tag, _ in page.elements if tag == "img"]
    assert page.asked_for == []
    assert page.shown.count(HOSTILE) == 16
    assert not [name for _, a in page.elements for name in a if name.startswith("on")]


@pytest.mark.long
def test_comparisons_and_checks_write_the_same_kind_of_page(tmp_path: Path) -> None:
    log = SAMPLES / "lawnmower_turn_db3"
    out = tmp_path / "compared"
    output_of("compare", log, "-f", "dr,usbl", "-j", 1, "-o", out)
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
    assert set(compared.plots) == {"by_filter", "errors", "track", "error_cdf"}
    (change,) = checked.plots["metrics"]["columns"][0]["panels"]
    failed = next(mark for mark in change["marks"] if mark.get("label") == "failed")
    assert checked.plots["metrics"]["numbers"][failed["rows"][0][1]] == ["mean_horizontal_m"]


USE = """<script>
const [track, , east, north] = document.querySelectorAll(".plot svg[role=img]");
Element.prototype.setPointerCapture = () => {};
const tell = (name, across, up) => {
  const box = east.getBoundingClientRect();
  const at = { clientX: box.left + across * box.width, clientY: box.top + up * box.height };
  east.dispatchEvent(new PointerEvent(name, { ...at, pointerType: "mouse", pointerId: 1 }));
};
const words = () => north.textContent;
const all = words();
tell("pointerdown", 0.5, 0.5); tell("pointermove", 0.7, 0.5); tell("pointerup", 0.7, 0.5);
const zoomed = words() !== all;
east.dispatchEvent(new MouseEvent("dblclick"));
const back = words() === all;
for (let k = 1; k < 20; k++) {
  tell("pointermove", 0.5, k / 20);
  if (east.closest(".plot").querySelector(".tip").textContent.startsWith("ekf")) break;
}
const drawn = () => track.querySelectorAll(".data > *").length;
const before = drawn();
track.closest(".plot").querySelector(".legend button").click();
Object.assign(document.body.dataset, { zoomed, back, hidden: drawn() < before });
</script></body>"""


@pytest.mark.skipif(chromium() is None, reason="Chromium is not installed")
@pytest.mark.parametrize("flags", [(), ("--force-dark-mode", "--window-size=500,900")], ids=["light", "dark"])
def test_a_browser_draws_the_figures_zooms_says_numbers_and_hides_series(folder, tmp_path, flags):
    used = tmp_path / "used.html"
    used.write_text((folder / "report.html").read_text(encoding="utf-8").replace("</body>", USE), encoding="utf-8")

    shown, console = in_chromium(used, tmp_path / "profile", *flags)

    assert console == []
    assert 'data-ready="yes"' in shown
    assert re.findall(r' data-(\w+)="true"', shown) == ["zoomed", "back", "hidden"]
    assert re.search(
        r"<b>ekf</b><div>time since the log's start: [\d.]+ s</div><div>east error: -?[\d.]+ m</div>", shown
    )


TOUCH = """<script>
const [left, right] = document.querySelectorAll(".plot svg[role=img]");
Element.prototype.setPointerCapture = () => {};
const touch = (name, across, up) => {
  const box = left.getBoundingClientRect();
  const at = { clientX: box.left + across, clientY: box.top + up };
  left.dispatchEvent(new PointerEvent(name, { ...at, pointerType: "touch", pointerId: 1 }));
};
const words = (svg) => Array.from(svg.querySelectorAll(":scope > text"), (one) => one.textContent).join(" ");
const stroke = (k) => left.querySelectorAll(".data > path")[k].getAttribute("stroke");
const shade = left.querySelector(".data > rect").getBBox();
const cross = left.querySelectorAll(".data > path")[1].getAttribute("d");
const marks = { ring: stroke(0), cross, flat: shade.width > shade.height };
const ring = left.querySelector(".data > path").getBoundingClientRect();
const box = left.getBoundingClientRect();
touch("pointerdown", ring.left - box.left + ring.width / 2, ring.top - box.top + ring.height / 2);
touch("pointerleave", 0, 0);
const tip = document.querySelector(".tip").hidden ? "" : document.querySelector(".tip").textContent;
document.querySelector(".tools button").click();
const zoomed = words(left);
touch("pointerdown", 200, 50); touch("pointermove", 120, 50); touch("pointerup", 120, 50);
const moved = words(left);
left.dispatchEvent(new KeyboardEvent("keydown", { key: "ArrowUp", bubbles: true }));
const raised = words(left);
document.querySelectorAll(".tools button")[2].click();
const [all, height] = [words(left), left.viewBox.baseVal.height];
dispatchEvent(new Event("beforeprint"));
const [printed, wide] = [left.viewBox.baseVal.height, left.viewBox.baseVal.width];
dispatchEvent(new Event("afterprint"));
const again = left.viewBox.baseVal.height;
const found = { marks, tip, zoomed, moved, raised, all, right: words(right), heights: [height, printed, again], wide };
document.body.dataset.found = btoa(encodeURIComponent(JSON.stringify(found)));
</script></body>"""


@pytest.mark.skipif(chromium() is None, reason="Chromium is not installed")
def test_a_page_shows_the_marks_of_the_picture_and_is_used_by_finger_keys_and_printer(tmp_path: Path) -> None:
    figure = titled_figure("title", "detail", 8, 4)
    left, right = figure.subplots(1, 2)
    left.plot([1], [5], ls="", marker="o", mfc="white", color="#0072b2", ms=8)
    left.plot([1.5], [2], ls="", marker="+", color="#cc79a7")
    left.axhspan(0.5, 1)
    left.set(xlim=(0, 4), ylim=(0, 8))
    left.set_xticks([0, 1, 2], ["", "ekf", "cpf"])
    left.set_ylabel("error [m] (logarithmic)")
    right.plot([1, 2], [1, 1e13])
    right.set(yscale="log", xticks=[], ylim=(1, 1e13))
    page = html(Page("", "", (PageSection("", (Plot("a", "", ""),)),)), {"a": page_data(figure)})
    (tmp_path / "page.html").write_text(page.replace("</body>", TOUCH), encoding="utf-8")

    shown, console = in_chromium(tmp_path / "page.html", tmp_path / "profile", "--window-size=600,800")

    assert console == []
    found = json.loads(unquote(base64.b64decode(re.findall(r'data-found="([^"]*)"', shown)[0]).decode()))
    assert found["marks"]["ring"] == "#0072b2"
    assert found["marks"]["cross"].count("M") + found["marks"]["cross"].count("m") == 3
    assert found["marks"]["flat"]
    assert found["tip"] == "ekferror: 5.00 m"
    assert len({found[name] for name in ("zoomed", "moved", "raised", "all")}) == 4
    assert found["all"].startswith("0 1 2 3")
    assert "1e+12" in found["right"]
    height, printed, again = found["heights"]
    assert printed < height == again
    assert found["wide"] < 360  # beside the other panel on a sheet of 700, although the window is narrow


def drawn() -> tuple[Any, Any]:
    figure = titled_figure("title", "detail", 8, 6)
    upper, lower = figure.subplots(2, 1, sharex=True)
    (line,) = upper.plot([0, 1, 2], [3, 4, 5], color="#000000", label="line")
    detail(line, {"time [s]": np.array([7.0, 8.0, 9.0])})
    (marks,) = upper.plot([1], [5], ls="", marker="x", color="#ff0000", label="mark (at the edge)")
    detail(marks, y=np.array([50.0]), key="mark")
    upper.fill_between([0, 1, 2], [-1, -2, -3], [1, 2, 3], label="band")
    upper.axvspan(0.5, 1.5, facecolor="#e4e4e4", label="outage")
    upper.axhline(2.5)
    lower.step([0, 1], [1, 2], where="post")
    lower.set_yscale("log")
    lower.set_xlabel("time [s]")
    upper.set_title(f"upper, in{WRAPPED}two lines\nand a third")
    legend_below(figure, (upper,))
    return figure, page_data(figure)


def numbers(data: Any, place: int) -> list[float]:
    return column(data, place).tolist()


def test_lines_marks_bands_shades_and_levels_have_the_numbers_that_were_drawn_and_are_named_in_words() -> None:
    with in_style():
        figure, data = drawn()

    assert (
        text_of(figure) == "upper, in two lines, and a third. time [s]. Drawn: line, mark (at the edge), band, outage."
    )
    (column,) = data["columns"]
    upper, lower = column["panels"]
    assert upper["title"] == "upper, in two lines\nand a third"
    line, mark, band, shade, level = (
        next(one for one in upper["marks"] if one["kind"] == kind)
        for kind in ("line", "points", "band", "shade", "rule")
    )
    assert (numbers(data, line["x"]), numbers(data, line["y"])) == ([0, 1, 2], [3, 4, 5])
    assert (line["colour"], line["label"]) == ("ink", "line")
    assert [(name, numbers(data, place)) for name, place in line["rows"]] == [("time [s]", [7, 8, 9])]
    assert (numbers(data, mark["y"]), mark["beyond"], mark["key"]) == ([50], ["y"], "mark")
    assert numbers(data, band["low"])[1:-1] == [-1, -2, -3]
    assert numbers(data, band["high"])[1:-1] == [1, 2, 3]
    assert (shade["axis"], shade["from"], shade["to"], level["across"]) == ("x", 0.5, 1.5, 2.5)
    assert upper["linked"] == lower["linked"]
    assert lower["y"]["log"]
    assert numbers(data, lower["marks"][0]["x"]) == [0, 1, 1]
    assert numbers(data, lower["marks"][0]["y"]) == [1, 1, 2]


def test_a_shade_across_the_axes_is_one_of_the_vertical_axis_and_a_box_plot_has_no_name() -> None:
    figure = titled_figure("title", "detail", 8, 6)
    shaded, boxes = figure.subplots(1, 2)
    shaded.axhspan(-1, 2)
    boxes.boxplot([[1.0, 2.0, 3.0]], showfliers=False)

    (shade,), drawn = (column["panels"][0]["marks"] for column in page_data(figure)["columns"])

    assert (shade["axis"], shade["from"], shade["to"]) == ("y", -1, 2)
    assert {mark["key"] for mark in drawn} == {""}


def test_panels_beside_each_other_share_the_label_of_their_row_and_an_axis_may_have_no_ticks() -> None:
    figure = titled_figure("title", "detail", 8, 6)
    grid = figure.subplots(2, 2, sharey=True)
    for row, label in zip(grid, ("upper", "lower"), strict=True):
        row[0].set_ylabel(label)
    grid[1, 1].set_xticks([])

    columns = page_data(figure)["columns"]

    assert [[panel["y"]["label"] for panel in column["panels"]] for column in columns] == [["upper", "lower"]] * 2
    assert [column["panels"][1]["x"]["ticks"] for column in columns] == [None, []]


@pytest.mark.parametrize("line", ["", "-"])
def test_what_is_drawn_at_the_edge_has_its_true_height_on_the_page(line: str) -> None:
    figure = titled_figure("title", "detail", 8, 6)
    axes = figure.subplots()
    plot_inside(axes, np.arange(3.0), np.array([1.0, 50.0, np.nan]), (-2.0, 2.0), ls=line, marker=".")

    data = page_data(figure)

    (mark,) = data["columns"][0]["panels"][0]["marks"]
    assert axes.lines[0].get_ydata()[1] == 2
    assert (numbers(data, mark["y"])[:2], mark["beyond"]) == ([1, 50], ["y"])


def test_a_few_known_values_among_many_unknown_ones_are_drawn() -> None:
    y = np.full(2 * MANY_POINTS, np.nan)
    y[[7, 800]] = 1.0

    assert one_a_dot(np.arange(float(len(y))), y).tolist() == [7, 800]


@settings(max_examples=20)
@given(st.integers(0, 2**32 - 1), st.integers(2, 30000))
def test_a_thinned_line_keeps_its_ends_its_extremes_and_its_gaps(seed: int, length: int) -> None:
    rng = np.random.default_rng(seed)
    y = rng.standard_cauchy(length)
    y[rng.integers(0, length, 3)] = np.nan

    kept = thinned(np.arange(float(length)), y)

    assert len(kept) <= 2010
    assert {0, length - 1} <= set(kept)
    assert np.isnan(y[kept]).sum() == np.isnan(y).sum()
    if not np.isnan(y).all():
        assert (np.nanmin(y[kept]), np.nanmax(y[kept])) == (np.nanmin(y), np.nanmax(y))
