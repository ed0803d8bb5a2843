"""The state of one true arm and of its SMR, and the observation of distances while the arms move."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from drivers.plant.clearance import Clearance, segment_distances
from drivers.plant.config import ArmConfig, Array
from drivers.plant.effect import Effect
from drivers.plant.lines import carry
from drivers.plant.mechanism import NO_DEFLECTION, Deflection, Mechanism, Posture
from drivers.plant.motion import AnyMotion


@dataclass(frozen=True, eq=False)
class Target:
    """An SMR at the current time: its arm, position (3,) [m] in M, and why the tracker cannot see it ("" if it can)."""

    arm: str
    p_M: Array
    hidden: str
    moving: bool


@dataclass(eq=False)
class TrueArm:
    """One true arm and its state."""

    config: ArmConfig
    mechanism: Mechanism
    T_C_B: Array
    T_M_B: Array
    gravity: Array  # acceleration of free fall in B
    effects: tuple[Effect, ...]
    repeatability: np.random.Generator
    q: Array  # (N,) at the last rest, or at the start of the current motion
    memories: list[Array | None]  # at that moment
    approach: Array
    last_step: Array
    stop_error: Array  # (N,) position error of the current stop
    rise: Array  # (N,) joint temperature above the air
    rest_since_s: float = 0.0
    motion: AnyMotion | None = None
    streamed: Array | None = None  # (N,) where a stream of positions last set its goal; None without a stream
    load_deflection: Deflection = NO_DEFLECTION  # last solution, the initial value of the next one
    resting: tuple[Array, Array] | None = None  # SMR and its viewing direction, of an arm at rest without effects


def largest_change(before: Deflection, after: Deflection) -> float:
    """Return the largest difference of two deflections [rad or m]."""
    largest = 0.0
    for name in ("joints", "base", "links", "tool"):
        old, new = getattr(before, name), getattr(after, name)
        if new is not None:
            largest = max(largest, float(np.abs(new if old is None else new - old).max(initial=0.0)))
    return largest


def watch(clearance: Clearance, arms: Sequence[TrueArm], times_s: Array, floor: float) -> None:
    """Update ``clearance`` with all capsules at some times (n,) of the current motions."""
    bodies = []
    for arm in arms:
        q = np.broadcast_to(arm.q, (len(times_s), arm.config.joints))
        if arm.motion is not None:
            q = arm.motion.position(times_s)
        ends = [carry(arm.T_C_B, end) for end in Posture(arm.mechanism, q, arm.gravity).segments()]
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
