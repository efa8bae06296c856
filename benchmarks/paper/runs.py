"""The runs that the study of paper.md rests on: which filter on which scenario, and how often.

Of a scenario each seed is a dive of its own. ``few`` is for what needs no sharp number: ways of running that turn out
alike, sweeps, and the costly ones.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeAlias

from usbldr.filters.replay.methods import METHODS
from usbldr_cli.options.run_options import RunChoices
from usbldr_cli.runs.run_jobs import run_jobs
from usbldr_cli.runs.seed_table import ComparisonRow
from usbldr_cli.runs.workers import Executor, Job

HERE = Path(__file__).parent
UNSEEN = str(HERE / "unseen.toml")
LATE = str(HERE / "late_stamps.toml")

STATES = {"none": "6 states", "scale": "+ scale", "scale,misalignment": "+ scale, misalignment"}
"""What is calibrated, and how tables call it."""

COUNTS = (10, 20, 50, 100, 300, 1000)  # of particles, for the figure of error against N
DRIFTS = (0.022, 0.067, 0.22)  # m after one second of process noise in place of the scale; 0.067 is `paper` itself
SHARES = (0.0, 0.1, 0.2, 0.3, 0.5)  # of outliers; 0.3 is `paper` itself


@dataclass(frozen=True, slots=True)
class Way:
    """A filter with its options."""

    method: str
    calibrate: str = "none"
    particles: int = 100
    gate: float | None = None
    smooth: bool = False
    order: str = "validity"

    @property
    def label(self) -> str:
        """The filter as a table names it, without what it calibrates."""
        parts = [self.method]
        parts += [f"--gate {self.gate:g}"] if self.gate is not None else []
        parts += [f"--particles {self.particles}"] if self.particles != 100 else []
        parts += ["--smooth"] if self.smooth else []
        parts += [f"--order {self.order}"] if self.order != "validity" else []
        return " ".join(parts)

    def choices(self, seed: int) -> RunChoices:
        """Return the options as the command line would make them."""
        return RunChoices(
            particles=self.particles,
            gate=self.gate,
            seed=seed,
            start=None,
            end=None,
            align="auto",
            dr_from="start",
            fast_hz=5.0,
            slow_hz=1.0,
            calibrate=None if self.calibrate == "none" else self.calibrate,  # simulated dives state none
            smooth=self.smooth,
            order=self.order,
        )


Cell: TypeAlias = tuple[str, Way]  # a scenario, by its name or its file, and what is run on it
Plan: TypeAlias = Mapping[Cell, int]  # how many seeds
Rows: TypeAlias = Mapping[Cell, ComparisonRow]

GATED = Way("ekf", gate=0.99)
LEADING = (Way("ekf"), GATED, Way("adf"), Way("adf", smooth=True), Way("cpf"), Way("pf"))
ALIKE = (Way("ckf"), Way("ukf"), Way("upf"), Way("cpf-gaussian"))
NAMED = (Way("aekf"), Way("afukf"), Way("pf-wekf"))  # in the paper's introduction
LITERAL = (Way("upf-literal"), Way("cpf-literal"))
SWEPT = (Way("ekf"), GATED, Way("adf"), Way("cpf"), Way("pf"))
ON_LAKE = (Way("pf"), Way("upf"), Way("cpf"), Way("ekf"), GATED, Way("adf"), Way("adf", smooth=True))
ON_UNSEEN = (Way("ekf"), GATED, Way("adf"), Way("adf", smooth=True), Way("cpf"), Way("pf"))
UNFILTERED = (Way("dr"), Way("usbl"))


def few(seeds: int) -> int:
    """Return how many seeds are enough for what needs no sharp number."""
    return max(2, seeds // 6)


def half(seeds: int) -> int:
    """Return how many seeds are enough beside a goal's row."""
    return max(2, seeds // 2)


def plan(seeds: int, sweeps: Path, unseen: bool) -> Plan:
    """Return every run of the study; ``sweeps`` is the folder of `write_sweeps`."""
    wanted: dict[Cell, int] = {}

    def want(log: str, ways: Sequence[Way], count: int, calibrate: str | None = None) -> None:
        for way in ways:
            cell = (log, way if calibrate is None else replace(way, calibrate=calibrate))
            wanted[cell] = max(count, wanted.get(cell, 0))

    want("paper", UNFILTERED, seeds)
    want("paper", SWEPT, seeds)
    want("paper", (Way("adf", smooth=True),), half(seeds))
    want("paper", (Way("cpf"), Way("adf"), Way("adf", smooth=True)), seeds, "scale")
    want("paper", (Way("cpf"),), seeds, "scale,misalignment")
    for calibrate in ("scale", "scale,misalignment"):
        want("paper", (*LEADING, *ALIKE), few(seeds), calibrate)
    want("paper", ALIKE, few(seeds))
    want("paper", NAMED, few(seeds))
    want("paper", NAMED, few(seeds), "scale")
    want("paper", LITERAL, few(seeds))
    for calibrate in ("none", "scale"):
        want("paper", (Way("cpf", particles=20),), seeds, calibrate)
    want("paper", [Way(name, particles=N) for name in ("cpf", "upf", "pf") for N in COUNTS], few(seeds))

    want("paper-drawn", (Way("adf"),), 2 * seeds, "scale")
    want("paper-drawn", (Way("cpf"), GATED, Way("adf", smooth=True)), half(seeds), "scale")
    want("paper-drawn", (Way("ekf"),), few(seeds), "scale")

    want("paper-range", (Way("cpf"), Way("adf", smooth=True)), seeds, "scale")
    want("paper-range", (Way("usbl"),), few(seeds))
    want("paper-range", (Way("ekf"), Way("adf")), few(seeds), "scale")

    want("delay", (Way("cpf"), Way("adf"), Way("adf", order="arrival")), few(seeds), "scale")
    want(LATE, (Way("adf"),), few(seeds), "scale")
    want("latency", (Way("adf"),), few(seeds), "scale")
    want("latency", (Way("adf"),), few(seeds), "scale,latency")
    want("square", (Way("adf"),), few(seeds), "scale")

    for share in SHARES:
        want(shared(sweeps, share), SWEPT, few(seeds))
    for drift in DRIFTS:
        want(drifting(sweeps, drift), (Way("cpf"), Way("adf")), few(seeds))
    want("lake", (*UNFILTERED, *ON_LAKE), few(seeds))
    want("lake", (Way("adf"),), few(seeds), "scale,misalignment")
    want("lake", (Way("adf"),), few(seeds), "scale,heading")
    if unseen:
        want(UNSEEN, (*UNFILTERED, *ON_UNSEEN), few(seeds))
        want(UNSEEN, (Way("cpf"), Way("adf"), Way("adf", smooth=True)), few(seeds), "scale,heading,latency,usbl-bias")
    return wanted


def shared(sweeps: Path, share: float) -> str:
    """Return the scenario with this share of outliers: `paper` itself for its own."""
    return "paper" if share == 0.3 else str(sweeps / f"share_{100 * share:02.0f}.toml")


def drifting(sweeps: Path, drift: float) -> str:
    """Return the scenario in which filters assume this drift instead of the scale."""
    return "paper" if drift == 0.067 else str(sweeps / f"drift_{1000 * drift:03.0f}.toml")


def write_sweeps(sweeps: Path) -> None:
    """Write the variations of `paper` into a folder."""
    sweeps.mkdir(parents=True, exist_ok=True)
    texts = {shared(sweeps, share): share_text(share) for share in SHARES}
    texts |= {drifting(sweeps, drift): drift_text(drift) for drift in DRIFTS}
    for name, text in texts.items():
        if name != "paper":
            Path(name).write_text(text, encoding="utf-8")


def share_text(share: float) -> str:
    """Return the scenario `paper` with another share of readings of ten times the variance."""
    noise = '{ kind = "gaussian" }'
    if share:
        noise = f'{{ kind = "mixture", share = {share}, variance_ratio = 10.0, per = "scalar" }}'
    sensors = "".join(f"\n[{sensor}]\nnoise = {noise}\n" for sensor in ("dvl", "compass", "usbl"))
    return f'schema = 1\nlike = "paper"\nabout = "paper with {share:.0%} of outliers"\n{sensors}'


def drift_text(drift: float) -> str:
    """Return the scenario `paper` with filters that assume another drift where no state explains the DVL's scale."""
    about = f"paper, but filters without the scale assume {drift:g} m of drift after one second"
    return f'schema = 1\nlike = "paper"\nabout = "{about}"\n\n[process]\nuncalibrated_m = {drift!r}\n'


def run_plan(wanted: Plan, where: Executor, store: Path) -> Rows:
    """Run what is not in the store yet, seed by seed, so that a dive is made once for all its filters."""
    logs = list(dict.fromkeys(log for log, _ in wanted))
    runs = [(cell, seed) for cell, count in wanted.items() for seed in range(count)]
    runs.sort(key=lambda run: (logs.index(run[0][0]), run[1]))
    found = run_jobs([Job(log, way.method, way.choices(seed)) for (log, way), seed in runs], where, store)
    outcomes = dict(zip(runs, found, strict=True))
    return {
        (log, way): ComparisonRow(
            log=Path(log).stem,
            label=way.label,
            method=way.method,
            seeds=tuple(range(count)),
            outcomes=tuple(outcomes[(log, way), seed] for seed in range(count)),
            sampled=METHODS[way.method].draws,
            dives=True,
        )
        for (log, way), count in wanted.items()
    }
