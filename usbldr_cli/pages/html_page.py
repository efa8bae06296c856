"""A page as one HTML file that needs no network: text, tables, and figures of Bokeh with its script inside.

A content security policy in the page forbids every request, also to what a name in a log may ask for.
"""

import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from usbldr.filters.errors import printable
from usbldr.io.reports.page import Block, Page
from usbldr.io.reports.run_directory import write_atomically

REPORT_HTML = "report.html"


def write_html(path: Path, page: Page, plots: Mapping[str, Any]) -> None:
    """Write a page with its figures, Bokeh models by the names of the page's Plot blocks; it appears when complete."""
    write_atomically(path, html(page, plots).encode())


def html(page: Page, plots: Mapping[str, Any]) -> str:
    """Return a page with its figures as HTML."""
    from bokeh.embed import json_item
    from bokeh.resources import Resources
    from jinja2 import Environment, PackageLoader

    loader = PackageLoader("usbldr_cli", "pages")
    environment: Any = Environment(loader=loader, autoescape=True, trim_blocks=True, lstrip_blocks=True)
    environment.filters |= {"kind": _kind, "sentence": _sentence, "printable": printable, "anchor": _anchor}
    embedded: Any = json_item
    figures: dict[str, Any] = {name: embedded(model, f"plot-{name}") for name, model in plots.items()}
    return environment.get_template("page.html.jinja").render(
        page=page,
        sections=[section for section in page.sections if section.blocks],
        figures=json.dumps(figures).replace("<", r"\u003c"),
        scripts=Resources(mode="inline", components=["bokeh"], log_level="warn").js_raw if figures else [],
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
