"""Write a log as our CSV folder: one file per sensor, COLUMNS with time_ns and received_ns in place of seconds.

Floats are written with as many digits as bring back the same float; an empty cell is unknown.
"""

from pathlib import Path

from usbldr.io.log import Log


def write_csv_folder(log: Log, folder: Path) -> None:
    """Write each table of the log into an existing folder."""
    for sensor, table in log.tables.items():
        canonical = table.copy(deep=False)
        for place, (seconds, nanoseconds) in enumerate((("time_s", "time_ns"), ("received_s", "received_ns"))):
            stamps = [log.start_ns + round(t * 1e9) for t in table[seconds]]
            canonical = canonical.drop(columns=seconds)
            canonical.insert(place, nanoseconds, stamps)
        canonical.to_csv(folder / f"{sensor}.csv", index=False, lineterminator="\n")
