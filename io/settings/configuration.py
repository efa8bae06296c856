"""usbldr.toml: found beside the log, read, checked key by key, and converted to the assumptions of a run.

The sections are in sensor_sections.py.
"""

import copy
import itertools
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

from usbldr.filters.errors import UsageError
from usbldr.filters.models.parameters import UNKNOWN_START, Parameters
from usbldr.io.settings.noise_sections import calibrated_keys, noise_family_of, stated_model
from usbldr.io.settings.sensor_sections import Configuration
from usbldr.io.settings.toml_text import inline
from usbldr.io.settings.validation import checked


def find_configuration(log: Path, named: str | None) -> Path | None:
    """Return the file to read for ``log``: the named one, else NAME.usbldr.toml, else usbldr.toml, else none.

    ``named`` = "none" ignores all of them.
    """
    if named == "none":
        return None
    if named is not None:
        if not Path(named).is_file():
            raise UsageError(f"{named}: no such configuration file")
        return Path(named)
    return next((place for place in configuration_places(log, log.is_dir()) if place.is_file()), None)


def configuration_places(log: Path, folder: bool) -> tuple[Path, ...]:
    """Return where the configuration of a log is looked for, its own place first."""
    own = [log / "usbldr.toml"] if folder else []
    return (*own, log.parent / f"{log.name if folder else log.stem}.usbldr.toml", log.parent / "usbldr.toml")


def own_configuration(log: Path, folder: bool) -> Path:
    """Return the path of a log's own configuration: inside a folder, beside a file."""
    return configuration_places(log, folder)[0]


def parse_configuration(document: dict[str, object], file: object) -> Configuration:
    """Return a TOML document as checked settings; raise UsageError with file, key, nearest match and allowed values."""
    return checked(document, Configuration, file)


def parameters(configuration: Configuration) -> Parameters:
    """Return the model side of a run: the stated values, usbldr's defaults for the rest. Angles become radians."""
    start, default = configuration.start, Parameters()
    return replace(
        default,
        process=stated_model(default.process, configuration.process),
        dvl=noise_family_of(configuration.dvl.noise, default.dvl, "dvl"),
        compass=noise_family_of(configuration.compass.noise, default.compass, "compass"),
        usbl=noise_family_of(configuration.usbl.noise, default.usbl, "usbl"),
        gps=noise_family_of(configuration.gps.noise, default.gps, "gps"),
        dvl_lever_m=configuration.dvl.lever_arm_m,
        water_track=configuration.dvl.track == "water",
        usbl_lever_m=configuration.usbl.lever_arm_m,
        gps_lever_m=configuration.gps.lever_arm_m,
        start=stated_model(UNKNOWN_START, start) if start else None,
        calibrate=calibrated_keys(configuration.calibrate),
        errors=stated_model(default.errors, configuration.calibrate),
        dvl_sd_scale=configuration.dvl.sd_scale,
        compass_sd_scale=configuration.compass.sd_scale,
        usbl_sd_scale=configuration.usbl.sd_scale,
    )


def with_set_keys(content: Mapping[str, object], texts: Sequence[str]) -> dict[str, object]:
    """Return the content of a configuration with the keys that --set states; raise UsageError if one has no place."""
    found = copy.deepcopy(dict(content))
    for text in texts:
        key, (value, *others) = _read(text)
        if others:
            raise UsageError(f"--set {text}: several values are for usbldr compare; a list is written [1, 2]")
        path = key.split(".")
        table = found
        for section in path[:-1]:
            inner = table.setdefault(section, {})
            if not isinstance(inner, dict):
                raise UsageError(f"--set {text}: {section} is no section that has keys")
            table = cast("dict[str, object]", inner)
        table[path[-1]] = value
    return found


def sweep(texts: Sequence[str]) -> list[tuple[str, ...]]:
    """Return the KEY=VALUE of each run: every combination of the values; one empty combination without --set."""
    stated = map(_read, texts)
    return list(itertools.product(*([f"{key}={inline(value)}" for value in values] for key, values in stated)))


def _read(text: str) -> tuple[str, list[object]]:
    """Return KEY=A,B as a key and values, as TOML has them; raise UsageError if it is none."""
    key, equals, values = (part.strip() for part in text.partition("="))
    if not (key and equals and values):
        raise UsageError(f"--set {text}: write SECTION.KEY=VALUE with a key of usbldr.toml, such as usbl.sd_m=2")
    whole: list[object] | None = _toml(f"[{values}]")
    return key, [_value(v) for v in values.split(",")] if whole is None else whole


def _value(text: str) -> object:
    """Return a value of TOML, or else the text: words need no quotes."""
    found = _toml(text)
    return text.strip() if found is None else found


def _toml(text: str) -> Any:
    try:
        document = tomllib.loads(f"value = {text}")
    except (tomllib.TOMLDecodeError, RecursionError):
        return None
    return document["value"] if len(document) == 1 else None
