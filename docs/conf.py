"""Settings of Sphinx, which makes a site of the documentation (`make docs`); the index page gives its contents."""

import importlib.metadata
import re

from sphinx.application import Sphinx

project = "usbldr"
release = importlib.metadata.version("usbldr")
extensions = ["myst_parser", "sphinx_click"]
myst_heading_anchors = 3
root_doc = "README"
include_patterns = ["*.md", "docs/**.md", "sample_logs/README.md"]
html_theme = "furo"
html_title = f"usbldr {release}"
html_show_copyright = False
man_pages = [("docs/commands", "usbldr", "replay logs of underwater vehicles through navigation filters", "", 1)]


def add_contents(_app: Sphinx, name: str, text: list[str]) -> None:
    """Add the list of contents that Sphinx needs, hidden: to the first page the index, to the index its links."""
    linked = re.findall(r"\]\(([^)#]+\.md)\)", text[0])
    pages = {root_doc: ["docs/README.md"], "docs/README": [page for page in linked if page != "../README.md"]}
    if name in pages:
        text[0] += "\n".join(["\n```{toctree}", ":hidden:", "", *pages[name], "```\n"])


def setup(app: Sphinx) -> None:
    """Connect the functions of this file."""
    app.connect("source-read", add_contents)
