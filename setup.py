"""The description of the package: the README without its relative links and pictures, which lead nowhere on PyPI."""

import re
from pathlib import Path

from setuptools import setup

RELATIVE = r"\((?!https?:)[^)]+\)"


def description(readme: str) -> str:
    """Return the text with each relative link replaced by its words; those are the path, if the page is the subject."""
    return re.sub(rf"\[([^\]]+)\]{RELATIVE}", r"\1", re.sub(rf"!\[[^\]]*\]{RELATIVE}", "", readme))


if __name__ == "__main__":
    text = (Path(__file__).parent / "README.md").read_text(encoding="utf-8")
    setup(long_description=description(text), long_description_content_type="text/markdown")
