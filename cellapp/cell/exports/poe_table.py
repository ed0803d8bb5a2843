"""Export the calibrated chain as a product of exponentials, as YAML."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cellapp.cell.exports.arm_export import ArmExport
from cellapp.cell.exports.export_format import ExportFormat
from cellapp.cell.exports.yaml_table import matrix_rows, yaml_table
from cellapp.robot.kinematics.chain import frame_poses
from cellapp.robot.kinematics.transforms import transform

_CHAIN = "T_M_S = T_M_B exp([S_1] q_1) ... exp([S_N] q_N) T_B_F_at_zero trans(tool); S = (omega, v) in the base frame"


def poe(export: ArmExport, sentences: Sequence[str]) -> str:
    """Return screw axes in the base frame at zero, and the home pose of the flange, as YAML.

    ``T_B_F(q) = exp([S_1] q_1) ... exp([S_N] q_N) T_B_F(0)`` with ``S_i = (omega, v)`` and ``v = point x omega``.
    Source: Brockett, Lecture Notes in Control and Information Sciences 58 (1984) 120; Lynch, Park, Modern Robotics,
    2017, chapter 4.
    """
    own = export.geometry.with_T_M_B(np.eye(4))
    rotations, origins = frame_poses(own, np.zeros((1, own.joints)))
    axes, points = rotations[:-1, 0, :, 2], origins[:-1, 0]
    screws = [{"omega": omega, "v": v} for omega, v in zip(axes.tolist(), np.cross(points, axes).tolist(), strict=True)]
    content = {
        "screws": screws,
        "T_B_F_at_zero": matrix_rows(transform(rotations[-1, 0], origins[-1, 0])),
        "tool": own.tool.tolist(),
    }
    return yaml_table(content, export.geometry, [*sentences, _CHAIN])


POE = ExportFormat("poe", "screw axes and home pose (YAML)", ".yaml", poe)
