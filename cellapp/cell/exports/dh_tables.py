"""Export the calibrated chain as YAML: D-H tables with and without Hayati angles, product of exponentials; as CSV."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields

import numpy as np
import yaml

from cellapp.cell.exports.arm_export import ArmExport, hashed
from cellapp.cell.exports.export_format import ExportFormat, smr_in_plain_flange
from cellapp.cell.run.csv_text import table_text
from cellapp.robot.kinematics.chain import ROW_NAMES, Geometry, frame_poses, parameter_unit, plain_geometry
from cellapp.robot.kinematics.transforms import transform
from cellapp.robot.model import ArmModel

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


# -- Export the calibrated chain as a product of exponentials, as YAML ------------------------------------------------


_POE_CHAIN = (
    "T_M_S = T_M_B exp([S_1] q_1) ... exp([S_N] q_N) T_B_F_at_zero trans(tool); S = (omega, v) in the base frame"
)


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
        "T_B_F_at_zero": transform(rotations[-1, 0], origins[-1, 0]).tolist(),
        "tool": own.tool.tolist(),
    }
    return yaml_table(content, export.geometry, [*sentences, _POE_CHAIN])


POE = ExportFormat("poe", "screw axes and home pose (YAML)", ".yaml", poe)


# -- Write tables of a chain as YAML: a comment, the base in the tracker frame, and the format's own content ----------


def yaml_table(content: Mapping[str, object], geometry: Geometry, sentences: Sequence[str]) -> str:
    """Return the YAML text, with floats in their shortest exact form."""
    content = {"units": "m, rad", "T_M_B": geometry.T_M_B().tolist(), **content}
    return hashed(sentences) + yaml.safe_dump(content, sort_keys=False, default_flow_style=None, width=200)


# ---------------------------------------------------------------------------------------------------------------------
# Export all parameters of an arm as CSV: nominal and identified value with standard error; effects as numbers, too.


_PARAMETERS_CHAIN = (
    "T_M_S = R_ref trans(x0, y0, 0) rot_x(alpha0) rot_y(beta0) trans(0, 0, z0) rot_z(theta0) A_1 ... A_N",
    "  trans(tx, ty, tz); A_i = rot_z(q_i + theta) trans(a, 0, d) rot_x(alpha) rot_y(beta)",
    "Effects are listed as numbers; 'cellapp docs effects' has their equations.",
)


@dataclass(frozen=True)
class ParameterRow:
    """Parameter of an arm's model: nominal and identified value with its standard error, all in ``unit``.

    ``standard_error`` is None for parameters that were not identified, or are at a bound. An effect's parameter is
    named ``SLUG.NAME``.
    """

    parameter: str
    unit: str
    nominal: float
    identified: float
    standard_error: float | None


def parameter_rows(model: ArmModel, geometry: Geometry) -> list[ParameterRow]:
    """Return all parameters of ``geometry``, which is the model's or equivalent to it, and of the model's effects."""
    names = geometry.names
    errors: dict[str, float] = {}
    if model.covariance is not None:
        variances = model.covariance.diagonal().tolist()
        errors = {name: math.sqrt(v) for name, v in zip(model.identified, variances, strict=False) if v >= 0.0}
        errors |= {name: errors[first] for name, first in geometry.tied_to.items() if first in errors}
        errors = {name: error for name, error in errors.items() if name not in geometry.at_bound}
    values = zip(names, model.nominal.vector().tolist(), geometry.vector().tolist(), strict=True)
    rows = [ParameterRow(name, parameter_unit(name), old, new, errors.get(name)) for name, old, new in values]
    for term in model.effects:
        found = zip(term.names, term.units, term.values.tolist(), term.standard_errors.tolist(), strict=True)
        rows += [ParameterRow(f"{term.slug}.{name}", unit, 0.0, value, error) for name, unit, value, error in found]
    return rows


def parameters(export: ArmExport, sentences: Sequence[str]) -> str:
    """Return the CSV text: comment lines, header row, a row per parameter [m, rad]; floats in the shortest exact form.

    ``standard_error`` is empty for parameters that were not identified.
    """
    rows = (
        [one.parameter, one.unit, repr(one.nominal), repr(one.identified), "" if error is None else repr(error)]
        for one in parameter_rows(export.model, export.geometry)
        for error in (one.standard_error,)
    )
    frame = "R_ref maps z to the tracker's " + "xyz"[export.geometry.reference_axis]
    table = table_text([field.name for field in fields(ParameterRow)], rows, "\n")
    return hashed([*sentences, *_PARAMETERS_CHAIN, frame]) + table


PARAMETERS = ExportFormat("parameters", "parameters and standard errors (CSV)", ".csv", parameters, lists_effects=True)
