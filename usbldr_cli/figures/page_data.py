"""What a drawn figure holds, for the page's script, which draws it again to point at and to zoom into.

Every figure is described once, by what it draws with matplotlib: panels, lines, marks, bands and shades are read back
from it here. A column of numbers is stored once for all series that share it, in single precision, as base64.
"""

import base64
from collections.abc import Iterable, Mapping
from itertools import zip_longest
from typing import Any, TypeAlias

import numpy as np
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import to_hex  # pyright: ignore[reportUnknownVariableType]
from matplotlib.ticker import FixedLocator

from usbldr.filters.types import Array, Mask, Vector
from usbldr_cli.figures.style import WRAPPED, Axes, Figure, one_a_dot

DETAILS = "usbldr_details"  # attribute of an artist
INCH_PX = 84  # [pixels] of the page for an inch of a figure's height
LEAST_PX, MOST_PX = 120, 560  # [pixels] of a panel: a curve can be read; it fits a screen with its legend
MOST_POINTS = 2000  # [points] of a line over time: the extremes of each dot of a screen
MOST_PLACES = 6000  # [points] of a track: one in 5 s of a day
DOTS = (140, 30)  # [dots] of a panel: of thousands of marks at one of them, the page has the first, to stay below 2 MB
SHADES = 16  # of a scale of colours
DASHES = {"-": "", "--": "7 4", ":": "2 3", "-.": "7 3 2 3"}  # [pixels] drawn and left out
SCREEN = {"#000000": "ink", "#ffffff": "paper", "#333333": "soft", "#444444": "soft", "#cc0000": "bad"}
"""Colours that the page has by name, because they differ between light and dark."""


Kind: TypeAlias = tuple[Mask, str, str]  # which points are of it (n,), their colour and label


def detail(artists: Any, rows: Mapping[str, Any] | None = None, **shown: Any) -> None:
    """Give a drawn line what the page tells of each of its points beside x and y: columns by label and unit.

    ``x`` and ``y`` are the values of marks that are drawn elsewhere, at the edge, because they lie beyond the axes.
    What has the same ``key`` (the label, if none is given) is hidden together.
    """
    setattr(artists, DETAILS, {"rows": dict(rows or {}), **shown})


def plot_inside(axes: Axes, x: Vector, y: Vector, limits: tuple[float, float], **style: Any) -> None:
    """Plot a line or points; what lies beyond the limits is drawn at the edge, and the page tells its true height."""
    inside = np.clip(y, *limits)
    points = style.get("ls") == ""
    shown = one_a_dot(x, np.log(inside) if limits[0] > 0 else inside) if points else np.arange(len(x))
    (drawn,) = axes.plot(x[shown], inside[shown], **style)
    detail(drawn, y=y[shown])


def plot_kinds(axes: Axes, x: Vector, y: Vector, kinds: Iterable[Kind], edge: float = np.inf, **style: Any) -> None:
    """Plot the known points (n,) of each kind; those whose y is beyond the edge, up or down, at the edge."""
    for chosen, colour, label in kinds:
        kept = chosen & np.isfinite(x) & np.isfinite(y)
        if kept.any():
            look = {"ls": "", "marker": ".", "color": colour, "label": label, **style}
            plot_inside(axes, x[kept], y[kept], (-edge, edge), **look)


class _Columns:
    """Columns of numbers, each stored once."""

    def __init__(self) -> None:
        self.texts: list[str | list[str]] = []  # numbers as base64, or words
        self.places: dict[bytes, int] = {}

    def place(self, values: Any) -> int:
        """Return where a column is stored."""
        if np.asarray(values).dtype.kind == "U":
            self.texts.append([str(text) for text in values])
            return len(self.texts) - 1
        packed = np.asarray(values, dtype="<f4").tobytes()
        if packed not in self.places:
            self.places[packed] = len(self.texts)
            self.texts.append(base64.b64encode(packed).decode())
        return self.places[packed]


def page_data(figure: Figure) -> dict[str, Any]:
    """Return a figure as the page's script draws it: columns of panels, and the numbers that they show."""
    columns = _Columns()
    parts = list(figure.subfigs) or [figure]
    height_in = float(figure.get_size_inches()[1])
    drawn: list[dict[str, Any]] = []
    for part in parts:
        grids: dict[int, list[Axes]] = {}
        for axes in part.axes:
            if axes.get_label() != "<colorbar>":
                grids.setdefault(axes.get_subplotspec().colspan.start, []).append(axes)
        for place, panels in sorted(grids.items()):
            grid = panels[0].get_subplotspec().get_gridspec()
            shares = grid.get_width_ratios()
            width = shares[place] / sum(shares)
            if part is not figure:
                width *= float(part.bbox.width / figure.bbox.width)
            drawn.append({"width": width, "panels": [_panel(axes, columns, height_in) for axes in panels]})
    return {"columns": drawn, "numbers": columns.texts}


