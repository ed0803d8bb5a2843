"""URDF: the calibrated chain from the tracker to the SMR, with joint limits and masses.

The ``origin`` of a joint is ``trans(xyz) rot_z(yaw) rot_y(pitch) rot_x(roll)`` (ROS wiki, "urdf/XML/joint"); each joint
rotates about z. A URDF needs an effort limit and inertia tensors, which a profile does not have.

Export the kinematics file of UR's ROS description: ``kinematics_params_file`` of ``ur_description``.

It has six links with ``x, y, z`` [m] and ``roll, pitch, yaw`` [rad], the origins of the URDF's joints, and a ``hash``
of the D-H table. Frames: from the controller's base, which is ``base_link`` rotated by 180 degrees about z, to
``tool0`` (documentation of ``ur_description``, "Robot Frames"). The driver computes the hash from what the connected
controller reports, and logs an error if they differ.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import numpy as np
import yaml

from cellapp.cell.exports.arm_export import ArmExport, hashed, millimetres
from cellapp.cell.exports.export_format import CellFormat, ExportFormat, smr_in_plain_flange
from cellapp.cell.profile.controller_file import controller_file_text
from cellapp.ground.errors import InputError
from cellapp.robot.kinematics.chain import Geometry, plain_geometry
from cellapp.robot.kinematics.transforms import (
    Array,
    rotation_vectors,
    rotation_x,
    rotation_y,
    rotation_z,
    rpy_of,
    transform,
)
from cellapp.robot.model.nominal import published_rows

_EFFORT = "1000"
"""Effort limit [Nm], which the file must have: above that of any joint of such an arm, so that it never acts."""
_NOTES = (
    "Effort limits are not known and stand for none. Inertias are those of point masses:",
    "a simulator of dynamics needs better ones.",
)


def urdf(export: ArmExport, sentences: Sequence[str]) -> str:
    """Return the URDF: links ``tracker``, ``NAME_base``, one per joint, ``NAME_flange`` and ``NAME_smr``."""
    return urdf_text(export.name, [export], sentences)


def urdf_text(name: str, exports: Sequence[ArmExport], sentences: Sequence[str]) -> str:
    """Return the URDF of a robot of several arms, whose bases are fixed to the link ``tracker``."""
    robot = Element("robot", name=name)
    robot.append(ElementTree.Comment(_comment([*sentences, *_NOTES])))
    SubElement(robot, "link", name="tracker")
    for export in exports:
        _add_arm(robot, export)
    ElementTree.indent(robot)
    return '<?xml version="1.0"?>\n' + ElementTree.tostring(robot, encoding="unicode") + "\n"


def _add_arm(robot: Element, export: ArmExport) -> None:
    name = export.name
    links = ["tracker", f"{name}_base", *(f"{name}_link_{i + 1}" for i in range(export.geometry.joints))]
    links += [f"{name}_flange", f"{name}_smr"]
    tool = transform(np.eye(3), export.geometry.tool)
    poses = [export.geometry.T_M_B(), *joint_origins(export.geometry), tool]
    elements = {link: SubElement(robot, "link", name=link) for link in links[1:]}
    for joint, frame in enumerate(dh_frames_in_links(export.geometry)):
        _add_mass(elements[f"{name}_link_{joint + 1}"], export, joint, frame)
    for number, (parent, child, pose) in enumerate(zip(links, links[1:], poses, strict=False)):
        _add_joint(robot, export, number - 1, parent, child, pose)


def _add_joint(robot: Element, export: ArmExport, index: int, parent: str, child: str, pose: Array) -> None:
    """Add joint ``index`` of the arm; add a fixed joint if the arm has no such joint."""
    is_revolute = 0 <= index < export.geometry.joints
    name = f"{export.name}_joint_{index + 1}" if is_revolute else f"{child}_fixed"
    joint = SubElement(robot, "joint", name=name, type="revolute" if is_revolute else "fixed")
    SubElement(joint, "origin", xyz=_numbers(pose[:3, 3].tolist()), rpy=_numbers(rpy_of(pose[:3, :3])))
    SubElement(joint, "parent", link=parent)
    SubElement(joint, "child", link=child)
    if is_revolute:
        row = export.arm.type.joints[index]
        low, high = row.limit if export.arm.limits is None else export.arm.limits[index]
        SubElement(joint, "axis", xyz="0 0 1")
        SubElement(joint, "limit", lower=repr(low), upper=repr(high), velocity=repr(row.speed), effort=_EFFORT)


def _add_mass(link: Element, export: ArmExport, joint: int, dh_frame: Array) -> None:
    """Add mass and centre of mass of body ``joint``; ``dh_frame`` (4, 4) is its D-H frame in the link's frame."""
    mass = float(export.model.bodies.masses[joint])
    if mass == 0.0:
        return
    center = dh_frame[:3, :3] @ export.model.bodies.centers[joint] + dh_frame[:3, 3]
    inertial = SubElement(link, "inertial")
    SubElement(inertial, "origin", xyz=_numbers(center.tolist()), rpy="0 0 0")
    SubElement(inertial, "mass", value=repr(mass))
    SubElement(inertial, "inertia", ixx="0", ixy="0", ixz="0", iyy="0", iyz="0", izz="0")


