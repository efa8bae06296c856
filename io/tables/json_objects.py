"""The objects of a text file of JSON: a line each, several lines each, or all within one."""

import json
import re
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, TypeAlias, cast

from usbldr.io.file_access.open_file import head_lines, is_damaged, opened, text_lines
from usbldr.io.limits import limit

OBJECT_LINES = 200  # [lines] of an object at most
MOST_BYTES = 1 << 27  # [bytes] of a file that is one value: Python's objects need ten times as many
REMAINS = re.compile(r"[\"}]")  # behind an object: of one that was damaged
COMMENTS = ("#", "//")  # with which a line begins that holds no object
KEY = re.compile(r"\"\s*:")  # before an object: of the one around it, whose beginning was lost
DOCUMENT = re.compile(r'\s*[\[{]\s*(\[|\{|"[^"\n]*"\s*:)')  # how a value begins that may hold objects
DECODER = json.JSONDecoder()
Object: TypeAlias = Mapping[str, Any]
Found: TypeAlias = tuple[int, str, str, Object | None]
"""The line's number, what stands before an object, its text and the object; None for what is none."""


def objects_of(file: Path) -> Iterator[Found]:
    """Yield the objects of a file; of one that is an array as a whole its elements."""
    document = whole_value(file)
    if document is None:
        yield from objects_in(text_lines(file))
    for one in cast("list[Any]", document) if isinstance(document, list) else [document] if document else ():
        yield 1, "", json.dumps(one), cast("Object", one) if isinstance(one, dict) else None


def whole_value(file: Path) -> Any:
    """Return the value that a file is as a whole; None if it is none, or if its first line is an object."""
    with opened(file) as content:
        head = head_lines(content.peek(1))
        if not head or not DOCUMENT.match("\n".join(head[:3])) or first_object(head[0]) is not None:
            return None
        if file.stat().st_size > limit(MOST_BYTES):
            return None
        with suppress(ValueError, RecursionError):
            return json.loads(content.read())
    return None


def joined(lines: Iterable[str]) -> Iterator[tuple[int, str]]:
    """Yield lines with their numbers; those of an object whose brackets have lines of their own as one.

    Objects within it are indented, so that the next one ends an object that is not closed.
    """
    held: list[str] = []
    number = 0
    for number, line in enumerate(lines, start=1):
        opens = line.strip("[, \t\r\n") == "{"
        if held and (len(held) == OBJECT_LINES or (opens and _indent(line) <= _indent(held[0]))):
            yield from enumerate(held, start=number - len(held))
            held = []
        if not held and not opens:
            yield number, line
            continue
        held.append(line)
        if line.lstrip().startswith("}") and first_object(text := "\n".join(map(str.rstrip, held))) is not None:
            yield number - len(held) + 1, text
            held = []
    yield from enumerate(held, start=number - len(held) + 1)


def _indent(line: str) -> int:
    return len(line) - len(line.lstrip())


def objects_in(lines: Iterable[str]) -> Iterator[Found]:
    """Yield the objects of lines: of one several, as of an array on one line, before a remark; comments hold none."""
    for number, line in joined(lines):
        end, place = 0, line.find("{") if not KEY.search(line.partition("{")[0]) else -1
        if number == 1 and place >= 0 and (cut := _end_of_begun(line)):  # of a record whose beginning was lost
            yield number, "", line[:cut], None
            end, place = cut, line.find("{", cut)
        while place >= 0:
            try:
                value, behind = DECODER.raw_decode(line, place)
            except (ValueError, RecursionError):
                break
            if end and REMAINS.search(line[end:place]):
                yield number, "", line[end:place], None
            yield number, line[end:place], line[place:behind], value
            end, place = behind, line.find("{", behind)
        rest = line[end:].strip("[], \r\n\t")
        if (
            rest
            and not (end == 0 and rest.startswith(COMMENTS))
            and (not end or place >= 0 or is_damaged(rest) or REMAINS.search(rest))
        ):
            yield number, "", rest, None


def _end_of_begun(line: str) -> int:
    """Return the length of a line up to the last bracket that closes an object from before it, 0 if none does."""
    depth = least = end = 0
    for place, character in enumerate(line):
        depth += (character == "{") - (character == "}")
        if depth < least:
            least, end = depth, place + 1
    return end


def first_object(line: str) -> Object | None:
    """Return the object that ends a line, or with which it begins; None if there is none: else it is within a cell."""
    _, before, text, value = next(objects_in([line]), (0, "", "", None))
    return value if line.rstrip().endswith(text) or not before.strip("[ ") else None
