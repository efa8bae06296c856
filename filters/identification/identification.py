"""What a log itself says of a run: the parameters to run with, and the reasons for them."""

from dataclasses import dataclass
from typing import NamedTuple

from usbldr.filters.models.parameters import Parameters

DR_WALK_NAME = "position_walk_m"  # fixed: the name under which a change of ProcessNoise.position_m is reported


class SensorErrorEvidence(NamedTuple):
    """What a log says of one sensor error."""

    key: str  # of usbl_likelihood.KEYS
    log_odds: float  # of the best explanation with the error against the best without
    exists: bool  # it is part of the best explanation
    value: tuple[float, ...]  # of its states there
    sd: tuple[float, ...]


class NoiseChange(NamedTuple):
    """A number of the noise that a log contradicted, see observability.py."""

    name: str  # with its unit
    before: float
    after: float


class TunedParameter(NamedTuple):
    """A number that was estimated from the log, see tuning.py."""

    name: str  # with its unit
    before: float
    after: float
    low: float  # one sigma down, by the width of the likelihood
    high: float  # one sigma up
    identified: bool  # False: the log hardly determines it, so it stays as it was


@dataclass(frozen=True, slots=True)
class Identification:
    """The parameters of a run, and how the log led to them; without ``observed`` it was not asked for states."""

    parameters: Parameters
    observed: tuple[SensorErrorEvidence, ...] = ()
    noise_changes: tuple[NoiseChange, ...] = ()
    tuned: tuple[TunedParameter, ...] = ()

    @property
    def warnings(self) -> tuple[str, ...]:
        """Return what to check if the fixes contradict dead reckoning."""
        if all(number.name != DR_WALK_NAME for number in self.noise_changes):
            return ()
        walk_m = self.parameters.process.position_m
        return (
            f"the fixes contradict dead reckoning, so that it may walk {walk_m:g} m in a second and the track follows "
            "them: check the DVL's bottom lock, its axes and mounting, and the compass",
        )
