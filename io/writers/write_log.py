"""Write a log with its configuration, in any format that can be read back, completely or not at all."""

import os
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Literal, TypeAlias, get_args

from usbldr.filters.errors import UsageError
from usbldr.io.log import COLUMNS, Log
from usbldr.io.settings.configuration import own_configuration
from usbldr.io.writing import has_ending, replacing

LogFormat: TypeAlias = Literal["mcap", "bag", "db3", "rosbag2", "csv"]
FORMS: Mapping[str, LogFormat] = {".mcap": "mcap", ".bag": "bag", ".db3": "db3"}  # files, by the end of their name
FOLDERS: tuple[LogFormat, ...] = ("csv", "rosbag2")
WRITTEN = ("usbldr.toml", "metadata.yaml", "truth.csv", *(f"{sensor}.csv" for sensor in COLUMNS))  # and *.db3
STAMPS = ("time", "received")  # the columns of times, without their unit
WRITTEN_BY = "Written by: usbldr"  # first words of the configuration of every written log


def log_format_of(out: Path, stated: str | None = None) -> LogFormat:
    """Return the stated format, else the one of the name.

    NAME.mcap, NAME.bag and NAME.db3 are files, NAME_db3 is a rosbag2 folder, a name without an ending a folder of CSV
    files. Raises UsageError for another ending.
    """
    for form in get_args(LogFormat):
        if stated == form:
            return form
    if has_ending(out) and out.suffix.lower() not in FORMS:
        raise UsageError(
            f"{out}: there is no format with the ending {out.suffix}: choose NAME.mcap, .bag, .db3, NAME_db3, or "
            "a name without an ending for a folder of CSV files"
        )
    return FORMS.get(out.suffix.lower(), "rosbag2" if out.name.endswith("_db3") else "csv")


def configuration_place(out: Path, form: LogFormat) -> Path:
    """Return the path of the configuration of a written log."""
    return own_configuration(out, form in FOLDERS)


def write_log_atomically(
    out: Path, form: LogFormat, configuration: str, make: Callable[[Path], None], force: bool
) -> Path:
    """Let ``make`` write the log to a path of the name of ``out``; return the path of its configuration.

    Raises UsageError if the path exists (and ``force`` is not set), or cannot be written.
    """
    folder, place = form in FOLDERS, configuration_place(out, form)
    for path in [out] if folder else [out, place]:
        if path.exists() and not force:
            raise UsageError(f"{path}: exists already; choose another name, or overwrite it with --force")
    if not folder and out.is_dir():
        raise UsageError(f"{out}: is a folder; give the file another name")
    if folder and out.exists():
        _refuse_unless_written(out)
    with replacing(out, "choose another --output") as made:
        make(made)
        text = made / "usbldr.toml" if folder else made.with_name("usbldr.toml")
        text.write_text(configuration, encoding="utf-8")
        if not folder:
            os.replace(text, place)
    return place


def write_records(log: Log, target: Path, form: LogFormat, remarks: Mapping[str, str], exported: bool) -> None:
    """Write a log's tables to ``target``; ``exported``: with messages that carry every canonical value."""
    if form == "csv":
        target.mkdir()
        _write_csv_files(log, target)
        return
    from usbldr.io.writers.recording_files import write_bag, write_mcap, write_rosbag2  # rosbags and mcap: 0.4 s
    from usbldr.io.writers.ros_messages import channels_of

    channels = channels_of(log, exported)
    if form == "mcap":
        write_mcap(log, target, remarks, channels)
    elif form == "bag":
        write_bag(log, target, channels)
    else:
        folder = target.with_suffix("") if form == "db3" else target
        write_rosbag2(log, folder, channels)
        if form == "db3":
            os.replace(folder / f"{folder.name}.db3", target)


def _write_csv_files(log: Log, folder: Path) -> None:
    """Write a file for each sensor: COLUMNS with time_ns and received_ns in place of seconds.

    Floats are written with as many digits as bring back the same float; an empty cell is unknown.
    """
    for sensor, table in log.tables.items():
        stamps = {f"{name}_ns": [log.start_ns + round(t * 1e9) for t in table[f"{name}_s"]] for name in STAMPS}
        table = table.rename(columns={f"{name}_s": f"{name}_ns" for name in STAMPS}).assign(**stamps)
        table.to_csv(folder / f"{sensor}.csv", index=False, lineterminator="\n")


def conventions_of(log: Log, form: LogFormat, exported: bool) -> dict[str, dict[str, str]]:
    """Return by section the keys of the configuration that state the messages' conventions."""
    if form == "csv":
        return {}
    from usbldr.io.writers.ros_messages import channels_of

    return {sensor: {"topic": one.topic, **one.conventions} for sensor, one in channels_of(log, exported).items()}


def _refuse_unless_written(folder: Path) -> None:
    if not folder.is_dir():
        raise UsageError(f"{folder}: is a file; name a file NAME.mcap, NAME.bag or NAME.db3, or another folder")
    held = sorted(file.name for file in folder.iterdir())
    foreign = [name for name in held if name not in WRITTEN and not name.endswith(".db3")]
    if foreign:
        raise UsageError(f"{folder}: holds {foreign[0]}, which usbldr did not write; choose another folder")
    if not held:
        return
    with suppress(OSError, UnicodeDecodeError):
        if (folder / "usbldr.toml").read_text(encoding="utf-8").startswith(f"# {WRITTEN_BY} "):
            return
    raise UsageError(f"{folder}: is not a log written by usbldr, so it is not replaced; choose another folder")
