"""Make docs/studies/faults.md: errors of the fixes, the start and the clocks on a dive that no shipped scenario has.

    python benchmarks/drills/goals.py --seeds 16

Each seed is a dive of its own (dive.toml, read without a configuration). Finished runs are kept in a file and used
again, so an interrupted study goes on where it was. Times are scored over the whole dive, the faults included.
"""

import argparse
import json
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

import usbldr
from usbldr.filters.types import Array, Vector
from usbldr.io.drills.drill import Drill, damaged
from usbldr.io.drills.fault_text import fault_of
from usbldr.io.log import Log
from usbldr.io.reports.run_directory import write_atomically

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
FIRST_SEED = 4100  # no other study uses these dives
ELSEWHERE_M = np.array([-300.0, 200.0])  # where positions lie that were written before the first reply
Damage = Callable[[Log, int], Log]
Row = dict[str, Any]

WAYS = {
    "default": ("cpf", usbldr.RunSettings()),
    "arrival": ("adf", usbldr.RunSettings(order="arrival")),
    "cpf none": ("cpf", usbldr.RunSettings(calibrate=())),
    "ekf gate": ("ekf", usbldr.RunSettings(calibrate=(), gate=0.99)),
}


@dataclass(frozen=True, slots=True)
class Goal:
    """A fault and what is asked of the default under it."""

    name: str
    damage: Damage
    most_m: float = np.inf
    times_clean: float = np.inf  # the most that is allowed, over the same dive without the fault
    times_best: float = np.inf  # over the better of `cpf none` and `ekf gate`
    false_s: float = 0.0  # the first fixes are false for so long: `--order arrival` is to be back at twice this time

    @property
    def ways(self) -> list[str]:
        """Return the ways that are run."""
        ways = ["default"]
        if self.false_s:
            ways.append("arrival")
        if np.isfinite(self.times_best):
            ways += ["cpf none", "ekf gate"]
        return ways


def drill(*texts: str) -> Damage:
    """Return the damage by faults as `usbldr drill` writes them, such as "cluster usbl:20m@0:40"."""
    faults = tuple(fault_of(*text.split(" ")) for text in texts)
    return lambda log, seed: damaged(log, Drill(texts[0], faults), seed)


def fixes(change: Callable[[Vector, Array, np.random.Generator], Array]) -> Damage:
    """Return the damage of the fixes: times (F,) and positions (F, 2) to positions."""

    def put_in(log: Log, seed: int) -> Log:
        table = log.tables["usbl"]
        t, z = table["time_s"].to_numpy(), table[["east_m", "north_m"]].to_numpy()
        changed = change(t, z, np.random.default_rng(seed))
        table = table.assign(east_m=changed[:, 0], north_m=changed[:, 1])
        return replace(log, tables={**log.tables, "usbl": table})

    return put_in


def at_one_place(place_m: Array, until_s: float) -> Damage:
    """Return the damage of first fixes that all lie at a place."""
    return fixes(lambda t, z, rng: np.where((t < until_s)[:, None], place_m, z))


def echoes(share: float, offset_m: float, length: int) -> Damage:
    """Return the damage of runs of fixes with an offset of their own each."""

    def change(t: Vector, z: Array, rng: np.random.Generator) -> Array:
        z, f = z.copy(), 0
        while f < len(t):
            f += rng.geometric(share / (1 - share) / length)
            angle, count = rng.uniform(0, 2 * np.pi), rng.geometric(1 / length)
            z[f : f + count] += offset_m * np.array([np.cos(angle), np.sin(angle)])
            f += count
        return z

    return fixes(change)


def roll(t: Vector, z: Array, rng: np.random.Generator) -> Array:
    """Return fixes of a head that rolls with its ship by 3 m at the transponder, every 9.3 s, to a random side."""
    angle, phase = rng.uniform(0, 2 * np.pi, 2)
    return z + 3.0 * np.sin(2 * np.pi * t / 9.3 + phase)[:, None] * [np.cos(angle), np.sin(angle)]


def late(log: Log, seed: int) -> Log:
    """Return a log whose fixes are stamped 5 ± 2 s late."""
    table = log.tables["usbl"]
    stamped = table["time_s"] + np.random.default_rng(seed).normal(5.0, 2.0, len(table)).clip(0.0)
    table = table.assign(time_s=stamped, received_s=stamped).sort_values("time_s", ignore_index=True)
    return replace(log, tables={**log.tables, "usbl": table})


