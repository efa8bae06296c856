"""A report as Markdown."""

import re

from usbldr.filters.errors import printable
from usbldr.io.reports.page import Block, Bullets, Code, Labelled, Page, Picture, Plot
from usbldr.io.reports.report_text import Table


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
        case Table():
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


def markdown_table(table: Table) -> str:
    """Return a table as Markdown, with columns of numbers to the right."""
    rows = [(table.title, *table.heads), *table.rows]
    lines = [[plain(cell).replace("|", r"\|").replace("*", r"\*") for cell in row] for row in rows]
    lines.insert(1, ["---", *("---:" if table.numbers else "---" for _ in table.heads)])
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def plain(text: str) -> str:
    """Return a text that shows as it is: names in a log may hold HTML, links, or characters that steer a terminal."""
    return printable(text).replace("<", "&lt;").replace("](", r"]\(")
