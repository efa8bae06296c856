"""A dive beside a ship as CSV files: the head of its USBL is turned, tilted, and measures ranges by a wrong speed."""

from pathlib import Path

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

T0 = 1_767_225_600_000_000_000
LAT_DEG, LON_DEG = 45.0, -30.0
M_PER_DEG = 111_131.78  # of latitude at 45 degrees, on WGS-84
MAP = f"schema = 1\n[map]\norigin_lat_deg = {LAT_DEG}\norigin_lon_deg = {LON_DEG}\n"
HEAD = 'head = { topic = "ship_gps", heading_topic = "gyro", depth_m = 5.0 }\n'


def write_dive(
    folder: Path, seed: int, *, ship: bool = True, seconds: int = 900, vertical: bool = True, **head
) -> Path:
    """Write a dive at 40 to 80 m with a fix every 3 s.

    ``head`` has heading_deg, pitch_deg, roll_deg and scale (true over measured).
    """
    rng = np.random.default_rng(seed)
    t = np.arange(5 * seconds + 1) / 5
    heading = np.degrees(0.6 + np.pi / 2 * np.sin(t / 23.0))
    mps = np.column_stack([0.1 * np.cos(t / 11), 1.0 + 0.1 * np.sin(t / 7)])  # starboard, forward
    c, s = np.cos(np.radians(heading)), np.sin(np.radians(heading))
    east_north = np.column_stack([s * mps[:, 1] + c * mps[:, 0], c * mps[:, 1] - s * mps[:, 0]])
    place = np.vstack([np.zeros(2), np.cumsum((east_north[1:] + east_north[:-1]) / 10, axis=0)])
    depth = 60 + 20 * np.sin(t / 60)
    seen = np.arange(5, len(t), 15)
    angle = t / 30.0 if ship else 0 * t
    about = np.outer(t / t[-1], place[-1]) if ship else np.zeros((len(t), 2)) + place[-1] / 2
    ship_at = about + 80 * np.column_stack([np.sin(angle), np.cos(angle)])
    gyro = (np.degrees(angle) * 1.7 + 40) % 360 if ship else np.full(len(t), 40.0)
    north_east_down = np.column_stack([(place - ship_at)[:, ::-1], depth - 5.0])[seen]
    mount = Rotation.from_euler(
        "ZYX", [head.get(k, 0.0) for k in ("heading_deg", "pitch_deg", "roll_deg")], degrees=True
    )
    along = (Rotation.from_euler("Z", gyro[seen, None], degrees=True) * mount).inv().apply(north_east_down)
    slant = np.linalg.norm(along, axis=1) / head.get("scale", 1.0)
    bearing = np.degrees(np.arctan2(along[:, 1], along[:, 0])) + rng.normal(0, 0.3, len(seen))
    down = np.degrees(np.arcsin(along[:, 2] / np.linalg.norm(along, axis=1))) + rng.normal(0, 0.3, len(seen))
    time_ns = T0 + np.round(t * 1e9).astype(np.int64)
    noise = rng.normal(size=(5, len(t)))
    files = {
        "dvl": {"forward_mps": mps[:, 1] + 0.02 * noise[0], "starboard_mps": mps[:, 0] + 0.02 * noise[1]},
        "compass": {"heading_deg": (heading + 0.3 * noise[2]) % 360},
        "depth": {"depth_m": depth + 0.05 * noise[3]},
        "ship_gps": {
            "lat_deg": LAT_DEG + ship_at[:, 1] / M_PER_DEG,
            "lon_deg": LON_DEG + ship_at[:, 0] / (M_PER_DEG * 0.70891),
        },
        "gyro": {"heading_deg": gyro},
    }
    folder.mkdir()
    for name, columns in files.items():
        pd.DataFrame({"time_ns": time_ns, **columns}).to_csv(folder / f"{name}.csv", index=False)
    fixes = {"slant_range_m": slant + rng.normal(0, 0.2, len(seen)), "bearing_deg": bearing % 360}
    if vertical:
        fixes["elevation_deg"] = down
    pd.DataFrame({"time_ns": time_ns[seen], **fixes}).to_csv(folder / "usbl.csv", index=False)
    (folder / "usbldr.toml").write_text(f'{MAP}[usbl]\nframe = "body"\n{HEAD}[compass]\ntopic = "compass"\n')
    return folder
