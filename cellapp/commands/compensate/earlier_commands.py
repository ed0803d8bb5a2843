"""Commands that a run has computed before: a target that stands where one of them does would be corrected twice."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from cellapp.cell.run import RunFile
from cellapp.cell.targets.goals import goals_of_arm
from cellapp.cell.targets.targets import Target
from cellapp.commands.stages import json_object, read_history
from cellapp.ground.errors import InputError
from cellapp.ground.results import COMPENSATE, PUSH, VERIFY
from cellapp.robot.kinematics.chain import Geometry, flange_poses, smr_positions
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.model import CellModel

_SAME_M, _SAME_RAD = 1e-5, 1e-4
"""Largest distance between a command and the same typed as a pendant shows it, to 0.01 mm and 0.0001 rad."""


def refuse_corrected_targets(run: RunFile, model: CellModel, targets: Sequence[Target]) -> None:
    """Raise ``InputError`` if a target was typed from an earlier command of the run."""
    for name, arm in model.arms.items():
        goals = goals_of_arm(model, targets, name)
        words = [f"target '{targets[k].name}'" for k in goals.rows]
        refuse_corrected(run, name, arm.nominal, words, goals.nominal_rotation_M, goals.nominal_position_M)


def refuse_corrected(run: RunFile, name: str, chain: Geometry, words: Sequence[str], R: Array, p: Array) -> None:
    """Raise ``InputError`` if a pose is that of ``chain`` at an earlier command of arm ``name``, and not as taught.

    ``R`` (n, 3, 3), NaN where any rotation will do, and ``p`` (n, 3) [m] are of the flange and of the chain's tool.
    """
    taught, sent = list[list[float]](), list[list[float]]()
    for stage in read_history(run):
        stored: Any = json_object(stage.text) if stage.name in (COMPENSATE, PUSH, VERIFY) else None
        for one in (stored or {}).get("targets", ()):
            if one.get("arm") == name:
                taught += [one["q_nominal"]] if one.get("q_nominal") else []
                sent += [q for q in (one.get("q_compensated"), one.get("q_corrected")) if q]
    for k in np.flatnonzero(_stands(chain, sent, R, p) & ~_stands(chain, taught, R, p)).tolist():
        raise InputError(
            f"{words[k]} of arm '{name}' stands where a command that this run computed for an earlier target does: it"
            " is corrected already and would be corrected twice. Give the target as it was taught"
        )


def _stands(chain: Geometry, q: Sequence[Sequence[float]], R: Array, p: Array) -> NDArray[np.bool_]:
    """Return whether each pose is that of the chain at one of ``q``."""
    if not q or not len(p):
        return np.zeros(len(p), dtype=np.bool_)
    exact = np.array(q)
    exact = np.concatenate([exact, np.radians(np.degrees(exact).round(2))])  # as a pendant shows joint positions
    at, rotated = smr_positions(chain, exact), flange_poses(chain, exact)[0]
    near = scipy.spatial.cKDTree(at).query_ball_point(p, _SAME_M)
    off = [np.linalg.norm(rotated[rows] - R[k], axis=(1, 2)) for k, rows in enumerate(near)]
    return np.array([bool(np.any(~(one > np.sqrt(2.0) * _SAME_RAD))) for one in off])
