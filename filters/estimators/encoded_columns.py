"""Many steps, with their readings as columns, as the compiled kernel reads them: see encoding.py for a step alone."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from usbldr.filters.estimators.encoding import (
    FIXES,
    NO_GAP,
    function_bytes,
    generator_state,
    noise_columns,
    relaxation,
    seed_words,
    word_count,
)
from usbldr.filters.estimators.protocol import SeededRng, Steps
from usbldr.filters.kernel import KERNEL
from usbldr.filters.models.motion import VehicleMotion
from usbldr.filters.models.readings import Part, Readings
from usbldr.filters.models.sensors import UsblFix
from usbldr.filters.models.states import StateLayout
from usbldr.filters.types import Indices, Mask, Vector
from usbldr.filters.updates import Codes

FUNCTIONS, READINGS, STEPS = (KERNEL.structure(name) for name in ("Function", "Reading", "Step"))


class EncodedSteps(NamedTuple):
    """K steps with P parts of readings as the kernel reads them, and what the updates of the parts say of them."""

    steps: NDArray[np.void]  # (K,) STEPS
    readings: NDArray[np.void]  # (P,) READINGS
    begin: Indices  # (K + 1,) the first part of each step, and the end
    names: tuple[str, ...]  # of sensors and axes
    sensor: Codes  # (P,) index into the names
    axis: Codes  # (P,) likewise
    row: NDArray[np.int32]  # (P,)
    time_s: Vector  # (P,)
    dof: Codes  # (P,) scalars
    is_first: Mask  # (P,) whether it is the first part of its reading


def encoded_steps(steps: Steps, motion: VehicleMotion, seed: int | None) -> EncodedSteps:
    """Return the code of steps; their random numbers depend on the seed, which is None for a filter without."""
    coded = np.zeros(len(steps), STEPS)
    coded["dt_s"] = steps.t1_s - steps.t0_s
    for k in np.flatnonzero(motion.history.gaps(steps.t0_s) | motion.turns.gaps(steps.t0_s)).tolist():
        relaxed = relaxation(motion, float(steps.t0_s[k]), float(coded["dt_s"][k]))
        coded["gap"][k] = relaxed is not None
        for place, field in enumerate(("remaining", "usual", "added")):
            coded[field][k] = (relaxed or NO_GAP)[3 * place : 3 * place + 3]
    if seed is not None:
        _seed(coded, seed, steps.first)

    place, coded["readings"] = _places(steps)
    begin = np.concatenate([[0], np.cumsum(coded["readings"], dtype=np.intp)])
    size = int(begin[-1])
    names = (*sorted({one.sensor for one in steps.readings}), *{"east", "north", *(one.axis for one in steps.readings)})
    sensor, axis, dof = np.zeros((3, size), np.uint8)
    readings, row, time_s, is_first = np.zeros(size, READINGS), np.zeros(size, np.int32), np.zeros(size), np.zeros(size)
    for one, first in zip(steps.readings, place, strict=True):
        for part in one.parts():
            at = first[part.readings] + part.place
            readings[at] = _coded(one, part, motion.layout)
            sensor[at], axis[at] = names.index(one.sensor), names.index(part.axis)
            row[at], time_s[at] = one.row[part.readings], one.time_s[part.readings]
            dof[at], is_first[at] = part.scalars.stop - part.scalars.start, part.place == 0
    return EncodedSteps(coded, readings, begin, names, sensor, axis, row, time_s, dof, is_first > 0)


def _seed(coded: NDArray[np.void], seed: int, first: int) -> None:
    """Seed the generator of each step: of (seed, epoch)."""
    epochs = range(first, first + len(coded))
    words = seed_words(seed, 0)
    if words is None:
        coded["state"] = [generator_state(SeededRng(seed, epoch)()) for epoch in epochs]
    else:
        coded["seed"], coded["seeded"] = words, True
        coded["seed"][:, word_count(seed)] = epochs


def _places(steps: Steps) -> tuple[list[Indices], Indices]:
    """Return where the parts of each reading begin, in the order of a step's measurements, and the parts of a step."""
    columns = [(one.epoch - steps.first, one.time_s, 1 + one.in_sequence, one.sensor) for one in steps.readings]
    epoch, time_s, count = (np.concatenate(column) for column in list(zip(*columns, strict=True))[:3])
    sensor = np.repeat([one.sensor for one in steps.readings], [len(one) for one in steps.readings])
    order = np.lexsort((sensor, time_s, epoch))  # stable: order in the log
    place = np.empty_like(count)
    place[order] = np.cumsum(count[order]) - count[order]
    ends = np.cumsum([len(one) for one in steps.readings])
    return np.split(place, ends[:-1]), np.bincount(epoch, count, len(steps)).astype(np.intp)


def _coded(one: Readings, part: Part, layout: StateLayout) -> NDArray[np.void]:
    """Return the code of one part of readings."""
    rows, scalars = part.readings, part.scalars
    coded, model, z = np.zeros(len(rows), READINGS), one.model, one.z[rows, scalars]
    if one.offset_s is None or not isinstance(model, UsblFix):
        coded["g"] = np.frombuffer(function_bytes(model, layout, one.bilinear), FUNCTIONS)
    else:
        offset_s, axes = one.offset_s[rows], model.axes[scalars]
        for here in (offset_s == 0, offset_s != 0):  # a fix at the epoch itself may select states
            if here.any():
                model = replace(model, axes=axes, offset_s=float(offset_s[here.argmax()]))
                coded["g"][here] = np.frombuffer(function_bytes(model, layout, one.bilinear), FUNCTIONS)
                if model.rows is None:
                    coded["g"]["number"][here, 0] = offset_s[here]
    coded["noise"] = noise_columns(one.noise.probabilities, one.noise.cov[:, rows, scalars, scalars])
    coded["z"][:, 0], coded["z"][:, 1] = z[:, 0], z[:, -1]
    coded["modes"], coded["fix"] = len(one.noise.probabilities), FIXES.get(one.sensor, 0)
    return coded
