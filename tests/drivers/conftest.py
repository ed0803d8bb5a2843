"""Fixtures: two published arms, cells made of them, and a D-H chain for comparison."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from drivers.plant import ArmConfig, CapsuleConfig, Plant, PlantConfig, TrackerConfig, TrueErrors

_ALPHA = [np.pi / 2, 0.0, 0.0, np.pi / 2, -np.pi / 2, 0.0]
_TABLES: dict[str, dict[str, Any]] = {
    "ur10": {
        "d": [0.1273, 0, 0, 0.163941, 0.1157, 0.0922],
        "a": [0, -0.612, -0.5723, 0, 0, 0],
        "masses": [7.1, 12.7, 4.27, 2.0, 2.0, 0.365],
        "centers": [
            [0.021, 0, 0.027],
            [0.38, 0, 0.158],
            [0.24, 0, 0.068],
            [0, 0.007, 0.018],
            [0, 0.007, 0.018],
            [0, 0, -0.026],
        ],
    },
    "ur5": {
        "d": [0.089159, 0, 0, 0.10915, 0.09465, 0.0823],
        "a": [0, -0.425, -0.39225, 0, 0, 0],
        "masses": [3.7, 8.393, 2.33, 1.219, 1.219, 0.1879],
        "centers": [
            [0, -0.02561, 0.00193],
            [0.2125, 0, 0.11336],
            [0.15, 0, 0.0265],
            [0, -0.0018, 0.01634],
            [0, 0.0018, 0.01634],
            [0, 0, -0.001159],
        ],
    },
}


def _capsules(a: list[float]) -> tuple[CapsuleConfig, ...]:
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
        table = _TABLES[kind]
        pose = np.eye(4)
        pose[:3, 3] = x, 0.0, 0.5
        values: dict[str, Any] = {
            "name": name,
            "rows": np.column_stack([np.zeros(6), table["d"], table["a"], _ALPHA]),
            "limits": np.tile([-2 * np.pi, 2 * np.pi], (6, 1)),
            "speed": np.full(6, 2.0),
            "acceleration": np.full(6, 3.0),
            "T_C_B": pose,
            "smr_offset": np.array([0.04, 0.03, 0.05]),
            "smr_normal": np.array([0.0, 0.0, 1.0]),
            "smr_acceptance": np.pi,
            "masses": np.array(table["masses"]),
            "centers_of_mass": np.array(table["centers"]),
            "capsules": _capsules(table["a"]),
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
def dh_frames() -> Callable[[np.ndarray, np.ndarray], list[np.ndarray]]:
    """``dh_frames(rows, q)``: frames 0 to N of a D-H chain at one ``q`` (N,), entry by entry."""

    def frames(rows: np.ndarray, q: np.ndarray) -> list[np.ndarray]:
        chain = [np.eye(4)]
        for (theta, d, a, alpha), angle in zip(rows, q):
            c, s, ca, sa = np.cos(angle + theta), np.sin(angle + theta), np.cos(alpha), np.sin(alpha)
            step = [[c, -s * ca, s * sa, a * c], [s, c * ca, -c * sa, a * s], [0, sa, ca, d], [0, 0, 0, 1]]
            chain.append(chain[-1] @ np.array(step))
        return chain

    return frames


@pytest.fixture(scope="session")
def dh_smr(dh_frames: Callable[..., list[np.ndarray]]) -> Callable[[PlantConfig, np.ndarray], np.ndarray]:
    """``dh_smr(config, q)``: SMR (n, 3) in M of the first arm of a perfect cell at ``q`` (n, N)."""

    def positions(config: PlantConfig, q: np.ndarray) -> np.ndarray:
        arm = config.arms[0]
        pose = np.linalg.inv(config.tracker.T_C_M) @ arm.T_C_B
        smr = np.append(arm.smr_offset, 1.0)
        return np.array([(pose @ dh_frames(arm.rows, row)[-1] @ smr)[:3] for row in q])

    return positions
