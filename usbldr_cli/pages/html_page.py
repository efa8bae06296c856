"""A page as one HTML file that needs no network: text, tables, and figures that its script draws from their numbers.

A content security policy in the page forbids every request, also to what a name in a log may ask for.
"""

import json
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

from usbldr.filters.errors import printable
from usbldr.io.reports.page import Block, Page, Picture, Plot
from usbldr.io.reports.run_directory import write_atomically

if TYPE_CHECKING:
    from usbldr_cli.figures import drawing  # imports matplotlib

REPORT_HTML = "report.html"
Plots: TypeAlias = Mapping[str, Mapping[str, Any]]


def plots_of(drawn: "Sequence[drawing.Drawn]") -> tuple[tuple[Plot, ...], Plots]:
    """Return drawn figures as blocks of a page, and what its script needs of each, by the names of the blocks."""
    names = [Path(one.file).stem for one in drawn]
    blocks = [Plot(name, f"{one.caption}.", one.text) for name, one in zip(names, drawn, strict=True)]
    return tuple(blocks), {name: one.data for name, one in zip(names, drawn, strict=True)}


def draw_page(
    folder: Path, pictures: "Sequence[drawing.Picture]", page: Callable[[Sequence[Plot]], Page], form: str = "png"
) -> list[Picture]:
    """Draw figures into a folder, and report.html with them; return them as a page in Markdown shows them."""
    from usbldr_cli.figures.drawing import draw  # imports matplotlib

    drawn = draw(folder, pictures, form)
    blocks, plots = plots_of(drawn)
    write_atomically(folder / REPORT_HTML, html(page(blocks), plots).encode())
    return [Picture(one.file, one.caption) for one in drawn]


def html(page: Page, plots: Plots) -> str:
    """Return a page with its figures as HTML."""
    from jinja2 import Environment, PackageLoader

    loader = PackageLoader("usbldr_cli", "pages")
    environment: Any = Environment(loader=loader, autoescape=True, trim_blocks=True, lstrip_blocks=True)
    environment.filters |= {"kind": _kind, "sentence": _sentence, "printable": printable, "anchor": _anchor}
    return environment.get_template("page.html.jinja").render(
        page=page,
        sections=[section for section in page.sections if section.blocks],
        figures=json.dumps(plots, separators=(",", ":")).replace("<", r"\u003c") if plots else "",
    )


def _kind(block: Block) -> str:
    """Return the name of the block's class, by which the template formats it."""
    return type(block).__name__


def _sentence(text: str) -> Any:
    """Return a sentence as HTML, with code between backticks."""
    from markupsafe import Markup, escape

    return Markup(re.sub(r"`([^`]*)`", r"<code>\1</code>", str(escape(printable(text)))))


def _anchor(title: str) -> str:
    return "about-" + re.sub(r"\W+", "-", title.lower()).strip("-")
