"""A plain controller: runs a program and solves its poses by the published table. It shares no code with cellapp.

The interpreter knows as much of URScript as the programs of these tests: assignments, arithmetic, the pose functions,
calls of functions, ``while`` with a counter, and motions.
"""

from __future__ import annotations

import ast
import re
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from tests.arms import dh_frames

Array = NDArray[np.float64]


class Pose(tuple[float, ...]):
    """A pose, told apart from a list of joint positions."""


def matrix(pose: Any) -> Array:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = Rotation.from_rotvec(pose[3:]).as_matrix(), pose[:3]
    return T


def pose_of(T: NDArray[Any]) -> Pose:
    return Pose((*T[:3, 3], *Rotation.from_matrix(T[:3, :3]).as_rotvec()))


def forward(rows: Array, q: Any) -> Array:
    """Flange pose (4, 4) of D-H rows (6, 4): theta, d, a, alpha."""
    return dh_frames(rows, q)[-1]


@dataclass
class PlainController:
    """Runs programs; ``reached`` are the joint positions at the end of each motion, ``at`` the TCP poses asked for."""

    rows: Array
    q: Array
    tcp: Array = field(default_factory=lambda: np.eye(4))
    reached: list[Array] = field(default_factory=list)
    tcps: list[Array] = field(default_factory=list)

    def inverse(self, pose: Any, near: Any = None) -> list[float]:
        """The solution that the least change leads to from ``near``, else from the present joint positions."""
        wanted = matrix(pose) @ np.linalg.inv(self.tcp)
        start = self.q if near is None else np.array(near)

        def off(q: Array) -> Array:
            T = forward(self.rows, q)
            rotation = Rotation.from_matrix(T[:3, :3].T @ wanted[:3, :3]).as_rotvec()
            return np.concatenate([T[:3, 3] - wanted[:3, 3], rotation])

        found = least_squares(off, start, xtol=1e-15, ftol=1e-15, gtol=1e-15)
        assert np.abs(found.fun).max() < 1e-9, f"the controller does not reach {pose}"
        return [float(angle) for angle in found.x]

    def move(self, target: Any) -> None:
        q = self.inverse(target) if isinstance(target, Pose) else list(target)
        self.q = np.array(q)
        self.reached.append(self.q)
        self.tcps.append(self.tcp)

    def run(self, program: str) -> list[Array]:
        """Run a program by way of Python; the joint positions at the end of each motion."""
        code, depth = [], 0
        for line in program.splitlines():
            words = re.sub(r"#.*", "", line).strip()
            words = re.sub(r"^(global|local)\s+", "", words)
            words = re.sub(r"\bp\[([^\]]*)\]", r"Pose([\1])", words)
            words = re.sub(r"^thread (\w+)", r"def \1", words)
            words = re.sub(r"^run (\w+)", r"\1", words)
            if words == "end":
                depth -= 1
            elif words and not words.startswith("$"):
                outer = words.startswith(("elif", "else"))
                code.append("  " * (depth - outer) + words)
                depth += words.endswith(":") and not outer
                if words.startswith("def "):
                    code.append("  " * depth + "global " + ", ".join(self._assigned(program)))
        ast.parse("\n".join(code))
        exec("\n".join(code), self._functions())
        return self.reached

    @staticmethod
    def _assigned(program: str) -> list[str]:
        return sorted(set(re.findall(r"^\s*(?:global |local )?(\w+)\s*=[^=]", program, re.M))) or ["_"]

    def _functions(self) -> dict[str, Any]:
        def set_tcp(pose: Any) -> None:
            self.tcp = matrix(pose)

        def movec(via: Any, to: Any, **_: Any) -> None:
            self.move(Pose((*via[:3], *to[3:])))
            self.move(to)

        def moves(target: Any, *_: Any, **__: Any) -> None:
            self.move(target)

        def nothing(*_: Any, **__: Any) -> None:
            return None

        return {
            "Pose": Pose,
            "movej": moves,
            "movel": moves,
            "movep": moves,
            "movec": movec,
            "set_tcp": set_tcp,
            "get_inverse_kin": lambda x, qnear=None, *_: self.inverse(x, qnear),
            "pose_trans": lambda a, b: pose_of(matrix(a) @ matrix(b)),
            "pose_inv": lambda a: pose_of(np.linalg.inv(matrix(a))),
            "pose_add": lambda a, b: pose_of(_added(matrix(a), matrix(b))),
            "d2r": np.radians,
            "textmsg": nothing,
            "sleep": nothing,
            "set_payload": nothing,
        }


def _added(one: Array, other: Array) -> Array:
    T = one.copy()
    T[:3, :3], T[:3, 3] = one[:3, :3] @ other[:3, :3], one[:3, 3] + other[:3, 3]
    return T