def text_of(figure: Figure) -> str:
    """Return what a figure shows, in words: the titles of its panels, their axes, and what is drawn."""
    parts: list[str] = []
    labels: dict[str, None] = {}
    for axes in figure.axes:
        if axes.get_label() == "<colorbar>":
            continue
        across, up = axes.get_xlabel(), axes.get_ylabel()
        titles = [
            _title(axes).strip().replace("\n", ", "),
            f"{up} over {across}" if across and up else up or across,
        ]
        parts.append("; ".join(filter(None, titles)))
        labels |= dict.fromkeys(axes.get_legend_handles_labels()[1])
    return f"{'. '.join(parts)}. Drawn: {', '.join(labels)}." if labels else f"{'. '.join(parts)}."


def _title(axes: Axes) -> str:
    return axes.get_title(loc="left").replace(WRAPPED, " ")


def _panel(axes: Axes, columns: _Columns, height_in: float) -> dict[str, Any]:
    spec = axes.get_subplotspec()
    shares = spec.get_gridspec().get_height_ratios()
    height = INCH_PX * height_in * shares[spec.rowspan.start] / sum(shares)
    marks = [mark for artist in axes.get_children() if (mark := _mark(axes, artist, columns)) is not None]
    return {
        "height": round(min(max(height, LEAST_PX), MOST_PX)),
        "title": _title(axes),
        "equal": axes.get_aspect() == 1,
        "linked": min(axes.figure.figure.axes.index(one) for one in axes.get_shared_x_axes().get_siblings(axes)),
        "x": _scale(axes.xaxis, axes.get_xlim()),
        "y": _scale(axes.yaxis, axes.get_ylim()) | {"label": _label_up(axes)},
        "marks": sorted(marks, key=lambda mark: mark["order"]),
    }


def _label_up(axes: Axes) -> str:
    """Return the label of the vertical axis, which panels beside each other may share."""
    row = axes.get_subplotspec().rowspan
    beside = axes.get_shared_y_axes().get_siblings(axes)
    return next((one.get_ylabel() for one in beside if one.get_subplotspec().rowspan == row and one.get_ylabel()), "")


def _scale(axis: Any, limits: tuple[float, float]) -> dict[str, Any]:
    ticks: list[tuple[float, str]] | None = None  # the page finds round numbers
    if isinstance(axis.get_major_locator(), FixedLocator):
        texts = [one.get_text() for one in axis.get_ticklabels()]
        ticks = [(float(at), text or f"{at:g}") for at, text in zip_longest(axis.get_ticklocs(), texts)]
    return {
        "label": axis.get_label_text(),
        "limits": [float(limit) for limit in limits],
        "log": axis.get_scale() == "log",
        "ticks": ticks,
    }


def _mark(axes: Axes, artist: Any, columns: _Columns) -> dict[str, Any] | None:
    """Return a drawn line, mark, band or shade; None for what is no part of the data."""
    found: dict[str, Any] | None = None
    if artist in axes.lines:
        found = _line(axes, artist, columns)
    elif isinstance(artist, LineCollection):
        found = _many_lines(artist, columns)
    elif isinstance(artist, PolyCollection):
        found = _band(artist, columns)
    elif artist in axes.patches:
        found = _patch(axes, artist, columns)
    elif artist in axes.texts:
        x, y = artist.xy
        found = {"kind": "text", "text": artist.get_text(), "at": [float(x), float(y)], "colour": "soft"}
    if found is None:
        return None
    label, alpha = str(artist.get_label()), artist.get_alpha()
    named = "" if label.startswith(("_child", "_nolegend_")) else label.removeprefix("_")
    found["key"] = getattr(artist, DETAILS, {}).get("key") or named
    if label in {text.get_text() for legend in axes.figure.figure.legends for text in legend.get_texts()}:
        found["label"] = label
    found["alpha"] = 1.0 if alpha is None else alpha
    found["order"] = artist.get_zorder()
    return found


def _line(axes: Axes, line: Any, columns: _Columns) -> dict[str, Any] | None:
    x, y = (np.asarray(values, dtype=float) for values in line.get_data(orig=False))
    if not len(x):
        return None
    style = {"colour": _colour(line.get_color()), "width": line.get_linewidth()}
    if line.get_transform() is not axes.transData:  # from one side of the axes to the other
        level = {"down": float(x[0])} if x[0] == x[-1] and (y[0], y[-1]) == (0, 1) else {"across": float(y[0])}
        return {"kind": "rule", **style, **level, "dash": DASHES[line.get_linestyle()]}
    given: dict[str, Any] = getattr(line, DETAILS, {})
    rows: dict[str, Any] = given.get("rows", {})
    if line.get_linestyle() != "None" and line.get_drawstyle() == "steps-post":
        x, y = np.repeat(x, 2)[1:], np.repeat(y, 2)[:-1]
    marker = line.get_marker()
    found: dict[str, Any] = {"kind": "line", **style, "dash": DASHES.get(line.get_linestyle(), "")}
    if marker not in ("None", "", " ", None):
        face = line.get_markerfacecolor()
        found |= {"marker": marker, "size": line.get_markersize(), "edge": _colour(line.get_markeredgecolor())}
        found |= {"face": "none" if isinstance(face, str) and face == "none" else _colour(face)}
        found |= {"line": line.get_markeredgewidth()}
    if line.get_linestyle() == "None":
        found["kind"] = "points"
        height = np.log(y) if axes.get_yscale() == "log" else y
        kept = np.arange(len(x)) if rows else one_a_dot(x, height, DOTS)
    else:
        kept = thinned(x, y)
    found["beyond"] = [axis for axis in ("x", "y") if axis in given]
    x, y = given.get("x", x), given.get("y", y)
    found |= {"x": columns.place(x[kept]), "y": columns.place(y[kept])}
    found["rows"] = [[name, columns.place(np.asarray(values)[kept])] for name, values in rows.items()]
    return found


