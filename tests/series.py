"""Readings: of what a test states, and series of the simulated cell at many stops, without driving its arms."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cellapp.cell.driving.cell import build_plant
from cellapp.cell.planning.plan import sample_stops
from cellapp.cell.safety.cell_bodies import cell_bodies
from cellapp.estimation.readings import Readings
from cellapp.ground.profile import Profile
from cellapp.robot.kinematics.chain import flange_poses
from cellapp.robot.model.nominal import nominal_arm
from tests.twin import altered, whole_twin

Array = NDArray[np.float64]
_POOL = 600


def twin() -> Profile:
    """The twin with its hidden effects."""
    return whole_twin()


def readings_at(
    q: Array, p_M: Array, *, approach: Any = 0, time_s: Any = None, split: Any = None, **more: Any
) -> Readings:
    """Readings at joint positions (n, N) [rad] of points (n, 3) [m], numbered as they come.

    ``approach`` is broadcast to all joints; without ``time_s`` times are unknown; ``more`` are other fields, numbers
    those of all readings. ``split`` are words, or every how manyth reading is held out: the last of each group.
    """
    n = len(q)
    if isinstance(split, int):
        split = ["validate" if k % split == split - 1 else "identify" for k in range(n)]
    others: dict[str, Any] = {name: np.full(n, one) if isinstance(one, float) else one for name, one in more.items()}
    return Readings(
        configuration=np.arange(n),
        time_s=np.full(n, np.nan) if time_s is None else time_s,
        q=q,
        approach=np.broadcast_to(approach, q.shape).astype(np.int8),
        p_M=p_M,
        split=None if split is None else tuple(split),
        **others,
    )


@lru_cache(maxsize=1)
def _pool() -> Mapping[str, Array]:
    return sample_stops(cell_bodies(twin()), twin(), _POOL, np.random.default_rng(99))


@dataclass(frozen=True)
class Series:
    """Readings of one arm: joint positions (n, N), true and measured SMR (n, 3), covariances (n, 3, 3), in M; and the
    flange's rotations (n, 3, 3)."""

    q: Array
    true_M: Array
    p_M: Array
    covariance_M: Array
    R_M_F: Array


def series(
    seed: int, count: int, *, shift: Mapping[str, Array] | None = None, short_ways: bool = False
) -> dict[str, Series]:
    """Readings of both arms at ``count`` stops of a twin drawn with ``seed``; ``shift`` (n, 3) [m] is added to points.

    Each joint's approach follows from the order of the stops: random, or by ``short_ways`` of joint 1 of the left arm
    in four turns over its range, as a plan visits them.
    """
    rng = np.random.default_rng([seed, 77])
    profile = twin()
    plant = build_plant(altered(profile, plant={"seed": seed}))
    rows = rng.permutation(_POOL)[:count]
    if short_ways:
        rotations = np.array_split(rows, 4)
        rows = np.concatenate([rotation[np.argsort(_pool()["left"][rotation, 0])] for rotation in rotations])
    q = {name: stops[rows] for name, stops in _pool().items()}
    found = {}
    for name in q:
        step = np.diff(q[name], axis=0, prepend=0.0)
        others = {other: q[other] for other in q if other != name}
        true = plant.smr_positions(name, q[name], others=others, last_step=step)
        if shift is not None and name in shift:
            true = true + shift[name]
        p_M, covariance = plant.measure_positions(true, rng)
        geometry = nominal_arm(profile.arms[name]).with_T_M_B(plant.true_T_M_B(name))
        found[name] = Series(q[name], true, p_M, covariance, flange_poses(geometry, q[name])[0])
    return found
