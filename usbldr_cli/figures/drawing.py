"""Figures as files and for the page: each is described and drawn once, several at a time."""

import multiprocessing
import os
import sys
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import Any, NamedTuple

from usbldr_cli.figures.page_data import page_data, text_of
from usbldr_cli.figures.style import Figure, in_style, save


class Picture(NamedTuple):
    """A figure to draw: the name of its file, without ending, its caption, and what describes it."""

    name: str
    caption: str
    describe: Callable[[], Figure | None]


class Drawn(NamedTuple):
    """A figure that was drawn: its file, what the page needs of it, and what it shows in words."""

    file: str
    caption: str
    text: str
    data: dict[str, Any]


def draw(folder: Path, pictures: Sequence[Picture], form: str = "png") -> list[Drawn]:
    """Draw the pictures that apply into the folder as png, svg or pdf; each file appears when it is complete."""
    places = range(len(pictures))
    workers = min(_processors(), len(pictures))
    if workers > 1 and sys.platform == "linux":  # elsewhere a process would import everything again
        try:
            context = multiprocessing.get_context("fork")  # takes over what is to be drawn
            with ProcessPoolExecutor(workers, context, _take_over, (folder, pictures, form)) as pool:
                return _applying(pool.map(_draw_inherited, places))
        except BrokenProcessPool:  # killed, perhaps for want of memory: one after the other needs less
            pass
    return _applying(_draw(folder, picture, form) for picture in pictures)


def described(pictures: Sequence[Picture]) -> list[Drawn]:
    """Return pictures for the page alone, without their files."""
    with in_style():
        figures = [(picture, figure) for picture in pictures if (figure := picture.describe()) is not None]
        return [Drawn(one.name, one.caption, text_of(figure), page_data(figure)) for one, figure in figures]


def _processors() -> int:
    """Return how many processors this process may use."""
    return len(os.sched_getaffinity(0)) if sys.platform == "linux" else 1


def _applying(drawn: Iterable[Drawn | None]) -> list[Drawn]:
    return [one for one in drawn if one is not None]


_INHERITED: list[Any] = []  # of a forked process: folder, pictures, format


def _take_over(*inherited: Any) -> None:
    _INHERITED[:] = inherited


def _draw_inherited(place: int) -> Drawn | None:
    folder, pictures, form = _INHERITED
    return _draw(folder, pictures[place], form)


def _draw(folder: Path, picture: Picture, form: str) -> Drawn | None:
    with in_style():
        figure = picture.describe()
        if figure is None:
            return None
        file = f"{picture.name}.{form}"
        save(figure, folder / file)
        return Drawn(file, picture.caption, text_of(figure), page_data(figure))
