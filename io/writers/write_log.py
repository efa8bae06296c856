"""Write a log with its configuration, in any format that can be read back, whole or not at all."""

import os
import shutil
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Literal, TypeAlias

from usbldr.filters.errors import UsageError
from usbldr.io.log import COLUMNS, Log
from usbldr.io.settings.configuration import own_configuration

LogFormat: TypeAlias = Literal["mcap", "bag", "db3", "rosbag2", "csv"]
FORMS: Mapping[str, LogFormat] = {".mcap": "mcap", ".bag": "bag", ".db3": "db3"}  # files, by the end of their name
OTHER_FORMATS = (".csv", ".json", ".txt", ".zip")  # a folder would not be called so
FOLDERS: tuple[LogFormat, ...] = ("csv", "rosbag2")
OURS = ("usbldr.toml", "metadata.yaml", "truth.csv", *(f"{sensor}.csv" for sensor in COLUMNS))  # in a folder; and *.db3
WRITTEN_BY = "Written by: usbldr"  # how the configuration of every log that we write begins


def log_format_of(out: Path, stated: str | None = None) -> LogFormat:
    """Return the form that the user states, else the one that the name means.

    NAME.mcap, NAME.bag and NAME.db3 are files, NAME_db3 is a rosbag2 folder, any other name a folder of CSV files.
    Raises UsageError for a name that means another format.
    """
    for form in ("mcap", "bag", "db3", "rosbag2", "csv"):
        if stated == form:
            return form
    if out.suffix.lower() in OTHER_FORMATS:
        raise UsageError(
            f"{out}: cannot write {out.suffix}; name a file NAME.mcap, NAME.bag or NAME.db3, or a folder for CSV files"
        )
    return FORMS.get(out.suffix.lower(), "rosbag2" if out.name.endswith("_db3") else "csv")


def configuration_place(out: Path, form: LogFormat) -> Path:
    """Return where the configuration of a written log stands."""
    return own_configuration(out, form in FOLDERS)


def write_log_atomically(
    out: Path, form: LogFormat, configuration: str, make: Callable[[Path], None], force: bool
) -> Path:
    """Let ``make`` write the log to a path of the name of ``out``; return where its configuration stands.

    Everything is made in a hidden sibling and then renamed, so that an interrupted run leaves nothing under the name.
    Raises UsageError where something is there already (and ``force`` is not set), or where nothing can be written.
    """
    folder, place = form in FOLDERS, configuration_place(out, form)
    for path in [out] if folder else [out, place]:
        if path.exists() and not force:
            raise UsageError(f"{path}: exists already; choose another name, or overwrite it with --force")
    if not folder and out.is_dir():
        raise UsageError(f"{out}: is a folder; give the file another name")
    if folder and out.exists():
        _refuse_foreign(out)
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        workshop = Path(tempfile.mkdtemp(dir=out.parent, prefix=f".{out.name}."))
    except OSError as err:
        raise UsageError(f"{out}: cannot be written ({err.strerror})") from err
    made, old = workshop / out.name, workshop / "old log"
    try:
        make(made)
        if folder:
            (made / "usbldr.toml").write_text(configuration, encoding="utf-8")
            if out.exists():
                os.replace(out, old)
        else:
            (workshop / "usbldr.toml").write_text(configuration, encoding="utf-8")
            os.replace(workshop / "usbldr.toml", place)
        os.replace(made, out)
    except OSError as err:
        raise UsageError(f"{out}: cannot be written ({err.strerror})") from err
    finally:
        if old.exists() and not out.exists():  # interrupted between the two renames
            os.replace(old, out)
        shutil.rmtree(workshop, ignore_errors=True)
    return place


def write_records(log: Log, target: Path, form: LogFormat, remarks: Mapping[str, str], exported: bool) -> None:
    """Write a log's tables to ``target``; ``exported``: with messages that carry every canonical value."""
    if form == "csv":
        from usbldr.io.writers.csv_writing import write_csv_folder

        target.mkdir()
        write_csv_folder(log, target)
        return
    from usbldr.io.writers.ros_messages import channels_of  # rosbags and mcap: 0.4 s

    channels = channels_of(log, exported)
    if form == "mcap":
        from usbldr.io.writers.mcap_writing import write_mcap

        write_mcap(log, target, remarks, channels)
    elif form == "bag":
        from usbldr.io.writers.bag_writing import write_bag

        write_bag(log, target, channels)
    else:
        from usbldr.io.writers.bag_writing import write_rosbag2

        folder = target.with_suffix("") if form == "db3" else target
        write_rosbag2(log, folder, channels)
        if form == "db3":
            os.replace(folder / f"{folder.name}.db3", target)


def conventions_of(log: Log, form: LogFormat, exported: bool) -> dict[str, dict[str, str]]:
    """Return by section what a configuration has to say of the messages' conventions."""
    if form == "csv":
        return {}
    from usbldr.io.writers.ros_messages import channels_of

    channels = channels_of(log, exported)
    return {sensor: dict(channel.conventions) for sensor, channel in channels.items() if sensor in log.tables}


def _refuse_foreign(folder: Path) -> None:
    """Even with --force a folder is only replaced if it is empty, or a log that we wrote and nothing else."""
    if not folder.is_dir():
        raise UsageError(f"{folder}: is a file; name a file NAME.mcap, NAME.bag or NAME.db3, or another folder")
    held = sorted(file.name for file in folder.iterdir())
    foreign = [name for name in held if name not in OURS and not name.endswith(".db3")]
    if foreign:
        raise UsageError(f"{folder}: holds {foreign[0]}, which is no part of a written log; choose another folder")
    if held and not _is_ours(folder):
        raise UsageError(f"{folder}: is no log that usbldr wrote, so it is not replaced; choose another folder")


def _is_ours(folder: Path) -> bool:
    """Tell whether the configuration in a folder says that we wrote it."""
    try:
        text = (folder / "usbldr.toml").read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError):
        return False
    return text.startswith(f"# {WRITTEN_BY} ")
