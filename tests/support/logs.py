"""Recordings written by hand and read back at once, with usbldr.toml beside them."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from recordings import Row, saved, saved_lines, write_csv, write_mcap
from usbldr.io.decoding.collected import read_whole
from usbldr.io.findings import Finding
from usbldr.io.log import Log
from usbldr.io.reader import Reader
from usbldr.io.reading.opening import DEFAULT_REQUEST
from usbldr.io.reading.read import Request, read_log

HEAD = "[usbl]\nhead = { east_m = 100.0, north_m = 200.0 }\n"
METRES_A_DEGREE = 111132.95  # of latitude at 45 degrees


def on_map(lat_deg: float, lon_deg: float) -> str:
    return f"[map]\norigin_lat_deg = {lat_deg}\norigin_lon_deg = {lon_deg}\n"


MAP = on_map(45.0, 7.0)


def read_as(log: Path, toml: str, request: Request = DEFAULT_REQUEST) -> Log:
    """Read a log by its usbldr.toml, which is in its folder, if it is one, or beside it."""
    saved((log if log.is_dir() else log.parent) / "usbldr.toml", toml)
    return read_log(log, request)


def logged(folder: Path, rows: Iterable[Row], toml: str = "", topics: Mapping[str, str] | None = None) -> Log:
    """Read the rows from dive.mcap; topics: role -> topic."""
    return read_as(write_mcap(folder / "dive.mcap", rows), toml, Request(topics=topics or {}))


def logged_csv(folder: Path, toml: str, **files: str) -> Log:
    """Read the texts from a folder of CSV files."""
    return read_as(write_csv(folder / "dive", **files), toml)


def logged_nmea(folder: Path, *lines: str, toml: str = "", **topics: str) -> Log:
    """Read the lines from ship.nmea."""
    return read_as(saved_lines(folder / "ship.nmea", lines), toml, Request(topics=topics))


def refusal(kind: type[Exception], call: Callable[..., object], *arguments: Any, **named: Any) -> str:
    with pytest.raises(kind) as refused:
        call(*arguments, **named)
    return str(refused.value)


def texts(log: Log, code: str) -> list[str]:
    return [finding.text for finding in log.findings if finding.code == code]


def only(log: Log, code: str) -> str:
    (text,) = texts(log, code)
    return text


def counts(log: Reader) -> dict[str, int]:
    """Return topic -> number of its messages."""
    return {topic.name: topic.count for topic in log.topics()}


def with_table(log: Log, role: str, table: pd.DataFrame) -> Log:
    return replace(log, tables={**log.tables, role: table})


def lost(log: Log) -> list[str]:
    return [finding.text for finding in log.findings if finding.lost_data]


def losses(findings: Iterable[Finding]) -> dict[str, bool]:
    """Return text -> whether data were lost."""
    return {finding.text: finding.lost_data for finding in findings}


def codes(log: Log) -> dict[str, str]:
    """Return code -> text of the findings."""
    return {finding.code: finding.text for finding in log.findings}


def columns(log: Log, names: Iterable[str]) -> dict[str, list[Any]]:
    """Return name -> values of columns that are named by their sensor, too, as compass.heading_deg is."""
    return {name: log.tables[sensor][column].tolist() for name in names for sensor, column in [name.split(".")]}


def places(log: Log) -> np.ndarray:
    """Return east and north of the USBL fixes, (K, 2)."""
    return log.tables["usbl"][["east_m", "north_m"]].to_numpy(dtype=float)


def covariance(log: Log) -> np.ndarray:
    """Return the covariance of the first USBL fix, (2, 2)."""
    columns = ["cov_ee_m2", "cov_en_m2", "cov_en_m2", "cov_nn_m2"]
    return log.tables["usbl"][columns].to_numpy(dtype=float)[0].reshape(2, 2)


TWIST_X = {"/dvl": ["header.stamp", "twist.linear.x"]}


def x_of(log: Reader) -> list[float]:
    """Return the x of the twists on /dvl."""
    return read_whole(log, TWIST_X)["/dvl"].columns["twist.linear.x"].tolist()
