"""What the page gets of a figure is what matplotlib drew."""

import base64
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from usbldr_cli.figures.page_data import detail, page_data, plot_inside, text_of, thinned
from usbldr_cli.figures.style import MANY_POINTS, in_style, legend_below, one_a_dot, titled_figure


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
    upper.set_title("upper")
    legend_below(figure, (upper,))
    return figure, page_data(figure)


def numbers(data: Any, place: int) -> list[float]:
    return np.frombuffer(base64.b64decode(data["numbers"][place]), "<f4").tolist()


def test_lines_marks_bands_shades_and_levels_have_the_numbers_that_were_drawn_and_are_named_in_words() -> None:
    with in_style():
        figure, data = drawn()

    assert text_of(figure) == "upper. time [s]. Drawn: line, mark (at the edge), band, outage."
    (column,) = data["columns"]
    upper, lower = column["panels"]
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
