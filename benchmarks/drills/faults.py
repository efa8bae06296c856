"""Errors of the fixes, of the start and of clocks that `usbldr drill` cannot put into a log: print what they cost.

    python benchmarks/drills/faults.py --seeds 8

Each seed is a dive of its own (dive.toml, read without a configuration), scored as a whole, the faults included.
docs/studies/faults.md has the table.
"""

import argparse
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import usbldr
from usbldr.filters.types import Array, Vector
from usbldr.io.conventions.shown_noise import examined
from usbldr.io.drills.drill import Drill, damaged
from usbldr.io.drills.fault_text import fault_of
from usbldr.io.log import Log

DIVE = Path(__file__).parent / "dive.toml"
FIRST_SEED = 4100  # no other study uses these dives
HEAD_M = np.array([60.0, 90.0])  # of dive.toml
ELSEWHERE_M = np.array([-300.0, 200.0])  # where positions lie that were written before the first reply
BACK_M = 1.5  # a track further off has not come back
Change = Callable[[Vector, Array, np.random.Generator], Array]  # times (F,) and fixes (F, 2) to fixes
Damage = Callable[[Log, int], Log]


def drill(text: str) -> Damage:
    """Return the damage by a fault as `usbldr drill` writes it, such as "cluster usbl:20m@0:40"."""
    return lambda log, seed: damaged(log, Drill(text, (fault_of(*text.split(" ")),)), seed)


def changed(log: Log, role: str, **columns: Any) -> Log:
    """Return the log with other values in some columns of a sensor."""
    return replace(log, tables={**log.tables, role: log.tables[role].assign(**columns)})


def fixes(change: Change) -> Damage:
    """Return the damage that a change does to the fixes."""

    def put_in(log: Log, seed: int) -> Log:
        table = log.tables["usbl"]
        z = change(table["time_s"].to_numpy(), table[["east_m", "north_m"]].to_numpy(), np.random.default_rng(seed))
        return changed(log, "usbl", east_m=z[:, 0], north_m=z[:, 1])

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


def later(log: Log, seed: int) -> Log:
    """Return a log whose fixes are stamped 3 s late from the middle on."""
    time_s = log.tables["usbl"]["time_s"]
    stamped = time_s + np.where(time_s > 400.0, 3.0, 0.0)
    return changed(log, "usbl", time_s=stamped, received_s=stamped)


def over_fish(log: Log, seed: int) -> Log:
    """Return a log whose DVL is off by .7 m/s on each axis, at random, for 20 s, five times."""
    rng, table = np.random.default_rng(seed), log.tables["dvl"]
    velocity, time_s = table[["starboard_mps", "forward_mps"]].to_numpy(), table["time_s"].to_numpy()
    for begin_s in np.linspace(0.18, 0.82, 5) * time_s[-1]:
        velocity = velocity + ((time_s >= begin_s) & (time_s < begin_s + 20.0))[:, None] * rng.normal(0.0, 0.7, 2)
    return examined(changed(log, "dvl", starboard_mps=velocity[:, 0], forward_mps=velocity[:, 1]))


def through_water(log: Log, seed: int) -> Log:
    """Return a log whose DVL measures through a current of 0.3 m/s, to a random side, from 300 to 450 s."""
    table, compass = log.tables["dvl"], log.tables["compass"]
    time_s, to_rad = table["time_s"].to_numpy(), np.random.default_rng(seed).uniform(0.0, 2 * np.pi)
    heading_rad = np.interp(time_s, compass["time_s"], np.unwrap(np.radians(compass["heading_deg"])))
    there = (time_s > 300.0) & (time_s < 450.0)
    starboard = table["starboard_mps"] - there * 0.3 * np.sin(to_rad - heading_rad)
    forward = table["forward_mps"] - there * 0.3 * np.cos(to_rad - heading_rad)
    return examined(changed(log, "dvl", starboard_mps=starboard, forward_mps=forward))


