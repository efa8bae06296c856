"""Our own measurements on the field logs, by the names that the collectors' expected.json gives to theirs.

Errors are horizontal distances in metres; angles are degrees clockwise, added to the heading. Dead reckoning is taken
as the collectors took it (each DVL record holds until the next) and, in brackets, as usbldr takes it. What is fitted to
a truth here is an evaluation: no filter ever sees it.
"""

import math
import tomllib
from pathlib import Path

import numpy as np

from field.logs import CASES, HERE
from survey.errors import (
    Measured,
    anchored,
    at,
    clockwise_deg,
    euler,
    fitted,
    fix_offsets,
    fix_statistics,
    path_m,
    prefixed,
    read_as,
    reckoned,
    statistics,
    truth_of,
    turn_deg,
)
from survey.expected import OURS
from usbldr.io.formats.mcap_log import McapLog
from usbldr.io.geodesy import Origin, to_geodetic, to_plane
from usbldr.io.log import Log
from usbldr.io.read import Request, read_log
from usbldr.io.timeline import timeline

UIB = '[dvl]\naxes = "FLU"\n[compass]\nconvention = "NED"\n[gps]\ntopic = "none"\n'
TRUTHS = {"uib_field": '"/slam/graph_vertices"\nskip_rows = 2', "uib_simulation": '"/ground_truth"'}
COMPASS_LATE_S = {"mhkit_riverpro": 0.31, "tanana_002": 0.18, "tanana_003": 0.18}  # the ensemble's end to its middle
STOPS_S = 2.0  # "a velocity is used for at most 2 s"


def measured(folder: Path, name: str, errors: bool = True) -> Measured:
    """Measure on a log what its expected.json holds; without its errors against GPS if it is held back."""
    case = CASES[name]
    path = folder / case.folder / f"{name}.mcap"
    found = topics(path)
    if case.folder.startswith("uib"):
        return found | uib(path, name)
    if name == "stpere_marina":
        return found | stpere(path)
    return found | river(path, name, errors)


def topics(path: Path) -> Measured:
    """Count what is in a file."""
    log, found = McapLog(path), {}
    for topic in log.topics():
        stamped = "header.stamp" in topic.fields
        read = log.read({topic.name: ["header.stamp", "header.frame_id"] if stamped else topic.fields[:1]})[topic.name]
        numbers: Measured = {
            "type": topic.type,
            "count": len(read.received_ns),
            "log_first_ns": int(read.received_ns[0]),
            "log_last_ns": int(read.received_ns[-1]),
            "span_s": topic.span_s,
            "rate_hz": topic.rate_hz,
            "longest_gap_s": float(np.max(np.diff(read.received_ns))) / 1e9,
        }
        if stamped:
            stamps = read.columns["header.stamp"]
            lag_s = (read.received_ns - stamps) / 1e9
            numbers["frame_id"] = str(read.columns["header.frame_id"][0])
            numbers["repeated_stamps"] = len(stamps) - len(np.unique(stamps))
            numbers |= {f"log_minus_stamp_s.{n}": float(getattr(np, n)(lag_s)) for n in ("min", "median", "max")}
        found |= prefixed(topic.name, numbers)
    return found


def uib(path: Path, name: str) -> Measured:
    """Measure on the survey of Turbot and on its simulated twin."""
    plain = f'{UIB}[usbl]\ntopic = "none"\n[truth]\ntopic = {TRUTHS[name]}\nframe = "NED"\n'
    log, in_file = read_as(path, plain), McapLog(path).topics()
    truth, dvl = truth_of(log), log.tables["dvl"]
    first_ns = min(topic.first_ns or 0 for topic in in_file if topic.count)
    counts = {topic.name: topic.count for topic in in_file}
    rows = counts[TRUTHS[name].split('"')[1]]
    skipped = 2 if name == "uib_field" else 0
    shared = rows - skipped - len(truth.time_s)  # rows of a stamp that another has: one here
    begins_s = (log.start_ns - first_ns) / 1e9
    found: Measured = map_origin(path) | {
        "dvl.unique_stamps": len(dvl),
        "dvl.repeated": counts["/dvl"] - len(dvl),
        "dvl.path_m": path_m(euler(log)[1]),
        "truth.rows": rows,
        "truth.rows_used": len(truth.time_s) + shared,
        "truth.first_s": float(truth.time_s[0]) + begins_s,
        "truth.last_s": float(truth.time_s[-1]) + begins_s,
        "truth.path_m": path_m(truth.position_m),
    }
    for topic in ("modem_delayed_acoustic", "modem_raw"):
        stated = plain.replace('[usbl]\ntopic = "none"', f'[usbl]\ntopic = "/{topic}"\nframe = "NED"')
        found |= prefixed(f"usbl_error_{topic}", fix_statistics(fix_offsets(read_as(path, stated))))
    fit = "dead_reckoning_fitted"
    found |= fits(fit, log, "mount_yaw_deg", shared)
    errors, alignment = fitted(truth, reckoned(timeline(read_as(path, plain.replace("FLU", "FRD")))))
    other = float(np.sqrt(np.mean(errors**2)))
    found[f"{fit}.other_y_sign.rms_m"], found[f"{fit}.other_y_sign.mount_yaw_deg"] = other, clockwise_deg(alignment)
    found[f"{fit}.y_sign"] = -1 if float(found[f"{fit}.rms_m"]) < other else 1  # FLU is y to port
    found |= anchor("dead_reckoning_anchored", log, {"uib_field": 135.0, "uib_simulation": 131}[name], "mount_yaw_deg")
    found |= {"dead_reckoning_anchored.n": len(errors) + shared, "dead_reckoning_anchored.y_sign": -1}
    if name == "uib_field":
        found |= modem_ranges(path) | gps_minus_truth(path, plain)
    return found