def in_steps(log: Log, seed: int) -> Log:
    """Return a log whose compass tells whole steps of 2°."""
    table = log.tables["compass"]
    table = table.assign(heading_deg=2.0 * np.round(table["heading_deg"] / 2.0) % 360.0)
    return replace(log, tables={**log.tables, "compass": table})


def clock_step(sensor: str, step_s: float) -> Damage:
    """Return the damage of a clock that jumps in the middle of the dive."""

    def put_in(log: Log, seed: int) -> Log:
        table = log.tables[sensor]
        late_s = np.where(table["time_s"] > 400.0, step_s, 0.0)
        table = table.assign(time_s=table["time_s"] + late_s, received_s=table["received_s"] + late_s)
        return replace(log, tables={**log.tables, sensor: table})

    return put_in


def clean(log: Log, seed: int) -> Log:
    """Return the log as it is."""
    return log


def goals() -> list[Goal]:
    """Return all rows of the table."""
    some = [Goal("no fault", clean)]
    for size_m, seconds in ((60, 2), (60, 5), (60, 10), (60, 40), (60, 100), (20, 10), (20, 40), (20, 100)):
        most_m = 0.5 if seconds == 100 else 0.3
        name, fault = f"first {seconds} s of fixes {size_m} m off", f"cluster usbl:{size_m}m@0:{seconds}"
        some.append(Goal(name, drill(fault), most_m, false_s=seconds))
    head_m = np.array([60.0, 90.0])  # of dive.toml
    some += [
        Goal("five first fixes at one place far away", at_one_place(ELSEWHERE_M, 5), 0.3, false_s=5),
        Goal("first 20 s of fixes at the head", at_one_place(head_m, 20), 0.3, false_s=20),
        Goal("echoes: 25 %, 8 m, runs of 10", echoes(0.25, 8.0, 10), 0.4),
        Goal("echoes: 40 %, 5 m, runs of 30", echoes(0.4, 5.0, 30), 0.4),
        Goal("the ship rolls: 3 m, 9.3 s", fixes(roll), 0.35),
        Goal("fixes stamped 5 ± 2 s late", late, 0.45),
        Goal("10 % DVL spikes of 3 m/s", drill("spike dvl:3m/s@0.1"), times_best=2.0),
        Goal("50 % outliers of 20 m", drill("outlier usbl:20m@0.5"), times_best=2.0),
        Goal("headings off by 40° for 60 s", drill("bias compass:40deg@43%:+60"), times_best=2.0),
        Goal("false fixes after an outage", drill("drop usbl@28%:+120", "cluster usbl:32m@28%+120:+60"), times_best=2),
        Goal("headings in steps of 2°", in_steps, times_best=2.0),
        Goal("no headings for 60 s", drill("drop compass@43%:+60"), times_best=2.0),
        Goal("DVL scale 20 %", drill("scale dvl:1.2"), times_clean=1.3),
        Goal("compass mounted at 170°", drill("bias compass:170deg"), times_clean=1.3),
        Goal("fixes stamped 5 s late", drill("latency usbl:5s"), times_clean=1.3),
        *(Goal(f"compass bias {b}°", drill(f"bias compass:{b}deg"), times_clean=1.3) for b in (5, 10, 15, 20, 25)),
        Goal("heading jumps by 8° in the middle", drill("bias compass:8deg@50%:"), times_clean=1.3),
        Goal("DVL scale 5 % from the middle on", drill("scale dvl:1.05@50%:"), times_clean=1.3),
        Goal("clock of the DVL steps by 30 s", clock_step("dvl", 30.0), times_clean=1.3),
        Goal("clock of the compass steps by 30 s", clock_step("compass", 30.0), times_clean=1.3),
        Goal("clock of the USBL steps by 30 s", clock_step("usbl", 30.0), times_clean=1.3),
    ]
    return some


def one_run(goal: Goal, way: str, seed: int) -> Row:
    """Return the errors of a run, and what it found."""
    method, settings = WAYS[way]
    log = usbldr.open_log(str(HERE / "dive.toml"), usbldr.Request(configuration="none"), seed)
    log = goal.damage(log, seed)
    line = usbldr.timeline(log)
    found = usbldr.resolve(log, line, method, settings)
    track = usbldr.replay(log, line, method, settings, found)
    report = usbldr.evaluate(log, line, track, settings)
    e_m, t = np.hypot(*report.error_m.T), report.time_s
    back_s = float("nan")
    if goal.false_s:
        bad = t[(e_m > 1.5) & (t >= goal.false_s)]
        back_s = float(bad.max()) if len(bad) else goal.false_s
    return {
        "goal": goal.name,
        "way": way,
        "seed": seed,
        "mean_m": float(e_m.mean()),
        "nees": report.nees.mean if report.nees else None,
        "back_s": back_s,
        "errors": {k: v.value for k, v in found.estimates.items()},
    }


