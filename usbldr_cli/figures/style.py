"""The style of all figures: one colour per method, titles, and bytes that do not change between runs.

The colours are those of M. Okabe and K. Ito ("Color Universal Design", 2008) and P. Tol's muted scheme, which
colour-blind readers can distinguish; no meaning depends on colour alone.
"""

import io
import textwrap
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from matplotlib import figure as mpl_figure
from matplotlib import rc_context, rcParamsDefault  # pyright: ignore[reportUnknownVariableType]
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.ticker import LogLocator, NullLocator, StrMethodFormatter
from numpy.typing import NDArray
from PIL import Image

from usbldr.filters.errors import printable
from usbldr.filters.evaluation.alignment import ALIGNMENTS
from usbldr.filters.replay.methods import METHODS
from usbldr.filters.types import Array, Mask, Vector
from usbldr.io.reports.report_text import ORDERS, TRUTHS, aid_text, window_text
from usbldr.io.reports.run import Run, ScoredTrack
from usbldr.io.reports.run_directory import write_atomically

Axes: TypeAlias = Any  # matplotlib's own types leave every keyword unknown, which strict checking refuses
Figure: TypeAlias = Any

Span: TypeAlias = tuple[float, float]  # seconds
EVER: Span = (-np.inf, np.inf)
AXES = ("east", "north")
WRAPPED = " \n"  # fixed: the end of a line of a title that is broken for its length alone, which a page need not keep

OTHER_COLOUR = "#44aa99"  # of a run by a method that this version does not have
TRUTH_COLOUR = "#000000"
REJECTED_COLOUR = "#cc0000"

OUTAGES: Mapping[str, tuple[str, str]] = {
    "usbl": ("#e4e4e4", ""),
    "dvl": ("#fde3cf", "//"),
    "compass": ("#dcebd8", ".."),
}
"""Shade and hatch of an outage of a sensor."""

STYLE: Mapping[str, Any] = {
    "font.size": 10,
    "axes.titlesize": 10,
    "axes.titlelocation": "left",
    "axes.titley": 1.0,  # fixed: nothing is above the axes; to look for it takes a fifth of the time
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#e6e6e6",
    "grid.linewidth": 0.7,
    "hatch.color": "#ffffff",
    "legend.frameon": False,
    "legend.fontsize": 9,
    "lines.linewidth": 1.3,
    "svg.hashsalt": "usbldr",
}
DPI = 130  # [dots per inch] sharp on a page, and small as a file
COMPRESSION = 3  # [of 9] of PNG: two thirds of the time of 6, the usual one, for files 4 % larger
UNDATED: Mapping[str, str] = {".svg": "Date", ".pdf": "CreationDate"}  # key of the date in a file's metadata
GAP_STEPS = 3.0  # times the usual step: a longer gap breaks the line
EDGE = 0.97  # of the height of the axes: where larger errors are drawn
MANY_POINTS = 5000  # [points] of one colour, from which those at the same dot are drawn once
PANEL = (1000, 1000)  # [dots] width and height of a panel, in which a mark is three dots wide
TITLE_IN, LINE_IN, LETTERS_AN_INCH = 0.47, 0.23, 14  # of the title and of the lines under it, inches


def in_style() -> AbstractContextManager[None]:
    """Draw in this style, whatever matplotlib's own settings are; they are global, so they are restored afterwards."""
    usual: Any = rcParamsDefault
    settings: Any = {name: value for name, value in usual.items() if name != "backend"} | dict(STYLE)
    return rc_context(settings)


def colour(method: str) -> str:
    """Return the colour of a method in every picture."""
    return METHODS[method].colour if method in METHODS else OTHER_COLOUR


def raw_fixes(method: str) -> bool:
    """Return whether a method's track is the fixes themselves: points, not a line."""
    return method in METHODS and METHODS[method].scored_at_fixes


def run_figure(run: Run, what: str, width_in: float, height_in: float) -> Figure:
    """Return a figure whose title says what is drawn, of which run, with which truth."""
    return titled_figure(f"{what}: {run.label} on {run.log.path.name}", subtitle(run), width_in, height_in)


def titled_figure(title: str, detail: str, width_in: float, height_in: float) -> Figure:
    """Return a figure with a title and a line of detail under it."""
    lines = textwrap.wrap(printable(detail), int(width_in * LETTERS_AN_INCH))
    head_in = TITLE_IN + LINE_IN * len(lines)
    figure: Figure = mpl_figure.Figure(figsize=(width_in, height_in), layout="constrained")
    figure.get_layout_engine().set(rect=(0, 0, 1, 1 - head_in / height_in), w_pad=0.08, h_pad=0.06)
    left, top = 0.12 / width_in, 1 - 0.27 / height_in
    figure.text(left, top, printable(title), size=13, weight="bold", va="center")
    figure.text(left, 1 - TITLE_IN / height_in, "\n".join(lines), size=9, color="#444444", va="top")
    return figure


def subtitle(run: Run) -> str:
    """Return truth, order of fixes, alignment and windows of a run."""
    report = run.scored.report
    if report is None:
        return f"no truth; fixes {ORDERS[run.order]}"
    fixes = [f"fixes {ORDERS[run.order]}"] if run.method in METHODS else []
    parts = [
        truth_text(report.truth_kind, report.truth_source),
        *fixes,
        f"alignment: {ALIGNMENTS[report.alignment.name]}",
    ]
    if report.aid:
        parts.append(aid_text(report.aid))
    if report.window != (-np.inf, np.inf):
        parts.append(window_text(report.window))
    return "; ".join(parts)


