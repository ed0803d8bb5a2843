"""A simulated Panda that is led by hand with a ball in sockets: readings of the plant, whose truth is known."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cellapp.cell.driving.cell import build_plant
from cellapp.cell.profile import load_profile
from cellapp.estimation.readings import Distance, Readings
from cellapp.ground.profile import Profile
from cellapp.ground.profile.schema import GeometryErrors, Pose
from cellapp.ground.profile.schema import Plant as PlantSettings
from drivers.plant import Plant
from drivers.plant.sockets import touches

Array = NDArray[np.float64]
PROFILE = Path(__file__).parents[3] / "profiles" / "panda-sockets.yaml"
SEATING_M = 3e-5
BALL = (0.0, 0.004, 0.14)
HOME = np.array([0.0, -0.3, 0.0, -2.0, 0.0, 1.9, 0.6])
PLACES = np.array([[0.45, 0.25, 0.15], [0.45, -0.25, 0.15], [0.6, 0.0, 0.35], [0.3, 0.35, 0.4], [0.35, -0.3, 0.5]])
ELASTIC: dict[str, dict[str, Any]] = {"joint_compliance": {"stiffness": [3e4, 8e3, 6e3, 5e3, 5e3, 5e3, 5e3]}}


@functools.cache
def panda() -> Profile:
    """The profile of an arm with sockets: no tracker, the ball unknown."""
    return load_profile(PROFILE)


def plant_of(seed: int, effects: dict[str, dict[str, Any]] | None = None) -> Plant:
    """The true arm, with the errors of an industrial one."""
    profile = panda()
    arm = profile.arms["left"]
    smr = arm.smr.model_copy(update={"offset": BALL})
    arm = arm.model_copy(update={"base": Pose(position=(0.0, 0.0, 0.0)), "smr": smr})
    errors = GeometryErrors(length=3e-4, angle=1e-3, base_length=0.0, base_angle=0.0, smr=2e-3)
    plant = PlantSettings(seed=seed, geometry=errors, effects={"left": effects or {}}, noise=False)
    tracker = profile.tracker.model_copy(update={"pose": Pose(position=(0.0, 0.0, 0.0))})
    return build_plant(profile.model_copy(update={"arms": {"left": arm}, "plant": plant, "tracker": tracker}))


@dataclass(frozen=True, eq=False)
class Led:
    """The true arm and what was recorded of it."""

    plant: Plant
    readings: Readings

    def true(self, q: Array) -> Array:
        """Ball centres (n, 3) [m] at these readings of the joints."""
        return self.plant.smr_positions("left", q, approach=np.zeros_like(q))


@functools.cache
def led(
    seed: int, *, elastic: bool = False, each: int = 25, gauge_m: float = 0.05, held_out: tuple[int, ...] = (4,)
) -> Led:
    """Two sockets at each place, ``gauge_m`` apart and known to be so; the last place is held out."""
    plant = plant_of(seed, ELASTIC if elastic else None)
    rng = np.random.default_rng([seed, 3])
    q, points, splits, distances = [], [], [], []
    for place, centre in enumerate(PLACES):
        direction = rng.normal(size=3) * [1.0, 1.0, 0.3]
        direction *= gauge_m / np.linalg.norm(direction)
        for socket, at in enumerate((centre, centre + direction)):
            there = _touched(plant, at, each, rng)
            q.append(there)
            points += [f"place{place}_{socket}"] * len(there)
            splits += ["validate" if place in held_out else "identify"] * len(there)
        distances.append(Distance(f"place{place}_0", f"place{place}_1", gauge_m, 2e-5))
    return Led(plant, readings_of(np.concatenate(q), points, splits, distances))


def _touched(plant: Plant, at: Array, count: int, rng: np.random.Generator) -> Array:
    found: list[Array] = []
    while sum(map(len, found)) < count:
        starts = HOME + rng.uniform(-1.2, 1.2, (count, 7))
        found.append(touches(plant, "left", at, starts, seating_m=SEATING_M, rng=rng))
    return np.concatenate(found)[:count]


def readings_of(q: Array, points: Sequence[str], splits: Sequence[str], distances: Sequence[Distance] = ()) -> Readings:
    """Readings in sockets."""
    return Readings(
        configuration=np.arange(len(q)),
        time_s=np.full(len(q), np.nan),
        q=q,
        approach=np.zeros(q.shape, dtype=np.int8),
        p_M=np.full((len(q), 3), np.nan),
        point=tuple(points),
        split=tuple(splits),
        distances=tuple(distances),
    )
