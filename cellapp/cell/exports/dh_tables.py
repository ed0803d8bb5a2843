"""Export D-H tables of the calibrated chain, with and without Hayati angles, as YAML."""

from __future__ import annotations

from collections.abc import Sequence

from cellapp.cell.exports.arm_export import ArmExport
from cellapp.cell.exports.export_format import ExportFormat, smr_in_plain_flange
from cellapp.cell.exports.yaml_table import yaml_table
from cellapp.robot.kinematics.chain import ROW_NAMES, Geometry
from cellapp.robot.kinematics.plain_dh import plain_geometry

_CHAIN = "T_M_S = T_M_B A_1 ... A_N trans(tool); A_i = rot_z(q_i + theta) trans(a, 0, d) rot_x(alpha)"


def dh(export: ArmExport, sentences: Sequence[str]) -> str:
    """Return D-H rows with Hayati's beta, as in the model (Hayati, Mirmirani, J. Robotic Systems 2 (1985) 397)."""
    return _dh_table(export.geometry, 5, [*sentences, f"{_CHAIN} rot_y(beta)"])


def dh_plain(export: ArmExport, sentences: Sequence[str]) -> str:
    """Return plain D-H rows; between nearly parallel axes d is hundreds of metres, and rounding it loses accuracy."""
    return _dh_table(plain_geometry(export.geometry), 4, [*sentences, _CHAIN])


def _dh_table(geometry: Geometry, columns: int, sentences: Sequence[str]) -> str:
    rows = [dict(zip(ROW_NAMES, row, strict=False)) for row in geometry.rows[:, :columns].tolist()]
    probe = {} if geometry.probe is None else {"probe_rotation_vector": geometry.probe.tolist()}
    return yaml_table({"rows": rows, "tool": geometry.tool.tolist(), **probe}, geometry, sentences)


DH = ExportFormat("dh", "D-H table with Hayati angles (YAML)", ".yaml", dh)
DH_PLAIN = ExportFormat(
    "dh-plain", "D-H table without Hayati angles (YAML)", ".yaml", dh_plain, plain_geometry, smr_in_plain_flange
)
