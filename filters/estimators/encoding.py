"""Steps and measurements as the bytes that the compiled kernel reads: the structures of kernel/layout.h.

A function of the state is coded by its kind, its numbers, and the states that it depends on, nonlinear ones first.
Here a step is coded alone, as late fixes and a loop of one's own have it; encoded_columns.py codes many at once.
"""

import math
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from usbldr.filters.kernel import KERNEL
from usbldr.filters.models.motion import VehicleMotion
from usbldr.filters.models.noise import NoiseFamily, is_nominal
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
from usbldr.filters.types import Array, Vector

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
            coded = function_bytes(part.model, self.motion.layout, part.bilinear) + noise
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
            function_bytes(model, motion.layout, bilinear=False)
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


def function_bytes(g: StateFunction, layout: StateLayout, bilinear: bool) -> bytes:
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
        return _function(COMPASS, 1, nonlinear, linear, layout, angle=True, bilinear=bilinear)
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
) -> bytes:
    rows = (*nonlinear, *linear)
    if len(rows) > MAX_COLUMNS:
        raise EncodingError(f"a sensor model depends on {len(rows)} states; the kernel has room for {MAX_COLUMNS}")
    arguments = [ARGUMENTS.index(layout.names[row]) for row in rows]
    none = [0] * (MAX_COLUMNS - len(rows))
    numbers = (*numbers, *[0.0] * (4 - len(numbers)))
    uses = sum(1 << argument for argument in arguments)
    counts = (kind, k, len(nonlinear), len(rows))
    return FUNCTION.pack(*numbers, *counts, *arguments, *none, *rows, *none, axis, angle, bilinear, uses)


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
