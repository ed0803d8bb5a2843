"""Readers of the exported files, written apart from ``cellapp``: each computes SMR positions from the text alone."""

from __future__ import annotations

import configparser
import csv
import json

import numpy as np
import pinocchio
import yaml
from numpy.typing import NDArray
from scipy.linalg import expm

Array = NDArray[np.float64]


def turn(axis: str, angle: Array | float) -> Array:
    """Rotations (n, 4, 4) about a coordinate axis."""
    angles = np.atleast_1d(np.asarray(angle, dtype=float))
    i, j = {"x": (1, 2), "y": (2, 0), "z": (0, 1)}[axis]
    T = np.tile(np.eye(4), (len(angles), 1, 1))
    T[:, i, i] = T[:, j, j] = np.cos(angles)
    T[:, j, i] = np.sin(angles)
    T[:, i, j] = -T[:, j, i]
    return T


def shift(x: float, y: float, z: float) -> Array:
    """A translation (4, 4)."""
    T = np.eye(4)
    T[:3, 3] = x, y, z
    return T


def rows_chain(rows: Array, q: Array) -> Array:
    """Flange poses (n, 4, 4) of rows theta, d, a, alpha and, where there is a fifth column, beta."""
    T = np.tile(np.eye(4), (len(q), 1, 1))
    for place, (theta, d, a, alpha, *beta) in enumerate(rows):
        T = T @ turn("z", q[:, place] + theta) @ shift(0, 0, d) @ shift(a, 0, 0) @ turn("x", alpha)
        for angle in beta:
            T = T @ turn("y", angle)
    return T


def points(T: Array, p: Array) -> Array:
    """A point (3,) of frames (n, 4, 4) in the outer frame, (n, 3)."""
    return T[:, :3, :3] @ np.asarray(p) + T[:, :3, 3]


def ur_table(text: str, published: Array) -> Array:
    """The D-H table (6, 4) of a UR controller with this calibration; ``published``: theta, d, a, alpha."""
    file = configparser.ConfigParser()
    file.read_string(text)
    lists = {key: json.loads(value) for key, value in file["mounting"].items()}
    deltas = np.array([lists[f"delta_{name}"] for name in ("theta", "d", "a", "alpha")]).T
    return published + deltas


def ur_controller(text: str, published: Array, smr: Array, q: Array) -> Array:
    """What a UR controller with this calibration computes, in its base frame."""
    return points(rows_chain(ur_table(text, published), q), smr)


def ur_description(text: str, smr: Array, q: Array) -> Array:
    """Positions in the controller's base by UR's ROS description, from YAML of two levels read line by line."""
    links: dict[str, dict[str, float]] = {}
    for line in text.splitlines():
        key, _, value = line.strip().partition(": ")
        if line.startswith("    "):
            links[list(links)[-1]][key] = float(value)
        elif line.startswith("  ") and line.endswith(":"):
            links[key.rstrip(":")] = {}
    T = np.tile(np.eye(4), (len(q), 1, 1))
    names = ("shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3")
    for place, name in enumerate(names):
        at = links[name]
        T = T @ shift(at["x"], at["y"], at["z"]) @ turn("z", at["yaw"]) @ turn("y", at["pitch"]) @ turn("x", at["roll"])
        T = T @ turn("z", q[:, place])
    return points(T, smr)


def urdf(text: str, name: str, q: Array) -> Array:
    """Positions in the tracker frame by pinocchio."""
    model = pinocchio.buildModelFromXML(text)
    data = model.createData()
    joints = [model.joints[model.getJointId(f"{name}_joint_{i + 1}")].idx_q for i in range(q.shape[1])]
    frame = model.getFrameId(f"{name}_smr")
    found = np.empty((len(q), 3))
    placed = np.zeros(model.nq)
    for row, one in enumerate(q):
        placed[joints] = one
        pinocchio.framesForwardKinematics(model, data, placed)
        found[row] = data.oMf[frame].translation
    return found


def dh(text: str, q: Array) -> Array:
    """Positions in the tracker frame by a D-H table, with or without beta."""
    table = yaml.safe_load(text)
    rows = np.array([list(row.values()) for row in table["rows"]])
    return points(np.array(table["T_M_B"]) @ rows_chain(rows, q), table["tool"])


def poe(text: str, q: Array) -> Array:
    """Positions in the tracker frame by a product of matrix exponentials."""
    table = yaml.safe_load(text)
    T = np.tile(np.array(table["T_M_B"]), (len(q), 1, 1))
    for place, screw in enumerate(table["screws"]):
        (x, y, z), v = screw["omega"], screw["v"]
        twist = np.zeros((4, 4))
        twist[:3, :3], twist[:3, 3] = [[0, -z, y], [z, 0, -x], [-y, x, 0]], v
        T = T @ expm(twist * q[:, place, None, None])
    return points(T @ np.array(table["T_B_F_at_zero"]), table["tool"])


def parameters(text: str, q: Array) -> Array:
    """Positions in the tracker frame by the list of parameters."""
    lines = [line for line in text.splitlines() if not line.startswith("#")]
    value = {row["parameter"]: float(row["identified"]) for row in csv.DictReader(lines)}
    names = ("theta", "d", "a", "alpha", "beta")
    rows = np.array([[value[f"{name}{i + 1}"] for name in names] for i in range(q.shape[1])])
    base = shift(value["x0"], value["y0"], 0) @ turn("x", value["alpha0"]) @ turn("y", value["beta0"])
    base = base @ shift(0, 0, value["z0"]) @ turn("z", value["theta0"])
    return points(base @ rows_chain(rows, q), np.array([value["tx"], value["ty"], value["tz"]]))
