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
from cellapp.cell.exports.export_format import ExportFormat
from cellapp.cell.exports.joint_origins import joint_origins
from cellapp.cell.exports.ur_calibration import frame_sentences
from cellapp.cell.exports.ur_chain import ur_rows
from cellapp.robot.kinematics.transforms import Array, rpy_of

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
