"""Write a simulated log and its configuration, whole or not at all."""

import os
import shutil
import tempfile
from pathlib import Path

from usbldr.filters.errors import UsageError
from usbldr.filters.simulation import Scenario
from usbldr.io.log import Log
from usbldr.io.scenario import configuration_text, simulated_log

OTHER_FORMATS = (".bag", ".csv", ".db3", ".json", ".txt", ".zip")  # a folder would not be called so


def write_scenario(scenario: Scenario, seed: int, out: Path, force: bool = False) -> tuple[Log, Path]:
    """Write to ``out`` (NAME.mcap, else a CSV folder) with a usbldr.toml; return the log and the configuration's path.

    Everything is made in a hidden sibling and then renamed, so that an interrupted run leaves nothing under the name.
    Raises UsageError where something is there already (and ``force`` is not set), or where nothing can be written.
    """
    as_mcap = out.suffix.lower() == ".mcap"
    if out.suffix.lower() in OTHER_FORMATS:
        raise UsageError(f"{out}: cannot write {out.suffix}; name a file NAME.mcap, or a folder for CSV files")
    configuration = out.with_name(f"{out.stem}.usbldr.toml") if as_mcap else out / "usbldr.toml"
    _refuse_to_overwrite([out, configuration] if as_mcap else [out], force)
    if as_mcap and out.is_dir():
        raise UsageError(f"{out}: is a folder; give the MCAP file another name")
    if not as_mcap and out.exists():
        _refuse_foreign(out)
    log = simulated_log(scenario, seed)
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        workshop = Path(tempfile.mkdtemp(dir=out.parent, prefix=f".{out.name}."))
    except OSError as err:
        raise UsageError(f"{out}: cannot be written ({err.strerror})") from err
    try:
        if as_mcap:
            _make_mcap(log, scenario, seed, workshop)
            os.replace(workshop / "usbldr.toml", configuration)
            os.replace(workshop / "log.mcap", out)
        else:
            _make_folder(log, scenario, seed, workshop / "new")
            if out.exists():
                os.replace(out, workshop / "old")
            os.replace(workshop / "new", out)
    except OSError as err:
        raise UsageError(f"{out}: cannot be written ({err.strerror})") from err
    finally:
        if (workshop / "old").exists() and not out.exists():  # interrupted between the two renames
            os.replace(workshop / "old", out)
        shutil.rmtree(workshop, ignore_errors=True)
    return log, configuration


def _make_mcap(log: Log, scenario: Scenario, seed: int, workshop: Path) -> None:
    from usbldr.io.mcap_writing import CHANNELS, write_mcap  # rosbags and mcap: 0.4 s

    conventions = {sensor: channel.conventions for sensor, channel in CHANNELS.items()}
    (workshop / "usbldr.toml").write_text(configuration_text(scenario, seed, conventions), encoding="utf-8")
    write_mcap(log, workshop / "log.mcap", {"scenario": scenario.name, "seed": str(seed)})


def _make_folder(log: Log, scenario: Scenario, seed: int, folder: Path) -> None:
    from usbldr.io.csv_writing import write_csv_folder

    folder.mkdir()
    (folder / "usbldr.toml").write_text(configuration_text(scenario, seed, {}), encoding="utf-8")
    write_csv_folder(log, folder)


def _refuse_to_overwrite(paths: list[Path], force: bool) -> None:
    for path in paths:
        if path.exists() and not force:
            raise UsageError(f"{path}: exists already; choose another name, or overwrite it with --force")


def _refuse_foreign(folder: Path) -> None:
    """Even with --force a folder is only replaced if it holds nothing but what we write."""
    if not folder.is_dir():
        raise UsageError(f"{folder}: is a file; name a file NAME.mcap, or a folder for CSV files")
    foreign = [f.name for f in sorted(folder.iterdir()) if f.suffix != ".csv" and f.name != "usbldr.toml"]
    if foreign:
        raise UsageError(f"{folder}: holds {foreign[0]}, which is no part of a simulated log; choose another folder")
