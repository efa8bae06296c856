"""What a log itself says of a run: the parameters to run with, and the reasons for them."""

from dataclasses import dataclass
from typing import NamedTuple

from usbldr.filters.models.parameters import Parameters

DR_WALK_NAME = "position_walk_m"  # fixed: the name under which a change of ProcessNoise.position_m is reported


class StateObservability(NamedTuple):
    """How well one key of calibration.STATES is observable in a log."""

    key: str
    sigma_ratio: float  # sigma at the end of the log, as a share of that before
    conclusion: str  # "observable", "only in turns", "not observable"


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
    observed: tuple[StateObservability, ...] = ()
    noise_changes: tuple[NoiseChange, ...] = ()
    tuned: tuple[TunedParameter, ...] = ()

    @property
    def warnings(self) -> tuple[str, ...]:
        """Return what to check if the fixes contradict dead reckoning."""
        if all(number.name != DR_WALK_NAME for number in self.noise_changes):
            return ()
        walk_m = self.parameters.process.position_m
        return (
            f"the fixes contradict dead reckoning; process noise of dead reckoning was raised to {walk_m:g} m/√s, so "
            "that the track follows the fixes: check the DVL's bottom lock, its axes and mounting, and the compass",
        )
