"""Export all parameters of an arm as CSV: nominal and identified value with standard error; effects as numbers, too."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Sequence
from dataclasses import dataclass, fields

from cellapp.cell.exports.arm_export import ArmExport, hashed
from cellapp.cell.exports.export_format import ExportFormat
from cellapp.robot.kinematics.chain import Geometry, parameter_unit
from cellapp.robot.model import ArmModel

_CHAIN = (
    "T_M_S = R_ref trans(x0, y0, 0) rot_x(alpha0) rot_y(beta0) trans(0, 0, z0) rot_z(theta0) A_1 ... A_N",
    "  trans(tx, ty, tz); A_i = rot_z(q_i + theta) trans(a, 0, d) rot_x(alpha) rot_y(beta)",
    "Effects are listed as numbers; 'cellapp docs effects' has their equations.",
)


@dataclass(frozen=True)
class ParameterRow:
    """Parameter of an arm's model: nominal and identified value with its standard error, all in ``unit``.

    ``standard_error`` is None for parameters that were not identified. An effect's parameter is named ``SLUG.NAME``.
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
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([field.name for field in fields(ParameterRow)])
    for row in parameter_rows(export.model, export.geometry):
        error = "" if row.standard_error is None else repr(row.standard_error)
        writer.writerow([row.parameter, row.unit, repr(row.nominal), repr(row.identified), error])
    frame = "R_ref maps z to the tracker's " + "xyz"[export.geometry.reference_axis]
    return hashed([*sentences, *_CHAIN, frame]) + text.getvalue()


PARAMETERS = ExportFormat("parameters", "parameters and standard errors (CSV)", ".csv", parameters)