def store_of(path: Path) -> dict[tuple[str, str, int], Row]:
    """Return the finished runs of a file."""
    lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
    return {(row["goal"], row["way"], row["seed"]): row for row in map(json.loads, lines)}


def table(rows: Iterable[Row]) -> str:
    """Return the table in Markdown."""
    by_cell: dict[tuple[str, str], dict[int, Row]] = {}
    for row in rows:
        by_cell.setdefault((row["goal"], row["way"]), {})[row["seed"]] = row
    lines = [
        "| fault | seeds | mean m (worst) | NEES | over clean | over best other | back after, arrival | goal | met |",
        "| --- | ---: | ---: | ---: | ---: | ---: | ---: | ---: | --- |",
    ]
    without = by_cell.get(("no fault", "default"), {})
    for goal in goals():
        mine = by_cell.get((goal.name, "default"), {})
        if not mine:
            continue
        errors = [row["mean_m"] for row in mine.values()]
        over = [row["mean_m"] / without[s]["mean_m"] for s, row in mine.items() if s in without]
        others = [by_cell.get((goal.name, way), {}) for way in ("cpf none", "ekf gate")]
        best = [
            row["mean_m"] / min(o[s]["mean_m"] for o in others)
            for s, row in mine.items()
            if all(s in o for o in others)
        ]
        back = [row["back_s"] for row in by_cell.get((goal.name, "arrival"), {}).values()]
        nees = [row["nees"] for row in mine.values() if row["nees"] is not None]
        met = [float(np.mean(errors)) <= goal.most_m, not over or float(np.mean(over)) <= goal.times_clean]
        wanted = []
        if np.isfinite(goal.most_m):
            wanted.append(f"{goal.most_m:g} m")
        if goal.false_s:
            wanted.append(f"{2 * goal.false_s:g} s")
            met.append(not back or median(back) <= 2 * goal.false_s)
        if np.isfinite(goal.times_clean):
            wanted.append(f"{goal.times_clean:g} × clean")
        if np.isfinite(goal.times_best):
            wanted.append(f"median 1.1, worst {goal.times_best:g}")
            met.append(bool(best) and median(best) <= 1.1 and max(best) <= goal.times_best)
        cells = [
            goal.name,
            str(len(mine)),
            f"{np.mean(errors):.2f} ({max(errors):.2f})",
            f"{np.mean(nees):.1f}" if nees else "",
            f"{np.mean(over):.2f}" if over else "",
            f"{median(best):.2f} ({max(best):.2f})" if best else "",
            f"{median(back):.0f} s ({max(back):.0f})" if back else "",
            "; ".join(wanted),
            ("yes" if all(met) else "no") if wanted else "",
        ]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def main() -> None:
    """Run what is missing, seed by seed, and write the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=16)
    parser.add_argument("--only", default="", help="only rows whose name contains this")
    parser.add_argument("--ways", nargs="*", default=list(WAYS), choices=list(WAYS))
    parser.add_argument("--runs", type=Path, default=ROOT / "drill-runs" / "goals.jsonl", help="file of finished runs")
    parser.add_argument("--output", type=Path, default=ROOT / "docs" / "studies" / "faults.md")
    options = parser.parse_args()
    options.runs.parent.mkdir(parents=True, exist_ok=True)
    done = store_of(options.runs)
    for seed in range(FIRST_SEED, FIRST_SEED + options.seeds):
        for goal in goals():
            for way in goal.ways:
                key = (goal.name, way, seed)
                if options.only not in goal.name or way not in options.ways or key in done:
                    continue
                done[key] = one_run(goal, way, seed)
                with options.runs.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(done[key]) + "\n")
                row = done[key]
                print(
                    seed,
                    f"{goal.name}, {way}: {row['mean_m']:.2f} m, back {row['back_s']:g} s",
                    row["errors"],
                    flush=True,
                )
    text = (HERE / "goals.md").read_text(encoding="utf-8").replace("{table}", table(done.values()))
    write_atomically(options.output, text.encode())


if __name__ == "__main__":
    main()
