"""Steps and measurements as the bytes that the compiled kernel reads: the structures of kernel/layout.h.

A function of the state is coded by its kind, its numbers, and the states that it depends on, nonlinear ones first.
A step is coded alone, as late fixes and a loop of one's own have it, or many at once, their readings as columns.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from usbldr.filters.estimators.protocol import SeededRng, Steps
from usbldr.filters.kernel import KERNEL
from usbldr.filters.models.motion import VehicleMotion
from usbldr.filters.models.noise import NoiseFamily, is_nominal
from usbldr.filters.models.readings import Part, Readings
from usbldr.filters.models.sensors import (
    BodyVelocity,
    DeviatingCompass,
    DirectState,
    Measurement,
    ScaledVelocity,
    UsblFix,
)
from usbldr.filters.models.sigma_points import StateFunction
from usbldr.filters.models.states import MOTION_STATES, StateLayout
from usbldr.filters.types import Array, Indices, Mask, Vector
from usbldr.filters.updates import Codes

_, MAX_STATES, MAX_MODES, MAX_COLUMNS, *_ = KERNEL.limits
NO_GAP = (0.0,) * 9  # fixed: of velocity and turn rate outside a gap
ARGUMENTS = (
    *(*MOTION_STATES, "dvl_scale", "dvl_mount", "current_east", "current_north"),
    *("usbl_latency", "usbl_bias_east", "usbl_bias_north", "heading_bias", "deviation_sin", "deviation_cos"),
)
"""The states that a function may depend on, in the order of layout.h."""
SELECTED, VELOCITY, COMPASS, FIX = range(4)  # kinds of functions, as in layout.h
FUNCTION, STEP, FILTER = (KERNEL.packer(name) for name in ("Function", "Step", "Filter"))
READING_END = KERNEL.packer("Reading", skip=2)  # what follows the function and its noise
FIXES = {"gps": 1, "usbl": 2}  # as in layout.h
READINGS, STEPS = (KERNEL.structure(name) for name in ("Reading", "Step"))


class EncodingError(TypeError):
    """The kernel has no code for a sensor model, or no room for a noise family."""


class EncodedStep(NamedTuple):
    """A step as the kernel reads it, and the measurements that its records are of."""

    step: bytes
    readings: bytes
    parts: tuple[Measurement, ...]  # one for each reading
    counts: tuple[int, ...]  # how many parts each measurement has


class Encoder:
    """Codes steps for one motion model; a model and a noise that come again together are coded once."""

    def __init__(self, motion: VehicleMotion) -> None:
        self.motion = motion
        self._known: dict[tuple[int, int], tuple[Measurement, bytes]] = {}  # by identity; the value keeps both alive

    def step(self, step: Any, words: Sequence[int] | None, state: Sequence[int]) -> EncodedStep:
        """Return a step; ``words`` seed its generator, or else it has the state of one that exists."""
        parts: list[Measurement] = []
        counts: list[int] = []
        for measurement in step.measurements:
            of_one = measurement.parts()
            parts += of_one
            counts.append(len(of_one))
        dt_s = step.t1_s - step.t0_s
        relaxed = relaxation(self.motion, step.t0_s, dt_s)
        gap = relaxed is not None
        seeds = words if words is not None else (0, 0, 0, 0)
        packed = STEP.pack(dt_s, *(relaxed or NO_GAP), *state, *seeds, words is not None, gap, len(parts), 0)
        return EncodedStep(packed, b"".join(map(self._reading, parts)), tuple(parts), tuple(counts))

    def _reading(self, part: Measurement) -> bytes:
        both = id(part.model), id(part.noise)
        known = self._known.get(both)
        if known is None:
            if len(self._known) > 4096:  # fixed: bounds the memory; every fix has a model of its own
                self._known.clear()
            noise = noise_columns(part.noise.probabilities, part.noise.cov[:, None]).tobytes()
            coded = function_bytes(part.model, self.motion.layout, part.bilinear, part.held) + noise
            known = self._known[both] = (part, coded)
        z = part.z.tolist()
        ending = READING_END.pack(z[0], z[-1], len(part.noise.probabilities), FIXES.get(part.sensor, 0))
        return known[1] + ending


def can_encode(motion: VehicleMotion, kinds: Iterable[tuple[StateFunction, NoiseFamily]]) -> bool:
    """Return whether the kernel runs the motion, and has code for each sensor model and its noise."""
    names = motion.layout.names
    if type(motion) is not VehicleMotion or len(names) > MAX_STATES or not {*names} <= {*ARGUMENTS}:
        return False
    try:
        for model, family in kinds:
            function_bytes(model, motion.layout)
            noise = family.modes(np.eye(1)[None])
            noise_columns(noise.probabilities, noise.cov)
    except EncodingError:
        return False
    return True


def relaxation(motion: VehicleMotion, t0_s: float, dt_s: float) -> tuple[float, ...] | None:
    """Return what is left of u, v and r after a step, their usual values and added variances; None without a gap."""
    gaps = list(motion.relaxing(t0_s)) if dt_s else []
    if not gaps:
        return None
    rows = [*motion.layout.rows("u", "v", "r")]
    columns = np.array([np.ones(3), np.zeros(3), motion.walk_variance_per_s()[rows] * dt_s])
    for some, usual in gaps:
        columns[:, [rows.index(row) for row in some]] = usual.remaining(dt_s), usual.mean, usual.added_variance(dt_s)
    return tuple(columns.ravel().tolist())


def function_bytes(g: StateFunction, layout: StateLayout, bilinear: bool = False, held: Sequence[int] = ()) -> bytes:
    """Return the code of a measurement model; raises EncodingError for one that the kernel does not know."""
    nonlinear, linear = tuple(g.nonlinear), tuple(g.linear)
    if g.rows is not None:
        rows = tuple(range(g.rows.start, g.rows.stop))
        return _function(SELECTED, len(rows), (), rows, layout, angle=isinstance(g, DirectState) and g.angle)
    if type(g) is BodyVelocity:
        starboard, forward = g.arm_m
        axis_row = g.velocity_rows[g.axis]
        # without an angle error each axis depends on its own velocity and one component of the lever arm
        unused = () if g.mount_row is not None else (g.velocity_rows[1 - g.axis],)
        if g.mount_row is None and not (starboard if g.axis else forward):
            unused = (*unused, g.rate_row)
        assert axis_row in linear
        linear = tuple(row for row in linear if row not in unused)
        return _function(VELOCITY, 1, nonlinear, linear, layout, (0.0, starboard, forward), g.axis, bilinear=bilinear)
    if type(g) is ScaledVelocity:
        axis = g.velocity_row - layout.index("u")
        return _function(VELOCITY, 1, nonlinear, linear, layout, axis=axis, bilinear=bilinear)
    if type(g) is DeviatingCompass:
        return _function(COMPASS, 1, nonlinear, linear, layout, angle=True, held=held)
    if type(g) is UsblFix:
        numbers = (g.offset_s, *g.lever_m[:2])
        return _function(FIX, len(g.axes), nonlinear, linear, g.layout, numbers, g.axes[0], bilinear=bilinear)
    raise EncodingError(f"the kernel has no code for {type(g).__name__}")


def _function(
    kind: int,
    k: int,
    nonlinear: Sequence[int],
    linear: Sequence[int],
    layout: StateLayout,
    numbers: Sequence[float] = (),
    axis: int = 0,
    angle: bool = False,
    bilinear: bool = False,
    held: Sequence[int] = (),
) -> bytes:
    rows = (*nonlinear, *linear)
    if len(rows) > MAX_COLUMNS:
        raise EncodingError(f"a sensor model depends on {len(rows)} states; the kernel has room for {MAX_COLUMNS}")
    arguments = [ARGUMENTS.index(layout.names[row]) for row in rows]
    none = [0] * (MAX_COLUMNS - len(rows))
    numbers = (*numbers, *[0.0] * (4 - len(numbers)))
    uses = sum(1 << argument for argument in arguments)
    counts = (kind, k, len(nonlinear), len(rows))
    last = (axis, angle, bilinear, uses, sum(1 << row for row in held), 0)
    return FUNCTION.pack(*numbers, *counts, *arguments, *none, *rows, *none, *last)


def noise_columns(probabilities: Vector, cov: Array) -> NDArray[np.void]:
    """Return the code of J modes, their covariances (J, F, k, k) of one or two scalars in each of F measurements."""
    J, F = cov.shape[:2]
    if J > MAX_MODES:
        raise EncodingError(f"a noise family has {J} modes; the kernel has room for {MAX_MODES}")
    coded = np.zeros(F, KERNEL.structure("NoiseModes"))
    coded["probability"][:, :J] = probabilities
    coded["log_probability"][:, :J] = [math.log(p) if p > 0 else -math.inf for p in probabilities.tolist()]
    by_measurement = cov.swapaxes(0, 1)
    coded["R"][:, :J, 0], coded["R"][:, :J, 2] = by_measurement[..., 0, 0], by_measurement[..., -1, -1]
    if cov.shape[-1] == 2:
        coded["R"][:, :J, 1] = by_measurement[..., 0, 1]
    coded["nominal"][:, :J] = is_nominal(np.einsum("jfkk->jf", cov)).T
    return coded


def filter_bytes(
    motion: VehicleMotion,
    scale: float,
    update: int,
    particles: int = 1,
    resample_below: float = 0.0,
    move_steps: int = 0,
) -> bytes:
    """Return the code of a filter: its motion, sigma points, and how it updates (an index of layout.h)."""
    n, errors = len(motion.layout), motion.errors
    walk = motion.walk_variance_per_s().tolist()
    bias = motion.layout.existing("usbl_bias_east")
    walk += [0.0] * (MAX_STATES - n)
    bias_row = bias[0] if bias else -1
    numbers = (scale, resample_below, *walk, errors.usbl_bias_s, errors.usbl_bias_m**2)
    return FILTER.pack(*numbers, n, particles, update, move_steps, bias_row, 0)


def seed_words(*numbers: int) -> tuple[int, ...] | None:
    """Return the four words of 32 bits that seed the generator of (seed, epoch); None if there are more."""
    words: list[int] = []
    for number in numbers:
        words += [number >> 32 * i & 0xFFFFFFFF for i in range(word_count(number))]
    return None if len(words) > 4 else (*words, *[0] * (4 - len(words)))


def word_count(number: int) -> int:
    """Return how many words of 32 bits a number has."""
    return max(1, math.ceil(number.bit_length() / 32))


def generator_state(rng: np.random.Generator) -> tuple[int, ...]:
    """Return state and increment of a PCG64, in words of 64 bits; raises TypeError for another generator."""
    made = rng.bit_generator.state
    if made["bit_generator"] != "PCG64":
        raise TypeError("the kernel draws from PCG64, NumPy's default")
    both = made["state"]["state"], made["state"]["inc"]
    return tuple(number >> shift & 0xFFFFFFFFFFFFFFFF for number in both for shift in (64, 0))


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
    readings, row, time_s, is_first = np.empty(size, READINGS), np.zeros(size, np.int32), np.zeros(size), np.zeros(size)
    for one, first in zip(steps.readings, place, strict=True):
        for part in one.parts():
            at = first[part.readings] + part.place
            _bytes(readings)[at] = _bytes(_coded(one, part, motion.layout))
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
        _bytes(coded["g"])[:] = function_bytes(model, layout, one.bilinear, one.held)
    else:
        offset_s, axes = one.offset_s[rows], model.axes[scalars]
        for here in (offset_s == 0, offset_s != 0):  # a fix at the epoch itself may select states
            if here.any():
                model = replace(model, axes=axes, offset_s=float(offset_s[here.argmax()]))
                _bytes(coded["g"])[here] = function_bytes(model, layout, one.bilinear, one.held)
                if model.rows is None:
                    coded["g"]["number"][here, 0] = offset_s[here]
    noise = noise_columns(one.noise.probabilities, one.noise.cov[:, rows, scalars, scalars])
    _bytes(coded["noise"])[:] = _bytes(noise)
    coded["z"][:, 0], coded["z"][:, 1] = z[:, 0], z[:, -1]
    coded["modes"], coded["fix"] = len(one.noise.probabilities), FIXES.get(one.sensor, 0)
    return coded


def _bytes(structures: NDArray[np.void]) -> NDArray[np.void]:
    """Return a view without fields: NumPy copies it at once, and not field by field."""
    return structures.view(np.dtype((np.void, structures.dtype.itemsize)))
