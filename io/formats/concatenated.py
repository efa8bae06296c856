"""A file that holds several recordings, or one behind other bytes: each is cut out and read, and the rest is named."""

from collections.abc import Callable, Sequence
from pathlib import Path

from usbldr.filters.errors import LogError
from usbldr.io.file_access.container_ends import MATLAB, PARQUET, Place, places_of
from usbldr.io.file_access.file_view import BLOCK_BYTES, FileView
from usbldr.io.file_access.open_file import opened
from usbldr.io.findings import Finding
from usbldr.io.formats.compressed_log import CopiedLog, Copies, written
from usbldr.io.limits import note_copy
from usbldr.io.reader import Reader
from usbldr.io.recordings.joined import JoinedLog, readable_parts


def concatenated_log(path: Path, open_copy: Callable[[Path], Reader]) -> Reader | None:
    """Return the log of a file of several recordings, None if it holds one alone; raise LogError if none is readable.

    ``open_copy`` opens a part.
    """
    with opened(path) as file:
        data = FileView(file.fileno())
        places = places_of(data)
        # of most containers the readers ignore the zeros behind them
        ends = len(places) == 1 and (places[0].end == len(data) or places[0].kind not in (PARQUET, MATLAB))
        if (ends and places[0].start == 0) or not any(place.kind for place in places):
            return None

    def copy(folder: Path) -> Copies:
        with opened(path) as file:
            return {_cut(FileView(file.fileno()), place, path, folder): path for place in places}, []

    return CopiedLog(path, "", copy, lambda copies: _joined(path, places, copies, open_copy))


def _cut(data: FileView, place: Place, path: Path, folder: Path) -> Path:
    (folder / str(place.start)).mkdir()
    copy = folder / str(place.start) / path.name
    note_copy(copy, path, (place.end - place.start) / len(data))
    with written(copy, path) as file:
        for at in range(place.start, place.end, BLOCK_BYTES):
            file.write(data[at : min(at + BLOCK_BYTES, place.end)])
    return copy


def _joined(
    path: Path, places: Sequence[Place], copies: Sequence[Path], open_copy: Callable[[Path], Reader]
) -> JoinedLog:
    """Join the recordings that can be read; raise LogError if none can."""
    kinds = dict(zip(copies, (place.kind for place in places), strict=True))

    def open_part(copy: Path) -> Reader:
        reader = open_copy(copy)
        if not kinds[copy] and not any(topic.count for topic in reader.topics()):
            raise LogError("no message was found", path=path)
        return reader

    names = [f"bytes {place.start} to {place.end}" for place in places]
    parts, unread = readable_parts(copies, open_part, names)
    if len(parts) > 1:
        text = f"the file holds {len(parts)} recordings, one behind the other: {', '.join(part.name for part in parts)}"
        unread.insert(0, Finding("CONCATENATED", text))
    return JoinedLog(path, parts, tuple(unread))