def stpere(path: Path) -> Measured:
    """Measure on the survey of the marina."""
    none = '[usbl]\ntopic = "none"\n'
    log = read_as(path, f'[compass]\ntopic = "/imu/data"\n{none}')
    gps, depth = log.tables["gps"], log.tables["depth"]["depth_m"]
    valid_s, moved = euler(log)
    assert log.origin is not None
    found: Measured = {
        "origin_lat_deg": log.origin.lat_deg,
        "origin_lon_deg": log.origin.lon_deg,
        "dvl_bottom_lock.good": len(valid_s),
        "dvl_bottom_lock.all": len(log.tables["dvl"]),
        "dvl_path_length_m": path_m(moved),
        "gps_box_m.east": float(np.ptp(gps["east_m"])),
        "gps_box_m.north": float(np.ptp(gps["north_m"])),
        "depth_m.min": float(depth.min()),
        "depth_m.max": float(depth.max()),
    }
    own = read_as(path, f'[compass]\ntopic = "/dvl/compass_heading"\n{none}')
    found |= fits("dead_reckoning_mti_fitted", log, "heading_offset_deg")
    found |= fits("dead_reckoning_dvl_compass_fitted", own, "heading_offset_deg")
    for key, offset_deg in (("nominal", -26.0), ("fitted", -19.95)):
        found |= anchor(f"dead_reckoning_mti_anchored_{key}", log, offset_deg, "heading_offset_deg")
    return found | synthetic_usbl(path, path.parent / "csv" / "usbl_synthetic_key.csv")


def river(path: Path, name: str, errors: bool) -> Measured:
    """Measure on a transect of the river."""
    log = read_as(path, f"[compass]\nlatency_s = {COMPASS_LATE_S[name]}\n")
    dvl, gps = log.tables["dvl"], log.tables["gps"][["east_m", "north_m"]].to_numpy()
    locked = dvl[dvl["valid"]]["time_s"].to_numpy()
    assert log.origin is not None
    found: Measured = {
        "ensembles": len(dvl),
        "bottom_lock_pct": 100 * float(dvl["valid"].mean()),
        "longest_loss_s": float(np.max(np.diff(locked))),
        "gps_path_m_5hz": path_m(gps),
        "origin_lat_deg": log.origin.lat_deg,
        "origin_lon_deg": log.origin.lon_deg,
    }
    usbl = synthetic_usbl(path, path.parent / "csv" / f"{name}_usbl_synthetic_key.csv")
    if not errors:
        return found | {key: value for key, value in usbl.items() if "error" not in key}
    for key, longest_s in (("hold", math.inf), ("stop_after_2_s", STOPS_S)):
        offset_deg = turn_deg(truth_of(log), euler(log, longest_s))
        found |= anchor(f"dead_reckoning_{key}", log, offset_deg, "heading_offset_deg", longest_s)
    return found | usbl


def synthetic_usbl(path: Path, key: Path) -> Measured:
    """Measure the fixes that the collectors put in; their key says which are gross."""
    stated = HERE / f"{path.stem}.toml"
    log = read_log(path, Request(configuration=str(stated)))
    usbl = log.tables["usbl"]
    rows = np.genfromtxt(key, delimiter=",", skip_header=1, dtype=None, encoding="utf-8")
    gross = np.asarray([int(row[0]) for row in rows if row[4]])
    stamps = np.asarray([log.start_ns + round(t * 1e9) for t in usbl["time_s"]])
    good = np.min(np.abs(stamps[:, None] - gross), axis=1) > 1000
    found: Measured = {"fixes": len(usbl), "gross_outliers": int(np.sum(~good))}
    found |= prefixed("error_all", fix_statistics(fix_offsets(log)))
    found |= prefixed("error_without_gross", fix_statistics(fix_offsets(log, good)))
    return prefixed("usbl_synthetic", found | head(log, stated))


