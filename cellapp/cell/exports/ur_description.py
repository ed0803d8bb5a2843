"""Export the kinematics file of UR's ROS description: ``kinematics_params_file`` of ``ur_description``.

It has six links with ``x, y, z`` [m] and ``roll, pitch, yaw`` [rad], the origins of the URDF's joints, and a ``hash``
of the D-H table. Frames: from the controller's base, which is ``base_link`` rotated by 180 degrees about z, to
``tool0`` (documentation of ``ur_description``, "Robot Frames"). The driver computes the hash from what the connected
controller reports, and logs an error if they differ.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import yaml

from cellapp.cell.exports.arm_export import ArmExport, hashed, millimetres
from cellapp.cell.exports.export_format import ExportFormat, smr_in_plain_flange
from cellapp.cell.exports.urdf import joint_origins
from cellapp.cell.profile.controller_file import controller_file_text
from cellapp.ground.errors import InputError
from cellapp.robot.kinematics.plain_dh import plain_geometry
from cellapp.robot.kinematics.transforms import Array, rotation_vectors, rpy_of
from cellapp.robot.model.nominal import published_rows

_LINKS = ("shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3")
_SEED, _FACTOR, _WORD = 0xC70F6907, 0xC6A4A7935BD1E995, (1 << 64) - 1


def ur_description(export: ArmExport, sentences: Sequence[str]) -> str:
    """Return the YAML text. Raise ``InputError`` if the arm is not a UR arm."""
    rows = ur_rows(export)
    origins = joint_origins(export.geometry)
    links: dict[str, dict[str, float] | str] = {
        link: _origin(origin) for link, origin in zip(_LINKS, origins[:-1], strict=True)
    }
    links["hash"] = kinematics_hash(rows)

    comment = [
        *sentences,
        "The hash is that of a controller which holds the file of 'cellapp export --as ur-calibration'; with another",
        "calibration the driver says that they do not match.",
        f"SMR in tool0 [mm]: {millimetres(smr_in_tool0(export))}",
        *frame_sentences(export)[1:],
    ]
    return hashed(comment) + yaml.safe_dump({"kinematics": links}, sort_keys=False)


def smr_in_tool0(export: ArmExport) -> Array:
    """Return the SMR centre (3,) [m] in ``tool0``, including a and alpha after the last joint: the file has none."""
    flange = joint_origins(export.geometry)[-1]
    return np.asarray(flange[:3, :3] @ export.geometry.tool + flange[:3, 3])


def _origin(T: Array) -> dict[str, float]:
    values = (*T[:3, 3].tolist(), *rpy_of(T[:3, :3]))
    return dict(zip(("x", "y", "z", "roll", "pitch", "yaw"), values, strict=True))


def kinematics_hash(rows: Array) -> str:
    """Return the hash by which UR's drivers recognise a calibration, from D-H rows (6, 4): theta, d, a, alpha.

    The numbers with six significant digits, joint by joint, are joined to one text and hashed by ``std::hash`` of the
    GNU C++ library (``KinematicsInfo::toHash`` in UR's client library). For the published UR10e the result is
    calib_5119701370761913513, as in ``ur_description``.
    """
    return f"calib_{murmur(''.join(f'{value:g}' for row in rows.tolist() for value in row).encode())}"


def murmur(data: bytes) -> int:
    """Compute MurmurHash64A (A. Appleby, public domain) with the seed of the GNU C++ library."""

    def mixed(value: int) -> int:
        return value ^ (value >> 47)

    whole = len(data) & ~7
    state = _SEED ^ (len(data) * _FACTOR & _WORD)
    for place in range(0, whole, 8):
        word = int.from_bytes(data[place : place + 8], "little") * _FACTOR & _WORD
        state = (state ^ (mixed(word) * _FACTOR & _WORD)) * _FACTOR & _WORD
    if rest := data[whole:]:
        state = (state ^ int.from_bytes(rest, "little")) * _FACTOR & _WORD
    return mixed(mixed(state) * _FACTOR & _WORD)


UR_DESCRIPTION = ExportFormat(
    "ur-description",
    "kinematics of UR's ROS 2 description",
    ".yaml",
    ur_description,
    smr=smr_in_tool0,
)


# -- Export the calibration file of a UR controller: ``calibration.conf`` ---------------------------------------------
#
# Its section ``[mounting]`` has four lists of six numbers, ``delta_theta``, ``delta_a``, ``delta_d`` and
# ``delta_alpha`` [rad, m], which the controller adds to its published table; a real file, with 18 significant digits
# and d of -92 m, is quoted in the UR forum ("Calibrated kinamatics info", forum.universal-robots.com/t/18921). Its
# further keys, ``joint_checksum``, ``calibration_status``, ``joint_raw_offset`` and ``joint_selftest_data_crc``, belong
# to the joints of the one arm; only the controller knows them.


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


# ---------------------------------------------------------------------------------------------------------------------
# Common code of the exports for Universal Robots: check that an arm has UR's chain, and return its calibrated rows.


_ALPHA = np.radians([90.0, 0.0, 0.0, 90.0, -90.0, 0.0])
_A, _D = [1, 2], [0, 3, 4, 5]
"""Rows with a length a, or d. Source: Universal Robots, "DH Parameters for calculations of kinematics and dynamics"."""
_ROUNDING = 1e-6
"""Tolerance [m, rad] for rounded right angles in a published table: UR's own states 1.570796327."""


def ur_rows(export: ArmExport) -> Array:
    """Return the calibrated plain D-H rows (6, 4) for the controller: theta, d, a, alpha [rad, m].

    Raises
    ------
    InputError
        If the arm's published table is not that of a UR arm.
    """
    rows = published_rows(export.arm)
    if len(rows) == len(_ALPHA):
        expected = np.zeros((6, 4))
        expected[_D, 1], expected[_A, 2], expected[:, 3] = rows[_D, 1], rows[_A, 2], _ALPHA
    if len(rows) != len(_ALPHA) or not np.allclose(rows, expected, rtol=0.0, atol=_ROUNDING):
        raise InputError(
            f"export: arm '{export.name}' ({export.arm.type.model}) does not have the chain of a UR arm: six joints,"
            " alpha 90, 0, 0, 90, -90, 0 degrees; nothing was written. Take urdf, dh, dh-plain or poe, or give --arm"
        )
    return np.asarray(plain_geometry(export.geometry).rows[:, :4])
