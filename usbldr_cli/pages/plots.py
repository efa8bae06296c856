"""What the interactive figures share: canvas, lines, fixes, outages. Metres and seconds, as everywhere."""

from collections.abc import Mapping, Sequence
from typing import Any, TypeAlias

import bokeh.layouts
import bokeh.models
import bokeh.plotting
import numpy as np

from usbldr.filters.types import Array, Vector

Canvas: TypeAlias = Any  # Bokeh's own types leave keywords unknown, which strict checking refuses
models: Any = bokeh.models
figure: Any = bokeh.plotting.figure
gridplot: Any = bokeh.layouts.gridplot

TOOLS = "pan,box_zoom,wheel_zoom,reset,save"
TRACK_HEIGHT = 560  # [pixels] of a plane: fits a laptop's screen with its legend
TIME_HEIGHT = 270  # [pixels] of a quantity over time: two fit a screen
HEAD_HEIGHT, LINE_HEIGHT = 130, 24  # [pixels] of axis and legend, of a line of text
INK = ["ink"]  # tag of a line that has the colour of the text
ALARM = ["alarm"]  # tag of a mark that has the colour of what is wrong
SHADES: Mapping[str, str] = {"usbl": "#9aa4ad", "dvl": "#e8a05c", "compass": "#7fb873"}
"""Shade of an outage of a sensor."""


def plane() -> Canvas:
    """Return a canvas on which metres are as long east as north."""
    canvas = _canvas(TRACK_HEIGHT, "pan", x_axis_label="east [m]", y_axis_label="north [m]", match_aspect=True)
    canvas.toolbar.active_scroll = None
    return canvas


def over_time(label: str, above: Canvas | None = None, height: int = TIME_HEIGHT) -> Canvas:
    """Return a canvas of a quantity over time; one that is below another shares its times."""
    shared = {} if above is None else {"x_range": above.x_range}
    return _canvas(height, "xbox_zoom", y_axis_label=label, **shared)


def stacked(panels: Sequence[Canvas]) -> Any:
    """Return canvases over time, one below the other, with one toolbar."""
    panels[-1].xaxis.axis_label = "time since the log's start [s]"
    rows = [[panel] for panel in panels]
    return gridplot(rows, sizing_mode="stretch_width", toolbar_location="above", toolbar_options={"logo": None})


def framed_by(canvas: Canvas, renderers: Sequence[Any]) -> None:
    """Let only these renderers set what the canvas shows at first."""
    canvas.x_range.renderers = canvas.y_range.renderers = list(renderers)


def categories(names: Sequence[str], label: str, logarithmic: bool = False) -> Canvas:
    """Return a canvas with a line for each name, the first on top, and a quantity to the right."""
    return _canvas(
        HEAD_HEIGHT + LINE_HEIGHT * len(names),
        "pan",
        x_axis_label=label,
        x_axis_type="log" if logarithmic else "auto",
        y_range=models.FactorRange(*(inert(name) for name in reversed(names))),
    )


def _canvas(height: int, drag: str, **given: Any) -> Canvas:
    tools = TOOLS.replace("box_zoom", "xbox_zoom,box_zoom") if drag == "xbox_zoom" else TOOLS
    canvas: Canvas = figure(
        height=height,
        sizing_mode="stretch_width",
        tools=tools,
        active_drag=drag,
        active_scroll=None,  # the wheel scrolls the page until its tool is chosen
        toolbar_location="above",
        background_fill_color=None,
        border_fill_color=None,
        outline_line_color=None,
        **given,
    )
    canvas.toolbar.logo = None
    return canvas


def source(**columns: Any) -> Any:
    """Return columns as Bokeh keeps them; numbers in single precision, which is half the file."""
    return models.ColumnDataSource(
        {name: values.astype(np.float32) if _real(values) else values for name, values in columns.items()}
    )


def _real(values: Any) -> bool:
    return getattr(values, "dtype", None) == np.float64


def hover(canvas: Canvas, renderers: Sequence[Any], lines: Sequence[tuple[str, str]]) -> None:
    """Show these lines, label and "@column", at the points of the renderers."""
    canvas.add_tools(models.HoverTool(renderers=list(renderers), tooltips=list(lines), visible=False))


def legend_below(canvas: Canvas, entries: Sequence[tuple[str, Sequence[Any]]], columns: int = 2) -> None:
    """Put a legend under the canvas; a click on an entry hides its marks."""
    legend = models.Legend(
        items=[(inert(label), list(renderers)) for label, renderers in entries],
        ncols=columns,
        click_policy="hide",
        inactive_fill_color="#888888",
        inactive_fill_alpha=0.35,
        location="left",
        background_fill_color=None,
        border_line_color=None,
        label_text_font_size="13px",
        label_standoff=8,
        spacing=6,
        padding=2,
        margin=4,
    )
    canvas.add_layout(legend, "below")


def inert(text: str) -> str:
    """Return a text in which Bokeh finds no TeX, for which it would ask the network."""
    return text.replace("$", "$\u200b").replace("\\", "\\\u200b")


def shade(canvas: Canvas, spans_s: Sequence[tuple[float, float]], colour: str) -> None:
    """Shade spans of time."""
    for start_s, end_s in spans_s:
        canvas.add_layout(
            models.BoxAnnotation(
                left=start_s, right=end_s, fill_color=colour, line_color=None, tags=["shade"], level="image"
            )
        )


def frame(canvas: Canvas, half: float) -> None:
    """Let the axis of a signed quantity reach from -half to half."""
    canvas.y_range = models.Range1d(-half, half)


def broken(time_s: Vector, *columns: Array, longest_s: float | None = None) -> tuple[Array, ...]:
    """Return times and columns with NaN where epochs are missing, so that lines break there."""
    if len(time_s) < 2:
        return time_s, *columns
    limit_s = 3 * float(np.median(np.diff(time_s))) if longest_s is None else longest_s
    cuts = np.flatnonzero(np.diff(time_s) > limit_s) + 1
    return tuple(np.insert(values, cuts, np.nan, axis=0) for values in (time_s, *columns))
