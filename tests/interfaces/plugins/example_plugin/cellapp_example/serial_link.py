"""The export ``serial-link``: a calibrated arm as a script for Corke's Robotics Toolbox for MATLAB."""

from __future__ import annotations

from collections.abc import Sequence

from cellapp.cell.exports.arm_export import ArmExport
from cellapp.cell.exports.export_format import ExportFormat, smr_in_plain_flange
from cellapp.robot.kinematics.chain import plain_geometry


def serial_link(export: ArmExport, sentences: Sequence[str]) -> str:
    """The text of the file: plain D-H rows, base and tool; ``repr`` keeps every digit."""
    plain = plain_geometry(export.geometry)
    comment = "".join(f"% {line}".rstrip() + "\n" for line in sentences)
    links = "".join(
        f"  Revolute('d', {d!r}, 'a', {a!r}, 'alpha', {alpha!r}, 'offset', {theta!r})\n"
        for theta, d, a, alpha in plain.rows[:, :4].tolist()
    )
    base = "; ".join(" ".join(map(repr, row)) for row in plain.T_M_B().tolist())
    tool = ", ".join(map(repr, plain.tool.tolist()))
    return f"{comment}arm = SerialLink([\n{links}]);\narm.base = SE3([{base}]);\narm.tool = SE3({tool});\n"


SERIAL_LINK = ExportFormat(
    "serial-link", "SerialLink of the Robotics Toolbox (MATLAB)", ".m", serial_link, plain_geometry, smr_in_plain_flange
)
