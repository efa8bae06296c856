"""A report as a page: its verdict, and sections of sentences, tables and figures, which Markdown and HTML format."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

from usbldr.filters.errors import printable
from usbldr.io.reports.report_text import TextTable


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


Block: TypeAlias = str | TextTable | Labelled | Bullets | Code | Picture | Plot
"""A part of a section; a plain sentence may hold code between backticks."""


@dataclass(frozen=True, slots=True)
class PageSection:
    """Blocks under a title, "" for those at the beginning of the page."""

    title: str
    blocks: tuple[Block, ...]


@dataclass(frozen=True, slots=True)
class Page:
    """A report; sections without blocks are left out."""

    title: str
    verdict: str
    sections: tuple[PageSection, ...]


def markdown(page: Page) -> str:
    """Return a page as Markdown, which links to the figures beside it."""
    parts = [f"# {plain(page.title)}", f"**{_sentence(page.verdict)}.**"]
    for section in page.sections:
        if section.blocks:
            parts += [f"## {plain(section.title)}"] if section.title else []
            parts += map(_block, section.blocks)
    return "\n\n".join(parts) + "\n"


def _block(block: Block) -> str:
    match block:
        case str():
            return _sentence(block)
        case TextTable():
            return markdown_table(block)
        case Labelled(lines):
            return "\n".join(f"* **{plain(label)}**: {plain(text)}" for label, text in lines)
        case Bullets(lines):
            return "\n".join(f"* {_sentence(line)}" for line in lines)
        case Code(line):
            return f"    {printable(line)}"
        case Picture(name, caption):
            return f"{plain(caption)}:\n\n![{plain(caption)}]({name})"
        case Plot(_, caption):
            raise ValueError(f"Markdown has no interactive figures: {caption}")


def _sentence(text: str) -> str:
    """Return a sentence; stars outside of code are no emphasis."""
    return re.sub(r"(`[^`]*`)|\*", lambda found: found[1] or r"\*", plain(text))


def markdown_table(table: TextTable) -> str:
    """Return a table as Markdown, with columns of numbers to the right."""
    rows = [(table.title, *table.heads), *table.rows]
    lines = [[plain(cell).replace("|", r"\|").replace("*", r"\*") for cell in row] for row in rows]
    lines.insert(1, ["---", *("---:" if table.numbers else "---" for _ in table.heads)])
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def plain(text: str) -> str:
    """Return a text that shows as it is: names in a log may hold HTML, links, or characters that steer a terminal."""
    return printable(text).replace("<", "&lt;").replace("](", r"]\(")
