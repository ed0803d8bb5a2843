"""Identification problems with known truth, written for every solver into the same two files.

A UR10 with Craig's modified D-H rows (alpha and a of the row before, then theta and d of the own). Every row value, the
tool and the base deviate from nominal. Joints are uniform over one turn each way, and every SMR position is measured.

- Case ``mdh``: lengths deviate by 0.3 mm, angles by 0.1 deg (standard deviations), tool coordinates by 2 mm. The base
  stands 3 m away, turned by up to 3 rad about the tracker's z axis and tilted by up to 0.3 rad.
- Case ``hayati``: besides, the parallel axes 2, 3 and 4 are turned by 0.1 deg against each other about y, which D-H
  rows cannot hold (Hayati, Mirmirani, J. Robotic Systems 2 (1985) 397).
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]

CASES = ("mdh", "hayati")
TEST_POSES = 100
NOISE_M = 15e-6
"""Standard deviation of a measured coordinate: a laser tracker at 3 m."""
_LENGTH_M, _ANGLE_RAD, _TOOL_M = 0.3e-3, math.radians(0.1), 2e-3
_PARALLEL_ROWS = (2, 3)
"""Rows, from 0, whose axis is parallel to the one before: the pairs 2-3 and 3-4."""
_RIGHT = math.pi / 2.0
_ALPHA = (0.0, _RIGHT, 0.0, 0.0, _RIGHT, -_RIGHT)
_A = (0.0, 0.0, -0.612, -0.5723, 0.0, 0.0)
_D = (0.1273, 0.0, 0.0, 0.163941, 0.1157, 0.0922)
NOMINAL_ROWS = np.column_stack([_ALPHA, _A, np.zeros(6), _D])
"""alpha [rad], a [m], theta [rad], d [m] of each row, shape (6, 4): the published table of a UR10."""
NOMINAL_TOOL = np.array([0.045, 0.020, 0.060])
"""SMR centre on the flange [m]."""


@dataclass(frozen=True)
class Case:
    """A problem and its solution.

    Attributes
    ----------
    q, p_M : array, shape (n, 6) [rad] and (n, 3) [m]
        Configurations and measured SMR positions in the tracker frame.
    q_test, p_test_M : array, shape (m, 6) [rad] and (m, 3) [m]
        Other configurations, and the true positions there.
    T_M_B : array, shape (4, 4)
        Base that fits the nominal arm best to the measured points: the start of every solver.
    """

    name: str
    q: Array
    p_M: Array
    q_test: Array
    p_test_M: Array
    T_M_B: Array


def make_case(name: str, configurations: int, seed: int) -> Case:
    """The case ``mdh`` or ``hayati`` with a number of configurations."""
    rng = np.random.default_rng([seed, configurations])
    size = np.array([_ANGLE_RAD, _LENGTH_M, _ANGLE_RAD, _LENGTH_M])
    rows = NOMINAL_ROWS + rng.normal(size=(6, 4)) * size
    tool = NOMINAL_TOOL + rng.normal(0.0, _TOOL_M, 3)
    beta = np.zeros(6)
    rotated = rng.normal(0.0, _ANGLE_RAD, len(_PARALLEL_ROWS))  # drawn in both cases, so that these differ in beta only
    if name == "hayati":
        beta[list(_PARALLEL_ROWS)] = rotated
    T_M_B = np.eye(4)
    T_M_B[:3, :3] = Rotation.from_euler("ZYX", rng.uniform([-3.0, -0.3, -0.3], [3.0, 0.3, 0.3])).as_matrix()
    direction = rng.uniform(-math.pi, math.pi)
    T_M_B[:3, 3] = 3.0 * math.cos(direction), 3.0 * math.sin(direction), rng.uniform(-1.0, 0.0)
    q, q_test = rng.uniform(-math.pi, math.pi, (configurations, 6)), rng.uniform(-math.pi, math.pi, (TEST_POSES, 6))
    p_M = positions(rows, beta, tool, T_M_B, q) + rng.normal(0.0, NOISE_M, (configurations, 3))
    start = registered(p_M, positions(NOMINAL_ROWS, np.zeros(6), NOMINAL_TOOL, np.eye(4), q))
    return Case(name, q, p_M, q_test, positions(rows, beta, tool, T_M_B, q_test), start)


def positions(rows: Array, beta: Array, tool: Array, T_M_B: Array, q: Array) -> Array:
    """SMR positions (n, 3) [m] at ``q`` (n, 6): rot_x(alpha) rot_y(beta) trans(a, 0, 0) rot_z(q + theta) trans(0, 0, d)
    for each row.
    """
    R, p = T_M_B[:3, :3], np.tile(T_M_B[:3, 3], (len(q), 1))
    for (alpha, a, theta, d), turn, joint in zip(rows, beta, q.T, strict=True):
        R = R @ Rotation.from_euler("XY", [alpha, turn]).as_matrix()
        p = p + a * R[..., 0]
        R = R @ Rotation.from_rotvec(np.outer(joint + theta, [0.0, 0.0, 1.0])).as_matrix()
        p = p + d * R[..., 2]
    return p + R @ tool


def registered(p_A: Array, p_B: Array) -> Array:
    """Rigid transform (4, 4) that maps points ``p_B`` (n, 3) onto ``p_A`` (n, 3) in least squares."""
    center_A, center_B = p_A.mean(axis=0), p_B.mean(axis=0)
    T = np.eye(4)
    T[:3, :3] = Rotation.align_vectors(p_A - center_A, p_B - center_B)[0].as_matrix()
    T[:3, 3] = center_A - T[:3, :3] @ center_B
    return T


def write_case(case: Case, folder: Path) -> None:
    """Write what a solver may know: ``nominal.json``, ``readings.npz`` and ``nominal.urdf``; not the true positions."""
    folder.mkdir(parents=True, exist_ok=True)
    nominal = {"rows": NOMINAL_ROWS.tolist(), "tool": NOMINAL_TOOL.tolist(), "T_M_B": case.T_M_B.tolist()}
    (folder / "nominal.json").write_text(json.dumps(nominal), encoding="utf-8")
    np.savez(folder / "readings.npz", q=case.q, p_M=case.p_M, q_test=case.q_test)
    (folder / "nominal.urdf").write_text(nominal_urdf(), encoding="utf-8")


def nominal_urdf() -> str:
    """The nominal arm as URDF: joints ``joint1`` to ``joint6`` about z, the SMR as the link ``smr``."""
    links = ["base", *(f"link{i}" for i in range(1, 7)), "smr"]
    parts = [f'<link name="{name}"/>' for name in links]
    for i, (alpha, a, _, d) in enumerate(NOMINAL_ROWS.tolist(), start=1):
        origin = f"{a!r} {-d * math.sin(alpha)!r} {d * math.cos(alpha)!r}"
        parts.append(
            f'<joint name="joint{i}" type="revolute"><parent link="{links[i - 1]}"/><child link="{links[i]}"/>'
            f'<origin xyz="{origin}" rpy="{alpha!r} 0 0"/><axis xyz="0 0 1"/>'
            '<limit lower="-6.3" upper="6.3" effort="1" velocity="1"/></joint>'
        )
    tool = " ".join(repr(value) for value in NOMINAL_TOOL.tolist())
    parts.append(
        '<joint name="smr_holder" type="fixed"><parent link="link6"/><child link="smr"/>'
        f'<origin xyz="{tool}" rpy="0 0 0"/></joint>'
    )
    return '<robot name="ur10">\n' + "\n".join(parts) + "\n</robot>\n"
