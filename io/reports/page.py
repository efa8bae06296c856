"""A report as a page: its verdict, and sections of sentences, tables and figures, which Markdown and HTML format."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

from usbldr.io.reports.report_text import Table


class Labelled(NamedTuple):
    """Sentences, each with its label."""

    lines: tuple[tuple[str, str], ...]


class Bullets(NamedTuple):
    """Sentences of equal rank."""

    lines: tuple[str, ...]


def labelled(lines: Sequence[tuple[str, str]]) -> tuple[Labelled, ...]:
    """Return a block of the sentences, none without any."""
    return (Labelled(tuple(lines)),) if lines else ()


def bullets(lines: Sequence[str]) -> tuple[Bullets, ...]:
    """Return a block of the sentences, none without any."""
    return (Bullets(tuple(lines)),) if lines else ()


class Code(NamedTuple):
    """A line for the shell."""

    line: str


class Picture(NamedTuple):
    """A figure beside the page: file name and caption."""

    name: str
    caption: str


class Plot(NamedTuple):
    """An interactive figure inside the page, by the name under which the page's writer has it.

    ``text`` says what it shows, for those who cannot see it.
    """

    name: str
    caption: str
    text: str = ""


Block: TypeAlias = str | Table | Labelled | Bullets | Code | Picture | Plot
"""A part of a section; a plain sentence may hold code between backticks."""


@dataclass(frozen=True, slots=True)
class Section:
    """Blocks under a title, "" for those at the beginning of the page."""

    title: str
    blocks: tuple[Block, ...]


@dataclass(frozen=True, slots=True)
class Page:
    """A report; sections without blocks are left out."""

    title: str
    verdict: str
    sections: tuple[Section, ...]
