"""One true arm and its SMR: their state, and the observation of distances while the arms move."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import takewhile

import numpy as np

from drivers.plant import effects as hidden
from drivers.plant.clearance import Clearance, segment_distances
from drivers.plant.config import ArmConfig, Array, PlantConfig
from drivers.plant.effect import PlantEffect
from drivers.plant.mechanism import (
    NO_DEFLECTION,
    STANDARD_GRAVITY,
    Deflection,
    Mechanism,
    Posture,
    nominal,
    with_errors,
    with_true_masses,
)
from drivers.plant.motion import LONGEST, AnyMotion, Phase
from drivers.plant.transforms import rigid, transform_points


@dataclass(frozen=True, eq=False)
class TrueTarget:
    """An SMR at the current time: its arm, position (3,) [m] in M, and why the tracker cannot see it ("" if it can).

    ``R_M_S`` (3, 3) is the orientation of a 6-D probe, which is measured with the standard deviation ``sigma_rad``
    about each axis. An SMR in a ``nest`` belongs to no arm.
    """

    arm: str | None
    p_M: Array
    hidden: str
    moving: bool = False
    R_M_S: Array | None = None
    sigma_rad: float = 0.0
    nest: str = ""

    @property
    def owner(self) -> str:
        """Its arm or nest, in words."""
        return f"nest {self.nest}" if self.arm is None else f"arm {self.arm}"


@dataclass(frozen=True, eq=False)
class Seen:
    """View of an arm for a tracker: position and viewing direction (3,) of its SMR in M, and orientation (3, 3) of a
    6-D probe."""

    p_M: Array
    normal_M: Array
    R_M_S: Array | None


@dataclass(eq=False)
class TrueArm:
    """One true arm and its state."""

    config: ArmConfig
    mechanism: Mechanism
    T_C_B: Array
    T_M_B: Array
    gravity: Array  # acceleration of free fall in B
    effects: tuple[PlantEffect, ...]
    repeatability: np.random.Generator
    q: Array  # (N,) at the last rest, or at the start of the current motion
    memories: list[Array | None]  # at that moment
    approach: Array
    last_step: Array
    stop_error: Array  # (N,) position error of the current stop
    rise: Array  # (N,) joint temperature above the air
    rest_since_s: float = 0.0
    motion: AnyMotion | None = None
    streamed: Array | None = None  # (N,) last goal of a stream of positions; None without a stream
    load_deflection: Deflection = NO_DEFLECTION  # last solution, start value of the next one
    resting: Seen | None = None  # cache for an arm at rest without effects
    trail: deque[Phase] = field(default_factory=lambda: deque(maxlen=LONGEST))  # recent history

    def phase(self, until_s: float) -> Phase:
        """Return the current phase, ending at ``until_s`` [s]."""
        return Phase(until_s, self.motion, self.q, self.memories, self.approach, self.last_step, self.rest_since_s)

    def note_phase(self, until_s: float) -> None:
        """Store the phase that ends at ``until_s`` [s]; call it before motion or memories change."""
        self.trail.append(self.phase(until_s))

    def joints_at(self, time_s: Array, now_s: float) -> tuple[Array, list[tuple[Phase, np.ndarray]]]:
        """Return joint positions (n, N) [rad] at recent times (n,), and the phases with the rows of their times."""
        first_s = float(np.min(time_s, initial=now_s))
        lasted = takewhile(lambda phase: phase.until_s >= first_s, reversed(self.trail))  # some ms out of a second
        phases = [self.phase(now_s), *lasted][::-1]
        number = np.searchsorted([phase.until_s for phase in phases[:-1]], time_s, side="left")
        q = np.empty((len(time_s), len(self.q)))
        known: list[tuple[Phase, np.ndarray]] = []
        for one in np.unique(number):
            phase, rows = phases[one], np.flatnonzero(number == one)
            q[rows] = phase.positions(time_s[rows])
            before, earlier = known[-1] if known else (None, rows)
            if before is not None and before.q is phase.q and (before.motion is None) == (phase.motion is None):
                known[-1] = before, np.concatenate([earlier, rows])
            else:
                known.append((phase, rows))
        return q, known

    def remembered(self, memories: Sequence[Array | None], q: Array) -> list[Array | None]:
        """Return the memories of the effects after a motion without reversal to ``q`` (n, N)."""
        return [one.memory_after_motion(memory, q) for one, memory in zip(self.effects, memories, strict=True)]

    def note_motion(self, q: Array) -> None:
        """Update the state after a motion without reversal to ``q`` (N,)."""
        step = q - self.q
        self.memories = self.remembered(self.memories, q[None])
        self.approach = np.where(step == 0.0, self.approach, np.sign(step))
        self.last_step, self.q = step, q

    def note_reversal(self, reversal: Array, after: Array) -> None:
        """Update the state of joints that reversed at ``reversal`` (N,); the other joints continue their motion."""
        step = reversal - self.q
        reverses = (after - reversal) * step < 0.0
        if reverses.any():
            at = np.where(reverses, reversal, self.q)
            self.memories = self.remembered(self.memories, at[None])
            self.approach = np.where(reverses, np.sign(step), self.approach)
            self.last_step, self.q = np.where(reverses, step, self.last_step), at


def largest_change(before: Deflection, after: Deflection) -> float:
    """Return the largest difference of two deflections [rad or m]."""
    largest = 0.0
    for name in ("joints", "base", "links", "tool"):
        old, new = getattr(before, name), getattr(after, name)
        if new is not None:
            largest = max(largest, float(np.abs(new if old is None else new - old).max(initial=0.0)))
    return largest


def watch(clearance: Clearance, arms: Sequence[TrueArm], times_s: Array, floor: float) -> None:
    """Update ``clearance`` with all capsules at given times (n,) of the current motions."""
    bodies = []
    for arm in arms:
        q = np.broadcast_to(arm.q, (len(times_s), arm.config.joints))
        if arm.motion is not None:
            q = arm.motion.position(times_s)
        ends = [transform_points(arm.T_C_B, end) for end in Posture(arm.mechanism, q, arm.gravity).segments()]
        radii = arm.mechanism.capsules.radii
        bodies.append((ends[0], ends[1], radii))
        # capsules of the base itself may touch the floor
        free = arm.mechanism.capsules.frames > 0
        heights = np.minimum(ends[0], ends[1])[free, :, 2] - radii[free, None] - floor
        clearance.update_floor(heights, times_s)
    for i, (a, b, r) in enumerate(bodies):
        for c, d, s in bodies[i + 1 :]:
            gaps = segment_distances(a[:, None], b[:, None], c[None], d[None]) - (r[:, None] + s)[..., None]
            clearance.update_arms(gaps, times_s)


def sample_true_arm(arm: ArmConfig, config: PlantConfig, T_M_C: Array, seed: np.random.SeedSequence) -> TrueArm:
    """Create the true arm of ``arm`` at rest in its home position, with errors sampled from ``seed``."""
    geometry, base, repeatability, masses = (np.random.default_rng(s) for s in seed.spawn(4))
    errors = config.errors
    effects = hidden.build(arm.name, arm.joints, arm.effects)
    sizes = np.repeat([errors.base_length, errors.base_angle], 3)
    T_C_B = arm.T_C_B @ rigid(sizes * base.standard_normal(6))
    assert arm.home is not None
    return TrueArm(
        config=arm,
        mechanism=with_true_masses(with_errors(nominal(arm), errors, geometry), errors.mass, masses),
        T_C_B=T_C_B,
        T_M_B=T_M_C @ T_C_B,
        gravity=T_C_B[:3, :3].T @ np.array([0.0, 0.0, -STANDARD_GRAVITY]),
        effects=effects,
        repeatability=repeatability,
        q=arm.home,
        memories=[effect.initial_memory(arm.home[None]) for effect in effects],
        approach=np.zeros(arm.joints),
        last_step=np.zeros(arm.joints),
        stop_error=config.repeatability * repeatability.standard_normal(arm.joints),
        rise=np.zeros(arm.joints),
    )