def biased(log: Log, seed: int) -> Log:
    """Return a log whose DVL reads 0.02 m/s too much forward and 0.03 m/s to starboard, at any speed."""
    table = log.tables["dvl"]
    return changed(log, "dvl", forward_mps=table["forward_mps"] + 0.02, starboard_mps=table["starboard_mps"] + 0.03)


def seldom(role: str, every: int, fault: str) -> Damage:
    """Return the damage by a fault as `usbldr drill` writes it, of a sensor of which every nth record is kept."""

    def put_in(log: Log, seed: int) -> Log:
        thinned = log.tables[role].iloc[::every].reset_index(drop=True)
        return examined(drill(fault)(replace(log, tables={**log.tables, role: thinned}), seed))

    return put_in


def headings_off(change: Callable[[Vector, Vector], Vector]) -> Damage:
    """Return the damage by what a change of times and headings adds to the headings, all (C,) and in degrees."""

    def put_in(log: Log, seed: int) -> Log:
        table = log.tables["compass"]
        off_deg = change(table["time_s"].to_numpy(), table["heading_deg"].to_numpy())
        return examined(changed(log, "compass", heading_deg=(table["heading_deg"] + off_deg) % 360.0))

    return put_in


def beside_iron(log: Log, seed: int) -> Log:
    """Return a log whose compass is turned by up to 50° for about half a minute, at a random time."""
    rng, table = np.random.default_rng(seed), log.tables["compass"]
    from_s = table["time_s"] - rng.uniform(200.0, 600.0)
    heading_deg = table["heading_deg"] + rng.choice([-50.0, 50.0]) * np.exp(-((from_s / 15.0) ** 2))
    return changed(log, "compass", heading_deg=heading_deg % 360.0)


def restarting(log: Log, seed: int) -> Log:
    """Return a log whose compass sends 0 for 8 s, every 200 s."""
    table = log.tables["compass"]
    heading_deg = table["heading_deg"].where((table["time_s"] + 50.0) % 200.0 > 8.0, 0.0)
    return examined(changed(log, "compass", heading_deg=heading_deg))


def silent(log: Log, seed: int) -> Log:
    """Return a log in which no sensor records for 25 s, at a random time."""
    begin_s = np.random.default_rng(seed).uniform(200.0, 600.0)
    kept = {role: table[~table["time_s"].between(begin_s, begin_s + 25.0)] for role, table in log.tables.items()}
    return replace(log, tables={role: table.reset_index(drop=True) for role, table in kept.items()})


