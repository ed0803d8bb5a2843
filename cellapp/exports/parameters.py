"""All parameters of an arm as CSV: nominal and identified value with its standard error; effects, too, as numbers."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Sequence

from cellapp.exports.arm_export import ArmExport, hashed
from cellapp.exports.export_format import ExportFormat
from cellapp.kinematics.chain import parameter_names, parameter_unit

_CHAIN = (
    "T_M_S = R_ref trans(x0, y0, 0) rot_x(alpha0) rot_y(beta0) trans(0, 0, z0) rot_z(theta0) A_1 ... A_N",
    "  trans(tx, ty, tz); A_i = rot_z(q_i + theta) trans(a, 0, d) rot_x(alpha) rot_y(beta)",
    "Effects are listed as numbers; 'cellapp docs effects' has their equations.",
)


def parameters(export: ArmExport, sentences: Sequence[str]) -> str:
    """The CSV text: comment lines, a header row, a row for each parameter [m, rad]; floats in the shortest exact form.

    ``standard_error`` is empty for parameters that were not identified.
    """
    model, names = export.model, parameter_names(export.geometry.joints)
    errors: dict[str, str] = {}
    if model.covariance is not None:
        variances = model.covariance.diagonal().tolist()
        errors = {name: repr(math.sqrt(v)) for name, v in zip(model.identified, variances, strict=False) if v >= 0.0}
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["parameter", "unit", "nominal", "identified", "standard_error"])
    values = zip(names, model.nominal.vector().tolist(), model.geometry.vector().tolist(), strict=True)
    writer.writerows([n, parameter_unit(n), repr(old), repr(new), errors.get(n, "")] for n, old, new in values)
    for term in model.effects:
        found = zip(term.names, term.units, term.values.tolist(), term.standard_errors.tolist(), strict=True)
        writer.writerows([f"{term.slug}.{n}", unit, "0.0", repr(value), repr(error)] for n, unit, value, error in found)
    frame = "R_ref maps z to the tracker's " + "xyz"[export.geometry.reference_axis]
    return hashed([*sentences, *_CHAIN, frame]) + text.getvalue()


PARAMETERS = ExportFormat("parameters", "parameters and standard errors (CSV)", ".csv", parameters)