def head(log: Log, stated: Path) -> Measured:
    """Return where the configuration puts the head and how far away the vehicle was, at depth 0 if no log states it."""
    place: dict[str, float] = tomllib.loads(stated.read_text(encoding="utf-8"))["usbl"]["head"]
    assert log.origin is not None
    east_m, north_m = to_plane(log.origin, np.array([place["lat_deg"]]), np.array([place["lon_deg"]]))
    level_m = np.hypot(*(truth_of(log).position_m - [east_m[0], north_m[0]]).T)
    depth_m = float(log.tables["depth"]["depth_m"].median()) if "depth" in log.tables else 0.0
    slant_m = np.hypot(level_m, place["depth_m"] - depth_m)
    return {
        **{f"head_{key}": value for key, value in place.items()},
        "slant_m.min": float(np.min(slant_m)),
        "slant_m.max": float(np.max(slant_m)),
    }


def fits(key: str, log: Log, angle: str, shared: int = 0) -> Measured:
    """Fit dead reckoning to the truth, by the collectors' way and, of what has a tolerance, by usbldr's own."""
    found: Measured = {}
    for way, track in (("", euler(log)), (OURS, reckoned(timeline(log)))):
        errors, alignment = fitted(truth_of(log), track)
        numbers = statistics(errors) | {"n": len(errors) + shared, angle: clockwise_deg(alignment)}
        kept = {name: value for name, value in numbers.items() if not way or name.endswith(("rms_m", "max_m", "_deg"))}
        found |= prefixed(key, kept, way)
    return found


def anchor(key: str, log: Log, clockwise_deg: float, angle: str, longest_s: float = math.inf) -> Measured:
    """Start dead reckoning on the first row of the truth, turned by a given angle."""
    errors = anchored(truth_of(log), euler(log, longest_s), clockwise_deg)
    return prefixed(key, statistics(errors) | {angle: clockwise_deg})


def map_origin(path: Path) -> Measured:
    """Find where the map begins by stamps that /gps_raw (latitude) and /gps (map, NED) share."""
    records = McapLog(path).read(
        {
            "/gps_raw": ["header.stamp", "latitude", "longitude"],
            "/gps": ["header.stamp", "pose.pose.position.x", "pose.pose.position.y"],
        }
    )
    raw, local = records["/gps_raw"].columns, records["/gps"].columns
    row_of = {int(stamp): row for row, stamp in enumerate(raw["header.stamp"])}
    pairs = [(row_of[int(s)], k) for k, s in enumerate(local["header.stamp"]) if int(s) in row_of]
    rows, others = (np.asarray(column) for column in zip(*pairs, strict=True))
    lat, lon = raw["latitude"][rows], raw["longitude"][rows]
    north, east = (local[f"pose.pose.position.{axis}"][others] for axis in "xy")
    origin = Origin(float(lat[0]), float(lon[0]), "first pair")
    for _ in range(3):  # the plane that touches the origin is known only with it
        at_east, at_north = to_plane(origin, lat, lon)
        off = np.array([[np.median(at_east - east)], [np.median(at_north - north)]])
        found_lat, found_lon = to_geodetic(origin, off[0], off[1])
        origin = Origin(float(found_lat[0]), float(found_lon[0]), "pairs")
    at_east, at_north = to_plane(origin, lat, lon)
    spread_m = float(np.max(np.hypot(at_east - east, at_north - north)))
    numbers: Measured = {
        "lat_deg": origin.lat_deg,
        "lon_deg": origin.lon_deg,
        "pairs": len(pairs),
        "spread_m": spread_m,
    }
    return prefixed("map_origin", numbers)


def modem_ranges(path: Path) -> Measured:
    """Return the least and the greatest distance that the modem reports."""
    columns = McapLog(path).read({"/usbllong": ["n", "e", "u"]})["/usbllong"].columns
    length = np.sqrt(sum(columns[axis].astype(float) ** 2 for axis in "neu"))
    return prefixed("usbllong_range_m", {"min": float(length.min()), "max": float(length.max())})


def gps_minus_truth(path: Path, plain: str) -> Measured:
    """Compare the fixes on the surface, before and after the dive, with the truth."""
    origin = map_origin(path)
    stated = plain.replace('[gps]\ntopic = "none"', '[gps]\ntopic = "/gps_raw"')
    where = (
        f"[map]\norigin_lat_deg = {origin['map_origin.lat_deg']!r}\norigin_lon_deg = {origin['map_origin.lon_deg']!r}\n"
    )
    log = read_as(path, where + stated)
    gps, truth = log.tables["gps"], truth_of(log)
    t = gps["time_s"].to_numpy()
    off_m = gps[["east_m", "north_m"]].to_numpy() - at(truth, t)
    found: Measured = {}
    for when, rows in (("start", t < t[-1] / 2), ("end", t > t[-1] / 2)):
        east_m, north_m = np.median(off_m[rows], axis=0)
        numbers: Measured = {"n": int(np.sum(rows)), "median_east_m": float(east_m), "median_north_m": float(north_m)}
        found |= prefixed(f"gps_minus_truth_{when}", numbers)
    return found
