"""HTML files as a browser without scripts reads them: elements, tables, text; and as headless Chromium shows them."""

import json
import re
import shutil
import subprocess
from dataclasses import dataclass, field
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

FLAGS = (
    *("--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-sync"),
    *("--disable-background-networking", "--disable-component-update", "--enable-logging=stderr"),
    *("--virtual-time-budget=20000", "--dump-dom"),
)


@dataclass
class HtmlPage(HTMLParser):
    """Elements with their attributes, the rows of all tables, and the text outside of scripts and styles."""

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
