"""URDF: the calibrated chain from the tracker to the SMR, with joint limits and masses.

The ``origin`` of a joint is ``trans(xyz) rot_z(yaw) rot_y(pitch) rot_x(roll)`` (ROS wiki, "urdf/XML/joint"); each joint
rotates about z. A URDF needs an effort limit and inertia tensors, which a profile does not have.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import numpy as np

from cellapp.cell.exports.arm_export import ArmExport
from cellapp.cell.exports.export_format import CellFormat, ExportFormat
from cellapp.robot.kinematics.chain import Geometry
from cellapp.robot.kinematics.transforms import Array, rotation_x, rotation_y, rotation_z, rpy_of, transform

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
    turns = 0 <= index < export.geometry.joints
    name = f"{export.name}_joint_{index + 1}" if turns else f"{child}_fixed"
    joint = SubElement(robot, "joint", name=name, type="revolute" if turns else "fixed")
    SubElement(joint, "origin", xyz=_numbers(pose[:3, 3].tolist()), rpy=_numbers(rpy_of(pose[:3, :3])))
    SubElement(joint, "parent", link=parent)
    SubElement(joint, "child", link=child)
    if turns:
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
