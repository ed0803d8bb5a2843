"""Fixtures: two published arms, cells made of them, and a D-H chain for comparison."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from drivers.plant import ArmConfig, CapsuleConfig, Plant, PlantConfig, TrackerConfig, TrueErrors
from tests.arms import UR5, UR5_CENTERS, UR5_MASSES, UR10, UR10_CENTERS, UR10_MASSES, dh_frames

_TABLES = {"ur10": (UR10, UR10_MASSES, UR10_CENTERS), "ur5": (UR5, UR5_MASSES, UR5_CENTERS)}


def _capsules(a: np.ndarray) -> tuple[CapsuleConfig, ...]:
    return (
        CapsuleConfig(0, np.zeros(3), np.array([0.0, 0.0, 0.1]), 0.08),
        CapsuleConfig(2, np.zeros(3), np.array([-a[1], 0.0, 0.0]), 0.07),
        CapsuleConfig(3, np.zeros(3), np.array([-a[2], 0.0, 0.0]), 0.06),
        CapsuleConfig(6, np.zeros(3), np.array([0.0, 0.0, -0.1]), 0.05),
    )


@pytest.fixture(scope="session")
def make_arm() -> Callable[..., ArmConfig]:
    """``make_arm(kind, name, x, **changes)``: a UR10 or UR5 at x on a 0.5 m table, its SMR visible from everywhere."""

    def make(kind: str = "ur10", name: str = "left", x: float = 0.0, **changes: Any) -> ArmConfig:
        rows, masses, centers = _TABLES[kind]
        pose = np.eye(4)
        pose[:3, 3] = x, 0.0, 0.5
        values: dict[str, Any] = {
            "name": name,
            "rows": rows,
            "limits": np.tile([-2 * np.pi, 2 * np.pi], (6, 1)),
            "speed": np.full(6, 2.0),
            "acceleration": np.full(6, 3.0),
            "T_C_B": pose,
            "smr_offset": np.array([0.04, 0.03, 0.05]),
            "smr_normal": np.array([0.0, 0.0, 1.0]),
            "smr_acceptance": np.pi,
            "masses": masses,
            "centers_of_mass": centers,
            "capsules": _capsules(rows[:, 2]),
        }
        return ArmConfig(**(values | changes))

    return make


@pytest.fixture(scope="session")
def seven_joints(make_arm: Callable[..., ArmConfig]) -> ArmConfig:
    """An arm of seven joints whose masses are not known."""
    arm = make_arm()
    return replace(
        arm,
        rows=np.vstack([arm.rows, [0.0, 0.1, 0.0, 0.0]]),
        limits=np.vstack([arm.limits, [-1.0, 1.0]]),
        home=None,
        speed=np.ones(7),
        acceleration=np.ones(7),
        masses=np.zeros(7),
        centers_of_mass=np.zeros((7, 3)),
    )


@pytest.fixture(scope="session")
def make_config(make_arm: Callable[..., ArmConfig]) -> Callable[..., PlantConfig]:
    """``make_config(*arms, tracker={...}, **changes)``: a perfect, noiseless cell, the tracker 3 m away."""

    def make(*arms: ArmConfig, tracker: dict[str, Any] | None = None, **changes: Any) -> PlantConfig:
        pose = np.eye(4)
        pose[:3, 3] = 0.3, -3.0, 1.1
        values: dict[str, Any] = {
            "seed": 1,
            "arms": arms or (make_arm(),),
            "tracker": TrackerConfig(**({"T_C_M": pose} | (tracker or {}))),
            "errors": TrueErrors(),
            "noise": False,
        }
        return PlantConfig(**(values | changes))

    return make


@pytest.fixture(scope="session")
def make_plant(make_config: Callable[..., PlantConfig]) -> Callable[..., Plant]:
    """``make_plant(*arms, ...)``: the plant of ``make_config``."""

    def make(*arms: ArmConfig, **changes: Any) -> Plant:
        return Plant(make_config(*arms, **changes))

    return make


@pytest.fixture(scope="session")
def dh_smr() -> Callable[[PlantConfig, np.ndarray], np.ndarray]:
    """``dh_smr(config, q)``: SMR (n, 3) in M of the first arm of a perfect cell at ``q`` (n, N)."""

    def positions(config: PlantConfig, q: np.ndarray) -> np.ndarray:
        arm = config.arms[0]
        pose = np.linalg.inv(config.tracker.T_C_M) @ arm.T_C_B
        return np.asarray((pose @ dh_frames(arm.rows, q)[-1] @ np.append(arm.smr_offset, 1.0))[:, :3])

    return positions