def _numbers(values: Sequence[float]) -> str:
    return " ".join(repr(float(value)) for value in values)


def _comment(lines: Sequence[str]) -> str:
    """Format lines as an XML comment, which must not contain two consecutive hyphens."""
    return "\n  " + "\n  ".join(re.sub("-(?=-)", "- ", line) for line in lines) + "\n  "


URDF = ExportFormat("urdf", "URDF from tracker to SMR, limits, masses", ".urdf", urdf)


# -- Export one URDF of the whole cell: every calibrated arm from its base in the tracker frame to its SMR ------------


def cell_urdf(exports: Mapping[str, ArmExport], sentences: Sequence[str]) -> str:
    """Return the URDF; its root is the link ``tracker``, names of links and joints begin with the name of their arm."""
    return urdf_text("cell", list(exports.values()), sentences)


CELL_URDF = CellFormat("urdf-cell", "URDF of the whole cell, its root the tracker", ".urdf", cell_urdf)


# -- Convert a chain to origins of joints that rotate about their own z axes, as in URDF ------------------------------


def joint_origins(geometry: Geometry) -> Array:
    """Return poses (N + 1, 4, 4): each joint in the frame of the joint before (first the base), then the flange.

    The base frame times ``origin_1 rot_z(q_1) ... origin_N rot_z(q_N) origin_flange`` is the flange. Theta and d of a
    D-H row commute with the rotation of its joint and are applied before it; a, alpha and beta before the next joint.
    This is exact for every row. UR's ``ur_description`` splits the rows in the same way.
    """
    before = np.array([transform(rotation_z(theta), [0.0, 0.0, d]) for theta, d in geometry.rows[:, :2]])
    behind = dh_frames_in_links(geometry)
    return np.array([before[0], *(behind[:-1] @ before[1:]), behind[-1]])


def dh_frames_in_links(geometry: Geometry) -> Array:
    """Return the poses (N, 4, 4) of D-H frame i in the frame of the link that joint i rotates."""
    return np.array(
        [transform(rotation_x(alpha) @ rotation_y(beta), [a, 0.0, 0.0]) for a, alpha, beta in geometry.rows[:, 2:]]
    )


_LINKS = ("shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3")
_SEED, _FACTOR, _WORD = 0xC70F6907, 0xC6A4A7935BD1E995, (1 << 64) - 1


def ur_description(export: ArmExport, sentences: Sequence[str]) -> str:
    """Return the YAML text. Raise ``InputError`` if the arm is not a UR arm."""
    rows = ur_rows(export)
    origins = joint_origins(export.geometry)
    links: dict[str, dict[str, float] | str] = {
        link: _ur_origin(origin) for link, origin in zip(_LINKS, origins[:-1], strict=True)
    }
    links["hash"] = kinematics_hash(rows)

    comment = [
        *sentences,
        "The hash is that of a controller which holds the file that export writes --as ur-calibration; with another",
        "calibration the driver says that they do not match.",
        f"SMR in tool0 [mm]: {millimetres(smr_in_tool0(export))}",
        *frame_sentences(export)[1:],
    ]
    return hashed(comment) + yaml.safe_dump({"kinematics": links}, sort_keys=False)


def smr_in_tool0(export: ArmExport) -> Array:
    """Return the SMR centre (3,) [m] in ``tool0``, including a and alpha after the last joint: the file has none."""
    flange = joint_origins(export.geometry)[-1]
    return np.asarray(flange[:3, :3] @ export.geometry.tool + flange[:3, 3])


def _ur_origin(T: Array) -> dict[str, float]:
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
    "ur-description", "kinematics of UR's ROS 2 description", ".yaml", ur_description, smr=smr_in_tool0
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
    rotation = ", ".join(f"{value:z.9f}" for value in rotation_vectors(T_M_B[None, :3, :3])[0].tolist())
    return [
        f"SMR in the flange [mm]: {millimetres(plain_geometry(export.geometry).tool)}",
        f"Base in the tracker frame: position [mm] {millimetres(T_M_B[:3, 3])};",
        f"  rotation vector [rad] {rotation}",
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
