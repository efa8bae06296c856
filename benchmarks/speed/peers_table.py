"""The table of `make peers`: our filters beside those of other libraries."""

import sys
from pathlib import Path
from typing import NamedTuple

from usbldr.filters.kernel import KERNEL
from usbldr.io.reports.run_directory import write_atomically

BEGIN, END = "<!-- make peers: begin -->", "<!-- make peers: end -->"


class Row(NamedTuple):
    """A line of the table."""

    name: str
    particles: int
    ns: float  # per particle and step
    rmse_m: float  # horizontal


def compared(rows: list[Row]) -> list[dict[str, object]]:
    """Return each of ours beside its peer, with ratio and goal."""
    mine = {(row.name, row.particles): row for row in rows}
    peers = {row.name: row for row in rows}
    variant = KERNEL.name
    pairs = (
        ("cpf", 1000, "particles bootstrap", 5 if variant == "avx512" else 3),
        ("cpf", 1000, "particles guided", None),
        ("cpf", 1000, "Stone Soup KalmanProposal, CKF", 8000),
        ("cpf", 100, "Stone Soup KalmanProposal, CKF", None),
        *((name, 1, "filterpy ExtendedKalmanFilter", 15) for name in ("ekf", "ckf", "adf")),
    )
    found: list[dict[str, object]] = []
    for name, count, peer, goal in pairs:
        one, other = mine[name, count], peers[peer]
        found.append(
            {"filter": name, "particles": count, "ns": one.ns, "rmse_m": one.rmse_m, "peer": peer}
            | {"peer_particles": other.particles, "peer_ns": other.ns, "peer_rmse_m": other.rmse_m}
            | {"ratio": other.ns / one.ns, "goal": goal}
        )
    return found


def table(found: list[dict[str, object]], *, goals: bool) -> str:
    """Return the comparison as Markdown."""
    heads = ["ours", "ns", "rmse, m", "peer", "ns", "rmse, m", "times as fast", *(["goal"] if goals else [])]
    lines = [heads, ["---"] * len(heads)]
    for row in found:
        ratio = float(str(row["ratio"]))
        cells = [f"`{row['filter']}`{_counted(row['particles'])}", f"{row['ns']:,.0f}", f"{row['rmse_m']:.2f}"]
        cells += [f"{row['peer']}{_counted(row['peer_particles'])}", f"{row['peer_ns']:,.0f}"]
        cells += [f"{row['peer_rmse_m']:.2f}", f"{ratio:,.{0 if ratio > 100 else 1}f}"]
        lines.append([*cells, str(row["goal"] or "")] if goals else cells)
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _counted(particles: object) -> str:
    return "" if particles == 1 else f", {particles} particles"


def write(file: Path, text: str, markers: tuple[str, str] = (BEGIN, END)) -> None:
    """Replace what stands between the markers of a page."""
    before, begin, rest = file.read_text(encoding="utf-8").partition(markers[0])
    _, end, after = rest.partition(markers[1])
    if not (begin and end):
        sys.exit(f"{file} has no markers {markers[0]} and {markers[1]}")
    write_atomically(file, f"{before}{begin}\n\n{text}\n\n{end}{after}".encode())


def processor() -> str:
    """Return the name of the processor, if the system tells."""
    reported = Path("/proc/cpuinfo")
    lines = reported.read_text(encoding="utf-8").splitlines() if reported.exists() else []
    return next(
        (line.partition(":")[2].strip() for line in lines if line.startswith("model name")), "unknown processor"
    )
