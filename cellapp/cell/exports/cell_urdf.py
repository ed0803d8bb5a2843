"""Export one URDF of the whole cell: every calibrated arm from its base in the tracker frame to its SMR."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from cellapp.cell.exports.arm_export import ArmExport
from cellapp.cell.exports.export_format import CellFormat
from cellapp.cell.exports.urdf import urdf_text


def cell_urdf(exports: Mapping[str, ArmExport], sentences: Sequence[str]) -> str:
    """Return the URDF; its root is the link ``tracker``, names of links and joints begin with the name of their arm."""
    return urdf_text("cell", list(exports.values()), sentences)


CELL_URDF = CellFormat("urdf-cell", "URDF of the whole cell, its root the tracker", ".urdf", cell_urdf)
