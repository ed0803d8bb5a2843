"""Identify one case with cellapp: ``python -m tests.evidence.peering.drive_cellapp hayati|dh CASE_FOLDER ANSWER_FILE``.

The identification that ``cellapp calibrate`` uses, with its defaults; ``dh`` holds Hayati's angles at zero by priors,
which gives the model of plain D-H rows. One call lasts about a millisecond: it and ``numpy.linalg.lstsq`` with as many
equations and parameters are measured in turns; the medians are stated.
"""

from __future__ import annotations

import json
import sys
import time
from importlib.metadata import version
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from cellapp.estimation.calibration.identification import identify
from cellapp.robot.kinematics.chain import (
    Geometry,
    JointAngles,
    jacobian,
    nominal_geometry,
    parallel_rows,
    smr_positions,
)
from cellapp.robot.kinematics.transforms import Array

ROUNDS = 200
HELD_RAD = 1e-7
"""Prior that holds an angle: 0.1 um at arm's length."""


def start_geometry(rows: Array, tool: Array, T_M_B: Array) -> Geometry:
    """The arm of modified D-H rows (N, 4), whose alpha and a are those of the link before and zero in the first row."""
    alpha, a, theta, d = rows.T
    own = np.column_stack([theta, d, np.append(a[1:], 0.0), np.append(alpha[1:], 0.0)])
    return nominal_geometry(own, tool, T_M_B)


def main(model: str, folder: Path, answer: Path) -> None:
    """Identify, measure the time of both, predict the test positions."""
    nominal, readings = json.loads((folder / "nominal.json").read_text()), np.load(folder / "readings.npz")
    start = start_geometry(*(np.array(nominal[name]) for name in ("rows", "tool", "T_M_B")))
    q, p_M = readings["q"], readings["p_M"]
    priors = {f"beta{row + 1}": HELD_RAD for row in parallel_rows(start)} if model == "dh" else None
    found = identify(start, q, p_M, prior_sigma=priors)
    _, J = jacobian(start, JointAngles.of(q), found.parameter_set.columns)
    A, b = np.ascontiguousarray(J.transpose(0, 2, 1).reshape(-1, J.shape[1])), p_M.T.ravel()
    times = np.empty((ROUNDS, 3))
    for row in times:
        row[0] = time.perf_counter()
        identify(start, q, p_M, prior_sigma=priors)
        row[1] = time.perf_counter()
        np.linalg.lstsq(A, b, rcond=None)
        row[2] = time.perf_counter()
    seconds, floor_seconds = np.median(np.diff(times, axis=1), axis=0).tolist()
    told = {
        "version": version("cellapp"),
        "seconds": seconds,
        "floor_s": floor_seconds,
        "p_M": smr_positions(found.geometry, readings["q_test"]).tolist(),
        "parameters": len(found.names),
        "said": f"{found.iterations} iterations, {found.message}",
    }
    answer.write_text(json.dumps(told))


if __name__ == "__main__":
    with threadpool_limits(limits=1):
        main(sys.argv[1], Path(sys.argv[2]), Path(sys.argv[3]))
