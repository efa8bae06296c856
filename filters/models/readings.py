"""The readings of many epochs as columns: what replay hands to the filters, without an object for each number.

A `Measurement` is made of one where a filter in NumPy wants it.
"""

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np

from usbldr.filters.models.noise import Noise, NoiseFamily
from usbldr.filters.models.sensors import Measurement, UsblFix
from usbldr.filters.models.sigma_points import StateFunction
from usbldr.filters.types import Array, Indices, Mask, Vector


class Part(NamedTuple):
    """The parts with this axis of some readings, see Measurement.parts."""

    axis: str
    scalars: slice  # of z
    readings: Indices  # which ones have it
    place: int  # among the parts of a reading


@dataclass(frozen=True)
class Readings:
    """R readings of one axis of a sensor, or R fixes, of k scalars each, in the order of their epochs."""

    sensor: str
    axis: str
    model: StateFunction  # of a fix: without its offset
    family: NoiseFamily
    bilinear: bool  # see Measurement
    held: tuple[int, ...]  # likewise
    epoch: Indices  # (R,) that uses it, ascending
    row: Indices  # (R,) see Measurement
    time_s: Vector  # (R,) of validity
    received_s: Vector  # (R,) when it reached the vehicle
    z: Array  # (R, k)
    cov: Array  # (R, k, k) of the nominal noise
    offset_s: Vector | None = None  # (R,) of a fix from its epoch

    def __len__(self) -> int:
        return len(self.epoch)

    def between(self, first: int, last: int) -> "Readings":
        """Return the readings of the epochs from first on, without last."""
        rows = slice(*self.epoch.searchsorted((first, last)).tolist())
        columns = {one.name: getattr(self, one.name) for one in fields(self)}
        return Readings(**{k: v[rows] if isinstance(v, np.ndarray) else v for k, v in columns.items()})  # pyright: ignore

    @cached_property
    def noise(self) -> Noise:
        """The modes of all readings: covariances (J, R, k, k)."""
        return self.family.modes(self.cov)

    @cached_property
    def in_sequence(self) -> Mask:
        """Whether the axes of a reading are used in sequence, (R,), see Measurement.parts."""
        if self.z.shape[1] == 1 or not self.family.per_scalar:
            return np.zeros(len(self), np.bool_)
        coupled: Mask = (self.noise.cov[:, :, 0, 1] != 0).any(axis=0)
        return ~coupled

    def parts(self) -> Iterator[Part]:
        """Yield the parts of all readings, those of the same axis together."""
        whole, split = np.flatnonzero(~self.in_sequence), np.flatnonzero(self.in_sequence)
        parts = (self.axis, 0, self.z.shape[1], whole, 0), ("east", 0, 1, split, 0), ("north", 1, 2, split, 1)
        for axis, first, last, rows, place in parts:
            if len(rows):
                yield Part(axis, slice(first, last), rows, place)

    def measurement(self, r: int) -> Measurement:
        """Return one reading."""
        model, cov = self.model, self.cov[r]
        if self.offset_s is not None and isinstance(model, UsblFix):
            model = replace(model, offset_s=float(self.offset_s[r]))
        noise = scalar_noise(self.family, float(cov[0, 0])) if len(cov) == 1 else self.family.modes(cov)
        row, time_s = int(self.row[r]), float(self.time_s[r])
        return Measurement(self.z[r], model, noise, self.sensor, self.axis, row, time_s, self.bilinear, self.held)


@lru_cache(maxsize=1024)
def scalar_noise(family: NoiseFamily, variance: float) -> Noise:
    """Return the modes of a scalar: most readings of a sensor share them, and so their code in the kernel."""
    return family.modes(np.array([[variance]]))
