"""The times at which something was taken: rows of a table, records of a topic, photos of a folder."""

from datetime import datetime
from pathlib import Path

import numpy as np
import pandas as pd

from usbldr.filters.errors import LogError, UsageError, listed
from usbldr.io.decoding.collected import read_whole
from usbldr.io.messages.configured import AT_1970, TIME_UNITS_NS
from usbldr.io.messages.roles import find_topic
from usbldr.io.reader import Nanoseconds
from usbldr.io.reading.opening import Request, open_configured

PHOTOS = (".jpg", ".jpeg", ".tif", ".tiff", ".png", ".webp")
DATES = ("time", "timestamp", "datetime", "date_time", "utc", "time_utc")
TAKEN, SUBSECOND, ZONE, EXIF = 36867, 37521, 36881, 34665  # fixed: tags of EXIF 2.32
NAME = "name"  # column of what was taken


def sample_times(place: str, log: Path, start_ns: int, clock: str) -> tuple[Nanoseconds, pd.DataFrame, list[str]]:
    """Return the times (n,) of a file NAME.csv, of a folder of photos, or of a topic of the run's log.

    With them come what the file holds besides, by the name of the photo, or by the number of the row from 1, and the
    photos without a time. ``clock`` is how many seconds the clock that stamped them is ahead, or PHOTO=TIME: what a
    photo of the folder shows. ``start_ns`` is where time_s of a table counts from.
    Raises LogError if there are no times, UsageError if nothing has that name, or if the clock cannot be read.
    """
    path, untimed = Path(place), list[str]()
    if path.is_dir():
        time_ns, columns, untimed = _photos(path)
    elif path.is_file():
        time_ns, columns = _table(path, start_ns)
        columns = columns.set_axis(range(1, len(columns) + 1))
    elif log.exists():
        time_ns = _topic(place, log)
        columns = pd.DataFrame(index=range(1, len(time_ns) + 1))
    else:
        raise UsageError(f"{place} is no file and no folder, and the log {log} with such a topic is gone (--log)")
    if not len(time_ns):
        raise LogError(f"{place} holds nothing with a time")
    return time_ns - _ahead_ns(clock, path), columns, untimed


def _ahead_ns(clock: str, folder: Path) -> int:
    photo, shows, shown = clock.rpartition("=")
    try:
        if not shows:
            return round(float(clock) * 1e9)
        shown_ns = pd.to_datetime(shown, utc=True, format="ISO8601").as_unit("ns").value
    except (ValueError, OverflowError) as err:
        raise UsageError(
            f"--clock {clock}: neither seconds nor PHOTO=TIME, with a time as 2026-01-31T12:00:00"
        ) from err
    taken_ns = _taken_ns(folder / photo)
    if taken_ns is None:
        raise UsageError(f"--clock: {folder / photo} is no photo with a time (EXIF DateTimeOriginal)")
    return taken_ns - shown_ns


def _table(path: Path, start_ns: int) -> tuple[Nanoseconds, pd.DataFrame]:
    """Read a CSV table with one column of times: time_ns and the like, time_s of a run's tables, or dates in UTC."""
    try:
        table = pd.read_csv(path)
    except (ValueError, OSError) as err:
        raise LogError(f"not a CSV table: {str(err).splitlines()[0]}", path=path) from err
    lower = {str(name).strip().lower(): str(name) for name in table.columns}
    units = {key: unit for key, unit in TIME_UNITS_NS.items() if key not in AT_1970}
    key = next((key for key in (*units, *DATES) if key in lower), None)
    if key is None:
        raise LogError(f"no column of times: name one {', '.join((*units, DATES[0]))}", path=path)
    column = table[lower[key]]
    if key in DATES:
        moments = pd.to_datetime(column, utc=True, errors="coerce", format="ISO8601")
        bad = moments.isna()
        time_ns = moments.dt.as_unit("ns").astype("int64").to_numpy()
    else:
        numbers = pd.to_numeric(column, errors="coerce")
        bad = numbers.isna()
        counted = (numbers.fillna(0) * units[key]).round().astype("int64")  # whole numbers stay exact
        time_ns = counted.to_numpy() + (start_ns if key == "time_s" else 0)
    if bad.any():
        row = int(np.argmax(bad.to_numpy()))
        raise LogError(f"row {row + 2}: {column.iloc[row]!r} is no time ({lower[key]})", path=path)
    return np.asarray(time_ns, dtype=np.int64), table.drop(columns=[lower[key]])


def _topic(name: str, log: Path) -> Nanoseconds:
    reader = open_configured(log, Request()).reader
    topic = find_topic(reader.topics(), name)
    if topic is None:
        listed = ", ".join(one.name for one in reader.topics()[:20])
        raise UsageError(f"{name} is no file, no folder and no topic of {log} (its topics: {listed})")
    stamp = "header.stamp"
    records = read_whole(reader, {topic.key: [stamp] if topic.has(stamp) else []})[topic.key]
    return records.columns.get(stamp, records.received_ns).astype(np.int64)


def _photos(folder: Path) -> tuple[Nanoseconds, pd.DataFrame, list[str]]:
    """Return when the photos of a folder were taken, by EXIF, and those that do not say it; UTC without a zone."""
    files = sorted(file for file in folder.iterdir() if file.suffix.lower() in PHOTOS)
    if not files:
        raise LogError(f"no photo in this folder ({', '.join(PHOTOS)})", path=folder)
    times = {file.name: _taken_ns(file) for file in files}
    timed = {name: time_ns for name, time_ns in times.items() if time_ns is not None}
    untimed = [name for name in times if name not in timed]
    if not timed:
        raise LogError(f"no time (EXIF DateTimeOriginal) in {listed(untimed, 1)}", path=folder)
    return np.array(list(timed.values()), dtype=np.int64), pd.DataFrame(index=list(timed)), untimed


def _taken_ns(file: Path) -> int | None:
    from PIL import Image  # comes with matplotlib

    try:
        with Image.open(file) as image:
            tags = image.getexif().get_ifd(EXIF)
        taken, zone = (str(text).strip("\0 ") for text in (tags[TAKEN], tags.get(ZONE, "")))
        moment = datetime.strptime(f"{taken} {zone or 'Z'}", "%Y:%m:%d %H:%M:%S %z")
        fraction = str(tags.get(SUBSECOND, "")).strip("\0 ")
    except (OSError, ValueError, KeyError, SyntaxError):
        return None
    nanoseconds = int(f"{fraction:0<9}"[:9]) if fraction.isdigit() else 0
    return int(moment.timestamp()) * 1_000_000_000 + nanoseconds