def thinned(x: Vector, *ys: Vector) -> Any:
    """Return which points (m,) of a line are kept: the lowest and the highest of each of many equal parts, and gaps."""
    if len(x) <= MOST_POINTS:
        return np.arange(len(x))
    with np.errstate(invalid="ignore"):
        in_plane = bool(np.any(np.diff(x) < 0))
    gaps = np.flatnonzero(np.isnan(x) | np.isnan(ys[0]))
    if in_plane:
        return np.union1d(np.arange(0, len(x), -(-len(x) // MOST_PLACES)), np.append(gaps, len(x) - 1))
    starts = np.linspace(0, len(x), MOST_POINTS // (2 * len(ys)) + 1).astype(int)[:-1]
    kept = np.append(gaps, [0, len(x) - 1])
    for y in ys:
        for least in (np.where(np.isnan(y), np.inf, y), np.where(np.isnan(y), np.inf, -y)):
            ends = np.append(starts[1:], len(x))
            places = [a + int(np.argmin(least[a:b])) for a, b in zip(starts, ends, strict=True)]
            kept = np.union1d(kept, places)
    return kept


def _many_lines(lines: Any, columns: _Columns) -> dict[str, Any]:
    segments = lines.get_segments()
    values: Any = lines.get_array()
    if values is not None:
        ends = np.array([segment.ravel() for segment in segments])  # (n, 4)
        scale: Any = lines.get_cmap()
        low, high = lines.get_clim()
        return {
            "kind": "scale",
            "ends": [columns.place(column) for column in ends.T],
            "value": columns.place(values),
            "limits": [low, high],
            "colours": [to_hex(scale(k / (SHADES - 1))) for k in range(SHADES)],
            "name": lines.colorbar.ax.get_ylabel() if lines.colorbar is not None else "",
            "width": float(lines.get_linewidth()[0]),
        }
    x, y = _joined(np.asarray(segment) for segment in segments)
    style = {"colour": _colour(lines.get_color()[0]), "width": float(lines.get_linewidth()[0])}
    return {"kind": "line", **style, "dash": "", "x": columns.place(x), "y": columns.place(y), "rows": [], "mute": True}


def _joined(lines: Iterable[Array]) -> tuple[Vector, Vector]:
    """Return several lines as one, with NaN between them."""
    gap = np.full((1, 2), np.nan)
    points = np.vstack([part for line in lines for part in (line, gap)] or [gap])
    return points[:, 0], points[:, 1]


def _band(band: PolyCollection, columns: _Columns) -> dict[str, Any]:
    """Return what `fill_between` drew: its polygons go along the lower edge and back along the upper one."""
    x, low, high = ([np.array([np.nan])] for _ in range(3))
    for path in band.get_paths():
        corners = np.asarray(path.vertices)
        n = (len(corners) - 3) // 2
        edge, back = corners[1 : n + 1], corners[n + 2 : 2 * n + 2][::-1]
        kept = thinned(edge[:, 0], edge[:, 1], back[:, 1])
        for column, values in ((x, edge[kept, 0]), (low, edge[kept, 1]), (high, back[kept, 1])):
            column += [values, np.array([np.nan])]
    return {
        "kind": "band",
        "colour": _colour(band.get_facecolor()[0]),
        **{name: columns.place(np.concatenate(parts)) for name, parts in (("x", x), ("low", low), ("high", high))},
    }


def _patch(axes: Axes, patch: Any, columns: _Columns) -> dict[str, Any] | None:
    corners = patch.get_patch_transform().transform_path(patch.get_path()).vertices
    colour = _colour(patch.get_facecolor())
    if patch.get_data_transform() is not axes.transData:  # from one side of the axes to the other
        axis = int(patch.get_data_transform() is axes.get_yaxis_transform())
        ends = corners[:, axis]
        return {"kind": "shade", "colour": colour, "axis": "xy"[axis], "from": ends.min(), "to": ends.max()}
    x, y = columns.place(corners[:, 0]), columns.place(corners[:, 1])
    return {"kind": "area", "colour": colour, "x": x, "y": y}


def _colour(colour: Any) -> str:
    text = str(to_hex(colour))
    return SCREEN.get(text, text)
