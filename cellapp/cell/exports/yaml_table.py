"""Write tables of a chain as YAML: a comment, the base in the tracker frame, and the format's own content."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import yaml

from cellapp.cell.exports.arm_export import hashed
from cellapp.robot.kinematics.chain import Geometry
from cellapp.robot.kinematics.transforms import Array


def yaml_table(content: Mapping[str, object], geometry: Geometry, sentences: Sequence[str]) -> str:
    """Return the YAML text, with floats in their shortest exact form."""
    content = {"units": "m, rad", "T_M_B": matrix_rows(geometry.T_M_B()), **content}
    return hashed(sentences) + yaml.safe_dump(content, sort_keys=False, default_flow_style=None, width=200)


def matrix_rows(T: Array) -> list[list[float]]:
    """Return a matrix as a list of rows."""
    rows: list[list[float]] = T.tolist()
    return rows