def truth_text(kind: str, source: str) -> str:
    """Return the truth in words: a file by its name, a topic in full."""
    file = Path(source)
    return f"truth: {TRUTHS.get(kind, kind)} ({file.name if file.suffix else source})"


def save(figure: Figure, path: Path) -> None:
    """Write a whole figure in the format of its suffix (.png, .svg, .pdf), without a version or a date in it."""
    packed = io.BytesIO()  # Pillow's own writing hides why it failed
    if path.suffix != ".png":
        figure.savefig(packed, format=path.suffix[1:], metadata={UNDATED[path.suffix]: None})
    else:
        figure.dpi = DPI
        canvas = FigureCanvasAgg(figure)  # unlike savefig, this draws only once
        if any(axes.get_aspect() == 1 for axes in figure.axes):
            figure.get_layout_engine().execute(figure)  # equal scales settle in a second pass, the drawing
        canvas.draw()
        picture = Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3])
        picture.save(packed, "PNG", compress_level=COMPRESSION, dpi=(DPI, DPI))
    write_atomically(path, packed.getvalue())


def shade_outages(axes: Axes, run: Run) -> None:
    """Shade the outages of each sensor; the first of each has the label."""
    labelled: set[str] = set()
    for outage in run.timeline.outages:
        shade, hatch = OUTAGES[outage.sensor]
        label = None if outage.sensor in labelled else f"no {outage.sensor}"
        labelled.add(outage.sensor)
        axes.axvspan(outage.start_s, outage.end_s, facecolor=shade, hatch=hatch, linewidth=0, zorder=0, label=label)


def other_tracks(run: Run) -> list[ScoredTrack]:
    """Return the baselines that are not the method itself."""
    return [other for other in run.reference_tracks if other.trajectory.label != run.label]


def time_axis(axes: Axes, *times_s: Vector) -> None:
    """Label the time axis and let it span these times; one second if there is only one."""
    first, last = min(t[0] for t in times_s), max(t[-1] for t in times_s)
    axes.set_xlabel("time since the log's start [s]")
    axes.set_xlim(first, last if last > first else first + 1.0)


def logarithmic(axes: Axes, which: str = "y", ticks: Sequence[int] = (1,)) -> None:
    """Give an axis a logarithmic scale with plain numbers, ``ticks`` times 10^n; minor ticks take long to draw."""
    axes.set(**{f"{which}scale": "log"})
    axis: Any = getattr(axes, f"{which}axis")
    axis.set_major_locator(LogLocator(subs=ticks))
    axis.set_minor_locator(NullLocator())
    axis.set_major_formatter(StrMethodFormatter("{x:g}"))


def broken_at_gaps(time_s: Vector, values: Array, longest_s: float | None = None) -> tuple[Vector, Array]:
    """Return a line with NaN in gaps longer than ``longest_s``, else than its own longest step."""
    cuts = np.flatnonzero(np.diff(time_s) > (longest_step_s(time_s) if longest_s is None else longest_s)) + 1
    return np.insert(time_s, cuts, np.nan), np.insert(values, cuts, np.nan, axis=0)


def longest_step_s(time_s: Vector) -> float:
    """Return the step beyond which a line is broken, because epochs were left out."""
    return GAP_STEPS * float(np.median(np.diff(time_s))) if len(time_s) > 1 else np.inf


def one_a_dot(x: Vector, y: Vector, panel: tuple[int, int] = PANEL) -> NDArray[np.intp]:
    """Return which points are drawn: of many at the same dot of a panel, so many dots wide and high, the first."""
    known = np.flatnonzero(np.isfinite(x) & np.isfinite(y))
    if len(known) < MANY_POINTS:
        return known
    across, up = (
        np.floor((v - v.min()) / max(float(np.ptp(v)), 1e-12) * dots)
        for v, dots in zip((x[known], y[known]), panel, strict=True)
    )
    return known[np.sort(np.unique(across * (panel[1] + 1) + up, return_index=True)[1])]


def usual_most(lengths: Array) -> float:
    """Return the largest length, or 1.6 times the 99th percentile if that is less: a few gross errors do not set it."""
    return min(float(lengths.max()), 1.6 * float(np.percentile(lengths, 99)))


def within(time_s: Vector, span_s: Span) -> Mask:
    """Return which times are in a span, ends included."""
    return (time_s >= span_s[0]) & (time_s <= span_s[1])


def legend_below(figure: Figure, panels: Sequence[Axes], columns: int = 6) -> None:
    """Put the legend of some panels under the figure; each label once."""
    entries: dict[str, Any] = {}
    for panel in panels:
        handles, labels = panel.get_legend_handles_labels()
        entries = dict(zip(labels, handles, strict=True)) | entries
    style = {"loc": "outside lower left", "ncols": columns, "columnspacing": 1.4}
    legend = figure.legend(list(entries.values()), list(entries), **style)
    for line in legend.get_lines():  # faint points are opaque in the legend
        line.set_alpha(1)
