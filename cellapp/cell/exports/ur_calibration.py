"""Export the calibration file of a UR controller: ``calibration.conf``.

Its section ``[mounting]`` has four lists of six numbers, ``delta_theta``, ``delta_a``, ``delta_d`` and ``delta_alpha``
[rad, m], which the controller adds to its published table; a real file, with 18 significant digits and d of -92 m, is
quoted in the UR forum ("Calibrated kinamatics info", forum.universal-robots.com/t/18921). Its further keys,
``joint_checksum``, ``calibration_status``, ``joint_raw_offset`` and ``joint_selftest_data_crc``, belong to the joints
of the one arm; only the controller knows them.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cellapp.cell.exports.arm_export import ArmExport, millimetres
from cellapp.cell.exports.export_format import ExportFormat, smr_in_plain_flange
from cellapp.cell.exports.ur_chain import ur_rows
from cellapp.cell.profile.controller_file import controller_file_text
from cellapp.robot.kinematics.plain_dh import plain_geometry
from cellapp.robot.kinematics.transforms import rotation_vectors
from cellapp.robot.model.nominal import published_rows


def ur_calibration(export: ArmExport, sentences: Sequence[str]) -> str:
    """Return the four lines of deltas. Raise ``InputError`` if the arm is not a UR arm."""
    rows, nominal = ur_rows(export), published_rows(export.arm)
    delta = rows - nominal
    delta[:, [0, 3]] -= 2.0 * np.pi * np.round(delta[:, [0, 3]] / (2.0 * np.pi))
    comment = [
        *sentences,
        "Replace the four lines in the controller's own calibration.conf, section [mounting]; keep its other lines:",
        "they belong to the joints. Keep a copy of the file: every taught pose moves with it.",
        "The deltas are to be added to this published table (theta is zero):",
        *(f"  {name} = {nominal[:, place].tolist()}" for name, place in (("a", 2), ("d", 1), ("alpha", 3))),
        *frame_sentences(export),
    ]
    return controller_file_text(delta.tolist(), "", comment)


def frame_sentences(export: ArmExport) -> list[str]:
    """Describe the SMR in the flange of the plain D-H rows, and the base in the tracker frame, as UR poses."""
    T_M_B = export.geometry.T_M_B()
    turn = ", ".join(f"{value:.9f}" for value in rotation_vectors(T_M_B[None, :3, :3])[0].tolist())
    return [
        f"SMR in the flange [mm]: {millimetres(plain_geometry(export.geometry).tool)}",
        f"Base in the tracker frame: position [mm] {millimetres(T_M_B[:3, 3])};",
        f"  rotation vector [rad] {turn}",
    ]


UR_CALIBRATION = ExportFormat(
    "ur-calibration",
    "deltas in a UR arm's calibration.conf",
    ".conf",
    ur_calibration,
    plain_geometry,
    smr_in_plain_flange,
)