FAULTS: dict[str, tuple[Damage, float]] = {  # and for how long the first fixes are false
    "none": (lambda log, seed: log, 0.0),
    **{f"first {s} s of fixes 60 m off": (drill(f"cluster usbl:60m@0:{s}"), float(s)) for s in (5, 10, 40, 100)},
    "five first fixes at one place far away": (at_one_place(ELSEWHERE_M, 5.0), 5.0),
    "first 20 s of fixes at the head": (at_one_place(HEAD_M, 20.0), 20.0),
    "echoes: 25 %, 8 m, runs of 10": (echoes(0.25, 8.0, 10), 0.0),
    "echoes: 40 %, 5 m, runs of 30": (echoes(0.4, 5.0, 30), 0.0),
    "the ship rolls: 3 m, 9.3 s": (fixes(roll), 0.0),
    "fixes stamped 5 ± 2 s late": (late, 0.0),
    "fixes stamped 5 s late": (drill("latency usbl:5s"), 0.0),
    "fixes stamped 2 s late": (drill("latency usbl:2s"), 0.0),
    "compass stamped 1.5 s late": (drill("latency compass:1.5s"), 0.0),
    "DVL stamped 1 s late": (drill("latency dvl:1s"), 0.0),
    "DVL scale 20 %": (drill("scale dvl:1.2"), 0.0),
    "compass bias 10°": (drill("bias compass:10deg"), 0.0),
    "compass mounted at 170°": (drill("bias compass:170deg"), 0.0),
    "compass off by 40° for 60 s": (drill("bias compass:40deg@300:360"), 0.0),
    "heading jumps by 8° in the middle": (drill("bias compass:8deg@50%:"), 0.0),
    "heading jumps by 3° after 70 %": (drill("bias compass:3deg@70%:"), 0.0),
    "headings drift by 8°": (headings_off(lambda t, heading_deg: 8.0 * t / t[-1]), 0.0),
    "headings settle from 10° off, time constant 200 s": (
        headings_off(lambda t, heading_deg: 10.0 * np.exp(-t / 200.0)),
        0.0,
    ),
    "headings wander by 5°, period 750 s": (headings_off(lambda t, heading_deg: 5.0 * np.sin(t / 120.0)), 0.0),
    "compass deviation of 4° twice per turn": (
        headings_off(lambda t, heading_deg: 4.0 * np.sin(np.radians(2.0 * heading_deg))),
        0.0,
    ),
    "DVL scale 5 % from the middle on": (drill("scale dvl:1.05@50%:"), 0.0),
    "DVL scale 2 % after a quarter": (drill("scale dvl:1.02@25%:"), 0.0),
    "DVL reads 0.02 m/s too much forward, 0.03 to starboard": (biased, 0.0),
    "fixes shift by 8 m after 60 %": (fixes(lambda t, z, rng: z + (t > 480.0)[:, None] * [6.4, -4.8]), 0.0),
    "fixes 3 s later from the middle on": (later, 0.0),
    "a DVL of 1 Hz, 10 % spikes of 2 m/s": (seldom("dvl", 5, "spike dvl:2m/s@0.1"), 0.0),
    "a compass of 1 Hz, 5 % spikes of 60°": (seldom("compass", 10, "spike compass:60deg@0.05"), 0.0),
    "a DVL that measures through a current of 0.3 m/s for 150 s": (through_water, 0.0),
    "a DVL over fish: off for 20 s, five times": (over_fish, 0.0),
    "no sensor records for 25 s": (silent, 0.0),
    "a compass beside iron: up to 50° for half a minute": (beside_iron, 0.0),
    "a compass that sends 0 for 8 s, four times": (restarting, 0.0),
    "fixes that scatter by 3 m after 60 %": (
        fixes(lambda t, z, rng: z + (t > 480.0)[:, None] * rng.normal(0, 3, z.shape)),
        0.0,
    ),
}


def errors_m(log: Log, method: str, settings: usbldr.RunSettings) -> tuple[Vector, Vector]:
    """Return times and horizontal errors of a run, (K,) each."""
    line = usbldr.timeline(log)
    track = usbldr.replay(log, line, method, settings, usbldr.resolve(log, line, method, settings))
    report = usbldr.evaluate(log, line, track, settings)
    return report.time_s, np.hypot(*report.error_m.T)


def main() -> None:
    """Print a row for each fault."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=8, help="dives")
    parser.add_argument("--arrival", type=int, default=2, help="of them also in the order of arrival, by adf")
    options = parser.parse_args()
    print("| fault | mean of the dives, m | least, largest | over the dive without | by arrival, back after |")
    print("| --- | ---: | ---: | ---: | --- |")
    clean = np.ones(options.seeds)
    for name, (damage, false_s) in FAULTS.items():
        means, back = [], []
        for seed in range(FIRST_SEED, FIRST_SEED + options.seeds):
            log = damage(usbldr.open_log(str(DIVE), usbldr.Request(configuration="none"), seed), seed)
            means.append(errors_m(log, "cpf", usbldr.RunSettings())[1].mean())
            if false_s and seed < FIRST_SEED + options.arrival:
                t, e_m = errors_m(log, "adf", usbldr.RunSettings(order="arrival"))
                back.append(t[(t < false_s) | (e_m > BACK_M)].max())
        clean = np.array(means) if name == "none" else clean
        each = f"{min(means):.2f}, {max(means):.2f}"
        times = f"{np.mean(np.array(means) / clean):.2f}"
        print(
            f"| {name} | {np.mean(means):.2f} | {each} | {times} | {', '.join(f'{s:.0f} s' for s in back)} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
